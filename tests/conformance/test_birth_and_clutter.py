"""What every birth and every clutter must do."""

from __future__ import annotations

import numpy as np
import pytest
from shipped import BIRTHS, CLUTTERS, GROUND, PLANE_BIRTHS, PLANE_CLUTTERS, POINT_BIRTHS, SENSORS, detections, fixed, keeps

from newborn_cases import newborn
from phdtrack.errors import InputError
from phdtrack.models import UniformBirth
from phdtrack.protocols import Birth, Clutter

SENSOR = SENSORS["particle"]
IN_WORLDS = ((BIRTHS, SENSOR), (PLANE_BIRTHS, GROUND), (POINT_BIRTHS, SENSORS["point"]))
WORLDS = [(birth, sensor) for births, sensor in IN_WORLDS for birth in births.values()]
births = pytest.mark.parametrize(("birth", "sensor"), WORLDS, ids=[*BIRTHS, *PLANE_BIRTHS, *POINT_BIRTHS])
PLACES = [(clutter, SENSOR) for clutter in CLUTTERS.values()] + [(clutter, GROUND) for clutter in PLANE_CLUTTERS.values()]
clutters = pytest.mark.parametrize(("clutter", "sensor"), PLACES, ids=[*CLUTTERS, *PLANE_CLUTTERS])


def measured(rng: np.random.Generator, n: int, sensor=SENSOR) -> np.ndarray:
    return fixed(sensor.measure(detections(rng, n)))


def dim(sensor) -> int:
    return 6 if sensor is SENSOR else 4


@births
def test_newborn_are_particles_and_repeat(birth, sensor, rng):
    keeps(Birth, birth)
    z, covered = measured(rng, 5, sensor), fixed(np.array([0.0, 0.3, 1.0, 2.0, 0.9]))
    a, b = (birth.sample(z, covered, sensor, 1.0, np.random.default_rng(3)) for _ in range(2))
    assert a.state.shape == (dim(sensor), len(a))
    assert len(a) > 0
    assert np.isfinite(a.state).all()
    assert np.isfinite(a.weight).all()
    assert (a.weight >= 0).all()
    assert (a.state[4:6] > 0).all()
    np.testing.assert_array_equal(a.state, b.state)
    np.testing.assert_array_equal(a.weight, b.weight)


@births
def test_their_mass_follows_the_interval(birth, sensor, rng):
    z, covered = measured(rng, 5, sensor), np.zeros(5)
    one, three = (birth.sample(z, covered, sensor, dt, np.random.default_rng(3)).mass for dt in (1.0, 3.0))
    assert three == pytest.approx(3 * one)
    assert 0 < one < 3


gaussian = pytest.mark.parametrize("name", sorted({*BIRTHS} - {"uniform", "learned"}))


@gaussian
def test_their_mixture_has_the_mass_of_their_particles(name: str):
    """Averaged over draws: detections far apart, so that regions of γ neither overlap nor leave the image."""
    birth = BIRTHS[name]
    z = fixed(np.array([[100.0, 300, 500], [200, 250, 100], [40, 60, 30], [80, 120, 100]]))
    covered = np.zeros(3)
    mixture = newborn(birth, z, SENSOR, 1.5)
    assert mixture.mean.shape == (6, len(mixture))
    assert mixture.covariance.shape == (len(mixture), 6, 6)
    assert (mixture.weight > 0).all()
    assert np.linalg.eigvalsh(mixture.covariance).min() > 0
    drawn = [birth.sample(z, covered, SENSOR, 1.5, np.random.default_rng(k)).mass for k in range(40)]
    # A region of the noise reaches a little beyond the neighbourhood that a local γ is spread over.
    assert mixture.mass == pytest.approx(np.mean(drawn), rel=0.05)


