"""The smoother's compiled steps against the same in NumPy, also where a matrix is singular."""

import numpy as np
import pytest

from inner_kernels import from_python
from phdtrack.kernels import rts


def gaussians(rng: np.random.Generator, n: int, d: int) -> np.ndarray:
    root = rng.standard_normal((n, d, d)) * np.exp(rng.normal(0, 2, (n, d, 1)))
    return root @ root.transpose(0, 2, 1)


@pytest.fixture(params=[(1, 4, 2), (7, 6, 4), (5, 8, 4), (0, 6, 4)])
def case(request):
    n, d, r = request.param
    rng = np.random.default_rng(n)
    return rng, n, d, np.sort(rng.permutation(d)[:r])


def test_prediction_is_that_of_the_formula(case):
    rng, n, d, _ = case
    f = rng.standard_normal((n, d, d))
    p = gaussians(rng, n, d)
    q = gaussians(rng, n, d)
    np.testing.assert_allclose(rts.predicted(p, f, q), f @ p @ f.transpose(0, 2, 1) + q, rtol=1e-10)


def test_update_is_that_of_the_formula(case):
    rng, n, d, rows = case
    x = rng.normal(size=(n, d))
    p = gaussians(rng, n, d)
    z = rng.normal(size=(n, len(rows)))
    r = gaussians(rng, n, len(rows))
    mean, cov = rts.updated(x, p, z, r, rows)
    for k in range(n):
        h = np.eye(d)[rows]
        gain = p[k] @ h.T @ np.linalg.inv(h @ p[k] @ h.T + r[k])
        np.testing.assert_allclose(mean[k], x[k] + gain @ (z[k] - h @ x[k]), rtol=1e-6, atol=1e-8)
        scale = np.sqrt(np.diag(p[k]))
        np.testing.assert_allclose(
            cov[k] / np.outer(scale, scale),
            (p[k] - gain @ h @ p[k]) / np.outer(scale, scale),
            atol=1e-8,
        )


def test_smoothing_is_that_of_the_formula(case):
    rng, n, d, _ = case
    x = rng.normal(size=(n, d))
    p = gaussians(rng, n, d)
    f = rng.normal(size=(n, d, d))
    q = gaussians(rng, n, d)
    later = rng.normal(size=(n, d))
    after = gaussians(rng, n, d)
    ahead = (f @ x[:, :, None])[:, :, 0], f @ p @ f.transpose(0, 2, 1) + q, f, q
    mean = x.copy()
    cov = p.copy()
    onward = np.arange(n) != 1
    rts.smooth((mean, cov), ahead, (later, after), onward)
    np.testing.assert_array_equal(mean[~onward], x[~onward])
    rts.smooth((mean, cov), ahead, (later, after), ~onward)
    for k in range(n):
        gain = p[k] @ f[k].T @ np.linalg.inv(ahead[1][k])
        np.testing.assert_allclose(
            mean[k], x[k] + gain @ (later[k] - ahead[0][k]), rtol=1e-6, atol=1e-8
        )
        expected = p[k] + gain @ (after[k] - ahead[1][k]) @ gain.T
        scale = np.sqrt(np.abs(np.diag(p[k])) + np.abs(np.diag(expected)))
        np.testing.assert_allclose(
            cov[k] / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-7
        )


def test_log_density_is_that_of_the_formula(case):
    rng, n, d, rows = case
    step = rng.normal(size=(n, len(rows)))
    p = gaussians(rng, n, d)
    r = gaussians(rng, n, len(rows))
    (log_density,) = from_python(rts.log_density)
    for k in range(n):
        s = p[k][np.ix_(rows, rows)] + r[k]
        for here in (slice(0, 2), slice(2, None)):
            a = s[here, here]
            v = step[k, here]
            expected = (
                -0.5 * (np.linalg.slogdet(a)[1] + v @ np.linalg.solve(a, v)) if len(v) else 0.0
            )
            found = log_density(
                step[k], p[k], r[k], rows, here.start, np.empty((3, len(v), len(v)))
            )
            assert found == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_exactly_known_component_stays_so(rng):
    """Its variance is 0: the predicted covariance has no inverse."""
    p = gaussians(rng, 3, 4)
    f = np.tile(np.eye(4), (3, 1, 1))
    q = np.zeros((3, 4, 4))
    d = 4
    p[:, 3, :] = p[:, :, 3] = 0.0
    x = rng.normal(size=(3, d))
    later = rng.normal(size=(3, d))
    later[:, 3] = x[:, 3]
    mean = x.copy()
    cov = p.copy()
    rts.smooth((mean, cov), (x, p, f, q), (later, p / 2), np.ones(3, np.bool_))
    np.testing.assert_allclose(mean, later, rtol=1e-7)
    np.testing.assert_allclose(cov, p / 2, atol=1e-8 * p.max())
