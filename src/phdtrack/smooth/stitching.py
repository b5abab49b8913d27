"""Which trajectories are of one target: the evidence of one that was lost and found again, against that of two.

A target that is lost re-enters with probability ``reentry``, after a time of exponential distribution, mean ``occluded``. A
trajectory that begins may be a new target: new ones come at the rate at which trajectories begin in this very stream,
anywhere among its measurements. The log-odds of a pair of trajectories, T apart, are

    log p(B|A)/p(B) + log p_S(T) + log reentry/(1 − reentry) + log (1/occluded) e^(−T/occluded) − log births

with births per time unit and unit of measurement volume. With A, B the measurements of two trajectories, a and b the states
at B's beginning, and π the prior of a state (flat over what measurements show, a Gaussian over the rest, as velocities),

    p(B|A)/p(B) = ∫ p(x|A) p(x|B)/π(x) dx

with both densities Gaussian: A's prediction from its end, and B's own smoothed beginning.

A detector that fires twice on one target may begin its second track before the first has ended: T is then the time for which
both overlap, and p_S = 1. Trajectories are joined so that the sum over all pairs is the largest, each with one successor at
most. Then they are smoothed anew, because a short piece between two others says more once it is joined, and so on until
nothing changes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from phdtrack.protocols import Motion
from phdtrack.smooth.appearance import log_likelihood_ratio
from phdtrack.smooth.smoother import MeasuredStates, Paths, Smoothed, ahead, joined, smooth
from phdtrack.types import F8, I8, Bool, MeasurementHistory


@dataclass(frozen=True, slots=True)
class Terms:
    """Mean time ``occluded``, longest ``gap`` and ``overlap`` in model time; P(``reentry``); time units a second."""

    occluded: float
    gap: float
    overlap: float
    reentry: float
    rate: float


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Path ``after`` (P,) may continue path ``before`` (P,), with these log-odds (P,)."""

    before: I8
    after: I8
    odds: F8


@dataclass(frozen=True, slots=True, eq=False)
class Sequence:
    """What is known of the whole sequence: its measurements, the same as states, and the motion."""

    measurements: MeasurementHistory
    seen: MeasuredStates
    motion: Motion

    def components(self) -> I8:
        """The rows of the state that later states depend on; not a size that a transition forgets."""
        _, jacobian, _ = self.motion.transition(np.ascontiguousarray(self.seen.state[:, :1]), 1.0)
        return np.flatnonzero(jacobian[0].any(axis=0)).astype(np.int64)

    def smooth(self, paths: Paths) -> Smoothed:
        """The states of the paths."""
        return smooth(paths, self.measurements, self.seen, self.motion)


@dataclass(frozen=True, slots=True, eq=False)
class Beginnings:
    """States of K trajectories by their own measurements, and their prior, as Gaussians in information form.

    Attributes
    ----------
    mean, inverse, log_inverse : (K, k), (K, k, k), (K,) of the states: inverse covariance and its log-determinant.
    prior, prior_inverse, log_prior : the same of the prior, 0 in observed rows.
    shown : number of observed rows.
    """

    mean: F8
    inverse: F8
    log_inverse: F8
    prior: F8
    prior_inverse: F8
    log_prior: F8
    shown: int

    @classmethod
    def of(cls, paths: Paths, states: Smoothed, sequence: Sequence, which: I8, row: I8) -> Beginnings:
        """Of the paths ``which`` (K,) in their rows ``row`` (K,)."""
        seen, kept = sequence.seen, sequence.components()
        column = paths.measurement[paths.first[which]]
        inverse = _inverse(states.covariance[row][:, kept[:, None], kept])
        unseen = np.setdiff1d(kept, seen.observed)
        at = np.searchsorted(kept, unseen)
        block = _inverse(seen.covariance[column][:, unseen[:, None], unseen])
        prior, prior_inverse = np.zeros((len(row), len(kept))), np.zeros_like(inverse)
        prior[:, at] = seen.state[unseen[:, None], column].T
        prior_inverse[:, at[:, None], at] = block
        mean, shown = states.mean[row][:, kept], len(kept) - len(unseen)
        return cls(mean, inverse, _log_det(inverse), prior, prior_inverse, _log_det(block), shown)

    def log_evidence(self, mean: F8, covariance: F8, which: I8) -> F8:
        """(P,) log p(B|A)/p(B) for states (P, k), (P, k, k) by A, and by B the beginnings ``which`` (P,)."""
        inverse = _inverse(covariance)
        later, prior = self.inverse[which], self.prior_inverse[which]
        total = inverse + later - prior
        # From the prediction, so that no large numbers are taken from each other.
        step, rest = (self.mean[which] - mean)[:, :, None], (self.prior[which] - mean)[:, :, None]
        pull = later @ step - prior @ rest
        square = step.transpose(0, 2, 1) @ later @ step - rest.transpose(0, 2, 1) @ prior @ rest
        square -= pull.transpose(0, 2, 1) @ np.linalg.solve(total, pull)
        logs = _log_det(inverse) + self.log_inverse[which] - self.log_prior[which] - _log_det(total)
        out: F8 = 0.5 * (logs - square[:, 0, 0] - self.shown * math.log(2 * math.pi))
        return out


