"""`phdtrack track` on a camera: true times, no hanging, no lost tracks, no secrets, bounded memory."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from camera_server import CameraServer

from phdtrack import Tracker
from phdtrack.cli import inputs
from phdtrack.cli.options import SourceOptions
from phdtrack.errors import InputError
from phdtrack.tracker import FinalTracks
from phdtrack.video import open_source


def started(address: str, out: Path) -> subprocess.Popen[str]:
    words = [sys.executable, "-m", "phdtrack", "track", address, "--out", str(out)]
    return subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def begun(out: Path) -> None:
    """Wait until the first frame is through."""
    log, end = out / "states.csv.part", time.monotonic() + 60
    while time.monotonic() < end and not (log.exists() and log.stat().st_size):
        time.sleep(0.1)


def test_a_camera_that_dies_returns_and_freezes(tmp_path: Path) -> None:
    """Ten pictures a second are taken as ten; SIGTERM ends the run while the camera is frozen, and nothing is lost."""
    camera, out = CameraServer(), tmp_path / "run"
    camera.rate = 10.0
    address = camera.url.replace("://", "://bob:secret99@")
    with started(address, out) as child:
        begun(out)
        time.sleep(3)
        camera.kill()
        time.sleep(0.5)
        camera.restart()
        time.sleep(3)
        camera.frozen = True
        time.sleep(1)
        asked = time.monotonic()
        child.send_signal(signal.SIGTERM)
        said, errors = child.communicate(timeout=60)
        took = time.monotonic() - asked
    assert child.returncode == 143, errors
    assert took < 20
    document = json.loads((out / "run.json").read_text())
    assert document["complete"] is False
    # Frames before and after the interruption, at the times at which they came.
    assert document["frames"] > 30
    video = list(open_source(out / "annotated.mp4"))
    assert len(video) == document["frames"]
    assert np.median(np.diff([frame.time for frame in video])) == pytest.approx(0.1, rel=0.3)
    assert "about 10" in errors or "about 9." in errors
    for path in out.iterdir():
        assert b"secret99" not in path.read_bytes(), path
    assert "secret99" not in said + errors
    camera.kill()


def test_a_mute_camera_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    camera = CameraServer()
    camera.mute = True
    monkeypatch.setattr("phdtrack.video.files.CONNECT", 0.5)
    with pytest.raises(InputError, match=r"no answer in 0\.5 s") as raised:
        inputs.open_inputs(SourceOptions(camera.url.replace("://", "://bob:secret99@")), {})
    assert "secret99" not in str(raised.value)
    assert "switched on" in raised.value.cure
    camera.kill()


def test_a_camera_that_does_not_return_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inputs, "GIVE_UP", 1.0)
    camera = CameraServer()
    opened = inputs.open_inputs(SourceOptions(camera.url), {})
    threading.Timer(0.5, camera.kill).start()
    frames = list(opened.source)
    assert len(frames) > 10
    assert "no picture in 1 s" in opened.source.problem
    assert "problem" not in opened.source.note


def walk(k: int) -> list[list[float]]:
    """Two objects that stay in view, and one that comes and goes."""
    there = [[100 + 0.05 * k, 100, 140 + 0.05 * k, 200], [600 - 0.05 * k, 300, 640 - 0.05 * k, 400]]
    return there + ([[300.0 + k % 200, 600, 340 + k % 200, 700]] if k % 200 < 120 else [])


def test_final_tracks_are_those_of_a_tracker_that_forgets_nothing() -> None:
    endless = Tracker((1280, 800), fps=10, associate={"history": 60.0})
    whole = Tracker((1280, 800), fps=10)
    final, parts = FinalTracks(endless, lag=10.0, every=10.0), []
    for k in range(1, 3001):
        endless.update(walk(k), k)
        whole.update(walk(k), k)
        rows = final.due()
        if len(rows):
            assert rows.frame.max() <= k - 100
            parts.append(rows)
    parts.append(final.rest())
    given, usual = np.concatenate([np.column_stack([p.frame, p.identity]) for p in parts]), whole.tracks()
    boxes = np.concatenate([part.xyxy for part in parts])
    # The same rows in the same places, and one identity of ours for each of theirs.
    order, theirs = np.lexsort((boxes[:, 0], given[:, 0])), np.lexsort((usual.xyxy[:, 0], usual.frame))
    assert given[order, 0].tolist() == usual.frame[theirs].tolist()
    np.testing.assert_allclose(boxes[order], usual.xyxy[theirs], atol=2.0)
    pairs = set(zip(given[order, 1].tolist(), usual.identity[theirs].tolist(), strict=True))
    assert len(pairs) == len({a for a, _ in pairs}) == len({b for _, b in pairs}) > 10
