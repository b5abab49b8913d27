"""COCO files of several videos, frame numbers from names, rotated boxes, and Scalabel."""

import json
from pathlib import Path
from typing import Any

import pytest
from format_cases import put

from phdtrack.errors import InputError
from phdtrack.formats import Conventions, read_detections, read_tracks, read_truth

HASHES = [f"{k:02d}4ca4238a0b923820dcc509a6f7584{k % 10}" for k in range(4)]
UUIDS = [f"{k}2ab34cd-0000-4000-8000-00000000000{k}" for k in range(4)]


def data_set(folder: Path, images: list[dict[str, Any]], **more: Any) -> Path:
    """A file with a box at 10 × its place on each image, of identity 7."""
    numbered = [{"id": place, **image} for place, image in enumerate(images, start=1)]
    boxes = [
        {"image_id": image["id"], "bbox": [10 * place, 0, 5, 5], "track_id": 7}
        for place, image in enumerate(numbered, start=1)
    ]
    document = {"images": numbered, "annotations": boxes, **more}
    return put(folder, json.dumps(document), "boxes.json")


def named(*names: str) -> list[dict[str, Any]]:
    return [{"file_name": name} for name in names]


FOLDERS = named("a/000001.jpg", "a/000002.jpg", "b/000001.jpg", "b/000002.jpg")
NESTED = named("x/a/img1/1.jpg", "x/a/img1/2.jpg", "x/b/img1/3.jpg", "x/b/img1/4.jpg")
REPEATED = named("f1.png", "f2.png", "f1.png", "f2.png")
BY_ID = [{"video_id": 3}, {"video_id": 3}, {"video_id": 5}, {"video_id": 5}]
VIDEOS = [{"id": 3, "name": "a"}, {"id": 5, "name": "b"}]


@pytest.mark.parametrize(
    ("images", "more", "second"),
    [
        (FOLDERS, {}, "b"),
        (NESTED, {}, "b"),
        (REPEATED, {}, "2"),
        (BY_ID, {}, "5"),
        (BY_ID, {"videos": VIDEOS}, "b"),
    ],
)
def test_one_of_several_videos_is_read(
    tmp_path: Path, images: list[dict[str, Any]], more: dict[str, Any], second: str
) -> None:
    path = data_set(tmp_path, images, **more)
    with pytest.raises(InputError, match=rf"one video, got 2: .*{second}.*--sequence"):
        read_tracks(path)
    notices = list[str]()
    tracks = read_tracks(path, conventions=Conventions(sequence=second), notices=notices)
    assert tracks.xyxy[:, 0].tolist() == [30, 40]
    assert f"read the video {second} of 2" in notices[0]
    with pytest.raises(InputError, match="no video 'c' among the 2"):
        read_tracks(path, conventions=Conventions(sequence="c"))
    together = Conventions(sequence="all")
    assert len(read_tracks(path, conventions=together, notices=notices)) == 4


def test_images_of_one_video_need_no_name(tmp_path: Path) -> None:
    path = data_set(tmp_path, named("a/1.jpg", "b/2.jpg", "c/3.jpg", "c/4.jpg"))
    assert read_tracks(path, conventions=Conventions(sequence="c")).frame.tolist() == [1, 2, 3, 4]


@pytest.mark.parametrize(
    ("names", "frames"),
    [
        ([f"clip_mp4-000{9 - k}_jpg.rf.{HASHES[k]}.jpg" for k in range(4)], [9, 8, 7, 6]),
        ([f"frame{k + 3}_png.rf.{HASHES[k]}.png" for k in range(4)], [3, 4, 5, 6]),
        ([f"{9 - k}_{HASHES[k]}.png" for k in range(4)], [9, 8, 7, 6]),
        ([f"{UUIDS[k]}.jpg" for k in range(4)], [1, 2, 3, 4]),
        ([f"{HASHES[k]}.jpg" for k in range(4)], [1, 2, 3, 4]),
        ([f"shot {k}_left.jpg" for k in (4, 3, 2, 1)], [4, 3, 2, 1]),
        ([f"20241128111015{k}.jpg" for k in (40, 50, 30, 60)], [2, 3, 1, 4]),
        ([f"000009_VID001_{k}.png" for k in range(4)], [1, 2, 3, 4]),
    ],
)
def test_names_number_frames(tmp_path: Path, names: list[str], frames: list[int]) -> None:
    path = data_set(tmp_path, named(*names))
    tracks = read_tracks(path, notices=[])
    places = dict(zip(tracks.xyxy[:, 0].tolist(), tracks.frame.tolist(), strict=True))
    assert [places[10.0 * k] for k in range(1, 5)] == frames


