"""One target that is always seen, no clutter, no births: the PHD filter is then the Bayes filter,
here the Kalman filter.

The particles must come to it as one over the root of their number.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from phd_cases import NoBirth

from composed import drawn
from phdtrack.filters import ParticlePHD
from phdtrack.models import BoxMotion, BoxSensor, UniformClutter
from phdtrack.protocols import Model
from phdtrack.types import GaussianMixture
from reference import gm_twin as twin

STEPS = 20
ROWS = [0, 1, 4, 5]
MEAN = np.array([320.0, 240, 2, -1, 60, 110])
COV = np.diag([3.0, 3, 20, 20, 6, 6])
# M09's fixed variances.
MODEL = Model(
    BoxMotion(1.5**0.5, 2.0, survival_probability=1.0, scaled_noise=False),
    BoxSensor(detection_probability=1.0, scaling="fixed", gate_probability=1.0),
    NoBirth(),
    UniformClutter(1e-9, (640.0 * 480.0) ** 2),
)


@lru_cache(maxsize=1)
def measurements() -> np.ndarray:
    """(STEPS, 4) of one target that moves by the model."""
    rng = np.random.default_rng(42)
    x = rng.multivariate_normal(MEAN, COV)[:, None]
    out = []
    for _ in range(STEPS):
        x = drawn(MODEL.motion, x, 1.0, rng)
        out.append(x[ROWS, 0] + rng.normal(0, np.sqrt([3.0, 3, 6, 6])))
    return np.array(out)


@lru_cache(maxsize=1)
def exact() -> tuple[np.ndarray, np.ndarray]:
    _, (f,), (q,) = MODEL.motion.transition(MEAN[:, None], 1.0)
    return twin.kalman(MEAN, COV, measurements(), f, q, np.eye(6)[ROWS], np.diag([3.0, 3, 6, 6]))


def run(count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Means (STEPS, 6), covariances (STEPS, 6, 6) and masses (STEPS,) after each update, with
    ``count`` particles.
    """
    rng = np.random.default_rng(seed)
    recursion = ParticlePHD(count, initial=GaussianMixture(np.ones(1), MEAN[:, None], COV[None]))
    state = recursion.start(MODEL, rng)
    means = []
    covs = []
    masses = []
    for z in measurements():
        state = recursion.predict(state, MODEL, 1.0, rng)
        state, _ = recursion.update(state, z[:, None], MODEL, 1.0, rng)
        means.append(np.average(state.state, axis=1, weights=state.weight))
        covs.append(np.cov(state.state, aweights=state.weight, ddof=0))
        masses.append(state.mass)
        state = recursion.reduce(state, rng)
    return np.array(means), np.array(covs), np.array(masses)


def test_posterior_is_the_kalman_filters():
    """Mean and covariance of the 20 posteriors, averaged over 16 runs, within their Monte Carlo
    error.
    """
    means, covs, masses = (
        np.array(part) for part in zip(*(run(8000, seed) for seed in range(16)), strict=True)
    )
    mean, cov = exact()
    np.testing.assert_allclose(masses, 1.0, atol=1e-6)
    deviation = np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
    # Sixteen runs know their own deviation poorly: a floor of a thousandth of the posterior's, and
    # five deviations.
    error = means.std(0, ddof=1) / 4 + 1e-3 * deviation
    assert np.abs((means.mean(0) - mean) / error).max() <= 5
    scale = deviation[:, :, None] * deviation[:, None, :]
    error = covs.std(0, ddof=1) / 4 + 2e-3 * scale
    assert np.abs((covs.mean(0) - cov) / error).max() <= 5


def test_the_error_falls_as_one_over_the_root_of_the_particles():
    """Slope of log error over log N, N from 250 to 16 000, 12 runs each: −0.5 within 0.06."""
    counts = np.array([250, 500, 1000, 2000, 4000, 8000, 16_000])
    mean, cov = exact()
    deviation = np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
    errors = [
        np.sqrt(np.mean([((run(n, 100 + s)[0] - mean) / deviation) ** 2 for s in range(12)]))
        for n in counts
    ]
    slope, _ = np.polyfit(np.log(counts), np.log(errors), 1)
    assert slope == pytest.approx(-0.5, abs=0.06)
    # In deviations of the posterior; what independent draws from it would give is 0.008.
    assert errors[-1] < 0.08
