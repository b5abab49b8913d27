"""The contents of a run's report, and the recorder that collects them during the run.

A `Recorder` keeps a few numbers per frame and one small picture, so that memory grows by some
hundred bytes per frame.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from phdtrack.arrays import pixelated
from phdtrack.opencv_package import cv2
from phdtrack.report.appearance_worth import AppearanceRecorder, AppearanceWorth
from phdtrack.report.doubtful_tracks import DoubtfulTracks
from phdtrack.report.object_list import Minute, Seen, bar_seconds, minutes, objects
from phdtrack.report.thumbnails import Thumbnails
from phdtrack.types import F8, I8, Frame, Image, SequenceInfo, Step, Tracks, Truth

STAGES = ("detect", "filter", "extract", "associate")
NO_IMAGE: Image = np.zeros((0, 0, 3), np.uint8)
# Width in pixels of the picture that is kept.
_PICTURE_WIDTH = 800


@dataclass(frozen=True, slots=True)
class About:
    """Sentences and single values that describe a run.

    Attributes
    ----------
    title, command, started : the heading, the command line, an ISO time.
    seed, seconds : of the random numbers; wall time of the whole run.
    versions, scores : pairs of name and value.
    warnings, notes : sentences to show.
    tracking_seconds : wall time of detection and tracking, which overlap; 0 if not measured.
    left_out : frames in which kernels were compiled or loaded; not in ``tracking_seconds``.
    finishing_seconds : wall time from then up to the report: corrected tracks, scores, annotated
        video.
    sections : further sections of the report, as markup, after the key figures.
    """

    title: str = ""
    command: str = ""
    seed: int = 0
    started: str = ""
    seconds: float = 0.0
    versions: tuple[tuple[str, str], ...] = ()
    scores: tuple[tuple[str, float], ...] = ()
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    tracking_seconds: float = 0.0
    left_out: int = 0
    sections: str = ""
    finishing_seconds: float = 0.0


class Whole(NamedTuple):
    """Counts of a whole run; a record may only hold the last part of it.

    Attributes
    ----------
    frames, seconds : number of frames, and time from the first to the last one.
    detections, false_alarms : number of detections, and the expected number of false ones.
    classes : number of objects of each class.
    rows, predicted : rows of the corrected tracks, and those without a detection.
    observed, missed : frames in which a detector ran, and the predicted rows in them.
    """

    frames: int
    seconds: float
    detections: int
    false_alarms: float
    classes: Counter[int]
    rows: int
    predicted: int
    observed: int
    missed: int

    @property
    def objects(self) -> int:
        """Number of objects of all classes."""
        return self.classes.total()

    @property
    def detection_rate(self) -> float:
        """The share of tracked objects that is detected in a frame in which a detector ran; NaN
        without rows.
        """
        found = self.rows - self.predicted
        if not found:
            return math.nan
        return found / (found + self.missed)

    def with_rows(self, rows: Tracks, unobserved: Iterable[int], *known: set[int]) -> Whole:
        """The counts with more corrected rows.

        Parameters
        ----------
        rows : to add.
        unobserved : frames in which no detector ran.
        known : identities that have been counted before.
        """
        names, first = np.unique(rows.identity, return_index=True)
        new = first[~np.isin(names, [*set().union(*known)])]
        observed = ~np.isin(rows.frame, [*unobserved])
        return self._replace(
            classes=self.classes + Counter(rows.class_id[new].tolist()),
            rows=self.rows + len(rows),
            predicted=self.predicted + int(rows.predicted.sum()),
            missed=self.missed + int((rows.predicted & observed).sum()),
        )


@dataclass(frozen=True, slots=True, eq=False)
class RunRecord:
    """Everything that a report shows of a run with F frames.

    Attributes
    ----------
    info, about : the sequence; sentences and single values.
    tracks : the corrected tracks.
    numbers, times : (F,) frame numbers from 1, ascending, and seconds.
    n_detections : (F,) number of detections.
    mass : (F,) expected number of objects, the integral of the intensity; NaN if the filter has
        none.
    count_range : (F, 2) 90 % interval of the filter's number of objects; NaN in frames without a
        distribution, (0, 2) if no frame has one.
    seconds : (F, S) time of each of the `STAGES`.
    truth_count : (F,) annotated objects, or (0,) without truth.
    background : (h, w, 3) BGR frame from the second half, scaled down; (0, 0, 3) without video.
    log_evidence : (F,) `UpdateInfo.log_evidence`; NaN in frames without it.
    whole : counts of the whole run.
    track_count : (F,) tracks in each frame; online ones if the source has no end.
    names : names of the classes; None without classes.
    doubtful : how many boxes are in doubtful tracks; None if the detector reports objects, not
        moving regions.
    appearance : what appearance was worth; None without a source of it.
    thumbnails : small pictures of objects as ``data:`` addresses, by identity.
    tables : True if objects.csv, minutes.csv, hours.csv and heatmap.csv are beside the report.
    """

    info: SequenceInfo
    about: About
    tracks: Tracks
    numbers: I8
    times: F8
    n_detections: I8
    mass: F8
    count_range: F8
    seconds: F8
    truth_count: I8
    background: Image
    log_evidence: F8
    whole: Whole
    track_count: I8
    names: Mapping[int, str] | None = None
    doubtful: DoubtfulTracks | None = None
    appearance: AppearanceWorth | None = None
    thumbnails: Mapping[int, str] = field(default_factory=dict)
    tables: bool = True

    def __len__(self) -> int:
        return len(self.numbers)

    @property
    def lifetimes(self) -> I8:
        """(n,) number of boxes of each track, ascending."""
        return np.sort(np.unique(self.tracks.identity, return_counts=True)[1])

    @property
    def objects(self) -> list[Seen]:
        """The objects of the tracks, by the time at which they came."""
        return objects(self.tracks, self.numbers, self.times, self.names)

    def objects_during(self, found: Sequence[Seen], width: float) -> list[Minute]:
        """How many of the objects ``found`` there were in each stretch of ``width`` seconds."""
        return minutes(found, self.times, self.track_count, width)

    @property
    def bar_seconds(self) -> float:
        """Seconds of a bar in the chart of objects over time."""
        return bar_seconds(float(self.times[-1] - self.times[0]) if len(self) else 0.0)

    @property
    def by_class(self) -> Mapping[str, int]:
        """The number of tracks of each class with tracks, by its name; empty without classes."""
        if self.names is None:
            return {}
        return {
            self.names.get(number, str(number)): count
            for number, count in sorted(self.whole.classes.items())
        }

    @property
    def frames_per_second(self) -> float:
        """Frames per second of wall time up to the report, as if frames left out had taken as long
        as others.

        If it was not measured, the time is the sum of the stages; NaN without either.
        """
        about = self.about
        frames = self.whole.frames
        total = about.tracking_seconds
        if not total and not about.left_out:
            total = float(self.seconds.sum())
        if not total > 0 or frames <= about.left_out:
            return math.nan
        return 1 / (total / (frames - about.left_out) + about.finishing_seconds / frames)

    @property
    def stage_times(self) -> Mapping[str, Sequence[float]]:
        """Mean, median and 95th percentile in ms per frame, and share of the total, by stage and
        together; empty without frames.
        """
        if not len(self):
            return {}
        table = 1000 * np.column_stack([self.seconds, self.seconds.sum(axis=1)])
        share = table.sum(axis=0) / max(float(table[:, -1].sum()), 1e-12)
        columns = np.array(
            [table.mean(axis=0), np.median(table, axis=0), np.quantile(table, 0.95, axis=0), share]
        )
        return dict(zip((*STAGES, "together"), columns.T.tolist(), strict=True))


class Recorder:
    """Collects a `RunRecord` during a run: call `add` for every frame in order, and `record` at the
    end or after an interruption.

    The picture is that of the last of the 1st, 2nd, 4th, 8th, … frames. ``truth`` is None without
    annotations. If ``most`` is given, only that many of the last frames are kept, and corrected
    rows must be passed to `count` when they are final. ``blur`` (`arrays.pixelated`) hides boxes of
    detections, estimates and tracks. ``appearance`` takes in what boxes look like.

    Parameters
    ----------
    info : size of the frames in pixels, and their rate.
    """

    def __init__(
        self,
        info: SequenceInfo,
        truth: Truth | None = None,
        most: int | None = None,
        blur: str = "",
    ) -> None:
        self._info = info
        self._truth = truth
        self._blur = blur
        self._rows = deque[tuple[float, ...]](maxlen=most)
        self._endless = most is not None
        self._unobserved = deque[int](maxlen=most)
        self._whole = Whole(0, 0.0, 0, 0.0, Counter(), 0, 0, 0, 0)
        self._first = math.nan
        # Identities in the last two calls of `count`.
        self._known = set[int](), set[int]()
        # The picture that is kept, and the number of its frame.
        self._picture = NO_IMAGE
        self._pictured = 0
        self.appearance = AppearanceRecorder()
        self._thumbnails = Thumbnails(blur)

    def add(self, frame: Frame | None, step: Step, detect_seconds: float) -> None:
        """Add one frame.

        Parameters
        ----------
        frame : the frame with its picture; None without video.
        step : the tracker's results for the frame.
        detect_seconds : time of detection, seconds.
        """
        info = step.info
        whole = self._whole
        false = float(info.clutter_probability.sum())
        tracks = int(step.tracks.confirmed.sum())
        row = (step.number, step.time, len(step.detections), info.mass, info.log_evidence)
        self._rows.append(
            (*row, *_likely_range(info.cardinality), tracks, detect_seconds, *step.seconds)
        )
        if not whole.frames:
            self._first = step.time
        self._whole = whole._replace(
            frames=whole.frames + 1,
            seconds=step.time - self._first,
            detections=whole.detections + len(step.detections),
            false_alarms=whole.false_alarms + float(np.nan_to_num(false)),
            observed=whole.observed + step.detections.observed,
        )
        self.appearance.see(step.appeared)
        if not step.detections.observed:
            self._unobserved.append(step.number)
        if frame is None:
            return
        boxes = np.vstack([step.detections.xyxy, step.estimates.xyxy])
        if not self._endless:
            self._thumbnails.see(frame, step.tracks, boxes)
        if self._whole.frames.bit_count() == 1:
            self._picture = self._hidden(_small(frame), boxes)
            self._pictured = step.number

    def keep_picture_of(self, other: Recorder) -> None:
        """Take over the pictures of a recorder of the same frames.

        Parameters
        ----------
        other : the other recorder.
        """
        self._picture = other._picture
        self._pictured = other._pictured
        self._thumbnails = other._thumbnails

    def count(self, rows: Tracks) -> None:
        """Count final corrected rows of a source without end.

        Parameters
        ----------
        rows : boxes in pixels.
        """
        self._whole = self._whole.with_rows(rows, self._unobserved, *self._known)
        # No track is absent for longer.
        self._known = self._known[1], set(rows.identity.tolist())

    def record(self, tracks: Tracks, about: About) -> RunRecord:
        """The record so far, with the corrected tracks of all frames that are kept; more frames
        may follow.

        Parameters
        ----------
        tracks : corrected rows, boxes in pixels.
        about : what else is told of the run.
        """
        table = np.array(self._rows, dtype=np.float64).reshape(-1, 8 + len(STAGES))
        numbers = table[:, 0].astype(np.int64)
        ranges = table[:, 5:7]
        if not np.isfinite(ranges).any():
            ranges = ranges[:0]
        truth_count = np.zeros(0, np.int64)
        if self._truth is not None:
            truth_count = _count(self._truth.frame[~self._truth.distractor], numbers)
        whole = self._whole
        track_count = table[:, 7].astype(np.int64)
        if not self._endless:
            whole = whole.with_rows(tracks, self._unobserved)
            track_count = _count(tracks.frame, numbers)
        return RunRecord(
            info=self._info,
            about=about,
            tracks=tracks,
            numbers=numbers,
            times=table[:, 1],
            n_detections=table[:, 2].astype(np.int64),
            mass=table[:, 3],
            count_range=ranges,
            seconds=table[:, 8:],
            truth_count=truth_count,
            background=self._hidden(self._picture, tracks.xyxy[tracks.frame == self._pictured]),
            log_evidence=table[:, 4],
            whole=whole,
            track_count=track_count,
            thumbnails=self._thumbnails.of(tracks),
        )

    def _hidden(self, image: Image, boxes: F8) -> Image:
        """A small picture of a frame with the content of boxes, in pixels of the frame, hidden."""
        return pixelated(image, image.shape[1] / max(1, self._info.width) * boxes, self._blur)


def known_mean(values: F8) -> float:
    """The mean of the finite values; NaN without any."""
    known = values[np.isfinite(values)]
    if len(known):
        return float(known.mean())
    return math.nan


def shrunk(image: Image, width: int) -> Image:
    """The picture shrunk to ``width`` pixels; a narrower one keeps its size."""
    rows, columns = image.shape[:2]
    if columns <= width:
        return image
    size = (width, max(1, round(rows * width / columns)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def _small(frame: Frame) -> Image:
    """The small picture of a frame; a decoder converts no larger one for it."""
    if isinstance(frame.picture, np.ndarray):
        return shrunk(frame.picture, _PICTURE_WIDTH).copy()
    columns, rows = frame.picture.size
    width = min(columns, _PICTURE_WIDTH)
    return np.asarray(frame.picture.bgr((width, max(1, round(rows * width / columns)))))


def _count(frame: I8, numbers: I8) -> I8:
    """(F,) number of entries of ``frame`` (M,) that equal each of ``numbers`` (F,)."""
    ordered = np.sort(frame)
    return np.searchsorted(ordered, numbers, "right") - np.searchsorted(ordered, numbers, "left")


def _likely_range(cardinality: F8) -> tuple[float, float]:
    """The 5 % and 95 % quantiles of a distribution over 0, 1, 2, …; NaN without one."""
    if not len(cardinality):
        return math.nan, math.nan
    low, high = np.searchsorted(np.cumsum(cardinality), (0.05, 0.95))
    return float(low), float(min(high, len(cardinality) - 1))
