"""Components of graphs, and tracks that compete for measurements."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack.kernels.linkage import competing, components
from reference import hypotheses_twin as twins


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=100, deadline=None)
def test_components(seed: int):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 15))
    first, second = rng.integers(0, count, (2, int(rng.integers(0, 15))))
    np.testing.assert_array_equal(components(count, first, second), twins.components(count, first, second))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=100, deadline=None)
def test_competing_tracks(seed: int):
    rng = np.random.default_rng(seed)
    forms, window, tracks = int(rng.integers(1, 12)), int(rng.integers(1, 4)), int(rng.integers(1, 6))
    leaf = rng.integers(-1, forms, (int(rng.integers(1, 5)), tracks))
    # A form belongs to one track.
    leaf = np.where(leaf % tracks == np.arange(tracks), leaf, -1)
    trace = np.where(rng.random((forms, window)) < 0.5, rng.integers(0, 5, (forms, window)), -1)
    np.testing.assert_array_equal(competing(leaf, trace, 5), twins.competing(leaf, trace))
