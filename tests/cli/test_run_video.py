"""One run, whatever stops it: what was computed is there and is consistent."""

from __future__ import annotations

import json
import signal
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path

import numba
import numpy as np
import pytest
from numba.core.compiler_lock import global_compiler_lock

from phdtrack.associate.graph import GraphMatching
from phdtrack.config import build, load
from phdtrack.errors import InputError
from phdtrack.filters import NoFilter
from phdtrack.filters.none import Raw
from phdtrack.final_rows import FinalTracks
from phdtrack.formats import DetectionsWriter, read_detections, read_tracks
from phdtrack.models import BoxClutter, BoxMotion, BoxSensor, MeasurementBirth
from phdtrack.multiclass import ClassSettings
from phdtrack.protocols import Model, Stages
from phdtrack.report import About, Annotator
from phdtrack.run import directory as rundir
from phdtrack.run.confirmation import detections_needed
from phdtrack.run.inputs import Inputs, expected_end
from phdtrack.run.observers import RunObserver
from phdtrack.run.pipeline_threads import DEPTH
from phdtrack.run.preparation import PreparedRun
from phdtrack.run.reporter import Advance, Silent
from phdtrack.run.running import RunOptions
from phdtrack.run.video import RunResult
from phdtrack.tracker import Tracker
from phdtrack.types import Detections, Frame, SequenceInfo, Tracks, Truth
from phdtrack.video import open_source

INFO = SequenceInfo(96, 64, 25.0, 0, "clip")
FRAMES = 20
FILES = {
    rundir.TRACKS,
    rundir.ONLINE,
    rundir.STATES,
    rundir.DETECTIONS,
    rundir.VIDEO,
    rundir.REPORT,
    rundir.RUN,
}


def box(number: int) -> list[float]:
    return [2.0 + 2 * number, 20.0, 14.0 + 2 * number, 44.0]


@dataclass
class Clip:
    """Frames with one moving bright box; fails with ``error`` instead of giving frame ``at``; may
    be gone through once.
    """

    error: BaseException | None = None
    at: int = 0
    once: bool = False
    problem: str = ""
    note: str = ""
    share: float = 0.0
    announced: int = 0
    first: int = 1
    last: int = 0
    info: SequenceInfo = INFO
    passes: int = 0

    @staticmethod
    def sample(_: int) -> Iterator[Frame]:
        """It cannot jump."""
        return iter(())

    def __iter__(self) -> Iterator[Frame]:
        self.passes += 1
        assert not (self.once and self.passes > 1), "a camera gives its frames once"
        for number in range(1, FRAMES + 1):
            if self.error is not None and number == self.at:
                raise self.error
            image = np.full((64, 96, 3), 40, np.uint8)
            left, top, right, bottom = (int(v) for v in box(number))
            image[top:bottom, left:right] = 220
            yield Frame(number, (number - 1) / 25.0, image)
        self.problem = (
            "clip.mp4: ends after frame 20, but its header announces 30; it may be truncated"
        )


class Looker:
    """Detects the box, and misses it in two frames."""

    def __call__(self, frame: Frame) -> Detections:
        return Detections.empty() if frame.number in (9, 10) else Detections.of([box(frame.number)])

    def reset(self) -> None:
        """It learns nothing."""


class Scholar(Looker):
    """Knows the scene until it is told to forget it."""

    studied = True

    def study(self, samples: Iterable[Frame]) -> None:
        """It knows all."""

    def scene_warnings(self) -> tuple[str, ...]:
        """The scene is odd."""
        return ("The scene is odd.",) if self.studied else ()

    def reset(self) -> None:
        """Forget the scene."""
        self.studied = False


@pytest.fixture
def job() -> PreparedRun:
    model = Model(
        BoxMotion(), BoxSensor(), MeasurementBirth(births_per_detection=0.25), BoxClutter(1.0)
    )
    stages = Stages(model, NoFilter(), Raw(), GraphMatching())
    clip = Clip()
    options = RunOptions(
        About("clip", "phdtrack track clip"),
        {"filter": {"name": "none"}},
        {"source": "clip", "detector": "looker"},
    )
    inputs = Inputs(INFO, clip, Looker(), "clip", "looker", pictures=True, again=True)
    return PreparedRun(inputs, ClassSettings(stages), options, load())


