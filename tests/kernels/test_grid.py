"""The spatial grid finds what looking everywhere finds, each pair once; boxes that overlap others,
against all pairs.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from inner_kernels import from_python
from phdtrack.arrays import iou, share_inside
from phdtrack.kernels.box import agreement, apart, following, plausible_boxes
from phdtrack.kernels.grid import (
    cell_of,
    make_grid,
    overlapping_pairs,
    points_in_rectangles,
    sorted_along,
    within,
)
from phdtrack.models.plane import Hiders

cell_of, sorted_along, within = from_python(cell_of, sorted_along, within)

# Whole numbers too, so that edges meet.
number = st.one_of(st.integers(-40, 40).map(float), st.floats(-1e3, 1e3), st.floats(-1e7, 1e7))
extent = st.one_of(st.integers(0, 30).map(float), st.floats(0, 200), st.floats(0, 1e6))
rectangles = st.lists(st.tuples(number, number, extent, extent), max_size=20)


def corners(boxes) -> tuple[np.ndarray, np.ndarray]:
    x = np.array(boxes, np.float64).reshape(-1, 4).T
    return np.ascontiguousarray(x[:2]), x[:2] + x[2:]


def overlaps(low, high, lower, upper) -> set[tuple[int, int]]:
    """By the definition: closed rectangles that share a point."""
    meet = (low[:, :, None] <= upper[:, None, :]) & (high[:, :, None] >= lower[:, None, :])
    return set(zip(*(index.tolist() for index in np.nonzero(meet.all(axis=0))), strict=True))


@given(rectangles, rectangles, st.sampled_from([0.0, 7.0]))
@settings(max_examples=100, deadline=None)
def test_overlapping_rectangles_are_found(boxes, others, least: float):
    low, high = corners(boxes)
    lower, upper = corners(others)
    first, second = overlapping_pairs(low, high, make_grid(lower, upper, least, least))
    assert np.all(np.diff(first) >= 0)
    found = list(zip(first.tolist(), second.tolist(), strict=True))
    assert len(found) == len(set(found))
    assert set(found) == overlaps(low, high, lower, upper)


@given(rectangles, rectangles)
@settings(max_examples=100, deadline=None)
def test_points_in_rectangles(points, around):
    at = corners(points)[0]
    lower, upper = corners(around)
    for array in (at, lower, upper):
        array.flags.writeable = False
    point, rectangle = points_in_rectangles(at, lower, upper)
    assert np.all(np.diff(rectangle) >= 0), "pairs come ordered by rectangle"
    found = list(zip(rectangle.tolist(), point.tolist(), strict=True))
    assert len(found) == len(set(found))
    assert set(found) == overlaps(lower, upper, at, at)


def test_more_pairs_than_points_fit():
    at = np.random.default_rng(2).uniform(0, 1, (2, 30))
    point, _ = points_in_rectangles(at, np.full((2, 40), -1.0), np.full((2, 40), 2.0))
    assert len(point) == 1200


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
@pytest.mark.parametrize("place", range(3))
def test_values_that_are_not_finite_are_refused(wrong: float, place: int):
    """Cells made of NaN would lie outside the grid, and memory beside it would be written."""
    arrays = [np.zeros((2, 2)), np.zeros((2, 1)), np.ones((2, 1))]
    arrays[place].flat[-1] = wrong
    with pytest.raises(ValueError, match="finite"):
        points_in_rectangles(*arrays)


@pytest.mark.parametrize("spread", [1.0, 1e3, 1e6])
def test_the_grid_is_linear_in_the_rectangles(spread: float):
    lower = np.random.default_rng(2).uniform(0, spread, (2, 100))
    grid = make_grid(lower, lower + 1)
    assert grid.start.size - 1 == grid.columns * grid.rows <= 4 * 100 + 16
    assert grid.item.size <= 16 * 100


def test_cells_are_clamped():
    cells = {-5.0: 0, 0.0: 0, 0.99: 0, 1.0: 1, 3.5: 3, 99.0: 3, np.inf: 3, -np.inf: 0, np.nan: 0}
    for value, cell in cells.items():
        assert cell_of(value, 0.0, 1.0, 4) == cell


def test_covered_shares_are_those_of_nearer_boxes():
    """By the shared area over the box's own, of hiders that are nearer; a depth of NaN hides
    nothing.
    """
    rng = np.random.default_rng(3)
    xyxy, others = (
        np.hstack([c, c + rng.integers(1, 30, (len(c), 2))])
        for c in (rng.integers(0, 60, (n, 2)) for n in (40, 12))
    )
    depth = rng.integers(0, 9, 40) + 0.0
    other_depth = rng.integers(0, 9, 12) + 0.0
    other_depth[3] = np.nan
    far = np.full((2, 12), 1e6)
    some = np.ones((2, 12))
    hiders = Hiders(others + 0.0, other_depth, far, some, 9.21, 0.0)
    wanted = np.zeros(40)
    for a, box in enumerate(xyxy):
        for b, other in enumerate(others):
            wide, high = np.minimum(box[2:], other[2:]) - np.maximum(box[:2], other[:2])
            if other_depth[b] < depth[a] and wide > 0 and high > 0:
                wanted[a] = max(wanted[a], wide * high / np.prod(box[2:] - box[:2]))
    np.testing.assert_allclose(
        hiders.visible_part(np.zeros((2, 40)), xyxy + 0.0, depth), 1 - wanted**1.5
    )


def test_shares_of_boxes_inside_the_image():
    xyxy = np.array(
        [
            [0.0, 0, 10, 20],
            [-5, 0, 5, 20],
            [60, 40, 80, 60],
            [90, 0, 99, 9],
            [-10, -10, 200, 200],
            [1, 1, 1, 5],
        ]
    )
    np.testing.assert_allclose(share_inside(xyxy, 70.0, 50.0), [1, 0.5, 0.25, 0, 3500 / 210**2, 0])


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
    corner = rng.uniform(0, room, (count, 2))
    size = rng.uniform(5, 60, (count, 2))
    size[::7] *= [1.0, 0.0]
    boxes = np.hstack([corner, corner + size])
    boxes[1::5] = boxes[: len(boxes[1::5])]
    boxes[count // 2, [0, 2]] = [-10, room + 10]
    return boxes


@pytest.mark.parametrize("overlap", [0.0, 0.2, 0.5, 0.9])
@pytest.mark.parametrize("count", [1, 2, 17, 120])
def test_kept_boxes_are_those_of_the_definition(count: int, overlap: float):
    went = 0
    for seed in range(6):
        boxes = crowd(np.random.default_rng(seed), count, 40.0 + 4 * count * (seed % 3))
        found = apart(boxes, boxes[:, 0].argsort(), overlap).tolist()
        assert found == left_of(boxes, overlap)
        went += count - len(found)
    assert went or count < 17


def continued(before: np.ndarray, after: np.ndarray, overlap: float) -> list[int]:
    """The definition: each of the two overlaps the other most; of equal ones the first counts."""
    table = iou(before, after)
    table[(table < overlap) | (table == 0)] = -1
    if not table.size:
        return [-1] * len(after)
    best = np.where(table.max(axis=0) >= 0, table.argmax(axis=0), -1)
    other = table.argmax(axis=1)
    return [int(i) if i >= 0 and other[i] == j else -1 for j, i in enumerate(best)]


@pytest.mark.parametrize("overlap", [0.1, 0.3, 0.7])
@pytest.mark.parametrize("count", [0, 1, 2, 17, 120])
def test_boxes_are_continued_as_defined(count: int, overlap: float):
    linked = 0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        before = crowd(rng, count, 40.0 + 4 * count * (seed % 3)) if count else np.zeros((0, 4))
        after = (before + rng.normal(0, 2 * (seed % 2), before.shape))[rng.random(count) < 0.8]
        for one, two in ((before, after), (after, before)):
            found = following(one, two, overlap).tolist()
            assert found == continued(one, two, overlap)
            linked += len(found) - found.count(-1)
    assert linked or count < 17


def test_boxes_above_each_other_are_continued():
    """All begin at one left side."""
    boxes = np.array([[5.0, 20 * k, 15, 20 * k + 20] for k in range(6)])
    assert following(boxes, boxes[::-1].copy(), 0.3).tolist() == [5, 4, 3, 2, 1, 0]


@given(st.lists(st.tuples(number, number, number, number), max_size=12))
def test_plausible_boxes_are_those_of_the_definition(boxes):
    xyxy = np.array(boxes, np.float64).reshape(-1, 4)
    frame = np.array([64.0, 48.0])
    sides = xyxy[:, 2:] - xyxy[:, :2]
    away = np.abs(xyxy[:, :2] / 2 + xyxy[:, 2:] / 2 - frame / 2)
    good = (sides >= 0.5) & (sides <= 3 * frame) & (away <= 3.5 * frame)
    rows, empty = plausible_boxes(xyxy, 64.0, 48.0, (0.5, 3.0))
    assert rows.tolist() == np.flatnonzero(good.all(axis=1)).tolist()
    assert empty == (~(sides > 0).all(axis=1)).sum()


def test_boxes_agree_in_whichever_order_their_names_come():
    rng = np.random.default_rng(5)
    n = 9
    names = rng.permutation(20)[:n]
    frames = [crowd(rng, n, 200.0) + np.array([0, 0, 1, 1]) for _ in range(4)]
    before = np.abs(rng.normal(1, 1, (2, 4)))
    held = [rng.permutation(n)[: n - k] for k in (0, 1, 2)]
    one, two, three = frames[0], frames[1], frames[2]
    some = np.intersect1d(held[1], held[2])
    some = held[0][np.isin(held[0], some)]

    def sums(first, second, third):
        then = names[first], one[first], frames[3][first]
        between = names[second], two[second]
        return agreement(then, between, (names[third], three[third]), 1.0, 0.9, before)

    np.testing.assert_array_equal(sums(*held), sums(some, some, some))


@given(st.lists(number, max_size=20), number, extent)
def test_sorted_values_within_reach_are_all_found(values, value: float, reach: float):
    along = np.array(values, np.float64)
    cells = sorted_along(along)
    begin, end = within(value, reach, cells)
    assert sorted(cells[1].tolist()) == list(range(len(values)))
    near = np.flatnonzero((along >= value - reach) & (along <= value + reach))
    assert set(near.tolist()) <= set(cells[1][begin:end].tolist())
