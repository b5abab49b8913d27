"""Clusters with overlapping boxes, joined by the kernel and by looking at all pairs again after every union."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack.kernels.joining import likeness
from phdtrack.kernels.unresolved import join_alike
from reference import clustering_twin as twin


@given(
    st.integers(0, 2**32 - 1), st.integers(1, 30), st.sampled_from([20.0, 100.0, 400.0]), st.sampled_from([0.0, 0.2, 0.4])
)
@settings(max_examples=60, deadline=None)
def test_unions(seed: int, k: int, width: float, overlap: float):
    rng = np.random.default_rng(seed)
    corner = rng.uniform(0, width, (k, 2))
    boxes = np.hstack([corner, corner + rng.choice([10.0, 30.0, 60.0], (k, 2))])
    mass, mean, root = rng.uniform(0.1, 2, k), rng.normal(size=(3, k)), rng.normal(size=(k, 3, 3))
    cov = root @ root.transpose(0, 2, 1)
    pairs = likeness(boxes, overlap)
    given_arrays = (*pairs, boxes, mass, mean, cov)
    for array in given_arrays:
        array.flags.writeable = False
    found = join_alike(*pairs, boxes, overlap, mass, mean, cov)
    weight, centre, spread, part = twin.join_alike(boxes, overlap, mass, mean, cov)
    np.testing.assert_allclose(found[0], weight, rtol=1e-12)
    np.testing.assert_allclose(found[1].T, centre, atol=1e-12)
    np.testing.assert_allclose(found[2], spread, atol=1e-12)
    np.testing.assert_array_equal(found[3], part)
