"""Which boxes nearer boxes cover, and how much of them: the grid finds what looking everywhere finds."""

from __future__ import annotations

import numpy as np
import pytest

from inner_kernels import from_python
from phdtrack.kernels.hidden import covered_part, hiding, parts_inside
from phdtrack.kernels.overlaps import rectangle_grid
from reference import hidden_twin as twin

[covered_part] = from_python(covered_part)


def boxes(rng: np.random.Generator, n: int) -> np.ndarray:
    """(n, 4), some on whole numbers so that edges meet."""
    corner = np.rint(rng.uniform(0, 60, (n, 2)))
    return np.hstack([corner, corner + np.rint(rng.uniform(1, 30, (n, 2)))])


def found_by_kernel(xyxy, depth, others, other_depth, room: int):
    low, high = xyxy[:, :2].T.copy(), xyxy[:, 2:].T.copy()
    lower, upper = others[:, :2].T.copy(), others[:, 2:].T.copy()
    pairs, part = np.zeros((2, room), np.int64), np.zeros(room)
    working = np.empty(len(others), np.int64)
    count = hiding(low, high, depth, lower, upper, other_depth, *rectangle_grid(lower, upper), working, pairs, part)
    return count, pairs, part


@pytest.mark.parametrize("seed", range(6))
def test_pairs_and_shares(seed: int):
    rng = np.random.default_rng(seed)
    xyxy, others = boxes(rng, 40), boxes(rng, 12)
    depth, other_depth = np.rint(rng.uniform(0, 9, 40)), np.rint(rng.uniform(0, 9, 12))
    other_depth[3] = np.nan
    want = twin.hiding(xyxy, depth, others, other_depth)
    count, pairs, part = found_by_kernel(xyxy, depth, others, other_depth, 500)
    assert count == len(want) > 10
    assert np.all(np.diff(pairs[0, :count]) >= 0)
    got = {(int(i), int(j)): share for i, j, share in zip(*pairs[:, :count], part[:count], strict=True)}
    assert got.keys() == want.keys()
    assert got == pytest.approx(want)
    # What has no room is counted and not written.
    short, few, _ = found_by_kernel(xyxy, depth, others, other_depth, 5)
    assert short == count
    np.testing.assert_array_equal(few, pairs[:, :5])


def test_nothing_hides_nothing(rng):
    none, some = np.zeros((0, 4)), boxes(rng, 3)
    assert found_by_kernel(some, np.ones(3), none, np.zeros(0), 4)[0] == 0
    assert found_by_kernel(none, np.zeros(0), some, np.zeros(3), 4)[0] == 0


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_the_part_is_that_of_the_area_in_the_type_given(kind):
    rng = np.random.default_rng(4)
    for a, b in zip(boxes(rng, 60).astype(kind), boxes(rng, 60).astype(kind), strict=True):
        assert covered_part(*a, *b) == pytest.approx(twin.covered_part(a, b), rel=1e-5)
    flat = np.array([1, 1, 1, 5], kind)
    assert covered_part(*flat, *np.array([0, 0, 9, 9], kind)) == 0


def test_parts_inside_the_image(rng):
    xyxy = np.array([[0.0, 0, 10, 20], [-5, 0, 5, 20], [60, 40, 80, 60], [90, 0, 99, 9], [-10, -10, 200, 200]])
    np.testing.assert_allclose(parts_inside(xyxy, 70.0, 50.0), [1, 0.5, 0.25, 0, 3500 / 210**2])
