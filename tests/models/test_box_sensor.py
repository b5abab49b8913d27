"""The likelihoods of boxes, each scaling by its name, against SciPy's Gaussian; the gate against
what it may cut.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import chi2, multivariate_normal

from composed import gaussian_view
from phdtrack.errors import InputError
from phdtrack.models import BoxSensor
from phdtrack.types import Detections

SCALINGS = ["particle", "detection", "fixed", "given"]
ROWS = [0, 1, 4, 5]


def states(rng, n: int, smallest: float = 3.0) -> np.ndarray:
    size = rng.uniform(smallest, 120, (2, n))
    return np.vstack([rng.uniform(0, 640, (2, n)), rng.normal(0, 3, (2, n)), size])


def near(rng, x: np.ndarray, scaling: str) -> np.ndarray:
    z = x[ROWS] + rng.normal(0, 0.15, (4, x.shape[1])) * np.vstack([x[4:6], x[4:6]])
    z[2:] = np.maximum(z[2:], 1.0)
    return np.vstack([z, rng.uniform(1, 90, z.shape)]) if scaling == "given" else z


def deviations(sensor: BoxSensor, z, x) -> list[float]:
    """The deviations as the papers' words give them, for one pair."""
    if sensor.scaling == "fixed":
        position, size = sensor.fixed_noise
        return [position, position, size, size]
    if sensor.scaling == "given":
        return [math.sqrt(v) for v in z[4:8]]
    w, h = {"particle": x[4:6], "detection": z[2:4]}[sensor.scaling]
    sw = max(sensor.box_noise * w, sensor.min_noise)
    sh = max(sensor.box_noise * h, sensor.min_noise)
    return [sw / 2, sh / 2, sw, sh]


@pytest.mark.parametrize("floor", [0.0, 1.0, 6.0])
@pytest.mark.parametrize("scaling", SCALINGS)
def test_likelihood_is_the_named_gaussian(scaling: str, floor: float, rng):
    """With the normaliser, which differs from particle to particle."""
    sensor = BoxSensor(scaling=scaling, min_noise=floor, box_noise=0.2)
    x = states(rng, 25)
    z = near(rng, x, scaling)
    for i in range(25):
        cov = np.diag(np.square(deviations(sensor, z[:, i], x[:, i])))
        want = multivariate_normal.logpdf(z[:4, i], x[ROWS, i], cov)
        assert gaussian_view(sensor, z[:, [i]], x[:, [i]])[1] == pytest.approx(want, rel=1e-10)


@pytest.mark.parametrize("scaling", SCALINGS)
def test_states_at_rest_and_what_one_detection_tells(scaling: str, rng):
    sensor = BoxSensor(scaling=scaling)
    z = near(rng, states(rng, 6), scaling)
    x, cov = sensor.states(z)
    assert x.shape == (6, 6)
    assert cov.shape == (6, 6, 6)
    np.testing.assert_array_equal(x[ROWS], z[:4])
    assert not x[2:4].any()
    np.testing.assert_allclose(gaussian_view(sensor, z, x)[0], 0)
    for i in range(6):
        want = np.square(deviations(sensor, z[:, i], x[:, i]))
        np.testing.assert_allclose(np.diag(cov[i])[ROWS], want)
        amplitude = (
            sensor.birth_speed_pixels
            if scaling == "fixed"
            else sensor.birth_speed * math.sqrt(z[2, i] * z[3, i])
        )
        np.testing.assert_allclose(np.diag(cov[i])[2:4], amplitude**2 / 2)
        assert np.linalg.eigvalsh(cov[i]).min() > 0
    if scaling != "given":
        np.testing.assert_allclose(sensor.noise(x).T ** 2, np.diagonal(cov, axis1=1, axis2=2))
    assert sensor.noise(x).shape == x.shape
    assert sensor.boxes(x).shape == (6, 4)


def gate_of(sensor: BoxSensor) -> float:
    """Half the width of the gate in deviations."""
    return math.sqrt(chi2.ppf(sensor.gate_probability, 4))


