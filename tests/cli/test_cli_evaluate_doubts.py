"""`phdtrack evaluate` of files that do not fit each other."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from cli_runner import phdtrack, refused, walkers

Change = Callable[[list[float]], list[float] | None]


@pytest.fixture
def truth(tmp_path: Path) -> Path:
    """Two walkers of 24x60 pixels in frames 1 to 40, without seqinfo.ini."""
    return walkers(tmp_path / "seq", seqinfo=False) / "gt" / "gt.txt"


def changed(truth: Path, change: Change, name: str = "tracks.txt") -> Path:
    """The truth's rows as ``change`` gives them, None for no row."""
    rows = [[float(cell) for cell in line.split(",")] for line in truth.read_text().split()]
    path = truth.with_name(name)
    kept = [row for row in map(change, rows) if row is not None]
    path.write_text("\n".join(",".join(f"{cell:g}" for cell in row) for row in kept))
    return path


def scores(truth: Path, tracks: Path, *more: object) -> tuple[dict[str, Any], str]:
    said = phdtrack("evaluate", "--truth", truth, "--tracks", tracks, "--json", "--quiet", *more)
    assert said.status == 0, said
    return said.object, said.err


def test_a_file_without_tracks_says_so(truth: Path) -> None:
    for content in ("", "frame,id,left,top,width,height\n", "<annotations/>", "[]"):
        empty = truth.with_name("empty.txt")
        empty.write_text(content)
        found, said = scores(truth, empty)
        assert (found["MOTA"], found["misses"]) == (0, 80)
        assert "the file holds no track" in said


@pytest.mark.parametrize(
    ("change", "words", "cure"),
    [
        (lambda row: [*row[:4], row[2] + row[4], row[3] + row[5], 1], "corners", (",ltrb",)),
        (lambda row: [*row[:2], *(one / 2 for one in row[2:6]), 1], "at 2 times", ()),
        (lambda row: [*row[:2], *(one * 3 for one in row[2:6]), 1], "at 0.333 times", ()),
        (lambda row: [row[0], row[1], row[2] + 5, *row[3:6], 1], "", ()),
    ],
)
def test_tracks_in_other_units_are_told(
    truth: Path, change: Change, words: str, cure: tuple[str, ...]
) -> None:
    tracks = changed(truth, change)
    _, said = scores(truth, tracks)
    assert bool(said) == bool(words)
    assert words in said
    if cure:
        found, said = scores(truth, tracks, "--box", *cure)
        assert (found["MOTA"], said) == (1, "")


@pytest.mark.parametrize("which", ["truth", "tracks"])
def test_frames_that_count_from_0_are_told(truth: Path, which: str) -> None:
    """Objects faster than their width, and nobody in the first frame."""
    fast = changed(truth, lambda row: [row[0] + 3, row[1], 40 * row[0], *row[3:]], "fast.txt")
    early = changed(fast, lambda row: [row[0] - 1, *row[1:]], "early.txt")
    files = (early, fast) if which == "truth" else (fast, early)
    option = "0," if which == "truth" else ",0"
    found, said = scores(*files)
    assert found["MOTA"] < 0
    assert f"of the {which} count from 0? Say --first-frame {option}" in said
    found, said = scores(*files, "--first-frame", option)
    assert (found["MOTA"], said) == (1, "")


def test_shares_are_refused_where_the_size_is_known(truth: Path) -> None:
    shares = changed(
        truth, lambda row: [*row[:2], row[2] / 320, row[3] / 240, row[4] / 320, row[5] / 240, 1]
    )
    asked = ("evaluate", "--truth", truth, "--tracks", shares, "--frame-size", "320x240")
    assert "tracks.txt: no coordinate exceeds" in refused(*asked)
    found, _ = scores(truth, shares, "--units", ",shares", "--frame-size", "320x240")
    assert found["MOTA"] == 1
    found, _ = scores(shares, truth, "--units", "shares,", "--frame-size", "320x240")
    assert found["MOTA"] == 1


def test_shares_are_refused_beside_pixels(truth: Path) -> None:
    """The other file's boxes say how large the frame is."""
    shares = changed(
        truth, lambda row: [*row[:2], row[2] / 320, row[3] / 240, row[4] / 320, row[5] / 240, 1]
    )
    asked = ("evaluate", "--truth", truth, "--tracks", shares)
    assert "tracks.txt: no coordinate exceeds" in refused(*asked)
    assert "size of the frames" in refused(*asked, "--units", "shares")
    found, _ = scores(truth, shares, "--units", ",pixels")
    assert found["MOTA"] == -1
    found, _ = scores(shares, shares)
    assert found["MOTA"] == 1


