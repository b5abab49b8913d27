"""Corrected tracks when all is known: pieces of one target are joined, and every row becomes the
state given all measurements of its track, before and after.

The evidence of one target that was lost and found again is compared with that of two. A target that
is lost re-enters with probability ``reentry``, after a time of exponential distribution, mean
``occluded``. A trajectory that begins may be a new target: new ones come at the rate at which
trajectories begin in this very stream, anywhere among its measurements. The log-odds of a pair of
trajectories, T apart, are

    log p(B|A)/p(B) + log p_S(T) + log reentry/(1 − reentry) + log (1/occluded) e^(−T/occluded) −
    log births

with births per time unit and unit of measurement volume. With A, B the measurements of two
trajectories, a and b the states at B's beginning, and π the prior of a state (flat over what
measurements show, a Gaussian over the rest, as velocities),

    p(B|A)/p(B) = ∫ p(x|A) p(x|B)/π(x) dx

with both densities Gaussian: A's prediction from its end, and B's own smoothed beginning.

A detector that fires twice on one target may begin its second track before the first has ended: T
is then the time for which both overlap, and p_S = 1. Trajectories are joined so that the sum over
all pairs is the largest, each with one successor at most. Then they are smoothed anew, because a
short piece between two others says more once it is joined, and so on until nothing changes. All
trajectories go through the frames together, so that the motion is asked once a frame
(`models.rts`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from phdtrack.errors import InputError, NonNegative, Positive, Share, check
from phdtrack.kernels.association import best_pairs
from phdtrack.kernels.rts import filtered, smooth
from phdtrack.models.rts import Ahead, moved, predict
from phdtrack.protocols import Model, Motion
from phdtrack.smooth.ends import carried_on
from phdtrack.smooth.paths import Paths, joined, paths_of
from phdtrack.types import F8, I8, STILL, Bool, MeasurementHistory, Tracks

# A path's noises are these multiples of the model's deviations: its acceleration, the change of its
# size, its measurements.
ACCELERATION = (1.0, 3.0, 9.0)
SIZE_CHANGE = (0.25, 0.5, 1.0)
BLUR = (0.4, 0.65, 1.0)
# A side this near to the border of the picture, in widths or heights of the box, is cut by it.
_CUT = 0.1


@dataclass(frozen=True, slots=True)
class Smoothing:
    """Smoothing and stitching of corrected tracks, and what boxes of online rows are.

    Parameters
    ----------
    stitching : join tracks of one target that was lost and found again.
    smoothing : replace the boxes of rows by the smoothed ones.
    noise_by_track : smooth each track with the noises under which its own measurements are most
        probable.
    mean_occluded_time : seconds for which a lost target is out of sight on average.
    max_gap : seconds between tracks that are joined, at most.
    max_overlap_time : seconds for which two tracks of one target may overlap, at most.
    reentry_probability : that a track that ends was lost and comes back.
    detection_share : boxes of online rows lie between the filter's and the detection's, see
        `smooth.online`.
    min_extent : tracks are left out that move by less than this in all their life, in widths or
        heights of a box; 0: none. What a background detector sees there sways or flickers.
    max_gap_uncertainty : fill the gap between joined tracks where positions are known to within
        this many deviations of a measurement. 0: such gaps stay open.
    max_continuation : seconds for which a track is carried on before its first row and after its
        last by detections that no track uses, at most; 0: never.
    frame_size : width and height of the picture, pixels: what it cuts of a box is not expected to
        be detected.
    """

    stitching: bool = True
    smoothing: bool = True
    noise_by_track: bool = False
    detection_share: bool = False
    mean_occluded_time: Positive = 2.0
    max_gap: NonNegative = 6.0
    max_overlap_time: NonNegative = 4.0
    reentry_probability: Share = 0.5
    max_gap_uncertainty: NonNegative = 1.0
    min_extent: NonNegative = 0.0
    max_continuation: NonNegative = 0.0
    frame_size: tuple[float, float] = (math.inf, math.inf)

    def __post_init__(self) -> None:
        check(self)
        if self.reentry_probability == 1:
            where = "Smoothing.reentry_probability"
            raise InputError(
                "expected a probability below 1, as some tracks end for good", where=where
            )

    def smooth(self, tracks: Tracks, measurements: MeasurementHistory, model: Model) -> Tracks:
        """The tracks joined and smoothed."""
        if self.stitching or self.smoothing:
            paths = paths_of(tracks, measurements)
        else:
            paths = None
        if paths is None or len(paths) == 0:
            return _going(tracks, self.min_extent, self.frame_size)
        sequence = Sequence.of(measurements, model)
        paths, states = (
            _stitched(paths, sequence, self) if self.stitching else (paths, sequence.smooth(paths))
        )
        if self.noise_by_track:
            states = sequence.smooth(paths, sequence.fitting(paths))
        out = _rows(tracks, paths, states, measurements, model, self)
        if self.max_continuation > 0:
            boxes = model.sensor.boxes(sequence.state)
            out = _numbered(
                carried_on(
                    out, measurements, boxes, self.frame_size, self.max_continuation * model.rate
                )
            )
        return _going(out, self.min_extent, self.frame_size)


def _going(tracks: Tracks, extent: float, size: tuple[float, float]) -> Tracks:
    """The tracks that get so far, in widths or heights of their median box: their centre, or the
    side that is seen where the other is cut by the border of the picture."""
    if extent == 0 or not len(tracks):
        return tracks
    kept = np.zeros(len(tracks), np.bool_)
    order = np.argsort(tracks.identity, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(tracks.identity[order])) + 1):
        low = tracks.xyxy[rows, :2]
        high = tracks.xyxy[rows, 2:]
        box = np.median(high - low, axis=0)
        way = np.ptp((low + high) / 2, axis=0)
        way = np.where(
            np.median(low, axis=0) <= _CUT * box, np.maximum(way, np.ptp(high, axis=0)), way
        )
        way = np.where(
            np.median(high, axis=0) >= size - _CUT * box, np.maximum(way, np.ptp(low, axis=0)), way
        )
        kept[rows] = (way >= extent * box).any()
    if kept.all():
        return tracks
    return _numbered(tracks.select(kept))


def _rows(
    tracks: Tracks,
    paths: Paths,
    states: Smoothed,
    measurements: MeasurementHistory,
    model: Model,
    wanted: Smoothing,
) -> Tracks:
    """The tracks with the rows of their paths as wanted, and those gaps between joined ones filled
    that are.
    """
    x = np.ascontiguousarray(states.mean.T)
    given = paths.row >= 0
    name = _names(tracks, paths)
    boxes = model.sensor.boxes(x)
    xyxy = tracks.xyxy.copy()
    if wanted.smoothing:
        xyxy[paths.row[given]] = boxes[given]
    # The nearest rows before and after each that come from a track; itself where it does.
    here = np.arange(len(given))
    before = np.maximum.accumulate(np.where(given, here, -1))
    after = np.minimum.accumulate(np.where(given, here, len(here))[::-1])[::-1]
    # Gaps inside one track were filled, or left open, by the associator.
    between = tracks.identity[paths.row[before]] != tracks.identity[paths.row[after]]
    variance = np.stack([states.covariance[:, 0, 0], states.covariance[:, 1, 1]])
    uncertain = np.sqrt((variance / model.sensor.noise(x)[:2] ** 2).max(axis=0))
    count = np.concatenate(([0], np.cumsum(uncertain > wanted.max_gap_uncertainty)))
    gap = np.flatnonzero((count[after] == count[before + 1]) & between)
    ends = paths.row[np.stack([before, after])[:, gap]]
    sure = tracks.confidence[ends].min(axis=0)
    numbers = measurements.number[paths.frame[gap]]
    filled = Tracks.of(numbers, name[ends[0]], boxes[gap], sure, -1)
    same = replace(tracks, identity=name, xyxy=xyxy)
    return _numbered(
        Tracks.concatenate([same.select(~_doubled(tracks, paths, measurements, name)), filled])
    )


def _names(tracks: Tracks, paths: Paths) -> I8:
    """(T,) the identity of each row: of joined tracks that of the first."""
    given = np.flatnonzero(paths.row >= 0)
    old, place = np.unique(tracks.identity, return_inverse=True)
    first = old.copy()
    first[place[paths.row[given]]] = tracks.identity[paths.row[paths.first[paths.path[given]]]]
    return first[place]


def _numbered(tracks: Tracks) -> Tracks:
    """The tracks with identities from 1 in order of appearance."""
    names, first, place = np.unique(tracks.identity, return_index=True, return_inverse=True)
    rank = np.empty(len(names), np.int64)
    rank[np.argsort(first)] = np.arange(1, len(names) + 1)
    return Tracks.concatenate([replace(tracks, identity=rank[place])])


def _doubled(tracks: Tracks, paths: Paths, measurements: MeasurementHistory, name: I8) -> Bool:
    """(T,) the predicted rows outside their track's measurements that a joined track has twice.

    The other is a row of its path, or one like it: two tracks that are joined may both go on with a
    shared detection.
    """
    outside = np.ones(len(tracks), np.bool_)
    outside[paths.row[paths.row >= 0]] = False
    identity = name[paths.row[paths.first]]
    order = np.argsort(identity)
    path = order[np.minimum(np.searchsorted(identity[order], name), len(order) - 1)]
    begin = measurements.number[paths.frame[paths.first]][path]
    end = measurements.number[paths.frame[paths.last]][path]
    within: Bool = (identity[path] == name) & (tracks.frame >= begin) & (tracks.frame <= end)
    _, first = np.unique(np.stack([name, tracks.frame]), axis=1, return_index=True)
    again = np.ones(len(tracks), np.bool_)
    again[first] = False
    return outside & (within | again)


class Smoothed(NamedTuple):
    """Of each row the state given all of its path's measurements: ``mean`` (M, d) and
    ``covariance`` (M, d, d).
    """

    mean: F8
    covariance: F8


class Scales(NamedTuple):
    """How many times the model's the deviations of a path's noises are: (K, d) of its states, (K,
    r) of measurements.
    """

    state: F8
    measurement: F8


class _Filtered(NamedTuple):
    """States of all rows given what was measured up to each, their predictions, and the evidence
    (2, K) of the paths.
    """

    mean: F8
    covariance: F8
    ahead: Ahead
    evidence: F8


@dataclass(frozen=True, slots=True, eq=False)
class Sequence:
    """What is known of a whole sequence: its Z measurements, the same as states, the motion and its
    time units a second.

    ``state`` (d, Z), ``covariance`` (Z, d, d), of which a measurement shows the rows ``observed``.
    Rows that no measurement shows, as a velocity, have their prior mean and covariance.
    """

    measurements: MeasurementHistory
    state: F8
    covariance: F8
    observed: I8
    motion: Motion
    rate: float

    @classmethod
    def of(cls, measurements: MeasurementHistory, model: Model) -> Sequence:
        """The sequence of these measurements."""
        states = model.sensor.states(measurements.z)
        shown = np.array(model.sensor.observed, np.int64)
        return cls(measurements, *states, shown, model.motion, model.rate)

    def _step(self, place: int) -> tuple[float, F8]:
        """The interval before a frame, and the camera's motion in it."""
        time = self.measurements.time
        warp = self.measurements.warp
        return float(time[place] - time[place - 1]), warp[place] if len(warp) else STILL

    def smooth(self, paths: Paths, scales: Scales | None = None) -> Smoothed:
        """The states of all rows of the paths, given their measurements [R65]."""
        passed = self._filtered(paths, scales or self._scales(np.ones((4, len(paths)))))
        mean = passed.mean
        cov = passed.covariance
        onward = paths.path[1:] == paths.path[:-1]
        smooth(
            (mean[:-1], cov[:-1]),
            tuple(part[1:] for part in passed.ahead),
            (mean[1:], cov[1:]),
            onward,
        )
        return Smoothed(mean, cov)

    def fitting(self, paths: Paths) -> Scales:
        """The noises with which the measurements of each path are most probable.

        What drives a target and what blurs its position are chosen by the innovations of the first
        two components of its measurements, those of its size by the others: they hardly say
        anything of each other.
        """
        moved, resized = (
            np.array(list(itertools.product(drive, BLUR))).T
            for drive in (ACCELERATION, SIZE_CHANGE)
        )
        tried = moved.shape[1]
        count = len(paths)
        all_of = np.repeat(np.stack([moved[0], resized[0], moved[1], resized[1]]), count, axis=1)
        evidence = self._filtered(paths.repeated(tried), self._scales(all_of), brief=True).evidence
        position, size = evidence.reshape(2, tried, count).argmax(axis=1)
        return self._scales(
            np.stack([moved[0, position], resized[0, size], moved[1, position], resized[1, size]])
        )

    def _scales(self, factors: F8) -> Scales:
        """From the factors (4, K) of acceleration, changes of size, position noise and size
        noise.
        """
        d = len(self.state)
        r = len(self.observed)
        # In one order, whether there is one path or more: a kernel is compiled for each order that
        # it meets.
        of_states = factors[:2].T
        of_sizes = factors[2:].T
        return Scales(
            np.repeat(of_states, [4, d - 4], axis=1), np.repeat(of_sizes, [2, r - 2], axis=1)
        )

    def _filtered(self, paths: Paths, scales: Scales, *, brief: bool = False) -> _Filtered:
        """The states of all rows of the paths, given the measurements up to each; if ``brief`` only
        the last ones.
        """
        shown = self.observed
        d = len(self.state)
        path = paths.path
        column = paths.measurement[paths.first]
        here, size = (path, len(paths)) if brief else (np.arange(len(path)), len(path))
        mean = np.empty((size, d))
        cov = np.empty((size, d, d))
        evidence = np.zeros((2, len(paths)))
        first = self.covariance[column]
        first[:, shown[:, None], shown] *= (
            scales.measurement[:, :, None] * scales.measurement[:, None]
        )
        mean[here[paths.first]] = self.state[:, column].T
        cov[here[paths.first]] = first
        kept = Ahead(np.empty((size * (not brief), d)), *np.empty((3, size * (not brief), d, d)))
        rows = np.flatnonzero(path[1:] == path[:-1]) + 1
        rows = rows[np.argsort(paths.frame[rows], kind="stable")]
        at = np.stack([here[rows - 1], here[rows], path[rows], paths.measurement[rows]], axis=1)
        bounds = np.searchsorted(paths.frame[rows], np.arange(len(self.measurements.time) + 1))
        seen = *map(np.ascontiguousarray, (self.state, self.covariance)), shown
        for p in np.flatnonzero(np.diff(bounds)).tolist():
            now = at[bounds[p] : bounds[p + 1]]
            filtered(
                now,
                (mean, cov),
                moved(self.motion, mean[now[:, 0]], *self._step(p)),
                kept,
                seen,
                scales,
                evidence,
            )
        return _Filtered(mean, cov, kept, evidence)