def stitched(paths: Paths, sequence: Sequence, terms: Terms) -> tuple[Paths, Smoothed]:
    """The paths, those of one target joined, and their states.

    Parameters
    ----------
    paths : K trajectories.
    sequence : what is known of the sequence.
    terms : settings.
    """
    states, appearance = sequence.smooth(paths), sequence.measurements.appearance
    while len(paths) > 1:
        pairs = candidates(paths, states, sequence, terms)
        if appearance.shape[1]:
            alike = log_likelihood_ratio(paths, appearance, pairs.before, pairs.after)
            pairs = Pairs(pairs.before, pairs.after, pairs.odds + alike)
        after = matched(pairs, len(paths))
        if (after < 0).all():
            break
        chain = _chains(after)
        longer = joined(paths, chain)
        changed = np.bincount(chain) > 1
        again = sequence.smooth(longer.take(changed))
        states = _merged(states, ~changed[chain[paths.path]], again, changed[longer.path])
        paths = longer
    return paths, states


def candidates(paths: Paths, states: Smoothed, sequence: Sequence, terms: Terms) -> Pairs:
    """All pairs that could be of one target.

    One begins within ``gap`` after the other's end, while the lost target may still be there; or they overlap (`_overlaps`).
    Trajectories that have ended are carried on through the frames together.
    """
    measurements, seen, kept = sequence.measurements, sequence.seen, sequence.components()
    time, last, end, begin = measurements.time, paths.last, paths.frame[paths.last], paths.frame[paths.first]
    loose = math.log(_births(paths, sequence) * terms.occluded * (1 - terms.reentry) / terms.reentry)
    starts = Beginnings.of(paths, states, sequence, np.arange(len(paths)), paths.first)
    found = [_overlaps(paths, states, sequence, terms, loose)]
    # The last frame in which a path begins that each may go on in.
    beginning = np.unique(begin)
    until = beginning[np.searchsorted(time[beginning], time[end] + terms.gap + 1e-9, side="right") - 1]
    lost, alive = np.zeros(0, np.int64), np.zeros(0)
    mean, cov = np.zeros((0, len(seen.state))), np.zeros((0, len(seen.state), len(seen.state)))
    for p in range(1, len(time)):
        fresh = np.flatnonzero((end == p - 1) & (until >= p))
        lost, alive = np.concatenate((lost, fresh)), np.concatenate((alive, np.zeros(len(fresh))))
        mean, cov = (np.concatenate((a, b[last[fresh]])) for a, b in ((mean, states.mean), (cov, states.covariance)))
        if len(lost) == 0:
            continue
        now = ahead(mean, cov, p, measurements, sequence.motion)
        survive = sequence.motion.p_survive(np.ascontiguousarray(now.mean.T), float(time[p] - time[p - 1]) / terms.rate)
        stay = (survive > 0) & (until[lost] >= p)
        lost, alive = lost[stay], alive[stay] + np.log(survive[stay])
        mean, cov = now.mean[stay], now.covariance[stay]
        come = np.flatnonzero(begin == p)
        if len(come) and len(lost):
            a, b = np.repeat(np.arange(len(lost)), len(come)), np.tile(come, len(lost))
            odds = starts.log_evidence(mean[a][:, kept], cov[a][:, kept[:, None], kept], b)
            odds += alive[a] - (time[p] - time[end[lost[a]]]) / terms.occluded - loose
            found.append(Pairs(lost[a], b, odds))
    return Pairs(
        np.concatenate([part.before for part in found]),
        np.concatenate([part.after for part in found]),
        np.concatenate([part.odds for part in found]),
    )


