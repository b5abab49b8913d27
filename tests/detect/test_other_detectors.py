"""Faces, pedestrians, tables, functions, wrappers and the registry."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phdtrack.arrays import iou
from phdtrack.detect import DETECTORS, CallableDetector, TableDetector, detector_names, detector_parameters, make_detector
from phdtrack.detect.opencv import strongest
from phdtrack.detect.registry import Masked, Rescaled
from phdtrack.errors import InputError
from phdtrack.types import Detections, DetectionTable, Frame


def blank(height: int = 120, width: int = 160, number: int = 1) -> Frame:
    return Frame(number, 0.0, np.full((height, width, 3), 127, np.uint8))


def person_like() -> Frame:
    """A dark, upright figure on light ground: head, trunk, legs."""
    image = np.full((300, 300, 3), 200, np.uint8)
    cv2.circle(image, (150, 80), 13, (60, 60, 60), -1)
    cv2.ellipse(image, (150, 133), (22, 42), 0, 0, 360, (40, 40, 40), -1)
    for left in (134, 154):
        cv2.rectangle(image, (left, 160), (left + 13, 245), (50, 50, 50), -1)
    return Frame(1, 0.0, cv2.GaussianBlur(image, (5, 5), 0))


def test_a_figure_is_taken_for_a_person() -> None:
    found = make_detector("person", scale=1.0, threshold=0.0)(person_like())
    assert len(found) > 0
    assert iou(found.xyxy[:1], np.array([[125.0, 66, 175, 246]]))[0, 0] > 0.5
    assert (np.diff(found.confidence) <= 0).all()


def test_a_face_is_found_and_scaled_back() -> None:
    # The plainest face a cascade accepts: bright oval, dark eyes, brows and mouth.
    image = np.full((200, 200, 3), 90, np.uint8)
    cv2.ellipse(image, (100, 100), (46, 60), 0, 0, 360, (190, 190, 190), -1)
    for x in (82, 118):
        cv2.ellipse(image, (x, 85), (11, 5), 0, 0, 360, (60, 60, 60), -1)
        cv2.line(image, (x - 12, 74), (x + 12, 74), (70, 70, 70), 4)
    cv2.line(image, (100, 88), (100, 112), (215, 215, 215), 8)
    cv2.ellipse(image, (100, 132), (20, 6), 0, 0, 360, (70, 70, 70), -1)
    frame = Frame(1, 0.0, cv2.GaussianBlur(image, (9, 9), 0))
    results = [
        make_detector("face", scale=scale, neighbours=1, cascade="frontalface_default")(frame) for scale in (1.0, 2.0)
    ]
    for found in results:
        assert len(found) >= 1
        assert iou(found.xyxy, np.array([[52.0, 50, 148, 150]])).max() > 0.5


def test_an_unknown_cascade_lists_those_there_are() -> None:
    with pytest.raises(InputError, match=r"no cascade 'nose'.*frontalface_alt2"):
        make_detector("face", cascade="nose")


def test_an_opencv_without_cascades_says_how_to_mend_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(cv2, "CascadeClassifier")
    monkeypatch.delattr(cv2, "HOGDescriptor")
    for name in ("face", "person"):
        with pytest.raises(InputError, match=r"pip install .*opencv-python-headless>=4\.8,<5"):
            make_detector(name)


@given(st.lists(st.tuples(st.floats(0, 50), st.floats(0, 50), st.floats(1, 30), st.floats(-1, 2)), max_size=12))
def test_the_strongest_do_not_overlap_and_nothing_else_is_lost(rows: list[tuple[float, float, float, float]]) -> None:
    table = np.array(rows, np.float64).reshape(-1, 4)
    boxes = np.stack([table[:, 0], table[:, 1], table[:, 0] + table[:, 2], table[:, 1] + table[:, 2]], axis=1)
    kept = strongest(boxes, table[:, 3], 0.4)
    shared = iou(boxes, boxes)
    assert all(shared[i, j] <= 0.4 for i in kept for j in kept if i != j)
    for i in set(range(len(boxes))) - set(kept.tolist()):
        assert any(shared[i, j] > 0.4 and table[j, 3] >= table[i, 3] for j in kept)


def test_a_table_is_read_by_frame_number() -> None:
    table = DetectionTable(np.array([1, 3, 3]), Detections.of([[0, 0, 1, 1], [0, 0, 2, 2], [0, 0, 3, 3]]))
    detector = make_detector("file", table=table)
    assert [len(detector(blank(number=n))) for n in (1, 2, 3, 4)] == [1, 0, 2, 0]
    assert isinstance(detector, TableDetector)


def test_a_function_gets_the_picture_and_its_boxes_are_checked() -> None:
    seen = []

    def function(image):  # type: ignore[no-untyped-def]
        seen.append(image.shape)
        return [[10, 10, 20, 20, 0.5]]

    detector = make_detector("callable", function=function)
    found = detector(blank())
    assert seen == [(120, 160, 3)]
    assert found.confidence[0] == 0.5
    with pytest.raises(InputError, match=r"^frame 7: "):
        CallableDetector(lambda image: [[0, 0, 0, 5]])(blank(number=7))
    outside = [[500, 0, 510, 10], [0, 0, 5, 5]]
    with pytest.raises(InputError, match=r"^frame 1: row 0 .*outside"):
        CallableDetector(lambda image: outside)(blank())
    assert len(CallableDetector(lambda image: outside, drop_outside=True)(blank())) == 1


def test_a_smaller_picture_is_searched_and_boxes_come_back_in_full_size() -> None:
    widths = []

    def function(image):  # type: ignore[no-untyped-def]
        widths.append(image.shape[1])
        height, width = image.shape[:2]
        return [[0, 0, width / 2, height]]

    detector = Rescaled(CallableDetector(function), 100)
    np.testing.assert_allclose(detector(blank(200, 400)).xyxy, [[0, 0, 200, 200]])
    np.testing.assert_allclose(detector(blank(50, 80)).xyxy, [[0, 0, 40, 50]])
    assert widths == [100, 80]
    with pytest.raises(InputError, match="max_width"):
        make_detector("change", max_width=-3)


def test_a_region_of_interest(tmp_path: Path) -> None:
    mask = np.zeros((120, 160), np.uint8)
    mask[:, :80] = 255
    boxes = [[10, 10, 30, 30], [100, 10, 120, 30], [70, 10, 88, 30], [75, 10, 95, 30], [-20, 0, 10, 10]]
    inner = CallableDetector(lambda image: boxes)
    np.testing.assert_array_equal(Masked(inner, mask)(blank()).xyxy, np.array(boxes)[[0, 2, 4]])
    cv2.imwrite(str(tmp_path / "roi.png"), mask)
    assert len(make_detector("callable", function=lambda image: boxes, mask=tmp_path / "roi.png")(blank())) == 3
    with pytest.raises(InputError, match="black all over"):
        Masked(inner, np.zeros((120, 160), np.uint8))
    with pytest.raises(InputError, match=r"roi\.png: the mask is 160x120 pixels, frame 1 is 50x40"):
        Masked(inner, str(tmp_path / "roi.png"))(blank(40, 50))
    with pytest.raises(InputError, match=r"shape \(height, width\)"):
        Masked(inner, np.zeros((3, 3, 3), np.uint8))
    with pytest.raises(InputError, match="cannot be read"):
        Masked(inner, tmp_path / "none.png")
    (tmp_path / "text.png").write_text("no")
    with pytest.raises(InputError, match="not an image"):
        Masked(inner, tmp_path / "text.png")


def test_every_name_makes_a_detector_and_every_parameter_is_taken() -> None:
    for name, summary in detector_names():
        assert summary
        defaults = {f.name: f.default for f in detector_parameters(name)}
        assert make_detector(name, **defaults) is not None
    assert set(DETECTORS) >= {"change", "mean-background", "mog2", "knn", "face", "person", "file", "callable"}
    assert "min_area" in {f.name for f in detector_parameters("change")}
    assert "method" not in {f.name for f in detector_parameters("knn")}


@pytest.mark.parametrize(
    ("name", "parameters", "message"),
    [
        ("chagne", {}, "no detector 'chagne'. Did you mean 'change'.*mog2"),
        ("change", {"min_aera": 1}, "no parameter 'min_aera'. Did you mean 'min_area'"),
        ("mog2", {"method": "knn"}, "no parameter 'method'"),
        ("change", {"window": 4}, "window: expected an odd whole number, got 4"),
        ("change", {"false_alarm": 1.5}, "false_alarm: expected a value below 1, got 1.5"),
        ("change", {"adapt": -1.0}, "adapt: expected a value above 0, got -1"),
        ("knn", {"warmup": -1.0}, "warmup: expected a value at least 0"),
        ("face", {"step": 1.0}, "step: expected a value above 1"),
        ("person", {"stride": 6}, "multiple of 8"),
        ("knn", {"split": 1.5}, "BlobSettings.split: expected"),
        ("change", {"window": "5"}, "window: expected a number, got '5'"),
        ("file", {}, "takes table"),
        ("callable", {"fn": print}, "takes function.*got fn"),
    ],
)
def test_what_is_wrong_is_named(name: str, parameters: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        make_detector(name, **parameters)  # type: ignore[arg-type]
