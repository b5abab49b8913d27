"""Joining tracks of one target that was lost and found again.

The evidence of one target that was lost and found again is compared with that of two targets. A
target that is lost re-enters with probability ``reentry``, after a time of exponential distribution
with mean ``occluded``. A trajectory that begins may be a new target: new ones appear at the rate at
which trajectories begin in this sequence, anywhere among its measurements. The log-odds of a pair
of trajectories, T apart, are

    log p(B|A)/p(B) + log p_S(T) + log reentry/(1 − reentry) + log (1/occluded) e^(−T/occluded)
    − log births

with births per time unit and unit of measurement volume. With A, B the measurements of the two
trajectories, x the state at B's beginning, and π the prior of a state (flat over what measurements
show, a Gaussian over the rest, such as velocities),

    p(B|A)/p(B) = ∫ p(x|A) p(x|B)/π(x) dx

where both densities are Gaussian: A's prediction from its end, and B's own smoothed beginning.

A detector that fires twice on one target may begin its second track before the first has ended: T
is then the time for which both overlap, and p_S = 1. Trajectories are joined so that the sum over
all pairs is maximal, with at most one successor each. Then they are smoothed again, because a short
track between two others is known better once it is joined, and so on until nothing changes.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from phdtrack.kernels.association import best_pairs
from phdtrack.models.returns import (
    EXCHANGED,
    RETURN,
    Rates,
    among,
    log_odds,
    twin_chance,
    twins_among,
)
from phdtrack.models.rts import predict
from phdtrack.smooth.looks import SequenceLooks
from phdtrack.smooth.paths import Paths, joined
from phdtrack.smooth.sequence import Sequence, Smoothed
from phdtrack.types import F4, F8, I8, Bool, MeasurementHistory

# Tracks whose beginnings are compared with all ends at a time.
_BLOCK = 256
# Seconds for which paths of two targets are there together, at least, and the rounds in which it is
# learned how many of these look alike.
_TOGETHER = 4.0
_ROUNDS = 10


class Stitching(NamedTuple):
    """The parameters of stitching, in time units of the model.

    Attributes
    ----------
    occluded : mean time for which a lost target is out of sight.
    max_gap : time between tracks that are joined, at most.
    max_overlap : time for which two tracks of one target may overlap, at most.
    reentry : probability that a track that ends was lost and comes back.
    """

    occluded: float
    max_gap: float
    max_overlap: float
    reentry: float


class _Pairs(NamedTuple):
    """P pairs of paths that may be of one target.

    Attributes
    ----------
    before, after : (P,) the earlier and the later path.
    mean, covariance : (P, d), (P, d, d) the state by the earlier path at the time of comparison.
    row : (P,) the row of the later path at this time.
    odds : (P,) the terms of the log-odds that do not depend on the states.
    """

    before: I8
    after: I8
    mean: F8
    covariance: F8
    row: I8
    odds: F8


def stitched(
    paths: Paths, sequence: Sequence, settings: Stitching, whole: I8
) -> tuple[Paths, Smoothed]:
    """Join the paths of one target, and smooth the states of all rows.

    Parameters
    ----------
    paths : the trajectories.
    sequence : their measurements.
    settings : the parameters of stitching.
    whole : (Z,) the track that had each measurement before tracks were parted, −1 for none.
    """
    states = sequence.smooth(paths)
    while len(paths) > 1:
        after = best_successors(*candidates(paths, states, sequence, settings, whole), len(paths))
        if (after < 0).all():
            break
        chain = _chains(after)
        longer = joined(paths, chain)
        # Smooth only the paths that have changed.
        is_joined = np.bincount(chain) > 1
        changed = is_joined[longer.path]
        kept = ~is_joined[chain[paths.path]]
        new = sequence.smooth(longer.select(is_joined))
        mean = np.empty((len(changed), *new.mean.shape[1:]))
        cov = np.empty((len(changed), *new.covariance.shape[1:]))
        mean[changed] = new.mean
        cov[changed] = new.covariance
        mean[~changed] = states.mean[kept]
        cov[~changed] = states.covariance[kept]
        paths = longer
        states = Smoothed(mean, cov)
    return paths, states


def candidates(
    paths: Paths,
    states: Smoothed,
    sequence: Sequence,
    settings: Stitching,
    whole: I8,
) -> tuple[I8, I8, F8]:
    """All pairs that may be of one target: path ``after`` (P,) continues ``before`` (P,) with these
    log-odds (P,).

    One begins within ``max_gap`` after the other's end, while the target may still exist; or they
    overlap (`_overlaps`).

    Parameters
    ----------
    paths, states : the trajectories, and the states of their rows.
    sequence : their measurements.
    settings, whole : as of `stitched`.
    """
    births = _births(paths, sequence)
    new_target = math.log(births * settings.occluded * (1 - settings.reentry) / settings.reentry)
    before = list[I8]()
    after = list[I8]()
    log_odds = list[F8]()
    ends = _ends(paths, sequence)
    overlaps = _overlaps(paths, states, sequence, settings)
    # Lazily, because the states of all pairs would take much memory.
    for pairs in itertools.chain([overlaps], _returns(paths, states, sequence, settings)):
        odds = _log_evidence(paths, states, sequence, pairs) + (pairs.odds - new_target)
        before.append(pairs.before)
        after.append(pairs.after)
        if ends is not None:
            odds = np.where(_parted(paths, pairs, whole), np.minimum(odds, -EXCHANGED), odds)
            odds = odds + ends.likeness(pairs.before, pairs.after)
        log_odds.append(odds)
    return np.concatenate(before), np.concatenate(after), np.concatenate(log_odds)


def _parted(paths: Paths, pairs: _Pairs, whole: I8) -> Bool:
    """(P,) True for pairs of which both were one track before it was parted.

    Who it was that went on where others hid it, motion cannot tell: it looks as if one had gone on
    whether it was the same one or not. So motion says no more for it than the prior.
    """
    before = whole[paths.measurement[paths.last[pairs.before]]]
    found: Bool = (before >= 0) & (before == whole[paths.measurement[paths.first[pairs.after]]])
    return found


class _Ends(NamedTuple):
    """The looks of paths at their ends.

    ``mean`` (2K, D), ``number``, ``seconds`` (2K,): of the last seconds of each, then of the first
    ones; of how many independent descriptors these are, and for how long.
    """

    mean: F4
    number: F8
    seconds: F8
    looks: SequenceLooks

    def likeness(self, before: I8, after: I8) -> F8:
        """(P,) log p(s | one object)/p(s | two) of ends of paths and beginnings of others."""
        second = len(self.number) // 2 + after
        return self.looks.likeness(self.mean, self.number, self.seconds, before, second)


def _ends(paths: Paths, sequence: Sequence) -> _Ends | None:
    """The looks of paths at their ends; None where these are not known."""
    known = sequence.looks
    if known is None:
        return None
    seen = np.flatnonzero(paths.measurement >= 0)
    column = paths.measurement[seen]
    seconds = sequence.measurements.seconds(sequence.rate)
    time = seconds[paths.frame[seen]]
    path = paths.path[seen]
    first = seconds[paths.frame[paths.first]]
    last = seconds[paths.frame[paths.last]]
    count = np.zeros(2 * len(paths))
    spans = np.zeros(2 * len(paths))
    mean = np.zeros((2 * len(paths), known.unit.shape[1]), np.float32)
    for place, apart in enumerate((last[path] - time, time - first[path])):
        weight = known.weight[column] * (apart <= known.frame.memory)
        at = path + place * len(paths)
        np.add.at(mean, at, known.unit[column] * weight[:, None].astype(np.float32))
        np.add.at(count, at, weight)
        np.maximum.at(spans, at, apart * (weight > 0))
    mean /= np.maximum(count, 1e-9)[:, None].astype(np.float32)
    return _Ends(mean, known.independent(count), spans, known)


def returns(paths: Paths, sequence: Sequence) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Pairs of paths of one target that came back, by the frame and `Detections.row` of the last
    detection before and of the first one after (`models.returns`); none where it is not known what
    they look like.
    """
    ends = _ends(paths, sequence)
    if ends is None or len(paths) < 2:
        return []
    measurements = sequence.measurements
    time = measurements.seconds(sequence.rate)
    first = paths.measurement[paths.first]
    last = paths.measurement[paths.last]
    begin = time[paths.frame[paths.first]]
    end = time[paths.frame[paths.last]]
    boxes = sequence.boxes
    extent = boxes[paths.measurement[paths.measurement >= 0]]
    size = extent[:, 2:].max(axis=0) - extent[:, :2].min(axis=0)
    area = max(float(size.prod()), 1.0)
    rates = Rates(len(paths) / max(float(time[-1] - time[0]), 1.0), RETURN)
    # What looks like nothing in particular is left to the motion.
    law = ends.looks.frame.law
    ended = (ends.number[: len(paths)] > 0) & (law.means_weight > 0)
    twin = _twin_chance(ends, begin, end)
    good = list[tuple[I8, I8, F8]]()
    began = np.flatnonzero(ends.number[len(paths) :] > 0)
    # In blocks, as all pairs of thousands of tracks would take much memory.
    for block in (began[k : k + _BLOCK] for k in range(0, len(began), _BLOCK)):
        gap = begin[block] - end[:, None]
        before, column = np.nonzero(ended[:, None] & (gap > 0) & (gap <= law.within))
        after = block[column]
        gaps = gap[before, column]
        odds = log_odds(gaps, boxes[last[before]], boxes[first[after]], rates, area)
        odds += among(ends.likeness(before, after), twin)
        kept = odds > 0
        good.append((before[kept], after[kept], odds[kept]))
    if not good:
        return []
    successor = best_successors(
        np.concatenate([each[0] for each in good]),
        np.concatenate([each[1] for each in good]),
        np.concatenate([each[2] for each in good]),
        len(paths),
    )
    return [
        (_name(measurements, last[k]), _name(measurements, first[successor[k]]))
        for k in np.flatnonzero(successor >= 0).tolist()
    ]


