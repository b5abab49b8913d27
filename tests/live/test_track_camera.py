"""`phdtrack track` on a camera: true times, no hanging, no lost tracks, no secrets, bounded
memory.
"""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from itertools import islice, pairwise
from pathlib import Path

import numpy as np
import pytest
from camera_server import CameraServer, Scripted, until, walker
from typer.testing import CliRunner

from phdtrack import Tracker
from phdtrack.cli.app import application
from phdtrack.errors import InputError
from phdtrack.final_rows import FinalTracks
from phdtrack.run import camera_input
from phdtrack.run.inputs import Inputs, open_inputs
from phdtrack.run.requests import SourceRequest
from phdtrack.types import Frame
from phdtrack.video import open_source

pytestmark = pytest.mark.slow


def started(address: str, out: Path, temporary: Path | None = None) -> subprocess.Popen[str]:
    words = [
        sys.executable,
        "-m",
        "phdtrack",
        "track",
        address,
        "--out",
        str(out),
        "--set",
        "detector.min_area=0.005",
    ]
    there = os.environ | ({} if temporary is None else {"TMPDIR": str(temporary)})
    return subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=there
    )


def rows(out: Path, name: str = "states.csv.part") -> list[dict[str, str]]:
    """What was written of a file so far, up to its last whole line."""
    there = (out / name).read_text() if (out / name).exists() else ""
    return list(csv.DictReader(there[: there.rfind("\n") + 1].splitlines()))


def test_a_camera_that_dies_returns_and_freezes(tmp_path: Path) -> None:
    """Ten pictures a second are not taken as 25; SIGTERM ends the run while the camera is frozen,
    and nothing is lost.
    """
    camera = CameraServer()
    out = tmp_path / "run"
    temporary = tmp_path / "temporary"
    camera.rate = 10.0
    camera.draw = walker
    temporary.mkdir()
    address = camera.url.replace("://", "://bob:secret99@")
    with started(address, out, temporary=temporary) as child:
        until(lambda: rows(out))
        seen = time.monotonic()
        until(lambda: len(rows(out)) >= 15)
        camera.kill()
        camera.restart()
        returned = time.monotonic()
        had = len(rows(out))
        until(lambda: len({row["frame"] for row in rows(out)[had:]}) >= 40)
        camera.frozen = True
        until(lambda: time.monotonic() - camera.sent[-1] > 1.0)
        # The stream is not copied.
        assert list(temporary.iterdir()) == []
        asked = time.monotonic()
        child.send_signal(signal.SIGTERM)
        said, errors = child.communicate(timeout=600)
        took = time.monotonic() - asked
    assert child.returncode == 143, errors
    # Not for ever, nor until a time-out; two seconds are asked for.
    assert took < 60
    document = json.loads((out / "run.json").read_text())
    assert document["complete"] is False
    # Tracks are judged as their rows become final.
    assert document["doubtful_boxes"]["boxes"] == document["track_rows"] > 0
    assert document["doubtful_boxes"]["tracks"] == document["tracks"]
    video = list(open_source(out / "annotated.mp4"))
    assert len(video) == document["frames"] > 50
    # At most ten of the forty were under way when the camera returned; the others were sent a tenth
    # of a second apart.
    assert returned - seen + 2.9 < video[-1].time < asked - camera.sent[0]
    assert "pictures a second, each at the time at which it arrived" in errors
    for path in out.iterdir():
        assert b"secret99" not in path.read_bytes(), path
    assert "secret99" not in said + errors
    camera.kill()


@pytest.mark.parametrize(
    ("name", "what"), [("SIGINT", "mute"), pytest.param("SIGHUP", "frozen", marks=pytest.mark.slow)]
)
def test_a_signal_ends_a_run_whose_camera_says_nothing(
    tmp_path: Path, name: str, what: str
) -> None:
    camera = CameraServer()
    out = tmp_path / "run"
    camera.draw = walker
    camera.mute = what == "mute"
    with started(camera.url, out) as child:
        if what == "mute":
            until(lambda: camera.asked)
        else:
            until(lambda: len(rows(out)) >= 5)
            camera.frozen = True
            until(lambda: time.monotonic() - camera.sent[-1] > 1.0)
        asked = time.monotonic()
        child.send_signal(getattr(signal, name))
        _, errors = child.communicate(timeout=600)
        took = time.monotonic() - asked
    assert child.returncode == {"SIGINT": 130, "SIGHUP": 129}[name], errors
    assert took < 60
    assert (out / "tracks.csv").exists() == (what == "frozen")
    assert not list(out.glob("*.part"))
    camera.kill()


def scripted(monkeypatch: pytest.MonkeyPatch, source: Scripted) -> Inputs:
    """The inputs of a run on a camera whose pictures and times are given."""
    monkeypatch.setattr(camera_input, "LiveSource", lambda address: source)
    return open_inputs(SourceRequest("rtsp://bob:secret99@cam/1"), {})


