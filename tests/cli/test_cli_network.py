"""A network as the detector of each command, and runs that take the detections of an earlier
one.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from cli_runner import phdtrack, refused

import networks
from phdtrack.config import load
from phdtrack.detect.change import ChangeDetector
from phdtrack.detect.onnx import OnnxDetector
from phdtrack.errors import InputError
from phdtrack.formats import read_detections
from phdtrack.live.camera_setup import CameraSetup
from phdtrack.run import directory as rundir
from phdtrack.run.preparation import prepare
from phdtrack.run.requests import RunRequest, SourceRequest, TrackingRequest
from phdtrack.state import blocks, to_bytes
from phdtrack.types import SequenceInfo
from phdtrack.video import VideoWriter

NAMES = {"names": "{0: 'person', 1: 'car', 2: 'bus'}"}
ROWS = (rundir.TRACKS, rundir.ONLINE, rundir.STATES, rundir.DETECTIONS)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with clip.mp4, in which a red and a blue blob move, and net.onnx, which finds
    them.
    """
    folder = tmp_path_factory.mktemp("made")
    with VideoWriter(folder / "clip.mp4", 200, 120, 25.0) as writer:
        for k in range(30):
            boxes = {0: (10 + 4 * k, 20, 34 + 4 * k, 80), 2: (150 - 2 * k, 84, 190 - 2 * k, 110)}
            writer.write(networks.scene(200, 120, boxes).image)
    networks.write(folder / "net.onnx", metadata=NAMES)
    return folder


