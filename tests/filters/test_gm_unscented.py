"""The unscented form of the GM-PHD filter: the linear one where the model is linear, and better where it is not."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from phd_cases import FRAME, NoBirth

from composed import composed_step
from phdtrack.errors import InputError
from phdtrack.filters import GMPHD
from phdtrack.models import BoxMotion, BoxSensor, LocalClutter, MeasurementBirth, UniformClutter
from phdtrack.models.gaussian import sigma_points
from phdtrack.protocols import Model
from phdtrack.types import GaussianMixture


def mixture(rng: np.random.Generator, n: int, d: int = 6) -> GaussianMixture:
    mean = rng.uniform([50, 50, -3, -3, 20, 40], [590, 400, 3, 3, 60, 120], (n, 6)).T[:d]
    root = rng.normal(0, 1.5, (n, d, d))
    return GaussianMixture(rng.uniform(0.1, 1.2, n), mean, root @ root.transpose(0, 2, 1) + np.eye(d))


def scaled_transform(points: np.ndarray, through: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance by the weights as they are printed, of points (d, 2d + 1) that became ``through``."""
    d, (alpha2, beta) = len(points), (2 / 3, 2 / 3)
    c = alpha2 * 3
    weight = np.full(2 * d + 1, 0.5 / c)
    weight[0] = 1 - d / c
    mean = through @ weight
    weight[0] += 1 - alpha2 + beta
    step = through - mean[:, None]
    return mean, (weight * step) @ step.T


def test_the_sums_are_the_scaled_transform(rng):
    """Through a motion that bends: the short sums and the printed weights."""
    wide = replace(START, covariance=START.covariance + mixture(rng, 1, 5).covariance)
    points = sigma_points(wide.mean, wide.covariance)[..., 0]
    mean, cov = scaled_transform(points, MODEL.motion.through(points, 1.5))
    found = GMPHD(transform="unscented").predict(wide, MODEL, 1.5, rng)
    np.testing.assert_allclose(found.mean[:, 0], mean, rtol=1e-9)
    np.testing.assert_allclose(found.covariance[0], cov + 0.01 * np.eye(5), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("scaling", ["particle", "detection", "fixed", "previous"])
def test_it_is_the_linear_one_where_the_model_is_linear(scaling: str, rng):
    """Along a run, every Gaussian to 1e-9; and its step is the composition, though the model is the shipped one."""
    sensor = BoxSensor(detection_probability=0.9, scaling=scaling)
    motion = BoxMotion(frame_size=FRAME, remember_size=scaling == "previous")
    model = Model(motion, sensor, MeasurementBirth(volume="local"), LocalClutter(0.5))
    linear, unscented = GMPHD(), GMPHD(transform="unscented")
    state = linear.start(model, rng)
    at = mixture(rng, 4).mean
    for k in range(8):
        seen = at[[0, 1, 4, 5]] + k * np.vstack([at[2:4], 0 * at[2:4]]) + rng.normal(0, 1, (4, 4))
        z = np.hstack([seen[:, : 3 if k % 3 else 4], rng.uniform([0, 0, 20, 40], [*FRAME, 60, 120], (2, 4)).T])
        one, expected = composed_step(linear, state, z, model, 1.0 + k % 2, rng)
        other, info = unscented.step(state, z, model, 1.0 + k % 2, rng)
        np.testing.assert_allclose(info.evidence, expected.evidence, rtol=1e-9, atol=1e-300)
        # Rounding orders Gaussians of equal weight; their tags stay.
        a, b = np.argsort(one.tag), np.argsort(other.tag)
        np.testing.assert_array_equal(other.tag[b], one.tag[a])
        np.testing.assert_allclose(other.weight[b], one.weight[a], rtol=1e-9)
        np.testing.assert_allclose(other.mean[:, b], one.mean[:, a], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(other.covariance[b], one.covariance[a], rtol=1e-9, atol=1e-9)
        state = one
    assert len(state) > 4


@dataclass(frozen=True)
class Turning:
    """State (px, py, vx, vy, turn): at constant speed and turn rate, noise on every component."""

    dim: int = 5

    def through(self, x, dt):
        angle = x[4] * dt
        out = x.copy()
        out[2] = np.cos(angle) * x[2] - np.sin(angle) * x[3]
        out[3] = np.sin(angle) * x[2] + np.cos(angle) * x[3]
        out[:2] += dt * 0.5 * (x[2:4] + out[2:4])
        return out

    def p_survive(self, x, dt):
        return np.ones(x.shape[1])

    def transition(self, x, dt):
        h, n = 1e-6, x.shape[1]
        f = np.stack(
            [(self.through(x + h * e[:, None], dt) - self.through(x - h * e[:, None], dt)) / (2 * h) for e in np.eye(5)]
        )
        return self.through(x, dt), f.transpose(2, 1, 0), np.tile(0.01 * np.eye(5), (n, 1, 1))

    def spawn(self, parents, dt, rng):
        return BoxMotion().spawn(parents, dt, rng)


@dataclass(frozen=True)
class Distant:
    """Shows the position and the distance from a point: z = (px, py, r)."""

    observed: tuple[int, ...] = (0, 1)
    linear: bool = False

    def expected(self, x):
        return np.vstack([x[:2], np.hypot(x[0] - 40.0, x[1])])

    angles: tuple[bool, ...] = (False, False, False)

    def innovation(self, z, seen):
        return z[:3] - seen

    def target_noise(self, x):
        return self.covariance(x, x)

    def measurement_noise(self, z):
        return np.zeros((0, 3, 3))

    def covariance(self, z, x):
        return np.tile(np.diag([4.0, 4.0, 0.01]), (z.shape[1], 1, 1))

    def p_detect(self, x):
        return np.ones(x.shape[1])

    def states(self, z):
        return np.vstack([z[:2], np.zeros((3, z.shape[1]))]), np.tile(4.0 * np.eye(5), (z.shape[1], 1, 1))

    def noise(self, x):
        return np.full((5, x.shape[1]), 2.0)


START = GaussianMixture(np.ones(1), np.array([[0.0, 0, 10, 0, 0.0]]).T, np.diag([1.0, 1, 1, 1, 0.4**2])[None])
MODEL = Model(Turning(), Distant(), NoBirth(), UniformClutter(0.0, 1.0))


def drawn(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.multivariate_normal(START.mean[:, 0], START.covariance[0], count).T


def test_a_bent_prediction_has_the_moments_of_draws(rng):
    """Of 400 000 draws through f; the linear one does not see that a turn shortens the way."""
    x = MODEL.motion.through(drawn(rng, 400_000), 1.0)
    truth, spread = x.mean(axis=1), np.cov(x) + 0.01 * np.eye(5)
    errors = {}
    for transform in ("linear", "unscented"):
        found = GMPHD(transform=transform).predict(START, MODEL, 1.0, rng)
        errors[transform] = (
            np.abs(found.mean[:, 0] - truth).max(),
            np.abs(found.covariance[0] - spread).max() / spread.max(),
        )
    assert errors["unscented"][0] < 0.1 < errors["linear"][0] / 5
    assert errors["unscented"][1] < 0.35 * errors["linear"][1]


def test_the_linear_transform_refuses_what_is_not_linear(rng):
    z = MODEL.sensor.expected(START.mean)
    with pytest.raises(InputError, match="unscented"):
        GMPHD().update(START, z, MODEL, 1.0, rng)
