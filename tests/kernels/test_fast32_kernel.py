"""Elementary functions in single precision: the errors that their docstrings state."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import config, njit

from phdtrack.kernels.fast32 import cos_sin_turn, exp32, log32, sortable, sorted_number

POINTS = 3_000 if config.DISABLE_JIT else 2_000_000


@njit
def exps(x, out):
    for i in range(x.size):
        out[i] = exp32(x[i])


@njit
def logs(x, out):
    for i in range(x.size):
        out[i] = log32(x[i])


@njit
def turns(u, cosine, sine):
    for i in range(u.size):
        cosine[i], sine[i] = cos_sin_turn(u[i])


def over(function, x, results: int = 1):
    x = np.asarray(x, np.float32)
    out = [np.empty(x.size, np.float32) for _ in range(results)]
    function(x, *out)
    return [o.astype(np.float64) for o in out]


def test_exponential():
    edges = np.float32([0.0, -0.0, -1e-30, -1e-8, -np.log(2) / 2, -86.99999, -87.0])
    x = np.concatenate([np.linspace(-87, 0, POINTS, dtype=np.float32), edges])
    [found] = over(exps, x)
    assert np.abs(found / np.exp(x.astype(np.float64)) - 1).max() < 5e-7


def test_exponential_of_very_small_numbers_is_tiny():
    [found] = over(exps, [-87.01, -88, -100, -1e4, -3e38, -np.inf])
    np.testing.assert_allclose(found, np.exp(-87.0), rtol=5e-7)


def test_logarithm():
    # Every exponent, and densely about 1 where the logarithm changes sign.
    bits = np.linspace(0x00800000, 0x7F7FFFFF, POINTS).astype(np.int32)
    x = np.concatenate([bits.view(np.float32), np.linspace(0.5, 2, POINTS, dtype=np.float32)])
    [found] = over(logs, x)
    exact = np.log(x.astype(np.float64))
    assert (np.abs(found - exact) / (1 + np.abs(exact))).max() < 2e-7


def test_logarithm_has_the_right_sign_near_one():
    """A root is taken of −2·log u, u < 1."""
    x = 1 - np.arange(0, 4096) * np.float32(2.0**-24)
    [found] = over(logs, x)
    assert found[0] == 0
    assert (found[1:] < 0).all()
    np.testing.assert_allclose(found, np.log(x.astype(np.float64)), rtol=5e-7)


def test_cosine_and_sine_of_turns():
    u = np.linspace(0, 1, POINTS, dtype=np.float32)[:-1]
    cosine, sine = over(turns, u, 2)
    angle = 2 * np.pi * u.astype(np.float64)
    assert np.abs(cosine - np.cos(angle)).max() < 3e-7
    assert np.abs(sine - np.sin(angle)).max() < 3e-7


@pytest.mark.parametrize(
    ("u", "cosine", "sine"), [(0.0, 1, 0), (0.25, 0, 1), (0.5, -1, 0), (0.75, 0, -1)]
)
def test_the_quarters_are_exact(u: float, cosine: float, sine: float):
    (c,), (s,) = over(turns, [u], 2)
    assert (c == 0) == (cosine == 0)
    assert (s == 0) == (sine == 0)
    assert abs(c - cosine) < 3e-7
    assert abs(s - sine) < 3e-7


@given(st.floats(width=32, allow_nan=False), st.floats(width=32, allow_nan=False))
@settings(max_examples=200, deadline=None)
def test_sortable_integers_are_in_the_order_of_the_numbers(a: float, b: float):
    x = np.float32(a)
    y = np.float32(b)
    assert (sortable(x) < sortable(y)) == (x < y) or x == y == 0
    back = sorted_number(sortable(x))
    assert back == x
    assert np.signbit(back) == np.signbit(x)
