"""States that no sensor could tell apart are joined, and nothing is lost in it."""

from __future__ import annotations

import numpy as np
from extract_cases import HERE, MODEL, moved
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack.arrays import iou
from phdtrack.filters.extract import join_unresolved
from phdtrack.kernels.mixtures import Gaussians
from reference import clustering_twin as twin


def random_clusters(rng, k: int, width: float):
    mean = np.array(
        [
            moved(*rng.uniform(0, width, 2), *rng.normal(0, 1, 2), *rng.uniform(-8, 8, 2))
            for _ in range(k)
        ]
    )
    root = rng.normal(size=(k, 6, 6))
    return rng.uniform(0.5, 2, k), mean.reshape(k, 6).T.copy(), root @ root.transpose(0, 2, 1)


def total_moments(mass, mean, cov):
    """Of the sum of the clusters: ∫, ∫x, ∫xxᵀ."""
    second = sum(
        (w * (c + np.outer(m, m)) for w, m, c in zip(mass, mean.T, cov, strict=True)),
        np.zeros((6, 6)),
    )
    return mass.sum(), (mass * mean).sum(1), second


@given(
    st.integers(0, 2**32 - 1),
    st.integers(0, 8),
    st.sampled_from([5.0, 60.0, 400.0]),
    st.sampled_from([0.2, 0.5, 1.0]),
)
@settings(max_examples=80, deadline=None)
def test_mass_and_moments_are_kept_and_no_two_overlap(
    seed: int, k: int, width: float, overlap: float
):
    mass, mean, cov = given_clusters = random_clusters(np.random.default_rng(seed), k, width)
    for array in given_clusters:
        array.flags.writeable = False
    joined, part = join_unresolved(Gaussians(mass, mean, cov), MODEL.sensor, overlap)
    want = (
        twin.join_alike(MODEL.sensor.boxes(mean), overlap, mass, mean, cov)
        if k
        else ([], [], [], [])
    )
    np.testing.assert_array_equal(part, want[3])
    np.testing.assert_allclose(joined.weight, want[0], rtol=1e-12)
    for was, now in zip(total_moments(*given_clusters), total_moments(*joined), strict=True):
        np.testing.assert_allclose(now, was, rtol=1e-9, atol=1e-6)
    boxes = MODEL.sensor.boxes(joined[1])
    assert np.triu(iou(boxes, boxes), 1).max(initial=0) <= overlap
    if overlap == 1:
        assert len(joined[0]) == k


def test_the_most_overlapping_go_first():
    """In a row of three, the nearer two are joined; their union then leaves the third alone."""
    row = np.array([HERE, moved(4), moved(24)]).T.copy()
    (mass, mean, _), _ = join_unresolved(
        Gaussians(np.ones(3), row, np.stack([np.eye(6)] * 3)), MODEL.sensor, 0.3
    )
    np.testing.assert_array_equal(mass, [2, 1])
    np.testing.assert_allclose(mean[0], [302, 324])
