"""Every format in which tracks are exported can be read as tracks, as detections and as truth."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from format_cases import put, refused
from hypothesis import given, settings
from hypothesis import strategies as st

import phdtrack
from phdtrack.errors import InputError
from phdtrack.formats import (
    EXPORTS,
    export_tracks,
    read_detections,
    read_tracks,
    read_tracks_named,
    read_truth,
)
from phdtrack.formats.checks import MalformedRows
from phdtrack.types import SequenceInfo, Tracks

FULL = ("csv", "parquet", "jsonl", "coco")
INFO = SequenceInfo(640, 480, 25.0, 30)


@st.composite
def tracks(draw: st.DrawFn) -> Tracks:
    keys = sorted(draw(st.sets(st.tuples(st.integers(1, 30), st.integers(1, 99)), max_size=12)))
    n = len(keys)
    number = st.integers(0, 2**32 - 1)
    rng = np.random.default_rng(draw(number))
    table = np.array(keys, np.int64).reshape(n, 2)
    corner = rng.uniform(-5000, 5000, (n, 2))
    size = rng.uniform(0.1, 3000, (n, 2))
    # An object has one class.
    label = table[:, 1] % 3
    boxes = np.hstack([corner, corner + size])
    return Tracks(
        *table.T, boxes, rng.uniform(0, 1, n), rng.integers(-1, 50, n), rng.random(n) < 0.5, label
    )


@pytest.mark.parametrize("kind", sorted(EXPORTS))
@settings(max_examples=15, deadline=None)
@given(original=tracks(), named=st.booleans())
def test_exported_tracks_are_read_back(
    tmp_path_factory: pytest.TempPathFactory, kind: str, original: Tracks, named: bool
) -> None:
    path = tmp_path_factory.getbasetemp() / f"tracks{EXPORTS[kind]}"
    names = {0: "person", 1: "traffic light", 2: "Ampel"} if named else {}
    # Of a sequence that is said to end earlier, too.
    export_tracks(path, original, kind, names, INFO if named else replace(INFO, frames=3))
    again, words = read_tracks_named(path)
    for name in ("frame", "identity", *(("detection", "confirmed") if kind in FULL else ())):
        np.testing.assert_array_equal(getattr(again, name), getattr(original, name))
    np.testing.assert_allclose(again.xyxy, original.xyxy, rtol=0, atol=2e-3)
    if kind != "cvat":
        np.testing.assert_allclose(again.confidence, original.confidence, rtol=1e-6)
    if named and kind != "motchallenge":
        expected = [
            names[one].replace(" ", "_" if kind == "kitti" else " ")
            for one in original.class_id.tolist()
        ]
        assert [words.get(one, "") for one in again.class_id.tolist()] == expected
    found = read_detections(path)
    assert found.frame.tolist() == original.frame.tolist()
    # Of a KITTI file with several types one has to be named, and a table without rows says nothing.
    if not (kind == "kitti" and len({*again.class_id.tolist()}) > 1) and (
        len(original) or kind not in ("csv", "kitti")
    ):
        truth = read_truth(path)
        assert len(truth) == np.count_nonzero(again.confidence)
        assert truth.regions.size == 0


# What the format of a suffix holds of tracks, besides boxes. Numbers have seven digits.
HELD = {
    ".csv": ("frame", "identity", "confidence", "detection", "confirmed", "class_id"),
    ".parquet": ("frame", "identity", "confidence", "detection", "confirmed", "class_id"),
    ".jsonl": ("frame", "identity", "confidence", "detection", "confirmed", "class_id"),
    ".json": ("frame", "identity", "confidence", "detection", "confirmed", "class_id"),
    ".txt": ("frame", "identity", "confidence"),
    ".xml": ("frame", "identity", "class_id"),
}


@pytest.mark.parametrize("methods", [False, True])
@pytest.mark.parametrize("suffix", sorted(HELD))
@settings(max_examples=15, deadline=None)
@given(original=tracks())
def test_tracks_in_a_file_of_any_suffix_are_the_same(
    tmp_path_factory: pytest.TempPathFactory, suffix: str, methods: bool, original: Tracks
) -> None:
    """Written and read by the methods of `Tracks`, or by the functions behind them."""
    path = tmp_path_factory.getbasetemp() / f"same{suffix}"
    if methods:
        original.save(path)
        again = Tracks.load(path)
    else:
        phdtrack.export_tracks(path, original)
        again = phdtrack.read_tracks(path)
    for name in HELD[suffix]:
        np.testing.assert_allclose(
            getattr(again, name), getattr(original, name), rtol=5e-7, atol=0, err_msg=name
        )
    # The right side is the sum of two rounded numbers.
    scale = np.abs(original.xyxy).max(initial=1.0)
    np.testing.assert_allclose(again.xyxy, original.xyxy, rtol=0, atol=1.5e-6 * scale)


def test_saved_tracks_have_names_and_a_named_format(tmp_path: Path) -> None:
    rows = Tracks.of(np.array([1, 2]), 7, np.array([[1.0, 2, 3, 4]] * 2), 1.0, -1)
    rows.save(str(tmp_path / "t.csv"), names={0: "person"})
    assert read_tracks_named(tmp_path / "t.csv")[1] == {1: "person"}
    rows.save(tmp_path / "t.txt", "kitti")
    assert (tmp_path / "t.txt").read_text(encoding="utf-8").startswith("0 7 ")
    assert Tracks.load(tmp_path / "t.txt").frame.tolist() == [1, 2]
    assert Tracks.load(tmp_path / "t.csv", first_frame=0).frame.tolist() == [2, 3]


def test_tracks_of_an_unknown_suffix_are_not_saved(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected a suffix that stands for a format, got \.doc"):
        Tracks.empty().save(tmp_path / "t.doc")
    with pytest.raises(InputError, match="no such file"):
        Tracks.load(tmp_path / "none.csv")


def test_classes_without_names_keep_their_numbers(tmp_path: Path) -> None:
    boxes = np.array([[1.0, 2, 3, 4]] * 3)
    rows = Tracks.of(np.array([1, 2, 3]), np.array([1, 2, 3]), boxes, 1.0, -1)
    rows = rows.with_class(np.array([0, 3, 72]))
    for name in ("t.xml", "t.csv"):
        export_tracks(tmp_path / name, rows)
        assert read_tracks(tmp_path / name).class_id.tolist() == [0, 3, 72]
    export_tracks(tmp_path / "t.txt", rows, "kitti")
    assert read_tracks(tmp_path / "t.txt").class_id.tolist() == [0, 3, 72]
    # Words of others are numbered in alphabetical order.
    export_tracks(tmp_path / "t.xml", rows, names={0: "object", 3: "class_3", 72: "bus"})
    again, names = read_tracks_named(tmp_path / "t.xml")
    assert again.class_id.tolist() == [3, 2, 1]
    assert names == {1: "bus", 2: "class_3", 3: "object"}


@pytest.mark.parametrize("name", ["tracks.mat", "tracks"])
def test_an_unknown_suffix_is_refused_with_the_known_ones(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError) as error:
        export_tracks(tmp_path / name, Tracks.empty())
    assert set(EXPORTS.values()) == {*re.findall(r"(\.\w+) \(", str(error.value))}
    assert "kind='motchallenge'" in str(error.value)
    assert name in str(error.value)
    assert not (tmp_path / name).exists()


def test_suffixes_may_be_in_capitals(tmp_path: Path) -> None:
    export_tracks(tmp_path / "T.CSV", Tracks.empty())
    assert (tmp_path / "T.CSV").read_text().startswith("frame,identity,left")


def test_cvat_track_gaps_and_images_without_identities(
    tmp_path: Path,
) -> None:
    path = tmp_path / "t.xml"
    box = np.array([[1.0, 2, 3, 4]] * 3)
    export_tracks(path, Tracks.of(np.array([1, 2, 5]), 7, box, 1.0, -1), "cvat", info=INFO)
    text = path.read_text()
    assert [part[:1] for part in text.split('outside="')[1:]] == ["0", "0", "1", "0", "1"]
    assert read_tracks(path).frame.tolist() == [1, 2, 5]
    image = (
        '<annotations><image id="3" name="a"><box label="car" xtl="1" ytl="2" xbr="3"'
        ' ybr="4"/></image></annotations>'
    )
    path.write_text(image)
    found = read_detections(path)
    assert (found.frame.tolist(), found.names) == ([4], {1: "car"})
    refused(read_tracks, path, "", "no column for the identity")
    path.write_text('<annotations>\n<box xtl="1"/></annotations>')
    refused(read_detections, path, ", line 2", "inside of <track> or <image>")
    path.write_text(
        '<annotations><track id="1">\n<box frame="0" xtl="a" ytl="2" xbr="3"'
        ' ybr="4"/></track></annotations>'
    )
    refused(read_detections, path, ", line 2", "finite number for xtl")


def test_json_lines_of_other_programs(tmp_path: Path) -> None:
    rows = [
        {"frame_id": 1, "bbox": [1, 2, 3, 4], "label": "car"},
        {"frame_id": 2, "bbox": [1, 2, 3, 4], "label": "bus, red"},
    ]
    path = put(tmp_path, "\n".join(map(json.dumps, rows)) + "\n\n", "d.jsonl")
    found = read_detections(path)
    assert (found.frame.tolist(), found.names) == ([1, 2], {1: "bus_ red", 2: "car"})
    assert found.detections.xyxy.tolist() == [[1, 2, 4, 6]] * 2
    path.write_text(json.dumps(rows[0]) + "\n\n" + json.dumps({"frame_id": 2, "bbox": [1]}) + "\n")
    refused(read_detections, path, ", line 3", "expected four numbers for bbox")
    left = MalformedRows()
    assert len(read_detections(path, left_out=left)) == 1
    assert left.rows == 1
    path.write_text(json.dumps(rows[0]) + "\n{\n")
    refused(read_detections, path, ", line 2", "expected JSON")


@pytest.mark.parametrize("name", ["class", "class_name", "category_name", "label"])
def test_class_column_has_several_names(tmp_path: Path, name: str) -> None:
    path = put(tmp_path, f"frame,x1,y1,x2,y2,score,{name}\n1,0,0,9,9,.5,car\n", "d.csv")
    assert read_detections(path).names == {1: "car"}


def test_an_unknown_format_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="Did you mean kitti"):
        export_tracks(tmp_path / "t", Tracks.empty(), "kity")
