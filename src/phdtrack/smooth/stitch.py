"""Which trajectories are one: the evidence of one object, lost and found again, against that of two.

A trajectory that ends has been lost out of sight with probability ``back``, to be found again after a time of exponential
distribution, mean ``hidden``, or has ended for good. One that begins may be a new object: new ones come at the rate at
which trajectories begin in this very stream, anywhere among its measurements. So the log-odds of a pair, T apart, are

    log p(B|A)/p(B) + log p_S(T) + log back/(1 − back) + log (1/hidden) e^(−T/hidden) − log births

with `evidence` for the first term, and births per time unit and unit of measurement volume. A detector that fires twice on
one object may begin its second track before the first has ended: such a pair is asked for as well, with the time that both
go on for T and p_S = 1. Trajectories are joined so that
the sum over all pairs is the largest, each with one successor at most; then they are smoothed anew, because a short piece
between two others says more once it is joined, and so on until nothing changes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from phdtrack.protocols import Motion
from phdtrack.smooth.ahead import ahead
from phdtrack.smooth.appearance import likeness
from phdtrack.smooth.evidence import log_evidence, others
from phdtrack.smooth.paths import Paths, Seen, chains, joined
from phdtrack.smooth.smooth import Smoothed, smooth
from phdtrack.types import F8, I8, Bool, MeasurementHistory


@dataclass(frozen=True, slots=True)
class Terms:
    """Mean and ``longest`` time out of sight, longest time that two tracks of one object go on ``beside`` each other, all in
    model time; ``back`` the probability that an end is no end; ``rate`` time units per second."""

    hidden: float
    longest: float
    beside: float
    back: float
    rate: float = 25.0


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Path ``after`` (P,) may be path ``before`` (P,) gone on; ``odds`` (P,) is the logarithm of the odds that it is."""

    before: I8
    after: I8
    odds: F8


def stitched(paths: Paths, measured: MeasurementHistory, seen: Seen, motion: Motion, terms: Terms) -> tuple[Paths, Smoothed]:
    """The paths with those joined that are one object's, and their states."""
    states = smooth(paths, measured, seen, motion)
    while len(paths) > 1:
        pairs = candidates(paths, states, measured, seen, motion, terms)
        if measured.appearance.shape[1]:
            pairs = replace(pairs, odds=pairs.odds + likeness(paths, measured.appearance, pairs.before, pairs.after))
        after = matched(pairs, len(paths))
        if (after < 0).all():
            break
        chain = chains(after)
        longer = joined(paths, chain)
        changed = np.bincount(chain) > 1
        again = smooth(longer.take(changed), measured, seen, motion)
        states = _merged(states, ~changed[chain[paths.owner]], again, changed[longer.owner])
        paths = longer
    return paths, states


def _merged(old: Smoothed, kept: Bool, new: Smoothed, changed: Bool) -> Smoothed:
    """The states of all rows: ``new`` where they have ``changed`` (M,), elsewhere the ``old`` ones that are ``kept``."""
    mean, cov = np.empty((len(changed), old.mean.shape[1])), np.empty((len(changed), *old.covariance.shape[1:]))
    mean[changed], cov[changed] = new.mean, new.covariance
    mean[~changed], cov[~changed] = old.mean[kept], old.covariance[kept]
    return Smoothed(mean, cov)


