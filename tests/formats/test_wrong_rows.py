"""Malformed rows: the first is an error, or all are skipped and counted; the range of frame
numbers.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from format_cases import put

from phdtrack.detect.table_detector import frames_walked
from phdtrack.errors import InputError
from phdtrack.formats import read_detections, read_tracks, read_truth
from phdtrack.formats.checks import MalformedRows
from phdtrack.types import Detections, DetectionTable

MOT = [f"{k},-1,{10 * k},20,30,60,0.5" for k in range(1, 6)]
NAMED = ["frame;x1;y1;x2;y2;class", *(f"{k};{10 * k};20;{10 * k + 30};80;car" for k in range(1, 6))]
KITTI = [f"{k} 1 Car 0 0 -1 {10 * k} 20 60 80 -1 -1 -1 -1 -1 -1 -1 0.5" for k in range(5)]


@pytest.mark.parametrize(
    ("rows", "at", "bad", "words"),
    [
        (MOT, 2, "3,-1,x,20,30,60,0.5", "expected a number for the left"),
        (MOT, 2, "3,-1,30,20,-30,60,0.5", "a width and a height above 0"),
        (MOT, 2, "3,-1,nan,20,30,60,0.5", "finite numbers"),
        (MOT, 2, "0,-1,30,20,30,60,0.5", "frame 1 or later"),
        (MOT, 2, "10000000001,-1,30,20,30,60,0.5", "frame 10,000,000,000 or earlier"),
        (MOT, 2, "1e400,-1,30,20,30,60,0.5", "whole number"),
        (MOT, 4, "5,-1,50,2", "expected 7 values"),
        (NAMED, 3, "3;x;20;60;80;car", "expected a number for the x1"),
        (NAMED, 3, "3;30;20;60;80;7", "a word for the class"),
        (NAMED, 1, "1;10", "expected 6 values"),
        (NAMED, 5, "5;50;20", "expected 6 values"),
        (KITTI, 4, "4 1 Car 0 0 -1 40", "expected 18 "),
    ],
)
def test_malformed_text_rows_are_errors_or_skipped(
    tmp_path: Path, rows: list[str], at: int, bad: str, words: str
) -> None:
    """A cut last line, too. The others are read as if it were not there."""
    path = put(tmp_path, "\n".join([*rows[:at], bad, *rows[at + 1 :]]) + "\n")
    with pytest.raises(InputError, match=words) as caught:
        read_detections(path)
    assert caught.value.where.startswith(f"{path}, line {at + 1}")
    left_out = MalformedRows()
    table = read_detections(path, left_out=left_out)
    without = read_detections(put(tmp_path, "\n".join([*rows[:at], *rows[at + 1 :]]), "good.txt"))
    assert table.frame.tolist() == without.frame.tolist()
    np.testing.assert_array_equal(table.detections.xyxy, without.detections.xyxy)
    document = left_out.document()
    assert document["rows_left_out"] == 1
    assert str(document["first_left_out"]).startswith(f"{path}, line {at + 1}: expected")
    assert left_out.sentences() == (f"1 malformed row skipped: {document['first_left_out']}",)


def test_first_malformed_row_is_named_and_all_counted(tmp_path: Path) -> None:
    rows = [*MOT[:1], "2,-1,5,5,-5,5,1", "2,-1,x,5,5,5,1", MOT[2], "3,-1,5,5,-5,5,1"]
    left_out = MalformedRows()
    assert len(read_detections(put(tmp_path, "\n".join(rows)), left_out=left_out)) == 2
    assert left_out.rows == 3
    assert ", line 2: expected a width" in str(left_out.first)
    assert "3 malformed rows skipped" in left_out.sentences()[0]


def test_malformed_json_entries_are_errors_or_skipped(tmp_path: Path) -> None:
    entries: list[Any] = [
        {"image_id": k, "bbox": [10 * k, 20, 30, 60], "score": 0.5} for k in range(1, 5)
    ]
    entries[1:1] = [
        {"image_id": 2, "bbox": [1, 2, 3]},
        7,
        {"image_id": 10**20, "bbox": [1, 2, 3, 4]},
    ]
    path = put(tmp_path, json.dumps(entries), "boxes.json")
    with pytest.raises(InputError, match="four numbers for bbox"):
        read_detections(path)
    left_out = MalformedRows()
    assert read_detections(path, left_out=left_out).frame.tolist() == [1, 2, 3, 4]
    assert left_out.rows == 3
    assert left_out.first is not None
    assert left_out.first.where == f"{path}, entry 2"


def test_file_without_a_valid_row_is_refused(tmp_path: Path) -> None:
    for content in ("1,-1,5,5,-5,5,1\n", "1,-1,a,5,5,5,1\n2,-1,b,5,5,5,1\n"):
        with pytest.raises(InputError, match="line 1"):
            read_detections(put(tmp_path, content), left_out=MalformedRows())


def test_frame_number_beyond_the_last_is_refused(tmp_path: Path) -> None:
    good = put(tmp_path, "10000000000,1,10,20,30,60,1\n")
    assert read_detections(good).last == 10_000_000_000
    path = put(tmp_path, "10000000001,1,10,20,30,60,1\n", "far.txt")
    for reader in (read_detections, read_truth, read_tracks):
        with pytest.raises(InputError, match="or earlier, got 10000000001"):
            reader(path)


def walked(frames: list[int], last: int, fps: float) -> list[int]:
    return list(
        frames_walked(
            DetectionTable(np.array(frames), Detections.of(np.zeros((len(frames), 4)))), last, fps
        )
    )


def test_short_gaps_are_visited_frame_by_frame() -> None:
    assert walked([3, 3, 9], 12, 25.0) == list(range(1, 13))
    assert walked([1500, 3001], 3001, 25.0) == list(range(1, 3002))
    assert walked([], 5, 25.0) == [1, 2, 3, 4, 5]
    assert walked([7], 5, 25.0) == [1, 2, 3, 4, 5]
    assert walked([], 0, 25.0) == []


@pytest.mark.parametrize(("fps", "longest"), [(25.0, 1500), (1.0, 250), (1e300, 100_000)])
def test_long_gaps_are_skipped_after_a_minute(fps: float, longest: int) -> None:
    """Wherever they are; the detections' frames and the last one are never left out."""
    found = walked([10**9, 10**9 + 1], 10**10, fps)
    assert found == [
        *range(1, longest + 1),
        10**9,
        *range(10**9 + 1, 10**9 + 2 + longest),
        10**10,
    ]
