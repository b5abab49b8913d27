"""What the report of a run shows, and the recorder that collects it while the run goes on.

A `Recorder` keeps numbers per frame and a small picture, so that memory does not grow with the
video beyond some hundred bytes a frame.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from phdtrack.arrays import pixelated
from phdtrack.types import F8, I8, Frame, Image, SequenceInfo, Step, Tracks, Truth

STAGES = ("detect", "filter", "extract", "associate")
NO_IMAGE: Image = np.zeros((0, 0, 3), np.uint8)
# Of the picture that is kept, in pixels.
_PICTURE_WIDTH = 800


@dataclass(frozen=True, slots=True)
class About:
    """What is said of a run in words and single values.

    Attributes
    ----------
    title, command, started : the heading, the line that was run, an ISO time.
    seed, seconds : of everything random; wall time of everything.
    versions, scores : pairs of name and value.
    warnings, notes : sentences to show.
    tracking_seconds : wall time of detection and tracking, which overlap; 0 where not measured.
    left_out : frames in which kernels were compiled or loaded; ``tracking_seconds`` is without
        them.
    finishing_seconds : wall time of what follows up to the report: corrected tracks, scores,
        annotated video.
    sections : of the report, as markup, that come after the key figures.
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
    """Counts of a whole run, of which a record may hold the last part only.

    Attributes
    ----------
    frames, seconds : how many, and from the first to the last one.
    detections, false_alarms : how many, and how many of them are expected to be false.
    classes : how many objects there were of each class.
    rows, predicted : rows of the corrected tracks, and those without a detection.
    """

    frames: int
    seconds: float
    detections: int
    false_alarms: float
    classes: Counter[int]
    rows: int
    predicted: int

    @property
    def objects(self) -> int:
        """Of all classes."""
        return self.classes.total()

    def with_rows(self, rows: Tracks, *known: set[int]) -> Whole:
        """With corrected rows; identities that are ``known`` were counted before."""
        names, first = np.unique(rows.identity, return_index=True)
        fresh = first[~np.isin(names, [*set().union(*known)])]
        classes = self.classes + Counter(rows.class_id[fresh].tolist())
        predicted = int(rows.predicted.sum())
        return self._replace(
            classes=classes, rows=self.rows + len(rows), predicted=self.predicted + predicted
        )


