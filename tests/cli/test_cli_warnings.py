"""Warnings of the tracker: every command prints each of them once, and the files hold them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from cli_runner import phdtrack, walkers

from phdtrack.run import directory as rundir

# Tests look at pages.
pytestmark = pytest.mark.usefixtures("paged")

EQUAL = "of the scores are 0.5: scores that are all the same"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A sequence of two people, all detections of which have the same score."""
    made = walkers(tmp_path / "yard", 56)
    file = made / "det" / "det.txt"
    file.write_text(file.read_text().replace(",1,-1,-1,-1", ",0.5,-1,-1,-1"))
    return made


def test_track_prints_a_warning_once(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    said = phdtrack("track", "--detections", folder / "det" / "det.txt", "--out", out)
    assert said.status == 0, said.err
    assert said.err.count(EQUAL) == 1
    assert "phdtrack: warning: frame 50: 100% " in said.err
    assert EQUAL not in said.out
    document = json.loads((out / rundir.RUN).read_text())
    assert sum(EQUAL in sentence for sentence in document["warnings"]) == 1
    assert "scores that are all the same" in (out / rundir.REPORT).read_text()


def test_quiet_track_still_warns(folder: Path, tmp_path: Path) -> None:
    given = ("--detections", folder / "det" / "det.txt", "--out", tmp_path / "run")
    assert phdtrack("track", *given, "--quiet").err.count(EQUAL) == 1


def test_count_prints_a_warning_once(folder: Path, tmp_path: Path) -> None:
    given = ("--detections", folder / "det" / "det.txt", "--line", "middle=160,0,160,240")
    said = phdtrack("count", *given, "--out", tmp_path / "run")
    assert said.status == 0, said.err
    assert said.err.count(EQUAL) == 1


def test_groups_prints_a_warning_once(folder: Path, tmp_path: Path) -> None:
    camera = tmp_path / "camera.toml"
    camera.write_text(
        "homography = [[0.1, 0.0, 0.0], [0.0, -0.1, 24.0], [0.0, 0.0, 1.0]]\n"
        "maps = 'pixel-to-ground'\n"
    )
    given = ("--detections", folder / "det" / "det.txt", "--camera", camera)
    said = phdtrack("groups", *given, "--out", tmp_path / "run")
    assert said.status == 0, said.err
    assert said.err.count(EQUAL) == 1


def test_compare_prints_a_warning_once(folder: Path, tmp_path: Path) -> None:
    given = ("--filters", "gm-phd,none", "--jobs", 1, "--out", tmp_path / "out")
    for _ in range(2):
        # The second time the results are those of the first.
        said = phdtrack("compare", folder, *given)
        assert said.status == 0, said.err
        assert said.err.count(EQUAL) == 1
        assert "(1 more run like it)" in said.err


@pytest.mark.slow
def test_batch_prints_a_warning_once(folder: Path, tmp_path: Path) -> None:
    other = walkers(tmp_path / "other", 40) / "det" / "det.txt"
    other.write_text((folder / "det" / "det.txt").read_text())
    files = (folder / "det" / "det.txt", other)
    said = phdtrack("batch", *files, "--jobs", 1, "--out", tmp_path / "out", "--", "--no-video")
    assert said.status == 0, said.err
    assert said.err.count(EQUAL) == 1
    summary = json.loads((tmp_path / "out" / "batch.json").read_text())
    assert all(EQUAL in str(video["warnings"]) for video in summary["videos"])