class _Meeting(NamedTuple):
    """Paths of which ``after`` may continue ``before``, (P,) each, and where they are compared.

    ``mean`` (P, d), ``covariance`` (P, d, d): the state by the first; ``row`` (P,): that of the
    second. ``odds`` (P,): the terms of the log-odds that do not depend on it.
    """

    before: I8
    after: I8
    mean: F8
    covariance: F8
    row: I8
    odds: F8


def _stitched(paths: Paths, sequence: Sequence, settings: Smoothing) -> tuple[Paths, Smoothed]:
    """The paths, those of one target joined, and the states of their rows."""
    states = sequence.smooth(paths)
    while len(paths) > 1:
        after = _matched(*_candidates(paths, states, sequence, settings), len(paths))
        if (after < 0).all():
            break
        chain = _chains(after)
        longer = joined(paths, chain)
        # Only the paths that have changed are smoothed anew.
        fresh = np.bincount(chain) > 1
        changed = fresh[longer.path]
        kept = ~fresh[chain[paths.path]]
        new = sequence.smooth(longer.select(fresh))
        mean, cov = (np.empty((len(changed), *part.shape[1:])) for part in new)
        mean[changed], cov[changed] = new
        mean[~changed] = states.mean[kept]
        cov[~changed] = states.covariance[kept]
        paths = longer
        states = Smoothed(mean, cov)
    return paths, states