def _twin_chance(ends: _Ends, begin: F8, end: F8) -> float:
    """The probability that another target looks like a given one, by the paths that were there
    together [APP (5)]; ``begin``, ``end`` (K,): their seconds.
    """
    ratios = list[F8]()
    for block in (slice(k, k + _BLOCK) for k in range(0, len(begin), _BLOCK)):
        common = np.minimum(end[:, None], end[block]) - np.maximum(begin[:, None], begin[block])
        before, column = np.nonzero(common > _TOGETHER)
        after = block.start + column
        once = before < after
        ratios.append(ends.likeness(before[once], after[once]))
    ratio = np.concatenate(ratios)
    found = 0.0
    for _ in range(_ROUNDS):
        twin = twin_chance(found, len(ratio) / len(begin), len(begin))
        found = twins_among(ratio, twin)
    return twin


def _name(measurements: MeasurementHistory, column: int) -> tuple[int, int]:
    """The frame and the row of a measurement."""
    frame = int(np.searchsorted(measurements.start, column, side="right")) - 1
    return int(measurements.number[frame]), int(measurements.row[column])


def _returns(
    paths: Paths, states: Smoothed, sequence: Sequence, settings: Stitching
) -> Iterator[_Pairs]:
    """Yield pairs of which one begins after the other's end; paths that have ended are predicted
    through the frames together.
    """
    time = sequence.measurements.time
    end = paths.frame[paths.last]
    last = paths.last
    begin = paths.frame[paths.first]
    # The last frame in which another path begins that may continue each.
    beginnings = np.unique(begin)
    latest = time[end] + settings.max_gap + 1e-9
    until = beginnings[np.searchsorted(time[beginnings], latest, side="right") - 1]
    lost = np.zeros(0, np.int64)
    log_survival = np.zeros(0)
    mean = states.mean[:0]
    cov = states.covariance[:0]
    after_ends = {*(end + 1).tolist()}
    for p in range(1, len(time)):
        if len(lost) == 0 and p not in after_ends:
            continue
        newly_lost = np.flatnonzero((end == p - 1) & (until >= p))
        lost = np.concatenate((lost, newly_lost))
        log_survival = np.concatenate((log_survival, np.zeros(len(newly_lost))))
        mean = np.concatenate((mean, states.mean[last[newly_lost]]))
        cov = np.concatenate((cov, states.covariance[last[newly_lost]]))
        if len(lost) == 0:
            continue
        interval, warp = sequence.step(p)
        predicted = predict(sequence.motion, mean, cov, interval, warp)
        survival = sequence.motion.p_survive(
            np.ascontiguousarray(predicted.mean.T), interval / sequence.rate
        )
        stay = (survival > 0) & (until[lost] >= p)
        lost = lost[stay]
        log_survival = log_survival[stay] + np.log(survival[stay])
        mean = predicted.mean[stay]
        cov = predicted.covariance[stay]
        new = np.flatnonzero(begin == p)
        if len(new) and len(lost):
            a = np.repeat(np.arange(len(lost)), len(new))
            b = np.tile(new, len(lost))
            odds = log_survival[a] - (time[p] - time[end[lost[a]]]) / settings.occluded
            yield _Pairs(lost[a], b, mean[a], cov[a], paths.first[b], odds)


