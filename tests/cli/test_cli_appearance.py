"""Appearance on the command line: from pictures, from a file, and from an earlier run."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runner import phdtrack, refused, walkers
from typer.testing import CliRunner

from phdtrack import Tracker
from phdtrack.cli.app import application
from phdtrack.detect.colours import Colours
from phdtrack.errors import InputError
from phdtrack.formats import read_detections, read_tracks
from phdtrack.live.camera_setup import CameraSetup
from phdtrack.live.engine import Camera, CameraSettings
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
from phdtrack.run.detection_log import load_detections, save_detections
from phdtrack.run.loop import DetectedFrame
from phdtrack.run.preparation import claim_directory
from phdtrack.run.requests import DEFAULT_APPEARANCE
from phdtrack.types import Detections, Frame, Image, SequenceInfo
from phdtrack.video import VideoWriter, open_source
from phdtrack.video.live_sources import LiveFrame, SourceStatus

FRAMES = 30
EMBEDDINGS = "detections.npy"


def pictures(frames: int = FRAMES) -> list[Image]:
    """Pictures 320x240 of `walkers`: one of them in red, the other in blue."""
    rng = np.random.default_rng(5)
    ground = rng.integers(110, 130, (240, 320, 3))
    out = list[Image]()
    for k in range(1, frames + 1):
        image = (ground + rng.integers(-2, 3, ground.shape)).astype(np.uint8)
        for x, y, colour in ((20 + 5 * k, 60, (30, 30, 190)), (270 - 5 * k, 150, (190, 70, 30))):
            image[y : y + 60, max(x, 0) : max(x + 24, 0)] = colour
        out.append(image)
    return out


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of `walkers`, with their video."""
    folder = walkers(tmp_path_factory.mktemp("scene") / "walkers", FRAMES)
    with VideoWriter(folder / "walkers.mp4", 320, 240, 25.0) as writer:
        for image in pictures():
            writer.write(image)
    return folder


