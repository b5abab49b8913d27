"""Parquet, with and without pyarrow."""

import importlib
import sys
from pathlib import Path

import pytest
from format_cases import refused

from phdtrack.errors import InputError
from phdtrack.formats import read_detections, read_tracks, read_truth

arrow = importlib.import_module("pyarrow")
parquet = importlib.import_module("pyarrow.parquet")
BOX: dict[str, list[object]] = {"X1": [1.0, 2.0], "Y1": [1, 2], "X2": [5.0, 5.0], "Y2": [9, 9]}


def put(folder: Path, columns: dict[str, list[object]]) -> Path:
    path = folder / "boxes.parquet"
    parquet.write_table(arrow.table(columns), path)
    return path


def test_parquet_columns_are_found_by_name(tmp_path: Path) -> None:
    more = {"score": [0.5, -3.0], "track_id": [4, 4], "name": ["a", "b"], "ignore": [True, False]}
    path = put(tmp_path, {"Frame ID": [2, 1], **BOX, **more})
    table = read_detections(path)
    assert table.frame.tolist() == [1, 2]
    assert table.detections.xyxy.tolist() == [[2, 2, 5, 9], [1, 1, 5, 9]]
    assert table.detections.confidence.tolist() == [-3, 0.5]
    truth = read_truth(path)
    assert (truth.identity.tolist(), truth.distractor.tolist()) == ([4, 4], [False, True])
    assert read_tracks(path).frame.tolist() == [1]


def test_empty_parquet_tables_and_columns(tmp_path: Path) -> None:
    assert (
        len(read_detections(put(tmp_path, {"frame": [], "x": [], "y": [], "w": [], "h": []}))) == 0
    )
    table = read_detections(
        put(tmp_path, {"frame": [1, 1], **BOX, "score": [None, None], "class": [None, None]})
    )
    assert table.detections.confidence.tolist() == [1, 1]


@pytest.mark.parametrize(
    ("columns", "where", "words"),
    [
        ({"frame": [1, 0], **BOX}, ", row 2", "expected frame 1 or later, got 0"),
        ({"frame": [1, None], **BOX}, ", row 2", "whole number for the frame number, got nan"),
        ({"frame": ["one", "two"], **BOX}, "", "numbers in the column frame, got string"),
        ({"time": [1, 2], **BOX}, "", "no column for the frame; the columns are time, x1"),
    ],
)
def test_the_message_names_the_row(
    tmp_path: Path, columns: dict[str, list[object]], where: str, words: str
) -> None:
    refused(read_detections, put(tmp_path, columns), where, words)


@pytest.mark.parametrize("damage", ["cut short", "footer"])
def test_broken_parquet_file_is_refused(tmp_path: Path, damage: str) -> None:
    path = put(tmp_path, {"frame": [1, 2], **BOX})
    good = path.read_bytes()
    start = len(good) - 8 - int.from_bytes(good[-8:-4], "little")
    path.write_bytes(
        good[:-20] if damage == "cut short" else good[:start] + b"\xff" * 8 + good[start + 8 :]
    )
    refused(read_detections, path, "", "expected a Parquet file, which cannot be read")


def test_class_names_that_are_not_utf_8_are_refused(tmp_path: Path) -> None:
    words = arrow.array([b"car", b"\xe1us"]).view(arrow.string())
    path = put(tmp_path, {"frame": [1, 2], **BOX, "class": words})
    refused(read_detections, path, "", "numbers in the column class, got string")


def test_missing_pyarrow_is_reported_with_install_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = put(tmp_path, {"frame": [1, 2], **BOX})
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(
        InputError, match=r"needs the package pyarrow.*pip install 'phdtrack\[parquet\]'"
    ):
        read_detections(path)
