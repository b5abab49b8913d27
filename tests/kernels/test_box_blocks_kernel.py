"""A block of boxes moved, bounded and weighed, one particle after the other."""

from __future__ import annotations

import numpy as np
import pytest

from inner_kernels import from_python
from phdtrack.filters.box_tables import motion_numbers
from phdtrack.kernels.birth_table import detection_table
from phdtrack.kernels.box_blocks import (
    BLOCK,
    ROWS,
    drift,
    extent,
    likelihood,
    load,
    move,
    own_precisions,
    store,
)
from phdtrack.models import BoxMotion, BoxSensor
from reference import fused_twin as twins

drift, extent, likelihood, load, move, own_precisions, store = from_python(
    drift, extent, likelihood, load, move, own_precisions, store
)

F = np.float32


def boxes(n: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    low, high = [-60, -60, -5, -5, 1, 1], [700, 540, 5, 5, 80, 160]
    return np.ascontiguousarray(rng.uniform(low, high, (n, 6)).T, F)


def block(x: np.ndarray) -> np.ndarray:
    """The scratch array, full of NaN, with the states loaded."""
    s = np.full(ROWS * BLOCK, np.nan, F)
    load(s, x.shape[1], x, 0)
    return s


def rows(s: np.ndarray) -> np.ndarray:
    return s.reshape(ROWS, BLOCK)


@pytest.mark.parametrize("n", [1, 7, 256])
def test_load_and_store_are_each_others_inverse(n: int):
    x = boxes(n + 9)
    s = np.full(ROWS * BLOCK, 7, F)
    load(s, n, x, 4)
    np.testing.assert_array_equal(rows(s)[:6, :n], x[:, 4 : 4 + n])
    assert (rows(s)[:6, n:] == 7).all()
    assert (rows(s)[6:] == 7).all()
    out = np.zeros_like(x)
    store(s, n, out, 3)
    np.testing.assert_array_equal(out[:, 3 : 3 + n], x[:, 4 : 4 + n])
    assert not out[:, :3].any()
    assert not out[:, 3 + n :].any()


@pytest.mark.parametrize("dt", [0.5, 1.0, 3.0])
@pytest.mark.parametrize("scaled", [True, False])
@pytest.mark.parametrize("border", [True, False])
def test_move(border: bool, scaled: bool, dt: float):
    motion = BoxMotion(0.05, 0.2, scaled_noise=scaled, min_size=3.0, frame_size=(640.0, 480.0) if border else (0.0, 0.0))
    if not scaled:
        motion = BoxMotion(1.5, 6.0, scaled_noise=False, min_size=3.0, frame_size=motion.frame_size)
    n, x = 90, boxes(90)
    s, normal = block(x), np.random.default_rng(1).standard_normal((4, n)).astype(F)
    rows(s)[6:10, :n] = normal
    move(s, n, motion_numbers(motion, dt))
    alive = rows(s)[12, :n]
    for i in range(n):
        before, drawn = x[:, i].astype(float), normal[:, i].astype(float)
        wanted = twins.move(before, drawn, dt, motion.acceleration, motion.size_noise, 3.0, scaled)
        np.testing.assert_allclose(rows(s)[:6, i], wanted, rtol=2e-5, atol=1e-4)
        assert alive[i] == (twins.survives(x[:, i], 640, 480) or not border)
        unit = np.maximum(x[4:6, i], 3.0) if scaled else np.ones(2)
        np.testing.assert_allclose(rows(s)[10:12, i], unit)
    assert 0 < alive.sum() < n or not border
    assert np.isnan(rows(s)[:, n:]).all(), "nothing is written behind the block"


@pytest.mark.parametrize("dt", [0.5, 1.0, 2.0, 7.0])
def test_the_noises_of_position_and_velocity_have_the_covariance_of_the_model(dt: float):
    """Linear in the normals, so that their coefficients tell the covariance exactly [M09 (11)]."""
    motion = BoxMotion(0.05, 0.2)
    numbers, x = motion_numbers(motion, dt), np.array([[5.0, 6, 1, 2, 20, 40]], F).T
    mean, _, cov = motion.transition(x.astype(float), dt)
    coefficients = []
    for k in range(6):
        s = block(x)
        rows(s)[6:10, 0] = np.eye(6, 4)[k] if k < 4 else 0
        move(s, 1, numbers)
        if numbers[7] > 0:
            rows(s)[6:10, 0] = [k == 4, k == 5, 0, 0]
            drift(s, 1, numbers[7])
        coefficients.append(rows(s)[:6, 0].astype(float) - mean[:, 0])
    c = np.array(coefficients)
    np.testing.assert_allclose(c.T @ c, cov[0], rtol=1e-4, atol=1e-4 * cov[0].max())
    assert (numbers[7] > 0) == (dt > 1)


def test_extent():
    for n in (1, 5, 256):
        x = boxes(n, n)
        s, both = block(x), np.empty((2, 6), F)
        rows(s)[12, :n] = np.arange(n) % 3 > 0
        assert extent(s, n, both, 1) == (np.arange(n) % 3 > 0).sum()
        out = both[1]
        np.testing.assert_array_equal(out[:4], [x[0].min(), x[1].min(), x[0].max(), x[1].max()])
        np.testing.assert_allclose(out[4:], x[4:6].mean(1), rtol=1e-5)


@pytest.mark.parametrize("scaling", ["particle", "detection", "fixed"])
@pytest.mark.parametrize("floor", [0.0, 1.0, 8.0])
def test_likelihood(scaling: str, floor: float):
    """g, its sum and the number in the region: near, far away, alive and not."""
    rng, n = np.random.default_rng(2), 60
    sensor = BoxSensor(scaling=scaling, min_noise=floor, fixed_noise=(9.0, 14.0))
    x = boxes(n, 3)
    z = x[[0, 1, 4, 5], :4].astype(float) * (1 + 0.05 * rng.standard_normal((4, 4)))
    x[:2, :40] = x[:2, :1] + rng.normal(0, 4, (2, 40))
    x[4:6, :40] = x[4:6, :1] * (1 + 0.1 * rng.standard_normal((2, 40)))
    at_rest = np.zeros((6, 4))
    at_rest[[0, 1, 4, 5]] = z
    noise = sensor.noise(at_rest)
    table, speed, reach, extents, *_ = detection_table(z, noise, 0.1, np.ones(4), 13.28, z[:2], z[:2], False)
    np.testing.assert_allclose(speed, np.sqrt(2) * noise[2], rtol=1e-6)
    np.testing.assert_allclose(reach, np.sqrt(13.28) * noise[:2])
    around = [*(z[:2] - reach), *(z[:2] + reach), *z[2:]]
    np.testing.assert_allclose(extents.T, around, rtol=1e-6)
    own, s = scaling == "particle", block(x)
    alive = (np.arange(n) % 7 > 0).astype(F)
    rows(s)[12, :n] = alive
    if own:
        own_precisions(s, n, F(sensor.box_noise), F(max(floor, 1e-3)))
    for j in range(4):
        total, near = likelihood(s, n, table, j, F(13.28), own)
        sigma = [twins.own_sigma(x[:, i].astype(float), 0.15, floor) if own else noise[[0, 1, 4, 5], j] for i in range(n)]
        g = np.array([twins.likelihood(z[:, j], x[:, i].astype(float), sigma[i]) for i in range(n)]) * alive
        d2 = np.array([twins.distance2(z[:, j], x[:, i].astype(float), sigma[i]) for i in range(n)])
        # The exponent of a box at 700 pixels is known to about 1e-4 where a deviation is a pixel.
        np.testing.assert_allclose(rows(s)[14, :n], g, rtol=2e-3, atol=1e-6 * max(g.max(), 1e-30))
        assert total == pytest.approx(g.sum(), rel=2e-4, abs=1e-30)
        assert abs(near - ((d2 <= 13.28) * alive).sum()) <= (np.abs(d2 - 13.28) < 1e-2).sum()
    assert np.isnan(rows(s)[:, n:]).all()


def test_far_away_nothing_is_explained():
    x = boxes(20)
    s = block(x)
    rows(s)[12, :20] = 1
    own_precisions(s, 20, F(0.15), F(1.0))
    z = np.array([[1e7], [-1e7], [5], [5]])
    noise = np.ones((6, 1))
    table = detection_table(z, noise, 0.0, np.ones(1), 13.28, z[:2], z[:2], False)[0]
    total, near = likelihood(s, 20, table, 0, F(13.28), True)
    assert near == 0
    assert 0 <= total < 1e-36
