"""Light clusters that are near each other, and boxes that overlap: against all pairs."""

from __future__ import annotations

import numpy as np
import pytest
from extract_cases import MODEL
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack.boxes import iou
from phdtrack.extract.joining import join_light
from phdtrack.extract.resolution import _overlapping
from reference import clustering_twin as twin

random_seeds = st.integers(0, 2**32 - 1)


@given(random_seeds, st.integers(0, 14))
@settings(max_examples=60, deadline=None)
def test_light_clusters_are_joined_nearest_first(seed: int, count: int):
    rng = np.random.default_rng(seed)
    mean = np.vstack([rng.uniform(0, 120, (2, count)), np.zeros((2, count)), rng.uniform(30, 60, (2, count))])
    mass, noise = rng.uniform(0, 1, count), MODEL.sensor.noise
    root = join_light(mass, mean, MODEL.sensor, twin.REACH, 0.6, 1.5)
    want = twin.join_light(mass, mean, noise, 0.6, 1.5)
    np.testing.assert_array_equal(root, want)


@given(random_seeds, st.integers(2, 12), st.sampled_from([0.0, 0.3]))
@settings(max_examples=40, deadline=None)
def test_boxes_that_overlap(seed: int, count: int, above: float):
    rng = np.random.default_rng(seed)
    corner = rng.uniform(0, 100, (count, 2))
    boxes = np.hstack([corner, corner + rng.choice([0.0, 20.0, 60.0], (count, 2))])
    table = iou(boxes, boxes)
    want = {(i, j): pytest.approx(table[i, j]) for i in range(count) for j in range(i + 1, count) if table[i, j] > above}
    first, second, shared = _overlapping(boxes, above)
    assert dict(zip(zip(first.tolist(), second.tolist(), strict=True), shared.tolist(), strict=True)) == want
