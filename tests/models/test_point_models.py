"""Point targets: the motion's draws and covariances, D14's numbers, the sensor, births in the
image.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from composed import gaussian_view
from phdtrack import config
from phdtrack.models import PointBirth, PointMotion, PointSensor, UniformBirth
from phdtrack.types import Detections, SequenceInfo

INFO = SequenceInfo(384, 288, 25.0)


def test_measurement_is_the_centroid_without_further_rows():
    sensor = PointSensor(noise_variance=2.0, size=(8.0, 12.0))
    z = sensor.measure(Detections.of([[10.0, 20, 20, 60]]))
    np.testing.assert_array_equal(z, [[15.0], [40.0]])
    labelled = np.vstack([z, [[7.0]]])
    x = np.array([[14.0], [42.0], [3.0], [1.0]])
    np.testing.assert_allclose(
        gaussian_view(sensor, labelled, x), [[(1 + 4) / 2], [-1.25 - math.log(4 * math.pi)]]
    )
    np.testing.assert_array_equal(sensor.innovation(labelled, x[:2]), [[1.0], [-2.0]])
    np.testing.assert_array_equal(sensor.states(labelled)[0], [[15.0], [40.0], [0.0], [0.0]])
    np.testing.assert_array_equal(sensor.boxes(x), [[10.0, 36, 18, 48]])


def test_uniform_births_of_points_have_no_size(rng):
    """D14's ten, anywhere in the image, of any direction; they fill it evenly."""
    birth = UniformBirth((384.0, 288.0), births_per_second=0.2, particles=20_000)
    born = birth.sample(np.zeros((3, 1)), np.zeros(1), PointSensor(birth_speed=2.0), 0.5, rng)
    assert born.state.shape == (4, 20_000)
    assert born.mass == pytest.approx(0.1)
    place = born.state[:2] / np.array([[384.0], [288.0]])
    assert ((place >= 0) & (place < 1)).all()
    assert np.histogramdd(place.T, 4, [(0, 1), (0, 1)])[0].min() > 20_000 / 16 * 0.85
    np.testing.assert_allclose(born.state[2:].var(axis=1), 2.0, rtol=0.1)


def test_the_preset_is_d14s():
    """p_D = p_S = 1, no clutter, J = 10 newborn anywhere, N particles for each target, no update
    without detections.
    """
    stages = config.build(
        config.load(preset="d14", sets=["filter.particles_per_target=500"]),
        INFO,
    )
    model = stages.model
    recursion = stages.filter
    rng = np.random.default_rng(3)
    z = np.array([[100.0, 250], [100, 200]])
    near = np.vstack([np.repeat(z, 50, axis=1), np.zeros((2, 100))])
    state = type(recursion.start(model, rng))(near, np.full(100, 0.02))
    after, info = recursion.step(state, z, model, 1.0, rng)
    assert len(after) == 1000
    assert (info.mass, after.mass) == pytest.approx((2.0, 2.0))
    assert info.mass_predicted == pytest.approx(2.1)
    np.testing.assert_array_equal(info.clutter, 0.0)
    # Nothing is updated where nothing is detected: ten more particles, and what was there.
    predicted = recursion.predict(after, model, 1.0, rng)
    assert predicted.mass == pytest.approx(2.0)
    waiting, info = recursion.update(predicted, z[:, :0], model, 1.0, rng)
    assert len(waiting) == 1010
    assert waiting.mass == pytest.approx(2.1)
    assert len(recursion.reduce(waiting, rng)) == 1050


@pytest.mark.parametrize(
    "filter_name", ["pmb", "gm-phd", "gm-cphd", "particle-cphd", "particle-phd", "none"]
)
def test_every_filter_can_do_with_points(filter_name: str, rng):
    """Two points seen for fifteen frames among clutter are found; the world brings its own
    parts.
    """
    stages = config.build(config.load(sets=["motion.kind=point"]), INFO, filter_name)
    assert (type(stages.model.motion), type(stages.model.sensor), type(stages.model.birth)) == (
        PointMotion,
        PointSensor,
        PointBirth,
    )
    np.testing.assert_allclose(stages.model.clutter.intensity(np.zeros((2, 1))), 1.0 / (384 * 288))
    state = stages.filter.start(stages.model, rng)
    for k in range(15):
        z = (
            np.array([[100.0, 200], [50, 150]])
            + k * np.array([[1.0, -1], [0.5, 0]])
            + rng.normal(0, 1, (2, 2))
        )
        z = np.hstack([z, rng.uniform([[0], [200]], [[384], [288]], (2, 1))])
        state, _ = stages.filter.step(state, z, stages.model, 1.0, rng)
        found = stages.extractor.extract(state, z, stages.model)
    true = np.array([[114.0, 186], [57, 150]])
    distance = np.hypot(*(found.state[:2, :, None] - true[:, None, :]))
    assert (distance.min(axis=0) < 4).all()
    assert len(found) == (3 if filter_name == "none" else 2)
