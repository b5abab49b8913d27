"""Births and false alarms with learned densities: their mass, their velocities, their limits."""

import numpy as np
import pytest

from phdtrack.models import BoxSensor, MeasurementBirth
from phdtrack.models.scene import SceneBirth, SceneClutter
from phdtrack.models.volume import image_volume
from phdtrack.scene import SceneDensity, marginal, uniform_density

SIZE = (640.0, 480.0)
LOW, HIGH = np.array([0.0, 0, -30, -30, 0, 0]), np.array([640.0, 480, 30, 30, 640, 480])
SENSOR = BoxSensor()
Z = np.array([[100.0, 400], [200, 300], [40, 30], [80, 70]])


def entrance(uniform: float = 0.2) -> SceneDensity:
    """One place with people who walk to the right, the faster the further down."""
    cov = np.diag([400.0, 900, 0.5, 0.5, 25, 100])
    cov[1, 2] = cov[2, 1] = 12.0
    return SceneDensity(LOW, HIGH, uniform, np.ones(1), np.array([[110.0, 210, 4, 1, 42, 82]]).T, cov[None])


def test_without_gaussians_it_is_uniform_birth_over_the_image():
    learned = SceneBirth(0.02, uniform_density(LOW, HIGH))
    plain = MeasurementBirth(0.02, 1000, "image", SIZE)
    covered = np.array([0.0, 0.4])
    a, b = (birth.sample(Z, covered, SENSOR, 1.5, np.random.default_rng(1)) for birth in (learned, plain))
    assert image_volume(SIZE) == pytest.approx(marginal(learned.density, learned.observed).volume)
    np.testing.assert_allclose(a.state, b.state)
    np.testing.assert_allclose(a.weight, b.weight)


def test_the_evidence_of_newborn_is_that_of_gamma():
    """C(z) = ∫ g γ, by drawing γ; a sensor of fixed noise, for which it is exact but for the 1 % that is cut off."""
    sensor = BoxSensor(scaling="fixed", fixed_noise=(3.0, 6.0))
    birth, rng = SceneBirth(1.0, entrance()), np.random.default_rng(2)
    drawn = birth.density.sample(1_000_000, rng)
    z = Z[:, :1]
    each = np.exp(sensor.log_likelihood(z[:, [0]], drawn))
    found = []
    for k in range(20):
        born = birth.sample(z, np.zeros(1), sensor, 1.0, np.random.default_rng(k))
        found.append(float(born.weight @ np.exp(sensor.log_likelihood(z[:, [0]], born.state))))
    assert np.mean(found) == pytest.approx(0.99 * each.mean(), rel=0.02)


def test_velocities_are_those_of_the_place():
    """Against drawing γ and weighing with the likelihood: mean and spread of the velocities given the detection."""
    sensor = BoxSensor(scaling="fixed", fixed_noise=(3.0, 6.0))
    birth = SceneBirth(1.0, entrance(uniform=1e-3))
    drawn = birth.density.sample(1_000_000, np.random.default_rng(3))
    for y in (200.0, 240.0):
        z = np.array([[105.0], [y], [40.0], [80.0]])
        weight = np.exp(sensor.log_likelihood(z, drawn))
        weight /= weight.sum()
        mean = drawn[2:4] @ weight
        spread = (drawn[2:4] - mean[:, None]) * weight @ (drawn[2:4] - mean[:, None]).T
        parts = [birth.sample(z, np.zeros(1), sensor, 1.0, np.random.default_rng(k)) for k in range(30)]
        velocity, share = np.hstack([part.state[2:4] for part in parts]), np.concatenate([part.weight for part in parts])
        share /= share.sum()
        ours = velocity @ share
        assert ours == pytest.approx(mean, abs=0.03)
        assert (velocity - ours[:, None]) * share @ (velocity - ours[:, None]).T == pytest.approx(spread, abs=0.03)


def test_gaussian_newborn_are_the_learned_ones_and_the_uniform_part_about_detections():
    birth = SceneBirth(0.5, entrance(uniform=0.2))
    mixture = birth.components(Z, np.zeros(2), SENSOR, 2.0)
    flat = MeasurementBirth(0.5 * 0.2, 1000, "image", SIZE).components(Z, np.zeros(2), SENSOR, 2.0)
    assert mixture.weight[0] * birth.density.truncated_mass[0] == pytest.approx(0.5 * 2.0 * 0.8)
    np.testing.assert_array_equal(mixture.mean[:, 0], birth.density.mean[:, 0])
    np.testing.assert_allclose(mixture.weight[1:], flat.weight)
    np.testing.assert_allclose(mixture.covariance[1:], flat.covariance)


def test_covered_detections_bring_nothing_and_rates_scale():
    birth = SceneBirth(0.5, entrance())
    assert len(birth.sample(Z, np.ones(2), SENSOR, 1.0, np.random.default_rng(5))) == 0
    # The learned Gaussians are there whatever was measured.
    assert len(birth.components(Z, np.ones(2), SENSOR, 1.0)) == 1
    assert birth.expected(Z, 3.0) == 1.5
    one, three = (birth.sample(Z, np.zeros(2), SENSOR, dt, np.random.default_rng(6)).mass for dt in (1.0, 3.0))
    assert three == pytest.approx(3 * one)


def test_clutter_integrates_to_its_rate_and_never_vanishes():
    p = marginal(entrance(), (0, 1, 4, 5))
    clutter = SceneClutter(3.0, p)
    rng = np.random.default_rng(7)
    points = np.concatenate([p.sample(50_000, rng), rng.uniform(p.low[:, None], p.high[:, None], (4, 50_000))], axis=1)
    ratio = clutter.intensity(points) / (0.5 * p(points) + 0.5 / p.volume)
    assert ratio.mean() == pytest.approx(3, abs=5 * ratio.std() / np.sqrt(ratio.size) + 0.01)
    outside = np.array([[-50.0], [200], [40], [80]])
    assert clutter.intensity(outside)[0] == pytest.approx(3.0 * p.uniform / p.volume)
    # Further rows of a measurement, such as its own noise, are none of the density's business.
    assert clutter.intensity(np.vstack([Z, np.ones((4, 2))])) == pytest.approx(clutter.intensity(Z))
