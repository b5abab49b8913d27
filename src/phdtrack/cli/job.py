"""One run from frames to the run directory: the loop with its files, then what can only be made at the end.

While the loop runs, every frame's detections, states and online track rows go to their files at once. Whatever stops it,
the end of the video, a frame that cannot be used, a full disk or Ctrl-C, the frames done so far are finished like a whole
run: corrected tracks, scores, annotated video, report, ``run.json``. The outcome then carries what stopped it.

Decoding, detecting and tracking overlap (see `overlap`), and so do decoding, drawing and encoding.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import repeat
from typing import TYPE_CHECKING, Protocol

import numpy as np
from markupsafe import Markup

from phdtrack.cli import belief
from phdtrack.cli import run_directory as rundir
from phdtrack.cli.camera_motion import Mover, moved, standing
from phdtrack.cli.ground import places
from phdtrack.cli.inputs import NO_PICTURE, Inputs, detected
from phdtrack.cli.output import progress
from phdtrack.cli.pace import paced
from phdtrack.cli.pipeline_threads import ahead
from phdtrack.cli.run_directory import RunDirectory
from phdtrack.cli.spool import rereadable
from phdtrack.cli.steps import Steps
from phdtrack.errors import interrupted
from phdtrack.filters import NoFilter
from phdtrack.formats import DetectionsWriter, StatesWriter, TracksWriter, write_tracks
from phdtrack.protocols import AnyStages
from phdtrack.report import About, Annotator, Recorder, RunRecord, run_document, sentences, write_report, write_run
from phdtrack.types import F8, Detections, Frame, Image, Step, Tracks, Truth
from phdtrack.video import VideoSource, VideoWriter

if TYPE_CHECKING:
    from phdtrack.metrics import Scores

Stop = Exception | KeyboardInterrupt

WHICH = (
    f"{rundir.TRACKS} holds the corrected tracks of the whole run, {rundir.ONLINE} the rows as they were given "
    "frame by frame, which did not change afterwards."
)


Draw = Callable[[int, Image], None]


class Companion(Protocol):
    """Something that goes along with a run and has files of its own, as the groups on the ground."""

    def open(self, directory: RunDirectory) -> AbstractContextManager[object]:
        """Its files, open while the run lasts."""

    def take(self, step: Step, intensity: object) -> None:
        """Take in one frame's step and the filter's state after it."""

    def flush(self, rows: Tracks) -> None:
        """The online rows that the output delay held back; no step follows."""

    def finish(self, tracks: Tracks) -> None:
        """The corrected tracks of the whole run, before anything is drawn or told."""

    def drawing(self, directory: RunDirectory, *, pictures: bool) -> AbstractContextManager[Draw]:
        """Its video: what to call with the number of each frame and the annotated picture, an empty one without."""

    def section(self) -> Markup:
        """What it tells in the report."""

    def sentences(self) -> tuple[str, ...]:
        """The same in a few words, for the terminal."""

    def document(self) -> dict[str, object]:
        """The same for programs; goes into run.json."""


@dataclass(frozen=True, slots=True)
class Job:
    """What is to be run.

    ``configuration`` and ``read``, what was read and how, decide the result; ``command`` is the line that asked for it.
    """

    inputs: Inputs
    stages: AnyStages
    steps: Steps
    seed: int
    configuration: dict[str, object]
    read: dict[str, object]
    command: str
    title: str
    versions: tuple[tuple[str, str], ...]
    truth: Truth | None = None
    video: bool = True
    companion: Companion | None = None
    mover: Mover = standing

    @property
    def filter_name(self) -> str:
        """``filter.kind``, as configured."""
        return str(self.configured("filter", "kind"))

    def configured(self, section: str, name: str) -> object:
        """The value of a setting."""
        values = self.configuration[section]
        return values[name] if isinstance(values, dict) else ""


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
        tracks = _finish(job, directory)
        if job.companion is not None:
            job.companion.finish(tracks)
        scores = None if job.truth is None else _scores(job.truth, tracks, done.last)
        if job.video and (job.inputs.pictures or job.companion is not None):
            done.cut = _draw(job, source, directory, done, tracks)
    stop = done.stop or done.cut
    notes, doubts = _belief(job, done)
    chain = done.recorder.chain
    if chain is not None:
        notes, doubts = (*notes, chain.sentence), (*doubts, *filter(None, [chain.warning]))
    warnings = (*_problems(job, done), *doubts)
    about = About(
        title=job.title,
        command=job.command,
        seed=job.seed,
        started=started.isoformat(timespec="seconds"),
        seconds=time.perf_counter() - clock,
        tracking_seconds=done.seconds,
        left_out=done.left_out,
        versions=job.versions,
        scores=() if scores is None else tuple((key, _plain(value)) for key, value in scores.as_dict().items()),
        warnings=warnings,
        notes=(*notes, WHICH),
    )
    record = done.recorder.record(tracks, about, job.truth)
    document = _written(job, directory, record, complete=stop is None)
    said = sentences(record) if job.companion is None else (*sentences(record), *job.companion.sentences())
    return Outcome(document, said, len(done.seen), scores, warnings, stop)


def _loop(job: Job, source: VideoSource, directory: RunDirectory) -> _Progress:
    """Every frame through detector and steps, into files and record, until the source ends or something stops it."""
    inputs, place, companion = job.inputs, directory.file, job.companion
    done = _Progress(Recorder(inputs.info))
    with ExitStack() as files:
        detections = files.enter_context(DetectionsWriter(place(rundir.DETECTIONS)))
        states = files.enter_context(StatesWriter(place(rundir.STATES)))
        online = files.enter_context(TracksWriter(place(rundir.ONLINE)))
        advance = files.enter_context(progress("tracking", inputs.info.frames))
        if companion is not None:
            files.enter_context(companion.open(directory))
        pace = files.enter_context(paced())
        try:
            with ahead(source) as frames, ahead(moved(job.mover, detected(inputs.detector, frames))) as looked:
                for frame, found, warp, seconds in looked:
                    step = job.steps.advance(frame.number, frame.time, found, warp)
                    if inputs.pictures:
                        job.steps.look(frame, found)
                    detections.append(frame.number, found)
                    states.append(frame.number, frame.time, step.estimates)
                    online.append(step.tracks, places(job.stages.model.sensor, step.tracks.xyxy))
                    if companion is not None:
                        companion.take(step, job.steps.intensity)
                    done.recorder.add(frame.image if inputs.pictures else None, step, job.steps.particles, seconds)
                    done.seen.append(_seen(step))
                    advance(len(done.seen))
                    pace.frame()
            held = job.steps.flush()
            online.append(held, places(job.stages.model.sensor, held.xyxy))
            if companion is not None:
                companion.flush(held)
        except (Exception, KeyboardInterrupt) as stop:
            done.stop = _as_meant(stop)
        done.seconds, done.left_out = pace.seconds, pace.left_out
    done.lost = source.problem
    return done


def _seen(step: Step) -> _Seen:
    return _Seen(step.number, step.detections, step.info.mass, step.info.clutter_probability)


def _finish(job: Job, directory: RunDirectory) -> Tracks:
    """The corrected tracks of all frames, written."""
    tracks = job.steps.finish()
    write_tracks(directory.file(rundir.TRACKS), tracks, places(job.stages.model.sensor, tracks.xyxy))
    return tracks


def _scores(truth: Truth, tracks: Tracks, last: int) -> Scores:
    from phdtrack.metrics import evaluate

    return evaluate(truth, tracks, frames=last)


def _draw(job: Job, source: VideoSource, directory: RunDirectory, done: _Progress, tracks: Tracks) -> Stop | None:
    """The videos of the frames that were tracked; what stopped it, if anything did."""
    try:
        with ExitStack() as files:
            draw = _videos(job, directory, files)
            advance = files.enter_context(progress("drawing", len(done.seen)))
            pictures: Iterable[Image] = repeat(NO_PICTURE)
            if job.inputs.pictures:
                frames = files.enter_context(ahead(source))
                drawn = _pictures(Annotator(job.inputs.info), done.seen, frames, tracks)
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


def _videos(job: Job, directory: RunDirectory, files: ExitStack) -> list[Draw]:
    """What to call with every annotated picture: the video of these, and the companion's."""
    info, draw = job.inputs.info, list[Draw]()
    if job.inputs.pictures:
        video = files.enter_context(VideoWriter(directory.file(rundir.VIDEO), info.width, info.height, info.fps))
        draw.append(lambda number, picture: video.write(picture))
    if job.companion is not None:
        draw.append(files.enter_context(job.companion.drawing(directory, pictures=job.inputs.pictures)))
    return draw


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


