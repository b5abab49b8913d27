"""Smoothing and stitching of corrected tracks, when all measurements are known.

Tracks of one target are joined (`stitching`), and every row becomes the state given all
measurements of its track, before and after (`sequence`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from phdtrack.errors import InputError, NonNegative, Positive, Share, check
from phdtrack.models.predicted_boxes import shown
from phdtrack.models.track_returns import with_returns
from phdtrack.protocols import Model
from phdtrack.smooth.ends import continued
from phdtrack.smooth.parting import parted
from phdtrack.smooth.paths import Paths, paths_of
from phdtrack.smooth.sequence import Sequence, Smoothed
from phdtrack.smooth.stitching import Stitching, returns, stitched
from phdtrack.smooth.vanished import without_vanished
from phdtrack.types import I8, Bool, MeasurementHistory, Tracks

# A side is cut by the border of the picture if it is this near, in widths or heights of the box.
_CUT = 0.1


@dataclass(frozen=True, slots=True)
class Smoothing:
    """Smoothing and stitching of corrected tracks, and the boxes of online rows.

    Parameters
    ----------
    stitching : join tracks of one target that was lost and found again.
    smoothing : replace the boxes of rows by the smoothed ones.
    noise_by_track : smooth each track with the noises that maximise the likelihood of its own
        measurements.
    mean_occluded_time : mean time in seconds for which a lost target is out of sight.
    max_gap : seconds between tracks that are joined, at most.
    max_overlap_time : seconds for which two tracks of one target may overlap, at most.
    reentry_probability : probability that a track that ends was lost and comes back.
    detection_share : boxes of online rows lie between the filter's and the detection's, see
        `smooth.online`.
    min_extent : drop tracks that move by less than this during their whole life, in widths or
        heights of a box; 0: none. To a background detector, swaying and flickering things are such
        tracks.
    max_gap_uncertainty : fill the gap between joined tracks if positions are known to within this
        many standard deviations of a measurement; 0: leave such gaps open.
    max_continuation : seconds by which a track is extended at both ends with detections that no
        track uses, at most; 0: never.
    frame_size : width and height of the picture, pixels: parts of a box outside are not expected to
        be detected.
    existence : confidences are the probability that there is a target. What is joined or smoothed
        then leaves out tracks that end as no target does (`smooth.vanished`), and rows without a
        detection whose box lies on no target more probably than not (`models.predicted_boxes`).
    """

    stitching: bool = True
    smoothing: bool = True
    noise_by_track: bool = True
    detection_share: bool = True
    mean_occluded_time: Positive = 2.0
    max_gap: NonNegative = 6.0
    max_overlap_time: NonNegative = 4.0
    reentry_probability: Share = 0.5
    max_gap_uncertainty: NonNegative = 1.0
    min_extent: NonNegative = 0.0
    max_continuation: NonNegative = 0.0
    frame_size: tuple[float, float] = (math.inf, math.inf)
    existence: bool = False

    def __post_init__(self) -> None:
        check(self)
        if self.reentry_probability == 1:
            raise InputError(
                "expected a probability below 1, because some tracks end for good",
                where="Smoothing.reentry_probability",
            )

    def smooth(self, tracks: Tracks, measurements: MeasurementHistory, model: Model) -> Tracks:
        """The tracks, stitched and smoothed."""
        out = tracks
        if self.stitching or self.smoothing:
            paths = paths_of(tracks, measurements)
            if len(paths):
                out = self._corrected(tracks, paths, measurements, model)
        return _moving(out, self.min_extent, self.frame_size)

    def _corrected(
        self, tracks: Tracks, paths: Paths, measurements: MeasurementHistory, model: Model
    ) -> Tracks:
        """The tracks whose ``paths`` are stitched, smoothed and extended."""
        sequence = Sequence.of(measurements, model)
        if self.stitching:
            whole = paths.track_of(measurements)
            pieces = parted(tracks, paths, sequence)
            if pieces is not tracks:
                tracks = pieces
                paths = paths_of(tracks, measurements)
            settings = Stitching(
                self.mean_occluded_time * model.rate,
                self.max_gap * model.rate,
                self.max_overlap_time * model.rate,
                self.reentry_probability,
            )
            paths, states = stitched(paths, sequence, settings, whole)
        else:
            states = sequence.smooth(paths)
        if self.existence:
            tracks, paths, states = without_vanished(tracks, paths, states, sequence)
        if self.noise_by_track:
            states = sequence.smooth(paths, sequence.fitting(paths))
        out = _rows(tracks, paths, states, measurements, model, self)
        if self.max_continuation > 0:
            limit = self.max_continuation * model.rate
            out = _numbered(continued(out, measurements, sequence.boxes, self.frame_size, limit))
        if self.stitching:
            return with_returns(out, returns(paths, sequence))
        return out


def _moving(tracks: Tracks, extent: float, size: tuple[float, float]) -> Tracks:
    """The tracks that move at least this far, in widths or heights of their median box.

    The motion is that of the centre, or of the visible side if the other is cut by the border of
    the picture.
    """
    if extent == 0 or not len(tracks):
        return tracks
    kept = np.zeros(len(tracks), np.bool_)
    order = np.argsort(tracks.identity, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(tracks.identity[order])) + 1):
        low = tracks.xyxy[rows, :2]
        high = tracks.xyxy[rows, 2:]
        box = np.median(high - low, axis=0)
        moved = np.ptp((low + high) / 2, axis=0)
        cut_low = np.median(low, axis=0) <= _CUT * box
        moved = np.where(cut_low, np.maximum(moved, np.ptp(high, axis=0)), moved)
        cut_high = np.median(high, axis=0) >= size - _CUT * box
        moved = np.where(cut_high, np.maximum(moved, np.ptp(low, axis=0)), moved)
        kept[rows] = (moved >= extent * box).any()
    if kept.all():
        return tracks
    return _numbered(tracks.select(kept))


def _rows(
    tracks: Tracks,
    paths: Paths,
    states: Smoothed,
    measurements: MeasurementHistory,
    model: Model,
    settings: Smoothing,
) -> Tracks:
    """The tracks with smoothed boxes if ``settings`` say so, joined, with gaps between them filled
    if the position is known well enough.
    """
    x = np.ascontiguousarray(states.mean.T)
    has_row = paths.row >= 0
    name = _names(tracks, paths)
    boxes = model.sensor.boxes(x)
    xyxy = tracks.xyxy.copy()
    if settings.smoothing:
        xyxy[paths.row[has_row]] = boxes[has_row]
    # The nearest rows of tracks before and after each row of a path; the row itself if it is one.
    here = np.arange(len(has_row))
    before = np.maximum.accumulate(np.where(has_row, here, -1))
    after = np.minimum.accumulate(np.where(has_row, here, len(here))[::-1])[::-1]
    # The associator has filled, or left open, gaps inside one track.
    between = tracks.identity[paths.row[before]] != tracks.identity[paths.row[after]]
    variance = np.stack([states.covariance[:, 0, 0], states.covariance[:, 1, 1]])
    uncertain = np.sqrt((variance / model.sensor.noise(x)[:2] ** 2).max(axis=0))
    count = np.concatenate(([0], np.cumsum(uncertain > settings.max_gap_uncertainty)))
    gap = np.flatnonzero((count[after] == count[before + 1]) & between)
    confidence = tracks.confidence[paths.row[np.stack([before, after])]].min(axis=0)
    on_target = np.ones(len(has_row), np.bool_)
    if settings.existence:
        # In frames in which nothing was measured perhaps no detector ran.
        measured = np.diff(measurements.start)[paths.frame] > 0
        unseen = np.flatnonzero((paths.measurement < 0) & measured)
        on_target[unseen] = shown(
            model, x[:, unseen], states.covariance[unseen], confidence[unseen]
        )
    gap = gap[on_target[gap]]
    numbers = measurements.number[paths.frame[gap]]
    filled = Tracks.of(numbers, name[paths.row[before[gap]]], boxes[gap], confidence[gap], -1)
    renamed = replace(tracks, identity=name, xyxy=xyxy)
    hidden = _duplicates(tracks, paths, measurements, name)
    hidden[paths.row[has_row & ~on_target]] = True
    return _numbered(Tracks.concatenate([renamed.select(~hidden), filled]))


def _names(tracks: Tracks, paths: Paths) -> I8:
    """(T,) the identity of each row; joined tracks have that of the first."""
    has_row = np.flatnonzero(paths.row >= 0)
    old, place = np.unique(tracks.identity, return_inverse=True)
    first = old.copy()
    first_rows = paths.row[paths.first[paths.path[has_row]]]
    first[place[paths.row[has_row]]] = tracks.identity[first_rows]
    return first[place]


def _numbered(tracks: Tracks) -> Tracks:
    """The tracks with identities from 1, in order of appearance."""
    names, first, place = np.unique(tracks.identity, return_index=True, return_inverse=True)
    rank = np.empty(len(names), np.int64)
    rank[np.argsort(first)] = np.arange(1, len(names) + 1)
    return Tracks.concatenate([replace(tracks, identity=rank[place])])


def _duplicates(tracks: Tracks, paths: Paths, measurements: MeasurementHistory, name: I8) -> Bool:
    """(T,) True for rows outside their track's measurements that duplicate another row of the
    joined track.

    The other is a row of its path, or a row like it: two tracks that are joined may both continue
    with a shared detection.
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
    repeated = np.ones(len(tracks), np.bool_)
    repeated[first] = False
    return outside & (within | repeated)