def test_times_are_those_of_pictures_and_the_rate_is_theirs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    opened = scripted(monkeypatch, Scripted(rate=10.0, last=30))
    assert opened.info.fps == 10.0
    assert "rtsp://" in opened.source.note
    assert "secret99" not in opened.source.note
    assert "about 10 pictures a second" in opened.source.note
    frames = list(islice(opened.source, 30))
    assert [frame.number for frame in frames] == list(range(1, 31))
    assert [frame.time for frame in frames] == pytest.approx([k / 10 for k in range(30)])


def test_pictures_that_nobody_had_time_for_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """A detector that takes as long as five pictures gets the newest, at its own time."""
    source = Scripted(rate=10.0, last=200)
    opened = scripted(monkeypatch, source)
    given = list[Frame]()
    for frame in opened.source:
        given.append(frame)
        if frame.number > 20:
            source.number = source.number + 4
            source.dropped = source.dropped + 4
        if frame.number > 150:
            break
    assert [frame.time for frame in given] == pytest.approx(
        [(frame.number - 1) / 10 for frame in given]
    )
    assert {b.number - a.number for a, b in pairwise(given[25:])} == {5}
    frames = opened.source.read(opened.source)
    next(frames)
    frames.close()
    assert f"{source.dropped} pictures dropped" in opened.source.problem


def test_a_mute_camera_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    camera = CameraServer()
    camera.mute = True
    monkeypatch.setattr("phdtrack.video.decoding.CONNECT", 0.5)
    with pytest.raises(InputError, match=r"no answer in 0\.5 s") as raised:
        open_inputs(SourceRequest(camera.url.replace("://", "://bob:secret99@")), {})
    assert "secret99" not in str(raised.value)
    assert "that the device is on" in raised.value.cure
    camera.kill()


def test_a_lost_camera_ends_an_incomplete_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(camera_input, "GIVE_UP", 1.0)
    monkeypatch.setattr(camera_input, "LiveSource", lambda address: Scripted(last=40))
    out = tmp_path / "run"
    words = [
        "track",
        "rtsp://bob:secret99@cam/1",
        "--out",
        str(out),
        "--set",
        "detector.min_area=0.005",
    ]
    said = CliRunner().invoke(application("track"), words)
    assert said.exit_code == 1
    assert "no picture in 1 s" in said.output
    assert "secret99" not in said.output
    document = json.loads((out / "run.json").read_text())
    assert (document["complete"], document["frames"]) == (False, 40)
    assert (out / "tracks.csv").exists()


def walk(k: int) -> list[list[float]]:
    """Two objects that stay in view, and one that comes and goes."""
    there = [[100 + 0.05 * k, 100, 140 + 0.05 * k, 200], [600 - 0.05 * k, 300, 640 - 0.05 * k, 400]]
    return there + ([[300.0 + k % 200, 600, 340 + k % 200, 700]] if k % 200 < 120 else [])


def test_final_tracks_equal_those_of_unlimited_memory() -> None:
    endless = Tracker((1280, 800), fps=10, associate={"history": 60.0})
    whole = Tracker((1280, 800), fps=10)
    final = FinalTracks(endless, lag=10.0, every=10.0)
    parts = []
    for k in range(1, 3001):
        endless.update(walk(k), k)
        whole.update(walk(k), k)
        rows = final.due()
        if len(rows):
            assert rows.frame.max() <= k - 100
            parts.append(rows)
    parts.append(final.rest())
    given = np.concatenate([np.column_stack([p.frame, p.identity]) for p in parts])
    usual = whole.tracks()
    boxes = np.concatenate([part.xyxy for part in parts])
    # The same rows in the same places, and one identity of ours for each of theirs.
    order = np.lexsort((boxes[:, 0], given[:, 0]))
    theirs = np.lexsort((usual.xyxy[:, 0], usual.frame))
    assert given[order, 0].tolist() == usual.frame[theirs].tolist()
    np.testing.assert_allclose(boxes[order], usual.xyxy[theirs], atol=2.0)
    pairs = set(zip(given[order, 1].tolist(), usual.identity[theirs].tolist(), strict=True))
    assert len(pairs) == len({a for a, _ in pairs}) == len({b for _, b in pairs}) > 10


def test_the_rest_is_all_that_was_not_final() -> None:
    tracker = Tracker((1280, 800), fps=10)
    final = FinalTracks(tracker, lag=1.0, every=1.0)
    given = list[int]()
    for asked in (True, True, False):
        for k in range(1, 61):
            tracker.update(walk(k))
            given += final.due().frame.tolist() if asked else []
        given += final.rest().frame.tolist()
        assert given == tracker.tracks().frame.tolist()
        tracker.reset()
        given.clear()


@pytest.mark.parametrize("command", [["track"], ["count", "--line", "a=0,0,9,9"]])
def test_a_password_with_a_slash_is_not_shown(command: list[str], tmp_path: Path):
    words = [*command, "rtsp://bob:12/secret99@127.0.0.1:9/x", "--out", str(tmp_path / "out")]
    found = CliRunner().invoke(application(command[0]), words)
    assert found.exit_code == 2
    assert "secret99" not in found.output
    assert ("%2F" in found.output) == (command[0] == "track"), found.output