@pytest.fixture
def directory(tmp_path: Path) -> rundir.RunDirectory:
    return rundir.claim(tmp_path / "run", overwrite=False)


def reading(job: PreparedRun, **changes: object) -> PreparedRun:
    """The same job on another clip."""
    return replace(job, inputs=replace(job.inputs, source=Clip(**changes)))  # type: ignore[arg-type]


def consistent(
    directory: rundir.RunDirectory,
    outcome: RunResult,
    frames: int,
    *,
    video: bool = True,
    endless: bool = False,
) -> None:
    """All files are there, complete, and of the same ``frames`` frames."""
    present = FILES - (set() if video else {rundir.VIDEO})
    if not endless:
        # Of a source without end only the last frames are known.
        present |= {rundir.OBJECTS, rundir.MINUTES, rundir.HOURS, rundir.HEATMAP}
    assert {path.name for path in directory.path.iterdir()} == present
    assert outcome.document["frames"] == frames
    tracks = read_tracks(directory.file(rundir.TRACKS))
    assert tracks.frame.tolist() == list(range(1, frames + 1))
    assert set(tracks.identity) == {1}
    assert read_detections(directory.file(rundir.DETECTIONS)).last == frames
    document = json.loads(directory.file(rundir.RUN).read_text())
    assert document == outcome.document
    assert document["frames"] == frames
    assert document["complete"] is (outcome.stop is None)
    if video:
        assert len(list(open_source(directory.file(rundir.VIDEO)))) == frames


def test_a_whole_run(job: PreparedRun, directory: rundir.RunDirectory) -> None:
    outcome = job.run(directory)
    assert outcome.stop is None
    consistent(directory, outcome, FRAMES)
    tracks = read_tracks(directory.file(rundir.TRACKS))
    # The two frames that the detector missed are bridged, and say so.
    assert tracks.frame[tracks.predicted].tolist() == [9, 10]
    assert tracks.xyxy[8] == pytest.approx(box(9), abs=1.0)


@pytest.mark.parametrize(
    "error",
    [
        InputError("this frame is 10x10 pixels, the first one 96x64", where="clip, frame 13"),
        KeyboardInterrupt(),
        RuntimeError("a mistake of ours"),
    ],
)
def test_what_stops_a_run_loses_nothing(
    job: PreparedRun, directory: rundir.RunDirectory, error: BaseException
) -> None:
    outcome = reading(job, error=error, at=13).run(directory)
    assert outcome.stop is error
    consistent(directory, outcome, 12)
    said = "Ctrl-C" if isinstance(error, KeyboardInterrupt) else str(error)
    assert any("after frame 12" in warning and said in warning for warning in outcome.warnings)


@pytest.mark.parametrize("again", [True, False])
def test_the_scene_of_a_file_is_forgotten_at_its_end(
    job: PreparedRun, directory: rundir.RunDirectory, again: bool
) -> None:
    """What the detector says of it stands in the report; a camera's next segment goes on."""
    scholar = Scholar()
    outcome = replace(job, inputs=replace(job.inputs, detector=scholar, again=again)).run(directory)
    assert scholar.studied is not again
    assert "The scene is odd." in outcome.warnings


def test_a_run_that_was_stopped_is_scored_on_what_it_saw(
    job: PreparedRun, directory: rundir.RunDirectory
) -> None:
    number = np.arange(1, FRAMES + 1)
    truth = Truth(
        number,
        np.ones(FRAMES, np.int64),
        np.array([box(n) for n in number]),
        np.zeros(FRAMES, np.bool_),
    )
    job = reading(job, error=KeyboardInterrupt(), at=13)
    job = replace(job, options=replace(job.options, truth=truth))
    outcome = job.run(directory)
    assert outcome.scores is not None
    assert (outcome.scores.frames, outcome.scores.misses) == (12, 0)


