"""The same detections and settings give the same tracks, whatever runs them: a `Tracker` loop,
`track`, `batch`, `compare`, `live`, and the tracker that suggests labels and learns a scene.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from phdtrack import Tracker, config
from phdtrack.cli.batch import track_request
from phdtrack.compare import Request, plan
from phdtrack.compare.runs import run_input, tracked
from phdtrack.detect import TableDetector
from phdtrack.formats import DetectionsWriter, TracksWriter, read_detections
from phdtrack.formats.warp_files import WarpsWriter, read_warps
from phdtrack.label.suggestions import Evidence
from phdtrack.live.camera_setup import CameraSetup
from phdtrack.live.engine import Camera, CameraParts, CameraSettings
from phdtrack.run import (
    OutputRequest,
    RunObserver,
    RunRequest,
    SourceRequest,
    TrackedFrame,
    TrackingRequest,
    claim,
    prepare,
)
from phdtrack.run.camera_motion import mover_of
from phdtrack.run.choices import chosen_settings, scene_settings
from phdtrack.run.preparation import request_settings
from phdtrack.run.video_batch import BatchPlan
from phdtrack.scene import Scene, write_scene
from phdtrack.scene.training import learn_boxes
from phdtrack.types import Detections, DetectionTable, SequenceInfo, Tracks
from phdtrack.video import VideoWriter
from phdtrack.video.live_sources import LiveFrame, SourceStatus

pytestmark = pytest.mark.usefixtures("blank")

INFO = SequenceInfo(320, 240, 25.0, 50, "walkers")
NAMES = {0: "person", 3: "car"}
SEED = 1
WAIT = 120.0


@dataclass(frozen=True)
class Case:
    """Detections and settings.

    Attributes
    ----------
    folder : of a sequence as MOTChallenge lays it out, with the detections.
    sets : settings as ``--set`` takes them.
    warps : a file of the camera's motion; None for a camera that stands still.
    scene : a learned scene; None without.
    """

    folder: Path
    sets: tuple[str, ...] = ()
    warps: Path | None = None
    scene: Path | None = None

    @property
    def detections(self) -> Path:
        return self.folder / "det" / "det.txt"

    @property
    def table(self) -> DetectionTable:
        return read_detections(self.detections)

    @property
    def tracking(self) -> TrackingRequest:
        return TrackingRequest(sets=list(self.sets), seed=SEED)

    @property
    def motion(self) -> str:
        return str(self.warps) if self.warps else ""

    def settings(self) -> config.Settings:
        return chosen_settings(self.tracking, scene_settings(self.scene, self.motion))


def detections(rng: np.random.Generator, *, classes: bool) -> Iterator[Detections]:
    """Two people who cross and a car, with noise, misses and false alarms, frame by frame."""
    size = np.array([24, 60])
    for k in range(INFO.frames):
        corners = np.array([[10 + 5 * k, 60], [270 - 5 * k, 75], [140, 10 + 3 * k]], float)
        labels = np.array([0, 0, 3])
        noisy = corners + rng.normal(0, 1, corners.shape)
        detected = rng.random(len(corners)) < 0.9
        count = rng.poisson(2.0)
        left_top = np.vstack([noisy[detected], rng.uniform(0, [280, 170], (count, 2))])
        label = np.concatenate([labels[detected], rng.choice([0, 3], count)])
        score = rng.uniform(0.3, 1, len(left_top))
        boxes = np.hstack([left_top, left_top + size])
        yield Detections.of(boxes, score, label if classes else None)


def sequence(folder: Path, *, classes: bool = False) -> Path:
    """Write the sequence in MOTChallenge's layout."""
    (folder / "det").mkdir(parents=True)
    rng = np.random.default_rng(2)
    with DetectionsWriter(folder / "det" / "det.txt", NAMES if classes else None) as writer:
        for number, found in enumerate(detections(rng, classes=classes), start=1):
            writer.append(number, found)
    (folder / "seqinfo.ini").write_text(
        "[Sequence]\nname=walkers\nframeRate=25\nseqLength=50\nimWidth=320\nimHeight=240\n"
    )
    return folder


def plain(folder: Path) -> Case:
    return Case(sequence(folder))


def with_classes(folder: Path) -> Case:
    return Case(sequence(folder, classes=True), ('classes.together=[["person", "car"]]',))


def with_classes_apart(folder: Path) -> Case:
    return Case(sequence(folder, classes=True), ('classes.only=["person", "car"]',))


def with_limits(folder: Path) -> Case:
    return Case(sequence(folder), ("limits.max_detections=3", "limits.max_in_one_place=1"))


