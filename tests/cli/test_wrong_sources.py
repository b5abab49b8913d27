"""Sources and words that cannot be used: one sentence says what they are, and nothing is left."""

from __future__ import annotations

import json
import subprocess
import sys
import wave
from pathlib import Path

import numpy as np
import pytest
from cli_runner import phdtrack, refused, walkers

from phdtrack.opencv_package import cv2
from phdtrack.run import directory as rundir

ONE_PICTURE = "one picture shows no motion, and the detector change needs several"


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    """A grey picture."""
    file = tmp_path / "one.jpg"
    assert cv2.imwrite(str(file), np.full((96, 128, 3), 120, np.uint8))
    return file


@pytest.mark.parametrize("exists", [False, True])
def test_a_part_behind_the_end_leaves_no_new_folder(tmp_path: Path, exists: bool) -> None:
    folder = walkers(tmp_path / "walkers", 12)
    out = tmp_path / "run"
    if exists:
        out.mkdir()
    words = ("--detections", folder / "det" / "det.txt", "--frames", "50-60")
    said = phdtrack("track", *words, "--no-video", "--out", out)
    assert said.status == 2
    assert "--frames" in said.err
    assert out.exists() is exists


def test_a_sound_file_is_called_so(tmp_path: Path) -> None:
    file = tmp_path / "a.wav"
    with wave.open(str(file), "wb") as sound:
        sound.setparams((1, 2, 8000, 0, "NONE", ""))
        sound.writeframes(bytes(1600))
    said = refused("track", file, "--out", tmp_path / "run")
    assert "expected a video, and by its name this is a sound file" in said
    assert "mp4" not in said


def test_one_picture_shows_no_motion(picture: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    said = phdtrack("track", picture, "--no-video", "--out", out)
    assert said.status == 0, said.err
    assert said.err.count(ONE_PICTURE) == 1
    warnings = json.loads((out / rundir.RUN).read_text())["warnings"]
    assert sum(one.startswith(ONE_PICTURE) for one in warnings) == 1


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--max-width", "abc"], "'--max-width': expected a whole number, got 'abc'"),
        (["--fps=2x"], "'--fps': expected a number, got '2x'"),
    ],
)
def test_a_word_in_place_of_a_number(words: list[str], sentence: str) -> None:
    command = [sys.executable, "-m", "phdtrack", "track", "a.mp4", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert f"Invalid value for {sentence}. See phdtrack track --help." in done.stderr


def test_evaluate_takes_the_folder_of_a_run(tmp_path: Path) -> None:
    truth = walkers(tmp_path / "walkers", 12) / "gt" / "gt.txt"
    run = tmp_path / "run"
    run.mkdir()
    (run / rundir.TRACKS).write_text(truth.read_text())
    said = phdtrack("evaluate", "--truth", truth, "--tracks", run, "--json")
    assert said.status == 0, said.err
    assert said.object["MOTA"] == 1.0
