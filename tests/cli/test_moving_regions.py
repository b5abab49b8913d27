"""Every command with a background detector says once what its boxes are."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from cli_runner import phdtrack

import networks
from phdtrack.detect import BACKGROUND
from phdtrack.detect.moving_regions import MOVING_REGIONS, reported_kind
from phdtrack.video import VideoWriter

SAID = MOVING_REGIONS.capitalize()
LINE = ("--line", "door=100,0,100,120")


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A video of 160x120 pixels in which a blob crosses the picture."""
    folder = tmp_path_factory.mktemp("clip")
    with VideoWriter(folder / "clip.mp4", 160, 120, 25.0) as writer:
        for k in range(70):
            left = max(0, 2 * k - 24)
            boxes = {0: (left, 30, min(160, 2 * k), 90)} if k else {}
            writer.write(networks.scene(160, 120, boxes).image)
    networks.write(folder / "net.onnx", metadata={"names": "{0: 'person', 1: 'car', 2: 'bus'}"})
    return folder / "clip.mp4"


@pytest.fixture
def work(clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.usefixtures("batch_here")
def test_each_command_says_what_moving_regions_are(work: Path, clip: Path) -> None:
    for words in (
        ("track", clip, "--no-video", "--out", "run"),
        ("count", "run", *LINE),
        ("count", clip, *LINE, "--out", "counts"),
        ("detect", clip, "--out", "found"),
        ("batch", clip, "--out", "all", "--jobs", "1", "--", "--detector", "mog2"),
        ("live", clip, "--out", "live", "--no-page", "--video", "0", "--duration", "2"),
    ):
        said = phdtrack(*words)
        assert said.status == 0, (words, said.err)
        assert (said.out + said.err).count(SAID) == 1, (words, said.out, said.err)


def test_run_has_its_doubt_and_objects_have_none(work: Path, clip: Path) -> None:
    moving = json.loads(phdtrack("track", clip, "--no-video", "--out", "run", "--json").out)
    doubtful = moving["doubtful_boxes"]
    assert doubtful["tracks"] == moving["tracks"] > 0
    assert doubtful["boxes"] == moving["track_rows"]
    assert doubtful["share"] < 0.2
    for more in (
        ("--detector", f"onnx:{clip.parent / 'net.onnx'}"),
        ("--detections", "run/detections.csv"),
    ):
        found = phdtrack("track", clip, "--no-video", "--out", "objects", "--overwrite", *more)
        assert found.status == 0, found.err
        assert SAID not in found.out + found.err
        assert json.loads(Path("objects/run.json").read_text())["doubtful_boxes"] is None


def test_detectors_that_learn_the_background_report_regions() -> None:
    assert all(SAID in reported_kind(name) for name in BACKGROUND)
    assert not any(map(reported_kind, ("person", "face", "onnx:net.onnx", "det.txt", "")))
