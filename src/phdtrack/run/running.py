"""Records that the parts of a run share: its arguments, and its progress."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from phdtrack.errors import InputError
from phdtrack.models import PlaneSensor
from phdtrack.multiclass import ClassSettings
from phdtrack.protocols import Sensor
from phdtrack.report import About, Recorder
from phdtrack.report.doubtful_tracks import TrackSigns
from phdtrack.run.camera_motion import Mover
from phdtrack.run.detection_log import source_of
from phdtrack.run.directory import RunDirectory
from phdtrack.run.inputs import Inputs
from phdtrack.run.loop import FrameObserver, TrackedFrame
from phdtrack.run.observers import RunObserver
from phdtrack.run.reporter import SILENT, Reporter
from phdtrack.tracker import Tracker
from phdtrack.types import F8, Detections, Tracks, Truth

Stop = Exception | KeyboardInterrupt


@dataclass(frozen=True, slots=True)
class RunOptions:
    """The options of a run besides its inputs and stages.

    Attributes
    ----------
    about : title, command line and seed.
    configuration, read : settings, and what was read and how, for run.json; a run is resumed only
        if they are the same.
    truth : annotated objects to score against.
    labelled : frames that are scored, as `scored_files.ScoringRequest.labelled`.
    video, video_size : whether to draw annotated.mp4, and its longer side in pixels; 0: that of the
        source.
    blur : ``boxes`` or ``faces`` to pixelate them in all pictures.
    delay : frames by which online rows lag.
    mover : the camera's motion; None for a camera that stands still.
    ground : measures where boxes in an image stand on the ground; None for the tracker's own
        sensor.
    detected_by : what decides the detections; empty if they are not kept for the next run.
    detect_again : do not reuse detections of an earlier run.
    checkpoint_every : seconds between checkpoints; 0 for none.
    learn : whether a first pass teaches the scene (`scene_pass`).
    viewer : takes in every frame once, with its picture; None for none. It needs detections that
        are made anew, as kept ones have no pictures.
    """

    about: About = field(default_factory=About)
    configuration: Mapping[str, object] = field(default_factory=dict)
    read: Mapping[str, object] = field(default_factory=dict)
    truth: Truth | None = None
    labelled: str = ""
    video: bool = True
    video_size: int = 0
    blur: str = ""
    delay: int = 0
    mover: Mover | None = None
    ground: Sensor | None = None
    detected_by: Mapping[str, object] = field(default_factory=dict)
    detect_again: bool = False
    checkpoint_every: float = 0.0
    learn: bool = False
    viewer: FrameObserver | None = None


@dataclass(frozen=True, slots=True)
class Run:
    """The arguments of `video.run`."""

    inputs: Inputs
    classes: ClassSettings
    directory: RunDirectory
    observers: Sequence[RunObserver] = ()
    options: RunOptions = field(default_factory=RunOptions)
    reporter: Reporter = SILENT
    resume: bool = False

    @property
    def key(self) -> dict[str, object]:
        """Everything that decides the result: a checkpoint of another run is refused."""
        options = self.options
        file = source_of(str(options.read.get("source", "")))
        settings = {"settings": options.configuration, **options.read}
        return {**settings, "seed": options.about.seed, "file": file}

    @property
    def names(self) -> Mapping[int, str] | None:
        """The names of the classes; None without classes."""
        if self.inputs.names is None or not self.classes.apart:
            return None
        return self.classes.names

    def places(self, xyxy: F8) -> F8:
        """(2, M) metres: where boxes (M, 4) stand on the ground; NaN if that is unknown."""
        return ground_places(self.options.ground or self.classes.usual.model.sensor, xyxy)


def ground_places(sensor: Sensor, xyxy: F8) -> F8:
    """(2, M) metres: the ground under each box's (M, 4) lower edge, or its centre in a plan; NaN if
    the sensor does not see the ground.
    """
    if isinstance(sensor, PlaneSensor):
        return sensor.measure(Detections.of(xyxy))[:2]
    return np.full((2, len(xyxy)), np.nan)


class FrameSummary(NamedTuple):
    """The part of a frame that drawing and the report need."""

    number: int
    time: float
    detections: Detections
    mass: float
    clutter_probability: F8

    @classmethod
    def of(cls, tracked: TrackedFrame) -> FrameSummary:
        """The summary of a tracked frame."""
        step = tracked.step
        info = step.info
        # There are as many summaries as frames, and embeddings are long.
        found = replace(step.detections, embeddings=None)
        return cls(step.number, step.time, found, info.mass, info.clutter_probability)


def used_boxes(rows: Tracks, summaries: Iterable[FrameSummary]) -> F8:
    """(M, 4) the boxes of the detections that rows (M,) rest on; NaN for predicted rows, and for
    frames without a summary.
    """
    known = list(summaries)
    counts = [len(summary.detections) for summary in known]
    boxes = np.concatenate([np.zeros((0, 4)), *(summary.detections.xyxy for summary in known)])
    number = np.repeat(np.array([summary.number for summary in known], np.int64), counts)
    row = np.concatenate([np.zeros(0, np.int64), *(summary.detections.row for summary in known)])
    # Frames and rows ascend, so that one number orders both.
    width = max(row.max(initial=0), rows.detection.max(initial=0)) + 1
    keys = number * width + row
    wanted = rows.frame * width + rows.detection
    place = np.searchsorted(keys, wanted)
    found = (rows.detection >= 0) & (place < len(keys))
    found[found] = keys[place[found]] == wanted[found]
    used = np.full((len(rows), 4), np.nan)
    used[found] = boxes[place[found]]
    return used


@dataclass(slots=True)
class Progress:
    """The progress of a run.

    Attributes
    ----------
    tracker, recorder : of the run.
    frames, summaries : number of frames, and a summary of each; of a source without an end those of
        the last frames.
    seconds, skipped : time of the loop without the ``skipped`` frames: the first, and those in
        which kernels were compiled or loaded.
    source_problem : what the source and the log reported at their end.
    stop, cut : what ended the loop, and the drawing, before its time.
    drawn : last frame of videos that end early because of a signal; 0 for whole ones.
    unwritten : what prevented the writing of files; the others are written all the same.
    final : corrected rows of a source without an end, for an observer.
    resumed : the frame that the run continued from; 0 for a run from the beginning.
    reused : whether the detections are those of an earlier run.
    shakes : whether the detector reported that the camera shakes.
    scene_warnings : what the detector reported of the scene.
    signs : judges tracks of moving regions; None if the detector reports objects.
    """

    tracker: Tracker
    recorder: Recorder
    summaries: list[FrameSummary] | deque[FrameSummary]
    frames: int = 0
    seconds: float = 0.0
    skipped: int = 0
    source_problem: str = ""
    stop: Stop | None = None
    cut: Stop | None = None
    drawn: int = 0
    unwritten: list[Stop] = field(default_factory=list)
    final: list[Tracks] = field(default_factory=list)
    resumed: int = 0
    reused: bool = False
    shakes: bool = False
    scene_warnings: tuple[str, ...] = ()
    signs: TrackSigns | None = None

    def judge(self, rows: Tracks) -> None:
        """Judge further corrected rows, if the detector reports moving regions."""
        if self.signs is not None:
            self.signs.add(rows, used_boxes(rows, self.summaries))

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Note that a file cannot be written, and go on with the others."""
        try:
            yield
        except (InputError, OSError) as error:
            self.unwritten.append(error)

    @property
    def ended(self) -> Stop | None:
        """The error or signal that ended the run, or the first file that could not be written."""
        return self.stop or self.cut or next(iter(self.unwritten), None)

    @property
    def last(self) -> int:
        """The number of the last frame that was tracked; 0 if there was none."""
        if self.summaries:
            return self.summaries[-1].number
        return 0
