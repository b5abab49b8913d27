"""The motion on the ground: its draws have the moments that `transition` states, and those are the paper's."""

from __future__ import annotations

import math

import numpy as np
import pytest

from phdtrack.errors import InputError
from phdtrack.models import PlaneMotion

START = np.array([[3.0], [20.0], [1.2], [-0.4]])


@pytest.mark.parametrize("dt", [0.05, 1 / 7, 0.4, 2.0])
@pytest.mark.parametrize("form", ["piecewise", "continuous"])
def test_draws_have_the_moments_of_the_transition(form: str, dt: float, rng):
    """Means and covariances within four and a half standard errors."""
    n = 40_000
    motion = PlaneMotion(acceleration=1.3, form=form)
    mean, _, (cov,) = motion.transition(START, dt)
    x = motion.sample(np.repeat(START, n, axis=1), dt, rng)
    spread = np.sqrt(np.diag(cov))
    assert np.all(np.abs(x.mean(1) - mean[:, 0]) <= 4.5 * spread / math.sqrt(n))
    error = np.sqrt((np.outer(spread, spread) ** 2 + cov**2) / n)
    assert np.all(np.abs(np.cov(x) - cov) <= 4.5 * error + 1e-12)


@pytest.mark.parametrize("interval", [1 / 7, 1.0])
def test_the_piecewise_noise_is_the_printed_one(interval: float):
    """Q = a² G Gᵀ, G = [T²/2; T] on each axis [E13 §4], and the standard scenario's at T = 1."""
    motion = PlaneMotion(acceleration=5.0, form="piecewise")
    _, (f,), (q,) = motion.transition(START, interval)
    g = np.vstack([interval**2 / 2 * np.eye(2), interval * np.eye(2)])
    np.testing.assert_allclose(q, 25 * g @ g.T, atol=1e-15)
    np.testing.assert_array_equal(f, np.eye(4) + interval * np.eye(4, k=2))


@pytest.mark.parametrize("steps", [2, 3, 7])
def test_whole_steps_compose(steps: int):
    motion = PlaneMotion()
    x, cov = START, np.zeros((4, 4))
    for _ in range(steps):
        x, (f,), (q,) = motion.transition(x, 0.2)
        cov = f @ cov @ f.T + q
    mean, _, (noise,) = motion.transition(START, 0.2 * steps)
    np.testing.assert_allclose(mean, x)
    np.testing.assert_allclose(noise, cov, atol=1e-15)


@pytest.mark.parametrize("form", ["piecewise", "continuous"])
@pytest.mark.parametrize("dt", [1e-3, 0.1, 1 / 7, 0.15, 1.0, 30.0])
def test_covariances_are_positive_semidefinite(form: str, dt: float):
    _, _, (cov,) = PlaneMotion(form=form).transition(START, dt)
    assert np.linalg.eigvalsh(cov).min() >= -1e-9 * np.trace(cov)


def test_survival_is_a_power_of_the_interval_inside_and_zero_outside():
    motion = PlaneMotion(survival_probability=0.9, borders=(-5.0, 0.0, 5.0, 10.0))
    x = np.zeros((4, 4))
    x[:2] = [[-5.0, 5.1, 0, 0], [0.0, 3, 10.1, 10]]
    np.testing.assert_allclose(motion.p_survive(x, 1.5), [0.9**1.5, 0, 0, 0.9**1.5])


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"survival_probability": 1.5}, "survival"),
        ({"acceleration": -1.0}, "acceleration"),
        ({"borders": (1.0, 0, 0, 2)}, "left, low"),
    ],
)
def test_settings_out_of_bounds(wrong, says: str):
    with pytest.raises(InputError, match=says):
        PlaneMotion(**wrong)
