"""Order by weight, merging through a grid, prune and cap, parts of Gaussians: what loops over every
pair find.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from inner_kernels import from_python
from phdtrack.kernels.gaussian import gaussian_parts
from phdtrack.kernels.gm_merge import Merging, Rows, descending, merged_rows
from reference import gm_twin as twin

(descending,) = from_python(descending)

weights = st.lists(
    st.one_of(st.floats(0, 3), st.sampled_from([0.0, 0.5, 1.0, 1e-300, 5e-324, 1e300])), max_size=60
)


@given(weights)
@settings(max_examples=100, deadline=None)
def test_descending_order_is_stable(values):
    w = np.array(values, dtype=np.float64)
    np.testing.assert_array_equal(descending(w), np.argsort(-w, kind="stable"))


def mixture(
    rng: np.random.Generator, n: int, d: int, spread: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gaussians in clumps, some much wider than others, weights over decades."""
    centres = rng.uniform(0, spread, (d, max(1, n // 3)))
    mean = centres[:, rng.integers(centres.shape[1], size=n)] + rng.normal(0, 2, (d, n))
    root = rng.normal(0, 1, (n, d, d)) * rng.choice([1.0, 3.0, 20.0], (n, 1, 1), p=[0.6, 0.3, 0.1])
    return 10 ** rng.uniform(-6, 0.2, n), mean, root @ root.transpose(0, 2, 1) + 0.5 * np.eye(d)


def same(found, expected) -> None:
    assert len(found[0]) == len(expected[0])
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9)


def kernel(weight, mean, cov, prune, distance, most, redistribute):
    mass = weight.sum() if redistribute else -1.0
    rows = Rows(weight, np.ascontiguousarray(mean.T), cov)
    return merged_rows(
        rows, tuple(range(len(mean))), Merging(prune, distance, most, redistribute), mass
    )


@pytest.mark.parametrize("d", [2, 4, 6])
@pytest.mark.parametrize("seed", range(6))
def test_reduction_is_that_of_the_paper(d: int, seed: int):
    rng = np.random.default_rng(seed)
    w, mean, cov = mixture(rng, 70, d, [20.0, 200.0, 2000.0][seed % 3])
    before = len(w)
    for distance in (0.5, 2.0, 5.0):
        for most, redistribute in ((0, False), (8, False), (8, True), (500, True)):
            expected = twin.reduce(w, mean, cov, 1e-5, distance, most, redistribute)
            same(kernel(w, mean, cov, 1e-5, distance, most, redistribute), expected)
    assert len(twin.reduce(w, mean, cov, 1e-5, 2.0, 0, False)[0]) < before, "something was merged"


def test_merging_keeps_mean_and_covariance(rng):
    w, mean, cov = mixture(rng, 50, 6, 30.0)
    far = mean + 1e6
    a, m, p = kernel(w, far, cov, 0.0, 3.0, 0, False)
    assert len(a) < 50
    centre = np.average(far, axis=1, weights=w)

    def second(weight, x, c):
        step = x - centre[:, None]
        return np.einsum("j,jrs->rs", weight, c) + (weight * step) @ step.T

    np.testing.assert_allclose(np.average(m, axis=1, weights=a), centre, rtol=1e-13)
    np.testing.assert_allclose(second(a, m, p), second(w, far, cov), rtol=1e-6)
    np.testing.assert_array_equal(p, p.transpose(0, 2, 1))


def test_empty_and_light_mixtures():
    none = (np.zeros(0), np.zeros((6, 0)), np.zeros((0, 6, 6)))
    for a, b in zip(kernel(*none, 1e-5, 2.0, 10, True), none, strict=True):
        assert a.shape == b.shape
    light = (np.array([1e-7, 1e-8]), np.zeros((6, 2)), np.tile(np.eye(6), (2, 1, 1)))
    assert len(kernel(*light, 1e-5, 2.0, 10, True)[0]) == 0
    w, mean, cov = kernel(
        np.zeros(2), np.zeros((6, 2)), np.tile(np.eye(6), (2, 1, 1)), 0.0, 2.0, 0, True
    )
    np.testing.assert_array_equal(w, [0.0])
    np.testing.assert_array_equal(cov[0], np.eye(6))
    assert mean.shape == (6, 1)


def test_merging_at_one_point_and_on_a_line(rng):
    """All in one point, and all on one line: grids of no extent."""
    mean = np.zeros((4, 40))
    cov = np.tile(np.eye(4), (40, 1, 1))
    w = rng.uniform(0.1, 1, 40)
    same(kernel(w, mean, cov, 0.0, 2.0, 0, False), twin.reduce(w, mean, cov, 0.0, 2.0, 0, False))
    mean[0] = np.linspace(0, 1e4, 40)
    same(kernel(w, mean, cov, 0.0, 2.0, 0, False), twin.reduce(w, mean, cov, 0.0, 2.0, 0, False))


def test_singular_covariances_are_not_merged():
    mean = np.zeros((2, 3))
    cov = np.stack([np.eye(2), np.zeros((2, 2)), np.diag([1.0, 0.0])])
    assert len(kernel(np.array([1.0, 0.5, 0.2]), mean, cov, 0.0, 2.0, 0, False)[0]) == 3


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_means_that_are_not_finite_are_refused(bad: float):
    mean = np.zeros((6, 3))
    mean[1, 1] = bad
    with pytest.raises(ValueError, match="finite"):
        kernel(np.ones(3), mean, np.tile(np.eye(6), (3, 1, 1)), 0.0, 2.0, 0, False)


seeds = st.integers(0, 2**32 - 1)


def precisions(rng: np.random.Generator, k: int, d: int) -> np.ndarray:
    root = rng.normal(size=(k, d, d))
    return root @ root.transpose(0, 2, 1) + 0.1 * np.eye(d)


@given(seeds, st.integers(1, 6), st.integers(0, 8))
@settings(max_examples=40, deadline=None)
def test_gaussian_parts(seed: int, m: int, count: int):
    rng = np.random.default_rng(seed)
    step = rng.normal(0, 10, (m, count))
    cov = precisions(rng, count, m) * rng.choice([1e-4, 1.0, 1e4])
    distance2, log_det = gaussian_parts(step, cov)
    np.testing.assert_allclose(
        distance2, [s @ np.linalg.solve(c, s) for s, c in zip(step.T, cov, strict=True)], rtol=1e-8
    )
    np.testing.assert_allclose(log_det, np.linalg.slogdet(cov)[1], rtol=1e-9, atol=1e-9)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_matrix_not_positive_definite_gives_nan_alone():
    cov = np.stack([np.array([[1.0, 2.0], [2.0, 1.0]]), np.eye(2)])
    distance2, log_det = gaussian_parts(np.ones((2, 2)), cov)
    assert np.isnan(distance2[0])
    assert np.isnan(log_det[0])
    assert distance2[1] == 2
    assert log_det[1] == 0
