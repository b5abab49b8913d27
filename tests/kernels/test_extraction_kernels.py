"""Blocks and their sums, clusters that are joined, who is served first, the box sensor's answers: against plain loops."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from inner_kernels import from_python
from phdtrack.kernels.blocks import cut, summarise
from phdtrack.kernels.box import box_corners, box_gate, box_noise, resting
from phdtrack.kernels.clustering import cluster_moments, outside
from phdtrack.kernels.em import block_moments, whitening
from phdtrack.kernels.joining import claim, meeting
from phdtrack.kernels.kmeans import kmeans
from phdtrack.kernels.nearest import CENTRE, MASS, MIXED
from phdtrack.kernels.overlaps import rectangle_grid
from reference import clustering_twin as twin

[whitening] = from_python(whitening)

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


def known_of(state, weight, start):
    """(B, 1 + 4d) what is known of the blocks, and the particles in the largest."""
    known, box = np.full((len(start) - 1, 1 + 4 * len(state)), np.nan), np.empty(2, state.dtype)
    integer = np.int32 if state.itemsize == 4 else np.int64
    most = summarise(state, state.view(integer), weight, start, known, box, box.view(integer))
    return known, most


@given(seeds, st.integers(1, 8), st.sampled_from([np.float32, np.float64]), st.booleans())
@settings(max_examples=40, deadline=None)
def test_summaries_of_blocks(seed: int, d: int, kind: type, equal: bool):
    rng = np.random.default_rng(seed)
    sizes = rng.integers(0, 20, 4)
    start = np.cumsum([0, *sizes])
    state = rng.normal(rng.choice([0.0, 500.0]), 10, (d, start[-1])).astype(kind)
    weight = np.full(1, 0.25, kind) if equal else rng.exponential(size=start[-1]).astype(kind)
    known, most = known_of(state, weight, start)
    assert most == sizes.max()
    even = d + d % 2
    first, second = np.empty((4, d)), np.empty((4, even, even))
    block_moments(state, weight, start, known, np.zeros((2 * even + 1, 20), kind), first, second)
    exact = 1e-4 if kind == np.float32 else 1e-10
    for b in range(4):
        x = state[:, start[b] : start[b + 1]]
        w = np.full(x.shape[1], 0.25) if equal else weight[start[b] : start[b + 1]].astype(float)
        mass, (low, high, origin, total) = known[b, 0], known[b, 1:].reshape(4, d)
        assert mass == pytest.approx(w.sum(), rel=1e-5)
        np.testing.assert_allclose(total, x.astype(float) @ w, rtol=exact, atol=exact)
        if x.shape[1] == 0:
            np.testing.assert_array_equal(known[b], 0)
            continue
        np.testing.assert_array_equal(low, x.min(1))
        np.testing.assert_array_equal(high, x.max(1))
        step = x.astype(float) - origin[:, None]
        np.testing.assert_allclose(origin, x.mean(1), rtol=1e-5, atol=1e-3)
        np.testing.assert_array_equal(origin, origin.astype(kind))
        np.testing.assert_allclose(first[b], (w * step).sum(1), rtol=exact, atol=100 * exact)
        np.testing.assert_allclose(np.tril(second[b, :d, :d]), np.tril((w * step) @ step.T), rtol=exact, atol=100 * exact)


def test_summaries_need_numbers():
    for wrong in (np.nan, np.inf, -np.inf):
        state = np.array([[1.0, wrong], [0.0, 0.0]])
        assert known_of(state, np.ones(1), np.array([0, 2]))[1] == -1


@given(seeds, st.integers(1, 12), st.sampled_from([np.float32, np.float64]), st.booleans())
@settings(max_examples=25, deadline=None)
def test_kmeans_and_moments(seed: int, most: int, kind: type, equal: bool):
    """In blocks of neighbours: whole, mixed, of nobody; every particle's cluster, the masses, means and covariances."""
    rng = np.random.default_rng(seed)
    centres, d = rng.uniform(0, 60, (3, 3)), 3
    state = np.hstack([c[:, None] + rng.normal(0, 3, (d, 15)) for c in centres.T] + [rng.uniform(-50, 120, (d, 5))])
    x, w, start = cut(state, np.full(50, 0.0497) if equal else rng.exponential(0.05, 50), most)
    x, w = x.astype(kind), w.astype(kind)
    known, widest = known_of(x, w, start)
    scales, blocks, room = rng.uniform(1, 4, (d, 3)), len(known), 60
    lower, upper = known[:, 1:3].T.copy(), known[:, 1 + d : 3 + d].T.copy()
    table, flags = np.empty((room, CENTRE + 4 * d)), np.empty((room, 6), np.int64)
    label, own = np.empty(blocks, np.int32), np.empty(50, np.int32)
    k = kmeans(
        x, w, start, known, lower, upper, *rectangle_grid(lower, upper), centres, scales, 8.0, 0.6, 4, 9,
        table, flags, label, own, np.empty(blocks, np.int64), np.empty((2, 1), np.int64),
        np.empty(max(room, blocks), np.int64), np.empty((d + 2, widest), kind), np.empty(widest, np.int32),
    )  # fmt: skip
    exact, wide = x.astype(float), w.astype(float)
    want, mass, mean = twin.cluster(exact, wide, centres, scales, 0.6, 4, 9)
    each = np.repeat(label, np.diff(start))
    labels = np.where(each == MIXED, own, each)
    if kind == np.float64:
        np.testing.assert_array_equal(labels, want)
        np.testing.assert_allclose(table[:k, MASS], mass, atol=1e-12)
        np.testing.assert_allclose(table[:k, CENTRE + 2 * d : CENTRE + 3 * d], mean.T, rtol=1e-9)
    place = rng.integers(-1, 2, k)
    total, first, cov = np.zeros(2), np.zeros((d, 2)), np.zeros((2, d, d))
    cluster_moments(
        x, w, start, label, own, place, np.full((d, 2), 30.0), np.zeros((2 * 4 + 2, widest), kind),
        np.empty(widest, np.int32), np.empty(d), np.empty((4, 4)), total, first, cov,
    )  # fmt: skip
    joined = np.where(labels >= 0, place[labels], -1)
    want_moments = twin.moments(exact, twin.members(joined, wide, 2), 2)
    close = {"rtol": 1e-3, "atol": 0.05} if kind == np.float32 else {"rtol": 1e-9, "atol": 1e-9}
    np.testing.assert_allclose(total, want_moments[0], rtol=1e-5, atol=1e-9)
    heavy = want_moments[0] > 0
    np.testing.assert_allclose(first[:, heavy], want_moments[1][:, heavy], **close)
    np.testing.assert_allclose(cov[heavy], want_moments[2][heavy], **close)


