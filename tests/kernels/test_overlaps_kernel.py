"""Which rectangles a box overlaps: as brute force says, each once."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from inner_kernels import from_python
from phdtrack.kernels.overlaps import cell_of, overlapping, rectangle_grid
from reference import fused_twin as twins

cell_of, overlapping = from_python(cell_of, overlapping)

# Whole numbers too, so that edges meet.
number = st.one_of(st.integers(-40, 40).map(float), st.floats(-1e3, 1e3), st.floats(-1e7, 1e7))
extent = st.one_of(st.integers(0, 30).map(float), st.floats(0, 200), st.floats(0, 1e6))
rectangle = st.tuples(number, number, extent, extent)


def found_in(box, lower, upper) -> list[int]:
    grid = rectangle_grid(lower, upper)
    found = np.full(lower.shape[1] + 1, -1, np.int64)
    count = overlapping(*box, lower, upper, *grid, found)
    assert (found[count:] == -1).all()
    return found[:count].tolist()


def corners(rectangles) -> tuple[np.ndarray, np.ndarray]:
    r = np.array(rectangles, np.float64).reshape(-1, 4).T
    return np.ascontiguousarray(r[:2]), r[:2] + r[2:]


@given(st.lists(rectangle, max_size=20), st.lists(rectangle, min_size=1, max_size=6))
@settings(max_examples=100, deadline=None)
def test_as_brute_force_says(rectangles, boxes):
    lower, upper = corners(rectangles)
    for x, y, w, h in boxes:
        box = (x, y, x + w, y + h)
        found = found_in(box, lower, upper)
        wanted = [j for j in range(len(rectangles)) if twins.touches(box, lower, upper, j)]
        assert sorted(found) == wanted, "each once"


def test_many_small_rectangles_in_a_wide_field():
    """More cells than the grid may have; boxes small, wide, and beside the field."""
    rng = np.random.default_rng(1)
    lower = rng.uniform(-5000, 5000, (2, 150))
    upper = lower + rng.uniform(0, 3, (2, 150))
    for box in [(-1e9, -1e9, 1e9, 1e9), (0, 0, 50, 4000), (-9000, -9000, -8000, -8000), *[(a, b, a + 900, b + 900)
                for a, b in rng.uniform(-5000, 5000, (15, 2))]]:  # fmt: skip
        assert sorted(found_in(box, lower, upper)) == [j for j in range(150) if twins.touches(box, lower, upper, j)]


def test_no_rectangles_and_one_point():
    assert found_in((0, 0, 1, 1), np.zeros((2, 0)), np.zeros((2, 0))) == []
    point = np.array([[3.0], [4.0]])
    assert found_in((3, 4, 3, 4), point, point) == [0]
    assert found_in((3.001, 4, 5, 5), point, point) == []


def test_the_grid_is_linear_in_the_rectangles():
    for spread in (1.0, 1e3, 1e6):
        lower = np.random.default_rng(2).uniform(0, spread, (2, 100))
        frame, start, item, _ = rectangle_grid(lower, lower + 1)
        assert start.size - 1 == frame[4] * frame[5] <= 4 * 100 + 16
        assert item.size <= 16 * 100


def test_cells_are_clamped():
    cells = {-5.0: 0, 0.0: 0, 0.99: 0, 1.0: 1, 3.5: 3, 99.0: 3, np.inf: 3, -np.inf: 0, np.nan: 0}
    for value, cell in cells.items():
        assert cell_of(value, 0.0, 1.0, 4) == cell
