"""Faces, pedestrians, wrappers and the registry."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import pytest

from phdtrack import opencv_package
from phdtrack.arrays import iou
from phdtrack.detect import DETECTORS, detector_parameters, make_detector
from phdtrack.detect.detectors import working_width
from phdtrack.detect.wrappers import Masked, Rescaled
from phdtrack.errors import InputError
from phdtrack.types import Detections, Frame, SequenceInfo


@dataclass
class Seen:
    """A detector that gives the same boxes for every picture, and keeps the widths of these."""

    boxes: list[list[float]]
    widths: list[int] = field(default_factory=list)

    def reset(self) -> None:
        self.widths.clear()

    def __call__(self, frame: Frame) -> Detections:
        self.widths.append(frame.image.shape[1])
        return Detections.of(self.boxes)


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


def test_figure_is_detected_as_person() -> None:
    found = make_detector("person", scale=1.0, threshold=0.0)(person_like())
    assert len(found) > 0
    assert iou(found.xyxy[:1], np.array([[125.0, 66, 175, 246]]))[0, 0] > 0.5
    assert (np.diff(found.confidence) <= 0).all()


def test_face_is_detected_in_original_pixels() -> None:
    # The plainest face a cascade accepts: bright oval, dark eyes, brows and mouth.
    image = np.full((200, 200, 3), 90, np.uint8)
    cv2.ellipse(image, (100, 100), (46, 60), 0, 0, 360, (190, 190, 190), -1)
    for x in (82, 118):
        cv2.ellipse(image, (x, 85), (11, 5), 0, 0, 360, (60, 60, 60), -1)
        cv2.line(image, (x - 12, 74), (x + 12, 74), (70, 70, 70), 4)
    cv2.line(image, (100, 88), (100, 112), (215, 215, 215), 8)
    cv2.ellipse(image, (100, 132), (20, 6), 0, 0, 360, (70, 70, 70), -1)
    frame = Frame(1, 0.0, cv2.GaussianBlur(image, (9, 9), 0))
    results = [make_detector("face", scale=scale, neighbours=1)(frame) for scale in (1.0, 2.0)]
    for found in results:
        assert len(found) >= 1
        assert iou(found.xyxy, np.array([[52.0, 50, 148, 150]])).max() > 0.5


def test_opencv_without_cascades_shows_the_repair(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(cv2, "CascadeClassifier", raising=False)
    monkeypatch.delattr(cv2, "HOGDescriptor", raising=False)
    vars(opencv_package.cv2).clear()
    for name in ("face", "person"):
        with pytest.raises(InputError, match=r"pip install .*opencv-python-headless>=4\.8,<5"):
            make_detector(name)


def test_shrunk_frame_gives_boxes_in_original_pixels() -> None:
    inner = Seen([[0, 0, 30, 10]])
    detector = Rescaled(inner, 100)
    np.testing.assert_allclose(detector(blank(200, 400)).xyxy, [[0, 0, 120, 40]])
    np.testing.assert_allclose(detector(blank(50, 80)).xyxy, [[0, 0, 30, 10]])
    assert inner.widths == [100, 80]
    with pytest.raises(InputError, match="max_width"):
        make_detector("change", max_width=-3)


def test_mask_keeps_boxes_inside_the_region(tmp_path: Path) -> None:
    mask = np.zeros((120, 160), np.uint8)
    mask[:, :80] = 255
    boxes = [
        [10, 10, 30, 30],
        [100, 10, 120, 30],
        [70, 10, 88, 30],
        [75, 10, 95, 30],
        [-20, 0, 10, 10],
    ]
    inner = Seen(boxes)
    np.testing.assert_array_equal(Masked(inner, mask)(blank()).xyxy, np.array(boxes)[[0, 2, 4]])
    cv2.imwrite(str(tmp_path / "roi.png"), mask)
    assert len(Masked(inner, tmp_path / "roi.png")(blank())) == 3
    with pytest.raises(InputError, match="whole mask is black"):
        Masked(inner, np.zeros((120, 160), np.uint8))
    with pytest.raises(InputError, match=r"roi\.png: the mask is 160x120 pixels, frame 1 is 50x40"):
        Masked(inner, str(tmp_path / "roi.png"))(blank(40, 50))
    with pytest.raises(InputError, match=r"shape \(height, width\)"):
        Masked(inner, np.zeros((3, 3, 3), np.uint8))
    with pytest.raises(InputError, match="there is no such file"):
        Masked(inner, tmp_path / "none.png")
    (tmp_path / "text.png").write_text("no")
    with pytest.raises(InputError, match="not a readable image"):
        Masked(inner, tmp_path / "text.png")


@pytest.mark.parametrize("name", DETECTORS)
def test_every_detector_accepts_its_parameters(name: str) -> None:
    defaults = detector_parameters(name)
    assert make_detector(name, **defaults) is not None
    assert ("min_area" in defaults) == (name not in ("face", "person"))


@pytest.mark.parametrize(
    ("name", "parameters", "message"),
    [
        ("chagne", {}, "no detector 'chagne'. Did you mean change"),
        ("change", {"min_aera": 1}, "no parameter 'min_aera'. Did you mean min_area"),
        ("change", {"window": 4}, "window: expected an odd whole number, got 4"),
        ("change", {"false_alarm": 1.5}, "false_alarm: expected a value below 1, got 1.5"),
        ("change", {"adapt": -1.0}, "adapt: expected a value above 0, got -1"),
        ("mog2", {"warmup": -1.0}, "warmup: expected a value at least 0"),
        ("face", {"step": 1.2}, "no parameter 'step'"),
        ("mog2", {"split": 1.5}, "ConnectedComponents.split: expected"),
        ("change", {"window": "5"}, "window: expected a whole number, got '5'"),
        ("mean-background", {"signed": 1}, "signed: expected true or false, got 1"),
        ("person", {"scale": True}, "scale: expected a number, got True"),
    ],
)
def test_wrong_parameters_are_named(name: str, parameters: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        make_detector(name, **parameters)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("size", "width"),
    [
        ((3840, 2160), 640),
        ((1920, 1080), 640),
        ((1080, 1920), 360),
        ((960, 540), 0),
        ((768, 576), 0),
    ],
)
def test_working_width_follows_from_the_video(size: tuple[int, int], width: int) -> None:
    info = SequenceInfo(*size, 25.0)
    assert [working_width(name, None, info) for name in ("change", "mog2", "person")] == [
        width,
        width,
        0,
    ]
    assert [working_width("change", given, info) for given in (0, 320)] == [0, 320]