def _overlaps(paths: Paths, states: Smoothed, sequence: Sequence, settings: Stitching) -> _Pairs:
    """Pairs of which one begins before the other ends, by at most ``max_overlap``, and ends later.

    They are compared in the middle of their common time, where both are known best.
    """
    begin = paths.frame[paths.first]
    end = paths.frame[paths.last]
    time = sequence.measurements.time
    order = np.argsort(end, kind="stable")
    latest = np.searchsorted(time, time[begin] + settings.max_overlap + 1e-9, side="right")
    low = np.searchsorted(end[order], begin)
    high = np.searchsorted(end[order], np.minimum(latest, end))
    count = np.maximum(high - low, 0)
    b = np.repeat(np.arange(len(paths)), count)
    a = order[
        np.repeat(low, count) + np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    ]
    earlier = begin[a] < begin[b]
    a = a[earlier]
    b = b[earlier]
    middle = (begin[b] + end[a] + 1) // 2
    here = paths.first[a] + middle - begin[a]
    row = paths.first[b] + middle - begin[b]
    odds = -(time[end[a]] - time[begin[b]]) / settings.occluded
    return _Pairs(a, b, states.mean[here], states.covariance[here], row, odds)


def _log_evidence(paths: Paths, states: Smoothed, sequence: Sequence, pairs: _Pairs) -> F8:
    """(P,) log p(B|A)/p(B), with all Gaussians in information form; the prior is flat in observed
    rows.
    """
    _, jacobian, _ = sequence.motion.transition(np.ascontiguousarray(sequence.state[:, :1]), 1.0)
    # Components that a transition forgets, such as a constant size, carry no evidence.
    kept = np.flatnonzero(jacobian[0].any(axis=0))
    unobserved = np.setdiff1d(kept, sequence.observed)
    at = np.searchsorted(kept, unobserved)
    column = paths.measurement[paths.first[pairs.after]]
    earlier = np.linalg.inv(pairs.covariance[:, kept[:, None], kept])
    later = np.linalg.inv(states.covariance[pairs.row][:, kept[:, None], kept])
    block = np.linalg.inv(sequence.covariance[column][:, unobserved[:, None], unobserved])
    mean = pairs.mean[:, kept]
    prior = np.zeros_like(earlier)
    prior[:, at[:, None], at] = block
    prior_mean = np.zeros((len(column), len(kept)))
    prior_mean[:, at] = sequence.state[unobserved[:, None], column].T
    total = earlier + later - prior
    # Relative to the earlier mean, to avoid cancellation of large numbers.
    to_later = (states.mean[pairs.row][:, kept] - mean)[:, :, None]
    to_prior = (prior_mean - mean)[:, :, None]
    pull = later @ to_later - prior @ to_prior
    square = to_later.transpose(0, 2, 1) @ later @ to_later
    square = square - to_prior.transpose(0, 2, 1) @ prior @ to_prior
    square -= pull.transpose(0, 2, 1) @ np.linalg.solve(total, pull)
    log_determinants = (
        np.linalg.slogdet(earlier)[1]
        + np.linalg.slogdet(later)[1]
        - np.linalg.slogdet(block)[1]
        - np.linalg.slogdet(total)[1]
    )
    constant = (len(kept) - len(unobserved)) * math.log(2 * math.pi)
    out: F8 = 0.5 * (log_determinants - square[:, 0, 0] - constant)
    return out