def _belief(job: Job, done: _Progress) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """After how many detections of the usual size an object is believed: notes, and warnings where it takes long."""
    boxes = [seen.detections.xyxy for seen in done.seen if len(seen.detections)]
    if isinstance(job.stages.filter, NoFilter) or not boxes:
        return (), ()
    xyxy = np.concatenate(boxes)
    width, height = np.median(xyxy[:, 2:] - xyxy[:, :2], axis=0)
    needed = belief.detections_needed(job.stages, job.inputs.info, (float(width), float(height)))
    doubt = belief.warning(needed)
    return (belief.sentence(needed),), (doubt,) if doubt else ()


def _reason(stop: Stop) -> str:
    return "stopped by Ctrl-C" if isinstance(stop, KeyboardInterrupt) else f"ended ({stop or type(stop).__name__})"


def _plain(value: float | None) -> float:
    return math.nan if value is None else value


def _written(job: Job, directory: RunDirectory, record: RunRecord, *, complete: bool) -> dict[str, object]:
    """Report and run.json; the latter's content."""
    more = Markup() if job.companion is None else job.companion.section()
    write_report(directory.file(rundir.REPORT), record, job.configuration | {"input": job.read}, more)
    document = run_document(record, job.configuration)
    own = {"complete": complete, "input": job.read, "directory": str(directory.path)}
    files = {file.name: str(file) for file in directory.written()} | {rundir.RUN: str(directory.file(rundir.RUN))}
    told = {} if job.companion is None else job.companion.document()
    document = document | own | {"files": files} | told
    write_run(directory.file(rundir.RUN), document)
    return document
