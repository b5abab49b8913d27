"""Bearings and ranges: a density, angles the short way round, gates that hold, Gaussians by sigma
points.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.bearing import BearingSensor, TurningMotion
from phdtrack.filters import GMPHD
from phdtrack.kernels.gaussian import PAIR, Measurements, all_posteriors
from phdtrack.kernels.mcmc import pair_likelihoods
from phdtrack.models import FixedBirth, UniformClutter
from phdtrack.models.gaussian import predicted_measurements
from phdtrack.protocols import Model
from phdtrack.types import GaussianMixture

SENSOR = BearingSensor(bearing=0.035, reach=10.0, origin=(100.0, -50.0))


def at(*places: tuple[float, float]) -> np.ndarray:
    """(5, n) states at rest."""
    return np.vstack([np.array(places).T, np.zeros((3, len(places)))])


def pairs(z: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(P,) d² and g(z|x) of pairs of columns."""
    numbers = SENSOR.particle_model(z)
    column = np.arange(z.shape[1])
    return pair_likelihoods(x, numbers.model, numbers.table, column, column)


def test_bearings_are_from_the_y_axis_towards_the_x_axis():
    x = at((100, 50), (200, -50), (100, -150), (0, -50))
    np.testing.assert_allclose(
        SENSOR.predicted_measurements(x),
        [[0, math.pi / 2, math.pi, -math.pi / 2], [100, 100, 100, 100]],
    )


@pytest.mark.parametrize("place", [(150.0, 700.0), (100.0, -800.0), (-900.0, -50.0), (100.0, 20.0)])
def test_the_likelihood_integrates_to_one(place: tuple[float, float]):
    """By the midpoint rule over all bearings and 12 deviations of range; behind the sensor the mass
    lies across ±π.
    """
    x = at(place)
    theta = (np.arange(2000) + 0.5) / 2000 * 2 * math.pi - math.pi
    centre = SENSOR.predicted_measurements(x)[1, 0]
    r = centre + 10 * np.linspace(-6, 6, 601)
    z = np.stack([np.repeat(theta, 601), np.tile(r, 2000)])
    _, density = pairs(z, np.repeat(x, z.shape[1], axis=1))
    assert density.sum() * (2 * math.pi / 2000) * 0.2 == pytest.approx(1, abs=1e-5)


@settings(max_examples=50, deadline=None)
@given(st.floats(-math.pi, math.pi), st.integers(-2, 2), st.floats(50, 2000))
def test_whole_turns_change_nothing(bearing: float, turns: int, r: float):
    x = at((-300, -700), (400, 900))
    z = np.array([[bearing], [r]])
    round_ = z + np.array([[2 * math.pi * turns], [0]])
    np.testing.assert_allclose(
        pairs(np.repeat(round_, 2, axis=1), x)[0],
        pairs(np.repeat(z, 2, axis=1), x)[0],
        rtol=1e-9,
        atol=1e-9,
    )
    assert (
        np.abs(SENSOR.innovation(round_, SENSOR.predicted_measurements(x))[0]) <= math.pi + 1e-12
    ).all()


@settings(max_examples=200, deadline=None)
@given(
    st.floats(-7, 7),
    st.floats(0, 3000),
    st.floats(0, 1),
    st.floats(0, 2 * math.pi),
    st.sampled_from([0.01, 0.2, 0.7]),
)
def test_the_gate_holds_what_is_within_it(
    bearing: float, r: float, part: float, turn: float, sd: float
):
    """Every position whose distance is at most G lies in the rectangle, also of wide noises and
    near the sensor.
    """
    sensor = BearingSensor(
        bearing=sd, reach=10.0, origin=(100.0, -50.0), gate_probability=1 - math.exp(-12.5)
    )
    z = np.array([[bearing], [r]])
    theta = bearing + 5 * sd * part * math.cos(turn)
    far = r + 50 * part * math.sin(turn)
    if far < 0:
        return
    x = at((100 + far * math.sin(theta), -50 + far * math.cos(theta)))
    lower, upper = sensor.gate(z)
    assert (lower - 1e-9 <= x[:2]).all()
    assert (x[:2] <= upper + 1e-9).all()


def test_the_covariance_of_a_place_is_that_of_draws(rng):
    z = np.array([[2.5], [1500.0]])
    x, (cov,) = SENSOR.states(z)
    drawn = SENSOR.states(z + rng.normal(size=(2, 200_000)) * [[0.035], [10.0]])[0][:2]
    np.testing.assert_allclose(np.cov(drawn), cov[:2, :2], rtol=0.02, atol=10)
    np.testing.assert_allclose(SENSOR.noise(x)[:2, 0] ** 2, np.diag(cov)[:2])
    assert SENSOR.noise(at((100, -50)))[:2].min() > 0, (
        "nor is anything certain at the sensor's own place"
    )