def candidates(
    paths: Paths, states: Smoothed, measured: MeasurementHistory, seen: Seen, motion: Motion, terms: Terms
) -> Pairs:
    """All pairs of which one begins after the other's end, ``longest`` at most, while whoever was lost may still be there.

    Those whose trajectory has ended are carried on through the frames together.
    """
    time, last = measured.time, paths.last
    end, begin = paths.frame[last], paths.frame[paths.first]
    kept = remembered(seen, motion)
    loose = math.log(_births(paths, measured, seen) * terms.hidden * (1 - terms.back) / terms.back)
    starts = others(paths, states, seen, kept, np.arange(len(paths)), paths.first)
    found = [_beside(paths, states, measured, seen, kept, terms, loose)]
    # The last frame in which a path begins that each may go on in.
    beginning = np.unique(begin)
    reach = np.searchsorted(time[beginning], time[end] + terms.longest + 1e-9, side="right") - 1
    until = beginning[reach]
    lost, alive = np.zeros(0, np.int64), np.zeros(0)
    mean, cov = np.zeros((0, len(seen.state))), np.zeros((0, len(seen.state), len(seen.state)))
    for p in range(1, len(time)):
        fresh = np.flatnonzero((end == p - 1) & (until >= p))
        lost, alive = np.concatenate((lost, fresh)), np.concatenate((alive, np.zeros(len(fresh))))
        mean, cov = (np.concatenate((a, b[last[fresh]])) for a, b in ((mean, states.mean), (cov, states.covariance)))
        if len(lost) == 0:
            continue
        now = ahead(mean, cov, p, measured, motion)
        survive = motion.p_survive(np.ascontiguousarray(now.mean.T), float(time[p] - time[p - 1]) / terms.rate)
        stay = (survive > 0) & (until[lost] >= p)
        lost, alive = lost[stay], alive[stay] + np.log(survive[stay])
        mean, cov = now.mean[stay], now.covariance[stay]
        come = np.flatnonzero(begin == p)
        if len(come) and len(lost):
            a, b = np.repeat(np.arange(len(lost)), len(come)), np.tile(come, len(lost))
            odds = log_evidence(mean[a][:, kept], cov[a][:, kept[:, None], kept], starts, b)
            odds += alive[a] - (time[p] - time[end[lost[a]]]) / terms.hidden - loose
            found.append(Pairs(lost[a], b, odds))
    return Pairs(*(np.concatenate([getattr(part, name) for part in found]) for name in ("before", "after", "odds")))


def _beside(
    paths: Paths, states: Smoothed, measured: MeasurementHistory, seen: Seen, kept: I8, terms: Terms, loose: float
) -> Pairs:
    """All pairs of which one begins while the other still goes on, for ``beside`` at most, and ends later.

    They are asked for in the middle of the time that they share, where both know most.
    """
    begin, end = paths.frame[paths.first], paths.frame[paths.last]
    order = np.argsort(end, kind="stable")
    latest = np.searchsorted(measured.time, measured.time[begin] + terms.beside + 1e-9, side="right")
    low, high = np.searchsorted(end[order], begin), np.searchsorted(end[order], np.minimum(latest, end))
    count = np.maximum(high - low, 0)
    b = np.repeat(np.arange(len(paths)), count)
    a = order[np.repeat(low, count) + np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)]
    earlier = begin[a] < begin[b]
    a, b = a[earlier], b[earlier]
    middle = (begin[b] + end[a] + 1) // 2
    here = paths.first[a] + middle - begin[a]
    starts = others(paths, states, seen, kept, b, paths.first[b] + middle - begin[b])
    odds = log_evidence(
        states.mean[here][:, kept], states.covariance[here][:, kept[:, None], kept], starts, np.arange(len(b))
    )
    shared = measured.time[end[a]] - measured.time[begin[b]]
    return Pairs(a, b, odds - shared / terms.hidden - loose)


def remembered(seen: Seen, motion: Motion) -> I8:
    """The rows of the state that say what comes next: not those that a transition forgets, as the size before the last."""
    probe = np.ascontiguousarray(seen.state[:, :1])
    _, jacobian, _ = motion.transition(probe, 1.0)
    return np.flatnonzero(jacobian[0].any(axis=0)).astype(np.int64)


def _births(paths: Paths, measured: MeasurementHistory, seen: Seen) -> float:
    """How many trajectories begin per time unit and unit of measurement volume: those that do, anywhere among all."""
    column, shown = paths.measurement[paths.measurement >= 0], seen.observed
    z = seen.state[shown[:, None], column]
    noise = np.sqrt(np.median(seen.covariance[column][:, shown, shown], axis=0))
    # Where all is one place, it is as large as measurements are fine.
    volume = np.prod(z.max(axis=1) - z.min(axis=1) + 4 * noise)
    return float(len(paths) / (volume * (measured.time[-1] - measured.time[0])))


def matched(pairs: Pairs, count: int) -> I8:
    """(K,) the successor of each of ``count`` paths, −1 for none: the sum of the log-odds is the largest that there is."""
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
        which, whom = linear_sum_assignment(gain, maximize=True)
        real = gain[which, whom] > 0
        after[rows[which[real]]] = columns[whom[real]]
    return after
