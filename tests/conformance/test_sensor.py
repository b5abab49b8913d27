"""What every sensor must do."""

from __future__ import annotations

import numpy as np
import pytest
from shipped import SENSORS, detections, fixed, frozen, keeps

from composed import gaussian_view
from phdtrack.kernels.mcmc import pair_likelihoods
from phdtrack.protocols import Sensor
from phdtrack.types import Detections

pytestmark = pytest.mark.parametrize("sensor", SENSORS.values(), ids=SENSORS)


@pytest.fixture
def found(rng):
    return frozen(detections(rng, 30))


@pytest.fixture
def z(sensor, found):
    return fixed(sensor.measure(found))


def root(sensor, z, x) -> np.ndarray:
    """(n, r, r) Cholesky factors of the noise."""
    return np.linalg.cholesky(sensor.covariance(z, x))


def test_signatures(sensor):
    keeps(Sensor, sensor)
    assert sensor.observed == (0, 1, *sensor.observed[2:]), "rows 0 and 1 are the position"


def test_measurements_are_columns(sensor, z):
    assert z.shape[1] == 30
    assert len(z) >= len(sensor.observed)
    assert sensor.measure(Detections.empty()).shape == (len(z), 0)


def test_a_state_made_of_a_measurement_predicts_it(sensor, z, found, rng):
    x, cov = sensor.states(z)
    d = len(x)
    assert x.shape == (d, 30)
    assert cov.shape == (30, d, d)
    assert np.linalg.eigvalsh(cov).min() > 0
    np.testing.assert_allclose(gaussian_view(sensor, z, x)[0], 0, atol=1e-18)
    if sensor.linear:
        np.testing.assert_allclose(x[list(sensor.observed)], z[: len(sensor.observed)])
    np.testing.assert_allclose(sensor.measure(detections(rng, 0)), np.zeros((len(z), 0)))
    boxes = sensor.boxes(x)
    assert boxes.shape == (30, 4)
    again = Detections(boxes, found.confidence, found.class_id, found.covariance)
    rows = len(sensor.observed)
    np.testing.assert_allclose(sensor.measure(again)[:rows], z[:rows], rtol=1e-9, atol=1e-9)


def test_state_of_a_measurement_predicts_that_measurement(sensor, z):
    x, _ = sensor.states(z)
    seen = fixed(sensor.predicted_measurements(x))
    np.testing.assert_allclose(seen, z[: len(seen)], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(sensor.innovation(z, seen), 0, atol=1e-12)
    np.testing.assert_array_equal(sensor.innovation(seen[:, :, None], seen[:, None, :])[:, 3, 3], 0)
    if sensor.linear:
        np.testing.assert_array_equal(seen, x[list(sensor.observed)])


def test_the_likelihood_is_a_density(sensor, z, rng):
    """Its integral over measurements about one state is 1, by importance sampling with twice the
    noise.
    """
    x, _ = sensor.states(z[:, :1])
    centre = sensor.predicted_measurements(x)
    n = 40000
    r = len(centre)
    wide = 2 * root(sensor, z[:, :1], x)[0]
    step = rng.standard_normal((r, n))
    drawn = np.vstack([centre + wide @ step, np.repeat(z[r:, :1], n, axis=1)])
    proposal = -0.5 * (step**2).sum(0) - np.linalg.slogdet(wide)[1] - 0.5 * r * np.log(2 * np.pi)
    weight = np.exp(gaussian_view(sensor, drawn, np.repeat(x, n, axis=1))[1] - proposal)
    # The detection's own size scales the noise of one sensor: as a function of z it is no density
    # then.
    if sensor is not SENSORS["detection"]:
        assert weight.mean() == pytest.approx(1, abs=0.05)


def test_the_gate_holds_what_is_likely(sensor, z, rng):
    """No state within a deviation in every component is outside of the gate."""
    lower, upper = sensor.gate(z)
    assert lower.shape == upper.shape == (2, 30)
    x, cov = sensor.states(z)
    rows = list(sensor.observed)
    deviation = np.sqrt(
        np.einsum("jrr->rj", sensor.covariance(z, x) if sensor.linear else cov[:, rows][:, :, rows])
    )
    for _ in range(200):
        near = x.copy()
        near[rows] += rng.uniform(-1, 1, (len(rows), 30)) * deviation
        assert ((near[:2] >= lower) & (near[:2] <= upper)).all()


def test_the_gaussian_view_has_the_likelihood_of_a_known_state(sensor, z, rng):
    """N(z; h(x), R) is the g(z|x) of the particle filters, which for boxes have single
    precision.
    """
    x, _ = sensor.states(z)
    x = fixed(x + rng.normal(0, 1, x.shape))
    r = sensor.covariance(z, x)
    seen = sensor.predicted_measurements(x)
    many = len(seen)
    assert r.shape == (30, many, many)
    numbers = sensor.particle_model(z)
    column = np.arange(30)
    distance2, likelihood = pair_likelihoods(x, numbers.model, numbers.table, column, column)
    wanted, log = gaussian_view(sensor, z, x)
    np.testing.assert_allclose(distance2, wanted, rtol=1e-3)
    np.testing.assert_allclose(likelihood, np.exp(log), rtol=1e-3, atol=1e-300)
    assert sensor.covariance(z[:, :0], x[:, :0]).shape == (0, many, many)


def test_detection_probability_and_noise(sensor, z):
    x, _ = sensor.states(z)
    p = sensor.p_detect(fixed(x))
    assert p.shape == (30,)
    assert ((p >= 0) & (p <= 1)).all()
    noise = sensor.noise(x)
    assert noise.shape == x.shape
    assert (noise > 0).all()


def test_watching_lowers_detection_probability_only(sensor, z, found):
    x, _ = sensor.states(z)
    watching = sensor.watching(x)
    keeps(Sensor, watching)
    fewer = watching.p_detect(x)
    assert ((fewer >= 0) & (fewer <= sensor.p_detect(x) + 1e-15)).all()
    np.testing.assert_array_equal(watching.measure(found), z)
    np.testing.assert_array_equal(watching.covariance(z, x), sensor.covariance(z, x))
    np.testing.assert_array_equal(sensor.watching(x[:, :0]).p_detect(x), sensor.p_detect(x))
    order = np.random.default_rng(1).permutation(30)
    np.testing.assert_array_equal(sensor.watching(x[:, order]).p_detect(x), fewer)
    assert sensor.occlusion or watching is sensor


def test_nothing_is_measured_of_nothing(sensor, z):
    none = z[:, :0]
    x, cov = sensor.states(none)
    assert x.shape[1] == len(cov) == len(sensor.p_detect(x)) == len(sensor.boxes(x)) == 0
    assert sensor.gate(none)[0].shape == (2, 0)
    assert sensor.noise(x).shape == x.shape
