"""Learned densities at points and at detections, against one Gaussian at a time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from phdtrack.errors import InputError
from phdtrack.kernels.scene_density import given_detections
from phdtrack.models import BoxSensor
from phdtrack.models.scene import SceneBirth, SceneClutter
from phdtrack.scene import SceneDensity, marginal
from reference import context_twin as twin

KINDS = {"boxes": (6, (0, 1, 4, 5)), "ground": (4, (0, 1)), "shown first": (3, (0, 1)), "nothing hidden": (2, (0, 1))}


def learned(rng: np.random.Generator, d: int, count: int, uniform: float = 0.3) -> SceneDensity:
    """Gaussians of many widths: near each other, far, and hardly inside."""
    root = rng.normal(0, 1, (count, d, d)) * rng.uniform(0.3, 6, (count, 1, 1))
    mean = rng.uniform(-25, 25, (d, count))
    mean[:, -1] = 400
    weight = rng.random(count) + 0.1
    low, high = np.full(d, -20.0), np.full(d, 30.0)
    return SceneDensity(low, high, uniform, weight / weight.sum(), mean, root @ root.transpose(0, 2, 1) + np.eye(d))


@pytest.mark.parametrize("d", [1, 2, 4, 6])
def test_a_density_and_false_alarms_at_points(d: int, rng):
    p = learned(rng, d, 7)
    x = np.hstack([rng.uniform(-30, 40, (d, 40)), p.mean[:, :3] + 0.1, np.full((d, 1), -20.0)])
    asked = p.low, p.high, p.uniform / p.volume
    np.testing.assert_allclose(p(x), twin.mixture_density(x, *asked, 0.0, p.scaled_weight, p.mean, p.covariance), rtol=1e-10)
    np.testing.assert_allclose(p(x), np.exp(p.log(x)), rtol=1e-10)
    kappa = 2.5 * twin.mixture_density(x, *asked, asked[2], p.scaled_weight, p.mean, p.covariance)
    found = SceneClutter(2.5, p).intensity(np.asfortranarray(np.vstack([x, x])))
    np.testing.assert_allclose(found, kappa, rtol=1e-10)
    assert kappa.max() > 2 * kappa.min(), "Gaussians count somewhere"
    np.testing.assert_array_equal(SceneClutter(0.0, p).intensity(x), np.zeros(x.shape[1]))


@pytest.mark.parametrize(("d", "rows"), KINDS.values(), ids=KINDS)
def test_what_it_says_of_detections(d: int, rows: tuple[int, ...], rng):
    p, n, keep = learned(rng, d, 9), 90, list(rows)
    root = rng.normal(0, 1, (n, d, d))
    state, noise = rng.uniform(-30, 40, (d, n)), root @ root.transpose(0, 2, 1) + 0.1 * np.eye(d)
    state[keep, 0] = p.mean[keep, 0]
    birth, shown = SceneBirth(2.0, p, rows), marginal(p, rows)
    found = birth.around((state, noise), 1.5)
    expected = twin.given_detections(
        state, noise, keep, shown.low, shown.high, p.uniform / shown.volume, p.scaled_weight, p.mean, p.covariance
    )
    density, mean, cov = given_detections(state, noise, *birth._table[:-1], np.full(9, 1e9))
    np.testing.assert_allclose(density, expected[0], rtol=1e-9)
    np.testing.assert_allclose(mean, expected[1], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(cov, expected[2], rtol=1e-8, atol=1e-8)
    # What is left out by default is nothing to single precision.
    np.testing.assert_allclose(found.density, 3.0 * density, rtol=1e-6)
    np.testing.assert_allclose(found.mean, mean, atol=1e-3)
    np.testing.assert_allclose(found.covariance, cov, rtol=1e-4, atol=0.1)
    assert len(np.unique(found.density.round(12))) > 12, "Gaussians count, and places beyond the volume have none"
    assert (found.density == 0).any()


def test_nobody_and_nothing(rng):
    p = learned(rng, 6, 3)
    with pytest.raises(InputError, match="expected 6 components, got 4"):
        p(np.zeros((4, 2)))
    found = SceneBirth(1.0, p).around((np.zeros((6, 0)), np.zeros((0, 6, 6))), 1.0)
    assert found.density.shape == (0,)
    assert p(np.zeros((6, 0))).shape == (0,)
    assert SceneClutter(1.0, marginal(p, (0, 1, 4, 5))).intensity(np.zeros((8, 0))).shape == (0,)


@pytest.mark.parametrize("beside", [False, True])
@pytest.mark.parametrize("scaling", ["particle", "detection", "fixed"])
def test_as_the_fused_filter_reads_it(scaling: str, beside: bool, rng):
    """Densities, means and roots of the velocities are those of `SceneBirth.around` for the sensor's states."""
    low, high = np.array([0.0, 0, -9, -9, 0, 0]), np.array([640.0, 480, 9, 9, 640, 480])
    root = rng.normal(0, 1, (8, 6, 6)) * np.array([30, 30, 1, 1, 5, 5])[:, None]
    mean = rng.uniform([100, 100, -4, -4, 30, 60], [500, 380, 4, 4, 60, 120], (8, 6)).T
    p = SceneDensity(low, high, 0.4, np.full(8, 0.125), mean, root @ root.transpose(0, 2, 1) + np.eye(6))
    birth, sensor = SceneBirth(0.3, p), BoxSensor(scaling=scaling)
    z = np.ascontiguousarray(rng.uniform([50, 50, 20, 40], [700, 430, 90, 140], (40, 4)).T)
    state, cov = sensor.states(z)
    if beside:
        birth = replace(birth, around_detections=0.05, among=marginal(replace(p, mean=p.mean[:, ::-1].copy()), (0, 1, 4, 5)))
    expected = birth.around((state, cov), 1.5)
    density, velocity = birth.about(state, sensor.noise(state), 1.5)
    np.testing.assert_allclose(density, expected.density, rtol=1e-5)
    assert density.max() > 5 * density.min() > 0 or not beside, "places count, and births are everywhere"
    np.testing.assert_allclose(velocity[:2], expected.mean[2:4], rtol=1e-5, atol=1e-5)
    square = np.sqrt(2) * np.linalg.cholesky(expected.covariance[:, 2:4, 2:4])
    np.testing.assert_allclose(velocity[2:], square[:, [0, 1, 1], [0, 0, 1]].T, rtol=1e-5, atol=1e-5)
    assert np.abs(velocity[:2]).max() > 0.5, "velocities differ from rest"
