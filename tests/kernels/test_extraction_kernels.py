"""Blocks and their sums, clusters that are joined, who is served first, the box sensor's answers: against plain loops."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from inner_kernels import from_python
from phdtrack.arrays import iou
from phdtrack.kernels.block_em import whitening
from phdtrack.kernels.blocks import cut, summarise
from phdtrack.kernels.box import box_corners, box_gate, box_noise
from phdtrack.kernels.clustering import outside
from phdtrack.kernels.islands import islands, united
from phdtrack.kernels.joining import claim, heavy_enough, likeness, meeting, nearest_first, serve
from phdtrack.kernels.kmeans import kmeans
from phdtrack.kernels.nearest import MIXED, ROOM
from phdtrack.kernels.overlaps import rectangle_grid
from phdtrack.models import BoxSensor
from reference import clustering_twin as twin

nearest_first, whitening = from_python(nearest_first, whitening)

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
    """(B, 1 + 4d) what is known of the blocks, sums of products, and the particles in the largest."""
    known, second, largest = summary(state, weight, start)
    assert max(largest) == np.diff(start).max()
    assert min(largest) >= 0
    return known, second, max(largest)


def summary(state, weight, start, products=True):
    """What `summarise` writes, and what it returns; the blocks in two ranges. With or without sums of products."""
    d, blocks = len(state), len(start) - 1
    known, second = np.full((blocks, 1 + 4 * d), np.nan), np.full((products * blocks, d + d % 2, d + d % 2), np.nan)
    bits, half = state.view(np.int32 if state.itemsize == 4 else np.int64), blocks // 2
    ranges = ((0, half), (half, blocks))
    largest = [summarise(lo, hi, state, bits, weight, start, known, second) for lo, hi in ranges]
    return known, second, largest


@given(seeds, st.integers(1, 8), st.sampled_from([np.float32, np.float64]), st.booleans())
@settings(max_examples=40, deadline=None)
def test_summaries_of_blocks(seed: int, d: int, kind: type, equal: bool):
    rng = np.random.default_rng(seed)
    sizes = rng.integers(0, 20, 4)
    start = np.cumsum([0, *sizes])
    state = rng.normal(rng.choice([0.0, 500.0]), 10, (d, start[-1])).astype(kind)
    weight = np.full(1, 0.25, kind) if equal else rng.exponential(size=start[-1]).astype(kind)
    known, second, _ = known_of(state, weight, start)
    np.testing.assert_array_equal(summary(state, weight, start, products=False)[0], known)
    exact = 1e-4 if kind == np.float32 else 1e-10
    for b in range(4):
        x = state[:, start[b] : start[b + 1]]
        w = np.full(x.shape[1], 0.25) if equal else weight[start[b] : start[b + 1]].astype(float)
        mass, (low, high, origin, total) = known[b, 0], known[b, 1:].reshape(4, d)
        assert mass == pytest.approx(w.sum(), rel=1e-5)
        np.testing.assert_allclose(total, x.astype(float) @ w, rtol=exact, atol=exact)
        if x.shape[1] == 0:
            np.testing.assert_array_equal(known[b], 0)
            np.testing.assert_array_equal(second[b], 0)
            continue
        np.testing.assert_array_equal(low, x.min(1))
        np.testing.assert_array_equal(high, x.max(1))
        step = x.astype(float) - origin[:, None]
        np.testing.assert_allclose(origin, x.mean(1), rtol=1e-5, atol=1e-3)
        np.testing.assert_array_equal(origin, origin.astype(kind))
        np.testing.assert_allclose(np.tril(second[b, :d, :d]), np.tril((w * step) @ step.T), rtol=exact, atol=100 * exact)


def test_summaries_need_numbers():
    for wrong in (np.nan, np.inf, -np.inf):
        state = np.array([[1.0, wrong], [0.0, 0.0]])
        assert summary(state, np.ones(1), np.array([0, 2]))[2] == [0, -1]


@given(seeds, st.integers(1, 12), st.sampled_from([np.float32, np.float64]), st.booleans())
@settings(max_examples=25, deadline=None)
def test_kmeans_and_moments(seed: int, most: int, kind: type, equal: bool):
    """In blocks of neighbours: whole, mixed, of nobody; every particle's cluster, the masses, means and covariances."""
    rng = np.random.default_rng(seed)
    centres, d = rng.uniform(0, 60, (3, 3)), 3
    state = np.hstack([c[:, None] + rng.normal(0, 3, (d, 15)) for c in centres.T] + [rng.uniform(-50, 120, (d, 5))])
    x, w, start = cut(state, np.full(50, 0.0497) if equal else rng.exponential(0.05, 50), most)
    x, w = x.astype(kind), w.astype(kind)
    known, second, widest = known_of(x, w, start)
    scales = rng.uniform(1, 4, (d, 3))
    lower, upper = known[:, 1:3].T.copy(), known[:, 1 + d : 3 + d].T.copy()
    grid = (lower, upper, *rectangle_grid(lower, upper))
    # Some centres are filed already, the rest by the kernel.
    filed = int(rng.integers(0, 4))
    _, head, link, used = outside(x, start, known, widest, *grid, centres[:, :filed].copy(), scales[:, :filed].copy(), 8.0)
    link, *isles = islands(head, link, used, filed, centres, scales, 8.0, *grid, int(rng.choice([0, len(known)])))
    label, own = np.empty(len(known), np.int32), np.empty(50, np.int32)
    # Sums of products are taken beforehand or when they are asked for.
    second = second[: len(known) * int(rng.integers(0, 2))]

    def settled(isles, many):
        count = np.empty(many, np.int64)
        rows, escaped = kmeans(
            0, many, x, w, start, known, second, *grid, centres, scales, 8.0, 0.6, 4, w.sum() if len(w) > 1 else 50 * w[0],
            link, *isles, label, own, count, widest,
        )  # fmt: skip
        return rows, escaped, count

    rows, escaped, count = settled(isles, isles[0].shape[1] - 1)
    drop, more = np.zeros(len(count), bool), np.zeros(len(known), bool)
    if escaped.shape[1]:
        # All that there is as one island is left by nobody.
        assert (count[escaped[0]] == 0).all()
        escaped = np.array([np.repeat(np.arange(len(count)), len(known)), np.tile(np.arange(len(known)), len(count))])
        isles = united(escaped, *isles[1:], drop, more)
        rows, escaped, count = settled(isles, 1)
    assert escaped.shape == (2, 0)
    assert len(rows) == count.sum()
    exact, wide = x.astype(float), w.astype(float)
    wide = np.full(50, wide[0]) if len(wide) == 1 else wide
    want, *_ = twin.cluster(exact, wide, centres, scales, 0.6, 4, 9)
    island = np.repeat(isles[2][2], np.diff(start))
    each = np.where(np.repeat(label, np.diff(start)) == MIXED, own, np.repeat(label, np.diff(start)))
    labels = np.where((island < 0) | (each < 0), -1, (count.cumsum() - count)[island] + each)
    if kind == np.float64:
        # Clusters are in the order of their islands.
        names = twin.names(labels, want, len(rows))
        np.testing.assert_array_equal(np.where(labels >= 0, names[labels], -1), want)
    mine = twin.moments(exact, twin.members(labels, wide, len(rows)), len(rows))
    close = {"rtol": 1e-3, "atol": 0.05} if kind == np.float32 else {"rtol": 1e-9, "atol": 1e-9}
    np.testing.assert_allclose(rows[:, 0], mine[0], rtol=1e-5, atol=1e-9)
    heavy = mine[0] > 0
    np.testing.assert_allclose(rows[heavy, 1 : 1 + d], mine[1][:, heavy].T, **close)
    np.testing.assert_allclose(rows[heavy, 1 + d :].reshape(-1, d, d), mine[2][heavy], **close)


