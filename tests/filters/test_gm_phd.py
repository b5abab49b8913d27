"""Laws of the GM-PHD filter: the Kalman filter of one target, the printed update, mass, gates."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from phd_cases import NoBirth, world

from composed import drawn
from phdtrack.filters import GMCPHD, GMPHD
from phdtrack.models import (
    BoxClutter,
    BoxMotion,
    BoxSensor,
    FixedBirth,
    MeasurementBirth,
    UniformClutter,
)
from phdtrack.protocols import Model
from phdtrack.types import GaussianMixture
from reference import gm_twin

ROWS = [0, 1, 4, 5]
H = np.eye(6)[ROWS]
MEAN = np.array([320.0, 240, 2, -1, 60, 110])
COV = np.diag([3.0, 3, 20, 20, 6, 6])
# M09's fixed variances: linear and Gaussian.
LINEAR = Model(
    BoxMotion(1.5**0.5, 2.0, survival_probability=1.0, scaled_noise=False),
    BoxSensor(detection_probability=1.0, scaling="fixed"),
    NoBirth(),
    UniformClutter(0.0, 1.0),
)
NOTHING = np.zeros((4, 0))


def nearby(rng: np.random.Generator, n: int, width: float = 500.0) -> GaussianMixture:
    """Gaussians of targets, some of them close together."""
    mean = rng.uniform([50, 50, -3, -3, 20, 40], [width, 400, 3, 3, 60, 120], (n, 6)).T
    mean[:, 1::3] = mean[:, ::3][:, : mean[:, 1::3].shape[1]] + rng.normal(
        0, 3, mean[:, 1::3].shape
    )
    root = rng.normal(0, 1.5, (n, 6, 6))
    return GaussianMixture(
        rng.uniform(0.1, 1.2, n), mean, root @ root.transpose(0, 2, 1) + np.eye(6)
    )


def seen_by(rng: np.random.Generator, state: GaussianMixture, n: int) -> np.ndarray:
    x = state.mean[:, rng.integers(len(state), size=n)]
    return x[ROWS] + rng.normal(0, 3, (4, n))


def test_one_target_is_the_kalman_filter(rng):
    """p_D = 1, no clutter, no births: means and covariances to 1e-10."""
    _, (f,), (q,) = LINEAR.motion.transition(MEAN[:, None], 1.0)
    x = rng.multivariate_normal(MEAN, COV)[:, None]
    measured = []
    for _ in range(30):
        x = drawn(LINEAR.motion, x, 1.0, rng)
        measured.append(x[ROWS, 0] + rng.normal(0, np.sqrt([3.0, 3, 6, 6])))
    means, covs = gm_twin.kalman(MEAN, COV, np.array(measured), f, q, H, np.diag([3.0, 3, 6, 6]))
    # The fused path knows births that are given: here none.
    for kind, model in itertools.product((GMPHD, GMCPHD), (LINEAR, with_no_births(LINEAR))):
        recursion = kind(initial=GaussianMixture(np.ones(1), MEAN[:, None], COV[None]))
        state = recursion.start(model, rng)
        for k, z in enumerate(measured):
            state, info = recursion.step(state, z[:, None], model, 1.0, rng)
            assert info.mass == pytest.approx(1.0)
            if kind is GMCPHD:
                np.testing.assert_allclose(info.cardinality, [0, 1], atol=1e-14)
            held = getattr(state, "intensity", state)
            np.testing.assert_allclose(held.mean, means[k][:, None], rtol=1e-10, atol=1e-10)
            np.testing.assert_allclose(held.covariance, covs[k][None], rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("scaling", ["particle", "detection", "fixed"])
def test_the_update_is_the_printed_one_but_for_the_gate(scaling: str, rng):
    """Every pair by matrix inverses, without gates: evidence and mass within what a gate of five
    deviations cuts.
    """
    model = world(scaling=scaling, detection_probability=0.9)
    state = nearby(rng, 9)
    sensor = model.sensor
    z = np.hstack([seen_by(rng, state, 6), [[900.0], [900], [30], [60]]])
    kappa = model.clutter.intensity(z)

    def noise(i: int, j: int) -> np.ndarray:
        return sensor.covariance(z[:, j : j + 1], state.mean[:, i : i + 1])[0]

    p = np.full(9, 0.9)
    weight, mean, cov, evidence = gm_twin.update(
        state.weight, state.mean, state.covariance, z, H, noise, p, kappa
    )
    wide, info = GMPHD(gate_probability=1.0).update(state, z, model, 1.0, rng)
    np.testing.assert_allclose(info.evidence, evidence, rtol=1e-9, atol=1e-300)
    assert wide.mass == pytest.approx(weight.sum())
    for printed in np.flatnonzero(weight > 1e-9):
        here = np.flatnonzero(np.isclose(wide.weight, weight[printed], rtol=1e-8))
        assert any(np.allclose(wide.mean[:, i], mean[:, printed]) for i in here)
        assert any(np.allclose(wide.covariance[i], cov[printed]) for i in here)
    gated, short = GMPHD().update(state, z, model, 1.0, rng)
    # N(z; Hm, S) is at most its value on the gate outside of it.
    largest = 0.0
    for j in range(7):
        norms = [
            np.linalg.det(2 * np.pi * (H @ state.covariance[i] @ H.T + noise(i, j))) ** -0.5
            for i in range(9)
        ]
        bound = 0.9 * np.exp(-12.5) * float(state.weight @ norms)
        assert -1e-9 * evidence[j] <= evidence[j] - short.evidence[j] <= bound * (1 + 1e-9)
        largest = max(largest, bound / (kappa[j] + short.evidence[j]))
    assert abs(gated.mass - wide.mass) <= 7 * 2 * largest


def test_prediction_is_the_printed_one(rng):
    model = world()
    state = nearby(rng, 5)
    mean, f, q = model.motion.transition(state.mean, 2.0)
    weight, _, cov = gm_twin.predict(state.weight, state.mean, state.covariance, 0.99**2, f, q)
    predicted = GMPHD().predict(state, model, 2.0, rng)
    np.testing.assert_allclose(predicted.weight, weight)
    np.testing.assert_allclose(predicted.mean, mean)
    np.testing.assert_allclose(predicted.covariance, cov)
    outside = GaussianMixture(np.ones(1), np.array([[-500.0, 50, 0, 0, 20, 40]]).T, COV[None])
    assert len(GMPHD().predict(outside, model, 1.0, rng)) == 0


def test_an_empty_scan_leaves_what_was_missed(rng):
    model = world(detection_probability=0.9)
    state = nearby(rng, 6)
    after, info = GMPHD().update(state, NOTHING, model, 1.0, rng)
    np.testing.assert_allclose(after.weight, 0.1 * state.weight)
    np.testing.assert_array_equal(after.mean, state.mean)
    assert info.mass == pytest.approx(0.1 * state.mass)


def test_unexplained_detection_vanishes_and_is_counted(rng):
    model = world(clutter=UniformClutter(0.0, 1.0), detection_probability=1.0)
    state = GaussianMixture(np.ones(1), MEAN[:, None], COV[None])
    z = np.array([[5000.0, 320, 5050], [5000, 240, 5000], [20, 60, 20], [40, 110, 40]])
    for after, info in (
        GMPHD().update(state, z, model, 1.0, rng),
        GMPHD().step(state, z, with_no_births(model), 1.0, rng),
    ):
        assert info.vanished == 2
        assert after.mass == pytest.approx(1.0)
        np.testing.assert_array_equal(info.clutter_probability[[0, 2]], [1.0, 1.0])


def with_no_births(model: Model) -> Model:
    """The same, in a form that the fused step knows."""
    return replace(
        model, birth=FixedBirth(GaussianMixture(np.zeros(0), np.zeros((6, 0)), np.zeros((0, 6, 6))))
    )


def test_births_stop_where_mass_explains_the_detection(rng):
    model = world(birth=MeasurementBirth(births_per_detection=25 * 0.05), clutter=BoxClutter(0.5))
    z = MEAN[ROWS, None]
    for weight, born in ((1.2, False), (0.5, True)):
        state = GaussianMixture(np.array([weight]), MEAN[:, None], COV[None])
        for info in (
            GMPHD().update(state, z, model, 1.0, rng)[1],
            GMPHD().step(state, z, model, 1.0, rng)[1],
        ):
            assert (info.mass_born > 0) == born
            assert info.mass_born < 0.1
