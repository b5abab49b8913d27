"""What every birth and every clutter must do."""

from __future__ import annotations

import numpy as np
import pytest
from shipped import BIRTHS, CLUTTERS, SENSORS, detections, fixed, keeps

from phdtrack.protocols import Birth, Clutter

SENSOR = SENSORS["particle"]
births = pytest.mark.parametrize("birth", BIRTHS.values(), ids=BIRTHS)
clutters = pytest.mark.parametrize("clutter", CLUTTERS.values(), ids=CLUTTERS)


def measured(rng: np.random.Generator, n: int) -> np.ndarray:
    return fixed(SENSOR.measure(detections(rng, n)))


@births
def test_newborn_are_particles_and_repeat(birth, rng):
    keeps(Birth, birth)
    z, covered = measured(rng, 5), fixed(np.array([0.0, 0.3, 1.0, 2.0, 0.9]))
    a, b = (birth.sample(z, covered, SENSOR, 1.0, np.random.default_rng(3)) for _ in range(2))
    assert a.state.shape == (6, len(a))
    assert len(a) > 0
    assert np.isfinite(a.state).all()
    assert np.isfinite(a.weight).all()
    assert (a.weight >= 0).all()
    assert (a.state[4:6] > 0).all()
    np.testing.assert_array_equal(a.state, b.state)
    np.testing.assert_array_equal(a.weight, b.weight)


@births
def test_their_mass_follows_the_interval(birth, rng):
    z, covered = measured(rng, 5), np.zeros(5)
    one, three = (birth.sample(z, covered, SENSOR, dt, np.random.default_rng(3)).mass for dt in (1.0, 3.0))
    assert three == pytest.approx(3 * one)
    assert 0 < one < 1


@births
def test_no_measurements(birth, rng):
    born = birth.sample(np.zeros((4, 0)), np.zeros(0), SENSOR, 1.0, rng)
    assert born.state.shape == (6, len(born))
    assert (born.weight >= 0).all()


@clutters
def test_clutter_is_an_intensity(clutter, rng):
    keeps(Clutter, clutter)
    z = measured(rng, 20)
    kappa = clutter.intensity(z)
    assert kappa.shape == (20,)
    assert np.isfinite(kappa).all()
    assert (kappa >= 0).all()
    np.testing.assert_array_equal(clutter.intensity(z[:, :0]), np.zeros(0))
    np.testing.assert_array_equal(clutter.intensity(z[:, 5:7]), kappa[5:7])