@given(seeds, st.integers(0, 8), st.integers(1, 9))
@settings(max_examples=40, deadline=None)
def test_who_lies_outside_and_what_meets(seed: int, count: int, most: int):
    rng = np.random.default_rng(seed)
    state, weight, start = cut(rng.uniform(0, 100, (2, 60)), np.ones(60), most)
    known, _ = known_of(state, weight, start)
    at, half = rng.uniform(0, 100, (2, count)), rng.uniform(0, 40, (2, count))
    low, high = at - half, at + half
    lower, upper = known[:, 1:3].T.copy(), known[:, 3:5].T.copy()
    blocks, pairs = len(known), np.empty((2, count * len(known)), np.int64)
    grid = rectangle_grid(lower, upper)
    number = meeting(low, high, lower, upper, *grid, np.empty(blocks, np.int64), pairs)
    want = [
        (i, j)
        for i in range(count)
        for j in range(blocks)
        if (low[:, i] <= upper[:, j]).all() and (high[:, i] >= lower[:, j]).all()
    ]
    which, block = pairs[:, :number]
    assert sorted(zip(which, block, strict=True)) == want
    assert (np.diff(which) >= 0).all()
    small = np.empty((2, number // 2), np.int64)
    assert meeting(low, high, lower, upper, *grid, np.empty(blocks, np.int64), small) == number
    out = np.empty(60, np.int64)
    found = outside(state, start, known, low, high, which, block, np.empty(blocks, bool), np.empty(60, bool), out)
    inside = ((state[:, :, None] >= low[:, None]) & (state[:, :, None] <= high[:, None])).all(0).any(1)
    np.testing.assert_array_equal(out[:found], np.flatnonzero(~inside))


def test_claims():
    x, weight = np.array([[0.0, 1, 2, 10, 11]]), np.array([1.0, 1, 2, 1, 0])
    # The second asks for what the first has; the third for the rest.
    point, which = np.array([0, 1, 1, 2, 2, 3, 4]), np.array([0, 0, 1, 1, 2, 2, 2])
    claimed, centre = np.zeros(5, bool), np.empty((1, 3))
    assert claim(x, weight, np.array([0, 1, 3]), which, point, claimed, centre) == 2
    np.testing.assert_allclose(centre[:, :2], [[0.5, (2 * 2 + 10) / 3]])
    np.testing.assert_array_equal(claimed, True)


@given(seeds, st.integers(1, 6), st.integers(0, 5))
@settings(max_examples=30, deadline=None)
def test_whitening(seed: int, d: int, count: int):
    root = np.random.default_rng(seed).normal(size=(count, d, d))
    cov = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(d)
    inverse, log_scale = whitening(cov)
    for a, log, c in zip(inverse, log_scale, cov, strict=True):
        np.testing.assert_allclose(a @ c @ a.T, np.eye(d), atol=1e-8)
        assert log == pytest.approx(-0.5 * np.linalg.slogdet(c)[1], abs=1e-9)


@pytest.mark.parametrize("d", [6, 8])
def test_box_states(d: int, rng):
    z = rng.uniform(5, 90, (4, 7))
    x = resting(z, d)
    np.testing.assert_array_equal(x[[0, 1, 4, 5]], z)
    np.testing.assert_array_equal(x[2:4], 0)
    np.testing.assert_array_equal(x[6:], z[2:] if d == 8 else np.zeros((0, 7)))
    np.testing.assert_allclose(box_corners(x)[:, 2:] - box_corners(x)[:, :2], z[2:].T)
    np.testing.assert_allclose(box_corners(x)[:, 2:] + box_corners(x)[:, :2], 2 * z[:2].T)
    noise = box_noise(x, d - 2, 0.15, 6.0, 0.06)
    sigma = np.maximum(0.15 * z[2:], 6.0)
    np.testing.assert_allclose(noise[[0, 1, 4, 5]], np.vstack([sigma / 2, sigma]))
    np.testing.assert_allclose(noise[2], 0.06 * np.sqrt(z[2] * z[3]) / math.sqrt(2))
    lower, upper = box_gate(z, 0.5, 20.0)
    np.testing.assert_allclose(upper - z[:2], np.maximum(0.5 * z[2:], 20.0))
    np.testing.assert_allclose(upper + lower, 2 * z[:2])
