"""A run: frames through detector and tracker into the files of its directory.

Every frame's detections, states and online track rows go to their files at once. Whatever stops the
loop, a frame that cannot be used, a full disk or Ctrl-C, the frames done so far are finished like a
whole run: corrected tracks, scores, annotated video, report, ``run.json``. Decoding, detecting and
tracking overlap (`inputs.ahead`), and so does drawing.
"""

from __future__ import annotations

import math
import shlex
import sys
import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from itertools import repeat
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
from numba.core import event

from phdtrack.cli import signals
from phdtrack.cli.output import Advance, progress, versions
from phdtrack.cli.show_settings import confirmation
from phdtrack.detect import BACKGROUND
from phdtrack.detect.base import prepared
from phdtrack.detect.scene_knowledge import scene_warnings
from phdtrack.devices import bgr_of, planes_of, size_of
from phdtrack.errors import InputError, interrupted, needed, shown
from phdtrack.files import return_memory, write_text
from phdtrack.formats import DetectionsWriter, StatesWriter, TracksWriter
from phdtrack.models import PlaneSensor
from phdtrack.multiclass import ClassSettings
from phdtrack.protocols import AnyStages, Sensor
from phdtrack.report import (
    About,
    Annotator,
    Recorder,
    report_html,
    run_document,
    sentences,
    write_run,
)
from phdtrack.report.pages import doubts, lines
from phdtrack.run import directory as rundir
from phdtrack.run.detection_log import Checkpoint, source_of
from phdtrack.run.directory import RunDirectory
from phdtrack.run.inputs import NO_PICTURE, Inputs, Mover, ahead, detected, expected, learn_scene
from phdtrack.run.observers import RunObserver
from phdtrack.tracker import FinalTracks, Tracker, uninterrupted
from phdtrack.types import F8, Detections, Frame, Image, Step, Tracks, Truth
from phdtrack.video import VideoWriter

if TYPE_CHECKING:
    from phdtrack.metrics import Scores
Stop = Exception | KeyboardInterrupt

_WHICH = (
    f"{rundir.TRACKS} holds the corrected tracks of the whole run, {rundir.ONLINE} the rows as they"
    " came frame by frame."
)
_LATEST = (
    "The source had no end: figures are of the whole run, charts of its last frames, paths of the"
    " last tracks."
)
_REUSED = (
    "The detections are those of an earlier run with the same detector; --detect-again detects"
    " anew."
)
_HIDDEN = (
    "In all pictures {} of detections and tracks are hidden; what was neither detected nor tracked"
    " can be seen."
)
_SHAKES = "The camera shakes: each picture was laid onto the scene before it was compared with it."
_STOPPED = "stopped after frame {}; its files are being completed"
# Frames that are kept, and that the report shows, of endless sources; the shorter side of an
# annotated video at the least; seconds for which videos are drawn after a signal.
_SAMPLE = 1000
_CHARTED = 100_000
_LEAST = 16
_SHORTLY = 0.5


@dataclass(frozen=True, slots=True)
class Job:
    """What is to be run; ``configuration`` and ``read``, what was read and how, decide the result;
    ``ground`` measures where boxes of tracks in an image stand; ``looked``: what decides the
    detections, empty where they are not kept; ``anew``: those of an earlier run are not taken;
    ``every``: seconds between checkpoints, 0 for none; ``delay``: frames by which online rows lag;
    ``blur``: what is made unrecognisable in pictures; ``video_size``: the longer side of the
    annotated video in pixels, at most; 0: as the source."""

    inputs: Inputs
    kinds: ClassSettings
    configuration: dict[str, object]
    read: dict[str, object]
    about: About
    truth: Truth | None = None
    video: bool = True
    observers: tuple[RunObserver, ...] = ()
    looked: Mapping[str, object] = field(default_factory=dict)
    anew: bool = False
    mover: Mover | None = None
    ground: Sensor | None = None
    every: float = 0.0
    delay: int = 0
    blur: str = ""
    video_size: int = 0

    @property
    def key(self) -> dict[str, object]:
        """What decides the result: a checkpoint of another is refused."""
        seed = self.about.seed
        file = source_of(str(self.read["source"]))
        return {"settings": self.configuration, **self.read, "seed": seed, "file": file}

    @property
    def sensor(self) -> Sensor:
        """What says where boxes stand on the ground."""
        return self.ground or self.stages.model.sensor

    @property
    def stages(self) -> AnyStages:
        """Those of classes that have none of their own."""
        return self.kinds.usual

    @property
    def names(self) -> Mapping[int, str] | None:
        """What classes are called; None without classes."""
        if self.inputs.names is None or not self.kinds.apart:
            return None
        return self.kinds.names


