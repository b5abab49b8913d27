"""One run from frames to the run directory: the loop with its files, then what can only be made at the end.

While the loop runs, every frame's detections, states and online track rows go to their files at once. Whatever stops it,
the end of the video, a frame that cannot be used, a full disk or Ctrl-C, the frames done so far are finished like a whole
run: corrected tracks, scores, annotated video, report, ``run.json``. The outcome then carries what stopped it.

Decoding, detecting and tracking overlap (`inputs.ahead`), and so do decoding, drawing and encoding.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from itertools import repeat
from typing import TYPE_CHECKING

import numpy as np
from numba.core import event

from phdtrack import pipeline
from phdtrack.cli import run_directory as rundir
from phdtrack.cli.inputs import NO_PICTURE, Inputs, ahead, detected, rereadable
from phdtrack.cli.observers import Draw, Mover, RunObserver, moved, standing
from phdtrack.cli.output import Output, progress
from phdtrack.cli.run_directory import RunDirectory
from phdtrack.errors import interrupted
from phdtrack.filters import NoFilter
from phdtrack.filters.intensities import Cardinalised
from phdtrack.formats import DetectionsWriter, StatesWriter, TracksWriter, write_tracks
from phdtrack.kernels import CACHE
from phdtrack.models import PlaneSensor
from phdtrack.protocols import AnyStages, Sensor
from phdtrack.report import About, Annotator, Recorder, RunRecord, run_document, sentences, write_report, write_run
from phdtrack.types import (
    F4,
    F8,
    STILL,
    Detections,
    Frame,
    Image,
    ParticleBlocks,
    Particles,
    SequenceInfo,
    Step,
    Tracks,
    Truth,
)
from phdtrack.video import VideoSource, VideoWriter

if TYPE_CHECKING:
    from phdtrack.metrics import Scores

Stop = Exception | KeyboardInterrupt

WHICH = (
    f"{rundir.TRACKS} holds the corrected tracks of the whole run, {rundir.ONLINE} the rows as they were given "
    "frame by frame, which did not change afterwards."
)
FIRST = "compiling kernels (first use on this machine, some ten seconds; they are kept for the next runs) ..."
ALWAYS = (
    "kernels are compiled anew in every run (some ten seconds): neither the installation nor the home folder can be "
    "written into; set NUMBA_CACHE_DIR to a folder that can"
)
# Detections after which an object must be reported at the latest; after more than SLOW the user is warned.
_TRIED, _SLOW = 25, 5


class Steps:
    """The tracker as the run drives it: it holds the state between frames; everything else is `pipeline`'s."""

    def __init__(self, stages: AnyStages, rng: np.random.Generator) -> None:
        self._stages, self._rng = stages, rng
        self.state = pipeline.start(stages, rng)
        self._looks: dict[int, F4] = {}

    def look(self, frame: Frame, detections: Detections) -> None:
        """Remember what the detections of a frame look like, where stitching compares it."""
        looks = self._stages.smoother.describe(frame.image, detections.xyxy)
        if looks.shape[1]:
            self._looks[frame.number] = looks

    def advance(self, number: int, time: float, detections: Detections, warp: F8 = STILL) -> Step:
        """Take in the detections of frame ``number`` at ``time`` seconds; ``warp`` is how the camera has moved."""
        self.state, step = pipeline.advance(self._stages, self.state, detections, number, time, self._rng, warp)
        return step

    @property
    def particles(self) -> Particles | None:
        """The filter's particles after the last frame where the image shows them (`shown`); None where there are none."""
        intensity = self.state.intensity
        if isinstance(intensity, Cardinalised):
            intensity = intensity.intensity
        if isinstance(intensity, ParticleBlocks):
            intensity = intensity.particles()
        if isinstance(self._stages.filter, NoFilter) or not isinstance(intensity, Particles):
            return None
        return shown(intensity, self._stages.model.sensor)

    def flush(self) -> Tracks:
        """The online rows that the output delay held back."""
        return self._stages.associator.flush(self.state.association, self._stages.model)

    def finish(self) -> Tracks:
        """The corrected tracks of everything taken in so far."""
        return pipeline.finish(self._stages, self.state, self._looks)


