"""As many peaks as the distribution of the number of targets says."""

from __future__ import annotations

import numpy as np
import pytest
from extract_cases import HERE, MODEL, THERE, cloud, moved, seen, together

from phdtrack.errors import InputError
from phdtrack.filters.extract import CountedComponents, CountedKMeans, CountedMixture
from phdtrack.filters.extract.counted import expected, united
from phdtrack.filters.intensities import Cardinalised
from phdtrack.types import Estimates, GaussianMixture, Particles

# The most probable number is 2, the mean 2.6.
NUMBER = np.array([0.0, 0.1, 0.5, 0.2, 0.1, 0.1])
MEAN = np.stack([HERE, THERE, moved(900)], axis=1)
WEIGHT = np.array([0.3, 1.0, 0.9])


def held(kind: str, rng, number: np.ndarray = NUMBER) -> Cardinalised:
    if kind == "components":
        return Cardinalised(GaussianMixture(WEIGHT, MEAN, np.tile(np.eye(6), (3, 1, 1))), number)
    clouds: Particles = together(*(cloud(rng, x, w) for x, w in zip(MEAN.T, WEIGHT, strict=True)))
    return Cardinalised(clouds, number)


@pytest.mark.parametrize("kind", ["components", "kmeans", "mixture"])
def test_the_heaviest_as_many_as_there_are(kind: str, rng):
    extractor = {"components": CountedComponents, "kmeans": CountedKMeans, "mixture": CountedMixture}[kind]
    state, z = held(kind, rng), seen(HERE, THERE, moved(900))
    two = extractor().extract(state, z, MODEL)
    np.testing.assert_allclose(np.sort(two.state[0]), np.sort(MEAN[0, 1:]), atol=3)
    assert sorted(two.detection.tolist()) == [1, 2]
    three = extractor(count="eap").extract(state, z, MODEL)
    assert len(three) == 3
    assert np.sort(three.weight)[0] == pytest.approx(0.3, abs=1e-3)
    alone = held(kind, rng, np.array([1.0]))
    assert len(extractor().extract(alone, z, MODEL)) == 0
    # There are no more states than peaks.
    assert len(extractor().extract(held(kind, rng, np.eye(9)[8]), z, MODEL)) == 3


def test_what_is_near_a_heavier_component_is_part_of_it(rng):
    """The covariance of the heaviest decides; the detection may be that of a part."""
    state = np.stack([HERE, moved(1.5), moved(4), THERE], axis=1)
    boxes, weight = MODEL.sensor.boxes(state), np.array([0.2, 0.6, 0.3, 0.5])
    cov = np.stack([9 * np.eye(6), np.eye(6), 9 * np.eye(6), np.eye(6)])
    found = united(Estimates(state, cov, weight, boxes, np.array([3, -1, 2, 1])), 2.0, MODEL.sensor)
    np.testing.assert_allclose(found.weight, [0.8, 0.5, 0.3])
    np.testing.assert_allclose(found.state[0], [HERE[0] + 0.6 * 1.5 / 0.8, THERE[0], HERE[0] + 4])
    np.testing.assert_array_equal(found.detection, [3, 1, 2])
    np.testing.assert_allclose(found.xyxy, MODEL.sensor.boxes(found.state))
    assert len(united(Estimates.empty(6), 2.0, MODEL.sensor)) == 0


def test_ties_and_rounding():
    assert expected(np.array([0.4, 0.2, 0.4]), "map") == 0
    assert expected(np.array([0.4, 0.2, 0.4]), "eap") == 1
    assert expected(np.ones(1), "map") == expected(np.ones(1), "eap") == 0


@pytest.mark.parametrize("kind", [CountedComponents, CountedKMeans, CountedMixture])
def test_settings_out_of_bounds(kind):
    for wrong in ({"candidate": 0.0}, {"merge_iou": 2.0}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            kind(**wrong)
