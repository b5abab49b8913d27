"""How files of detections and of tracks are read on the command line, and places in shares."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from cli_runner import phdtrack, refused, walkers

from phdtrack.formats import read_detections, read_tracks

Change = Callable[[list[float]], list[float]]
TRACK = ("track", "--no-video", "--frame-size", "320x240", "--fps", 25, "--detections")


@pytest.fixture
def sequence(tmp_path: Path) -> Path:
    """Two walkers of 24x60 pixels in frames 1 to 40, without seqinfo.ini."""
    return walkers(tmp_path / "seq", seqinfo=False)


def changed(file: Path, change: Change, name: str = "other.txt") -> Path:
    """The rows of a file as ``change`` gives them."""
    rows = [[float(cell) for cell in line.split(",")] for line in file.read_text().split()]
    path = file.with_name(name)
    path.write_text("\n".join(",".join(f"{cell:.9g}" for cell in change(row)) for row in rows))
    return path


def corners(row: list[float]) -> list[float]:
    return [*row[:4], row[2] + row[4], row[3] + row[5], *row[6:]]


def shares(row: list[float]) -> list[float]:
    return [*row[:2], row[2] / 320, row[3] / 240, row[4] / 320, row[5] / 240, *row[6:]]


@pytest.mark.parametrize(
    "command", ["track", "groups", "count", "label", "learn", "export", "evaluate", "compare"]
)
def test_help_names_how_files_are_read(command: str) -> None:
    said = phdtrack(command, "--help").out
    for option in ("--format", "--first-frame", "--units", "--box", "--sequence"):
        assert option in said
    assert ("--labelled" in said) == ("--truth FILE" in said)


@pytest.mark.parametrize(
    ("change", "option", "value"),
    [
        (corners, "--box", "ltrb"),
        (shares, "--units", "shares"),
        (lambda row: [row[0] - 1, *row[1:]], "--first-frame", "0"),
    ],
)
def test_detections_are_read_as_stated(
    sequence: Path, tmp_path: Path, change: Change, option: str, value: str
) -> None:
    file = sequence / "det" / "det.txt"
    other = changed(file, change)
    out = tmp_path / "run"
    said = phdtrack(*TRACK, other, "--out", out, option, value)
    assert said.status == 0, said
    found = read_detections(out / "detections.csv")
    expected = read_detections(file)
    np.testing.assert_array_equal(found.frame, expected.frame)
    np.testing.assert_allclose(found.detections.xyxy, expected.detections.xyxy, atol=0.02)
    name = option.removeprefix("--").replace("-", "_")
    assert json.loads((out / "run.json").read_text())["input"]["reading"] == {name: value}


def test_stated_conventions_need_a_file(tmp_path: Path) -> None:
    asked = ("track", tmp_path / "a.mp4", "--out", tmp_path / "run", "--box", "ltrb")
    assert "there is no file of detections" in refused(*asked)
    out = ("--out", tmp_path / "run")
    assert "MOTChallenge or CSV in pixels" in refused(*TRACK, "-", *out, "--units", "shares")
    assert "expected 0 or 1" in refused(*TRACK, tmp_path / "det.txt", "--first-frame", "2")


def test_guesses_are_among_the_warnings_of_a_run(sequence: Path, tmp_path: Path) -> None:
    file = changed(sequence / "det" / "det.txt", lambda row: [*row[:6], 10 + row[0], -1, -1, -1])
    said = phdtrack(*TRACK, file, "--out", tmp_path / "run")
    assert "scores go up to 50 and seem to be percent" in said.err


def test_rows_after_the_end_of_a_sequence_are_told(tmp_path: Path) -> None:
    sequence = walkers(tmp_path / "seq")
    file = sequence / "det" / "det.txt"
    file.write_text(file.read_text() + "55,-1,9,9,20,60,1,-1,-1,-1\n")
    said = phdtrack("track", "--no-video", "--detections", file, "--out", tmp_path / "run")
    assert "detections up to frame 55, and seqinfo.ini has 40 frames" in said.err
    tracks = sequence / "gt" / "gt.txt"
    tracks.write_text(tracks.read_text() + "55,9,9,9,20,60,1,-1,-1,-1\n")
    line = ("--line", "gate=160,0,160,240", "--out", tmp_path / "counts")
    said = phdtrack("count", tracks, *line)
    assert "rows up to frame 55, and the sequence has 40 frames" in said.err


def test_truth_of_a_run_that_does_not_fit(sequence: Path, tmp_path: Path) -> None:
    detections = sequence / "det" / "det.txt"
    truth = sequence / "gt" / "gt.txt"
    asked = (*TRACK, detections, "--out", tmp_path / "run", "--overwrite", "--truth")
    assert "not in shares of its size" in refused(*asked, changed(truth, shares))
    half = changed(truth, lambda row: [*row[:2], *(one / 2 for one in row[2:6]), *row[6:]])
    assert "at 0.5 times their size: are they of a video" in phdtrack(*asked, half).err
    assert "times their size" not in phdtrack(*asked, truth).err
    keys = truth.with_name("keys.txt")
    rows = [line for line in truth.read_text().split() if int(line.split(",")[0]) % 10 == 1]
    keys.write_text("\n".join(rows))
    assert len(rows) == 8
    assert "every 10th frame" not in phdtrack(*asked, keys).err
    rows = [line for line in truth.read_text().split() if int(line.split(",")[0]) % 5 == 1]
    keys.write_text("\n".join(rows))
    said = phdtrack(*asked, keys)
    assert "in one of 5 frames, and only these 8 frames are scored" in said.err
    alone = json.loads((tmp_path / "run" / "run.json").read_text())["scores"]
    assert (alone["frames"], alone["false_positives"]) == (8, 0)
    found = phdtrack(*asked, keys, "--labelled", "all", "--json")
    assert "every 5th" not in found.err
    assert found.object["scores"]["false_positives"] == 64
    assert phdtrack(*asked, keys, "--labelled", "1,6", "--json").object["scores"]["frames"] == 2
    assert "frame numbers from 1" in refused(*asked, keys, "--labelled", "0")
    assert "Leave out --labelled or say --truth" in refused(*asked[:-1], "--labelled", "all")
    part = phdtrack(*asked, keys, "--frames", "6-31", "--json").object
    assert (part["scores"]["frames"], part["scores"]["false_positives"]) == (6, 0)


def test_truth_of_a_run_is_read_as_stated(sequence: Path, tmp_path: Path) -> None:
    detections = sequence / "det" / "det.txt"
    truth = sequence / "gt" / "gt.txt"
    asked = (*TRACK, detections, "--out", tmp_path / "run", "--overwrite", "--json", "--truth")
    early = changed(truth, lambda row: [row[0] - 1, *row[1:]])
    best = phdtrack(*asked, truth).object["scores"]["MOTA"]
    for file, option, value in (
        (changed(truth, corners, "corners.txt"), "--box", "ltrb,"),
        (changed(truth, shares, "shares.txt"), "--units", "shares,"),
        (early, "--first-frame", "0,"),
        (truth, "--format", "mot17,mot15"),
    ):
        found = phdtrack(*asked, file, option, value).object["scores"]["MOTA"]
        assert found == pytest.approx(best)
    # A word that stands alone is that of the detections.
    assert "not in shares" in refused(*asked, changed(truth, shares), "--units", "pixels")
    assert "TRUTH,FILE" in refused(*asked, truth, "--box", "ltwh,ltrb,ltwh")
    assert "expected ltwh, ltrb" in refused(*asked[:-1], "--box", "ltwh,ltrb")


def test_tracks_to_export_are_read_as_stated(sequence: Path, tmp_path: Path) -> None:
    file = sequence / "gt" / "gt.txt"
    out = tmp_path / "out.csv"
    other = changed(file, corners)
    asked = ("export", other, "--to", "csv", "--out", out, "--overwrite")
    assert phdtrack(*asked, "--box", "ltrb").status == 0
    np.testing.assert_allclose(read_tracks(out).xyxy, read_tracks(file).xyxy)
    sized = ("--size", "320x240")
    far = changed(file, lambda row: corners([*row[:2], row[2] + 150, row[3] + 90, *row[4:]]))
    assert "perhaps corners were read as sizes" in refused("export", far, "--to", "csv", *sized)
    asked = ("export", changed(file, shares), "--to", "csv", "--out", out, "--overwrite")
    assert "not in shares" in refused(*asked, *sized)
    assert phdtrack(*asked, *sized, "--units", "shares").status == 0
    np.testing.assert_allclose(read_tracks(out).xyxy, read_tracks(file).xyxy, atol=1e-3)


def test_tracks_to_count_are_read_as_stated(sequence: Path, tmp_path: Path) -> None:
    file = sequence / "gt" / "gt.txt"
    line = ("--line", "gate=160,0,160,240", "--fps", 25, "--frame-size", "320x240")
    asked = ("count", "--json", "--quiet", *line, "--out", tmp_path / "counts", "--overwrite")
    expected = phdtrack(*asked, file).object["counts"]
    assert expected != phdtrack(*asked, empty(file)).object["counts"]
    other = changed(file, shares)
    assert "not in shares of its size" in refused(*asked, other)
    assert phdtrack(*asked, other, "--units", "shares").object["counts"] == expected
    other = changed(file, corners)
    assert phdtrack(*asked, other, "--box", "ltrb").object["counts"] == expected


def empty(file: Path) -> Path:
    path = file.with_name("none.txt")
    path.write_text("")
    return path


def test_scores_of_0_count_in_count_and_export(sequence: Path, tmp_path: Path) -> None:
    file = changed(sequence / "gt" / "gt.txt", lambda row: [*row[:6], 0, 0, -1])
    said = phdtrack("export", file, "--to", "csv", "--out", tmp_path / "out.csv")
    assert "80 rows of 2 tracks" in said.out


@pytest.mark.parametrize(
    "place",
    [
        ("--line", "gate=0.5,0,0.5,1"),
        ("--zone", "shop=0.1,0.1,0.9,0.1,0.9,0.9"),
        ("--places", '[[line]]\nname = "gate"\npoints = [[0.5, 0], [0.5, 1]]\n'),
    ],
)
def test_places_in_shares_are_refused(
    sequence: Path, tmp_path: Path, place: tuple[str, str]
) -> None:
    option, value = place
    if option == "--places":
        (tmp_path / "places.toml").write_text(value)
        value = str(tmp_path / "places.toml")
    said = refused("count", sequence / "gt" / "gt.txt", "--fps", 25, option, value)
    assert "points must be in pixels of the video, not in shares" in said


def test_one_video_of_a_coco_file_is_tracked(tmp_path: Path) -> None:
    names = [f"{folder}/{k:06d}.jpg" for folder in ("north", "south") for k in range(1, 21)]
    images = [{"id": k, "file_name": name} for k, name in enumerate(names)]
    boxes = [{"image_id": k, "bbox": [5 * k, 50, 20, 60]} for k in range(len(names))]
    file = tmp_path / "both.json"
    file.write_text(json.dumps({"images": images, "annotations": boxes}))
    asked = (*TRACK, file, "--out", tmp_path / "run")
    assert "one video, got 2: north, south. Say --sequence north" in refused(*asked)
    said = phdtrack(*asked, "--sequence", "south")
    assert "read the video south of 2" in said.err
    assert len(read_detections(tmp_path / "run" / "detections.csv")) == 20


COMPARE = ("compare", "--filters", "none", "--seeds", 1, "--jobs", 1, "--json", "--overwrite")


def moda(sequence: Path, *more: object) -> tuple[float, int, str]:
    """The MODA and the false boxes that compare finds, and what it reports."""
    said = phdtrack(*COMPARE, sequence, "--out", sequence.with_name("out"), *more)
    assert said.status == 0, said
    run = json.loads(next(sequence.with_name("out").rglob("runs/**/run.json")).read_text())
    return run["scores"]["MODA"], run["scores"]["false_positives"], said.err


@pytest.mark.parametrize(
    ("change", "option", "value"),
    [
        (corners, "--box", "ltrb"),
        (shares, "--units", "shares"),
        (lambda row: [row[0] - 1, *row[1:]], "--first-frame", "0"),
    ],
)
def test_compare_reads_files_as_stated(
    tmp_path: Path, change: Change, option: str, value: str
) -> None:
    sequence = walkers(tmp_path / "seq")
    best, _, _ = moda(sequence)
    truth = changed(sequence / "gt" / "gt.txt", change)
    assert moda(sequence, "--truth", truth, option, f"{value},")[0] == pytest.approx(best, abs=0.05)
    detections = changed(sequence / "det" / "det.txt", change)
    assert moda(sequence, "--detections", detections, option, value)[0] == pytest.approx(best)
    both = ("--truth", truth, "--detections", detections, option, f"{value},{value}")
    assert moda(sequence, *both)[0] == pytest.approx(best, abs=0.05)


def test_compare_scores_keyframes_alone(tmp_path: Path) -> None:
    sequence = walkers(tmp_path / "seq")
    truth = sequence / "gt" / "gt.txt"
    rows = [line for line in truth.read_text().split() if int(line.split(",")[0]) % 5 == 1]
    truth.write_text("\n".join(rows))
    best, false, said = moda(sequence)
    assert (best > 0.5, false) == (True, 0)
    assert "in one of 5 frames, and only these 8 frames are scored" in said
    _, false, said = moda(sequence, "--labelled", "all")
    assert (false > 32, "every 5th" in said) == (True, False)
    assert "frame numbers from 1" in refused(*COMPARE, sequence, "--labelled", "0")


def test_compare_tells_of_truth_that_does_not_fit(tmp_path: Path) -> None:
    sequence = walkers(tmp_path / "seq")
    truth = sequence / "gt" / "gt.txt"
    half = changed(truth, lambda row: [*row[:2], *(one / 2 for one in row[2:6]), *row[6:]])
    assert "at 0.5 times their size" in moda(sequence, "--truth", half)[2]
    asked = (*COMPARE, sequence, "--out", tmp_path / "out", "--truth")
    assert "not in shares of its size" in refused(*asked, changed(truth, shares))