def test_nothing_computed_leaves_nothing(job: PreparedRun, directory: rundir.RunDirectory) -> None:
    (directory.path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="frame 1"):
        reading(job, error=InputError("bad", where="clip, frame 1"), at=1).run(directory)
    assert [path.name for path in directory.path.iterdir()] == ["notes.txt"]


class Listener(Silent):
    """Keeps what a run reports of its progress, and why it stops."""

    def __init__(self) -> None:
        self.steps = list[tuple[int, object, object]]()
        self.stops = list[str]()

    def progress(self, title: str, total: int = 0) -> AbstractContextManager[Advance]:
        def advance(done: int, **more: object) -> None:
            self.steps.append((done, more.get("total"), more.get("description")))

        return nullcontext(advance)

    def stopping(self, sentence: str) -> None:
        self.stops.append(sentence)


def test_the_first_of_two_readings_is_shown(
    job: PreparedRun, directory: rundir.RunDirectory
) -> None:
    job = reading(job, announced=FRAMES)
    listener = Listener()
    replace(job, inputs=replace(job.inputs, detector=Scholar())).run(directory, listener)
    first = "learning the background (1 of 2)"
    assert (FRAMES - 1, FRAMES, first) in listener.steps
    second = (FRAMES, FRAMES, "tracking (2 of 2)")
    assert listener.steps.index(second) > listener.steps.index((FRAMES, FRAMES, first))


def test_one_reading_is_only_tracking(job: PreparedRun, directory: rundir.RunDirectory) -> None:
    listener = Listener()
    job.run(directory, listener)
    assert not [step for step in listener.steps if " of 2)" in str(step[2])]


def test_a_stop_in_the_first_reading_is_told(
    job: PreparedRun, directory: rundir.RunDirectory
) -> None:
    job = reading(job, error=KeyboardInterrupt(), at=13)
    listener = Listener()
    with pytest.raises(KeyboardInterrupt):
        replace(job, inputs=replace(job.inputs, detector=Scholar())).run(directory, listener)
    assert len(listener.stops) == 1
    assert listener.stops[0].startswith("stopped during the first of two readings of the video")
    assert "nothing is kept (--detector mog2 reads it once)" in listener.stops[0]
    assert not directory.path.exists()


@pytest.mark.parametrize("at", [0, 13])
def test_a_camera_gives_its_frames_once(
    job: PreparedRun, directory: rundir.RunDirectory, at: int
) -> None:
    clip = Clip(once=True, error=KeyboardInterrupt() if at else None, at=at)
    outcome = replace(job, inputs=replace(job.inputs, source=clip, again=False)).run(directory)
    consistent(directory, outcome, 12 if at else FRAMES, endless=True)


def test_an_interrupt_in_the_loop_stops_the_stages(
    job: PreparedRun, directory: rundir.RunDirectory
) -> None:
    """A real signal: it reaches the main thread, wherever that is, while source and detector are
    frames ahead.
    """

    class Signalling(Looker):
        def __call__(self, frame: Frame) -> Detections:
            if frame.number == 13:
                signal.raise_signal(signal.SIGINT)
            return super().__call__(frame)

    before = threading.active_count()
    outcome = replace(job, inputs=replace(job.inputs, detector=Signalling())).run(directory)
    assert isinstance(outcome.stop, KeyboardInterrupt)
    assert 12 - 2 * DEPTH <= outcome.document["frames"] <= FRAMES
    assert (
        json.loads(directory.file(rundir.RUN).read_text())["frames"] == outcome.document["frames"]
    )
    assert len(list(open_source(directory.file(rundir.VIDEO)))) == outcome.document["frames"]
    assert any("stopped by Ctrl-C after frame" in warning for warning in outcome.warnings)
    assert threading.active_count() == before