def test_the_detection_probability_falls_with_the_range():
    x = at((100, -50), (100, 1950))
    np.testing.assert_array_equal(SENSOR.p_detect(x), [0.98, 0.98])
    np.testing.assert_allclose(
        BearingSensor(fade=2000.0, origin=SENSOR.origin).p_detect(x), [0.98, 0.98 * math.exp(-0.5)]
    )


def corrected(
    state: GaussianMixture, z: np.ndarray, sensor: BearingSensor
) -> tuple[np.ndarray, np.ndarray]:
    """Mean (d, 1) and covariance (1, d, d) of one Gaussian after one measurement (2, 1)."""
    mean, after, cov = (
        state.mean.T.copy(),
        np.empty(state.mean.T.shape),
        np.empty(state.covariance.shape),
    )
    seen = predicted_measurements(sensor, mean, state.covariance, "unscented")
    measured = Measurements(z.T.copy(), np.zeros((0, 2, 2)), np.zeros(1), (2 * math.pi, 0.0))
    all_posteriors(mean, state.covariance, seen, measured, np.zeros(1, PAIR), after, cov)
    return after.T, cov


def gaussian(place: tuple[float, float], sd: float) -> GaussianMixture:
    return GaussianMixture(np.ones(1), at(place), np.diag([sd**2, sd**2, 50.0, 50.0, 0.01])[None])


@pytest.mark.parametrize("place", [(900.0, 700.0), (100.0, -800.0)])
def test_sigma_points_have_the_moments_of_draws(place: tuple[float, float], rng):
    """400 000 draws; the second Gaussian lies across the cut at ±π."""
    state = gaussian(place, 50.0)
    seen = predicted_measurements(SENSOR, state.mean.T.copy(), state.covariance, "unscented")
    x = rng.multivariate_normal(state.mean[:, 0], state.covariance[0], 400_000).T
    step = SENSOR.innovation(SENSOR.predicted_measurements(x), seen.z.T)
    spread = np.cov(step)
    assert (
        np.abs(step.mean(1))
        < 5 * np.sqrt(np.diag(spread) / 400_000) + 0.002 * np.sqrt(np.diag(spread))
    ).all()
    scale = np.sqrt(np.outer(np.diag(spread), np.diag(spread)))
    assert (np.abs(seen.covariance[0] - spread) < 0.02 * scale).all()
    cross = np.cov(np.vstack([x, step]))[:5, 5:]
    wide = np.sqrt(np.outer(np.diag(state.covariance[0]), np.diag(spread)))
    assert (np.abs(seen.cross[0] - cross) < 0.02 * wide).all()


def test_turning_target_is_tracked_within_the_covariance(rng):
    """Normalised error over 40 runs of 40 scans, turning at the model's own noise: in the band of
    independent runs.

    One target, always seen, no clutter: every posterior is one Gaussian.
    """
    motion = TurningMotion(acceleration=2.0, turning=0.01, survival_probability=1.0)
    sensor = BearingSensor(bearing=0.01, reach=5.0, detection_probability=1.0)
    model = Model(
        motion, sensor, FixedBirth(gaussian((0, 500), 1.0), 1), UniformClutter(0.0, 1.0), rate=1.0
    )
    runs = []
    for _ in range(40):
        start = gaussian((-500 + 20 * len(runs), 900), 20.0)
        x = rng.multivariate_normal(start.mean[:, 0], start.covariance[0])[:, None]
        recursion = GMPHD(transform="unscented")
        errors = []
        state = start
        for _ in range(40):
            mean, _, (noise,) = motion.transition(x, 1.0)
            push, rest, turn = (rng.standard_normal((axes, 1)) for axes in (2, 2, 1))
            place = noise[0, 0]
            both = noise[0, 2]
            speed = noise[2, 2]
            moved = both / np.sqrt(speed) * push + np.sqrt(place - both**2 / speed) * rest
            x = mean + np.vstack([moved, np.sqrt(speed) * push, np.sqrt(noise[4, 4]) * turn])
            z = sensor.predicted_measurements(x) + rng.normal(size=(2, 1)) * [[0.01], [5.0]]
            state = recursion.predict(state, model, 1.0, rng)
            mean, cov = corrected(state, z, sensor)
            state = GaussianMixture(np.ones(1), mean, cov)
            step = x[:, 0] - mean[:, 0]
            errors.append(step @ np.linalg.solve(cov[0], step))
        runs.append(np.mean(errors))
    assert np.mean(runs) == pytest.approx(5, abs=4 * np.std(runs, ddof=1) / math.sqrt(40) + 0.1)
    assert np.std(runs, ddof=1) < 1.5