def _births(paths: Paths, sequence: Sequence) -> float:
    """Trajectories that begin per time unit and unit of measurement volume, in the volume spanned
    by all measurements.
    """
    time = sequence.measurements.time
    observed = sequence.observed
    column = paths.measurement[paths.measurement >= 0]
    z = sequence.state[observed[:, None], column]
    noise = np.sqrt(np.median(sequence.covariance[column][:, observed, observed], axis=0))
    # If all measurements coincide, their noise determines the volume.
    volume = np.prod(z.max(axis=1) - z.min(axis=1) + 4 * noise)
    return float(len(paths) / (volume * (time[-1] - time[0])))


def best_successors(before: I8, after: I8, odds: F8, count: int) -> I8:
    """(K,) the successor of each path, −1 for none, so that the sum of the log-odds is maximal.

    Parameters
    ----------
    before, after, odds : from `candidates`.
    count : number of paths.
    """
    good = np.flatnonzero(odds > 0)
    good = good[np.argsort(before[good], kind="stable")]
    successor: I8 = best_pairs(before[good], after[good], odds[good], count)
    return successor


def _chains(after: I8) -> I8:
    """(K,) the chain of each path, numbered by first paths; ``after`` (K,) is its successor, −1 for
    none.
    """
    follows = np.isin(np.arange(len(after)), after)
    chain = np.full(len(after), -1, np.int64)
    for number, head in enumerate(np.flatnonzero(~follows).tolist()):
        here = head
        while here >= 0:
            chain[here] = number
            here = int(after[here])
    return chain
