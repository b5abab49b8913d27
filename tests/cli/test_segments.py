"""Segments of a long video: the frames of each, who is who across a border, and the same whoever
did them.
"""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runner import phdtrack, refused, walkers
from pyarrow import parquet

from phdtrack.formats import read_tracks
from phdtrack.metrics import evaluate
from phdtrack.run.directory import claim, read_run_tracks
from phdtrack.run.segments import Segment, cut, join
from phdtrack.types import Tracks, Truth

pytestmark = pytest.mark.slow

CUT = ("--segment", "0.8s", "--overlap", "0.48s", "--jobs", 1)
REST = ("--", "--no-video", "--filter", "gm-phd")
PARTS = ["1-26", "15-"]


def test_segments_are_even_and_each_frame_is_taken_once() -> None:
    assert cut(30, 40, 4) == [Segment(1, 0, 1)]
    assert cut(0, 40, 4) == [Segment(1, 0, 1)]
    assert cut(100, 40, 5) == [Segment(1, 53, 1), Segment(48, 0, 51)]
    found = cut(1003, 100, 20)
    assert len(found) == 10
    assert {b.begin - a.begin for a, b in pairwise(found)} <= {100, 101}
    assert all(a.last - b.first == 19 for a, b in pairwise(found))


def segment(folder: Path, rows: list[tuple[int, int, float, str]], frames: int) -> Path:
    """The folder of a segment's run: rows of frame, identity, left, class."""
    folder.mkdir(parents=True)
    lines = [
        f"{k},{who},{x},10,20,40,1,-1,-1,-1,0,1{kind and ',' + kind}"
        for k, who, x, kind in sorted(rows)
    ]
    (folder / "tracks.csv").write_text("".join(f"{line}\n" for line in lines))
    (folder / "states.csv").write_text(
        "frame,time,weight\n" + "".join(f"{row[0]},0.1,1\n" for row in sorted(rows))
    )
    (folder / "detections.csv").write_text("")
    about: dict[str, Any] = dict.fromkeys(
        ("title", "versions", "seed", "source", "configuration"), 1
    )
    about |= {"input": {"frames": "1-6"}, "frames": frames, "seconds": 1.0, "warnings": ["dark"]}
    (folder / "run.json").write_text(json.dumps(about))
    return folder


def joined(tmp_path: Path, first: list[Any], second: list[Any]) -> list[list[str]]:
    """Rows (frame, identity, left) of two segments of ten frames, the border before frame 11; they
    have 7 … 14 in common.
    """
    parts = [
        (Segment(1, 14, 1), segment(tmp_path / "a", first, 14)),
        (Segment(7, 0, 11), segment(tmp_path / "b", second, 14)),
    ]
    about = join(parts, claim(tmp_path / "all", False))
    assert (about["frames"], about["seconds"], about["warnings"], about["input"]) == (
        20,
        2.0,
        ["dark"],
        {},
    )
    text = (tmp_path / "all" / "tracks.csv").read_text().splitlines()
    assert about["track_rows"] == len(text)
    assert about["tracks"] == len({line.split(",")[1] for line in text})
    return [line.split(",")[:3] for line in text]


def test_identities_are_kept_across_a_segment_border(
    tmp_path: Path,
) -> None:
    """1 and 2 cross; 9 is in rows of the first segment only, and 4 in those of the second."""
    first = [
        (k, who, x, "") for k in range(1, 15) for who, x in ((1, 100 + 6.0 * k), (2, 232 - 6.0 * k))
    ]
    first += [(k, 9, 400.0, "") for k in range(2, 6)]
    second = [
        (k, who, x, "") for k in range(7, 21) for who, x in ((1, 233 - 6.0 * k), (2, 101 + 6.0 * k))
    ]
    second += [(k, 3, 102 + 6.0 * k, "") for k in range(7, 11)] + [
        (k, 4, 400.0, "") for k in range(15, 21)
    ]
    rows = joined(tmp_path, first, second)
    place = {(int(k), int(who)): float(x) for k, who, x in rows}
    assert len(place) == len(rows) == 2 * 20 + 4 + 6
    assert [place[k, 1] for k in (10, 11, 20)] == [160, 167, 221]
    assert [place[k, 2] for k in (10, 11, 20)] == [172, 167, 113]
    assert {who for k, who in place if k in (3, 16)} == {1, 2, 3, 4}
    assert (place[3, 3], place[16, 4]) == (400, 400)
    # States of each frame from one segment, with one header.
    states = (tmp_path / "all" / "states.csv").read_text().splitlines()
    assert states[0] == "frame,time,weight"
    assert [line.partition(",")[0] for line in states[1:]] == [row[0] for row in rows]


