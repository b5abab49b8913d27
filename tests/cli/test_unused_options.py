"""Options that have no effect without another one say so once, with the cure."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cli_runner import phdtrack, walkers

from phdtrack.run import directory as rundir
from phdtrack.video import VideoWriter

# Options, the beginning of what is said, and those that make them useful.
CASES = {
    "reidentify-within": (
        ("--reidentify-within", "1"),
        "--reidentify-within has no effect: it is not known what the objects look like.",
        ("--appearance", "colours"),
    ),
    "threads": (
        ("--threads", "2"),
        "--threads has no effect: the filter pmb has one thread.",
        ("--filter", "particle-phd"),
    ),
    "video-size": (
        ("--video-size", "320", "--no-video"),
        "--video-size has no effect with --no-video: no video is written.",
        ("--video",),
    ),
}


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of `walkers`, with a grey video."""
    folder = walkers(tmp_path_factory.mktemp("scene") / "walkers", 12)
    with VideoWriter(folder / "walkers.mp4", 320, 240, 25.0) as writer:
        for image in np.full((12, 240, 320, 3), 128, "uint8"):
            writer.write(image)
    return folder


def track(scene: Path, out: Path, *words: str) -> tuple[str, list[str]]:
    """What a run prints on stderr, and the warnings in its run.json."""
    detections = ("--detections", scene / "det" / "det.txt")
    said = phdtrack("track", scene / "walkers.mp4", *detections, "--out", out, *words)
    assert said.status == 0, said.err
    return said.err, json.loads((out / rundir.RUN).read_text())["warnings"]


@pytest.mark.parametrize("case", CASES)
def test_track_says_what_has_no_effect(case: str, scene: Path, tmp_path: Path) -> None:
    words, sentence, _ = CASES[case]
    printed, warnings = track(scene, tmp_path / "run", *words)
    assert printed.count(f"phdtrack: warning: {sentence}") == 1
    assert sum(one.startswith(sentence) for one in warnings) == 1


@pytest.mark.parametrize("case", CASES)
def test_useful_options_are_not_warned_of(case: str, scene: Path, tmp_path: Path) -> None:
    words, _, useful = CASES[case]
    printed, _ = track(scene, tmp_path / "run", *words, *useful)
    assert "has no effect" not in printed


def test_live_says_what_has_no_effect(scene: Path, tmp_path: Path) -> None:
    words = ("--reidentify-within", "1", "--threads", "2", "--allow-private")
    source = ("live", scene / "walkers.mp4", "--no-page", "--duration", "0.1")
    said = phdtrack(*source, "--out", tmp_path / "live", *words)
    assert said.status == 0, said.err
    for option in ("--reidentify-within", "--threads", "--allow-private"):
        assert said.err.count(f"warning: {option} has no effect") == 1
