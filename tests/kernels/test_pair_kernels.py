"""Sums and distances over pairs, and Gaussian parts: against loops that read like the formulas."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack.kernels.gaussian import gaussian_parts
from phdtrack.kernels.pairs import moments, nearest, quadratic_form, scaled_distance2, shares
from reference import kernel_twins as twins

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
    scale, shape = rng.uniform(0.1, 5, (d, 4)), precisions(rng, 4, d)
    point, which = pairing(rng, 12, 4, int(rng.integers(0, 40)))
    np.testing.assert_allclose(
        scaled_distance2(x, centre, scale, point, which),
        twins.scaled_distance2(x, centre, scale, point, which),
        rtol=1e-12,
    )
    np.testing.assert_allclose(
        quadratic_form(x, centre, shape, point, which), twins.quadratic_form(x, centre, shape, point, which), rtol=1e-9
    )


@given(seeds, st.integers(0, 60), st.booleans())
@settings(max_examples=60, deadline=None)
def test_nearest(seed: int, pairs: int, ties: bool):
    rng = np.random.default_rng(seed)
    point, which = pairing(rng, 9, 5, pairs)
    distance2 = rng.integers(0, 3, pairs).astype(float) if ties else rng.exponential(size=pairs)
    label, best = nearest(distance2, point, which, 11)
    want_label, want_best = twins.nearest(distance2, point, which, 11)
    np.testing.assert_array_equal(label, want_label)
    np.testing.assert_array_equal(best, want_best)
    assert np.all(label[9:] == -1)


@given(seeds, st.integers(1, 6), st.integers(0, 50), offsets)
@settings(max_examples=60, deadline=None)
def test_moments(seed: int, d: int, pairs: int, offset: float):
    rng = np.random.default_rng(seed)
    x, weight = offset + rng.normal(size=(d, 15)), rng.exponential(size=pairs)
    point, which = pairing(rng, 15, 4, pairs)
    mass, mean, cov = moments(x, weight, point, which, 5)
    want = twins.moments(x, weight, point, which, 5)
    np.testing.assert_allclose(mass, want[0], rtol=1e-12)
    np.testing.assert_allclose(mean, want[1], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(cov, want[2], rtol=1e-7, atol=1e-7 if offset > 1e5 else 1e-10)
    np.testing.assert_array_equal(cov, cov.transpose(0, 2, 1))
    assert mass[4] == 0
    assert not mean[:, 4].any()
    assert not cov[4].any()


@given(seeds, st.integers(0, 40), st.sampled_from([1.0, 30.0, 2000.0]))
@settings(max_examples=60, deadline=None)
def test_shares(seed: int, pairs: int, width: float):
    """Those of a point add up to one, also where every density of it is too small for a number."""
    rng = np.random.default_rng(seed)
    point, _ = pairing(rng, 8, 1, pairs)
    log_density = rng.normal(-1000, width, pairs)
    out = shares(log_density, point, 9)
    np.testing.assert_allclose(out, twins.shares(log_density, point, 9), rtol=1e-9, atol=1e-300)
    total = np.bincount(point, out, 9)
    np.testing.assert_allclose(total[np.unique(point)], 1.0)
    assert total[8] == 0


def test_moments_far_from_the_origin_keep_their_digits():
    """Differences of raw moments would leave nothing of a variance of 1e-4 at 1e7 pixels."""
    step = np.array([-0.01, 0.01])
    x = 1e7 + np.stack([step, step])
    _, _, cov = moments(x, np.ones(2), np.arange(2), np.zeros(2, np.int64), 1)
    np.testing.assert_allclose(cov[0], np.full((2, 2), 1e-4), rtol=1e-5)


def test_moments_of_points_without_weight():
    mass, mean, cov = moments(np.ones((2, 3)), np.zeros(3), np.arange(3), np.zeros(3, np.int64), 1)
    assert mass[0] == 0
    assert not mean.any()
    assert not cov.any()


def test_no_pairs():
    none = np.zeros(0, np.int64)
    x, centre = np.zeros((3, 0)), np.zeros((3, 0))
    assert scaled_distance2(x, centre, centre, none, none).shape == (0,)
    assert quadratic_form(x, centre, np.zeros((0, 3, 3)), none, none).shape == (0,)
    label, best = nearest(np.zeros(0), none, none, 2)
    assert list(label) == [-1, -1]
    assert np.all(np.isinf(best))
    assert shares(np.zeros(0), none, 3).shape == (0,)
    assert [a.shape for a in moments(x, np.zeros(0), none, none, 0)] == [(0,), (3, 0), (0, 3, 3)]


@given(seeds, st.integers(1, 6), st.integers(0, 8))
@settings(max_examples=40, deadline=None)
def test_gaussian_parts(seed: int, m: int, count: int):
    rng = np.random.default_rng(seed)
    step, cov = rng.normal(0, 10, (m, count)), precisions(rng, count, m) * rng.choice([1e-4, 1.0, 1e4])
    distance2, log_det = gaussian_parts(step, cov)
    want = twins.gaussian_parts(step, cov)
    np.testing.assert_allclose(distance2, want[0], rtol=1e-8)
    np.testing.assert_allclose(log_det, want[1], rtol=1e-9, atol=1e-9)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_matrix_that_is_not_positive_definite_gives_nan_and_spoils_no_other():
    cov = np.stack([np.array([[1.0, 2.0], [2.0, 1.0]]), np.eye(2)])
    distance2, log_det = gaussian_parts(np.ones((2, 2)), cov)
    assert np.isnan(distance2[0])
    assert np.isnan(log_det[0])
    assert distance2[1] == 2
    assert log_det[1] == 0
