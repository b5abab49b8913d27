from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phdtrack.errors import InputError
from phdtrack.report.record import default_cell, density_map
from phdtrack.types import Particles, SequenceInfo


@given(
    st.integers(1, 90), st.integers(1, 90), st.floats(0.7, 40), st.integers(0, 200), st.integers(0, 4), st.integers(0, 2**31)
)
def test_mass_inside_the_frame_is_conserved(wide: int, high: int, cell: float, count: int, smooth: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    state = rng.uniform(-0.3, 1.3, (4, count)) * np.array([wide, high, 1, 1])[:, None]
    weight = rng.exponential(1.0, count)
    grid = density_map(Particles(state, weight), SequenceInfo(wide, high, 25.0), cell, smooth=smooth)
    inside = (state[0] >= 0) & (state[0] < wide) & (state[1] >= 0) & (state[1] < high)
    assert grid.sum() == pytest.approx(weight[inside].sum(), rel=1e-12, abs=1e-12)
    assert grid.shape == (int(np.ceil(high / cell)), int(np.ceil(wide / cell)))
    assert (grid >= 0).all()


def test_mass_lands_in_the_cell_of_the_position() -> None:
    particles = Particles(np.array([[25.0, 3.0], [11.0, 39.0]]), np.array([0.5, 2.0]))
    grid = density_map(particles, SequenceInfo(40, 40, 25.0), 10, smooth=0)
    expected = np.zeros((4, 4))
    expected[1, 2], expected[3, 0] = 0.5, 2.0
    np.testing.assert_array_equal(grid, expected)


def test_smoothing_is_the_binomial_kernel_inside() -> None:
    particles = Particles(np.array([[25.0], [25.0]]), np.array([16.0]))
    grid = density_map(particles, SequenceInfo(50, 50, 25.0), 10, smooth=1)
    np.testing.assert_allclose(grid[1:4, 1:4], [[1, 2, 1], [2, 4, 2], [1, 2, 1]])


@pytest.mark.parametrize(("wide", "high", "cell"), [(0, 10, 1.0), (10, 0, 1.0), (10, 10, 0.0), (10, 10, np.nan)])
def test_a_grid_without_size_is_refused(wide: int, high: int, cell: float) -> None:
    with pytest.raises(InputError, match="positive size"):
        density_map(Particles(np.zeros((2, 0)), np.zeros(0)), SequenceInfo(wide, high, 25.0), cell)


def test_default_cell_gives_a_bounded_grid() -> None:
    assert default_cell(SequenceInfo(3840, 2160, 25.0)) == 30
    assert default_cell(SequenceInfo(64, 48, 25.0)) == 1
