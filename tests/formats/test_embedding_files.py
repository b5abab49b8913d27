"""Embeddings in NumPy files: which row of the file of detections each belongs to, and what is
refused.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phdtrack.detect import TableDetector
from phdtrack.detect.convert import within_frame
from phdtrack.errors import InputError
from phdtrack.formats import read_detections
from phdtrack.formats.checks import MalformedRows
from phdtrack.formats.embeddings import EmbeddingsWriter, open_embeddings
from phdtrack.types import Frame, SequenceInfo

FRAME = np.zeros((0, 0, 3), np.uint8)


def lefts_and_rows(path: Path, *, skip: bool = False) -> tuple[list[float], list[int], int]:
    """The left sides of the boxes in a file, the row of each there, and the number of its rows."""
    wrong = MalformedRows() if skip else None
    table = read_detections(path, left_out=wrong)
    return table.detections.xyxy[:, 0].tolist(), table.file_row.tolist(), table.rows


@pytest.mark.parametrize("header", ["", "frame,id,left,top,width,height,score\n"])
def test_rows_of_text_are_those_with_values(tmp_path: Path, header: str) -> None:
    lines = [
        "# made by hand",
        "2,-1,20,5,9,9,1",
        "",
        "1,-1,10,5,9,9,1",
        "1,-1,11,5,0,9,1",
        "# more",
        "1,-1,12,5,9,9,1",
    ]
    (tmp_path / "det.txt").write_text(header + "\n".join(lines) + "\n")
    assert lefts_and_rows(tmp_path / "det.txt") == ([10, 12, 20], [1, 3, 0], 4)


def test_malformed_rows_keep_the_place_of_others(tmp_path: Path) -> None:
    rows = ["1,-1,10,5,9,9,1", "1,-1,x,5,9,9,1", "1,-1,12,5,-9,9,1", "2,-1,13,5,9,9,1"]
    (tmp_path / "det.txt").write_text("\n".join(rows) + "\n")
    assert lefts_and_rows(tmp_path / "det.txt", skip=True) == ([10, 13], [0, 3], 4)
    lines = [
        '{"frame": 2, "bbox": [20, 5, 9, 9]}',
        "{broken",
        '{"frame": 1, "bbox": [10, 5, 9, 9]}',
    ]
    (tmp_path / "det.jsonl").write_text("\n".join(lines) + "\n")
    assert lefts_and_rows(tmp_path / "det.jsonl", skip=True) == ([10, 20], [2, 0], 3)
    entries: list[Any] = [
        {"image_id": 2, "bbox": [20, 5, 9, 9], "score": 1},
        {"image_id": 1, "bbox": [15, 5, 9], "score": 1},
        {"image_id": 1, "bbox": [10, 5, 9, 9], "score": 1},
    ]
    (tmp_path / "det.json").write_text(json.dumps(entries))
    assert lefts_and_rows(tmp_path / "det.json", skip=True) == ([10, 20], [2, 0], 3)


def test_kitti_regions_keep_the_place_of_others(tmp_path: Path) -> None:
    rest = "1.5 1.6 4.0 1 2 10 0.1"
    lines = [
        f"0 -1 DontCare -1 -1 -10 1 1 9 9 {rest}",
        f"1 1 Car 0 0 0 20 5 29 14 {rest}",
        f"0 1 Car 0 0 0 10 5 19 14 {rest}",
    ]
    (tmp_path / "0001.txt").write_text("\n".join(lines) + "\n")
    assert lefts_and_rows(tmp_path / "0001.txt") == ([10, 20], [2, 1], 3)


def test_table_detector_finds_the_row_of_each_box(tmp_path: Path) -> None:
    rows = ["2,-1,20,5,9,9,1", "1,-1,900,5,9,9,1", "1,-1,12,5,9,9,1", "3,-1,30,5,9,9,1"]
    (tmp_path / "det.txt").write_text("\n".join(rows) + "\n")
    np.save(tmp_path / "looks.npy", np.array([[20, 2], [900, 1], [12, 1], [30, 3]], np.float16))
    table = read_detections(tmp_path / "det.txt")
    inside, _ = within_frame(table, SequenceInfo(320, 240, 25.0), tmp_path / "det.txt")
    looks = open_embeddings(tmp_path / "looks.npy", inside.rows, "det.txt")
    assert isinstance(looks, np.memmap)
    detector = TableDetector(inside, looks)
    for number, expected in ((1, [[12, 1]]), (2, [[20, 2]]), (3, [[30, 3]])):
        embeddings = detector(Frame(number, 0.0, FRAME)).embeddings
        assert embeddings is not None
        assert embeddings.dtype == np.float32
        np.testing.assert_array_equal(embeddings, expected)
    empty = detector(Frame(4, 0.0, FRAME)).embeddings
    assert empty is not None
    assert empty.shape == (0, 2)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (np.zeros((3, 4)), "expected 2 rows, as det.txt has, got 3"),
        (np.zeros(2), "expected embeddings (rows, length), got (2,) of float64"),
        (np.array([["a"], ["b"]]), "got (2, 1) of <U1"),
        (np.array([[None], [1]], object), "expected a NumPy file of numbers"),
        (np.zeros((2, 0)), "got rows of no numbers"),
        (b"1,2,3\n4,5,6\n", "expected a NumPy file of numbers"),
        (b"", "expected a NumPy file of numbers"),
        (None, "there is no such file"),
    ],
)
def test_files_that_cannot_be_right(tmp_path: Path, content: Any, message: str) -> None:
    path = tmp_path / "looks.npy"
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content is not None:
        np.save(path, content, allow_pickle=True)
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        open_embeddings(path, 2, "det.txt")
    assert str(path) in str(caught.value)


def test_archives_and_unfinished_files_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "looks.npz", a=np.zeros((2, 3)))
    with pytest.raises(InputError, match="got an archive of arrays"):
        open_embeddings(tmp_path / "looks.npz", 2, "det.txt")
    with pytest.raises(InputError, match="not complete"):
        open_embeddings(tmp_path / "looks.npy.part", 2, "det.txt")


def test_writer_writes_what_numpy_reads(tmp_path: Path) -> None:
    path = tmp_path / "out" / "detections.npy"
    looks = np.array([[1, 0.5, -2], [0, 3, 1]], np.float32)
    with EmbeddingsWriter(path) as writer:
        writer.append(None, 2)
        writer.append(looks, 2)
        writer.append(np.zeros((0, 3), np.float32), 0)
        writer.append(None, 1)
        assert not path.exists()
    writer.close()
    found = np.load(path)
    assert found.dtype == np.float16
    np.testing.assert_array_equal(found, [*np.zeros((2, 3)), *looks, np.zeros(3)])
    np.save(tmp_path / "same.npy", found)
    assert path.read_bytes() == (tmp_path / "same.npy").read_bytes()


def test_writer_leaves_an_unfinished_name_after_errors(tmp_path: Path) -> None:
    path = tmp_path / "detections.npy"
    writer = EmbeddingsWriter(path, np.float32)
    writer.append(np.ones((1, 4), np.float32), 1)
    writer.__exit__(KeyError, None, None)
    assert [one.name for one in tmp_path.iterdir()] == ["detections.npy.part"]
    with EmbeddingsWriter(path):
        pass
    assert open_embeddings(path, 0, "det.txt").shape == (0, 0)
