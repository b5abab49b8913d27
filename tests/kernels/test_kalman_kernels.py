"""Kalman prediction and update of many Gaussians against one at a time, in other forms."""

from __future__ import annotations

import numpy as np
import pytest

from phdtrack.kernels.kalman import factor, predicted_covariance, updated
from reference import gm_twin as twin


def positive(rng: np.random.Generator, n: int, d: int) -> np.ndarray:
    root = rng.normal(0, 2, (n, d, d))
    return root @ root.transpose(0, 2, 1) + 0.1 * np.eye(d)


@pytest.mark.parametrize("d", [1, 4, 6])
def test_prediction(d: int, rng):
    cov, f, q = positive(rng, 7, d), rng.normal(0, 1, (7, d, d)), positive(rng, 7, d)
    _, _, expected = twin.predict(np.ones(7), np.zeros((d, 7)), cov, 1.0, f, q)
    found = predicted_covariance(cov, f, q)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(found, found.transpose(0, 2, 1))


@pytest.mark.parametrize(("d", "rows"), [(4, [0, 1]), (6, [0, 1, 4, 5]), (3, [2])])
def test_update_of_pairs(d: int, rows: list[int], rng):
    mean, cov, z = rng.normal(0, 3, (d, 5)), positive(rng, 5, d), rng.normal(0, 3, (len(rows) + 1, 4))
    point, which = np.array([0, 4, 4, 2]), np.array([3, 0, 1, 1])
    noise = positive(rng, 4, len(rows))
    means, covs = updated(mean, cov, z, noise, np.array(rows), point, which)
    h = np.eye(d)[rows]
    for p in range(4):
        m, c = twin.kalman(mean[:, point[p]], cov[point[p]], z[: len(rows), which[p]], h, noise[p])
        np.testing.assert_allclose(means[:, p], m, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(covs[p], c, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(covs, covs.transpose(0, 2, 1))


def test_no_pairs(rng):
    none = np.zeros(0, np.int64)
    means, covs = updated(np.zeros((6, 0)), np.zeros((0, 6, 6)), np.zeros((4, 0)), np.zeros((0, 4, 4)), none, none, none)
    assert means.shape == (6, 0)
    assert covs.shape == (0, 6, 6)


def test_what_has_no_root_is_told(rng):
    s = np.diag([4.0, -1.0])
    assert np.isnan(factor(s))
    s = positive(rng, 1, 3)[0]
    expected = np.linalg.cholesky(s)
    assert factor(s) == pytest.approx(np.sqrt(np.linalg.det(expected @ expected.T)))
    np.testing.assert_allclose(np.tril(s), expected)