class Outcome(NamedTuple):
    """What came of a run: the content of run.json, a summary in sentences, scores where there is
    truth; ``stop`` is what ended it before its time, None where it ran to the end."""

    document: dict[str, object]
    summary: tuple[str, ...]
    scores: Scores | None
    warnings: tuple[str, ...]
    stop: Stop | None


class _Seen(NamedTuple):
    """What drawing needs of a frame."""

    number: int
    detections: Detections
    mass: float
    clutter_probability: F8


@dataclass(slots=True)
class _Progress:
    """How far it got. ``stop`` ended the loop, ``cut`` the drawing; ``lost`` is what the source
    said at its end; ``drawn`` the last frame of videos that end early because of a signal, or 0.
    ``seconds`` is what the loop took, but for ``left_out`` frames: the first, and those in which
    kernels were compiled or loaded. ``unwritten`` ended the writing of files; the others are
    written all the same. ``final``: corrected rows of a source without an end for an observer.
    ``resumed``: the frame that it went on from; ``reused``: an earlier run's detections;
    ``shakes``: the camera does."""

    tracker: Tracker
    recorder: Recorder
    seen: list[_Seen] | deque[_Seen]
    frames: int = 0
    seconds: float = 0.0
    left_out: int = 0
    lost: str = ""
    drawn: int = 0
    stop: Stop | None = None
    cut: Stop | None = None
    unwritten: list[Stop] = field(default_factory=list)
    final: list[Tracks] = field(default_factory=list)
    resumed: int = 0
    reused: bool = False
    shakes: bool = False

    @contextmanager
    def saving(self) -> Iterator[None]:
        """A file that cannot be written does not take the others with it."""
        try:
            yield
        except (InputError, OSError) as error:
            self.unwritten.append(error)

    @property
    def ended(self) -> Stop | None:
        """What ended it before its time, or the first file that could not be written."""
        return self.stop or self.cut or next(iter(self.unwritten), None)

    @property
    def last(self) -> int:
        """The number of the last frame that went through, 0 where none did."""
        if self.seen:
            return self.seen[-1].number
        return 0


def about(title: str, seed: int = 0) -> About:
    """What is known of a run that starts now."""
    now = datetime.now(UTC).isoformat(timespec="seconds")
    command = [shown(word) for word in sys.argv[1:]]
    return About(title, shlex.join(["phdtrack", *command]), seed, now, versions=versions())


def run(job: Job, directory: RunDirectory, *, resume: bool = False) -> Outcome:
    """Run the job. Raises only where nothing was computed; the directory is then left without files
    of this run.
    """
    return_memory()
    if job.video and (job.inputs.pictures or job.observers):
        needed("av")  # at the end, perhaps after hours
    with progress("tracking", 0) as advance:
        return _run(job, directory, advance, resume=resume)


