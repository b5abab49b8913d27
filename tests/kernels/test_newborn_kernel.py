"""Standard points and the newborn placed from them: their law, and their weights against the printed formula."""

from __future__ import annotations

import numpy as np
import pytest
from numba import config
from scipy import stats

from inner_kernels import from_python
from phdtrack.kernels.birth_table import detection_table
from phdtrack.kernels.box_blocks import BLOCK, ROWS
from phdtrack.kernels.newborn import PEAK, place_newborn, standard_points, stretch, weigh_newborn
from phdtrack.models.births import KEPT, region
from reference import fused_twin as twins

place_newborn, stretch, weigh_newborn = from_python(place_newborn, stretch, weigh_newborn)

LIMIT, RADIUS = region()
FRAMES, EACH = (6, 40) if config.DISABLE_JIT else (400, 250)
F = np.float32


@pytest.fixture(scope="module")
def points() -> np.ndarray:
    """(frames, 7, points) under independent keys."""
    keys = np.random.default_rng(9).integers(0, 2**32, (FRAMES, 2))
    return np.stack([standard_points(EACH, RADIUS, key) for key in keys]).astype(np.float64)


def quantiles(points: np.ndarray) -> np.ndarray:
    """The quantile of each point's radius among those of the kept part."""
    return stats.chi2(4).cdf((points[..., :4, :] ** 2).sum(-2)) / KEPT


