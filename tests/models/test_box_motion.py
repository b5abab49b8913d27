"""The motion of boxes: its draws have the moments that `transition` states, and those are the paper's."""

from __future__ import annotations

import math

import numpy as np
import pytest

from phdtrack.errors import InputError
from phdtrack.models import BoxMotion, SplitSpawn
from phdtrack.types import Particles

START = np.array([320.0, 240.0, 3.0, -2.0, 60.0, 150.0])
INTERVALS = [0.5, 1.0, 2.0, 3.57]


def start(motion: BoxMotion, count: int) -> np.ndarray:
    x = START if motion.dim == 6 else np.append(START, [50.0, 140.0])
    return np.repeat(x[:, None], count, axis=1)


@pytest.mark.parametrize("dt", INTERVALS)
@pytest.mark.parametrize("scaled", [True, False])
def test_draws_have_the_moments_of_the_transition(dt: float, scaled: bool, rng):
    """Means and covariances within four standard errors; sizes far from where they are reflected."""
    n = 40_000
    motion = BoxMotion(0.03, 0.02, scaled_noise=scaled) if scaled else BoxMotion(1.2, 2.0, scaled_noise=False)
    mean, _, cov = (part[0] if part.ndim == 3 else part[:, 0] for part in motion.transition(start(motion, 1), dt))
    x = motion.sample(start(motion, n), dt, rng)
    spread = np.sqrt(np.diag(cov))
    assert np.all(np.abs(x.mean(1) - mean) <= 4 * spread / math.sqrt(n))
    # The standard error of a covariance c_ij is sqrt((c_ii c_jj + c_ij²) / n).
    error = np.sqrt((np.outer(spread, spread) ** 2 + cov**2) / n)
    assert np.all(np.abs(np.cov(x) - cov) <= 4.5 * error)


def test_one_step_is_the_printed_one():
    """G Gᵀ with G = [T²/2, T] times the target's own width and height [M09 (11)]."""
    _, _, (cov,) = BoxMotion(0.03, 0.1).transition(START[:, None], 1.0)
    g = np.zeros((6, 4))
    w, h = START[4:]
    g[0, 0], g[2, 0] = 0.03 * w / 2, 0.03 * w
    g[1, 1], g[3, 1] = 0.03 * h / 2, 0.03 * h
    g[4, 2], g[5, 3] = 0.1 * w, 0.1 * h
    np.testing.assert_allclose(cov, g @ g.T, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("steps", [2, 3, 7])
def test_whole_steps_compose(steps: int):
    motion = BoxMotion(1.5, 2.0, scaled_noise=False)
    x, cov = START[:, None], np.zeros((6, 6))
    for _ in range(steps):
        x, (f,), (q,) = motion.transition(x, 1.0)
        cov = f @ cov @ f.T + q
    mean, (jacobian,), (noise,) = motion.transition(START[:, None], float(steps))
    np.testing.assert_allclose(mean, x, rtol=1e-12)
    np.testing.assert_allclose(jacobian, np.linalg.matrix_power(f, steps), rtol=1e-12)
    np.testing.assert_allclose(noise, cov, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("dt", [1e-3, 0.1, 0.5, 0.999, 1.0, 1.5, 10.0, 100.0])
def test_covariances_are_positive_semidefinite(dt: float):
    _, _, (cov,) = BoxMotion().transition(START[:, None], dt)
    np.testing.assert_array_equal(cov, cov.T)
    assert np.linalg.eigvalsh(cov).min() >= -1e-9 * np.trace(cov)


def test_sizes_stay_positive(rng):
    motion = BoxMotion(0.03, 1.0, min_size=1.0)
    x = start(motion, 20_000)
    for _ in range(20):
        x = motion.sample(x, 2.0, rng)
        assert x[4:6].min() >= 1.0
    x[4:6] = 0.0
    assert motion.sample(x, 1.0, rng)[4:6].min() >= 1.0


def test_the_noise_follows_the_own_size(rng):
    n = 20_000
    x = np.repeat(np.array([[0.0, 0, 0, 0, 20, 20], [0, 0, 0, 0, 80, 80]]).T, n, axis=1)
    moved = BoxMotion(0.03, 0.05).sample(x, 1.0, rng)
    ratio = moved[[2, 3], n:].std(1) / moved[[2, 3], :n].std(1)
    np.testing.assert_allclose(ratio, 4.0, rtol=0.05)


def test_remembered_sizes_are_those_before_the_step(rng):
    motion = BoxMotion(remember_size=True)
    assert motion.dim == 8
    x = start(motion, 50)
    moved = motion.sample(x, 2.0, rng)
    np.testing.assert_array_equal(moved[6:8], x[4:6])
    mean, (jacobian,), (noise,) = motion.transition(x[:, :1], 2.0)
    np.testing.assert_array_equal(mean[6:8, 0], START[4:6])
    np.testing.assert_allclose(jacobian @ x[:, 0], mean[:, 0])
    assert not noise[6:].any()


def test_survival_is_a_power_of_the_interval_inside_and_zero_outside():
    motion = BoxMotion(survival_probability=0.9, frame_size=(640.0, 480.0))
    inside = np.array([[320.0, -9, 649, 320, 320], [240.0, 240, 240, -19, 499]])
    outside = np.array([[-10.0, 650, 320, 320, -1e9], [240.0, 240, -20, 500, -1e9]])
    x = np.zeros((6, 10))
    x[:2], x[4], x[5] = np.hstack([inside, outside]), 20, 40
    np.testing.assert_allclose(motion.p_survive(x, 3.0), [0.9**3] * 5 + [0.0] * 5)
    np.testing.assert_allclose(BoxMotion(survival_probability=0.9).p_survive(x, 0.5), 0.9**0.5)


def test_inputs_are_left_alone(rng):
    motion = BoxMotion(remember_size=True, frame_size=(640.0, 480.0), births=SplitSpawn())
    x, weight = start(motion, 30), np.full(30, 0.1)
    x.flags.writeable = weight.flags.writeable = False
    motion.sample(x, 2.0, rng)
    motion.transition(x, 2.0)
    motion.p_survive(x, 2.0)
    motion.spawn(Particles(x, weight), 1.0, rng)


@pytest.mark.parametrize(
    "wrong", [{"survival_probability": 1.5}, {"acceleration": -1.0}, {"min_size": 0.0}, {"size_noise": math.nan}]
)
def test_settings_out_of_bounds(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        BoxMotion(**wrong)