def _run(job: Job, directory: RunDirectory, advance: Advance, *, resume: bool) -> Outcome:
    """As `run`, with the function that says how far it got."""
    clock = time.perf_counter()
    scores = None
    done = _track(job, directory, advance, resume=resume)
    tracked = time.perf_counter()
    return_memory()
    if not (done.seen or done.stop or resume) and job.inputs.source.first > 1:
        # A segment of a batch, which always resumes, may lie behind the end of a file that is cut
        # short.
        done.stop = InputError(job.inputs.source.problem, where="--frames")
    if not done.seen and done.stop is not None:
        if not resume:
            directory.clear()
        raise done.stop
    tracks = _smoothed(done)
    if job.inputs.again:
        with done.saving(), TracksWriter(directory.file(rundir.TRACKS), job.names) as file:
            file.append(tracks, places(job.sensor, tracks.xyxy))
    for observer in job.observers:
        with done.saving():
            observer.finish(
                directory, tracks if job.inputs.again else Tracks.concatenate(done.final)
            )
    if job.truth is not None and done.seen:
        from phdtrack.metrics import evaluate

        scores = evaluate(job.truth, tracks, frames=done.last, first=job.inputs.source.first)
    if job.video:
        _draw(job, directory, done, tracks, advance)
    finished = time.perf_counter() - tracked
    return_memory()
    advance(done.frames, total=done.frames, description="report")
    record = replace(done.recorder.record(tracks, job.about), names=job.names)
    # The note comes first, then the warning if there is one.
    boxes = np.concatenate([np.zeros((0, 4)), *(seen.detections.xyxy for seen in done.seen)])
    confirmed = confirmation(job.stages, job.inputs.info, boxes)
    wrong = scene_warnings(job.inputs.detector) or doubts(
        record, background=job.inputs.described in BACKGROUND
    )
    hidden = job.blur and _HIDDEN.format(job.blur)
    latest = "" if job.inputs.again else _LATEST
    said = replace(
        job.about,
        seconds=time.perf_counter() - clock,
        tracking_seconds=done.seconds,
        finishing_seconds=finished,
        left_out=done.left_out,
        scores=(
            ()
            if scores is None
            else tuple((k, math.nan if v is None else v) for k, v in scores.as_dict().items())
        ),
        warnings=(*_problems(job, done), *wrong, *confirmed[1:]),
        notes=tuple(
            filter(None, (*confirmed[:1], _WHICH, hidden, latest, _SHAKES if done.shakes else ""))
        ),
    )
    reports = [observer.report() for observer in job.observers]
    record = replace(
        record, about=replace(said, sections="\n".join(report.section for report in reports))
    )
    with done.saving():
        write_text(
            directory.file(rundir.REPORT),
            report_html(record, job.configuration | {"input": job.read}),
        )
    complete = done.ended is None
    document = run_document(record, job.configuration) | {"complete": complete, "input": job.read}
    some = {"resumed_from_frame": done.resumed, "detections_reused": done.reused}
    document |= {"boxes_left_out": done.tracker.left_out._asdict()} | {
        name: one for name, one in some.items() if one
    }
    with done.saving():
        document = finish_document(document, directory, *(report.document for report in reports))
    if complete and done.ended is None:
        directory.sweep()
    summary = (
        *([_REUSED] * done.reused),
        *sentences(record),
        *(one for report in reports for one in report.sentences),
    )
    warnings = (
        *said.warnings,
        *(str(error) for error in done.unwritten if error is not done.ended),
    )
    return Outcome(document, summary, scores, warnings, done.ended)


def finish_document(
    document: dict[str, object], directory: RunDirectory, *more: dict[str, object]
) -> dict[str, object]:
    """Write run.json: the document, where the files are, and what observers add."""
    run = directory.file(rundir.RUN)
    files = {file.name: str(file) for file in directory.written()} | {run.name: str(run)}
    document = document | {"directory": str(directory.path), "files": files}
    for part in more:
        document |= part
    write_run(run, document)
    return document


