"""What every motion must do."""

from __future__ import annotations

import numpy as np
import pytest
from shipped import MOTIONS, fixed, keeps, states

from composed import drawn
from phdtrack.errors import InputError
from phdtrack.filters import ParticlePHD
from phdtrack.protocols import Model, Motion
from phdtrack.types import Particles

pytestmark = pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
INTERVALS = (0.3, 1.0, 25 / 7)


def test_signatures(motion):
    keeps(Motion, motion)
    assert isinstance(motion.dim, int)


def test_draws_are_states_and_repeat(motion, rng):
    x = fixed(states(rng, 50, motion.dim))
    for dt in INTERVALS:
        a, b = (drawn(motion, x, dt, np.random.default_rng(1)) for _ in range(2))
        assert a.shape == x.shape
        assert np.isfinite(a).all()
        assert a.flags.c_contiguous
        np.testing.assert_array_equal(a, b)


def test_transition_is_that_of_the_draws(motion, rng):
    """Mean and covariance of 20 000 draws from one state, within five standard errors; boxes have
    single precision.
    """
    one = states(rng, 1, motion.dim)
    many = np.repeat(one, 20000, axis=1)
    for dt in INTERVALS:
        mean, jacobian, noise = motion.transition(one, dt)
        assert mean.shape == one.shape
        assert jacobian.shape == noise.shape == (1, motion.dim, motion.dim)
        found = drawn(motion, many, dt, rng)
        scale = np.sqrt(np.diag(noise[0]))
        assert (
            np.abs(found.mean(1) - mean[:, 0])
            <= 5 * scale / np.sqrt(20000) + 1e-6 * np.abs(mean).max()
        ).all()
        error = np.abs(np.cov(found) - noise[0])
        assert (error <= 0.05 * np.outer(scale, scale) + 1e-9).all()


def test_noise_is_a_covariance_and_the_jacobian_a_derivative(motion, rng):
    x = states(rng, 10, motion.dim)
    for dt in INTERVALS:
        _, jacobian, noise = motion.transition(fixed(x), dt)
        np.testing.assert_allclose(noise, noise.transpose(0, 2, 1))
        assert np.linalg.eigvalsh(noise).min() > -1e-9
        for row in range(motion.dim):
            ahead = x.copy()
            behind = x.copy()
            ahead[row] += 1e-4
            behind[row] -= 1e-4
            slope = (motion.transition(ahead, dt)[0] - motion.transition(behind, dt)[0]) / 2e-4
            np.testing.assert_allclose(slope.T, jacobian[:, :, row], atol=1e-6)


def test_survival_is_a_probability_that_falls_with_time(motion, rng):
    """Also as the particle filters weigh particles; half of these left what is watched."""
    x = states(rng, 40, motion.dim)
    x[0, ::2] = -1e4
    fixed(x)
    shares = [motion.p_survive(x, dt) for dt in INTERVALS]
    for dt, share in zip(INTERVALS, shares, strict=True):
        assert share.shape == (40,)
        assert ((share >= 0) & (share <= 1)).all()
        particles = Particles(x, np.ones(40), np.array([0, 40]))
        moved = ParticlePHD().predict(particles, Model(motion, None, None, None, rate=1.0), dt, rng)
        np.testing.assert_allclose(moved.weight, share, rtol=1e-6)
    assert (np.diff(shares, axis=0) <= 0).all()


def test_nobody_moves_to_nowhere(motion, rng):
    x = np.zeros((motion.dim, 0))
    assert drawn(motion, x, 1.0, rng).shape == x.shape
    assert motion.p_survive(x, 1.0).shape == (0,)
    mean, jacobian, noise = motion.transition(x, 1.0)
    assert mean.shape == x.shape
    assert jacobian.shape == noise.shape == (0, motion.dim, motion.dim)


@pytest.mark.parametrize("count", [0, 12])
def test_a_camera_that_moves_carries_states_or_is_refused(motion, count: int, rng):
    """Of boxes and points; on the ground it means nothing."""
    x = fixed(states(rng, count, motion.dim))
    warp = fixed(np.array([[1.1, 0.02, 9.0], [-0.02, 1.1, 4.0], [0.0, 0.0, 1.0]]))
    if motion.dim == 5 or type(motion).__name__ == "PlaneMotion":
        with pytest.raises(InputError, match=r"^camera motion: .* does not lie in the image"):
            motion.warp_states(x, warp)
        with pytest.raises(InputError, match=r"^camera motion: .* does not lie in the image"):
            motion.warp_jacobian(x, warp)
        return
    moved = motion.warp_states(x, warp)
    slope = motion.warp_jacobian(x, warp)
    assert moved.shape == x.shape
    assert slope.shape == (count, motion.dim, motion.dim)
    np.testing.assert_allclose(moved[:2], warp[:2, :2] @ x[:2] + warp[:2, 2:])
    # The map is affine: it is its slope, but for the shift.
    np.testing.assert_allclose(np.einsum("nrs,sn->rn", slope, x)[2:], moved[2:])
    np.testing.assert_array_equal(motion.warp_states(x, np.eye(3)), x)
