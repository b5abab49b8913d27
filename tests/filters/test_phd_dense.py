"""The gated filter against the ungated one, written as two loops: what the gate drops is bounded."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from phd_cases import crowd, seen_by, world
from scipy.stats import multivariate_normal

from phdtrack.filters import ParticlePHD
from phdtrack.kernels.grid import points_in_rectangles
from phdtrack.types import Particles
from reference import phd_twin as twin

P_DETECT = 0.9


def dense(state: Particles, z, model, likelihood):
    return twin.update(state.state, state.weight, z, P_DETECT, likelihood, model.clutter.intensity(z))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("floor", [1.0, 8.0])
def test_a_wide_gate_gives_the_dense_update(seed: int, floor: float):
    rng = np.random.default_rng(seed)
    state = crowd(rng, 4, 50, width=200.0)
    z = seen_by(rng, state, 6)
    model = world(detection_probability=P_DETECT, min_noise=floor, gate_probability=1.0)
    updated, info = ParticlePHD().update(state, z, model, 1.0, rng)
    weight, evidence = dense(state, z, model, lambda a, b: twin.box_likelihood(a, b, 0.15, floor))
    np.testing.assert_allclose(info.evidence, evidence, rtol=1e-10)
    np.testing.assert_allclose(updated.weight, weight, rtol=1e-10, atol=1e-18)


@pytest.mark.parametrize("seed", range(6))
def test_what_the_gate_drops_is_bounded(seed: int):
    """A dropped pair is more than G deviations away: its likelihood is below exp(−G²/2) of its peak."""
    rng = np.random.default_rng(seed)
    state = crowd(rng, 5, 60, spread=0.3, width=150.0)
    z = seen_by(rng, state, 8)
    model = world(detection_probability=P_DETECT)
    sensor = model.sensor
    updated, info = ParticlePHD().update(state, z, model, 1.0, rng)
    weight, evidence = dense(state, z, model, lambda a, b: twin.box_likelihood(a, b, sensor.box_noise, sensor.min_noise))
    own = state.state[[0, 1, 4, 5]]
    peak = np.exp(sensor.log_likelihood(own, state.state))
    tail = math.exp(-(sensor._gate**2) / 2)
    dropped = evidence - info.evidence
    assert np.all(dropped >= -1e-12 * evidence)
    assert np.all(dropped <= tail * (P_DETECT * state.weight * peak).sum())
    # Of the mass, what was dropped is at most that share of each detection's evidence, twice (numerator and denominator).
    share = dropped / (evidence + model.clutter.intensity(z))
    assert np.abs(updated.weight - weight).sum() <= 2 * share.sum() + 1e-12


@pytest.mark.parametrize("scaling", ["particle", "detection", "fixed"])
def test_every_pair_within_the_gate_is_looked_at(scaling: str, rng):
    model = world(scaling=scaling)
    state = crowd(rng, 10, 60, spread=0.4)
    z = seen_by(rng, state, 30)
    found = set(zip(*(a.tolist() for a in points_in_rectangles(*state.state[:2], *model.sensor.gate(z))), strict=True))
    distance2 = model.sensor.distance2(z[:, None, :], state.state[:, :, None])
    within = set(zip(*(a.tolist() for a in np.nonzero(distance2 <= model.sensor._gate**2)), strict=True))
    assert len(within) > 20
    assert within <= found
    # And the gate is of use: most pairs are not looked at.
    assert len(found) < 0.5 * distance2.size


def test_fixed_deviations_agree_with_scipy(rng):
    state, model = (
        crowd(rng, 2, 60, spread=0.05, width=100.0),
        world(detection_probability=P_DETECT, scaling="fixed", gate_probability=1.0),
    )
    z = seen_by(rng, state, 3)
    cov = np.diag([3.0, 3, 6, 6])
    weight, evidence = dense(state, z, model, lambda a, b: multivariate_normal.pdf(a, b[[0, 1, 4, 5]], cov))
    updated, info = ParticlePHD().update(state, z, model, 1.0, rng)
    np.testing.assert_allclose(info.evidence, evidence, rtol=1e-10)
    np.testing.assert_allclose(updated.weight, weight, rtol=1e-10, atol=1e-18)


def test_detection_probability_may_depend_on_the_state(rng):
    """p_D is a model: here nothing is seen in the left half."""
    model = world(gate_probability=1.0)

    class Half:
        def __getattr__(self, name):
            return getattr(model.sensor, name)

        def p_detect(self, x):
            return np.where(x[0] < 100, 0.0, 0.8)

    state = crowd(rng, 4, 40, width=200.0)
    z = seen_by(rng, state, 5)
    halved = replace(model, sensor=Half())
    updated, info = ParticlePHD().update(state, z, halved, 1.0, rng)
    likelihood = np.exp(model.sensor.log_likelihood(z[:, None, :], state.state[:, :, None]))
    seen = state.weight * halved.sensor.p_detect(state.state)
    evidence = seen @ likelihood
    np.testing.assert_allclose(info.evidence, evidence, rtol=1e-10)
    total = model.clutter.intensity(z) + evidence
    np.testing.assert_allclose(updated.weight, state.weight - seen + seen * (likelihood / total).sum(1), rtol=1e-9)
    left = state.state[0] < 100
    np.testing.assert_array_equal(updated.weight[left], state.weight[left])
