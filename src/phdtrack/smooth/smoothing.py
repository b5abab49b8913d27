"""Settings of what is done with corrected tracks when all is known, and the tracks that come of it.

`Smoothing` begins again with the measurements: pieces of one target are joined (`stitching`), and every row becomes the
state given all measurements of its track, before and after.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from phdtrack.errors import InputError, NonNegative, Positive, Share, check
from phdtrack.protocols import Model
from phdtrack.smooth.paths import Paths, paths_of
from phdtrack.smooth.stitching import Sequence, Smoothed, Terms, stitched
from phdtrack.types import I8, Bool, MeasurementHistory, Tracks


@dataclass(frozen=True, slots=True)
class Smoothing:
    """Smoothing and stitching of corrected tracks; online rows are not touched.

    Parameters
    ----------
    stitching : join tracks of one target that was lost and found again.
    smoothing : replace the boxes of rows by the smoothed ones.
    mean_occluded_time : seconds for which a lost target is out of sight on average.
    max_gap : seconds between tracks that are joined, at most.
    max_overlap_time : seconds for which two tracks of one target may overlap, at most.
    reentry_probability : that a track that ends was lost and comes back.
    max_gap_uncertainty : fill the gap between joined tracks where positions are known to within this many deviations of a
        measurement. 0: such gaps stay open.

    Raises
    ------
    InputError : a value is out of bounds.
    """

    stitching: bool = True
    smoothing: bool = True
    mean_occluded_time: Positive = 2.0
    max_gap: NonNegative = 6.0
    max_overlap_time: NonNegative = 4.0
    reentry_probability: Share = 0.5
    max_gap_uncertainty: NonNegative = 1.0

    def __post_init__(self) -> None:
        check(self)
        if self.reentry_probability == 1:
            where = "Smoothing.reentry_probability"
            raise InputError("expected a probability below 1, as some tracks end for good", where=where)

    def smooth(self, tracks: Tracks, measurements: MeasurementHistory, model: Model) -> Tracks:
        """The tracks joined and smoothed; identities from 1 in order of appearance.

        Parameters
        ----------
        tracks : corrected tracks.
        measurements : that they rest on.
        model : of the last frame.

        Returns
        -------
        The tracks.
        """
        paths = paths_of(tracks, measurements) if self.stitching or self.smoothing else None
        if paths is None or len(paths) == 0:
            return tracks
        sequence, rate = Sequence.of(measurements, model.sensor, model.motion), model.rate
        if self.stitching:
            times = self.mean_occluded_time * rate, self.max_gap * rate, self.max_overlap_time * rate
            paths, states = stitched(paths, sequence, Terms(*times, self.reentry_probability, rate))
        else:
            states = sequence.smooth(paths)
        return _rows(tracks, paths, states, measurements, model, self)


def _rows(
    tracks: Tracks, paths: Paths, states: Smoothed, measurements: MeasurementHistory, model: Model, wanted: Smoothing
) -> Tracks:
    """The tracks with the rows of their paths as wanted, and those gaps between joined ones filled that are."""
    x, given, name = np.ascontiguousarray(states.mean.T), paths.row >= 0, _names(tracks, paths)
    boxes, xyxy = model.sensor.boxes(x), tracks.xyxy.copy()
    if wanted.smoothing:
        xyxy[paths.row[given]] = boxes[given]
    # The nearest rows before and after each that come from a track; itself where it does.
    here = np.arange(len(given))
    before = np.maximum.accumulate(np.where(given, here, -1))
    after = np.minimum.accumulate(np.where(given, here, len(here))[::-1])[::-1]
    # Gaps inside one track were filled, or left open, by the associator.
    between = tracks.identity[paths.row[before]] != tracks.identity[paths.row[after]]
    uncertain = np.sqrt(
        (np.stack([states.covariance[:, 0, 0], states.covariance[:, 1, 1]]) / model.sensor.noise(x)[:2] ** 2).max(axis=0)
    )
    count = np.concatenate(([0], np.cumsum(uncertain > wanted.max_gap_uncertainty)))
    gap = np.flatnonzero((count[after] == count[before + 1]) & between)
    ends = paths.row[np.stack([before, after])[:, gap]]
    filled = Tracks(
        measurements.number[paths.frame[gap]],
        name[ends[0]],
        boxes[gap],
        tracks.confidence[ends].min(axis=0),
        np.full(len(gap), -1),
        np.ones(len(gap), np.bool_),
    )
    same = Tracks(tracks.frame, name, xyxy, tracks.confidence, tracks.detection, tracks.confirmed)
    return _numbered(Tracks.concatenate([same.take(~_doubled(tracks, paths, measurements, name)), filled]))


def _names(tracks: Tracks, paths: Paths) -> I8:
    """(T,) the identity of each row: of joined tracks that of the first."""
    given = np.flatnonzero(paths.row >= 0)
    old, place = np.unique(tracks.identity, return_inverse=True)
    first = old.copy()
    first[place[paths.row[given]]] = tracks.identity[paths.row[paths.first[paths.path[given]]]]
    out: I8 = first[place]
    return out


def _numbered(tracks: Tracks) -> Tracks:
    """The tracks with identities from 1 in order of appearance."""
    names, first, place = np.unique(tracks.identity, return_index=True, return_inverse=True)
    rank = np.empty(len(names), np.int64)
    rank[np.argsort(first)] = np.arange(1, len(names) + 1)
    return Tracks.concatenate([replace(tracks, identity=rank[place])])


def _doubled(tracks: Tracks, paths: Paths, measurements: MeasurementHistory, name: I8) -> Bool:
    """(T,) the predicted rows outside their track's measurements that a joined track has twice.

    The other is a row of its path, or one like it: two tracks that are joined may both go on with a shared detection.
    """
    outside = np.ones(len(tracks), np.bool_)
    outside[paths.row[paths.row >= 0]] = False
    identity = name[paths.row[paths.first]]
    order = np.argsort(identity)
    path = order[np.minimum(np.searchsorted(identity[order], name), len(order) - 1)]
    begin, end = measurements.number[paths.frame[paths.first]][path], measurements.number[paths.frame[paths.last]][path]
    within: Bool = (identity[path] == name) & (tracks.frame >= begin) & (tracks.frame <= end)
    _, first = np.unique(np.stack([name, tracks.frame]), axis=1, return_index=True)
    again = np.ones(len(tracks), np.bool_)
    again[first] = False
    out: Bool = outside & (within | again)
    return out
