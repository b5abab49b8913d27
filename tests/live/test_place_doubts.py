"""Lines and zones that count nothing are named, and files of them that cannot be used refused."""

from __future__ import annotations

from pathlib import Path

import pytest
from camera_server import Scripted

from phdtrack.cli.live import check_places, named_sources
from phdtrack.config import build_classes, load
from phdtrack.errors import InputError
from phdtrack.live.engine import Camera, CameraParts, CameraSettings
from phdtrack.live.zones import Place, place_doubts, read_places, write_places
from phdtrack.types import Detections, SequenceInfo

CORNERS = ((10.0, 10.0), (90.0, 10.0), (90.0, 90.0))
QUEUE = Place("queue", CORNERS, closed=True, classes=("person",))
FAR = Place("far", ((9000.0, 9000.0), (9100.0, 9000.0)), closed=False)
UNNAMED = (
    "zone 'queue' counts nothing: it asks for person, and the detector has no class names. Leave"
    " classes out, or take a detector with classes."
)
OUTSIDE = (
    "line 'far' counts nothing: it lies outside of the picture of 160x120 pixels. Draw it anew, or"
    " correct its points."
)


def test_classes_need_a_detector_that_names_them() -> None:
    assert list(place_doubts((QUEUE,), ())) == [UNNAMED]
    assert list(place_doubts((QUEUE,), ("person", "car"))) == []
    (sentence,) = place_doubts((QUEUE,), ("persons", "car"))
    assert sentence.endswith("the detector has no such class. Did you mean persons?")
    numbered = Place("queue", CORNERS, closed=True, classes=("3",))
    assert list(place_doubts((numbered,), ())) == []


def test_a_place_outside_of_the_picture_is_named() -> None:
    assert list(place_doubts((FAR,), (), (160, 120))) == [OUTSIDE]
    assert list(place_doubts((FAR,), ())) == []
    edge = Place("edge", ((150.0, 60.0), (300.0, 60.0)), closed=False)
    assert list(place_doubts((edge,), (), (160, 120))) == []


def test_a_camera_warns_once_of_places_without_use(tmp_path: Path) -> None:
    file = tmp_path / "places.toml"
    write_places(file, (FAR, QUEUE))

    def make(info: SequenceInfo) -> CameraParts:
        return CameraParts(lambda frame: Detections.empty(), build_classes(load(), info), info)

    source = Scripted(last=0)
    one = Camera("gate", source, make, CameraSettings(tmp_path, file, video=0))
    one.start()
    assert one.warnings == [UNNAMED]
    assert one.stop(60.0)
    source = Scripted()
    source.number = 10
    pictures = Scripted()
    other = Camera("gate", source, make, CameraSettings(tmp_path, file, video=0))
    other.watched = one.watched
    for _ in range(2):
        frame = pictures.next(0.0)
        assert frame is not None
        other.process(frame)
        assert sorted(other.warnings) == [OUTSIDE, UNNAMED]


def test_a_missing_or_broken_file_of_places_is_refused(tmp_path: Path) -> None:
    missing = tmp_path / "missing.toml"
    with pytest.raises(InputError, match="there is no such file of lines and zones") as found:
        check_places([str(missing)], ["gate"], tmp_path)
    assert f"the page saves what is drawn into {tmp_path / 'gate' / 'places.toml'}" in str(
        found.value
    )
    with pytest.raises(InputError, match="no such file"):
        check_places([f"gate={missing}"], ["yard", "gate"], tmp_path)
    # The usual file is made by the page.
    check_places([], ["gate"], tmp_path)
    usual = tmp_path / "gate" / "places.toml"
    usual.parent.mkdir()
    usual.write_text("[[line]]\npoints = 3\n")
    with pytest.raises(InputError, match="number 1: expected points"):
        check_places([], ["gate"], tmp_path)


@pytest.mark.parametrize(
    ("kind", "cure"),
    [
        ("line", "Write points = [[x1, y1], [x2, y2]]."),
        ("zone", "Write points = [[x1, y1], [x2, y2], [x3, y3]]."),
    ],
)
def test_too_few_points_are_cured_as_the_file_writes_them(
    tmp_path: Path, kind: str, cure: str
) -> None:
    file = tmp_path / "places.toml"
    file.write_text(f'[[{kind}]]\nname = "door"\npoints = [[100, 400]]\n')
    with pytest.raises(InputError, match="number 1: expected at least") as found:
        read_places(file)
    assert found.value.cure == cure


@pytest.mark.parametrize("name", ["a/b", "a b", "../out"])
def test_a_name_that_is_no_folder_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="is no name of a camera"):
        named_sources([f"{name}=http://127.0.0.1:9/x"])
