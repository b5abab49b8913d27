"""Identities given back to somebody who was lost and looks the same, on the command line."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runner import phdtrack, refused
from typer.testing import CliRunner

from appearance_cases import SIZE, meeting, tracker_of
from phdtrack import Tracker
from phdtrack.cli.app import application
from phdtrack.formats import read_tracks
from phdtrack.types import F4, F8

# Tests look at pages.
pytestmark = pytest.mark.usefixtures("paged")

FPS = 10.0
LEFT = 151
BACK = 201
FRAMES = 230
LENGTH = 16


def people(frame: int) -> tuple[F8, F4]:
    """The boxes (N, 4) of a frame, and noisy descriptors (N, D): four people, each in a lane of
    their own, of whom the first is away in the frames from `LEFT` to `BACK` − 1.
    """
    rng = np.random.default_rng(frame)
    lane = np.arange(4)
    x = 100 + 30 * lane + 1.5 * frame
    y = 60 + 100 * lane
    boxes = np.stack([x, y, x + 30, y + 70], axis=1) + rng.normal(0, 0.3, (4, 4))
    looks = np.eye(4, LENGTH) + rng.normal(0, 0.1, (4, LENGTH))
    here = slice(1 if LEFT <= frame < BACK else 0, 4)
    return boxes[here], looks[here].astype(np.float32)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Detections as a MOTChallenge file, and their descriptors."""
    folder = tmp_path_factory.mktemp("returns")
    lines = list[str]()
    looks = list[F4]()
    for frame in range(1, FRAMES + 1):
        boxes, described = people(frame)
        for left, top, right, bottom in boxes:
            size = f"{right - left:.2f},{bottom - top:.2f}"
            lines.append(f"{frame},-1,{left:.2f},{top:.2f},{size},1,-1,-1,-1")
        looks.append(described)
    detections = folder / "det.txt"
    detections.write_text("\n".join(lines) + "\n")
    np.save(folder / "looks.npy", np.concatenate(looks))
    return detections, folder / "looks.npy"


def given_back(files: tuple[Path, Path], out: Path, *words: object) -> Any:
    """``identities_given_back`` of the run.json of a run; None if it has none."""
    said = phdtrack(
        *("track", "--detections", files[0], "--frame-size", "640x480", "--fps", FPS),
        *("--out", out, *words),
    )
    assert said.status == 0, said.err
    return json.loads((out / "run.json").read_text()).get("identities_given_back")


def test_run_json_lists_identities_given_back(files: tuple[Path, Path], tmp_path: Path) -> None:
    found = given_back(files, tmp_path / "run", "--appearance", files[1])
    assert len(found) == 1
    pair = found[0]
    assert pair["last_frame"] == LEFT - 1
    assert BACK <= pair["frame"] < BACK + FPS
    assert pair["odds"] > 1
    assert pair["seconds"] == pytest.approx((pair["frame"] - pair["last_frame"]) / FPS)
    rows = read_tracks(tmp_path / "run" / "tracks_online.csv")
    frames = rows.frame[rows.identity == pair["identity"]]
    assert frames.min() < LEFT
    assert frames.max() == FRAMES


def test_a_loop_has_the_same_returns(files: tuple[Path, Path], tmp_path: Path) -> None:
    tracker = Tracker((640, 480), fps=FPS)
    for frame in range(1, FRAMES + 1):
        boxes, looks = people(frame)
        tracker.update(boxes, frame, embeddings=looks)
    found = given_back(files, tmp_path / "run", "--appearance", files[1])
    pairs = [(one.identity, one.ended[0], one.began[0]) for one in tracker.returns]
    assert pairs == [(one["identity"], one["last_frame"], one["frame"]) for one in found]


@pytest.mark.parametrize(
    ("words", "count"),
    [
        (["--reidentify-within", "3"], 0),
        (["--reidentify-within", "60"], 1),
        (["--reidentify-within", "0"], 1),
        (["--set", "appearance.reidentify_within=3"], 0),
        (["--set", "appearance.reidentify_within=3", "--reidentify-within", "60"], 1),
    ],
)
def test_nobody_comes_back_later_than_the_limit(
    files: tuple[Path, Path], tmp_path: Path, words: Sequence[str], count: int
) -> None:
    found = given_back(files, tmp_path / "run", "--appearance", files[1], *words)
    assert len(found) == count


def test_run_json_lists_identities_exchanged(tmp_path: Path) -> None:
    """The same as in a loop, of two who hid each other and turned back."""
    frames = meeting(turn=True)
    tracker = tracker_of()
    lines = list[str]()
    for frame, found in enumerate(frames, 1):
        tracker.update(found, frame)
        for left, top, right, bottom in found.xyxy.tolist():
            lines.append(f"{frame},-1,{left},{top},{right - left},{bottom - top},1,-1,-1,-1")
    (tmp_path / "det.txt").write_text("\n".join(lines) + "\n")
    np.save(tmp_path / "looks.npy", np.concatenate([found.embeddings for found in frames]))
    words = ["--frame-size", "x".join(map(str, SIZE)), "--fps", FPS, "--out", tmp_path / "run"]
    looks = ["--appearance", tmp_path / "looks.npy"]
    said = phdtrack("track", "--detections", tmp_path / "det.txt", *words, *looks)
    assert said.status == 0, said.err
    told = json.loads((tmp_path / "run" / "run.json").read_text())["identities_exchanged"]
    assert [(one["frame"], tuple(one["identities"])) for one in told] == [
        (one.frame, one.identities) for one in tracker.exchanges
    ]
    assert len(told) == 1
    assert told[0]["odds"] > 50


def test_without_appearance_there_is_no_list(files: tuple[Path, Path], tmp_path: Path) -> None:
    assert given_back(files, tmp_path / "run") is None
    document = json.loads((tmp_path / "run" / "run.json").read_text())
    assert "appearance" not in document
    assert "tell two objects apart" not in " ".join(document["summary"])


def test_a_run_tells_what_appearance_was_worth(files: tuple[Path, Path], tmp_path: Path) -> None:
    """On the terminal in one sentence, with another for who came back; in the report."""
    out = tmp_path / "run"
    said = phdtrack(
        *("track", "--detections", files[0], "--frame-size", "640x480", "--fps", FPS),
        *("--out", out, "--appearance", files[1]),
    )
    assert (
        "Embeddings tell two objects apart in more than 99 of 100 pairs, 2\u00a0s later" in said.out
    )
    assert "1 object came back and has its identity again; run.json lists it with its" in said.out
    worth = json.loads((out / "run.json").read_text())["appearance"]
    assert worth["source"] == str(files[1])
    assert worth["told_apart"] > 0.99
    assert worth["nats_of_taken_detections"] > 0.5
    assert "<h2>Appearance</h2>" in (out / "report.html").read_text()


def test_limit_is_in_seconds(files: tuple[Path, Path], tmp_path: Path) -> None:
    words = ("track", "--detections", files[0], "--out", tmp_path / "run", "--fps", FPS)
    words += ("--frame-size", "640x480")
    said = phdtrack(*words, "--reidentify-within", "-1")
    assert said.status == 2
    assert "Invalid value for '--reidentify-within'" in said.err
    text = refused(*words, "--set", "appearance.kind=none", "--reidentify-within", "3")
    assert "--reidentify-within" in text
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("command", ["track", "count", "groups", "live"])
def test_commands_that_track_have_the_limit(command: str) -> None:
    said = CliRunner().invoke(application(command), [command, "--help"])
    text = " ".join(said.stdout.split())
    assert "--reidentify-within S With --appearance: seconds within which a lost object" in text
