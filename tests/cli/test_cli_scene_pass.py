"""The first pass of a run teaches the second one where the scene flickers."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from cli_runner import phdtrack

from phdtrack.formats import read_tracks
from phdtrack.run import directory as rundir
from phdtrack.video import VideoWriter

# Tests look at pages.
pytestmark = pytest.mark.usefixtures("paged")

SAME = (rundir.TRACKS, rundir.ONLINE, rundir.STATES, rundir.DETECTIONS)
# Ends its own process by a signal after some frames of the second pass.
KILLED = """
import os, signal, sys
from phdtrack.cli.app import main
from phdtrack.formats import StatesWriter
real, calls = StatesWriter.append, []
def counted(*given, **more):
    calls.append(1)
    if len(calls) == {after}:
        os.kill(os.getpid(), signal.{name})
    return real(*given, **more)
StatesWriter.append = counted
sys.argv = ["phdtrack", *{words}]
main()
"""
FRAMES = 600
# It hardly gets used to what blinks.
DETECTOR = "mog2"


def clip(path: Path, *, blinks: bool) -> Path:
    """Twice a box crosses a noisy grey; a spot may light up again and again."""
    rng = np.random.default_rng(5)
    ground = rng.integers(110, 126, (120, 200, 3))
    glow = 0
    with VideoWriter(path, 200, 120, 25.0) as writer:
        for k in range(FRAMES):
            image = (ground + rng.integers(-2, 3, ground.shape)).astype(np.uint8)
            x = 2 * (k % 300) - 40
            if 0 <= x < 176:
                image[70:100, x : x + 16] = 30
            if k % 40 == 0:
                glow = int(rng.integers(150, 250))
            if blinks and k % 40 < 14:
                sway = round(8 * np.sin(0.5 * k))
                image[10:40, 140 + sway : 156 + sway] = glow
            writer.write(image)
    return path


@pytest.fixture(scope="module")
def blinking(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return clip(tmp_path_factory.mktemp("clip") / "blinking.mp4", blinks=True)


@pytest.fixture(scope="module")
def learned(blinking: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run that nothing stopped."""
    out = tmp_path_factory.mktemp("run") / "run"
    said = phdtrack(*given(blinking, out))
    assert said.status == 0, said.err
    assert (said.out + said.err).count("The scene flickers") == 1
    return out


def given(video: Path, out: Path, *more: str) -> list[str]:
    words = ["track", str(video), "--out", str(out), "--no-video", "--checkpoint-every", "0.001"]
    return [*words, "--detector", DETECTOR, *more]


def places(out: Path) -> np.ndarray:
    """The height in the picture of the rows of tracks."""
    return read_tracks(out / rundir.TRACKS).xyxy[:, 1]


def test_what_flickers_is_not_tracked(blinking: Path, learned: Path, tmp_path: Path) -> None:
    said = phdtrack(*given(blinking, tmp_path / "plain", "--no-learn"))
    assert "flickers" not in said.err
    assert (places(tmp_path / "plain") < 50).any()
    assert not (places(learned) < 50).any()
    assert (places(learned) > 50).sum() == (places(tmp_path / "plain") > 50).sum()
    document = json.loads((learned / rundir.RUN).read_text())
    assert 0 < document["flicker"]["share_of_picture"] < 0.2
    assert "Where the scene flickers" in (learned / rundir.REPORT).read_text()
    assert "Where the scene flickers" not in (tmp_path / "plain" / rundir.REPORT).read_text()


def test_without_flicker_the_files_are_the_same(tmp_path: Path) -> None:
    video = clip(tmp_path / "calm.mp4", blinks=False)
    for name, more in (("learn", ()), ("plain", ("--no-learn",))):
        said = phdtrack(*given(video, tmp_path / name, *more))
        assert (said.status, "flickers" in said.err) == (0, False)
    for name in SAME:
        assert (tmp_path / "learn" / name).read_bytes() == (tmp_path / "plain" / name).read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("after", [FRAMES // 2, FRAMES + 100], ids=["first pass", "second pass"])
@pytest.mark.parametrize("name", ["SIGKILL", "SIGTERM"])
def test_a_stopped_run_is_resumed_and_writes_the_same(
    blinking: Path, learned: Path, tmp_path: Path, name: str, after: int
) -> None:
    out = tmp_path / "run"
    code = KILLED.format(after=after, name=name, words=given(blinking, out))
    status = subprocess.run([sys.executable, "-c", code], env={**os.environ}, check=False)
    number = getattr(signal, name)
    assert status.returncode == (-number if name == "SIGKILL" else 128 + number)
    said = phdtrack(*given(blinking, out, "--resume"))
    assert said.status == 0, said.err
    for file in SAME:
        assert (out / file).read_bytes() == (learned / file).read_bytes(), file


def test_a_counting_run_sees_every_frame_once(blinking: Path, tmp_path: Path) -> None:
    said = phdtrack(
        *("count", blinking, "--line", "gate=100,110,100,60", "--out", tmp_path / "run", "--json"),
        *("--detector", DETECTOR),
    )
    assert said.status == 0, said.err
    counts = json.dumps(said.object["counts"])
    assert '"in": 2' in counts or '"out": 2' in counts, counts