def _candidates(
    paths: Paths, states: Smoothed, sequence: Sequence, settings: Smoothing
) -> tuple[I8, I8, F8]:
    """All pairs that could be of one target: path ``after`` (P,) continues ``before`` (P,) with
    these log-odds (P,).

    One begins within ``max_gap`` after the other's end, while it may still be there; or they
    overlap (`_overlaps`).
    """
    reentry = settings.reentry_probability
    occluded = settings.mean_occluded_time * sequence.rate
    loose = math.log(_births(paths, sequence) * occluded * (1 - reentry) / reentry)
    found = list[tuple[I8, I8, F8]]()
    for some in itertools.chain(
        [_overlaps(paths, states, sequence, settings)], _returns(paths, states, sequence, settings)
    ):
        odds = _log_evidence(paths, states, sequence, some) + (some.odds - loose)
        found.append((some.before, some.after, odds))
    before, after, log_odds = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return before, after, log_odds


def _returns(
    paths: Paths, states: Smoothed, sequence: Sequence, settings: Smoothing
) -> Iterator[_Meeting]:
    """Pairs of which one begins after the other's end; those that have ended are carried on through
    the frames together.
    """
    time = sequence.measurements.time
    end = paths.frame[paths.last]
    last = paths.last
    begin = paths.frame[paths.first]
    # The last frame in which a path begins that each may go on in.
    beginning = np.unique(begin)
    latest = time[end] + settings.max_gap * sequence.rate + 1e-9
    until = beginning[np.searchsorted(time[beginning], latest, side="right") - 1]
    lost = np.zeros(0, np.int64)
    alive = np.zeros(0)
    mean = states.mean[:0]
    cov = states.covariance[:0]
    ending = {*(end + 1).tolist()}
    for p in range(1, len(time)):
        if len(lost) == 0 and p not in ending:
            continue
        fresh = np.flatnonzero((end == p - 1) & (until >= p))
        lost = np.concatenate((lost, fresh))
        alive = np.concatenate((alive, np.zeros(len(fresh))))
        mean, cov = (
            np.concatenate((a, b[last[fresh]]))
            for a, b in ((mean, states.mean), (cov, states.covariance))
        )
        if len(lost) == 0:
            continue
        now = predict(sequence.motion, mean, cov, *sequence._step(p))
        survive = sequence.motion.p_survive(
            np.ascontiguousarray(now.mean.T), float(time[p] - time[p - 1]) / sequence.rate
        )
        stay = (survive > 0) & (until[lost] >= p)
        lost = lost[stay]
        alive = alive[stay] + np.log(survive[stay])
        mean = now.mean[stay]
        cov = now.covariance[stay]
        come = np.flatnonzero(begin == p)
        if len(come) and len(lost):
            a = np.repeat(np.arange(len(lost)), len(come))
            b = np.tile(come, len(lost))
            odds = alive[a] - (time[p] - time[end[lost[a]]]) / (
                settings.mean_occluded_time * sequence.rate
            )
            yield _Meeting(lost[a], b, mean[a], cov[a], paths.first[b], odds)


