"""From masks to boxes, on any mask."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phdtrack.detect.components import ConnectedComponents, Heights
from phdtrack.detect.convert import as_detections
from phdtrack.types import Image

SHAPE = (144, 176)


def mask_of(*rectangles: tuple[int, int, int, int]) -> Image:
    mask = np.zeros(SHAPE, np.uint8)
    for left, top, right, bottom in rectangles:
        mask[top:bottom, left:right] = 255
    return mask


corner = st.tuples(
    st.integers(0, 175), st.integers(0, 143), st.integers(1, 176), st.integers(1, 144)
)
rectangles = st.lists(corner, max_size=8)


@given(
    rectangles,
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.0, 0.1, 0.5]),
    st.sampled_from([0.0, 0.002, 0.01]),
)
def test_any_mask_gives_valid_boxes(
    drawn: list[tuple[int, int, int, int]], seed: int, salt: float, peel: float
) -> None:
    mask = mask_of(*drawn)
    mask[np.random.default_rng(seed).random(SHAPE) < salt] = 255
    before = mask.copy()
    found = as_detections(ConnectedComponents(peel=peel).detections(mask))
    if len(found):
        assert found.xyxy.min() >= 0
        assert (found.xyxy.max(axis=0) <= [SHAPE[1], SHAPE[0]] * 2).all()
    np.testing.assert_array_equal(mask, before)


@pytest.mark.parametrize("peel", [0.0, 0.002, 0.01])
def test_rectangle_gives_its_box(peel: float) -> None:
    found = ConnectedComponents(peel=peel).detections(mask_of((40, 30, 64, 90)))
    np.testing.assert_allclose(found.xyxy, [[40, 30, 64, 90]], atol=1)


def test_specks_and_bridges_are_removed_and_gaps_closed() -> None:
    assert len(ConnectedComponents().detections(mask_of((10, 10, 12, 12), (90, 90, 93, 92)))) == 0
    bridged = mask_of((20, 20, 40, 60), (60, 20, 80, 60), (40, 39, 60, 41))
    assert len(ConnectedComponents(split=0).detections(bridged)) == 2
    gap = mask_of((20, 20, 40, 50), (20, 52, 40, 90))
    assert len(ConnectedComponents(join=0).detections(gap)) == 1


def test_three_neighbours_are_split_but_a_wide_object_is_not() -> None:
    mask = np.zeros(SHAPE, np.uint8)
    for x in (40, 62, 84):
        cv2.ellipse(mask, (x, 70), (13, 40), 0, 0, 360, 255, -1)
    assert len(ConnectedComponents().detections(mask)) == 3
    assert len(ConnectedComponents(split=0).detections(mask)) == 1
    assert len(ConnectedComponents().detections(mask_of((30, 60, 130, 100)))) == 1


def test_object_behind_another_is_not_joined() -> None:
    fragments = mask_of((60, 20, 92, 60), (60, 68, 92, 110))
    assert len(ConnectedComponents(join=0.15).detections(fragments)) == 1
    slender = mask_of((60, 10, 76, 66), (60, 74, 76, 134))
    assert len(ConnectedComponents(join=0.15).detections(slender)) == 2
    beside = mask_of((40, 20, 60, 60), (70, 20, 90, 60))
    assert len(ConnectedComponents(join=0.15).detections(beside)) == 2


def boxes_on_the_ground(rng: np.random.Generator, count: int) -> np.ndarray:
    """(N, 4) boxes of height 20 at row 100 of 400 and 80 at row 380, a sixth of them cut, in
    columns of their own.
    """
    foot = rng.uniform(100, 380, count)
    left = 30.0 + 40 * np.arange(count)
    height = 20 * 4 ** ((foot - 100) / 280) * rng.normal(1, 0.08, count)
    height[: count // 6] *= 0.4
    return np.stack([left, foot - height, left + 20, foot], axis=1)


def test_heights_are_learned_from_components(rng: np.random.Generator) -> None:
    shape = (400, 1000)
    found = [boxes_on_the_ground(rng, 20) for _ in range(5)]
    usual = Heights.learned(found, shape)
    assert usual is not None
    np.testing.assert_allclose(
        [usual.at(100), usual.at(240), usual.at(380)], [20, 40, 80], rtol=0.12
    )
    # Fragments of one body, and what the border cuts, teach nothing.
    fragments = np.array([[10, 300, 30, 318], [10, 324, 30, 342], [400, 380, 420, 400]], np.float64)
    assert Heights.learned([*found, *[fragments] * 60], shape) == usual
    assert Heights.learned([one[:3] for one in found[:3]], shape) is None
    left = 30.0 + 40 * np.arange(20)
    foot = np.full(20, 380.0)
    anything = [np.stack([left, foot - high, left + 20, foot], axis=1) for high in (9, 300)]
    assert Heights.learned(anything, shape) is None


def test_known_heights_prevent_joining_two_objects() -> None:
    contours = ConnectedComponents().components(mask_of((60, 20, 92, 60), (60, 68, 92, 110)))
    assert len(ConnectedComponents().boxes(contours, (144, 192))) == 1
    assert len(ConnectedComponents().boxes(contours, (144, 192), Heights(np.log(90.0), 0.0))) == 1
    assert len(ConnectedComponents().boxes(contours, (144, 192), Heights(np.log(45.0), 0.0))) == 2