def _track(job: Job, directory: RunDirectory, advance: Advance, *, resume: bool) -> _Progress:
    """Every frame through detector and tracker, into files and record, until the source ends or
    something stops it.
    """
    inputs = job.inputs
    tracker = Tracker(stages=job.kinds, fps=inputs.info.fps, seed=job.about.seed)
    recorder = Recorder(inputs.info, job.truth, None if inputs.again else _CHARTED, job.blur)
    done = _Progress(tracker, recorder, [] if inputs.again else deque(maxlen=_SAMPLE))
    found_in = partial(detected, inputs.detector, mover=job.mover)
    checkpoint = None
    if job.every > 0 and inputs.pictures and inputs.again:
        checkpoint = Checkpoint(
            directory, job.key, job.looked, job.every, resume=resume, anew=job.anew
        )
        found_in = partial(checkpoint.detected, inputs, mover=job.mover)
        done.resumed = checkpoint.number
        done.reused = checkpoint.reused
    if not inputs.again:
        # What runs for months does not stop for a kernel that it meets late.
        tracker.warm_up()
    with ExitStack() as files:
        written = _Written(job, directory, done, files)
        # To load or to compile a kernel for arguments of new types Numba takes a lock, which is
        # recorded.
        locks = files.enter_context(event.install_recorder("numba:compiler_lock"))
        clock = time.perf_counter()
        try:
            if checkpoint is None:
                learn_scene(inputs)
            # Where detections are used again, nobody looks at the pictures.
            pictures = inputs.source if done.reused else prepared(inputs.detector, inputs.source)
            with ahead(pictures) as frames, ahead(found_in(frames)) as looked:
                for frame, found, warp, seconds, pose in looked:
                    # No frame stands in one file only; and Numba does not survive Ctrl-C while it
                    # makes objects.
                    with uninterrupted():
                        rows = tracker.update(
                            found, frame.number, frame.time, warp if len(warp) else None
                        )
                        step = tracker.step
                        assert step is not None
                        seen = _Seen(
                            step.number,
                            step.detections,
                            step.info.mass,
                            step.info.clutter_probability,
                        )
                        written.take(frame, found, step, seen, rows)
                        done.recorder.add(frame if inputs.pictures else None, step, seconds)
                        done.seen.append(seen)
                        done.frames = done.frames + 1
                        done.shakes = done.shakes or len(pose) > 0
                    advance(done.frames, **expected(inputs.source, done.frames, "tracking"))
                    before = clock
                    clock = time.perf_counter()
                    if locks.buffer or done.frames == 1:
                        done.left_out += 1
                        locks.buffer.clear()
                    else:
                        done.seconds += clock - before
            written.flush()
        except (Exception, KeyboardInterrupt) as stop:
            done.stop = _as_meant(stop)
        written.rest()
        if isinstance(done.stop, KeyboardInterrupt):
            signals.last_chance(_STOPPED.format(done.last))
        done.lost = ". ".join(
            filter(None, (inputs.source.problem, checkpoint.problem if checkpoint else ""))
        )
    return done


def _smoothed(done: _Progress) -> Tracks:
    """The corrected tracks. A signal that comes meanwhile waits for them."""
    try:
        with uninterrupted():
            tracks = done.tracker.tracks()
    except KeyboardInterrupt as stop:
        done.stop = done.stop or stop
        signals.last_chance(_STOPPED.format(done.last))
    return tracks


class _Written:
    """The files that grow while frames come, opened in ``files``; what goes wrong when they are
    closed is in ``done``.
    """

    def __init__(
        self, job: Job, directory: RunDirectory, done: _Progress, files: ExitStack
    ) -> None:
        self._job = job
        self._done = done
        again = job.inputs.again
        self._detections = DetectionsWriter(directory.file(rundir.DETECTIONS), job.names)
        self._states = StatesWriter(directory.file(rundir.STATES))
        self._online = TracksWriter(directory.file(rundir.ONLINE), job.names)
        # Of a source that may never end tracks go to disk when they are final, and the past is
        # forgotten.
        if again:
            self._corrected = None
        else:
            self._corrected = TracksWriter(directory.file(rundir.TRACKS), job.names)
        if again:
            self._final = None
        else:
            self._final = FinalTracks(done.tracker)
        if again or not (job.video and job.inputs.pictures):
            self._once = None
        else:
            self._once = _DrawnOnce(job, directory)
        for writer in (self._detections, self._states, self._online, self._corrected, self._once):
            # What goes wrong when it is closed must not take with it what was computed.
            files.enter_context(done.saving())
            if writer is not None:
                files.enter_context(writer)
        for observer in job.observers:
            files.enter_context(done.saving())
            observer.open(directory, files)

    def take(self, frame: Frame, found: Detections, step: Step, seen: _Seen, rows: Tracks) -> None:
        """A frame, its detections, and the online rows that it brought."""
        self._detections.append(frame.number, found)
        self._states.append(step)
        self._append(self._online, rows)
        for observer in self._job.observers:
            observer.take(found, step, self._done.tracker.state)
        if self._once:
            self._once.take(frame, seen, rows)
        if self._final and len(final := self._final.due()):
            self._take_final(final)
            return_memory()  # what smoothing has freed, or the heap grows for days

    def flush(self) -> None:
        """The online rows that were held back."""
        self._append(self._online, held := self._done.tracker.flush())
        if self._once:
            self._once.flush(held)

    def rest(self) -> None:
        """All corrected rows that are not written yet."""
        if self._final:
            self._take_final(self._final.rest())

    def _take_final(self, rows: Tracks) -> None:
        """Write corrected rows, count them, and keep them where an observer wants those of the
        whole run.
        """
        if self._corrected:
            self._append(self._corrected, rows)
        self._done.recorder.count(rows)
        if any(observer.all_tracks for observer in self._job.observers):
            self._done.final.append(rows)

    def _append(self, writer: TracksWriter, rows: Tracks) -> None:
        writer.append(rows, places(self._job.sensor, rows.xyxy))