def _overlaps(paths: Paths, states: Smoothed, sequence: Sequence, settings: Smoothing) -> _Meeting:
    """Pairs of which one begins before the other ends, by ``max_overlap_time`` at most, and ends
    later.

    They are compared in the middle of the time that they share, where both are known best.
    """
    begin = paths.frame[paths.first]
    end = paths.frame[paths.last]
    time = sequence.measurements.time
    order = np.argsort(end, kind="stable")
    latest = np.searchsorted(
        time, time[begin] + settings.max_overlap_time * sequence.rate + 1e-9, side="right"
    )
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
    odds = -(time[end[a]] - time[begin[b]]) / (settings.mean_occluded_time * sequence.rate)
    return _Meeting(a, b, states.mean[here], states.covariance[here], row, odds)


def _log_evidence(paths: Paths, states: Smoothed, sequence: Sequence, pairs: _Meeting) -> F8:
    """(P,) log p(B|A)/p(B), with all Gaussians in information form; the prior is flat in observed
    rows.
    """
    _, jacobian, _ = sequence.motion.transition(np.ascontiguousarray(sequence.state[:, :1]), 1.0)
    # Not a size that a transition forgets.
    kept = np.flatnonzero(jacobian[0].any(axis=0))
    unseen = np.setdiff1d(kept, sequence.observed)
    at = np.searchsorted(kept, unseen)
    column = paths.measurement[paths.first[pairs.after]]
    inverse, later = (
        np.linalg.inv(c[:, kept[:, None], kept])
        for c in (pairs.covariance, states.covariance[pairs.row])
    )
    block = np.linalg.inv(sequence.covariance[column][:, unseen[:, None], unseen])
    mean = pairs.mean[:, kept]
    prior = np.zeros_like(inverse)
    centre = np.zeros((len(column), len(kept)))
    prior[:, at[:, None], at] = block
    centre[:, at] = sequence.state[unseen[:, None], column].T
    total = inverse + later - prior
    # From the prediction, so that no large numbers are taken from each other.
    step = (states.mean[pairs.row][:, kept] - mean)[:, :, None]
    rest = (centre - mean)[:, :, None]
    pull = later @ step - prior @ rest
    square = step.transpose(0, 2, 1) @ later @ step - rest.transpose(0, 2, 1) @ prior @ rest
    square -= pull.transpose(0, 2, 1) @ np.linalg.solve(total, pull)
    first, second, third, last = (np.linalg.slogdet(a)[1] for a in (inverse, later, block, total))
    out: F8 = 0.5 * (
        first
        + second
        - third
        - last
        - square[:, 0, 0]
        - (len(kept) - len(unseen)) * math.log(2 * math.pi)
    )
    return out


