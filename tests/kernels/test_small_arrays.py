"""Loops of kernels that stand for functions of NumPy."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from inner_kernels import from_python
from phdtrack.kernels import small_arrays

ascending_at, copy_into, copy_rows = from_python(
    small_arrays.ascending_at, small_arrays.copy_into, small_arrays.copy_rows
)
values = st.lists(
    st.floats(-5, 5) | st.sampled_from([-np.inf, -1.0, 0.0, 1.0, np.inf]), min_size=1, max_size=40
)


@given(values, st.data())
def test_the_value_at_a_place_is_that_of_the_sorted_values(values: list[float], data) -> None:
    given_values = np.array(values)
    place = data.draw(st.integers(0, len(values) - 1))
    assert ascending_at(given_values, place) == np.sort(given_values)[place]
    np.testing.assert_array_equal(given_values, values)


def test_copies_leave_the_rest_as_it_is() -> None:
    out = np.full(5, 7)
    copy_into(np.arange(3), out)
    assert out.tolist() == [0, 1, 2, 7, 7]
    rows = np.full((2, 2, 3), 7.0)
    copy_rows(np.arange(6.0).reshape(2, 3), rows[:, 1])
    assert rows[:, 1].tolist() == [[0, 1, 2], [3, 4, 5]]
    assert (rows[:, 0] == 7).all()