def test_truth_of_flag_0_alone_is_told(truth: Path) -> None:
    unscored = changed(truth, lambda row: [*row[:6], 0, 1, 1], "gt0.txt")
    _, said = scores(unscored, truth)
    assert "all 80 rows have flag 0" in said


def test_corners_are_refused_where_the_size_is_known(tmp_path: Path) -> None:
    truth = walkers(tmp_path / "seq") / "gt" / "gt.txt"
    right = changed(truth, lambda row: [*row[:2], row[2] + 150, row[3] + 90, *row[4:]], "right.txt")
    tracks = changed(right, lambda row: [*row[:4], row[2] + row[4], row[3] + row[5], 1])
    asked = ("evaluate", "--truth", right, "--tracks", tracks)
    assert "--box ltrb" in refused(*asked)
    assert scores(right, tracks, "--box", ",ltrb") == ({**scores(right, right)[0]}, "")
    # What the user states is not doubted.
    assert scores(right, tracks, "--box", ",ltwh")[0]["MOTA"] < 1


def test_lists_that_ignore_nothing_are_told(truth: Path) -> None:
    listed = truth.with_name("ignore.csv")
    for rows, words in (
        (",0.1,0.1,0.5,0.5\n", "none of the 1 rows touches a box"),
        ("99,20,60,50,50\n", "none of the 1 rows touches a box"),
        ("", "the list is empty"),
        (",20,60,50,50\n", ""),
        ("3,20,60,50,50\n", ""),
    ):
        listed.write_text(f"frame,x,y,w,h\n{rows}")
        _, said = scores(truth, truth, "--ignore", listed)
        assert words in said
        assert bool(said) == bool(words)


def test_doubts_of_classes_are_told(truth: Path) -> None:
    classes = truth.with_name("classes.csv")
    rows = [line.split(",") for line in truth.read_text().split()]
    lines = [",".join([*row[:6], "car" if row[1] == "1" else "bus"]) for row in rows]
    classes.write_text("frame,id,left,top,width,height,class\n" + "\n".join(lines))
    listed = truth.with_name("ignore.csv")
    listed.write_text("frame,x,y,w,h\n,20,60,90,50\n")
    asked = ("--per-class", "--ignore", listed)
    found, said = scores(classes, classes, *asked)
    assert (list(found["classes"]), said) == (["car", "bus"], "")
    listed.write_text("frame,x,y,w,h\n,0.1,0.1,0.5,0.5\n")
    assert "none of the 1 rows touches a box" in scores(classes, classes, *asked)[1]
    empty = truth.with_name("empty.txt")
    empty.write_text("")
    assert "the file holds no track" in scores(classes, empty, "--per-class")[1]


def with_classes(path: Path, name: str) -> Path:
    """The same rows with a header, and of two classes."""
    rows = [line.split(",") for line in path.read_text().split()]
    lines = [",".join([*row[:6], "car" if row[1] == "1" else "bus"]) for row in rows]
    named = path.with_name(name)
    named.write_text("frame,id,left,top,width,height,class\n" + "\n".join(lines))
    return named


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda row: [*row[:2], *(one / 2 for one in row[2:6])], "at 2 times"),
        (lambda row: [row[0] - 1, *row[1:6]], "of the tracks count from 0? Say --first-frame ,0"),
        (lambda row: [row[0] + 40, *row[1:6]], "40 of 40 rows lie after frame"),
    ],
)
def test_classes_that_do_not_fit_are_told(truth: Path, change: Change, words: str) -> None:
    fast = changed(truth, lambda row: [row[0] + 1, row[1], 40 * row[0], *row[3:]], "fast.txt")
    of_truth = with_classes(fast, "truth.csv")
    for one in (1, 2):
        own = changed(fast, lambda row, own=one: row if row[1] == own else None, "own.txt")
        tracks = with_classes(changed(own, change), "tracks.csv")
        _, plain = scores(of_truth, tracks)
        found, said = scores(of_truth, tracks, "--per-class")
        assert list(found["classes"]) == (["car", "bus"] if one == 1 else ["bus", "car"])
        assert words in said
        assert said == plain


def test_classes_in_shares_are_refused(truth: Path) -> None:
    shares = changed(truth, lambda row: [*row[:2], *(one / 320 for one in row[2:6])])
    asked = ("--truth", with_classes(truth, "truth.csv"), "--tracks", with_classes(shares, "t.csv"))
    assert "no coordinate exceeds" in refused("evaluate", *asked, "--per-class")


