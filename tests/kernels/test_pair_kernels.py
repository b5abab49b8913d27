"""Gaussian parts, against loops that read like the formulas."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack.kernels.gaussian import gaussian_parts

seeds = st.integers(0, 2**32 - 1)


def precisions(rng: np.random.Generator, k: int, d: int) -> np.ndarray:
    root = rng.normal(size=(k, d, d))
    return root @ root.transpose(0, 2, 1) + 0.1 * np.eye(d)


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
