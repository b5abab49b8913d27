"""Rows that are wrong, files that are too large, and a row a billion frames away, from the command
line.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from cli_runner import phdtrack, refused

from phdtrack.files import SIZE_LIMIT
from phdtrack.formats import read_tracks

FAR = 1_000_000_000
SIZE = ("--frame-size", "640x480", "--fps", "1")


@pytest.fixture
def far(tmp_path: Path) -> Path:
    """Detections, truth and a seqinfo.ini; one walker at the beginning, and one a billion frames
    later.
    """
    frames = [*range(1, 20), *range(FAR, FAR + 19)]
    rows = [(frame, 100 + 5 * (frame % FAR), 100, 40, 80) for frame in frames]
    folder = tmp_path / "far"
    for part, between, after in (("det/det.txt", -1, ",0.9"), ("gt/gt.txt", 1, ",1,1,1")):
        (folder / part).parent.mkdir(parents=True)
        lines = [f"{f},{between},{x},{y},{w},{h}{after}\n" for f, x, y, w, h in rows]
        (folder / part).write_text("".join(lines), encoding="ascii")
    info = "[Sequence]\nname=far\nframeRate=1\nimWidth=640\nimHeight=480\n"
    (folder / "seqinfo.ini").write_text(info, encoding="ascii")
    return folder


@pytest.fixture(autouse=True)
def limit(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """What the option sets is taken back."""
    monkeypatch.setenv(SIZE_LIMIT, "4000000000")
    yield
    monkeypatch.undo()


def test_a_row_a_billion_frames_away_takes_no_time(far: Path, tmp_path: Path) -> None:
    """In the loop, the report, the scores and their causes."""
    truth = far / "gt" / "gt.txt"
    out = tmp_path / "run"
    given = ("--detections", far / "det" / "det.txt", "--truth", truth)
    document = phdtrack("track", *given, "--out", out, "--json").object
    assert document["complete"]
    # 19 with a detection, 250 empty ones, and the same again but for the end, which is the last
    # detection.
    assert document["frames"] == 19 + 250 + 19
    assert document["scores"]["frames"] == FAR + 18
    tracks = read_tracks(out / "tracks.csv")
    assert set(tracks.frame.tolist()) >= {*range(3, 20), *range(FAR + 2, FAR + 19)}
    assert ((tracks.frame < 300) | (tracks.frame >= FAR)).all()
    scored = (
        "--truth",
        truth,
        "--tracks",
        out / "tracks.csv",
        "--errors",
        "--t-gospa",
        "--rmse",
        "20",
        "--json",
    )
    assert phdtrack("evaluate", *scored).object["frames"] == FAR + 18


def test_so_it_is_in_groups_and_comparisons(far: Path, tmp_path: Path) -> None:
    camera = tmp_path / "H.txt"
    camera.write_text("0.01 0 0\n0 0.01 0\n0 0 1\n", encoding="ascii")
    given = (
        "--detections",
        far / "det" / "det.txt",
        "--camera",
        camera,
        "--no-video",
        "--out",
        tmp_path / "groups",
        "--json",
    )
    document = phdtrack("groups", *given).object
    assert (document["complete"], document["frames"]) == (True, 288)
    compared = phdtrack(
        "compare",
        far,
        "--filters",
        "none",
        "--seeds",
        "1",
        "--jobs",
        "1",
        "--out",
        tmp_path / "all",
        "--json",
    )
    assert compared.status == 0, compared.err
    clutter = phdtrack(
        "compare",
        far,
        "--filters",
        "none",
        "--clutter",
        "5",
        "--seeds",
        "1",
        "--jobs",
        "1",
        "--out",
        tmp_path / "b",
    )
    assert clutter.status == 1
    assert "frames to add clutter to, at most 10,000,000" in clutter.out + clutter.err


@pytest.mark.parametrize("command", ["label", "learn"])
def test_no_frames_are_drawn_from_a_billion(command: str, far: Path) -> None:
    said = phdtrack(command, "--detections", far / "det" / "det.txt")
    assert said.status == 2
    assert (
        "at most 10,000,000 frames to draw from, got one that ends with frame 1000000018"
        in said.err
    )


def test_malformed_rows_are_skipped_on_request(far: Path, tmp_path: Path) -> None:
    path = tmp_path / "det.txt"
    out = tmp_path / "run"
    rows = (far / "det" / "det.txt").read_text(encoding="ascii").splitlines()[:19]
    path.write_text(
        "\n".join([*rows[:4], "5,-1,nan,1,1,1,0.5", *rows[5:18], "19,-1,1"]), encoding="ascii"
    )
    stopped = phdtrack("track", "--detections", path, *SIZE, "--out", out)
    assert stopped.status == 2
    assert f"{path}, line 19: expected 7 values" in stopped.err
    said = phdtrack(
        "track", "--detections", path, *SIZE, "--on-error", "skip", "--out", out, "--json"
    )
    assert said.status == 0, said.err
    first = f"{path}, line 5: expected finite numbers for the box"
    assert f"2 malformed rows skipped, the first: {first}" in said.err
    document = said.object
    assert document["input"]["rows_left_out"] == 2
    assert document["input"]["first_left_out"].startswith(first)
    assert document["detections"] == 17
    other = phdtrack("track", "--detections", path, *SIZE, "--on-error", "ignore", "--out", out)
    assert other.status == 2
    assert "expected skip or stop" in other.err


def test_the_largest_file_can_be_chosen(far: Path, tmp_path: Path) -> None:
    path = far / "det" / "det.txt"
    said = phdtrack(
        "track", "--detections", path, "--max-file-size", "1kB", "--out", tmp_path / "run"
    )
    assert said.status == 2
    assert f"{path}: expected a file of at most 1,000 bytes" in said.err
    said = phdtrack("evaluate", "--truth", path, "--tracks", path, "--max-file-size", "500")
    assert "at most 500 bytes" in said.err
    said = phdtrack("track", "--detections", path, "--max-file-size", "much")
    assert "expected a size as 500MB or 4GB" in said.err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--fps", "25"], "--frame-size"),
        (["--frame-size", "64x48"], "--fps"),
        (["--frame-size", "64x48", "--fps", "25", "--on-error", "skip"], "--on-error"),
        (["--frame-size", "64x48", "--fps", "25", "--detector", "mog2"], "--detector"),
    ],
)
def test_standard_input_needs_size_and_rate(words: list[str], said: str, tmp_path: Path) -> None:
    assert said in refused("track", "--detections", "-", "--out", str(tmp_path / "run"), *words)