@dataclass(frozen=True, slots=True)
class Job:
    """What is to be run.

    ``configuration`` and ``read``, what was read and how, decide the result; ``about`` has title, command, seed, versions.
    """

    inputs: Inputs
    stages: AnyStages
    steps: Steps
    configuration: dict[str, object]
    read: dict[str, object]
    about: About
    truth: Truth | None = None
    video: bool = True
    observers: tuple[RunObserver, ...] = ()
    mover: Mover = standing


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a run: the content of run.json, a summary in sentences, frames done, scores where there is truth.

    ``stop`` is what ended it before its time, None where it ran to the end.
    """

    document: dict[str, object]
    summary: tuple[str, ...]
    frames: int
    scores: Scores | None
    warnings: tuple[str, ...]
    stop: Stop | None


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """What the second pass needs of a frame."""

    number: int
    detections: Detections
    mass: float
    clutter_probability: F8


@dataclass(slots=True)
class _Progress:
    """How far it got. ``lost``: what the source said when it ended; ``stop`` ended the loop, ``cut`` the drawing.

    ``seconds`` is what the loop took, but for ``left_out`` frames in which kernels were compiled or loaded.
    """

    recorder: Recorder
    lost: str = ""
    seconds: float = 0.0
    left_out: int = 0
    seen: list[_Seen] = field(default_factory=list)
    stop: Stop | None = None
    cut: Stop | None = None

    @property
    def last(self) -> int:
        """The number of the last frame that went through, 0 where none did."""
        return self.seen[-1].number if self.seen else 0


def run(job: Job, directory: RunDirectory) -> Outcome:
    """Run the job. Raises only where nothing was computed; the directory is then left without files of this run."""
    started, clock = datetime.now(UTC), time.perf_counter()
    with rereadable(job.inputs, job.video) as source:
        done = _loop(job, source, directory)
        if not done.seen and done.stop is not None:
            directory.clear()
            raise done.stop
        tracks = job.steps.finish()
        write_tracks(directory.file(rundir.TRACKS), tracks, places(job.stages.model.sensor, tracks.xyxy))
        for observer in job.observers:
            observer.finish(tracks)
        scores = None if job.truth is None else _scores(job.truth, tracks, done.last)
        if job.video and (job.inputs.pictures or any(observer.draws for observer in job.observers)):
            done.cut = _draw(job, source, directory, done, tracks)
    stop = done.stop or done.cut
    notes, doubts = _confirmation(job, done)
    chain = done.recorder.chain
    if chain is not None:
        notes, doubts = (*notes, chain.sentence), (*doubts, *filter(None, [chain.warning]))
    warnings = (*_problems(job, done), *doubts)
    about = replace(
        job.about,
        started=started.isoformat(timespec="seconds"),
        seconds=time.perf_counter() - clock,
        tracking_seconds=done.seconds,
        left_out=done.left_out,
        scores=() if scores is None else tuple((k, math.nan if v is None else v) for k, v in scores.as_dict().items()),
        warnings=warnings,
        notes=(*notes, WHICH),
    )
    record = done.recorder.record(tracks, about, job.truth)
    document = _written(job, directory, record, complete=stop is None)
    summary = (*sentences(record), *(sentence for observer in job.observers for sentence in observer.sentences()))
    return Outcome(document, summary, len(done.seen), scores, warnings, stop)


def _loop(job: Job, source: VideoSource, directory: RunDirectory) -> _Progress:
    """Every frame through detector and steps, into files and record, until the source ends or something stops it."""
    inputs, place, sensor = job.inputs, directory.file, job.stages.model.sensor
    done = _Progress(Recorder(inputs.info))
    with ExitStack() as files:
        detections = files.enter_context(DetectionsWriter(place(rundir.DETECTIONS)))
        states = files.enter_context(StatesWriter(place(rundir.STATES)))
        online = files.enter_context(TracksWriter(place(rundir.ONLINE)))
        advance = files.enter_context(progress("tracking", inputs.info.frames))
        for observer in job.observers:
            files.enter_context(observer.open(directory))
        pace = files.enter_context(paced())
        try:
            with ahead(source) as frames, ahead(moved(job.mover, detected(inputs.detector, frames))) as looked:
                for frame, found, warp, seconds in looked:
                    step = job.steps.advance(frame.number, frame.time, found, warp)
                    if inputs.pictures:
                        job.steps.look(frame, found)
                    detections.append(frame.number, found)
                    states.append(frame.number, frame.time, step.estimates)
                    online.append(step.tracks, places(sensor, step.tracks.xyxy))
                    for observer in job.observers:
                        observer.take(step, job.steps.state)
                    done.recorder.add(frame.image if inputs.pictures else None, step, job.steps.particles, seconds)
                    seen = _Seen(step.number, step.detections, step.info.mass, step.info.clutter_probability)
                    done.seen.append(seen)
                    advance(len(done.seen))
                    pace.frame()
            held = job.steps.flush()
            online.append(held, places(sensor, held.xyxy))
            for observer in job.observers:
                observer.flush(held)
        except (Exception, KeyboardInterrupt) as stop:
            done.stop = _as_meant(stop)
        done.seconds, done.left_out = pace.seconds, pace.left_out
    done.lost = source.problem
    return done


def _scores(truth: Truth, tracks: Tracks, last: int) -> Scores:
    from phdtrack.metrics import evaluate

    return evaluate(truth, tracks, frames=last)


def _draw(job: Job, source: VideoSource, directory: RunDirectory, done: _Progress, tracks: Tracks) -> Stop | None:
    """The videos of the frames that were tracked; what stopped it, if anything did."""
    try:
        with ExitStack() as files:
            draw, info = list[Draw](), job.inputs.info
            if job.inputs.pictures:
                video = files.enter_context(VideoWriter(directory.file(rundir.VIDEO), info.width, info.height, info.fps))
                draw.append(lambda number, picture: video.write(picture))
            for observer in job.observers:
                draw.append(files.enter_context(observer.drawing(directory, pictures=job.inputs.pictures)))
            advance = files.enter_context(progress("drawing", len(done.seen)))
            pictures: Iterable[Image] = repeat(NO_PICTURE)
            if job.inputs.pictures:
                frames = files.enter_context(ahead(source))
                drawn = _pictures(Annotator(info), done.seen, frames, tracks)
                pictures = files.enter_context(ahead(drawn))
            for count, (seen, picture) in enumerate(zip(done.seen, pictures, strict=False), start=1):
                for one in draw:
                    one(seen.number, picture)
                advance(count)
    except (Exception, KeyboardInterrupt) as stop:
        return _as_meant(stop)
    return None


def _as_meant(stop: Stop) -> Stop:
    """Ctrl-C, in whatever form it comes out of compiled code, or the error itself."""
    return KeyboardInterrupt() if interrupted(stop) and not isinstance(stop, KeyboardInterrupt) else stop


def _pictures(annotate: Annotator, seen: Sequence[_Seen], frames: Iterable[Frame], tracks: Tracks) -> Iterator[Image]:
    """The frames that were seen, drawn on."""
    numbers = [one.number for one in seen]
    first, last = (np.searchsorted(tracks.frame, numbers, side=side) for side in ("left", "right"))
    for one, frame, i, j in zip(seen, frames, first, last, strict=False):
        rows, chances = tracks.take(np.arange(i, j)), one.clutter_probability
        yield annotate(frame.image, one.number, rows, one.detections, mass=one.mass, clutter_probability=chances)


def _problems(job: Job, done: _Progress) -> tuple[str, ...]:
    """What did not go as it should, in sentences: what the source lost, and what stopped the run."""
    said = [sentence for sentence in (*job.inputs.warnings, job.inputs.source.note, done.lost) if sentence]
    annotated = 0 if job.truth is None else int(job.truth.frame.max(initial=0))
    if done.stop is None and annotated > done.last:
        said.append(
            f"the truth goes on to frame {annotated}, the frames end at {done.last}: scored up to there; "
            "is it the truth of this sequence?"
        )
    if done.stop is not None:
        said.append(f"{_reason(done.stop)} after frame {done.last}; the results hold the frames up to there")
    if done.cut is not None:
        said.append(f"{_reason(done.cut)} while the video was drawn; {rundir.VIDEO} is not whole, everything else is")
    return tuple(said)


def _confirmation(job: Job, done: _Progress) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """After how many detections of the usual size an object is reported: notes, and warnings where it takes long."""
    boxes = [seen.detections.xyxy for seen in done.seen if len(seen.detections)]
    if isinstance(job.stages.filter, NoFilter) or not boxes:
        return (), ()
    xyxy = np.concatenate(boxes)
    width, height = np.median(xyxy[:, 2:] - xyxy[:, :2], axis=0)
    needed = detections_needed(job.stages, job.inputs.info, (float(width), float(height)))
    after = f"after {needed} coherent detection{'' if needed == 1 else 's'}"
    after = after if needed else f"within {_TRIED} coherent detections"
    note = f"With these settings an object is {'' if needed else 'not '}reported {after}."
    if 1 <= needed <= _SLOW:
        return (note,), ()
    cure = "raise birth.births_per_second, lower clutter.clutter_per_frame, or widen both volumes (birth.volume=image)"
    return (note,), (f"an object is {'reported only' if needed else 'not reported'} {after}: {cure}",)


def detections_needed(stages: AnyStages, info: SequenceInfo, size: tuple[float, float]) -> int:
    """Coherent detections of an object up to its first state; 0 for more than 25.

    The ratio of the densities of births and of clutter decides it, which settings do not show. So it is tried: an object
    of ``size`` (width, height in pixels) stands still in the middle of the frame and is detected in every frame.
    """
    rng = np.random.default_rng(0)
    centre, half = np.array([info.width, info.height]) / 2, np.array(size) / 2
    box = np.concatenate([centre - half, centre + half])[None, :]
    state = pipeline.start(stages, rng)
    for number in range(1, _TRIED + 1):
        state, step = pipeline.advance(stages, state, Detections.of(box), number, number / info.fps, rng)
        if len(step.estimates):
            return number
    return 0


def places(sensor: Sensor, xyxy: F8) -> F8:
    """(2, M) metres: the ground under the middle of each box's (M, 4) lower edge; NaN where there is none, or where the
    world of the sensor is the image. Without a camera the image is a plan, and the middles of the boxes are the places."""
    if not isinstance(sensor, PlaneSensor) or len(xyxy) == 0:
        return np.full((2, len(xyxy)), np.nan)
    middle = (xyxy[:, 0] + xyxy[:, 2]) / 2
    if sensor.camera is None:
        return np.stack([middle, (xyxy[:, 1] + xyxy[:, 3]) / 2])
    return sensor.camera.ground(np.stack([middle, xyxy[:, 3]]))


def shown(particles: Particles, sensor: Sensor) -> Particles | None:
    """The particles where the image shows them: rows 0 and 1 the middle of their boxes in pixels, as detections are drawn.
    None where the world is a plan without an image."""
    if not isinstance(sensor, PlaneSensor):
        return particles
    if sensor.camera is None:
        return None
    boxes = sensor.boxes(particles.state)
    return Particles(np.vstack([(boxes[:, :2] + boxes[:, 2:]).T / 2, particles.state[2:]]), particles.weight)


def _reason(stop: Stop) -> str:
    return "stopped by Ctrl-C" if isinstance(stop, KeyboardInterrupt) else f"ended ({stop or type(stop).__name__})"


def _written(job: Job, directory: RunDirectory, record: RunRecord, *, complete: bool) -> dict[str, object]:
    """Report and run.json; the latter's content."""
    more = "\n".join(observer.section() for observer in job.observers)
    write_report(directory.file(rundir.REPORT), record, job.configuration | {"input": job.read}, more)
    document = run_document(record, job.configuration)
    about = {"complete": complete, "input": job.read, "directory": str(directory.path)}
    files = {file.name: str(file) for file in directory.written()} | {rundir.RUN: str(directory.file(rundir.RUN))}
    document = document | about | {"files": files}
    for observer in job.observers:
        document |= observer.document()
    write_run(directory.file(rundir.RUN), document)
    return document