@given(seeds, st.integers(0, 12), st.integers(1, 9))
@settings(max_examples=40, deadline=None)
def test_islands(seed: int, k: int, most: int):
    """Centres are on one island where a chain of blocks leads from one to the other."""
    rng = np.random.default_rng(seed)
    state, weight, start = cut(rng.uniform(0, 100, (2, 40)), np.ones(40), most)
    known, _, widest = known_of(state, weight, start)
    lower, upper = known[:, 1:3].T.copy(), known[:, 3:5].T.copy()
    grid, at, half = (lower, upper, *rectangle_grid(lower, upper)), rng.uniform(-20, 120, (2, k)), rng.uniform(0, 12, (2, k))
    _, head, link, used = outside(state, start, known, widest, *grid, at[:, : k // 2].copy(), half[:, : k // 2].copy(), 2.0)
    few = int(rng.choice([0, 0, len(known)]))
    isles = islands(head, link, used, k // 2, at, half, 2.0, *grid, few)[1:]
    low, high = at - 2 * ROOM * half, at + 2 * ROOM * half
    near = ~((low[:, :, None] > upper[:, None]) | (high[:, :, None] < lower[:, None])).any(0)
    reach = np.full((k, k), few > 0) | np.eye(k, dtype=bool) | (near.astype(int) @ near.T.astype(int) > 0)
    for _ in range(k):
        reach |= reach.astype(int) @ reach.astype(int) > 0
    begin, (_, of_centre, _), (_, _, of_block, _) = isles
    np.testing.assert_array_equal(of_centre[:, None] == of_centre, reach)
    for b in range(len(known)):
        assert set(of_centre[near[:, b]]) == ({of_block[b]} - {-1}) or (few and of_block[b] == 0)
    for starts, (item, of, place) in zip(begin, (isles[1], isles[2][1:]), strict=True):
        for i, (first, last) in enumerate(pairwise(starts)):
            np.testing.assert_array_equal(item[first:last], np.flatnonzero(of == i))
            np.testing.assert_array_equal(place[item[first:last]], np.arange(last - first))
        np.testing.assert_array_equal(place[of < 0], -1)
    if k == 0:
        return
    # One island of two, and a block that is on none.
    drop, more = np.zeros(begin.shape[1] - 1, bool), np.zeros(len(known), bool)
    escaped = np.array([[of_centre[0], of_centre[0]], rng.integers(0, len(known), 2)])
    one = united(escaped, *isles[1:], drop, more)
    members = {of_centre[0], *of_block[escaped[1]]} - {-1}
    np.testing.assert_array_equal(one[1][1], np.where(np.isin(of_centre, list(members)), 0, -1))
    on = np.isin(of_block, list(members))
    on[escaped[1]] = True
    np.testing.assert_array_equal(one[2][2], np.where(on, 0, -1))


@given(seeds, st.integers(0, 8), st.integers(1, 9))
@settings(max_examples=40, deadline=None)
def test_who_lies_outside_and_what_meets(seed: int, count: int, most: int):
    rng = np.random.default_rng(seed)
    state, weight, start = cut(rng.uniform(0, 100, (2, 60)), np.ones(60), most)
    known, *_ = known_of(state, weight, start)
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


@given(seeds, st.integers(0, 14))
@settings(max_examples=60, deadline=None)
def test_light_clusters_are_joined_and_the_heavy_enough_kept(seed: int, k: int):
    rng = np.random.default_rng(seed)
    x, k = rng.uniform(0, 120, (3, 60)), max(k, 1)
    labels, weight = rng.integers(0, k, 60), rng.uniform(0, 1 / 15, 60)
    (mass, mean, cov), scale = twin.moments(x, twin.members(labels, weight, k), k), rng.uniform(2, 6, (3, k))
    found = heavy_enough(mass, mean, cov, scale, twin.REACH, 0.6, 1.5)
    root = twin.join_light(mass, mean, lambda _: scale, 0.6, 1.5)
    want = twin.moments(x, twin.members(root[labels], weight, k), k)
    for mine, exact in zip(found, want, strict=True):
        np.testing.assert_allclose(mine.T, exact.T[want[0] >= 0.6] if exact.ndim < 3 else exact[want[0] >= 0.6].T, atol=1e-9)


@given(seeds, st.integers(0, 12), st.sampled_from([0.0, 0.3]))
@settings(max_examples=40, deadline=None)
def test_boxes_that_are_alike(seed: int, count: int, above: float):
    rng = np.random.default_rng(seed)
    corner = rng.uniform(0, 100, (count, 2))
    boxes = np.hstack([corner, corner + rng.choice([0.0, 20.0, 60.0], (count, 2))])
    table = iou(boxes, boxes)
    want = {(i, j): pytest.approx(table[i, j]) for i in range(count) for j in range(i + 1, count) if table[i, j] > above}
    first, second, shared = (found.tolist() for found in likeness(boxes, above))
    assert dict(zip(zip(first, second, strict=True), shared, strict=True)) == want


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
    x, _ = BoxSensor(scaling="previous" if d == 8 else "particle").states(z)
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
