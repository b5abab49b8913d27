"""The unscented form of the GM-PHD filter: the linear one where the model is linear, and better
where it is not.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from phd_cases import FRAME, NoBirth

from composed import composed_step
from experiments.bearing import BearingSensor, TurningMotion
from phdtrack.errors import InputError
from phdtrack.filters import GMPHD
from phdtrack.models import BoxClutter, BoxMotion, BoxSensor, MeasurementBirth, UniformClutter
from phdtrack.models.gaussian import sigma_points
from phdtrack.protocols import Model
from phdtrack.types import GaussianMixture

START = GaussianMixture(
    np.ones(1), np.array([[0.0, 0, 10, 0, 0.0]]).T, np.diag([1.0, 1, 1, 1, 0.4**2])[None]
)
TURNING = Model(TurningMotion(0.1, 0.1), BearingSensor(), NoBirth(), UniformClutter(0.0, 1.0))


def mixture(rng: np.random.Generator, n: int, d: int = 6) -> GaussianMixture:
    mean = rng.uniform([50, 50, -3, -3, 20, 40], [590, 400, 3, 3, 60, 120], (n, 6)).T[:d]
    root = rng.normal(0, 1.5, (n, d, d))
    return GaussianMixture(
        rng.uniform(0.1, 1.2, n), mean, root @ root.transpose(0, 2, 1) + np.eye(d)
    )


def scaled_transform(points: np.ndarray, through: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance by the weights as they are printed, of points (d, 2d + 1) that became
    ``through``.
    """
    d = len(points)
    alpha2 = 2 / 3
    beta = 2 / 3
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
    moved, _, q = TURNING.motion.transition(points, 1.5)
    mean, cov = scaled_transform(points, moved)
    found = GMPHD(transform="unscented").predict(wide, TURNING, 1.5, rng)
    np.testing.assert_allclose(found.mean[:, 0], mean, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.covariance[0], cov + q[0], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("scaling", ["particle", "detection", "fixed"])
def test_it_is_the_linear_one_where_the_model_is_linear(scaling: str, rng):
    """Along a run, every Gaussian to 1e-9; and its step is the composition, though the model is the
    shipped one.
    """
    sensor = BoxSensor(detection_probability=0.9, scaling=scaling)
    model = Model(
        BoxMotion(frame_size=FRAME),
        sensor,
        MeasurementBirth(births_per_detection=0.25),
        BoxClutter(0.5),
    )
    linear = GMPHD()
    unscented = GMPHD(transform="unscented")
    state = linear.start(model, rng)
    at = mixture(rng, 4).mean
    for k in range(8):
        seen = at[[0, 1, 4, 5]] + k * np.vstack([at[2:4], 0 * at[2:4]]) + rng.normal(0, 1, (4, 4))
        z = np.hstack(
            [seen[:, : 3 if k % 3 else 4], rng.uniform([0, 0, 20, 40], [*FRAME, 60, 120], (2, 4)).T]
        )
        one, expected = composed_step(linear, state, z, model, 1.0 + k % 2, rng)
        other, info = unscented.step(state, z, model, 1.0 + k % 2, rng)
        np.testing.assert_allclose(info.evidence, expected.evidence, rtol=1e-9, atol=1e-300)
        # Rounding orders Gaussians of equal weight.
        a, b = (np.lexsort(mixture.mean.round(5)) for mixture in (one, other))
        np.testing.assert_allclose(other.weight[b], one.weight[a], rtol=1e-9)
        np.testing.assert_allclose(other.mean[:, b], one.mean[:, a], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(other.covariance[b], one.covariance[a], rtol=1e-9, atol=1e-9)
        state = one
    assert len(state) > 4


def test_a_bent_prediction_has_the_moments_of_draws(rng):
    """Of 400 000 draws through f; the linear one does not see that a turn shortens the way."""
    x, _, q = TURNING.motion.transition(
        rng.multivariate_normal(START.mean[:, 0], START.covariance[0], 400_000).T, 1.0
    )
    truth = x.mean(axis=1)
    spread = np.cov(x) + q[0]
    errors = {}
    for transform in ("linear", "unscented"):
        found = GMPHD(transform=transform).predict(START, TURNING, 1.0, rng)
        errors[transform] = (
            np.abs(found.mean[:, 0] - truth).max(),
            np.abs(found.covariance[0] - spread).max() / spread.max(),
        )
    assert errors["unscented"][0] < 0.1 < errors["linear"][0] / 5
    assert errors["unscented"][1] < 0.35 * errors["linear"][1]


def test_the_linear_transform_refuses_what_is_not_linear(rng):
    z = TURNING.sensor.predicted_measurements(START.mean)
    with pytest.raises(InputError, match="unscented"):
        GMPHD().update(START, z, TURNING, 1.0, rng)
