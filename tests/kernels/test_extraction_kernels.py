"""Blocks, what lies outside of all windows, who is served first: against plain loops."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from inner_kernels import from_python
from phdtrack.filters.extract.cloud import Cloud
from phdtrack.kernels.blocks import cut
from phdtrack.kernels.clustering import outside
from phdtrack.kernels.joining import claim, meeting, nearest_first, serve
from phdtrack.kernels.nearest import ROOM
from phdtrack.kernels.overlaps import rectangle_grid
from phdtrack.types import ParticleBlocks

[nearest_first] = from_python(nearest_first)

seeds = st.integers(0, 2**32 - 1)


@given(seeds, st.integers(1, 60), st.integers(1, 8), st.sampled_from([1.0, 1e6]))
@settings(max_examples=40, deadline=None)
def test_cut_keeps_every_particle_in_small_blocks(seed: int, count: int, most: int, outlier: float):
    rng = np.random.default_rng(seed)
    state, weight = rng.normal(0, 30, (3, count)), rng.exponential(size=count)
    state[0, 0] *= outlier
    x, w, start = cut(state, weight, most)
    assert start[0] == 0
    assert start[-1] == count
    assert np.diff(start).min() >= 1
    assert np.diff(start).max() <= most
    before, after = np.vstack([state, weight]), np.vstack([x, w])
    np.testing.assert_array_equal(before[:, np.lexsort(before)], after[:, np.lexsort(after)])


@given(seeds, st.integers(0, 8), st.integers(1, 9))
@settings(max_examples=40, deadline=None)
def test_who_lies_outside_and_what_meets(seed: int, count: int, most: int):
    rng = np.random.default_rng(seed)
    state, _, start = cut(rng.uniform(0, 100, (2, 60)), np.ones(60), most)
    known = Cloud.of(ParticleBlocks(state, start, 1.0)).known
    at, half = rng.uniform(0, 100, (2, count)), rng.uniform(0, 40, (2, count))
    lower, upper = known[:, 1:3].T.copy(), known[:, 3:5].T.copy()

    def met(times: float) -> list[tuple[int, int]]:
        low, high = at - times * half, at + times * half
        apart = (low[:, :, None] > upper[:, None]) | (high[:, :, None] < lower[:, None])
        return [(int(i), int(j)) for i, j in np.argwhere(~apart.any(0))]

    assert list(zip(*meeting(at - half, at + half, lower, upper), strict=True)) == met(1.0)
    grid = (lower, upper, *rectangle_grid(lower, upper))
    out, head, link, used = outside(state, start, known, most, *grid, at, 0.5 * half, 2.0)
    inside = (np.abs(state[:, :, None] - at[:, None]) <= half[:, None]).all(0).any(1)
    np.testing.assert_array_equal(out, np.flatnonzero(~inside))
    filed = []
    for b, first in enumerate(head):
        while first >= 0:
            filed.append((link[0, first], b))
            first = link[1, first]
    assert sorted(filed) == met(ROOM)
    assert used == len(filed)


@given(seeds, st.integers(0, 70), st.sampled_from([1, 10, 10**9]))
@settings(max_examples=40, deadline=None)
def test_nearest_first(seed: int, count: int, kinds: int):
    """As a stable sort has it, few and many, with and without equal ones."""
    distance2 = np.random.default_rng(seed).integers(0, kinds, count) / 7.0
    order = np.empty(count, np.int64)
    nearest_first(np.append(distance2, 0.0), order)
    np.testing.assert_array_equal(order, distance2.argsort(kind="stable"))


@given(seeds, st.integers(0, 9), st.integers(0, 9))
@settings(max_examples=40, deadline=None)
def test_a_detection_serves_one_cluster_the_closest_first(seed: int, k: int, detections: int):
    rng = np.random.default_rng(seed)
    which, point = (i.ravel() for i in np.indices((detections, k)))
    distance2 = rng.integers(0, 12, which.size) / 3.0
    floor, cov = rng.uniform(0, 3, (2, k)), rng.normal(size=(k, 2, 2))
    seen, floored = serve(which, point, distance2, 2.5, floor, detections, cov)
    want: dict[int, int] = {}
    for d2, z, j in sorted(zip(distance2, which.tolist(), point.tolist(), strict=True)):
        if d2 <= 2.5 and j not in want and z not in want.values():
            want[j] = z
    np.testing.assert_array_equal(seen, [want.get(j, -1) for j in range(k)])
    diagonal = np.array([np.diag((0.1 * f) ** 2) for f in floor.T]).reshape(k, 2, 2)
    np.testing.assert_allclose(floored - cov, diagonal, atol=1e-12)


def test_claims():
    x, weight = np.array([[0.0, 1, 2, 10, 11]]), np.array([1.0, 1, 2, 1, 0])
    # The second asks for what the first has; the third for the rest.
    point, which = np.array([0, 1, 1, 2, 2, 3, 4]), np.array([0, 0, 1, 1, 2, 2, 2])
    claimed, centre = np.zeros(5, bool), np.empty((1, 3))
    assert claim(x, weight, np.array([0, 1, 3]), which, point, claimed, centre) == 2
    np.testing.assert_allclose(centre[:, :2], [[0.5, (2 * 2 + 10) / 3]])
    np.testing.assert_array_equal(claimed, True)
