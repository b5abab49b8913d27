"""The PMB filter with models that no kernel knows, points, the ground plane, bearings; a moving camera; its statistics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mht_cases import FRAME, RNG, told
from pmb_cases import PLAIN, world

from experiments.bearing import BearingSensor, TurningMotion
from phdtrack.filters import MHT, PMB
from phdtrack.models import (
    FixedBirth,
    PlaneBirth,
    PlaneMotion,
    PlaneSensor,
    PointBirth,
    PointMotion,
    PointSensor,
    UniformClutter,
)
from phdtrack.protocols import Model
from phdtrack.types import GaussianMixture


def follow(filter_: PMB | MHT, model: Model, x: np.ndarray, noisy, alarms, frames: int) -> tuple:
    """Estimates of each frame, and where the targets ``x`` (d, n) were, seen with noise among false alarms."""
    state, found, truth = filter_.start(model, RNG), [], []
    for _ in range(frames):
        x = model.motion.transition(x, 1.0)[0]
        state, _ = filter_.step(state, np.hstack([noisy(x), alarms()]), model, 1.0, RNG)
        found.append(told(state, model))
        truth.append(x)
    return found, truth


def stays_with(found, truth, near: float) -> None:
    """Everybody is reported, near where he is, under one label from early on."""
    labels: list[set[int]] = [set() for _ in range(truth[0].shape[1])]
    for estimates, x in zip(found[5:], truth[5:], strict=True):
        assert len(estimates) == x.shape[1]
        for i in range(x.shape[1]):
            distance = np.hypot(*(estimates.state[:2] - x[:2, [i]]))
            assert distance.min() < near
            labels[i].add(int(estimates.tag[distance.argmin()]))
    assert all(len(mine) == 1 for mine in labels)
    assert len(set().union(*labels)) == len(labels)


@pytest.mark.parametrize("transform", ["linear", "unscented"])
def test_points(transform: str):
    rng, sensor = np.random.default_rng(1), PointSensor(noise_variance=4.0, detection_probability=0.99)
    model = Model(
        PointMotion(),
        sensor,
        PointBirth(births_per_second=25 * 0.05, frame_size=FRAME),
        UniformClutter(2.0, FRAME[0] * FRAME[1]),
    )
    x = np.array([[100.0, 500], [100, 300], [3, -2], [1, 2]])
    found, truth = follow(
        PMB(transform=transform), model, x, lambda x: x[:2] + rng.normal(0, 2, (2, 2)),
        lambda: rng.uniform([[0], [0]], [[640], [480]], (2, 2)), 25,
    )  # fmt: skip
    stays_with(found, truth, 12)


@pytest.mark.parametrize("transform", ["linear", "unscented"])
def test_the_ground_plane(transform: str):
    """Metres on a plan, with a covariance of each measurement."""
    rng, sensor = np.random.default_rng(2), PlaneSensor(scaling="given", detection_probability=0.99)
    births = PlaneBirth(births_per_second=0.05, births_per_detection=0.0, borders=(-20.0, 0.0, 20.0, 40.0))
    model = Model(PlaneMotion(acceleration=0.02), sensor, births, UniformClutter(1.0, 1600.0))
    x = np.array([[-5.0, 5], [10, 25], [0.1, -0.1], [0.05, 0.1]])
    found, truth = follow(
        PMB(transform=transform), model, x, lambda x: measured_plane(x[:2] + rng.normal(0, 0.1, (2, 2))),
        lambda: measured_plane(rng.uniform([[-20], [0]], [[20], [40]], (2, 1))), 25,
    )  # fmt: skip
    stays_with(found, truth, 1.0)


def measured_plane(xy: np.ndarray) -> np.ndarray:
    """(5, N) points with a covariance of (0.1 m)²."""
    return np.vstack([xy, np.tile([[0.01], [0.0], [0.01]], xy.shape[1])])


@pytest.mark.parametrize("filter_", [PMB(mean_visible_time=0.0, static_clutter_prior=0.0), MHT()], ids=["pmb", "mht"])
def test_bearings_and_range_with_sigma_points(filter_):
    """The turning targets of the nonlinear scenario."""
    rng, sensor, motion = np.random.default_rng(8), BearingSensor(), TurningMotion()
    x = np.array([[400.0, -500], [700, 300], [5, -3], [-8, 6], [0.01, -0.02]])
    place = GaussianMixture(np.full(2, 0.05), x.copy(), np.tile(np.diag([900.0, 900, 100, 100, 0.01]), (2, 1, 1)))
    model = replace(world(), motion=motion, sensor=sensor, birth=FixedBirth(place),
                    clutter=UniformClutter(1.0, np.pi * 2000), rate=1.0)  # fmt: skip

    def noisy(x: np.ndarray) -> np.ndarray:
        root = np.linalg.cholesky(sensor.covariance(sensor.expected(x), x))
        return sensor.expected(x) + (root @ rng.standard_normal((2, 2, 1)))[:, :, 0].T

    def alarms() -> np.ndarray:
        return rng.uniform([[-np.pi / 2], [0]], [[np.pi / 2], [2000]], (2, 1))

    found, truth = follow(replace(filter_, transform="unscented"), model, x, noisy, alarms, 20)
    stays_with(found[5:], truth[5:], 60)


def simulated(rng, model: Model, frames: int, arrivals: float, alarms: float) -> tuple[list, np.ndarray]:
    """Scans of a world that is as the model says, and how many were there in each frame."""
    p_s, p_d = model.motion.survival_probability ** (1 / model.rate), model.sensor.detection_probability
    x, scans, number = np.zeros((6, 0)), [], []
    low, high = np.array([0.0, 0, 30, 60]), np.array([640.0, 480, 50, 100])
    for _ in range(frames):
        x = x[:, rng.random(x.shape[1]) < p_s]
        if x.shape[1]:
            mean, _, q = model.motion.transition(x, 1.0)
            x = mean + np.stack([rng.multivariate_normal(np.zeros(6), c, method="eigh") for c in q]).T
        new = rng.uniform(low, high, (rng.poisson(arrivals), 4)).T
        speed = rng.normal(0, model.sensor.birth_speed_pixels / np.sqrt(2), new[:2].shape)
        x = np.hstack([x, np.vstack([new[:2], speed, new[2:]])])
        seen = x[:, rng.random(x.shape[1]) < p_d][[0, 1, 4, 5]]
        seen = seen + 3 * rng.standard_normal(seen.shape)
        scans.append(np.ascontiguousarray(np.hstack([seen, rng.uniform(low, high, (rng.poisson(alarms), 4)).T])))
        number.append(x.shape[1])
    return scans, np.array(number)


def test_the_expected_number_is_the_number_on_average():
    """Twenty runs of a world that is as the model says: the mean of mass − number is within three standard errors.

    Those who have not been detected yet are not in the mass: 0.25 a frame arrive and 0.1 of them wait a frame, 0.01 two.
    """
    volume = 640.0 * 480 * 20 * 40
    model = world(detection=0.9, survival=0.97, birth=0.25 / volume, clutter=2.0 / volume)
    error, masses = [], []
    for seed in range(20):
        scans, number = simulated(np.random.default_rng(seed), model, 80, 0.25, 2.0)
        state, mass = PLAIN.start(model, RNG), []
        for z in scans:
            state, info = PLAIN.step(state, z, model, 1.0, RNG)
            mass.append(info.mass)
        error.append(np.mean(np.array(mass)[10:] - number[10:]))
        masses.append(np.mean(number[10:]))
    unseen = 0.25 * 0.1 / (1 - 0.1 * 0.97)
    bias, standard = np.mean(error) + unseen, np.std(error, ddof=1) / np.sqrt(20)
    assert np.mean(masses) > 4
    assert abs(bias) < 3 * standard + 0.02