def worth(pairs: int, apart: float | None) -> dict[str, Any]:
    """The appearance of a run.json."""
    return {
        "source": "colours",
        "pairs_of_one_object": pairs,
        "pairs_of_two_objects": 3 * pairs,
        "seconds_apart": apart,
        "told_apart": 0.9 if pairs else None,
        "nats_of_taken_detections": 1.5,
        "taken_detections": 10,
        "nats_of_refused_neighbours": None,
        "refused_neighbours": 0,
        "weight": 0.4,
    }


def test_appearance_of_segments_is_that_of_the_video(tmp_path: Path) -> None:
    """Numbers add up, means are weighted; of lists each segment has its own frames."""
    parts = [
        (Segment(1, 14, 1), segment(tmp_path / "a", [(5, 1, 0, "")], 14)),
        (Segment(7, 0, 11), segment(tmp_path / "b", [(15, 1, 0, "")], 14)),
        (Segment(20, 0, 22), segment(tmp_path / "c", [], 14)),
    ]
    pairs, apart, frames = (30, 0, None), (1.0, None, None), ((9, 12), (10, 11, 12), ())
    for k, (_, folder) in enumerate(parts):
        about = json.loads((folder / "run.json").read_text())
        if pairs[k] is not None:
            about["appearance"] = worth(pairs[k], apart[k])
            about["identities_given_back"] = [
                {"identity": 7, "last_frame": 1, "frame": frame, "odds": 9.0} for frame in frames[k]
            ]
            about["identities_exchanged"] = [{"identities": [1, 2], "frame": 11, "odds": 2.0}]
        (folder / "run.json").write_text(json.dumps(about))
    about = join(parts, claim(tmp_path / "all", False))
    assert about["appearance"] == worth(30, 1.0) | {"taken_detections": 20}
    back = [(one["frame"], one["segment"]) for one in about["identities_given_back"]]
    assert back == [(9, 1), (11, 2), (12, 2)]
    assert [one["segment"] for one in about["identities_exchanged"]] == [2]
    kept = json.loads((tmp_path / "all" / "run.json").read_text())
    assert kept["identities_given_back"] == about["identities_given_back"]


def test_segments_without_appearance_have_no_lists(tmp_path: Path) -> None:
    folder = segment(tmp_path / "a", [(5, 1, 0, "")], 14)
    about = join([(Segment(1, 0, 1), folder)], claim(tmp_path / "all", False))
    assert not {"appearance", "identities_given_back"} & set(about)


