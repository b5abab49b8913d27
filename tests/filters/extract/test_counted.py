"""As many peaks as the distribution of the number of targets says."""

from __future__ import annotations

import numpy as np
import pytest
from extract_cases import HERE, MODEL, THERE, cloud, moved, seen, together

from phdtrack.filters.cardinality import Cardinalised
from phdtrack.filters.extract import Components, KMeans, Mixture, heaviest, united
from phdtrack.types import Estimates, GaussianMixture, Particles

# The most probable number is 2.
NUMBER = np.array([0.0, 0.1, 0.5, 0.2, 0.1, 0.1])
MEAN = np.stack([HERE, THERE, moved(900)], axis=1)
WEIGHT = np.array([0.3, 1.0, 0.9])


def held(kind: type, rng, number: np.ndarray = NUMBER) -> Cardinalised:
    if kind is Components:
        return Cardinalised(GaussianMixture(WEIGHT, MEAN, np.tile(np.eye(6), (3, 1, 1))), number)
    clouds: Particles = together(*(cloud(rng, x, w) for x, w in zip(MEAN.T, WEIGHT, strict=True)))
    return Cardinalised(clouds, number)


@pytest.mark.parametrize("kind", [Components, KMeans, Mixture])
def test_the_heaviest_as_many_as_there_are(kind: type, rng):
    state = held(kind, rng)
    z = seen(HERE, THERE, moved(900))
    two = kind().extract(state, z, MODEL)
    np.testing.assert_allclose(np.sort(two.state[0]), np.sort(MEAN[0, 1:]), atol=3)
    assert sorted(two.detection.tolist()) == [1, 2]
    three = kind().extract(Cardinalised(state.intensity, np.eye(4)[3]), z, MODEL)
    assert np.sort(three.weight)[0] == pytest.approx(0.3, abs=1e-3)
    assert len(kind().extract(Cardinalised(state.intensity, np.ones(1)), z, MODEL)) == 0
    # There are no more states than peaks.
    assert len(kind().extract(Cardinalised(state.intensity, np.eye(9)[8]), z, MODEL)) == 3


def test_what_is_near_a_heavier_component_is_part_of_it(rng):
    """The covariance of the heaviest decides; the detection may be that of a part."""
    state = np.stack([HERE, moved(1.5), moved(4), THERE], axis=1)
    boxes = MODEL.sensor.boxes(state)
    weight = np.array([0.2, 0.6, 0.3, 0.5])
    cov = np.stack([9 * np.eye(6), np.eye(6), 9 * np.eye(6), np.eye(6)])
    found = united(Estimates(state, cov, weight, boxes, np.array([3, -1, 2, 1])), MODEL.sensor)
    np.testing.assert_allclose(found.weight, [0.8, 0.5, 0.3])
    np.testing.assert_allclose(found.state[0], [HERE[0] + 0.6 * 1.5 / 0.8, THERE[0], HERE[0] + 4])
    np.testing.assert_array_equal(found.detection, [3, 1, 2])
    np.testing.assert_allclose(found.xyxy, MODEL.sensor.boxes(found.state))
    assert len(united(Estimates.empty(6), MODEL.sensor)) == 0


def test_of_equally_probable_numbers_the_smaller_one():
    assert len(heaviest(Estimates.empty(6), np.array([0.4, 0.2, 0.4]))) == 0
