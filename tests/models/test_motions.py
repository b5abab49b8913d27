"""Every motion's noise is the printed one, and intervals add up; survival; the sizes of boxes."""

from __future__ import annotations

import numpy as np
import pytest

from composed import drawn
from experiments.bearing import TurningMotion
from phdtrack.errors import InputError
from phdtrack.models import BoxMotion, PlaneMotion, PointMotion

BOX = np.array([[320.0], [240.0], [3.0], [-2.0], [60.0], [150.0]])
POINT = np.array([[3.0], [20.0], [1.2], [-0.4]])
TURNING = np.array([[3.0], [20.0], [12.0], [-4.0], [0.05]])


def along_axes(dt: float, scale: np.ndarray) -> np.ndarray:
    """(4, 4) G Gᵀ with G = [T²/2; T] on each axis, times ``scale`` (2,)."""
    g = np.vstack([dt**2 / 2 * np.diag(scale), dt * np.diag(scale)])
    return g @ g.T


def block(*parts: np.ndarray) -> np.ndarray:
    """The block-diagonal matrix of a (4, 4) matrix and of variances."""
    out = np.zeros((4 + len(parts[1]),) * 2)
    out[:4, :4] = parts[0]
    np.fill_diagonal(out[4:, 4:], parts[1])
    return out


@pytest.mark.parametrize(
    ("motion", "x", "dt", "wanted"),
    [
        # Times the target's own width and height [M09 (11)].
        (
            BoxMotion(0.03, 0.1),
            BOX,
            1.0,
            block(along_axes(1.0, 0.03 * BOX[4:, 0]), np.square(0.1 * BOX[4:, 0])),
        ),
        # [E13 §4], and the standard scenario's at T = 1.
        (
            PlaneMotion(acceleration=5.0, form="piecewise"),
            POINT,
            1 / 7,
            along_axes(1 / 7, np.full(2, 5.0)),
        ),
        (
            PlaneMotion(acceleration=5.0, form="piecewise"),
            POINT,
            1.0,
            along_axes(1.0, np.full(2, 5.0)),
        ),
        # [V06 §IV-C].
        (
            TurningMotion(acceleration=15.0, turning=0.02, form="piecewise"),
            TURNING,
            1.0,
            block(along_axes(1.0, np.full(2, 15.0)), np.array([0.02**2])),
        ),
        # Variance 2 on every component [D14].
        (PointMotion(), POINT, 1.0, 2 * np.eye(4)),
    ],
    ids=["box", "plane", "plane, one second", "turning", "point"],
)
def test_one_step_has_the_printed_noise(motion, x, dt, wanted):
    _, (f,), (q,) = motion.transition(x, dt)
    np.testing.assert_allclose(q, wanted, rtol=1e-12, atol=1e-12)
    if motion.dim == 4:
        np.testing.assert_array_equal(f, np.eye(4) + dt * np.eye(4, k=2))


@pytest.mark.parametrize(
    ("motion", "x", "parts"),
    [
        (BoxMotion(1.5, 2.0, scaled_noise=False), BOX, (1.0, 1.0, 1.0)),
        (PlaneMotion(), POINT, (0.2, 0.2, 0.2)),
        (PointMotion(noise_variance=1.7), POINT, (0.3, 0.7)),
        (PointMotion(noise_variance=1.7), POINT, (2.5, 0.1, 1.4)),
    ],
)
def test_intervals_compose(motion, x, parts: tuple[float, ...]):
    now = x
    slope = np.eye(motion.dim)
    cov = np.zeros((motion.dim, motion.dim))
    for dt in parts:
        now, (f,), (q,) = motion.transition(now, dt)
        slope = f @ slope
        cov = f @ cov @ f.T + q
    mean, (jacobian,), (noise,) = motion.transition(x, sum(parts))
    np.testing.assert_allclose(mean, now, rtol=1e-12)
    np.testing.assert_allclose(jacobian, slope, rtol=1e-12)
    np.testing.assert_allclose(noise, cov, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("kind", [PlaneMotion, TurningMotion])
def test_survival_is_a_power_inside_and_zero_outside(kind):
    motion = kind(survival_probability=0.9, borders=(-5.0, 0.0, 5.0, 10.0))
    x = np.zeros((motion.dim, 4))
    x[:2] = [[-5.0, 5.1, 0, 0], [0.0, 3, 10.1, 10]]
    np.testing.assert_allclose(motion.p_survive(x, 1.5), [0.9**1.5, 0, 0, 0.9**1.5])
    with pytest.raises(InputError, match="left, low"):
        kind(borders=(1.0, 0, 0, 2))


def test_boxes_survive_as_long_as_they_touch_the_frame():
    motion = BoxMotion(survival_probability=0.9, frame_size=(640.0, 480.0))
    inside = np.array([[320.0, -9, 649, 320, 320], [240.0, 240, 240, -19, 499]])
    outside = np.array([[-10.0, 650, 320, 320, -1e9], [240.0, 240, -20, 500, -1e9]])
    x = np.zeros((6, 10))
    x[:2] = np.hstack([inside, outside])
    x[4] = 20
    x[5] = 40
    np.testing.assert_allclose(motion.p_survive(x, 3.0), [0.9**3] * 5 + [0.0] * 5)
    np.testing.assert_allclose(BoxMotion(survival_probability=0.9).p_survive(x, 0.5), 0.9**0.5)


def test_sizes_stay_positive(rng):
    motion = BoxMotion(0.03, 1.0, min_size=1.0)
    x = np.repeat(BOX, 20_000, axis=1)
    for _ in range(20):
        x = drawn(motion, x, 2.0, rng)
        assert x[4:6].min() >= 1.0
    x[4:6] = 0.0
    assert drawn(motion, x, 1.0, rng)[4:6].min() >= 1.0