@dataclass(slots=True)
class Pace:
    """``seconds`` of wall time that frames took in which nothing was compiled or loaded; ``left_out``: the other frames."""

    seconds: float = 0.0
    left_out: int = 0
    _loading: bool = False
    _clock: float = field(default_factory=time.perf_counter)

    def frame(self) -> None:
        """A frame is done; the next one begins."""
        now = time.perf_counter()
        if self._loading:
            self.left_out += 1
        else:
            self.seconds += now - self._clock
        self._clock, self._loading = now, False

    def loading(self, started: event.Event) -> None:
        """A kernel met arguments of new types: to load or to compile it, Numba has taken a lock."""
        self._loading = True


# Numba has no types.
class _Listener(event.Listener):  # type: ignore[misc]
    """Calls ``started`` at the start of each of Numba's events."""

    def __init__(self, started: Callable[[event.Event], None]) -> None:
        self._started = started

    def on_start(self, event: event.Event) -> None:
        """An event starts."""
        self._started(event)

    def on_end(self, event: event.Event) -> None:
        """Nothing."""


@contextmanager
def paced() -> Iterator[Pace]:
    """The pace of the frames from now on, without those in which kernels were compiled or loaded."""
    pace = Pace()
    with event.install_listener("numba:compiler_lock", _Listener(pace.loading)):
        yield pace


@contextmanager
def announced(out: Output) -> Iterator[None]:
    """While this lasts, say so when the first kernel is compiled, so that the first run does not look as if it hung.

    Kernels that are loaded from disk say nothing. The line comes on a terminal only, as a progress bar does; that kernels
    cannot be kept is said in any case, because the user can change it.
    """
    said = False

    def begun(started: event.Event) -> None:
        nonlocal said
        if said or not started.data["dispatcher"].py_func.__module__.startswith("phdtrack."):
            return
        said = True
        if not CACHE.lasting:
            out.warn(ALWAYS)
        elif sys.stderr.isatty():
            out.note(FIRST)

    with event.install_listener("numba:compile", _Listener(begun)):
        yield