@pytest.fixture
def work(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copytree(made, tmp_path / "work")
    monkeypatch.chdir(tmp_path / "work")
    return tmp_path / "work"


def track(*more: object, detector: str = "onnx:net.onnx") -> dict[str, object]:
    """What the run in `run` says of itself."""
    said = phdtrack(
        "track", "clip.mp4", "--detector", detector, "--out", "run", "--no-video", "--json", *more
    )
    assert said.status == 0, said.err
    document = json.loads(Path("run/run.json").read_text())
    assert ("detections are those of an earlier run" in said.err) == document.get(
        "detections_reused", False
    )
    return document


def rows(folder: str = "run") -> list[bytes]:
    return [(Path(folder) / name).read_bytes() for name in ROWS]


def test_a_network_has_the_default_settings_and_its_classes(
    work: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    document = track()
    assert document["configuration"]["preset"] == "default"  # type: ignore[index]
    assert document["input"]["network"][1] == (work / "net.onnx").stat().st_size  # type: ignore[index]
    classes = [line.split(",")[12] for line in Path("run/tracks.csv").read_text().splitlines()]
    assert set(classes) == {"person", "bus"}

    def never(*_: object) -> None:
        raise AssertionError("it was looked at again")

    with monkeypatch.context() as during:
        during.setattr(OnnxDetector, "detect_batch", never)
        assert track("--overwrite", "--classes", "bus")["detections_reused"] is True
    assert {line.split(",")[12] for line in Path("run/tracks.csv").read_text().splitlines()} == {
        "bus"
    }
    assert "There are person, car, bus" in refused(
        "track", "clip.mp4", "--detector", "onnx:net.onnx", "--out", "x", "--classes", "tram"
    )


def test_guess_about_the_outputs_is_reported_once(work: Path) -> None:
    networks.write(work / "bare.onnx", "end2end")
    for command in ("track", "detect"):
        said = phdtrack(command, "clip.mp4", "--detector", "onnx:bare.onnx", "--out", command)
        assert said.status == 0, said.err
        assert (said.out + said.err).count("This is a guess") == 1
    document = json.loads(Path("track", "run.json").read_text())
    assert "read as final boxes" in document["warnings"][0]


@pytest.mark.parametrize(
    ("layout", "classes", "red", "blue"),
    # COCO's own numbers count from 1, with gaps: 0 has no name.
    [
        ("yolov8", 80, "person", "car"),
        ("yolov5", 80, "person", "car"),
        ("rfdetr", 91, "0", "bicycle"),
    ],
)
def test_classes_without_names_are_those_of_coco(
    work: Path, layout: str, classes: int, red: str, blue: str
) -> None:
    networks.write(work / "coco.onnx", layout, classes=classes)
    document = track(detector="onnx:coco.onnx")
    assert f"its {classes} classes are called as in COCO" in " ".join(document["warnings"])  # type: ignore[arg-type]
    assert f"2 objects ({red} 1, {blue} 1)" in document["summary"][0]  # type: ignore[index]
    track("--overwrite", "--classes", blue, detector="onnx:coco.onnx")
    found = {line.split(",")[12] for line in Path("run/tracks.csv").read_text().splitlines()}
    assert found == {blue}


def test_names_of_the_file_or_of_nobody_are_no_guess(work: Path) -> None:
    named = {"names": str({k: f"kind {k}" for k in range(80)})}
    networks.write(work / "named.onnx", metadata=named, classes=80)
    networks.write(work / "few.onnx", classes=7)
    for file, objects in (("named", "kind 0 1, kind 2 1"), ("few", "0 1, 2 1")):
        document = track("--overwrite", detector=f"onnx:{file}.onnx")
        assert "COCO" not in " ".join(document["warnings"])  # type: ignore[arg-type]
        assert f"2 objects ({objects})" in document["summary"][0]  # type: ignore[index]


@pytest.mark.parametrize("name", ["net.pt", "onnx:net.pt", "onnx:net.PTH", "net.safetensors"])
def test_weights_in_place_of_a_network_are_told_to_be_exported(work: Path, name: str) -> None:
    (work / name.removeprefix("onnx:")).write_bytes(b"PK weights")
    said = refused("track", "clip.mp4", "--detector", name, "--out", "x")
    assert "yolo export model=net." in said
    assert "--detector onnx:net.onnx" in said


def test_unknown_class_of_many_suggests_the_nearest(work: Path) -> None:
    networks.write(work / "coco.onnx", classes=80)
    network = ("track", "clip.mp4", "--detector", "onnx:coco.onnx", "--out", "x")
    assert "Did you mean person?" in refused(*network, "--classes", "persn")


def test_every_command_takes_a_network(work: Path) -> None:
    network = ("clip.mp4", "--detector", "onnx:net.onnx")
    assert (
        phdtrack(
            "detect", *network, "--out", "found", "--classes", "bus", "--set", "detector.batch=4"
        ).status
        == 0
    )
    found = read_detections(work / "found" / "detections.csv")
    assert (len(found), set(found.names.values())) == (30, {"bus"})
    assert "has no parameter 'classes'" in refused(
        "detect", "clip.mp4", "--out", "x", "--classes", "bus"
    )
    for _ in range(2):
        learned = phdtrack(
            "learn",
            *network,
            "--clutter",
            "unattended",
            "--set",
            "detector.classes=person",
            "--overwrite",
        )
        assert "nothing could be learned" in learned.err or learned.status == 0, learned.err
    kept = next((work / "runs").glob("clip.labels.onnx-*.detections.csv"))
    assert f"those of {kept.relative_to(work)}" in learned.err
    quick = ("--filters", "none", "--seeds", 1, "--jobs", 1)
    assert (
        phdtrack(
            "compare", "clip.mp4", "--detectors", "onnx:net.onnx", *quick, "--out", "compared"
        ).status
        == 0
    )


def test_live_knows_the_classes_of_a_network_at_once(work: Path) -> None:
    make = CameraSetup(TrackingRequest(classes="bus"), (), "onnx:net.onnx", 100, None)
    made = make(SequenceInfo(200, 120, 25.0))
    assert (made.classes.only, dict(made.classes.names)) == (
        (2,),
        {0: "person", 1: "car", 2: "bus"},
    )
    assert made.detector(
        networks.scene(200, 120, {0: (10, 10, 60, 60), 2: (90, 10, 140, 60)})
    ).class_id.tolist() == [2]
    wrong = CameraSetup(TrackingRequest(classes="bud"), (), "onnx:net.onnx", 0, None)
    with pytest.raises(InputError, match=r"no class bud\. Did you mean bus"):
        wrong.new_detector(wrong.settings(), 0)


@pytest.mark.parametrize(
    "detector",
    ["onnx:net.onnx", *(pytest.param(name, marks=pytest.mark.slow) for name in ("change", "mog2"))],
)
def test_what_was_detected_is_used_again_and_gives_the_same(detector: str, work: Path) -> None:
    moving = ("--set", "camera_motion.kind=flow")
    other = ("--overwrite", "--set", "motion.acceleration=2")
    assert "detections_reused" not in track(*moving, detector=detector)
    first = rows()
    motion = Path("run/camera_motion.csv").read_bytes()
    # Another tracker, of a camera that stands; and the first run again.
    assert track(*other, detector=detector)["detections_reused"] is True
    again = rows()
    assert again[3] == first[3]
    assert again != first
    assert track("--overwrite", *moving, detector=detector)["detections_reused"] is True
    assert (rows(), Path("run/camera_motion.csv").read_bytes()) == (first, motion)
    assert "detections_reused" not in track(*other, "--detect-again", detector=detector)
    assert rows() == again


@pytest.mark.parametrize(
    ("part", "value"),
    [("sources_digest", lambda home: "other"), ("detecting_packages", lambda: {"av": "99.0"})],
)
def test_other_code_detects_anew(
    work: Path, monkeypatch: pytest.MonkeyPatch, part: str, value: Callable[..., object]
) -> None:
    def reused() -> bool:
        return "detections_reused" in track("--overwrite", detector="onnx:net.onnx")

    assert [reused(), reused()] == [False, True]
    monkeypatch.setattr(f"phdtrack.run.preparation.{part}", value)
    assert [reused(), reused()] == [False, True]


def test_another_video_detector_or_setting_is_detected_anew(work: Path) -> None:
    """All that the detections depend on, and nothing else, is looked at."""
    cv2.imwrite("roi.png", np.full((120, 200), 255, np.uint8))
    shutil.copy("clip.mp4", "later.mp4")

    def looked(*sets: str, **more: object) -> object:
        source = SourceRequest(
            **{"source": "clip.mp4", "detector": "onnx:net.onnx", "mask": Path("roi.png"), **more}
        )  # type: ignore[arg-type]
        return prepare(RunRequest(source), settings=load(None, sets)).options.detected_by

    first = looked()
    assert first
    assert (
        looked("motion.acceleration=2", source=str(work / "clip.mp4"), detect_again=True) == first
    )
    given: list[dict[str, object]] = [
        {"max_width": 100},
        {"fps": 12.0},
        {"mask": None},
        {"detector": "change"},
    ]
    assert all(looked(**one) != first for one in (*given, {"source": "later.mp4"}))
    assert looked("detector.confidence=0.5") != first
    for change in (
        lambda: Path("later.mp4").replace("clip.mp4"),
        lambda: cv2.imwrite("roi.png", np.full((120, 200), 254, np.uint8)),
        lambda: networks.write(work / "net.onnx", "end2end", metadata=NAMES),
    ):
        before = looked()
        change()
        assert looked() != before
    (work / "det.csv").write_text("frame,left,top,width,height\n1,1,1,20,20\n")
    assert looked(detections=Path("det.csv"), detector="", mask=None) == {}
    words = ("track", "clip.mp4", "--detections", "det.csv", "--detect-again")
    assert "Leave out --detect-again" in refused(*words)


def test_an_interrupted_run_leaves_no_detections_to_reuse(
    work: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = ChangeDetector.__call__
    calls = list[int]()

    def stopped(self: ChangeDetector, frame: object) -> object:
        calls.append(1)
        if len(calls) == 12:
            raise InputError("it stops here")
        return real(self, frame)  # type: ignore[arg-type]

    words = ("track", "clip.mp4", "--out", "run", "--no-video")
    with monkeypatch.context() as during:
        during.setattr(ChangeDetector, "__call__", stopped)
        assert "it stops here" in phdtrack(*words).err
    assert not Path("run", rundir.DETECTED).exists()
    assert "detections_reused" not in track("--resume", detector="change")
    kept = Path("run", rundir.DETECTED)
    whole = rows()
    assert track("--overwrite", detector="change")["detections_reused"] is True
    assert rows() == whole
    with kept.open("rb") as log:
        ends = [end for end, _ in blocks(log)]
    kept.write_bytes(kept.read_bytes()[: ends[10]])
    assert "does not fit the source. Say --detect-again" in phdtrack(*words, "--overwrite").err
    kept.write_bytes(to_bytes({"other": 1}))
    assert "detections_reused" not in track("--overwrite", detector="change")
