"""CVAT's shapes that are no upright boxes, and UA-DETRAC."""

from pathlib import Path

import pytest
from format_cases import put, refused

from phdtrack.errors import InputError
from phdtrack.formats import (
    Conventions,
    read_detections,
    read_tracks,
    read_truth,
    read_truth_by_class,
    xml_boxes,
)
from phdtrack.formats.annotations import read_annotated

BOX = 'xtl="0" ytl="0" xbr="80" ybr="40"'
CUBOID = " ".join(
    f'x{side}{k}="{10 * k + 5 * (side[1] == "r")}" y{side}{k}="{3 * k + (side[0] == "b")}"'
    for k in (1, 2)
    for side in ("tl", "bl", "tr", "br")
)


def cvat(folder: Path, shapes: str) -> Path:
    track = f'<track id="1" label="car">{shapes}</track>'
    return put(folder, f"<annotations>{track}</annotations>", "cvat.xml")


@pytest.mark.parametrize(
    ("shape", "box", "told"),
    [
        (f'<box frame="0" {BOX} rotation="90.00"/>', [20, -20, 60, 60], "rotated box"),
        (f'<box frame="0" {BOX} rotation="0.0"/>', [0, 0, 80, 40], ""),
        ('<polygon frame="0" points="4,1;9,2;3,8.5"/>', [3, 1, 9, 8.5], "polygon"),
        ('<ellipse frame="0" cx="9" cy="8" rx="3" ry="2" rotation="90"/>', [7, 5, 11, 11], "ellip"),
        ('<mask frame="0" left="1" top="2" width="3" height="4" rle="1"/>', [1, 2, 4, 6], "mask"),
        (f'<cuboid frame="0" {CUBOID}/>', [10, 3, 25, 7], "cuboid"),
    ],
)
def test_shapes_are_read_as_their_hulls(
    tmp_path: Path, shape: str, box: list[float], told: str
) -> None:
    notices = list[str]()
    path = cvat(tmp_path, shape)
    assert read_truth(path, notices=notices).xyxy[0].tolist() == pytest.approx(box)
    assert bool(notices) == bool(told)
    assert all(told in one and "upright boxes around them" in one for one in notices)
    assert read_annotated(path).boxes[0]["xyxy"] == pytest.approx(tuple(box))


def test_shapes_that_are_no_areas_are_told(tmp_path: Path) -> None:
    skeleton = '<skeleton frame="0"><points frame="0" points="1,2"/></skeleton>'
    lines = '<polyline frame="0" points="1,2;3,4"/>' * 2
    hidden = f'<polygon frame="1" outside="1" points="1,2"/><box frame="0" {BOX}/>'
    notices = list[str]()
    assert len(read_truth(cvat(tmp_path, skeleton + lines + hidden), notices=notices)) == 1
    assert len(notices) == 1
    assert notices[0].endswith("they are no boxes or areas: 2 × polyline, 1 × skeleton")
    path = cvat(tmp_path, '<polygon frame="0" points="1;2"/>')
    refused(read_truth, path, ", line 1", "points as x,y;x,y")


def key(frame: int, left: float, outside: int = 0, keyframe: str = 'keyframe="1"') -> str:
    place = f'xtl="{left}" ytl="0" xbr="{left + 10}" ybr="20"'
    return f'<box frame="{frame}" outside="{outside}" {keyframe} {place}/>'


@pytest.mark.parametrize(
    ("boxes", "frames", "lefts"),
    [
        (key(0, 0) + key(4, 8), [1, 2, 3, 4, 5], [0, 2, 4, 6, 8]),
        (key(0, 0) + key(2, 8, outside=1) + key(4, 8), [1, 5], [0, 8]),
        (key(0, 0, keyframe="") + key(3, 8, keyframe=""), [1, 4], [0, 8]),
        (key(0, 0) + key(1, 2, keyframe='keyframe="0"') + key(2, 4), [1, 2, 3], [0, 2, 4]),
        (key(0, 0) + key(1_000_000, 4), [1, 1_000_001], [0, 4]),
    ],
)
def test_boxes_between_keyframes_of_cvat(
    tmp_path: Path, boxes: str, frames: list[int], lefts: list[float]
) -> None:
    notices = list[str]()
    truth = read_truth(cvat(tmp_path, boxes), notices=notices)
    assert (truth.frame.tolist(), truth.xyxy[:, 0].tolist()) == (frames, lefts)
    assert bool(notices) == (len(frames) == 5)
    assert all("3 boxes between keyframes are interpolated" in one for one in notices)


def test_too_many_boxes_between_keyframes_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(xml_boxes, "MOST_BETWEEN", 20)
    boxes = "".join(key(9 * k, 0) for k in range(4))
    refused(read_truth, cvat(tmp_path, boxes), ", line 1", "at most 20 boxes between keyframes")


def test_keyframes_of_two_tracks_are_kept_apart(tmp_path: Path) -> None:
    tracks = "".join(
        f'<track id="{k}" label="car">{key(5 * k, 0)}{key(5 * k + 2, 4)}</track>' for k in (1, 2)
    )
    path = put(tmp_path, f"<annotations>{tracks}</annotations>", "cvat.xml")
    found = read_tracks(path, notices=[])
    assert found.frame.tolist() == [6, 7, 8, 11, 12, 13]
    assert found.identity.tolist() == [1, 1, 1, 2, 2, 2]


DETRAC = """<?xml version="1.0" encoding="utf-8"?>
<sequence name="MVI_1"><sequence_attribute camera_state="stable"/>
<ignored_region><box left="0.5" top="1.75" width="8" height="3"/></ignored_region>
<frame density="2" num="1"><target_list>
<target id="1"><box left="10" top="20" width="30" height="40"/>\
<attribute vehicle_type="car"/></target>
<target id="2"><box left="60" top="20" width="30" height="40"/>\
<attribute vehicle_type="van"/></target>
</target_list></frame>
<frame density="1" num="3"><target_list>
<target id="1"><box left="12" top="20" width="30" height="40"/></target></target_list></frame>
</sequence>
"""


def test_ua_detrac(tmp_path: Path) -> None:
    path = put(tmp_path, DETRAC, "MVI_1.xml")
    truth = read_truth(path)
    assert (truth.frame.tolist(), truth.identity.tolist()) == ([1, 1, 3], [1, 2, 1])
    assert truth.xyxy[0].tolist() == [10, 20, 40, 60]
    assert truth.regions.tolist() == [[0, 0.5, 1.75, 8.5, 4.75]]
    assert len(read_tracks(path)) == 3
    found = read_detections(path)
    assert [found.names[one] for one in found.detections.class_id.tolist()] == [
        "car",
        "van",
        "vehicle",
    ]
    assert read_truth(path, conventions=Conventions(format="detrac")).regions.size
    by_class = read_truth_by_class(path)
    assert list(by_class) == ["car", "van", "vehicle"]
    assert all(len(one.regions) == 1 for one in by_class.values())
    with pytest.raises(InputError, match="expected the format cvat, got detrac"):
        read_truth(path, conventions=Conventions(format="cvat"))
    refused(
        read_truth,
        put(tmp_path, DETRAC.replace('left="12" ', ""), "MVI_1.xml"),
        ", line 9",
        "<box> with a value for left",
    )
