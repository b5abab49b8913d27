"""Classes in files: words and numbers are preserved in every format that has them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phdtrack.errors import InputError
from phdtrack.formats import read_detections, read_tracks_named, write_detections, write_tracks
from phdtrack.formats.text import is_number
from phdtrack.types import Detections, DetectionTable, Tracks

WORDS = st.text(st.characters(categories=["L"]), min_size=1, max_size=8).filter(
    lambda word: not is_number(word)
)


@given(st.data(), st.lists(WORDS, max_size=4, unique=True), st.booleans())
def test_classes_survive_writing_and_reading(
    tmp_path_factory, data: st.DataObject, words: list[str], spread: bool
) -> None:
    names = dict(enumerate(words))
    path = tmp_path_factory.getbasetemp() / "classes.csv"
    known = st.sampled_from(sorted(names)) if names else st.integers(-1, 90)
    label = np.array(data.draw(st.lists(known, min_size=1, max_size=9)))
    called = [names.get(one, str(one)) for one in label.tolist()]
    n = len(label)
    frame = np.arange(1, n + 1)
    boxes = np.array([[10.0 * k, 5, 10 * k + 8, 25] for k in range(n)])
    found = Detections(
        boxes, np.full(n, 0.5), label, np.tile(np.eye(4), (n, 1, 1)) if spread else None
    )
    write_detections(path, DetectionTable(frame, found, names=names))
    again = read_detections(path)
    assert [again.names.get(one, str(one)) for one in again.detections.class_id.tolist()] == called
    assert (again.detections.covariance is not None) == spread
    rows = Tracks.of(frame, 4, boxes, 0.5, -1)
    write_tracks(path, replace(rows, class_id=label), names or None)
    tracks, same = read_tracks_named(path)
    assert [same.get(one, str(one)) for one in tracks.class_id.tolist()] == called
    # Without classes the file is as it was.
    write_tracks(path, rows)
    assert {line.count(",") for line in path.read_text().splitlines()} == {11}


def test_class_names_of_csv_kitti_and_coco(tmp_path: Path) -> None:
    path = tmp_path / "d.csv"
    path.write_text(
        "frame,class,x1,y1,x2,y2,score\n1,person,0,0,9,9,.5\n1,traffic"
        " light,0,0,9,9,.5\n2,car,1,1,9,9,.5\n"
    )
    table = read_detections(path)
    assert table.names == {1: "car", 2: "person", 3: "traffic light"}
    assert table.detections.class_id.tolist() == [2, 3, 1]
    row = "{} -1 {} -1 -1 -10 {} 100 {} 150 -1 -1 -1 -1000 -1000 -1000 -10 {}\n"
    lines = [
        (0, "Car", 10, 60, 0.9),
        (0, "Pedestrian", 100, 120, 0.8),
        (1, "DontCare", 0, 9, 0.1),
        (1, "Car", 12, 62, 0.7),
    ]
    path.write_text("".join(row.format(*line) for line in lines))
    table = read_detections(path)
    assert table.names == {1: "Car", 2: "Pedestrian"}
    assert (table.frame.tolist(), table.detections.class_id.tolist()) == ([1, 1, 2], [1, 2, 1])
    image = {"id": 1, "file_name": "000001.jpg"}
    box = {"image_id": 1, "bbox": [1, 2, 3, 4], "category_id": 3}
    path.write_text(
        json.dumps(
            {"images": [image], "annotations": [box], "categories": [{"id": 3, "name": "car"}]}
        )
    )
    table = read_detections(path)
    assert (table.names, table.detections.class_id.tolist()) == ({3: "car"}, [3])
    path.write_text("frame,class,x1,y1,x2,y2\n1,person,0,0,9,9\n1,3,0,0,9,9\n")
    with pytest.raises(
        InputError, match="line 3: expected a word for the class, as before, got '3'"
    ):
        read_detections(path)
