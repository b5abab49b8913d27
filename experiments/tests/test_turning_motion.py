"""Turning targets: circles, the straight limit, Jacobians against differences, draws against what
`transition` states.
"""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.bearing import SMALL, TurningMotion, slopes, turned
from phdtrack.models import PlaneMotion


def states(rng: np.random.Generator, n: int) -> np.ndarray:
    return np.vstack(
        [rng.uniform(-500, 500, (2, n)), rng.normal(0, 20, (2, n)), rng.normal(0, 0.2, (1, n))]
    )


def test_targets_go_round_their_circle(rng):
    """Speed and distance from the centre, v/ω to the left, stay; a whole turn leads back."""
    x = states(rng, 30)
    after = turned(x, 3.0)
    np.testing.assert_allclose(np.hypot(*after[2:4]), np.hypot(*x[2:4]))
    centre = [place[:2] + np.stack([-place[3], place[2]]) / place[4] for place in (x, after)]
    np.testing.assert_allclose(centre[1], centre[0])
    for one in x.T:
        np.testing.assert_allclose(
            turned(one[:, None], 2 * math.pi / one[4])[:, 0], one, rtol=1e-9, atol=1e-9
        )


@settings(max_examples=50, deadline=None)
@given(st.floats(-3, 3), st.floats(0.1, 5), st.floats(0.1, 5))
def test_two_intervals_are_one(turn: float, one: float, other: float):
    x = np.array([[1.0], [2.0], [3.0], [-4.0], [turn]])
    np.testing.assert_allclose(
        turned(turned(x, one), other), turned(x, one + other), rtol=1e-9, atol=1e-9
    )


def test_without_a_turn_it_is_constant_velocity(rng):
    """At ω = 0 exactly, and continuously on the way there: the bend shrinks with ω."""
    x = states(rng, 20)
    x[4] = 0
    straight, plane, noise = PlaneMotion(acceleration=5.0).transition(x[:4], 2.0)
    mean, jacobian, cov = TurningMotion(acceleration=5.0).transition(x, 2.0)
    np.testing.assert_allclose(mean[:4], straight, rtol=1e-15)
    np.testing.assert_array_equal(jacobian[:, :4, :4], plane)
    np.testing.assert_array_equal(cov[:, :4, :4], noise)
    for turn in (1e-3, 1e-6, 1e-9, 1e-300):
        x[4] = turn
        bend = np.abs(turned(x, 2.0)[:4] - straight)
        assert (bend <= 1.01 * turn * 2.0**2 * np.hypot(*x[2:4]) + 1e-12).all()


def test_jacobians_are_derivatives(rng):
    """Central differences; turns on both sides of where the series begins, and none."""
    x = states(rng, 60)
    x[4, :20] = np.linspace(-2 * SMALL, 2 * SMALL, 20)
    x[4, 20] = 0
    for dt in (0.3, 1.0, 4.0):
        jacobian = slopes(x, dt)
        for row, step in enumerate((1e-3, 1e-3, 1e-3, 1e-3, 1e-5)):
            ahead = x.copy()
            behind = x.copy()
            ahead[row] += step
            behind[row] -= step
            slope = (turned(ahead, dt) - turned(behind, dt)) / (2 * step)
            np.testing.assert_allclose(slope.T, jacobian[:, :, row], atol=2e-6)