def test_keyframes_of_classes_are_scored_alone(truth: Path) -> None:
    keys = changed(truth, lambda row: row if row[0] % 5 == 1 else None, "keys.txt")
    files = (with_classes(keys, "keys.csv"), with_classes(truth, "tracks.csv"))
    found, said = scores(*files, "--per-class")
    assert [one["MOTA"] for one in found["classes"].values()] == [1, 1]
    assert "only these 8 frames are scored" in said
    found, said = scores(*files, "--per-class", "--labelled", "all")
    assert all(one["MOTA"] < 0 for one in found["classes"].values())


def test_rows_after_the_end_are_told(tmp_path: Path, truth: Path) -> None:
    tracks = truth.with_name("long.txt")
    late = [f"{k},9,5,5,20,20,1,-1,-1,-1" for k in range(41, 51)]
    tracks.write_text(truth.read_text() + "\n".join(late))
    found, said = scores(truth, tracks)
    assert (found["false_positives"], found["frames"]) == (10, 50)
    assert "10 of 90 rows lie after frame 40, the last with an object, and count" in said
    found, said = scores(truth, tracks, "--frames", 40)
    assert (found["MOTA"], found["frames"]) == (1, 40)
    assert "40, the end of the sequence, and do not count" in said
    info = "[Sequence]\nframeRate=25\nseqLength=45\nimWidth=320\nimHeight=240\n"
    (truth.parents[1] / "seqinfo.ini").write_text(info)
    found, said = scores(truth, tracks)
    assert (found["false_positives"], found["frames"]) == (5, 45)
    assert "5 of 90 rows lie after frame 45" in said


def test_labelled_keyframes_are_scored_alone(truth: Path) -> None:
    keys = changed(truth, lambda row: row if row[0] % 5 == 1 else None, "keys.txt")
    found, said = scores(keys, truth)
    assert (found["MOTA"], found["frames"]) == (1, 8)
    assert "in one of 5 frames, and only these 8 frames are scored" in said
    found, said = scores(keys, truth, "--labelled", "all")
    assert (found["MOTA"] < 0, found["frames"], "one of" in said) == (True, 40, False)
    listed = truth.with_name("frames.txt")
    listed.write_text("1\n6\n11\n16-17\n")
    found, _ = scores(keys, truth, "--labelled", listed)
    assert (found["frames"], found["false_positives"]) == (5, 2)
    assert scores(keys, truth, "--labelled", "1,6")[0]["frames"] == 2
    for wrong in ("0", "3-1", "1 x"):
        listed.write_text(wrong)
        said = refused("evaluate", "--truth", keys, "--tracks", truth, "--labelled", listed)
        assert "frame numbers from 1 as 1,11,21-30" in said


def test_causes_of_errors_are_of_the_labelled_frames(truth: Path) -> None:
    """An object is detected in frames 1 and 6 and tracked in 1 alone: the miss of frame 6 had a
    detection, those of the frames between do not count.
    """
    keys = changed(truth, lambda row: row if row[0] in (1, 6) else None, "keys.txt")
    own = changed(truth, lambda row: row if row[0] == 1 or row[1] == 2 else None, "tracks.txt")
    asked = ("--errors", "--detections", truth, "--labelled", "1,6")
    found, _ = scores(keys, own, *asked)
    assert (found["frames"], found["misses"]) == (2, 1)
    misses = found["errors"]["misses"]
    assert (sum(misses["unused"].values()), sum(misses["undetected"].values())) == (1, 0)
    assert sum(found["errors"]["false_positives"].values()) == 0


def test_irregular_keyframes_are_told(truth: Path) -> None:
    chosen = (1, 2, 9, 17, 30, 40)
    keys = changed(truth, lambda row: row if row[0] in chosen else None, "keys.txt")
    found, said = scores(keys, truth)
    assert found["MOTA"] < 0
    assert "annotated in 6 of 40 frames" in said
    found, said = scores(keys, truth, "--labelled", "truth")
    assert (found["MOTA"], said) == (1, "")


def test_options_are_checked(truth: Path) -> None:
    asked = ("evaluate", "--truth", truth, "--tracks", truth)
    for option, value, words in (
        ("--format", "mot16", "expected mot15, mot17"),
        ("--first-frame", "2", "expected 0 or 1"),
        ("--units", "metres", "expected pixels, shares"),
        ("--box", "ltwh,ltrb,ltwh", "TRUTH,FILE"),
    ):
        assert words in refused(*asked, option, value)
    assert "17 columns" in refused(*asked, "--format", "kitti")
    assert "JSON" in refused(*asked, "--format", ",coco")
