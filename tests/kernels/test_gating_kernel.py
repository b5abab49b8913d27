"""Which points lie in which rectangles: the grid finds what looking everywhere finds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack.kernels.gating import gated_pairs
from reference import kernel_twins as twins

# Whole numbers often fall on the edges of rectangles and of cells; the others are anywhere.
coordinates = st.one_of(st.integers(-20, 20).map(float), st.floats(-1e3, 1e3), st.sampled_from([1e9, -1e9, 1e9 + 1]))
extents = st.one_of(st.just(0.0), st.integers(0, 12).map(float), st.floats(0, 500), st.just(1e10))
points = st.lists(st.tuples(coordinates, coordinates), max_size=30)
rectangles = st.lists(st.tuples(coordinates, coordinates, extents, extents), max_size=12)


def columns(rows: list[tuple[float, ...]], count: int) -> np.ndarray:
    return np.array(rows, dtype=float).reshape(-1, count).T.copy()


def pairs(px, py, lower, upper) -> list[tuple[int, int]]:
    point, rectangle = gated_pairs(px, py, lower, upper)
    assert len(point) == len(rectangle)
    assert np.all(np.diff(rectangle) >= 0), "pairs come ordered by rectangle"
    return [(int(i), int(j)) for i, j in zip(point, rectangle, strict=True)]


def agree(px, py, lower, upper) -> int:
    found = pairs(px, py, lower, upper)
    assert len(found) == len(set(found))
    assert set(found) == twins.gated_pairs(px, py, lower, upper)
    return len(found)


@given(points, rectangles)
@settings(max_examples=120, deadline=None)
def test_grid_agrees_with_looking_everywhere(at, around):
    p, r = columns(at, 2), columns(around, 4)
    agree(p[0], p[1], r[:2], r[:2] + r[2:])


@pytest.mark.parametrize("seed", range(6))
def test_random_scenes(seed: int):
    rng = np.random.default_rng(seed)
    p = rng.normal(0, 50 * (1 + seed), (2, 150))
    lower = rng.normal(0, 60, (2, 12))
    assert agree(p[0], p[1], lower, lower + rng.exponential(40, (2, 12))) > 0


def test_nothing_to_look_for():
    none, some = np.zeros((2, 0)), np.ones((2, 3))
    assert agree(none[0], none[1], some, some) == 0
    assert agree(some[0], some[1], none, none) == 0
    assert agree(none[0], none[1], none, none) == 0


@pytest.mark.parametrize("place", [0.0, -7.25, 1e9, 1e15])
def test_all_points_on_one_spot(place: float):
    p = np.full((2, 40), place)
    lower = np.array([[place, place - 1, place + 1e3], [place, place - 1, place]])
    upper = np.array([[place, place + 1, place + 2e3], [place, place + 1, place]])
    assert agree(p[0], p[1], lower, upper) == 80


def test_one_rectangle_around_everything():
    p = np.random.default_rng(1).uniform(0, 100, (2, 50))
    assert agree(p[0], p[1], np.full((2, 1), -1e6), np.full((2, 1), 1e6)) == 50


def test_points_outside_every_rectangle():
    p = np.random.default_rng(1).uniform(0, 100, (2, 50))
    lower = np.array([[-50.0, 200.0, 20.0, 20.0], [0.0, 0.0, -90.0, 400.0]])
    assert agree(p[0], p[1], lower, lower + 30) == 0


def test_rectangles_without_extent_hold_what_lies_on_them():
    p = np.array([[1.0, 2.0, 3.0, 2.0], [5.0, 5.0, 5.0, 5.0]])
    at = np.array([[2.0, 2.5], [5.0, 5.0]])
    assert sorted(pairs(p[0], p[1], at, at)) == [(1, 0), (3, 0)]


def test_borders_belong_to_the_rectangle():
    p = np.array([[0.0, 10.0, 10.0 + 1e-9], [0.0, 4.0, 4.0]])
    assert pairs(p[0], p[1], np.zeros((2, 1)), np.array([[10.0], [4.0]])) == [(0, 0), (1, 0)]


def test_many_more_answers_than_points():
    """The buffers grow: each of 30 points lies in each of 40 rectangles."""
    p = np.random.default_rng(2).uniform(0, 1, (2, 30))
    assert agree(p[0], p[1], np.full((2, 40), -1.0), np.full((2, 40), 2.0)) == 1200


def test_a_line_of_points_and_tiny_rectangles_need_little_memory():
    """Cells the size of the rectangles would be a million in a row; the grid stays in proportion to the points."""
    x = np.linspace(0, 1e6, 60)
    y = np.zeros(60)
    lower = np.stack([x - 1e-3, y])
    assert agree(x, y, lower, lower + np.array([[2e-3], [0.0]])) == 60


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
@pytest.mark.parametrize("place", range(4))
def test_what_is_not_finite_is_refused(wrong: float, place: int):
    """Cells made of NaN would lie outside the grid, and memory beside it would be written."""
    arrays = [np.array([0.0, 1.0]), np.array([0.0, 1.0]), np.zeros((2, 1)), np.ones((2, 1))]
    arrays[place].flat[-1] = wrong
    with pytest.raises(ValueError, match="finite"):
        gated_pairs(*arrays)


def test_inputs_are_left_alone():
    p, lower = np.random.default_rng(3).uniform(0, 9, (2, 20)), np.zeros((2, 1))
    upper = np.full((2, 1), 5.0)
    for array in (p, lower, upper):
        array.flags.writeable = False
    agree(p[0], p[1], lower, upper)