class _Drawing:
    """Draws frames for the annotated video, shrunk as `Job.video_size` says."""

    def __init__(self, job: Job, *, planes: bool = False) -> None:
        sides = (job.inputs.info.width, job.inputs.info.height)
        info = job.inputs.info
        # Encoders take no sides of a few pixels, and even ones only.
        share = max(job.video_size / max(sides), _LEAST / min(sides))
        self.size = sides
        if job.video_size and share < 1:
            self.size = (
                2 * int(share * info.width / 2 + 1e-9),
                2 * int(share * info.height / 2 + 1e-9),
            )
        self._factor = np.tile(np.divide(self.size, (info.width, info.height)), 2)
        self._annotate = Annotator(
            replace(info, width=self.size[0], height=self.size[1]), names=job.names, blur=job.blur
        )
        # What is drawn on the decoder's planes goes to the encoder as it is; what blurs, and odd
        # sizes, need BGR.
        self._planes = planes and not (job.blur or self.size[0] % 2 or self.size[1] % 2)

    def __call__(self, frame: Frame, seen: _Seen, rows: Tracks) -> Image:
        """The picture with rows of tracks and what else was seen in it: BGR or, where they may be,
        its `Picture.planes`.
        """
        planes = self._planes and not isinstance(frame.picture, np.ndarray)
        size = self.size
        # A picture keeps BGR of its own size only.
        if size == size_of(frame):
            own = None
        else:
            own = size
        if planes:
            image = planes_of(frame.picture, own).reshape(-1, size[0])
        else:
            image = bgr_of(frame.picture, own)
        rows = replace(rows, xyxy=rows.xyxy * self._factor)
        found = replace(seen.detections, xyxy=seen.detections.xyxy * self._factor)
        return self._annotate(
            image,
            seen.number,
            rows,
            found,
            mass=seen.mass,
            clutter_probability=seen.clutter_probability,
        )


class _DrawnOnce:
    """The video of pictures that come only once: the online rows are drawn when they come, and no
    picture is kept.
    """

    def __init__(self, job: Job, directory: RunDirectory) -> None:
        self._draw = _Drawing(job)
        self._delay = job.delay
        self._waiting = deque[tuple[Frame, _Seen]]()
        self._video = VideoWriter(
            directory.file(rundir.VIDEO), *self._draw.size, job.inputs.info.fps, fast=True
        )

    def take(self, frame: Frame, seen: _Seen, rows: Tracks) -> None:
        """Draw the frame that the rows are of, which the output delay holds back."""
        self._waiting.append((frame, seen))
        if len(self._waiting) > self._delay:
            self._write(rows)

    def flush(self, rows: Tracks) -> None:
        """Draw what still waits."""
        while self._waiting:
            self._write(rows)

    def _write(self, rows: Tracks) -> None:
        frame, seen = self._waiting.popleft()
        self._video.write(
            self._draw(frame, seen, rows.select(rows.frame == frame.number)), frame.time
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: Any) -> None:
        self._video.__exit__(*error)


