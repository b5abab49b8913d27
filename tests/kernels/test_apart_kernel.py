"""Which boxes are left of those that overlap, against all pairs in turn."""

from __future__ import annotations

import numpy as np
import pytest

from phdtrack.arrays import iou
from phdtrack.kernels.box import apart


def left_of(boxes: np.ndarray, overlap: float) -> list[int]:
    """Each box in turn is left unless one left before it is in its place."""
    table = iou(boxes, boxes)
    left: list[int] = []
    for j in range(len(boxes)):
        if not (table[left, j] > overlap).any():
            left.append(j)
    return left


def crowd(rng: np.random.Generator, count: int, room: float) -> np.ndarray:
    """Boxes of many sizes, some of them twice, some without area, one as wide as the image."""
    corner, size = rng.uniform(0, room, (count, 2)), rng.uniform(5, 60, (count, 2))
    size[::7] *= [1.0, 0.0]
    boxes = np.hstack([corner, corner + size])
    boxes[1::5] = boxes[: len(boxes[1::5])]
    boxes[count // 2, [0, 2]] = [-10, room + 10]
    return boxes


@pytest.mark.parametrize("overlap", [0.0, 0.2, 0.5, 0.9])
@pytest.mark.parametrize("count", [1, 2, 17, 120])
def test_they_are_those_of_the_definition(count: int, overlap: float):
    went = 0
    for seed in range(6):
        boxes = crowd(np.random.default_rng(seed), count, 40.0 + 4 * count * (seed % 3))
        found = apart(boxes, boxes[:, 0].argsort(), overlap).tolist()
        assert found == left_of(boxes, overlap)
        went += count - len(found)
    assert went or count < 17