@dataclass(frozen=True, slots=True, eq=False)
class RunRecord:
    """Everything that a report shows of a run of F frames.

    Attributes
    ----------
    info, about : the sequence; words and single values.
    tracks : the corrected tracks.
    numbers, times : (F,) frame numbers from 1, ascending, and seconds.
    n_detections : (F,) detections.
    mass : (F,) expected number of objects, the integral of the intensity; NaN where the filter has
        none.
    clutter_mass : (F,) expected number of false alarms, the sum of κ/(κ + C) over the detections.
    count_range : (F, 2) between which numbers the filter's number of objects lies with 90 %
        probability; NaN in frames without a distribution, (0, 2) where no frame has one.
    seconds : (F, S) time that each of the `STAGES` took.
    truth_count : (F,) annotated objects, or (0,) where there is no truth.
    background : (h, w, 3) BGR frame from the second half, scaled down; (0, 0, 3) without video.
    log_evidence : (F,) `UpdateInfo.log_evidence`; NaN in frames without it.
    whole : counts of the whole run.
    track_count : (F,) tracks in each frame; online ones where there was no end to the source.
    names : what classes are called; None without classes.
    """

    info: SequenceInfo
    about: About
    tracks: Tracks
    numbers: I8
    times: F8
    n_detections: I8
    mass: F8
    clutter_mass: F8
    count_range: F8
    seconds: F8
    truth_count: I8
    background: Image
    log_evidence: F8
    whole: Whole
    track_count: I8
    names: Mapping[int, str] | None = None

    def __len__(self) -> int:
        return len(self.numbers)

    @property
    def lifetimes(self) -> I8:
        """(n,) number of boxes of each identity, ascending."""
        return np.sort(np.unique(self.tracks.identity, return_counts=True)[1])

    @property
    def by_class(self) -> Mapping[str, int]:
        """The number of tracks of each class that has any, by its name; {} without classes."""
        if self.names is None:
            return {}
        return {
            self.names.get(one, str(one)): count
            for one, count in sorted(self.whole.classes.items())
        }

    @property
    def frames_per_second(self) -> float:
        """Frames over the wall time from the first one up to the report, as if frames left out had
        taken as long as others.

        Where it was not measured it is by the sum of the stages; NaN without either.
        """
        about = self.about
        frames = self.whole.frames
        total = about.tracking_seconds or (0.0 if about.left_out else float(self.seconds.sum()))
        if not total > 0 or frames <= about.left_out:
            return math.nan
        return 1 / (total / (frames - about.left_out) + about.finishing_seconds / frames)

    @property
    def stage_times(self) -> Mapping[str, Sequence[float]]:
        """By stage, and together: mean, median, 95th percentile in ms per frame, share of the
        whole; {} without frames.
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
    """Collects a `RunRecord` while a run goes on: `add` every frame in order, `record` at the end
    or when it breaks off.

    The picture that is kept is of the 1st, 2nd, 4th, 8th, … frame, the last of these. ``truth`` is
    None where nothing is annotated. Of more than ``most`` frames the last ones are kept, and
    corrected rows are to be counted by `count`, when they are final. ``blur`` (`arrays.pixelated`)
    hides boxes of detections, estimates and tracks.
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
        self._whole = Whole(0, 0.0, 0, 0.0, Counter(), 0, 0)
        self._first = math.nan
        # Identities of the last two times that rows were counted.
        self._known = set[int](), set[int]()
        # The picture that is kept, and the number of its frame.
        self._picture = NO_IMAGE
        self._pictured = 0

    def add(self, frame: Frame | None, step: Step, detect_seconds: float) -> None:
        """Take in one frame.

        Parameters
        ----------
        frame : whose picture is shown, None without video.
        step : what the tracker made of the frame.
        detect_seconds : time that detection took, seconds.
        """
        info = step.info
        whole = self._whole
        false = float(info.clutter_probability.sum())
        tracks = int(step.tracks.confirmed.sum())
        row = (step.number, step.time, len(step.detections), info.mass, false, info.log_evidence)
        self._rows.append(
            (*row, *_likely_range(info.cardinality), tracks, detect_seconds, *step.seconds)
        )
        if whole.frames:
            self._first = self._first
        else:
            self._first = step.time
        self._whole = whole._replace(
            frames=whole.frames + 1,
            seconds=step.time - self._first,
            detections=whole.detections + len(step.detections),
            false_alarms=whole.false_alarms + float(np.nan_to_num(false)),
        )
        if frame is not None and self._whole.frames.bit_count() == 1:
            boxes = np.vstack([step.detections.xyxy, step.estimates.xyxy])
            self._picture = self._hidden(_small(frame), boxes)
            self._pictured = step.number

    def count(self, rows: Tracks) -> None:
        """Count corrected rows of a source without an end."""
        self._whole = self._whole.with_rows(rows, *self._known)
        # No track is away for longer.
        self._known = self._known[1], set(rows.identity.tolist())

    def record(self, tracks: Tracks, about: About) -> RunRecord:
        """Everything so far, with the corrected tracks of all frames that are kept; collecting may
        go on.
        """
        truth = self._truth
        table = np.array(self._rows, dtype=np.float64).reshape(-1, 9 + len(STAGES))
        numbers = table[:, 0].astype(np.int64)
        ranges = table[:, 6:8]
        return RunRecord(
            info=self._info,
            about=about,
            tracks=tracks,
            numbers=numbers,
            times=table[:, 1],
            n_detections=table[:, 2].astype(np.int64),
            mass=table[:, 3],
            clutter_mass=table[:, 4],
            count_range=ranges if np.isfinite(ranges).any() else ranges[:0],
            seconds=table[:, 9:],
            truth_count=np.zeros(0, np.int64)
            if truth is None
            else _count(truth.frame[~truth.distractor], numbers),
            background=self._hidden(self._picture, tracks.xyxy[tracks.frame == self._pictured]),
            log_evidence=table[:, 5],
            whole=self._whole if self._endless else self._whole.with_rows(tracks),
            track_count=table[:, 8].astype(np.int64)
            if self._endless
            else _count(tracks.frame, numbers),
        )

    def _hidden(self, image: Image, boxes: F8) -> Image:
        """A small picture of a frame with what is in boxes of the frame, in its own pixels,
        hidden.
        """
        return pixelated(image, image.shape[1] / max(1, self._info.width) * boxes, self._blur)


def known_mean(values: F8) -> float:
    """The mean of those that are finite; NaN without any."""
    known = values[np.isfinite(values)]
    if len(known):
        return float(known.mean())
    return math.nan


def shrunk(image: Image, width: int) -> Image:
    """The picture at most ``width`` pixels wide; itself where it is not wider."""
    high, wide = image.shape[:2]
    if wide <= width:
        return image
    small: Image = cv2.resize(
        image, (width, max(1, round(high * width / wide))), interpolation=cv2.INTER_AREA
    )
    return small


def _small(frame: Frame) -> Image:
    """The picture of a frame as it is kept; a decoder makes no larger one for it."""
    if isinstance(frame.picture, np.ndarray):
        return shrunk(frame.picture, _PICTURE_WIDTH).copy()
    wide, high = frame.picture.size
    width = min(wide, _PICTURE_WIDTH)
    return np.asarray(frame.picture.bgr((width, max(1, round(high * width / wide)))))


def _count(frame: I8, numbers: I8) -> I8:
    """(F,) how many entries of ``frame`` (M,) equal each of ``numbers`` (F,)."""
    first, end = (np.searchsorted(np.sort(frame), numbers, side) for side in ("left", "right"))
    return end - first


def _likely_range(cardinality: F8) -> tuple[float, float]:
    """The 5 % and 95 % quantiles of a distribution over 0, 1, 2, …; NaN without one."""
    if not len(cardinality):
        return math.nan, math.nan
    low, high = np.searchsorted(np.cumsum(cardinality), (0.05, 0.95))
    return float(low), float(min(high, len(cardinality) - 1))