@pytest.fixture
def stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C comes while frame 7 is written."""
    real = DetectionsWriter.append

    def signalling(self: DetectionsWriter, number: int, found: Detections) -> None:
        if number == 7:
            signal.raise_signal(signal.SIGINT)
        real(self, number, found)

    monkeypatch.setattr(DetectionsWriter, "append", signalling)


@pytest.mark.usefixtures("stopped")
def test_an_interrupt_while_a_frame_is_written_waits_for_its_end(
    job: PreparedRun, directory: rundir.RunDirectory
) -> None:
    outcome = job.run(directory)
    assert isinstance(outcome.stop, KeyboardInterrupt)
    consistent(directory, outcome, 7)


def test_a_signal_waits_for_the_corrected_tracks(
    job: PreparedRun, directory: rundir.RunDirectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After the last frame; the run ends as after any other signal, with all its files."""
    real = Tracker.tracks

    def signalling(self: Tracker) -> Tracks:
        signal.raise_signal(signal.SIGINT)
        return real(self)

    monkeypatch.setattr(Tracker, "tracks", signalling)
    outcome = job.run(directory)
    assert isinstance(outcome.stop, KeyboardInterrupt)
    consistent(directory, outcome, FRAMES)


@pytest.mark.usefixtures("stopped")
def test_after_a_signal_a_long_video_is_not_drawn_to_its_end(
    job: PreparedRun, directory: rundir.RunDirectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("phdtrack.run.annotated_video.DRAWN_AFTER_SIGNAL", 0.0)
    outcome = job.run(directory)
    assert isinstance(outcome.stop, KeyboardInterrupt)
    assert len(list(open_source(directory.file(rundir.VIDEO)))) == 1
    assert len(read_tracks(directory.file(rundir.TRACKS))) == 7
    assert any(
        "annotated.mp4 ends after frame 1 because" in warning for warning in outcome.warnings
    )


def test_stopped_while_drawing(
    job: PreparedRun, directory: rundir.RunDirectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = Annotator.__call__
    drawn = count(1)

    def interrupted(self: Annotator, *args: object, **kwargs: object) -> object:
        if next(drawn) == 5:
            raise KeyboardInterrupt
        return real(self, *args, **kwargs)  # type: ignore[arg-type]

    monkeypatch.setattr(Annotator, "__call__", interrupted)
    outcome = job.run(directory)
    assert isinstance(outcome.stop, KeyboardInterrupt)
    assert outcome.document["frames"] == FRAMES
    assert len(read_tracks(directory.file(rundir.TRACKS))) == FRAMES
    assert len(list(open_source(directory.file(rundir.VIDEO)))) == 4
    assert any("while the video was drawn" in warning for warning in outcome.warnings)


def test_an_observer_gets_all_corrected_tracks_of_a_camera(
    job: PreparedRun, directory: rundir.RunDirectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The tracker has forgotten the first of them by then."""
    given = list[Tracks]()

    class Keeper(RunObserver):
        all_tracks = True

        def finish(self, directory: rundir.RunDirectory, tracks: Tracks) -> None:
            given.append(tracks)

    monkeypatch.setattr(
        "phdtrack.run.run_files.FinalTracks", partial(FinalTracks, lag=0.1, every=0.1)
    )
    short = replace(job.classes.usual, associator=GraphMatching(history=0.4))
    camera = replace(job.inputs, source=Clip(once=True), again=False)
    options = replace(job.options, video=False)
    job = replace(job, classes=ClassSettings(short), inputs=camera, options=options)
    replace(job, observers=(Keeper(),)).run(directory)
    (whole,) = given
    tracks = read_tracks(directory.file(rundir.TRACKS))
    assert whole.frame.tolist() == tracks.frame.tolist() == list(range(1, FRAMES + 1))
    np.testing.assert_array_equal(whole.identity, tracks.identity)


@pytest.mark.parametrize("again", [True, False])
@pytest.mark.parametrize("size", [48, 96, 300])
def test_the_video_may_be_smaller_than_the_pictures(
    job: PreparedRun, directory: rundir.RunDirectory, size: int, *, again: bool
) -> None:
    """With the tracks where they are in the pictures, also of a source whose pictures come once."""
    options = replace(job.options, video_size=size)
    replace(job, options=options, inputs=replace(job.inputs, again=again)).run(directory)
    width = min(size, 96)
    height = min(size, 96) * 2 // 3
    pictures = [frame.image for frame in open_source(directory.file(rundir.VIDEO))]
    assert [image.shape for image in pictures] == [(height, width, 3)] * FRAMES
    tracks = read_tracks(directory.file(rundir.TRACKS if again else rundir.ONLINE))
    # At the beginning online tracks are not confirmed, and drawn faintly.
    tracks = tracks.select(tracks.confirmed & ~tracks.predicted & (tracks.frame > 5))
    assert len(tracks) > 10
    for number, corners in zip(tracks.frame.tolist(), tracks.xyxy, strict=True):
        left, top, right, bottom = np.round(corners * width / 96).astype(int)
        image = pictures[number - 1].astype(int)
        assert (
            image[top + 2 : bottom - 1, left + 2 : right - 1].mean()
            > 150
            > 90
            > image[bottom + 6 :].mean()
        )
        # The pictures are grey: what has a colour was drawn.
        colour = np.ptp(image, axis=2)
        assert (
            colour[top + 2 : bottom - 1, [left, right]].mean()
            > 40
            > 10
            > colour[bottom + 6 :].mean()
        )


def test_no_video_is_too_small_for_an_encoder(
    job: PreparedRun, directory: rundir.RunDirectory
) -> None:
    job = replace(job, options=replace(job.options, video_size=1))
    assert job.run(directory).stop is None
    assert {frame.image.shape for frame in open_source(directory.file(rundir.VIDEO))} == {
        (16, 24, 3)
    }


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_frames_that_compile_are_left_out_of_the_speed(
    job: PreparedRun, directory: rundir.RunDirectory
) -> None:
    job.run(directory)
    # Nothing is compiled any more; the first frame waits for all that comes before it.
    assert job.run(directory).document["frames_left_out"] == 1
    double = numba.njit(lambda x: 2 * x)

    class Compiling(Looker):
        def __call__(self, frame: Frame) -> Detections:
            # Other types than before are compiled for; the same types are not.
            double(np.ones(2) if frame.number >= 15 else 1.0)
            return super().__call__(frame)

    compiling = replace(job, inputs=replace(job.inputs, detector=Compiling()))
    found = compiling.run(directory).document
    # A compilation may reach into the frames that are tracked meanwhile.
    assert 2 <= found["frames_left_out"] <= 6
    assert found["frames_per_second"] > 0


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_kernels_compiled_at_the_end_do_not_count_for_speed(
    job: PreparedRun, directory: rundir.RunDirectory
) -> None:
    """A first run compiles what joins and smooths the tracks, too."""

    class Compiling(RunObserver):
        def finish(self, directory: rundir.RunDirectory, tracks: Tracks) -> None:
            with global_compiler_lock:
                time.sleep(2.0)

    found = replace(job, observers=(Compiling(),)).run(directory).document
    assert found["seconds"] > 2.0
    assert found["frames"] / found["frames_per_second"] < 2.0


@pytest.mark.parametrize("rate", [7.0, 25.0])
def test_the_object_that_is_tried_moves(rate: float) -> None:
    """One that stands from its first frame on may be a false alarm that lasts: the note would warn
    of every run.
    """
    info = SequenceInfo(768, 576, rate)
    assert 1 <= detections_needed(build(load(), info), info, (40.0, 100.0)) <= 5


@pytest.mark.parametrize(
    ("frames", "announced", "share", "done", "total", "estimated"),
    [
        (300, 0, 0.0, 20, 300, False),
        (0, 795, 0.001, 1, 795, False),
        # A key frame of many bytes, and a scene that grows calm: the header holds.
        (0, 795, 0.2, 20, 795, False),
        (0, 795, 0.6, 350, 795, False),
        # Cut in the middle; more frames than announced; no header.
        (0, 795, 0.5, 200, 400, True),
        (0, 795, 0.5, 900, 1800, True),
        (0, 0, 0.01, 8, None, False),
        (0, 0, 0.1, 80, 800, True),
    ],
)
def test_the_end_of_a_bar(
    frames: int, announced: int, share: float, done: int, total: int | None, estimated: bool
) -> None:
    """What the file tells, as long as it does not contradict what was read of it; what is estimated
    is called so.
    """
    source = Clip(info=replace(INFO, frames=frames), share=share, announced=announced)
    said = expected_end(source, done, "detecting")
    assert (said["total"], "estimated" in said["description"]) == (total, estimated)