def test_radii_are_those_of_the_truncated_gaussian(points):
    """One point a frame is an independent draw; all of a frame's cover every stretch of the quantiles."""
    u = quantiles(points)
    assert (u > -1e-6).all()
    assert (u < 1 + 1e-5).all()
    for column in range(0, EACH, EACH // 4):
        assert stats.kstest(u[:, column], "uniform").pvalue > 1e-3
    for length in (10, EACH // 2, EACH):
        for begin in (0, EACH - length):
            part = np.sort(u[:, begin : begin + length], axis=1)
            # Of a golden-section sequence the distance falls as one over the number, but for a logarithm.
            off = np.abs(part - (np.arange(length) + 0.5) / length).max()
            assert off < 3 / length


def test_directions_are_uniform(points):
    d = points[:, :4] / np.sqrt((points[:, :4] ** 2).sum(1, keepdims=True))
    n = FRAMES * EACH
    flat = d.transpose(1, 0, 2).reshape(4, n)
    np.testing.assert_allclose(flat.mean(1), 0, atol=4.5 * 0.5 / np.sqrt(n))
    np.testing.assert_allclose(flat @ flat.T / n, np.eye(4) / 4, atol=4.5 * 0.3 / np.sqrt(n))
    # On the sphere E d⁴ = 3/24, E d²e² = 1/24; points on a torus, say, would have others.
    squares = (flat**2) @ (flat**2).T / n
    np.testing.assert_allclose(squares, (np.ones((4, 4)) + 2 * np.eye(4)) / 24, atol=4.5 * 0.25 / np.sqrt(n))
    for row in flat:
        assert stats.kstest(row**2, stats.beta(0.5, 1.5).cdf).pvalue > 1e-3
    radius = quantiles(points).ravel()
    for row in flat:
        assert abs(np.corrcoef(radius, row**2)[0, 1]) < 4.5 / np.sqrt(n)


def test_coordinates_are_those_of_a_truncated_gaussian(points):
    """Each has mean 0 and the variance of the kept part, E[r²]/4, and two do not correlate."""
    x = points[:, :4].transpose(1, 0, 2).reshape(4, -1)
    variance = stats.chi2(6).cdf(LIMIT) / KEPT
    np.testing.assert_allclose(np.cov(x), variance * np.eye(4), atol=4.5 * np.sqrt(2 / x.shape[1]))


def test_the_density_is_that_of_the_point(points):
    np.testing.assert_allclose(points[:, 4], np.exp(-0.5 * (points[:, :4] ** 2).sum(1)), rtol=1e-5)


def test_velocities_have_uniform_direction_and_gaussian_amplitude(points):
    v = points[:, 5:7].transpose(1, 0, 2).reshape(2, -1)
    n, speed = v.shape[1], np.hypot(*v)
    assert stats.kstest(speed, stats.halfnorm.cdf).pvalue > 1e-3
    assert stats.kstest(np.arctan2(v[1], v[0]) / (2 * np.pi) + 0.5, "uniform").pvalue > 1e-3
    np.testing.assert_allclose(np.cov(v), np.eye(2) / 2, atol=4.5 * np.sqrt(9 / 8 / n))
    for row in points[:, :4].transpose(1, 0, 2).reshape(4, -1):
        assert abs(np.corrcoef(row, v[0])[0, 1]) < 4.5 / np.sqrt(n)
        assert abs(np.corrcoef(row**2, speed**2)[0, 1]) < 4.5 / np.sqrt(n)


def test_points_belong_to_their_key_and_number():
    key = np.array([5, 2**32 - 1])
    many, few = standard_points(40, RADIUS, key), standard_points(11, RADIUS, key)
    np.testing.assert_array_equal(many[:, :11], few)
    assert not np.isin(standard_points(40, RADIUS, np.array([5, 2**32 - 2]))[0], many[0]).any()


def test_stretches_begin_anywhere():
    k0, k1 = np.uint32(3), np.uint32(4)
    begin = np.array([stretch(j, 9, k0, k1) for j in range(400)])
    assert set(begin) == set(range(10))
    assert stats.chisquare(np.bincount(begin)).pvalue > 1e-3
    assert stretch(5, 0, k0, k1) == 0


def scene(n: int, seed: int, size: float = 30.0):
    """Detections close to each other, their deviations, and how many newborn each has (one of them none)."""
    rng = np.random.default_rng(seed)
    z = np.vstack([rng.uniform(0, 40, (2, n)), size * rng.uniform(0.7, 1.4, (2, n))])
    sigma = np.maximum(0.15 * np.vstack([z[2:] / 2, z[2:]]), [[0.5], [0.5], [1], [1]])
    many = rng.integers(1, 300, n)
    many[-1] = 0
    return z, sigma, many


@pytest.mark.parametrize("local", [True, False])
@pytest.mark.parametrize("size", [30.0, 2.0])
@pytest.mark.parametrize("n", [2, 6])
def test_weights_are_gamma_over_the_proposal(n: int, size: float, local: bool):
    z, sigma, many = scene(n, 1, size)
    noise = np.zeros((6, n))
    noise[[0, 1, 4, 5]] = sigma
    volume = 4 * (z[2] * z[3]) ** 2
    table, *_ = detection_table(z, noise, 0.02 if local else 0.0, volume, LIMIT, z[:2], z[:2], local)
    table[PEAK] = many / ((2 * np.pi) ** 2 * sigma.prod(0)) / KEPT
    drawn = standard_points(90, RADIUS, np.array([1, 2]))
    everybody, count = np.arange(n), 60
    for j in range(n - 1):
        s = np.full(ROWS * BLOCK, np.nan, F)
        place_newborn(s, count, drawn, 7 + j, table, j)
        x = s.reshape(ROWS, BLOCK)[[0, 1, 4, 5], :count].astype(float)
        np.testing.assert_allclose(x, z[:, [j]] + sigma[:, [j]] * drawn[:4, 7 + j : 7 + j + count], rtol=1e-5, atol=1e-5)
        total = weigh_newborn(s, count, table, j, everybody, n, F(LIMIT), local, F(0.0 if local else 3e-9))
        weight = s.reshape(ROWS, BLOCK)[12, :count]
        assert total == pytest.approx(weight.sum(), rel=1e-5)
        wanted = []
        for i in range(count):
            state = np.array([*x[:2, i], 0, 0, *x[2:, i]])
            flat = None if local else 3e-9
            wanted.append(twins.newborn_weight(state, z, sigma, many, LIMIT * (1 + 1e-6), KEPT, 0.02, flat))
        # On the rim of a region or a neighbourhood rounding decides.
        off = np.abs(weight - wanted) > 2e-4 * np.array(wanted)
        assert off.sum() <= 1
        assert (s.reshape(ROWS, BLOCK)[4:6, :count] > 0).all()
        assert np.isnan(s.reshape(ROWS, BLOCK)[:, count:]).all()
        if size == 2.0:
            assert (weight[(x[2:] <= 0).any(0)] == 0).all()


def test_the_mass_of_a_flat_density_is_that_of_the_region():
    """Σ weight = γ · volume of the 99 % ellipsoid, for one detection alone."""
    z = np.array([[100.0], [50], [40], [80]])
    noise = np.zeros((6, 1))
    noise[[0, 1, 4, 5], 0] = [3, 6, 6, 12]
    table, *_ = detection_table(z, noise, 0.0, np.ones(1), LIMIT, z[:2], z[:2], False)
    count, masses = 250, []
    table[PEAK] = count / ((2 * np.pi) ** 2 * 3 * 6 * 6 * 12) / KEPT
    for key in range(3 if config.DISABLE_JIT else 200):
        s = np.zeros(ROWS * BLOCK, F)
        place_newborn(s, count, standard_points(count, RADIUS, np.array([key, 1])), 0, table, 0)
        masses.append(weigh_newborn(s, count, table, 0, np.zeros(1, np.int64), 1, F(LIMIT), False, F(1e-7)))
    wanted = 1e-7 * np.pi**2 / 2 * LIMIT**2 * 3 * 6 * 6 * 12
    error = 0.07 * wanted / np.sqrt(len(masses))
    assert np.mean(masses) == pytest.approx(wanted, abs=4 * error)
    assert np.std(masses) < 0.1 * wanted
