"""Heavy components of a mixture as states."""

from __future__ import annotations

import numpy as np

from phdtrack.filters.extract import Components
from phdtrack.models import BoxMotion, BoxSensor, MeasurementBirth, UniformClutter
from phdtrack.protocols import Model
from phdtrack.types import GaussianMixture

MODEL = Model(
    BoxMotion(), BoxSensor(), MeasurementBirth(births_per_detection=0.25), UniformClutter(1.0, 1e10)
)
MEAN = np.array(
    [
        [100.0, 100, 2, 0, 40, 80],
        [300, 120, 0, 1, 40, 80],
        [306, 120, 0, 1, 40, 80],
        [500, 90, 0, 0, 30, 70],
    ]
).T
MIXTURE = GaussianMixture(np.array([0.9, 2.2, 0.6, 0.49]), MEAN, np.tile(np.eye(6), (4, 1, 1)))
Z = MEAN[[0, 1, 4, 5]][:, [1, 0]] + 1.0


def test_components_of_half_a_target_or_more_are_states():
    found = Components(merge_iou=1.0).extract(MIXTURE, Z, MODEL)
    np.testing.assert_array_equal(found.state, MEAN[:, :3])
    np.testing.assert_array_equal(found.weight, MIXTURE.weight[:3])
    np.testing.assert_array_equal(found.detection, [1, 0, -1])
    np.testing.assert_allclose(found.xyxy[0], [80, 60, 120, 140])
    assert len(Components(min_weight=0.3, merge_iou=1.0).extract(MIXTURE, Z, MODEL)) == 4


def test_those_that_no_sensor_could_tell_apart_are_one():
    found = Components().extract(MIXTURE, Z, MODEL)
    np.testing.assert_allclose(found.weight, [0.9, 2.8])
    np.testing.assert_allclose(found.state[0], [100, (2.2 * 300 + 0.6 * 306) / 2.8])


def test_repeated_as_vo_and_ma_do():
    """Each as often as its rounded weight; the mass is shared, and a detection serves one of
    them.
    """
    found = Components(repeat=True).extract(MIXTURE, Z, MODEL)
    np.testing.assert_array_equal(found.state, MEAN[:, [0, 1, 1, 2]])
    np.testing.assert_allclose(found.weight, [0.9, 1.1, 1.1, 0.6])
    assert sorted(found.detection.tolist()) == [-1, -1, 0, 1]
    halves = GaussianMixture(np.full(4, 0.5), MEAN, MIXTURE.covariance)
    assert len(Components(repeat=True).extract(halves, Z, MODEL)) == 4