@pytest.mark.parametrize(
    "image",
    [
        lambda k: {"file_name": f"frame_{k:06d}.PNG"},
        lambda k: {"frame_id": k, "video_id": 1},
        lambda k: {"frame_index": k, "file_name": "9.jpg"},
    ],
)
def test_frames_count_from_0_if_an_image_does(tmp_path: Path, image: Any) -> None:
    """Also if no object is on it."""
    path = data_set(tmp_path, [image(k) for k in range(4)])
    document = json.loads(path.read_text())
    document["annotations"] = document["annotations"][2:]
    path.write_text(json.dumps(document))
    notices = list[str]()
    for reader in (read_truth, read_tracks, read_detections):
        assert reader(path, notices=notices).frame.tolist() == [3, 4]
    assert "frames count from 0" in notices[0]
    stated = Conventions(first_frame=1)
    assert read_truth(path, conventions=stated, notices=[]).frame.tolist() == [2, 3]
    # From 4 on, they count from 1.
    path = data_set(tmp_path, [image(k) for k in range(4, 8)])
    assert read_truth(path).frame.tolist() == [4, 5, 6, 7]


def test_results_that_count_from_0(tmp_path: Path) -> None:
    rows = [{"image_id": k, "bbox": [1, 2, 3, 4]} for k in (0, 1)]
    assert read_detections(put(tmp_path, json.dumps(rows))).frame.tolist() == [1, 2]


def with_annotation(folder: Path, **more: Any) -> Path:
    return put(folder, json.dumps([{"image_id": 1, "track_id": 1, **more}]), "boxes.json")


@pytest.mark.parametrize(
    ("degrees", "box"),
    [
        (90, [20, -20, 60, 60]),
        (-90.0, [20, -20, 60, 60]),
        ("90.0", [20, -20, 60, 60]),
        (1e400, [0, 0, 80, 40]),
        (180, [0, 0, 80, 40]),
        (45, [-2.426407, -22.426407, 82.426407, 62.426407]),
        (0, [0, 0, 80, 40]),
        ("?", [0, 0, 80, 40]),
    ],
)
def test_hull_of_a_rotated_box(tmp_path: Path, degrees: object, box: list[float]) -> None:
    path = with_annotation(tmp_path, bbox=[0, 0, 80, 40], attributes={"rotation": degrees})
    notices = list[str]()
    assert read_truth(path, notices=notices).xyxy[0].tolist() == pytest.approx(box, abs=1e-6)
    assert any("1 × rotated box" in one for one in notices) == (degrees not in (0, "?", 1e400))


def test_polygon_without_a_box(tmp_path: Path) -> None:
    path = with_annotation(tmp_path, segmentation=[[1, 2, 9, 2, 5, 8], [20, 3, 21, 3, 21, 4]])
    notices = list[str]()
    assert read_truth(path, notices=notices).xyxy.tolist() == [[1, 2, 21, 8]]
    assert "1 × polygon" in notices[0]
    with pytest.raises(InputError, match="four numbers for bbox"):
        read_truth(with_annotation(tmp_path, segmentation=[["a", 2]]))


def scalabel(name: str, index: int, *labels: dict[str, Any]) -> dict[str, Any]:
    return {"name": f"{name}-{index}.jpg", "videoName": name, "frameIndex": index, "labels": labels}


def car(identity: str, left: float, **more: Any) -> dict[str, Any]:
    box = {"x1": left, "y1": 0, "x2": left + 4, "y2": 3}
    return {"id": identity, "category": "car", "box2d": box, **more}


@pytest.mark.parametrize("nested", [False, True])
def test_scalabel(tmp_path: Path, nested: bool) -> None:
    frames = [
        scalabel("v", 0, car("00000001", 1)),
        scalabel("v", 1, car("00000001", 2, category="bus"), {"id": "2", "poly2d": []}),
        scalabel("v", 2, car("00000020", 3, attributes={"crowd": True})),
    ]
    path = put(tmp_path, json.dumps({"frames": frames} if nested else frames), "v.json")
    truth = read_truth(path, notices=[])
    assert (truth.frame.tolist(), truth.identity.tolist()) == ([1, 2, 3], [1, 1, 20])
    assert (truth.xyxy[0].tolist(), truth.distractor.tolist()) == ([1, 0, 5, 3], [0, 0, 1])
    assert read_detections(path, notices=[]).names == {1: "bus", 2: "car"}
    frames = [*frames, scalabel("w", 0, car("x", 1)), scalabel("w", 1, car("y", 1))]
    path = put(tmp_path, json.dumps(frames), "v.json")
    found = read_tracks(path, conventions=Conventions(sequence="w"), notices=[])
    assert (found.frame.tolist(), len(set(found.identity.tolist()))) == ([1, 2], 2)
    for bad, words in (
        ([*frames, 3], "object with name and labels, got 3"),
        ([*frames, scalabel("w", 2, {"box2d": {"x1": 1}})], "numbers for x1, y1, x2, y2"),
        ([*frames, {"name": "a", "labels": 3}], "list of labels"),
    ):
        with pytest.raises(InputError, match=words):
            read_tracks(put(tmp_path, json.dumps(bad), "v.json"))
