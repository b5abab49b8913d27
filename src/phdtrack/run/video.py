"""One run: frames through detector and tracker into the files of a directory.

Every frame's detections, states and online rows go to their files at once. Whatever stops the loop,
a frame that cannot be used, a full disk or Ctrl-C, the frames done so far are finished like a whole
run: corrected tracks, scores, annotated video, report, ``run.json``. Decoding, detection and
tracking overlap, and so does drawing.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from numba.core import event

from phdtrack.detect import BACKGROUND
from phdtrack.detect.scene_knowledge import forget_scene, scene_warnings
from phdtrack.detect.wrappers import reported_region
from phdtrack.errors import InputError, needed
from phdtrack.files import return_memory
from phdtrack.formats import TracksWriter
from phdtrack.multiclass import ClassSettings
from phdtrack.report import Recorder
from phdtrack.report.doubtful_tracks import TrackSigns
from phdtrack.run import directory as rundir
from phdtrack.run.annotated_video import as_interrupt, draw_videos
from phdtrack.run.detection_log import DetectionLog
from phdtrack.run.directory import RunDirectory
from phdtrack.run.inputs import Inputs, detected_frames, expected_end
from phdtrack.run.loop import NO_PICTURE, DetectedFrame, FrameObserver, TrackedFrame, track_frames
from phdtrack.run.observers import RunObserver
from phdtrack.run.reporter import SILENT, Advance, Reporter
from phdtrack.run.run_files import RunFiles
from phdtrack.run.run_report import write_report
from phdtrack.run.running import FrameSummary, Progress, Run, RunOptions, Stop
from phdtrack.run.scene_pass import KeptFrames, SceneLesson, can_learn
from phdtrack.run.scoring import score_run
from phdtrack.scene.flicker import NOWHERE
from phdtrack.tracker import Tracker, uninterrupted
from phdtrack.types import Tracks

if TYPE_CHECKING:
    from phdtrack.metrics import Scores

_STOPPED = "stopped after frame {}; its files are being completed"
_STOPPED_STUDY = (
    "stopped during the first of two readings of the video, in which the detector learns the"
    " background: no frame is tracked yet, and nothing is kept (--detector mog2 reads it once)"
)
SAMPLE = 1000
"""Frames of a source without an end that the report shows, and charts of so many."""
CHARTED = 100_000


class RunResult(NamedTuple):
    """The results of a run.

    Attributes
    ----------
    tracks : corrected tracks; of a source without an end those that are remembered.
    document : the content of run.json.
    summary, warnings : sentences.
    reported : the warnings that the reporter got during the run.
    scores : None without truth.
    stop : what ended the run before its time; None if it ran to the end.
    """

    tracks: Tracks
    document: dict[str, object]
    summary: tuple[str, ...]
    warnings: tuple[str, ...]
    scores: Scores | None = None
    stop: Stop | None = None
    reported: tuple[str, ...] = ()

    @property
    def unreported(self) -> tuple[str, ...]:
        """The warnings that the reporter did not get during the run."""
        return tuple(each for each in self.warnings if each not in self.reported)


def run(
    inputs: Inputs,
    classes: ClassSettings,
    directory: RunDirectory,
    observers: Sequence[RunObserver] = (),
    *,
    options: RunOptions | None = None,
    reporter: Reporter = SILENT,
    resume: bool = False,
) -> RunResult:
    """Track the objects in the inputs and write everything into a directory.

    Parameters
    ----------
    inputs : frames and detector.
    classes : how each class is tracked.
    directory : where files are written.
    observers : take in every frame, and add files and sections of the report.
    options : everything else.
    reporter : receives progress and sentences.
    resume : continue a run that was interrupted.

    Returns
    -------
    Tracks, the content of run.json, sentences, and what stopped the run.

    Raises
    ------
    Whatever stops the run before its first frame; the directory is then left without files of this
    run. What stops it later is in the result.
    """
    return_memory()
    whole = Run(inputs, classes, directory, observers, options or RunOptions(), reporter, resume)
    if whole.options.video and (inputs.pictures or observers):
        # Not at the end, perhaps after hours.
        needed("av")
        needed("cv2")
    with reporter.progress("tracking") as advance:
        return _run(whole, advance)


def _run(run: Run, advance: Advance) -> RunResult:
    """Track, finish and report, with a function that shows how far it got."""
    began = time.perf_counter()
    lesson = None
    if can_learn(run):
        kept = KeptFrames(run.directory.path)
        lesson = SceneLesson((run.inputs.info.width, run.inputs.info.height), kept)
    progress = _track(run, advance, lesson)
    tracked = time.perf_counter()
    # Seconds in which kernels are compiled or loaded are none of the run's speed.
    compiling = list[float]()
    with event.install_timer("numba:compiler_lock", compiling.append):
        return_memory()
        _raise_if_nothing(run, progress)
        tracks = _smoothed(run, progress)
        if lesson is not None:
            run, progress, tracks = _track_again(run, lesson, progress, tracks, advance)
        progress.scene_warnings = scene_warnings(run.inputs.detector)
        if run.inputs.again:
            # Videos and charts take memory, too. A camera's detector goes on in the next segment.
            forget_scene(run.inputs.detector)
            with (
                progress.writing(),
                TracksWriter(run.directory.file(rundir.TRACKS), run.names) as file,
            ):
                file.append(tracks, run.places(tracks.xyxy))
            final = tracks
        else:
            final = Tracks.concatenate(progress.final)
        for observer in run.observers:
            with progress.writing():
                observer.finish(run.directory, final)
        if run.inputs.again:
            progress.judge(tracks)
        scored = score_run(run, progress, tracks)
        if run.options.video:
            draw_videos(run, progress, tracks, advance)
    finishing = time.perf_counter() - tracked - sum(compiling)
    return_memory()
    advance(progress.frames, total=progress.frames, description="report")
    seconds = (time.perf_counter() - began, finishing)
    document, summary, warnings = write_report(run, progress, tracks, scored, seconds, lesson)
    reported = progress.tracker.warnings
    ended = progress.ended
    return RunResult(tracks, document, summary, warnings, scored.scores, ended, reported)


def _track(run: Run, advance: Advance, lesson: SceneLesson | None = None) -> Progress:
    """All frames through detector and tracker, into files and record, until the source ends or
    something stops it. A ``lesson`` takes them in, too; the observers then get them later.
    """
    inputs = run.inputs
    progress = _begun(run)
    tracker = progress.tracker
    if not inputs.again:
        tracker.trust_times()
    log = _detection_log(run)
    if log is not None:
        progress.resumed = log.number
        progress.reused = log.reused
    if not inputs.again:
        # What runs for months does not stop for a kernel that it needs late.
        tracker.warm_up()
    first = run
    more: tuple[FrameObserver, ...] = ()
    if lesson is not None:
        first = replace(run, observers=())
        more = (lesson,)
    if run.options.viewer is not None:
        more = (*more, run.options.viewer)
    study = _Study(advance)
    _follow(first, progress, _detected(run, log, study), study, more)
    problems = (inputs.source.problem, log.problem if log else "")
    progress.source_problem = ". ".join(filter(None, problems))
    return progress


def _begun(run: Run) -> Progress:
    """The progress of a run before its first frame."""
    inputs = run.inputs
    options = run.options
    tracker = Tracker(stages=run.classes, fps=inputs.info.fps, seed=options.about.seed)
    tracker.on_warning = lambda sentence: run.reporter.warn([sentence])
    charted = None if inputs.again else CHARTED
    recorder = Recorder(inputs.info, options.truth, charted, options.blur)
    progress = Progress(tracker, recorder, [] if inputs.again else deque(maxlen=SAMPLE))
    if inputs.described in BACKGROUND:
        progress.signs = TrackSigns(inputs.info, reported_region(inputs.detector))
    return progress


def _follow(
    run: Run,
    progress: Progress,
    detections: AbstractContextManager[Iterator[DetectedFrame]],
    study: _Study,
    more: Sequence[FrameObserver] = (),
) -> None:
    """Frames with their detections through the tracker, into files and record, and to ``more``
    observers, until they end or something stops it. ``study`` shows the progress.
    """
    tracker = progress.tracker
    with ExitStack() as files:
        written = RunFiles(run, progress, files)
        pace = _Pace(run, progress, files, study)
        try:
            with detections as detected:
                record = _Record(run, progress)
                track_frames(tracker, detected, (written, record, pace, *more))
            written.flush()
        except (Exception, KeyboardInterrupt) as stop:
            progress.stop = as_interrupt(stop)
        written.rest()
        if isinstance(progress.stop, KeyboardInterrupt):
            if study.begun and not progress.frames:
                run.reporter.stopping(_STOPPED_STUDY)
            else:
                run.reporter.stopping(_STOPPED.format(progress.last))


def _track_again(
    run: Run, lesson: SceneLesson, first: Progress, tracks: Tracks, advance: Advance
) -> tuple[Run, Progress, Tracks]:
    """The second pass, with what the first has taught, over the same detections; the first is all
    if it has taught nothing and no observer waits for the frames.

    Parameters
    ----------
    run, lesson : the run, and the detections of the first pass.
    first, tracks : progress and corrected tracks of the first pass.
    advance : shows the progress.
    """
    if first.stop is None:
        lesson.learn(tracks)
    if lesson.learned is NOWHERE and not run.observers:
        return run, first, tracks
    if lesson.sentence:
        # The sentences at the end say where.
        run.reporter.note(
            "the scene flickers: the same detections are tracked once more, knowing where"
        )
    run = replace(run, classes=lesson.taught(run.classes))
    progress = _begun(run)
    known = first.tracker.warnings
    progress.tracker.on_warning = lambda each: run.reporter.warn({each}.difference(known))
    again = _Study(advance, "tracking again")
    _follow(run, progress, nullcontext(iter(lesson.frames)), again)
    progress.recorder.keep_picture_of(first.recorder)
    # The second pass counts as what follows the loop.
    progress.seconds = first.seconds
    progress.skipped = first.skipped
    progress.source_problem = first.source_problem
    progress.stop = first.stop or progress.stop
    progress.unwritten += first.unwritten
    progress.resumed = first.resumed
    progress.reused = first.reused
    return run, progress, lesson.without_flicker(_smoothed(run, progress))


def _detection_log(run: Run) -> DetectionLog | None:
    """The log of detections; None without checkpoints, or for detections that are in a file."""
    options = run.options
    inputs = run.inputs
    if options.checkpoint_every <= 0 or not (inputs.pictures and inputs.again):
        return None
    return DetectionLog(
        run.directory,
        run.key,
        options.detected_by,
        options.checkpoint_every,
        resume=run.resume,
        anew=options.detect_again,
        described_by=options.read.get("appearance"),
    )


def _detected(
    run: Run, log: DetectionLog | None, study: _Study
) -> AbstractContextManager[Iterator[DetectedFrame]]:
    """Every frame with its detections; ``study`` shows how the detector learns the scene."""
    if log is None:
        return detected_frames(run.inputs, run.options.mover, study.watch)
    return log.detected_frames(run.inputs, run.options.mover, study.watch)


class _Study:
    """Shows the progress of both readings of a file from which a detector learns the background
    first, or of the only one.

    Attributes
    ----------
    begun : whether there is a first reading.
    """

    def __init__(self, advance: Advance, title: str = "tracking") -> None:
        self.begun = False
        self.advance = advance
        self._title = title

    @property
    def title(self) -> str:
        """The description of the tracking."""
        if self.begun:
            return f"{self._title} (2 of 2)"
        return self._title

    def watch(self, done: int, total: int) -> None:
        """Show how far the first reading is, as `inputs.study_scene` reports it."""
        self.begun = True
        self.advance(done, total=total or None, description="learning the background (1 of 2)")


class _Record:
    """Keeps what report and drawing need of each frame."""

    def __init__(self, run: Run, progress: Progress) -> None:
        self._pictures = run.inputs.pictures
        self._progress = progress

    def take(self, tracked: TrackedFrame) -> None:
        """Record a frame."""
        progress = self._progress
        detected = tracked.detected
        # The second pass has no pictures.
        pictured = self._pictures and detected.frame.picture is not NO_PICTURE
        progress.recorder.add(detected.frame if pictured else None, tracked.step, detected.seconds)
        progress.summaries.append(FrameSummary.of(tracked))
        if progress.signs is not None:
            progress.signs.see(tracked.step.number)
        progress.frames += 1
        progress.shakes = progress.shakes or len(detected.pose) > 0


class _Pace:
    """Measures the time of frames, and shows how far the run got."""

    def __init__(self, run: Run, progress: Progress, files: ExitStack, study: _Study) -> None:
        self._source = run.inputs.source
        self._progress = progress
        self._study = study
        # To load or to compile a kernel for arguments of new types Numba takes a lock, which is
        # recorded.
        self._locks = files.enter_context(event.install_recorder("numba:compiler_lock"))
        self._clock = time.perf_counter()

    def take(self, tracked: TrackedFrame) -> None:
        """Add the time since the last frame, unless kernels were compiled meanwhile."""
        progress = self._progress
        end = expected_end(self._source, progress.frames, self._study.title)
        self._study.advance(progress.frames, **end)
        before = self._clock
        self._clock = time.perf_counter()
        if self._locks.buffer or progress.frames == 1:
            progress.skipped += 1
            self._locks.buffer.clear()
        else:
            progress.seconds += self._clock - before


def _raise_if_nothing(run: Run, progress: Progress) -> None:
    """Raise what stopped the run if there was no frame."""
    source = run.inputs.source
    if not (progress.summaries or progress.stop or run.resume) and source.first > 1:
        # A segment of a batch, which always resumes, may lie behind the end of a file that is cut
        # short.
        progress.stop = InputError(source.problem, where="--frames")
    if not progress.summaries and progress.stop is not None:
        if not run.resume:
            run.directory.discard()
        raise progress.stop


def _smoothed(run: Run, progress: Progress) -> Tracks:
    """The corrected tracks. A signal that arrives meanwhile waits for them."""
    try:
        with uninterrupted():
            tracks = progress.tracker.tracks()
    except KeyboardInterrupt as stop:
        progress.stop = progress.stop or stop
        run.reporter.stopping(_STOPPED.format(progress.last))
    return tracks
