"""Systematic resampling: the comb, its bounds on offspring, and its rounding."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack.kernels.resample import systematic
from reference import kernel_twins as twins

# Sums of 64ths, teeth at powers of two: exact in floating point, so that the twin must agree on every tie.
exact_weights = st.lists(st.integers(0, 64), min_size=1, max_size=30).filter(any).map(lambda w: np.array(w) / 64)
open_weights = st.lists(st.floats(0, 1e3), min_size=1, max_size=30).filter(lambda w: sum(w) > 1e-3).map(np.array)
offsets = st.floats(0, 1, exclude_max=True)


@given(exact_weights, st.sampled_from([1, 2, 4, 16, 64, 256]), st.sampled_from([0.0, 0.25, 0.5, 0.875]))
@settings(max_examples=100, deadline=None)
def test_teeth_stand_where_the_definition_puts_them(weight, count: int, offset: float):
    np.testing.assert_array_equal(systematic(weight, count, offset), twins.systematic(weight, count, offset))


@given(open_weights, st.integers(1, 200), offsets)
@settings(max_examples=100, deadline=None)
def test_offspring_are_as_many_as_the_weight_says(weight, count: int, offset: float):
    chosen = systematic(weight, count, offset)
    assert len(chosen) == count
    assert np.all(np.diff(chosen) >= 0)
    children = np.bincount(chosen, minlength=len(weight))
    expected = count * weight / weight.sum()
    assert np.all(np.abs(children - expected) < 1 + 1e-9 * count)
    assert not children[weight == 0].any()


def test_the_average_over_offsets_is_the_weight():
    weight = np.array([0.1, 0.0, 0.35, 0.55])
    children = np.mean([np.bincount(systematic(weight, 3, o), minlength=4) for o in (np.arange(400) + 0.5) / 400], axis=0)
    np.testing.assert_allclose(children, 3 * weight, atol=1e-2)


def test_the_last_tooth_beyond_the_rounded_sum_belongs_to_the_last_point_with_weight():
    weight = np.array([0.25] * 4 + [0.0])
    # The last tooth stands at (1023 + 1 − ε)/1024 of the sum, which rounds to all of it.
    chosen = systematic(weight, 1024, np.nextafter(1.0, 0.0))
    assert chosen.max() == 3


def test_small_weights_at_the_end_of_a_long_sum_keep_their_offspring():
    """In float32 the newborn at the end of many particles would have none."""
    weight = np.append(np.full(20_000, 1.0), np.full(2_000, 1e-4))
    chosen = systematic(weight, 20_000, 0.5)
    assert abs((chosen >= 20_000).sum() - 0.2) <= 1
    chosen = systematic(np.append(np.full(20_000, 1e-6), 1.0), 100, 0.5)
    assert (chosen == 20_000).sum() == 98


@pytest.mark.parametrize("weight", [np.zeros(0), np.ones(3)])
def test_no_offspring(weight):
    assert systematic(weight, 0, 0.5).shape == (0,)


def test_one_point_has_all_the_offspring():
    assert list(systematic(np.array([0.3]), 5, 0.99)) == [0] * 5