@pytest.mark.parametrize("name", ["measurement, image", "measurement, local"])
def test_newborn_gaussians_have_the_density_of_gamma_at_their_detection(name: str):
    """Seen through the noise; the second and third detections share what lies between them."""
    birth = BIRTHS[name]
    z = np.array([[100.0, 300, 303], [200, 250, 251], [40, 60, 60], [80, 120, 122]])
    mixture = newborn(birth, z, SENSOR, 1.0)
    seen = mixture.covariance[:, [0, 1, 4, 5]][:, :, [0, 1, 4, 5]] + SENSOR.covariance(z, mixture.mean)
    step = z[:, :, None] - mixture.mean[[0, 1, 4, 5]][:, None, :]
    distance2 = np.einsum("rji,irs,sji->ji", step, np.linalg.inv(seen), step)
    density = (mixture.weight / np.sqrt(np.linalg.det(2 * np.pi * seen)) * np.exp(-0.5 * distance2)).sum(1)
    gamma = 0.02 / (640.0 * 480) ** 2 * np.ones(3)
    if "local" in name:
        gamma = 0.02 / (4 * (z[2] * z[3]) ** 2)
        gamma[1:] = gamma[1:].sum()
    np.testing.assert_allclose(density, gamma, rtol=0.01)


def test_uniform_births_have_no_mixture_and_say_what_has():
    with pytest.raises(InputError, match="measurement"):
        BIRTHS["uniform"].gaussians(np.zeros((4, 0)), SENSOR, 1.0)


@births
def test_no_measurements(birth, sensor, rng):
    d, none = dim(sensor), sensor.measure(detections(rng, 0))
    born = birth.sample(none, np.zeros(0), sensor, 1.0, rng)
    assert born.state.shape == (d, len(born))
    assert (born.weight >= 0).all()
    if not isinstance(birth, UniformBirth):
        mixture = newborn(birth, none, sensor, 1.0)
        assert mixture.mean.shape == (d, len(mixture))
        assert mixture.covariance.shape == (len(mixture), d, d)


@pytest.mark.parametrize("name", sorted({*PLANE_BIRTHS} - {"plane, learned"}))
def test_on_the_plane_gaussians_have_the_mass_of_particles(name: str):
    """Averaged over draws; people far apart, whose regions of γ lie inside its border."""
    birth = PLANE_BIRTHS[name]
    z = fixed(np.array([[-10.0, 3, 12], [20, 30, 25], [0.2, 0.4, 0.3], [0.1, 0, -0.1], [0.3, 0.6, 0.2]]))
    covered = np.zeros(3)
    mixture = newborn(birth, z, GROUND, 1.5)
    assert np.linalg.eigvalsh(mixture.covariance).min() > 0
    drawn = [birth.sample(z, covered, GROUND, 1.5, np.random.default_rng(k)).mass for k in range(40)]
    assert mixture.mass == pytest.approx(np.mean(drawn), rel=0.03)


def test_on_the_plane_gaussians_have_the_density_of_gamma_at_their_detection():
    """Seen through the noise; the second and third detections share what lies between them."""
    z = np.array([[-10.0, 3, 3.5], [20, 30, 30.5], [0.2, 0.4, 0.4], [0.1, 0, 0], [0.3, 0.6, 0.6]])
    for name, each in (
        ("plane, region", 0.02 / 4800),
        ("plane, local", 0.02 / (np.pi * 36 * np.sqrt(z[2] * z[4] - z[3] ** 2))),
    ):
        mixture = newborn(PLANE_BIRTHS[name], z, GROUND, 1.0)
        seen = mixture.covariance[:, :2, :2] + GROUND.covariance(z, mixture.mean)
        step = z[:2, :, None] - mixture.mean[:2, None, :]
        distance2 = np.einsum("rji,irs,sji->ji", step, np.linalg.inv(seen), step)
        density = (mixture.weight / np.sqrt(np.linalg.det(2 * np.pi * seen)) * np.exp(-0.5 * distance2)).sum(1)
        np.testing.assert_allclose(density, each * np.array([1, 1, 1] if "region" in name else [1, 2, 2]), rtol=0.01)


@clutters
def test_clutter_is_an_intensity(clutter, sensor, rng):
    keeps(Clutter, clutter)
    z = measured(rng, 20, sensor)
    kappa = clutter.intensity(z)
    assert kappa.shape == (20,)
    assert np.isfinite(kappa).all()
    assert (kappa >= 0).all()
    np.testing.assert_array_equal(clutter.intensity(z[:, :0]), np.zeros(0))
    assert (clutter.intensity(z[:, 5:7]) <= kappa[5:7] + 1e-15).all(), "other detections take nothing away"
