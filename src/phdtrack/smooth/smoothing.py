"""Settings of what is done with finished tracks, and the tracks that come of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from phdtrack.checks import NonNegative, Positive, Share, check
from phdtrack.errors import InputError
from phdtrack.protocols import Model
from phdtrack.smooth.appearance import histograms
from phdtrack.smooth.paths import Paths, Seen, paths_of
from phdtrack.smooth.smooth import Smoothed, smooth
from phdtrack.smooth.stitch import Terms, stitched
from phdtrack.types import F4, F8, I8, Bool, Image, MeasurementHistory, Tracks


@dataclass(frozen=True, slots=True)
class Smoothing:
    """Smoothing of corrected tracks; online rows are not touched.

    Parameters
    ----------
    stitching : join tracks that are one object's, lost out of sight and found again.
    smoothing : put each row where all measurements of its track say together, instead of where the filter had it.
    mean_occluded_time : seconds for which somebody lost is out of sight on average.
    max_overlap_time : seconds for which at most two tracks of one object may go on beside each other before the first ends;
        they are
        joined too.
    max_gap : seconds after which nobody is taken for one who was lost.
    reentry_probability : probability that a track that ends was lost and comes back.
    appearance : where there are pictures, let colours have a say in what is joined, see `smooth.appearance`.
    max_gap_uncertainty : fill the gap between joined tracks where the object's place in it is known to within this many
        deviations of a
        single measurement. 0: such gaps stay open.
    """

    stitching: bool = True
    smoothing: bool = True
    mean_occluded_time: Positive = 2.0
    max_gap: NonNegative = 6.0
    max_overlap_time: NonNegative = 4.0
    reentry_probability: Share = 0.5
    max_gap_uncertainty: NonNegative = 1.0
    appearance: bool = False

    def __post_init__(self) -> None:
        check(self)
        if self.reentry_probability == 1:
            raise InputError(
                "expected a probability below 1, as some tracks end for good", where="Smoothing.reentry_probability"
            )

    def describe(self, image: Image, xyxy: F8) -> F4:
        """(N, B) colour histograms of the boxes (N, 4) with ``appearance``, (N, 0) without."""
        return histograms(image, xyxy) if self.stitching and self.appearance else np.zeros((len(xyxy), 0), np.float32)

    def smooth(self, tracks: Tracks, measured: MeasurementHistory, model: Model) -> Tracks:
        """The tracks refined by the measurements that they rest on; identities from 1 in order of appearance."""
        paths = paths_of(tracks, measured) if self.stitching or self.smoothing else None
        if paths is None or len(paths) == 0:
            return tracks
        seen, rate = Seen.of(measured.z, model.sensor), model.rate
        if self.stitching:
            terms = Terms(
                self.mean_occluded_time * rate,
                self.max_gap * rate,
                self.max_overlap_time * rate,
                self.reentry_probability,
                rate,
            )
            paths, states = stitched(paths, measured, seen, model.motion, terms)
        else:
            states = smooth(paths, measured, seen, model.motion)
        return _rows(tracks, paths, states, measured, model, self)


def _rows(
    tracks: Tracks, paths: Paths, states: Smoothed, measured: MeasurementHistory, model: Model, wanted: Smoothing
) -> Tracks:
    """The tracks with the rows of their paths as wanted, and those gaps between joined ones filled that are."""
    x, own, name = np.ascontiguousarray(states.mean.T), paths.row >= 0, _names(tracks, paths)
    boxes, xyxy = model.sensor.boxes(x), tracks.xyxy.copy()
    if wanted.smoothing:
        xyxy[paths.row[own]] = boxes[own]
    sides = _sides(paths)
    gap = np.flatnonzero(
        _known(states, model.sensor.noise(x), sides, wanted.max_gap_uncertainty) & _between(tracks, paths, sides)
    )
    ends = paths.row[sides[:, gap]]
    filled = Tracks(
        measured.number[paths.frame[gap]],
        name[ends[0]],
        boxes[gap],
        tracks.confidence[ends].min(axis=0),
        np.full(len(gap), -1),
        np.ones(len(gap), np.bool_),
    )
    same = Tracks(tracks.frame, name, xyxy, tracks.confidence, tracks.detection, tracks.confirmed)
    return _numbered(Tracks.concatenate([same.take(~_doubled(tracks, paths, measured, name)), filled]))


def _names(tracks: Tracks, paths: Paths) -> I8:
    """(T,) the identity of each row: of joined tracks that of the first."""
    own = np.flatnonzero(paths.row >= 0)
    whose = tracks.identity[paths.row[own]]
    old, place = np.unique(tracks.identity, return_inverse=True)
    root = old.copy()
    root[np.searchsorted(old, whose)] = tracks.identity[paths.row[paths.first[paths.owner[own]]]]
    out: I8 = root[place]
    return out


def _numbered(tracks: Tracks) -> Tracks:
    """The tracks with identities from 1 in order of appearance."""
    names, first, place = np.unique(tracks.identity, return_index=True, return_inverse=True)
    rank = np.empty(len(names), np.int64)
    rank[np.argsort(first)] = np.arange(1, len(names) + 1)
    return Tracks.concatenate([replace(tracks, identity=rank[place])])


def _sides(paths: Paths) -> I8:
    """(2, M) the nearest rows before and after each that come from a track; itself where it does."""
    own, here = paths.row >= 0, np.arange(len(paths.row))
    before = np.maximum.accumulate(np.where(own, here, -1))
    after = np.minimum.accumulate(np.where(own, here, len(here))[::-1])[::-1]
    return np.stack([before, after])


def _between(tracks: Tracks, paths: Paths, sides: I8) -> Bool:
    """(M,) the rows between two tracks. Gaps inside one are filled, or left open, by whoever made it."""
    before, after = tracks.identity[paths.row[sides]]
    out: Bool = before != after
    return out


def _known(states: Smoothed, noise: F8, sides: I8, most: float) -> Bool:
    """(M,) the rows in gaps whose every state is known to within ``most`` deviations of a measurement, in both axes."""
    variance = np.stack([states.covariance[:, 0, 0], states.covariance[:, 1, 1]])
    unsure = np.sqrt((variance / noise[:2] ** 2).max(axis=0)) > most
    count = np.concatenate(([0], np.cumsum(unsure)))
    out: Bool = count[sides[1]] == count[sides[0] + 1]
    return out


def _doubled(tracks: Tracks, paths: Paths, measured: MeasurementHistory, name: I8) -> Bool:
    """(T,) the rows that rest on nothing of their own, before or behind their own measurements, where that name has another:
    one of its path, or a row like it (two tracks that are one may both go on with a detection that they share).
    """
    outside = np.ones(len(tracks), np.bool_)
    outside[paths.row[paths.row >= 0]] = False
    who = name[paths.row[paths.first]]
    order = np.argsort(who)
    at = np.minimum(np.searchsorted(who[order], name), len(order) - 1)
    path = order[at]
    begin, end = measured.number[paths.frame[paths.first]][path], measured.number[paths.frame[paths.last]][path]
    within: Bool = (who[path] == name) & (tracks.frame >= begin) & (tracks.frame <= end)
    _, first = np.unique(np.stack([name, tracks.frame]), axis=1, return_index=True)
    again = np.ones(len(tracks), np.bool_)
    again[first] = False
    out: Bool = outside & (within | again)
    return out