@pytest.fixture(scope="module")
def given(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run with colours of given detections."""
    out = tmp_path_factory.mktemp("given") / "run"
    said = phdtrack(
        *track(scene, out), "--detections", scene / "det" / "det.txt", "--appearance", "colours"
    )
    assert said.status == 0, said.err
    return out


def track(scene: Path, out: Path) -> list[object]:
    return ["track", scene / "walkers.mp4", "--out", out, "--no-video"]


def boxes_alone(scene: Path, out: Path) -> list[object]:
    return ["track", "--detections", scene / "det" / "det.txt", "--out", out]


def read(run: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((run / "run.json").read_text())
    return found


def test_colours_are_kept_beside_the_detections(scene: Path, given: Path) -> None:
    kept = np.load(given / EMBEDDINGS)
    table = read_detections(given / "detections.csv")
    assert (kept.dtype, kept.shape) == (np.float16, (len(table), Colours().length))
    assert read(given)["input"]["appearance"] == {"name": "colours"}
    for frame in open_source(scene / "walkers.mp4"):
        found = table.at(frame.number)
        rows = table.file_row[table.places(frame.number)]
        expected = Colours().describe(frame.image, found.xyxy)
        np.testing.assert_allclose(kept[rows].astype(np.float32), expected, atol=2e-2)


def test_files_of_a_blurred_run_hold_descriptors_alone(
    scene: Path, given: Path, tmp_path: Path
) -> None:
    """The same as without ``--blur``: shares of colours, a row for each detection, no picture."""
    out = tmp_path / "run"
    words = ("--detections", scene / "det" / "det.txt", "--appearance", "colours")
    assert phdtrack(*track(scene, out), *words, "--blur", "boxes").status == 0
    assert (out / EMBEDDINGS).read_bytes() == (given / EMBEDDINGS).read_bytes()
    kept = np.load(out / EMBEDDINGS).astype(np.float64)
    rows = len((out / "detections.csv").read_text().splitlines())
    assert kept.shape == (rows, Colours().length)
    np.testing.assert_allclose(np.square(kept).sum(axis=1), 1.0, atol=5e-3)
    # Nothing else of the size of a picture: that of the report is hidden.
    others = {path.suffix for path in out.iterdir() if path.is_file()}
    assert others == {".csv", ".npy", ".html", ".json"}
    document = (out / "run.json").read_text() + (out / "detections.csv").read_text()
    assert "embeddings" not in document


def test_a_loop_with_images_gives_the_same_tracks(scene: Path, given: Path) -> None:
    table = read_detections(scene / "det" / "det.txt")
    tracker = Tracker((320, 240), fps=25.0)
    for frame in open_source(scene / "walkers.mp4"):
        tracker.update(table.at(frame.number), frame.number, frame.time, image=frame.image)
    expected = read_tracks(given / "tracks.csv")
    found = tracker.tracks()
    assert len(found) > 40
    np.testing.assert_array_equal(found.identity, expected.identity)
    np.testing.assert_allclose(found.xyxy, expected.xyxy, atol=1e-3)


def test_tracking_the_detections_again_uses_them(scene: Path, given: Path, tmp_path: Path) -> None:
    again = tmp_path / "again"
    words = ["track", "--detections", given / "detections.csv", "--fps", 25]
    words += ["--frame-size", "320x240"]
    said = phdtrack(*words, "--out", again)
    assert said.status == 0, said.err
    assert f"{given / EMBEDDINGS}: what the detections look like is read from it" in said.err
    assert (again / EMBEDDINGS).read_bytes() == (given / EMBEDDINGS).read_bytes()
    assert read_tracks(again / "tracks.csv").identity.tolist() == (
        read_tracks(given / "tracks.csv").identity.tolist()
    )
    plain = tmp_path / "plain"
    said = phdtrack(*words, "--out", plain, "--appearance", "none")
    assert (said.status, said.err) == (0, "")
    assert not (plain / EMBEDDINGS).exists()
    assert "appearance" not in read(plain)["input"]


def test_a_file_of_other_rows_is_told_and_not_used(given: Path, tmp_path: Path) -> None:
    shutil.copytree(given, tmp_path / "run")
    rows = (tmp_path / "run" / "detections.csv").read_text().splitlines()
    (tmp_path / "run" / "detections.csv").write_text("\n".join(rows[:-1]) + "\n")
    words = ["track", "--detections", tmp_path / "run" / "detections.csv", "--fps", 25]
    words += ["--frame-size", "320x240", "--out", tmp_path / "out"]
    said = phdtrack(*words)
    assert said.status == 0
    assert f"expected {len(rows) - 1} rows" in said.err
    assert "It is not used." in said.err
    assert not (tmp_path / "out" / EMBEDDINGS).exists()
    assert "expected 59 rows" in refused(
        *words, "--overwrite", "--appearance", tmp_path / "run" / EMBEDDINGS
    )


def test_a_file_has_a_row_for_each_row_in_any_order(scene: Path, tmp_path: Path) -> None:
    rows = (scene / "det" / "det.txt").read_text().splitlines()
    order = np.random.default_rng(1).permutation(len(rows))
    shutil.copytree(scene, tmp_path / "mixed")
    (tmp_path / "mixed" / "det" / "det.txt").write_text("\n".join(rows[k] for k in order) + "\n")
    # The left side, which the row of a detection has too.
    looks = np.array([[float(rows[k].split(",")[2]), 1] for k in order], np.float32)
    np.save(tmp_path / "looks.npy", looks)
    out = tmp_path / "out"
    words = boxes_alone(tmp_path / "mixed", out)
    said = phdtrack(*words, "--appearance", tmp_path / "looks.npy")
    assert said.status == 0, said.err
    kept = np.load(out / EMBEDDINGS)
    left = read_detections(out / "detections.csv").detections.xyxy[:, 0]
    assert kept.dtype == np.float32
    np.testing.assert_allclose(kept[:, 0], left, atol=1e-3)
    name = read(out)["input"]["appearance"]
    assert (name["name"], name["file"][0]) == (str(tmp_path / "looks.npy"),) * 2


@pytest.mark.slow
def test_background_detections_keep_their_colours(scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    words = [*track(scene, out), "--appearance", "colours"]
    assert phdtrack(*words).status == 0
    kept = (out / EMBEDDINGS).read_bytes()
    rows = np.load(out / EMBEDDINGS)
    assert len(rows) == len((out / "detections.csv").read_text().splitlines())
    assert rows.any(axis=1).all()
    # From the detections of the first run, with its embeddings and without.
    said = phdtrack(*words, "--overwrite", "--json")
    assert said.object["detections_reused"] is True
    assert (out / EMBEDDINGS).read_bytes() == kept
    plain = ["--appearance", "none"]
    said = phdtrack(*track(scene, out), "--overwrite", "--json", *plain)
    assert said.object["detections_reused"] is True
    assert not (out / EMBEDDINGS).exists()
    other = tmp_path / "other"
    assert phdtrack(*track(scene, other), *plain).status == 0
    said = phdtrack(*track(scene, other), "--overwrite", "--appearance", "colours", "--json")
    assert said.object["detections_reused"] is True
    assert (other / EMBEDDINGS).read_bytes() == kept


class Stopping(RunObserver):
    """Ends a run after some frames."""

    def __init__(self, frames: int) -> None:
        self.left = frames

    def take(self, tracked: TrackedFrame) -> None:
        """Count a frame."""
        self.left -= 1
        if not self.left:
            raise KeyboardInterrupt


@pytest.mark.slow
def test_a_resumed_run_has_the_same_embeddings(scene: Path, tmp_path: Path) -> None:
    def request(out: Path, *, resume: bool = False) -> RunRequest:
        return RunRequest(
            SourceRequest(str(scene / "walkers.mp4")),
            TrackingRequest(appearance="colours"),
            OutputRequest(out, resume=resume, learn=False),
            video=False,
            checkpoint_every=0.001,
        )

    whole = prepare(request(tmp_path / "whole")).run(claim(tmp_path / "whole", False))
    assert whole.stop is None
    stopped = prepare(request(tmp_path / "part"))
    stopped = replace(stopped, observers=(Stopping(12),))
    assert stopped.run(claim(tmp_path / "part", False)).stop is not None
    again = request(tmp_path / "part", resume=True)
    prepared = prepare(again)
    rest = prepared.run(claim_directory(prepared, again), resume=True)
    assert rest.document["resumed_from_frame"]
    for name in (EMBEDDINGS, "detections.csv", "tracks.csv"):
        assert (tmp_path / "part" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


@pytest.mark.parametrize("exact", [False, True])
def test_the_log_keeps_embeddings_to_the_bit(tmp_path: Path, exact: bool) -> None:
    looks = np.random.default_rng(2).normal(size=(2, 5)).astype(np.float32)
    if not exact:
        looks = looks.astype(np.float16).astype(np.float32)
    looks[0] = np.nan
    found = Detections.of([[0, 0, 9, 9], [5, 5, 20, 30]], embeddings=looks)
    frames = [
        DetectedFrame(Frame(1, 0.0, np.zeros((0, 0, 3), np.uint8)), found),
        DetectedFrame(Frame(2, 0.1, np.zeros((0, 0, 3), np.uint8)), Detections.empty()),
    ]
    for _ in save_detections(tmp_path / "log", frames):
        pass
    first, second = load_detections(tmp_path / "log")
    assert first.detections.embeddings is not None
    np.testing.assert_array_equal(first.detections.embeddings, looks)
    assert first.detections.embeddings.dtype == np.float32
    assert second.detections.embeddings is None


@pytest.mark.slow
def test_segments_are_joined_with_their_embeddings(scene: Path, tmp_path: Path) -> None:
    rest = ["--", "--no-video", "--appearance", "colours"]
    words = ["batch", scene / "walkers.mp4", "--jobs", 1, "--out", tmp_path / "parts"]
    said = phdtrack(*words, "--segment", "0.6s", "--overlap", "0.3s", *rest)
    assert said.status == 0, said.err
    run = tmp_path / "parts" / "runs" / "walkers"
    table = read_detections(run / "detections.csv")
    kept = np.load(run / EMBEDDINGS)
    assert len(kept) == table.rows > 40
    for frame in open_source(scene / "walkers.mp4"):
        rows = table.file_row[table.places(frame.number)]
        expected = Colours().describe(frame.image, table.at(frame.number).xyxy)
        np.testing.assert_allclose(kept[rows].astype(np.float32), expected, atol=2e-2)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--appearance", "colours"], "colours: it is read from pictures, and there are none"),
        (["--appearance", "colors"], "colours: it is read from pictures, and there are none"),
        (["--appearance", "hues"], "there is no appearance 'hues'. There are colours, none, onnx:"),
        (["--appearance", "net.onnx"], "there is no appearance 'net.onnx'. Say onnx:net.onnx"),
        (["--appearance", "no.npy"], "no.npy: there is no such file"),
        (["--set", "embedding.mean=[1]"], "embedding.mean: expected three numbers"),
    ],
)
def test_appearance_without_pictures(
    scene: Path, tmp_path: Path, words: Sequence[str], message: str
) -> None:
    assert message in refused(*boxes_alone(scene, tmp_path / "out"), *words)
    assert not (tmp_path / "out").exists()


def test_a_file_needs_the_rows_of_detections(scene: Path, given: Path, tmp_path: Path) -> None:
    words = [*track(scene, tmp_path / "out"), "--appearance", given / EMBEDDINGS]
    assert "Say --detections FILE, too." in refused(*words)
    words = ["track", "--detections", "-", "--frame-size", "320x240", "--fps", 25]
    words += ["--appearance", given / EMBEDDINGS]
    assert "a row for each row of a file of detections" in refused(*words)
    words = ["track", "--detections", given / "detections.csv", "--fps", 25, "--frame-size"]
    words += ["320x240", "--out", given, "--overwrite"]
    assert "is read for this run, and would be replaced by it" in refused(*words)


class Arrived:
    """A source of which all pictures have arrived."""

    def start(self) -> None: ...

    def stop(self) -> None: ...

    def next(self, patience: float) -> LiveFrame | None:
        return None

    def status(self) -> SourceStatus:
        return SourceStatus("live", frames=99, fps=25.0, width=320, height=240)


class Looks:
    """Keeps the embeddings of all frames, by number."""

    def __init__(self) -> None:
        self.seen = dict[int, tuple[Detections, Image]]()

    def take(self, tracked: TrackedFrame) -> None:
        """Keep a frame."""
        frame = tracked.detected.frame
        self.seen[frame.number] = (tracked.step.detections, frame.image)


def test_a_live_camera_describes_its_boxes(tmp_path: Path) -> None:
    make = CameraSetup(TrackingRequest(appearance="colours"), (), "mog2", 0, None)
    looks = Looks()
    settings = CameraSettings(tmp_path / "gate", video=0.0)
    source: Any = Arrived()
    camera = Camera("gate", source, make, settings, observers=(looks,))
    for k, image in enumerate(pictures(), start=1):
        camera.process(LiveFrame(k, k / 25, 1e9 + k / 25, image))
    camera.stop(60.0)
    assert sum(len(found) for found, _ in looks.seen.values()) > 20
    for found, image in looks.seen.values():
        expected = Colours().describe(image, found.xyxy)
        np.testing.assert_array_equal(found.embeddings, expected)


def test_live_cameras_read_colours() -> None:
    info = SequenceInfo(64, 48, 10.0)
    for appearance in ("", "none", "colours"):
        parts = CameraSetup(TrackingRequest(appearance=appearance), (), "change", 0, None)(info)
        described = (appearance or DEFAULT_APPEARANCE) == "colours"
        assert isinstance(parts.describer, Colours) == described
        assert ("appearance" in parts.fixed) == described
    make = CameraSetup(TrackingRequest(appearance="looks.npy"), (), "change", 0, None)
    with pytest.raises(InputError, match="Say colours, onnx:FILE or none"):
        make(info)


@pytest.mark.parametrize("command", ["track", "count", "groups", "live"])
def test_commands_that_track_have_the_option(command: str) -> None:
    said = CliRunner().invoke(application(command), [command, "--help"])
    text = " ".join(said.stdout.split())
    assert "--appearance NAME Tell objects apart by how they look: by their colours" in text