def _draw(
    job: Job, directory: RunDirectory, done: _Progress, tracks: Tracks, advance: Advance
) -> None:
    """The videos of the frames that were tracked, but for pictures that do not come again: they are
    drawn as they come.
    """
    try:
        with ExitStack() as files:
            info = job.inputs.info
            again = job.inputs.pictures and job.inputs.again
            draw = [
                one
                for observer in job.observers
                if (one := observer.drawing(directory, files, pictures=again))
            ]
            pictures: Iterable[Image] = repeat(NO_PICTURE)
            if again:
                # Observers draw on the same pictures, and in their coordinates.
                drawing = _Drawing(replace(job, video_size=0) if draw else job, planes=not draw)
                video = files.enter_context(
                    VideoWriter(directory.file(rundir.VIDEO), *drawing.size, info.fps, fast=True)
                )
                frames = files.enter_context(ahead(job.inputs.source, 1))
                pictures = files.enter_context(
                    ahead(_annotated(drawing, done.seen, frames, tracks), 1)
                )
                draw.insert(0, lambda number, picture: video.write(picture))
            if not draw:
                return
            end = math.inf
            if isinstance(done.stop, KeyboardInterrupt):
                shortly = _SHORTLY
            else:
                shortly = math.inf
            try:
                for count, (seen, picture) in enumerate(
                    zip(done.seen, pictures, strict=False), start=1
                ):
                    for one in draw:
                        one(seen.number, picture)
                    advance(count, total=done.frames, description="drawing")
                    # Without the first one, for which kernels are loaded.
                    if count == 1:
                        end = time.monotonic() + shortly
                    else:
                        end = end
                    if time.monotonic() >= end and count < done.frames:
                        done.drawn = seen.number
                        break
            except KeyboardInterrupt as stop:
                # The videos end here, and can be played.
                done.cut = stop
                signals.last_chance(f"stopped while frame {seen.number} was drawn")
    except Exception as error:
        if isinstance(error, InputError | OSError):
            done.unwritten.append(error)
        else:
            done.cut = _as_meant(error)


def _annotated(
    draw: _Drawing, seen: Iterable[_Seen], frames: Iterable[Frame], tracks: Tracks
) -> Iterator[Image]:
    """The frames that were seen, drawn on."""
    for one, frame in zip(seen, frames, strict=False):
        yield draw(
            frame,
            one,
            tracks.select(np.arange(*np.searchsorted(tracks.frame, [one.number, one.number + 1]))),
        )


def _as_meant(stop: Stop) -> Stop:
    """Ctrl-C, in whatever form it comes out of compiled code, or the error itself."""
    if interrupted(stop) and not isinstance(stop, KeyboardInterrupt):
        return KeyboardInterrupt()
    return stop


def _problems(job: Job, done: _Progress) -> Iterator[str]:
    """What did not go as it should, in sentences: what the source lost, and what stopped the
    run.
    """
    yield from filter(None, (*job.inputs.warnings, job.inputs.source.note, done.lost))
    if job.truth is None:
        annotated = 0
    else:
        annotated = int(job.truth.frame.max(initial=0))
    asked = f"stopped by {signals.which()}"
    why = [asked if isinstance(stop, KeyboardInterrupt) else stop for stop in (done.stop, done.cut)]
    yield from lines(
        "problems.txt",
        stop=why[0],
        cut=why[1],
        done=done,
        annotated=annotated,
        job=job,
        video=rundir.VIDEO,
    )
    yield from done.tracker.left_out.sentences()


def places(sensor: Sensor, xyxy: F8) -> F8:
    """(2, M) metres: the ground under each box's (M, 4) lower edge, or its centre in a plan; NaN
    where there is none.
    """
    plane = isinstance(sensor, PlaneSensor)
    if plane:
        return sensor.measure(Detections.of(xyxy))[:2]
    return np.full((2, len(xyxy)), np.nan)