def with_camera_motion(folder: Path) -> Case:
    """The camera shakes by some pixels."""
    rng = np.random.default_rng(3)
    warps = folder.parent / "warps.csv"
    with WarpsWriter(warps) as writer:
        for number in range(2, INFO.frames + 1):
            warp = np.eye(3)
            warp[:2, 2] = rng.normal(0, 2, 2)
            writer.append(number, warp)
    # Otherwise the detections decide whether this motion is believed.
    return Case(sequence(folder), ("common_motion.kind=none",), warps=warps)


def with_scene(folder: Path) -> Case:
    """False alarms were learned on the left."""
    rng = np.random.default_rng(4)
    boxes = np.vstack(
        [rng.normal(60, 10, 300), rng.normal(90, 20, 300), np.full(300, 24.0), np.full(300, 60.0)]
    )
    learned = learn_boxes(boxes, 100, (320.0, 240.0), "false alarms").learned
    file = folder.parent / "scene.json"
    write_scene(file, Scene(320, 240, 1.0, "walkers", None, learned))
    return Case(sequence(folder), scene=file)


CASES = [plain, with_classes, with_classes_apart, with_limits, with_camera_motion, with_scene]


@pytest.fixture(scope="module", params=CASES, ids=lambda make: make.__name__)
def case(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Case:
    make: Callable[[Path], Case] = request.param
    return make(tmp_path_factory.mktemp("case") / "walkers")


class Loop:
    """A loop of one's own: online rows and corrected tracks."""

    def __init__(self, case: Case, folder: Path) -> None:
        settings = folder / "settings.toml"
        settings.write_text(f'scene = "{case.scene}"\n' if case.scene else "")
        codes = {name: code for code, name in case.table.names.items()}
        sections: dict[str, dict[str, object]] = {}
        for text in case.sets:
            name, _, value = text.partition("=")
            section, _, key = name.partition(".")
            for label, code in codes.items():
                value = value.replace(f'"{label}"', str(code))
            quoted = value if value[0] in "[0123456789" else f'"{value}"'
            sections.setdefault(section, {})[key] = json.loads(quoted)
        tracker = Tracker((320, 240), fps=25, seed=SEED, settings=settings, **sections)
        warps = read_warps(case.warps) if case.warps else None
        online = list[Tracks]()
        for number in range(1, INFO.frames + 1):
            warp = warps.between(number - 1, number) if warps else None
            moved = warp if warp is not None and len(warp) else None
            found = case.table.at(number)
            online.append(tracker.update(found, number, (number - 1) / INFO.fps, moved))
        self.online = Tracks.concatenate(online)
        self.tracks = tracker.tracks()
        self.left_out = tracker.left_out
        assert len(np.unique(self.tracks.identity)) >= 2


@pytest.fixture(scope="module")
def loop(case: Case) -> Loop:
    return Loop(case, case.folder)


class Online(RunObserver):
    """Keeps the online rows; ``last`` is set when the last frame was tracked."""

    def __init__(self) -> None:
        self.rows = list[Tracks]()
        self.last = threading.Event()

    def take(self, tracked: TrackedFrame) -> None:
        self.rows.append(tracked.rows)
        if tracked.step.number == INFO.frames:
            self.last.set()

    @property
    def tracks(self) -> Tracks:
        return Tracks.concatenate(self.rows)


def assert_same(given: Tracks, expected: Tracks) -> None:
    """Every array is the same, to the last bit."""
    assert (given.data, expected.data) == ({}, {})
    for name in [name for name in Tracks.__slots__ if name != "data"]:
        ours = getattr(given, name)
        theirs = getattr(expected, name)
        np.testing.assert_array_equal(ours, theirs, err_msg=name)
        assert (ours.dtype, ours.tobytes()) == (theirs.dtype, theirs.tobytes()), name


def test_the_cases_differ(tmp_path: Path) -> None:
    found = [Loop(make(tmp_path / make.__name__ / "walkers"), tmp_path) for make in CASES]
    contents = {(one.tracks.xyxy.tobytes(), one.tracks.class_id.tobytes()) for one in found}
    assert len(contents) == len(CASES)
    assert sum(found[CASES.index(with_limits)].left_out) > 0


def test_track_is_the_tracker_loop(case: Case, loop: Loop, tmp_path: Path) -> None:
    request = RunRequest(
        SourceRequest(detections=case.detections),
        case.tracking,
        OutputRequest(tmp_path / "run", scene=case.scene),
        video=False,
        camera_motion=case.motion,
    )
    online = Online()
    prepared = prepare(request)
    prepared = replace(prepared, observers=(*prepared.observers, online))
    result = prepared.run(claim(tmp_path / "run", overwrite=False))
    assert result.stop is None
    assert_same(result.tracks, loop.tracks)
    assert_same(online.tracks, loop.online)


def test_batch_is_the_tracker_loop(
    case: Case, loop: Loop, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["--no-video", "--seed", str(SEED)]
    for text in case.sets:
        words += ["--set", text]
    if case.scene:
        words += ["--scene", str(case.scene)]
    if case.warps:
        words += ["--camera-motion", str(case.warps)]
    out = tmp_path / "batch"
    (video,) = BatchPlan(track_request(words), tuple(words), out).videos([str(case.detections)])
    video()
    names = case.table.names or None
    with TracksWriter(tmp_path / "expected.csv", names) as writer:
        writer.append(loop.tracks, np.full((2, len(loop.tracks)), np.nan))
    written = video.folder / "tracks.csv"
    assert written.read_bytes() == (tmp_path / "expected.csv").read_bytes()


def test_compare_is_the_tracker_loop(case: Case, loop: Loop, tmp_path: Path) -> None:
    sets = (*scene_settings(case.scene, case.motion), *case.sets)
    made = plan(Request([str(case.folder)], filters=["pmb"], seeds=SEED, sets=sets))
    (run,) = made.runs
    assert run.seed == SEED
    assert_same(tracked(run, run_input(run, tmp_path)).tracks, loop.tracks)


class Replayed:
    """A camera whose pictures are all there at once."""

    def __init__(self) -> None:
        picture = np.zeros((INFO.height, INFO.width, 3), np.uint8)
        self._left = [
            LiveFrame(number, (number - 1) / INFO.fps, 1e9 + number / INFO.fps, picture)
            for number in range(INFO.frames, 0, -1)
        ]

    def start(self) -> None:
        """It is there."""

    def stop(self) -> None:
        """It ends by itself."""

    def next(self, patience: float) -> LiveFrame | None:
        return self._left.pop() if self._left else None

    def status(self) -> SourceStatus:
        return SourceStatus(
            "live", frames=INFO.frames, fps=INFO.fps, width=INFO.width, height=INFO.height
        )


def test_live_is_the_tracker_loop(case: Case, loop: Loop, tmp_path: Path) -> None:
    settings = case.settings()
    table = case.table
    names = table.names or None

    def parts(info: SequenceInfo) -> CameraParts:
        present = np.unique(table.detections.class_id).tolist() if names else None
        classes = config.build_classes(settings, info, names, present, moving=True)
        mover = mover_of(settings, classes.usual.model, pictures=True)
        return CameraParts(TableDetector(table), classes, info, seed=SEED, mover=mover)

    online = Online()
    camera = Camera(
        "walkers",
        Replayed(),  # type: ignore[arg-type]
        parts,
        CameraSettings(tmp_path / "live", video=0.0),
        observers=(online,),
    )
    camera.start()
    assert online.last.wait(WAIT), camera.problems
    assert camera.stop(WAIT)
    assert_same(online.tracks, loop.online)


@pytest.mark.parametrize("make", [plain, with_classes, with_limits, with_scene])
def test_suggestions_are_of_the_tracker_loop(make: Callable[[Path], Case], tmp_path: Path) -> None:
    case = make(tmp_path / "walkers")
    table = case.table
    classes = config.build_classes(case.settings(), INFO, table.names or None)
    evidence = Evidence.of(table, INFO.fps, range(1, INFO.frames + 1), classes, SEED)
    assert len(evidence.clutter) == len(table)
    assert_same(evidence.tracks, Loop(case, tmp_path).tracks)


@pytest.mark.parametrize("detector", ["change", "mog2", "person"])
@pytest.mark.parametrize("sets", [[], ["filter.kind=gm-phd"], ["sensor.box_noise=0.2"]])
def test_all_choose_the_settings_of_a_detector(
    detector: str, sets: list[str], tmp_path: Path
) -> None:
    video = tmp_path / "clip.mp4"
    with VideoWriter(video, 64, 48, 25.0) as writer:
        for _ in range(3):
            writer.write(np.zeros((48, 64, 3), np.uint8))
    tracking = TrackingRequest(sets=sets)
    source = SourceRequest(str(video), detector=detector)
    settings = request_settings(RunRequest(source, tracking))
    chosen = config.for_run(settings, endless=False).as_dict()
    run = plan(Request([str(video)], detectors=[detector], sets=sets, seeds=1)).runs[0]
    assert run.settings.as_dict() == chosen
    camera = CameraSetup(tracking, (), detector, None, None).settings().as_dict()
    # A camera has no end.
    assert camera.pop("associate") == chosen.pop("associate") | {"history": 90.0}
    assert camera == chosen