def test_segments_match_identities_of_one_class(
    tmp_path: Path,
) -> None:
    first = [(k, 1, 50.0, "car") for k in range(1, 15)] + [
        (k, 2, 300.0, "person") for k in (*range(1, 9), 13, 14)
    ]
    second = [(k, 1, 50.0, "person") for k in range(7, 21)] + [
        (k, 2, 301.0, "person") for k in range(13, 21)
    ]
    rows = joined(tmp_path, first, second)
    assert {who for k, who, _ in rows if int(k) > 12} == {"2", "3"}
    assert {who for _, who, x in rows if float(x) >= 300} == {"2"}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a sequence of detections, and in ``all`` the batch of its segments by one call,
    in ``plain`` without.
    """
    folder = walkers(tmp_path_factory.mktemp("long") / "walk")
    assert (
        phdtrack(
            "batch", folder / "det/det.txt", "--out", folder / "plain", "--jobs", 1, *REST
        ).status
        == 0
    )
    said = phdtrack("batch", folder / "det/det.txt", "--out", folder / "all", *CUT, *REST)
    assert said.status == 0, said.err
    assert "1 video: 1 now, 0 before, 0 failed." in said.out
    return folder


def same(out: Path, other: Path) -> None:
    """The video is joined to the same files."""
    for name in (
        "runs/det/tracks.csv",
        "runs/det/states.csv",
        "runs/det/detections.csv",
        "tracks/det.parquet",
    ):
        assert (out / name).read_bytes() == (other / name).read_bytes(), name


def test_the_tracks_are_those_of_the_whole(whole: Path) -> None:
    run = read_run_tracks(whole / "all" / "runs" / "det")
    plain = read_tracks(whole / "plain" / "runs" / "det" / "tracks.csv")
    assert sorted(path.name for path in (whole / "all/segments/det").iterdir()) == sorted(PARTS)
    assert (run.info.frames, run.info.width, len(np.unique(run.tracks.identity))) == (40, 320, 2)
    truth = Truth(plain.frame, plain.identity, plain.xyxy, np.zeros(len(plain), bool))
    scores = evaluate(truth, run.tracks)
    assert (scores.id_switches, scores.IDF1 > 0.97) == (0, True)
    table = parquet.read_table(whole / "all" / "tracks")
    assert table.num_rows == len(run.tracks)
    np.testing.assert_allclose(table["time"].to_numpy(), (run.tracks.frame - 1) / 25, atol=1e-6)
    # Detections of each frame are there once.
    for name in ("detections.csv", "states.csv"):
        there = [
            (whole / out / "runs/det" / name).read_text().splitlines() for out in ("all", "plain")
        ]
        if name == "detections.csv":
            assert there[0] == there[1]
        else:
            assert abs(len(there[0]) - len(there[1])) <= 4
    found = json.loads((whole / "all" / "batch.json").read_text())["videos"][0]
    assert (found["state"], found["frames"], found["segments"]) == ("done", 40, 2)


def test_shards_do_the_same_and_the_last_one_joins(whole: Path, tmp_path: Path) -> None:
    words = ("batch", whole / "det/det.txt", "--out", tmp_path, "--json", *CUT)
    told = list[dict[str, Any]]()
    for k in (1, 2):
        said = phdtrack(*words, "--shard", f"{k}/2", *REST)
        assert (said.status, said.object["complete"]) == (0, True)
        told += said.object["videos"]
    assert [one["state"] for one in told] == ["missing", "done"]
    same(tmp_path, whole / "all")
    again = phdtrack(*words, *REST).object
    assert (again["reused"], again["complete"], again["videos"][0]["state"]) == (1, True, "done")
    # Rows that were lost are joined again, from the segments.
    (tmp_path / "tracks" / "det.parquet").unlink()
    assert phdtrack(*words, *REST).object["complete"]
    same(tmp_path, whole / "all")


def test_a_failed_segment_is_retried_by_the_next_call(whole: Path, tmp_path: Path) -> None:
    words = ("batch", whole / "det/det.txt", "--out", tmp_path, *CUT, *REST)
    stone = tmp_path / "segments" / "det" / PARTS[0]
    stone.parent.mkdir(parents=True)
    stone.write_text("in the way")
    said = phdtrack(*words)
    assert (said.status, "0 now, 0 before, 1 failed" in said.out) == (1, True)
    found = json.loads((tmp_path / "batch.json").read_text())["videos"][0]
    assert found["state"] == "failed"
    assert found["error"].startswith(f"det {PARTS[0]}: ")
    assert not (tmp_path / "runs" / "det").exists()
    begun = (stone.parent / PARTS[1] / "tracks.csv").stat().st_mtime_ns
    stone.unlink()
    assert "1 now, 0 before, 0 failed" in phdtrack(*words).out
    assert (stone.parent / PARTS[1] / "tracks.csv").stat().st_mtime_ns == begun
    same(tmp_path, whole / "all")
    # Other segments are other options.
    other = (
        "batch",
        whole / "det/det.txt",
        "--out",
        tmp_path,
        "--segment",
        "0.5",
        "--overlap",
        "0.2",
        *REST,
    )
    assert "1 run there (det, …) had other options" in refused(*other)


def test_what_cannot_be_cut_is_refused(whole: Path, tmp_path: Path) -> None:
    words = ("batch", whole / "det/det.txt", "--out", tmp_path / "no", "--segment")
    assert "segments of 10 s cannot have 20 s in common" in refused(*words, "10s")
    assert "a segment is a choice of frames already" in refused(
        *words, "1m", "--", "--frames", "1-5"
    )
    assert "expected a duration as 90s, 10m or 1h, got 'ten'" in phdtrack(*words, "ten").err
    assert not (tmp_path / "no").exists()


@pytest.mark.parametrize("frames", ["11-30", "21-"])
def test_chosen_frames_keep_numbers_and_times(frames: str, whole: Path, tmp_path: Path) -> None:
    first = int(frames.split("-")[0])
    last = int(frames.split("-")[1] or 40)
    words = (
        "track",
        "--detections",
        whole / "det/det.txt",
        "--frames",
        frames,
        "--truth",
        whole / "gt/gt.txt",
    )
    about = phdtrack(*words, "--out", tmp_path, "--json", "--no-video").object
    tracks: Tracks = read_tracks(tmp_path / "tracks.csv")
    assert (about["frames"], about["input"]["frames"]) == (last - first + 1, frames)
    assert (tracks.frame.min(), tracks.frame.max()) == (first, last)
    assert (about["scores"]["frames"], about["scores"]["misses"]) == (last - first + 1, 0)
    assert not about["warnings"]
    line = (tmp_path / "states.csv").read_text().splitlines()[1].split(",")
    assert float(line[1]) == pytest.approx((int(line[0]) - 1) / 25, abs=1e-6)


def test_wrong_choices_of_frames_are_one_sentence(whole: Path, tmp_path: Path) -> None:
    for text in ("9-3", "0-4", "x", "1-2-3"):
        said = refused(
            "track",
            "--detections",
            whole / "det/det.txt",
            "--frames",
            text,
            "--out",
            tmp_path / "no",
        )
        assert f"--frames: expected frames as 1500-3000, from 1, got {text!r}" in said
    late = phdtrack(
        "track",
        "--detections",
        whole / "det/det.txt",
        "--frames",
        "90-",
        "--out",
        tmp_path,
        "--no-video",
    )
    assert "there is no frame 90: the last one is 40" in late.err