def _births(paths: Paths, sequence: Sequence) -> float:
    """How many trajectories begin per time unit and unit of measurement volume, in the volume that
    all measurements span.
    """
    time = sequence.measurements.time
    shown = sequence.observed
    column = paths.measurement[paths.measurement >= 0]
    z = sequence.state[shown[:, None], column]
    noise = np.sqrt(np.median(sequence.covariance[column][:, shown, shown], axis=0))
    # Where all is one place, it is as large as measurements are fine.
    volume = np.prod(z.max(axis=1) - z.min(axis=1) + 4 * noise)
    return float(len(paths) / (volume * (time[-1] - time[0])))


def _matched(before: I8, after: I8, odds: F8, count: int) -> I8:
    """(K,) the successor of each of ``count`` paths, −1 for none, so that the sum of the log-odds
    is the largest.
    """
    good = np.flatnonzero(odds > 0)
    good = good[np.argsort(before[good], kind="stable")]
    successor: I8 = best_pairs(before[good], after[good], odds[good], count)
    return successor


def _chains(after: I8) -> I8:
    """(K,) the number of the chain of each path, from its successor ``after`` (K,), −1 for none, by
    their first paths.
    """
    follows = np.isin(np.arange(len(after)), after)
    chain = np.full(len(after), -1, np.int64)
    for number, head in enumerate(np.flatnonzero(~follows).tolist()):
        here = head
        while here >= 0:
            chain[here] = number
            here = int(after[here])
    return chain
