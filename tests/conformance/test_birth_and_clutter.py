"""What every birth and every clutter must do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from shipped import (
    BIRTHS,
    CLUTTERS,
    GROUND,
    PLANE_BIRTHS,
    PLANE_CLUTTERS,
    POINT_BIRTHS,
    SENSORS,
    detections,
    fixed,
    keeps,
)

from phdtrack.errors import InputError
from phdtrack.filters import GMPHD
from phdtrack.models import PlaneMotion, UniformBirth, UniformClutter
from phdtrack.protocols import Birth, Clutter, Model, Sensor
from phdtrack.types import GaussianMixture

SENSOR = SENSORS["particle"]
IN_WORLDS = ((BIRTHS, SENSOR), (PLANE_BIRTHS, GROUND), (POINT_BIRTHS, SENSORS["point"]))
WORLDS = [(birth, sensor) for births, sensor in IN_WORLDS for birth in births.values()]
births = pytest.mark.parametrize(
    ("birth", "sensor"), WORLDS, ids=[*BIRTHS, *PLANE_BIRTHS, *POINT_BIRTHS]
)
PLACES = [(clutter, SENSOR) for clutter in CLUTTERS.values()] + [
    (clutter, GROUND) for clutter in PLANE_CLUTTERS.values()
]
clutters = pytest.mark.parametrize(("clutter", "sensor"), PLACES, ids=[*CLUTTERS, *PLANE_CLUTTERS])


def measured(rng: np.random.Generator, n: int, sensor=SENSOR) -> np.ndarray:
    return fixed(sensor.measure(detections(rng, n)))


def dim(sensor) -> int:
    return 6 if sensor is SENSOR else 4


def newborn(birth: Birth, z: np.ndarray, sensor: Sensor, seconds: float) -> GaussianMixture:
    """What there is after a frame in which nothing was expected and targets are never detected."""
    model = Model(
        PlaneMotion(),
        replace(sensor, detection_probability=0.0),
        birth,
        UniformClutter(1.0, 1.0),
        rate=1.0,
    )
    d = len(sensor.states(z)[0])
    nothing = GaussianMixture(np.zeros(0), np.zeros((d, 0)), np.zeros((0, d, d)))
    found, _ = GMPHD().update(nothing, z, model, seconds, np.random.default_rng(0))
    there = found.weight > 0
    return GaussianMixture(found.weight[there], found.mean[:, there], found.covariance[there])


@births
def test_newborn_are_particles_and_repeat(birth, sensor, rng):
    keeps(Birth, birth)
    z = measured(rng, 5, sensor)
    covered = fixed(np.array([0.0, 0.3, 1.0, 2.0, 0.9]))
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
    z = measured(rng, 5, sensor)
    covered = np.zeros(5)
    one, three = (
        birth.sample(z, covered, sensor, dt, np.random.default_rng(3)).mass for dt in (1.0, 3.0)
    )
    assert three == pytest.approx(3 * one)
    assert 0 < one < 3


BOXES = np.array([[100.0, 300, 500], [200, 250, 100], [40, 60, 30], [80, 120, 100]])
FEET = np.array([[-10.0, 3, 12], [20, 30, 25], [0.2, 0.4, 0.3], [0.1, 0, -0.1], [0.3, 0.6, 0.2]])
GAUSSIAN = [
    (birth, SENSOR, BOXES) for name, birth in BIRTHS.items() if name not in ("uniform", "learned")
]
GAUSSIAN += [(birth, GROUND, FEET) for name, birth in PLANE_BIRTHS.items() if "learned" not in name]
GAUSSIAN.append((POINT_BIRTHS["point"], SENSORS["point"], BOXES[:2]))


@pytest.mark.parametrize(("birth", "sensor", "z"), GAUSSIAN)
def test_their_mixture_has_the_mass_of_their_particles(birth, sensor, z):
    """Averaged over draws: detections far apart, so that regions of γ neither overlap nor leave the
    image.
    """
    d = dim(sensor)
    mixture = newborn(birth, fixed(z), sensor, 0.6)
    assert mixture.mean.shape == (d, len(mixture))
    assert mixture.covariance.shape == (len(mixture), d, d)
    assert (mixture.weight > 0).all()
    assert np.linalg.eigvalsh(mixture.covariance).min() > 0
    drawn = [
        birth.sample(z, np.zeros(3), sensor, 0.6, np.random.default_rng(k)).mass for k in range(40)
    ]
    assert mixture.mass == pytest.approx(np.mean(drawn), rel=0.03)


# The second and third detections share what lies between them.
NEAR = np.array([[100.0, 300, 303], [200, 250, 251], [40, 60, 60], [80, 120, 122]])
FEET_NEAR = np.array(
    [[-10.0, 3, 3.5], [20, 30, 30.5], [0.2, 0.4, 0.4], [0.1, 0, 0], [0.3, 0.6, 0.6]]
)
ELLIPSE = np.pi * 36 * np.sqrt(FEET_NEAR[2] * FEET_NEAR[4] - FEET_NEAR[3] ** 2)
AROUND = 1 / (4 * (NEAR[2] * NEAR[3]) ** 2)


@pytest.mark.parametrize(("birth", "sensor", "z", "gamma"), [
    (BIRTHS["measurement, image"], SENSOR, NEAR, np.full(3, 1 / (640.0 * 480) ** 2)),
    (BIRTHS["measurement, local"], SENSOR, NEAR, AROUND),
    (PLANE_BIRTHS["plane, region"], GROUND, FEET_NEAR, np.full(3, 1 / 4800)),
    (PLANE_BIRTHS["plane, local"], GROUND, FEET_NEAR, 1 / ELLIPSE),
    (POINT_BIRTHS["point"], SENSORS["point"], NEAR[:2], np.full(3, 1 / (640.0 * 480))),
], ids=["image", "local", "region", "local on the plane", "point"])  # fmt: skip
def test_newborn_gaussians_have_the_density_of_births(birth, sensor, z, gamma):
    """Seen through the noise; 0.02 are born a second."""
    mixture = newborn(birth, z, sensor, 1.0)
    rows = list(sensor.observed)
    seen = mixture.covariance[:, rows][:, :, rows] + sensor.covariance(z, mixture.mean)
    step = z[: len(rows), :, None] - mixture.mean[rows][:, None, :]
    distance2 = np.einsum("rji,irs,sji->ji", step, np.linalg.inv(seen), step)
    density = (
        mixture.weight / np.sqrt(np.linalg.det(2 * np.pi * seen)) * np.exp(-0.5 * distance2)
    ).sum(1)
    np.testing.assert_allclose(density, 0.02 * gamma, rtol=0.02)


def test_uniform_births_have_no_mixture_and_say_what_has():
    with pytest.raises(InputError, match=r"birth\.kind=point"):
        POINT_BIRTHS["point, uniform"].gaussians(np.zeros((2, 0)), SENSORS["point"], 1.0)


@births
def test_no_measurements(birth, sensor, rng):
    d = dim(sensor)
    none = sensor.measure(detections(rng, 0))
    born = birth.sample(none, np.zeros(0), sensor, 1.0, rng)
    assert born.state.shape == (d, len(born))
    assert (born.weight >= 0).all()
    if not isinstance(birth, UniformBirth):
        mixture = newborn(birth, none, sensor, 1.0)
        assert mixture.mean.shape == (d, len(mixture))
        assert mixture.covariance.shape == (len(mixture), d, d)


@clutters
def test_clutter_is_an_intensity(clutter, sensor, rng):
    keeps(Clutter, clutter)
    z = measured(rng, 20, sensor)
    kappa = clutter.intensity(z)
    assert kappa.shape == (20,)
    assert np.isfinite(kappa).all()
    assert (kappa >= 0).all()
    np.testing.assert_array_equal(clutter.intensity(z[:, :0]), np.zeros(0))
    assert (clutter.intensity(z[:, 5:7]) <= kappa[5:7] + 1e-15).all(), (
        "other detections take nothing away"
    )