def _overlaps(paths: Paths, states: Smoothed, sequence: Sequence, terms: Terms, loose: float) -> Pairs:
    """All pairs of which one begins before the other ends, by ``overlap`` at most, and ends later.

    They are compared in the middle of the time that they share, where both are known best.
    """
    begin, end, time = paths.frame[paths.first], paths.frame[paths.last], sequence.measurements.time
    order = np.argsort(end, kind="stable")
    latest = np.searchsorted(time, time[begin] + terms.overlap + 1e-9, side="right")
    low, high = np.searchsorted(end[order], begin), np.searchsorted(end[order], np.minimum(latest, end))
    count = np.maximum(high - low, 0)
    b = np.repeat(np.arange(len(paths)), count)
    a = order[np.repeat(low, count) + np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)]
    earlier = begin[a] < begin[b]
    a, b = a[earlier], b[earlier]
    middle, kept = (begin[b] + end[a] + 1) // 2, sequence.components()
    here = paths.first[a] + middle - begin[a]
    starts = Beginnings.of(paths, states, sequence, b, paths.first[b] + middle - begin[b])
    mean, cov = states.mean[here][:, kept], states.covariance[here][:, kept[:, None], kept]
    odds = starts.log_evidence(mean, cov, np.arange(len(b)))
    return Pairs(a, b, odds - (time[end[a]] - time[begin[b]]) / terms.occluded - loose)


def _births(paths: Paths, sequence: Sequence) -> float:
    """How many trajectories begin per time unit and unit of measurement volume, in the volume that all measurements span."""
    seen, time = sequence.seen, sequence.measurements.time
    column, shown = paths.measurement[paths.measurement >= 0], seen.observed
    z = seen.state[shown[:, None], column]
    noise = np.sqrt(np.median(seen.covariance[column][:, shown, shown], axis=0))
    # Where all is one place, it is as large as measurements are fine.
    volume = np.prod(z.max(axis=1) - z.min(axis=1) + 4 * noise)
    return float(len(paths) / (volume * (time[-1] - time[0])))


def matched(pairs: Pairs, count: int) -> I8:
    """(K,) the successor of each of ``count`` paths, −1 for none, so that the sum of the log-odds is the largest."""
    after = np.full(count, -1, np.int64)
    good = np.flatnonzero(pairs.odds > 0)
    if len(good) == 0:
        return after
    # Importing it takes most of a second, which a run in which nothing can be joined need not wait for.
    from scipy.optimize import linear_sum_assignment
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    a, b, odds = pairs.before[good], pairs.after[good], pairs.odds[good]
    graph = coo_array((np.ones(len(a)), (a, b + count)), shape=(2 * count, 2 * count))
    _, part = connected_components(graph, directed=False)
    order = np.argsort(part[a], kind="stable")
    for these in np.split(order, np.flatnonzero(np.diff(part[a][order])) + 1):
        rows, row = np.unique(a[these], return_inverse=True)
        columns, column = np.unique(b[these], return_inverse=True)
        gain = np.zeros((len(rows), len(columns)))
        gain[row, column] = odds[these]
        i, j = linear_sum_assignment(gain, maximize=True)
        real = gain[i, j] > 0
        after[rows[i[real]]] = columns[j[real]]
    return after


def _chains(after: I8) -> I8:
    """(K,) the number of the chain of each path, from its successor ``after`` (K,), −1 for none, by their first paths."""
    follows = np.isin(np.arange(len(after)), after)
    chain = np.full(len(after), -1, np.int64)
    for number, head in enumerate(np.flatnonzero(~follows).tolist()):
        here = head
        while here >= 0:
            chain[here] = number
            here = int(after[here])
    return chain


def _merged(old: Smoothed, kept: Bool, new: Smoothed, changed: Bool) -> Smoothed:
    """The states of all rows: ``new`` where they have ``changed`` (M,), elsewhere the ``old`` ones that are ``kept``."""
    mean, cov = np.empty((len(changed), old.mean.shape[1])), np.empty((len(changed), *old.covariance.shape[1:]))
    mean[changed], cov[changed] = new.mean, new.covariance
    mean[~changed], cov[~changed] = old.mean[kept], old.covariance[kept]
    return Smoothed(mean, cov)


def _inverse(a: F8) -> F8:
    return np.linalg.inv(a).astype(np.float64, copy=False)


def _log_det(a: F8) -> F8:
    out: F8 = np.linalg.slogdet(a)[1]
    return out
