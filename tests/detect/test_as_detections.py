"""Anything a detector may hand over, and what is refused."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from phdtrack.detect.convert import as_detections
from phdtrack.errors import InputError
from phdtrack.types import Detections


def boxes(xyxy: Any, confidence: Any = None, class_id: Any = None) -> SimpleNamespace:
    """Like the objects of other libraries."""
    return SimpleNamespace(xyxy=xyxy, confidence=confidence, class_id=class_id)


def test_columns() -> None:
    rows = [[0, 1, 10, 20, 0.5, 3], [5, 5, 6, 7, 0.25, 0]]
    for columns in (4, 5, 6):
        found = as_detections([row[:columns] for row in rows])
        np.testing.assert_array_equal(found.xyxy, [row[:4] for row in rows])
        np.testing.assert_array_equal(found.confidence, [0.5, 0.25] if columns > 4 else [1, 1])
        np.testing.assert_array_equal(found.class_id, [3, 0] if columns > 5 else [0, 0])
        assert found.class_id.dtype == np.int64


def test_objects() -> None:
    box = np.array([[0, 1, 10, 20]], np.float32)
    assert as_detections(boxes(box)).confidence[0] == 1
    found = as_detections(boxes(box, np.array([0.5]), np.array([2])))
    assert (found.confidence[0], found.class_id[0]) == (0.5, 2)
    found = as_detections(SimpleNamespace(xyxy=box, conf=[0.5], cls=[2.0]))
    assert (found.confidence[0], found.class_id[0]) == (0.5, 2)
    ours = Detections.of(box)
    assert as_detections(ours) is ours


@pytest.mark.parametrize("nothing", [[], (), np.zeros((0, 4)), np.zeros((0, 6)), np.zeros(0), boxes(np.zeros((0, 4)))])
def test_no_boxes(nothing: object) -> None:
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
def test_what_is_refused(bad: object, message: str) -> None:
    with pytest.raises(InputError, match=f"^frame 12: .*{message}"):
        as_detections(bad, where="frame 12")


def test_a_covariance_must_fit() -> None:
    bad = Detections(np.array([[0, 0, 1, 1.0]]), np.ones(1), np.zeros(1, np.int64), np.zeros((1, 3, 3)))
    with pytest.raises(InputError, match="covariance"):
        as_detections(bad)