def gated_out(sensor: BoxSensor, z, x) -> np.ndarray:
    lower, upper = sensor.gate(z)
    return np.any((x[:2] < lower) | (x[:2] > upper), axis=0)


@pytest.mark.parametrize("floor", [0.0, 1.0, 4.0])
@pytest.mark.parametrize("spread", [0.05, 0.15, 0.19])
@pytest.mark.parametrize("scaling", ["particle", "detection", "fixed", "given"])
def test_no_pair_within_the_gate_is_dropped(scaling: str, spread: float, floor: float, rng):
    """Nothing at Mahalanobis distance ≤ G in position and size is cut, also where σ follows a size
    that z does not show.
    """
    sensor = BoxSensor(scaling=scaling, box_noise=spread, min_noise=floor)
    x = states(rng, 30_000)
    direction = rng.normal(size=(4, 30_000))
    # On the rim of the ball, where it bulges most: mostly in x and w, sometimes anywhere.
    direction[[1, 3], :20_000] *= 0.01
    direction[0, :20_000] *= rng.uniform(0.2, 5, 20_000)
    direction *= gate_of(sensor) / np.linalg.norm(direction, axis=0) * rng.uniform(0.9, 1.0, 30_000)
    if scaling == "detection":
        # σ is the detection's: go from z to x.
        z = x[ROWS].copy()
        sigma = sensor.noise(x)[ROWS]
        x[ROWS] = z - direction * sigma
    elif scaling == "given":
        z = np.vstack([x[ROWS], rng.uniform(1, 90, (4, 30_000))])
        x[ROWS] -= direction * np.sqrt(z[4:])
    else:
        z = x[ROWS] + direction * sensor.noise(x)[ROWS]
    assert gaussian_view(sensor, z, x)[0].max() <= gate_of(sensor) ** 2 * (1 + 1e-9)
    assert not gated_out(sensor, z, x).any()


def test_the_gate_around_a_particle_is_as_tight_as_it_can_be(rng):
    """At the worst pair of position and size, sin θ = G·s, the formula's edge is reached."""
    sensor = BoxSensor(box_noise=0.15, min_noise=0.0)
    g = gate_of(sensor)
    s = sensor.box_noise
    w = 40.0
    sine = g * s
    cosine = math.sqrt(1 - sine**2)
    z = np.array([[0.0], [0.0], [w * (1 - g * s * sine)], [50.0]])
    x = np.array([[g * s * w / 2 * cosine], [0.0], [0.0], [0.0], [w], [50.0]])
    assert gaussian_view(sensor, z, x)[0][0] == pytest.approx(g**2)
    assert sensor.gate(z)[1][0, 0] == pytest.approx(x[0, 0])
    assert sensor.gate(z)[1][0, 0] / z[2, 0] == pytest.approx(0.567, abs=5e-4)


def test_measurements_and_given_covariances():
    boxes = np.array([[10.0, 20, 30, 60], [0, 0, 4, 8]])
    found = Detections(
        boxes, np.ones(2), np.zeros(2, np.int64), np.stack([np.diag([1.0, 2, 3, 4])] * 2)
    )
    np.testing.assert_array_equal(BoxSensor().measure(found), [[20, 2], [40, 4], [20, 4], [40, 8]])
    z = BoxSensor(scaling="given").measure(found)
    np.testing.assert_array_equal(z[4:], [[1, 1], [2, 2], [3, 3], [4, 4]])
    with pytest.raises(InputError, match="covariance"):
        BoxSensor(scaling="given").measure(Detections.of(boxes))
    x, _ = BoxSensor().states(BoxSensor().measure(found))
    np.testing.assert_allclose(BoxSensor().boxes(x), boxes)


@pytest.mark.parametrize("variance", [0.0, -1.0])
def test_a_given_covariance_needs_variances_above_zero(variance: float):
    boxes = np.array([[0.0, 0, 10, 20]])
    found = Detections(
        boxes, np.ones(1), np.zeros(1, np.int64), np.diag([1.0, 1, variance, 1])[None]
    )
    with pytest.raises(InputError, match="variances above 0"):
        BoxSensor(scaling="given").measure(found)
