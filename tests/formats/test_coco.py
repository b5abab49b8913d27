"""COCO JSON in both forms."""

import json
from pathlib import Path
from typing import Any

import pytest
from format_cases import put, refused

from phdtrack.errors import InputError
from phdtrack.formats import read_detections, read_tracks, read_truth


def written(folder: Path, document: object) -> Path:
    return put(
        folder, document if isinstance(document, str) else json.dumps(document), "boxes.json"
    )


def result(image: object = 1, **more: object) -> dict[str, Any]:
    return {"image_id": image, "bbox": [1, 2, 3, 4], **more}


def test_list_of_results_is_read(tmp_path: Path) -> None:
    path = written(tmp_path, [result(4, score=-0.5, category_id=3), result("000002")])
    table = read_detections(path)
    assert table.frame.tolist() == [2, 4]
    assert table.detections.xyxy.tolist() == [[1, 2, 4, 6]] * 2
    assert table.detections.confidence.tolist() == [1, -0.5]
    assert table.detections.class_id.tolist() == [0, 3]
    assert read_detections(path, first_frame=0).frame.tolist() == [3, 5]


@pytest.mark.parametrize(
    ("names", "frames"),
    [
        (
            [{"file_name": "a/9.jpg", "frame_id": 5}, {"file_name": "a/8.jpg", "frame_id": 6}],
            [5, 6],
        ),
        ([{"file_name": "img1/000011.jpg"}, {"file_name": "img1/000012.jpg"}], [11, 12]),
        ([{"file_name": "a1\\x3.png"}, {"file_name": "a1\\x4.png"}], [3, 4]),
        ([{"file_name": "one.jpg"}, {"file_name": "2.jpg"}], [70, 80]),
        ([{"file_name": "a/1.jpg"}, {"file_name": "b/1.jpg"}], [70, 80]),
        ([{}, {}], [70, 80]),
    ],
)
def test_data_set_numbers_its_frames(
    tmp_path: Path, names: list[dict[str, Any]], frames: list[int]
) -> None:
    images = [{"id": number, **name} for number, name in zip((70, 80), names, strict=True)]
    annotations = [
        result(80, track_id=2),
        result(70, track_id=2),
        result(80, attributes={"track_id": 3}, iscrowd=1),
    ]
    path = written(tmp_path, {"images": images, "annotations": annotations, "categories": []})
    truth = read_truth(path)
    assert truth.frame.tolist() == [frames[0], frames[1], frames[1]]
    assert truth.identity.tolist() == [2, 2, 3]
    assert truth.distractor.tolist() == [False, False, True]
    assert read_tracks(path).identity.tolist() == [2, 2]
    assert len(read_detections(path)) == 3


@pytest.mark.parametrize("document", [[], {"images": [], "annotations": []}])
def test_empty_coco_file_has_no_rows(tmp_path: Path, document: object) -> None:
    path = written(tmp_path, document)
    assert len(read_detections(path)) == len(read_truth(path)) == len(read_tracks(path)) == 0


@pytest.mark.parametrize(
    ("document", "where", "words"),
    [
        ('[\n{"image_id": 1,\n', ", line 3", "JSON, which breaks here"),
        ({"images": []}, "", "list of annotations, got keys images"),
        ({"annotations": 3}, "", "list of annotations, got annotations = 3"),
        ([result(), 7], ", entry 2", "object with image_id and bbox, got 7"),
        ([result(), {"bbox": [1, 2, 3, 4]}], ", entry 2", "value for image_id, got keys bbox"),
        ([result(), result(bbox=[1, 2, 3])], ", entry 2", "four numbers for bbox"),
        ([result(), result(bbox=[1, 2, 3, "x"])], ", entry 2", "a number for bbox, got 'x'"),
        ([result(), result(bbox=[1, 2, -1, 4])], ", entry 2", "above 0, got width -1, height 4"),
        ([result(), result(score=None)], ", entry 2", "a number for score, got None"),
        ([result(), result(10**400)], ", line 1", "hundreds of digits"),
        ([result(), result("a")], ", entry 2", "a number for image_id"),
        ('[{"image_id": 1, "bbox": [NaN, 1, 1, 1]}]', ", entry 1", "finite numbers for the box"),
        (
            {"images": [{"id": 1}], "annotations": [result(2)]},
            ", annotation 1",
            "one of the images, got image_id 2",
        ),
        ({"images": [3], "annotations": []}, ", image 1", "object with id and file_name"),
        (
            {"images": [{"id": 1, "video_id": 1}, {"id": 2, "video_id": 2}], "annotations": []},
            "",
            "one video, got 2",
        ),
        ("[" * 100_000, "", "nested without end"),
    ],
)
def test_the_message_names_the_place(
    tmp_path: Path, document: object, where: str, words: str
) -> None:
    refused(read_detections, written(tmp_path, document), where, words)


def test_truth_needs_unique_identities(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match="entry 1: expected a value for track_id or instance_id or identity"
    ):
        read_truth(written(tmp_path, [result()]))
    with pytest.raises(
        InputError, match=r"entry 2: identity 3 is in frame 1 .*already, in entry 1"
    ):
        read_truth(written(tmp_path, [result(track_id=3), result(track_id=3)]))
