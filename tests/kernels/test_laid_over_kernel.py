"""Births and false alarms laid over those around each detection, against one detection at a time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from phdtrack.models import BoxSensor
from phdtrack.models.scene import SceneBirth, SceneClutter
from phdtrack.scene import SceneDensity, marginal, uniform_density
from phdtrack.types import F8
from reference import context_twin as twin

SHOWN = (0, 1, 4, 5)


def scene(seed: int, count: int = 12) -> tuple[SceneBirth, SceneClutter]:
    """Births and false alarms with learned densities: wide Gaussians, narrow ones, and one that leaks."""
    rng = np.random.default_rng(seed)
    low, high = np.array([0.0, 0, -30, -30, 0, 0]), np.array([640.0, 480, 30, 30, 640, 480])
    mean = rng.uniform([50, 50, -5, -5, 20, 20], [600, 430, 5, 5, 90, 90], (count, 6)).T
    mean[0, 0] = 5.0
    root = rng.normal(0, 1, (count, 6, 6)) * rng.uniform(1, 8, (count, 1, 1)) * np.array([4, 4, 0.2, 0.2, 1, 1])[:, None]
    p = SceneDensity(low, high, 0.3, np.full(count, 1 / count), mean, root @ root.transpose(0, 2, 1) + np.eye(6))
    return SceneBirth(0.2, p), SceneClutter(4.0, marginal(p, (0, 1, 4, 5)))


def boxes(rng: np.random.Generator, count: int) -> F8:
    """(4, count) in a few crowds, some of them beyond the frame of 640 × 480."""
    middle = rng.uniform([[-30.0], [-30]], [[660], [500]], (2, 5))[:, rng.integers(0, 5, count)]
    return np.vstack([middle + rng.normal(0, 25, (2, count)), rng.uniform([[20.0], [50]], [[60], [120]], (2, count))])


def around(z: F8) -> list[float]:
    """l(z): detections within a box's size, of half to one and a half times its size, each over 4w²h²."""
    out = []
    for x, y, w, h in z.T:
        total = 0.0
        for cx, cy, cw, ch in z.T:
            near = abs(x - cx) <= cw and abs(y - cy) <= ch and 0.5 * cw <= w <= 1.5 * cw and 0.5 * ch <= h <= 1.5 * ch
            total += near / (4 * cw**2 * ch**2)
        out.append(total)
    return out


def density_at(p: SceneDensity, z: F8, beyond: float) -> F8:
    out: F8 = twin.mixture_density(z, p.low, p.high, p.uniform / p.volume, beyond, p.scaled_weight, p.mean, p.covariance)
    return out


@pytest.mark.parametrize("count", [0, 1, 60])
def test_false_alarms_come_to_those_around_each_detection(count: int, rng):
    clutter = scene(3)[1]
    p, z = clutter.density, boxes(rng, count)
    wanted = [0.7 * near for near in around(z)] + 4.0 * density_at(p, z, p.uniform / p.volume)
    found = replace(clutter, around_detections=0.7).intensity(np.vstack([z, z]))
    np.testing.assert_allclose(found, wanted, rtol=1e-10)


@pytest.mark.parametrize("among", [None, scene(5)[1].density], ids=["anywhere", "objects"])
@pytest.mark.parametrize("count", [0, 1, 60])
def test_births_are_those_around_each_detection_by_place(count: int, among: SceneDensity | None, rng):
    birth, sensor, z = scene(2)[0], BoxSensor(), boxes(rng, count)
    seen = sensor.states(z)
    objects = among or uniform_density(birth.shown.low, birth.shown.high)
    p = marginal(birth.density, SHOWN)
    plain = SceneBirth(1.0, birth.density).around(seen, 1.0)
    born = np.maximum(plain.density, p.uniform / p.volume)
    there = density_at(objects, z, objects.uniform / objects.volume)
    found = SceneBirth(0.2, birth.density, around_detections=0.05, among=among).around(seen, 2.0)
    np.testing.assert_allclose(found.density, 0.1 * np.array(around(z)) * born / there, rtol=1e-9)
    np.testing.assert_array_equal(found.mean, plain.mean)
    np.testing.assert_array_equal(found.covariance, plain.covariance)
    assert count < 60 or found.density.max() > 30 * found.density.min(), "places count"


def test_beyond_the_volume_neighbours_count_too():
    """κ is that of the uniform part, and what is around the detection."""
    p = scene(3)[1].density
    z = np.array([[-500.0], [-500], [30], [60]])
    found = SceneClutter(2.0, p, 0.5).intensity(z)
    np.testing.assert_allclose(found, 0.5 / (4 * 30**2 * 60**2) + 2.0 * p.uniform / p.volume)
