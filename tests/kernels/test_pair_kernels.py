"""Distances over pairs, and Gaussian parts: against loops that read like the formulas."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack.kernels.gaussian import gaussian_parts
from phdtrack.kernels.pairs import quadratic_form

seeds = st.integers(0, 2**32 - 1)
# Pixels from the origin: rounding must not grow with them more than subtraction makes it.
offsets = st.sampled_from([0.0, 1e3, 1e6])


def precisions(rng: np.random.Generator, k: int, d: int) -> np.ndarray:
    root = rng.normal(size=(k, d, d))
    return root @ root.transpose(0, 2, 1) + 0.1 * np.eye(d)


def pairing(rng: np.random.Generator, points: int, centres: int, pairs: int):
    return rng.integers(0, points, pairs), rng.integers(0, centres, pairs)


@given(seeds, st.integers(1, 8), offsets)
@settings(max_examples=40, deadline=None)
def test_distances(seed: int, d: int, offset: float):
    rng = np.random.default_rng(seed)
    x, centre = offset + rng.normal(size=(d, 12)), offset + rng.normal(size=(d, 4))
    shape = precisions(rng, 4, d)
    point, which = pairing(rng, 12, 4, int(rng.integers(0, 40)))
    want = [(x[:, i] - centre[:, j]) @ shape[j] @ (x[:, i] - centre[:, j]) for i, j in zip(point, which, strict=True)]
    np.testing.assert_allclose(quadratic_form(x, centre, shape, point, which), want, rtol=1e-9)


@given(seeds, st.integers(1, 6), st.integers(0, 8))
@settings(max_examples=40, deadline=None)
def test_gaussian_parts(seed: int, m: int, count: int):
    rng = np.random.default_rng(seed)
    step, cov = rng.normal(0, 10, (m, count)), precisions(rng, count, m) * rng.choice([1e-4, 1.0, 1e4])
    distance2, log_det = gaussian_parts(step, cov)
    np.testing.assert_allclose(distance2, [s @ np.linalg.solve(c, s) for s, c in zip(step.T, cov, strict=True)], rtol=1e-8)
    np.testing.assert_allclose(log_det, np.linalg.slogdet(cov)[1], rtol=1e-9, atol=1e-9)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_matrix_that_is_not_positive_definite_gives_nan_and_spoils_no_other():
    cov = np.stack([np.array([[1.0, 2.0], [2.0, 1.0]]), np.eye(2)])
    distance2, log_det = gaussian_parts(np.ones((2, 2)), cov)
    assert np.isnan(distance2[0])
    assert np.isnan(log_det[0])
    assert distance2[1] == 2
    assert log_det[1] == 0
