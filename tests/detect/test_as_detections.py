"""Anything a detector may hand over, and what is refused."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from phdtrack import Tracker
from phdtrack.detect.convert import as_detections, sizes_warning, unit_warning
from phdtrack.errors import InputError
from phdtrack.types import Detections


def boxes(xyxy: Any, confidence: Any = None, class_id: Any = None) -> SimpleNamespace:
    """Like the objects of other libraries."""
    return SimpleNamespace(xyxy=xyxy, confidence=confidence, class_id=class_id)


def test_arrays_with_4_to_6_columns() -> None:
    rows = [[0, 1, 10, 20, 0.5, 3], [5, 5, 6, 7, 0.25, 0]]
    for columns in (4, 5, 6):
        found = as_detections([row[:columns] for row in rows])
        np.testing.assert_array_equal(found.xyxy, [row[:4] for row in rows])
        np.testing.assert_array_equal(found.confidence, [0.5, 0.25] if columns > 4 else [1, 1])
        np.testing.assert_array_equal(found.class_id, [3, 0] if columns > 5 else [0, 0])
        assert found.class_id.dtype == np.int64


def test_objects_with_attributes() -> None:
    box = np.array([[0, 1, 10, 20]], np.float32)
    assert as_detections(boxes(box)).confidence[0] == 1
    found = as_detections(boxes(box, np.array([0.5]), np.array([2])))
    assert (found.confidence[0], found.class_id[0]) == (0.5, 2)
    found = as_detections(SimpleNamespace(xyxy=box, conf=[0.5], cls=[2.0]))
    assert (found.confidence[0], found.class_id[0]) == (0.5, 2)
    ours = Detections.of(box)
    assert as_detections(ours) is ours


class Tensor:
    """Like torch's on a GPU with gradients: NumPy cannot read it before it is detached, copied, and
    of a usual type.
    """

    def __init__(self, values: Any, there: bool = False) -> None:
        self._values = values
        self._there = there

    def detach(self) -> Tensor:
        return self

    def cpu(self) -> Tensor:
        return Tensor(self._values, True)

    def double(self) -> Any:
        assert self._there
        return np.array(self._values, np.float64)

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise TypeError("can't convert cuda:0 device type tensor to numpy")


@pytest.mark.parametrize(
    "wrapped", [lambda whole: whole, lambda whole: [whole], lambda whole: (whole,)]
)
def test_ultralytics_result(wrapped: Any) -> None:
    inner = SimpleNamespace(xyxy=Tensor([[0, 1, 10, 20]]), conf=Tensor([0.5]), cls=Tensor([2.0]))
    found = as_detections(wrapped(SimpleNamespace(boxes=inner, obb=None, names={2: "car"})))
    assert found.xyxy.tolist() == [[0, 1, 10, 20]]
    assert (found.confidence[0], found.class_id[0]) == (0.5, 2)
    empty = SimpleNamespace(xyxy=Tensor(np.zeros((0, 4))), conf=Tensor([]), cls=Tensor([]))
    assert len(as_detections(wrapped(SimpleNamespace(boxes=empty, obb=None)))) == 0
    with pytest.raises(InputError, match="oriented"):
        as_detections(wrapped(SimpleNamespace(boxes=None, obb=inner)))


@pytest.mark.parametrize(
    ("box", "words"),
    [
        ([-9, 5, 0, 9], "1 of 2 boxes lie outside the frame of 640x480 pixels"),
        ([10, 480, 20, 500], "1 of 2 boxes lie outside"),
        ([-9, -9, 1, 1], ""),
        (
            [10, 500, 20, 600],
            "1 of 2 boxes lie outside the frame of 640x480 pixels: perhaps it is 480 wide and 640",
        ),
    ],
)
def test_boxes_outside_the_frame_are_reported(box: list[float], words: str) -> None:
    assert unit_warning(as_detections([[100, 100, 120, 140], box]), (640, 480)).startswith(words)
    assert unit_warning(as_detections([[100, 100, 120, 140], box]), (0, 0)) == ""


def test_boxes_in_shares_of_the_frame_are_reported() -> None:
    assert "not in shares of its size" in unit_warning(
        as_detections([[0.1, 0.2, 0.3, 0.9]]), (640, 480)
    )
    assert unit_warning(as_detections([]), (640, 480)) == ""
    # Neither a box that has left at the top, nor one that is outside either way.
    for box in ([-9, 5, 0, 9], [700, 5, 710, 9]):
        assert unit_warning(as_detections([box]), (640, 480)).endswith("640x480 pixels")


def test_sizes_in_place_of_corners_are_reported() -> None:
    said: list[str] = []
    tracker = Tracker(frame_size=(640, 480), fps=25)
    tracker.on_warning = said.append
    for k in range(3):
        tracker.update([[300 + k, 200, 40, 80], [10, 15, 30, 60], [9, 80, 40, 60]])
    assert len([each for each in said if "left, top, width, height" in each]) == 1
    assert "2 of 3 boxes end before they begin" in said[-1]
    assert "centre, width, height" in said[-1]
    # A detector may give a box without area, or a wrong one among others.
    assert sizes_warning(as_detections([[50, 50, 50, 60]])) == ""
    assert sizes_warning(as_detections([[50, 50, 40, 60], [50, 50, 60, 60]])) == ""


def test_results_that_are_no_boxes_are_refused_with_a_cure() -> None:
    results = [boxes(np.zeros((1, 4))), boxes(np.zeros((2, 4)))]
    with pytest.raises(InputError, match=r"one frame, got those of 2. Call update for each"):
        as_detections(results)
    for unusual in (
        {"boxes": [[1, 2, 3, 4]]},
        [{"bbox": [1, 2, 3, 4]}],
        (np.zeros((2, 4)), [1, 1]),
    ):
        with pytest.raises(InputError, match="column_stack"):
            as_detections(unusual)


@pytest.mark.parametrize(
    "nothing", [[], (), np.zeros((0, 4)), np.zeros((0, 6)), np.zeros(0), boxes(np.zeros((0, 4)))]
)
def test_empty_input_gives_no_boxes(nothing: object) -> None:
    assert len(as_detections(nothing)) == 0


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (None, "got None.*empty"),
        ([1, 2, 3, 4], "one row"),
        (np.zeros((2, 3)), r"\(2, 3\)"),
        (np.zeros((2, 7)), r"\(2, 7\)"),
        ("boxes", "does not convert"),
        ([[1, 2, 3], [1]], "does not convert"),
        ([[0, 0, 9, 9], [0, np.nan, 9, 9]], "row 1 .* not finite"),
        ([[0, 0, 9, np.inf]], "row 0 .* not finite"),
        ([[0, 0, 9, 9, np.nan]], "row 0 .* not finite"),
        ([[0, 0, 9, 9, 1, 0.5]], "whole number"),
        (boxes(np.zeros((2, 5))), "xyxy of shape"),
        (boxes([[0, 0, 9, 9]], [1, 1]), r"\.confidence with one value for each of 1"),
    ],
)
def test_invalid_input_is_rejected(bad: object, message: str) -> None:
    with pytest.raises(InputError, match=f"^frame 12: .*{message}"):
        as_detections(bad, where="frame 12")


def test_covariance_of_wrong_shape_is_rejected() -> None:
    bad = Detections(
        np.array([[0, 0, 1, 1.0]]), np.ones(1), np.zeros(1, np.int64), np.zeros((1, 3, 3))
    )
    with pytest.raises(InputError, match="covariance"):
        as_detections(bad)
