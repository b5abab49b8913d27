"""Blocks and their sums, clusters that are joined, who is served first, the box sensor's answers: against plain loops."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack.boxes import iou
from phdtrack.kernels.blocks import cut, summarise
from phdtrack.kernels.box import box_corners, box_gate, box_noise, resting
from phdtrack.kernels.em import whitening
from phdtrack.kernels.joining import claim, join_pairs, near_pairs, overlapping_boxes, overlaps_with, serve

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


@given(seeds, st.integers(1, 8), st.sampled_from([np.float32, np.float64]), st.booleans())
@settings(max_examples=40, deadline=None)
def test_summaries_of_blocks(seed: int, d: int, kind: type, equal: bool):
    rng = np.random.default_rng(seed)
    start = np.cumsum([0, *rng.integers(0, 20, 4)])
    state = rng.normal(rng.choice([0.0, 500.0]), 10, (d, start[-1])).astype(kind)
    weight = np.full(1, 0.25, kind) if equal else rng.exponential(size=start[-1]).astype(kind)
    low, high, origin, mass, first, second = summarise(
        state, state.view(np.int32 if kind == np.float32 else np.int64), weight, start
    )
    low, high = low.view(kind), high.view(kind)
    exact = 1e-4 if kind == np.float32 else 1e-10
    for b in range(4):
        x = state[:, start[b] : start[b + 1]]
        w = np.full(x.shape[1], 0.25) if equal else weight[start[b] : start[b + 1]].astype(float)
        assert mass[b] == pytest.approx(w.sum(), rel=1e-5)
        if x.shape[1] == 0:
            continue
        np.testing.assert_array_equal(low[b], x.min(1))
        np.testing.assert_array_equal(high[b], x.max(1))
        step = x.astype(float) - origin[b][:, None]
        np.testing.assert_allclose(origin[b], x.mean(1), rtol=1e-5, atol=1e-3)
        np.testing.assert_allclose(first[b], (w * step).sum(1), rtol=exact, atol=100 * exact)
        np.testing.assert_allclose(np.tril(second[b, :d, :d]), np.tril((w * step) @ step.T), rtol=exact, atol=100 * exact)


def test_summaries_need_numbers():
    state = np.array([[1.0, np.nan], [0.0, 0.0]])
    with pytest.raises(ValueError, match="finite"):
        summarise(state, state.view(np.int64), np.ones(1), np.array([0, 2]))


@given(seeds, st.integers(0, 14))
@settings(max_examples=40, deadline=None)
def test_near_pairs_and_joining(seed: int, count: int):
    rng = np.random.default_rng(seed)
    x, scale, mass = rng.normal(0, 4, (3, count)), rng.uniform(0.3, 1.5, (3, count)), rng.uniform(0, 1, count)
    among = np.flatnonzero(rng.random(count) < 0.8)
    first, second, apart = near_pairs(x, scale, 4.0, among)
    want = {(i, j): float((((x[:, i] - x[:, j]) / scale[:, i]) ** 2).sum()) for i in among for j in among if i < j}
    want = {pair: d for pair, d in want.items() if d <= 16}
    assert {(int(i), int(j)): pytest.approx(d) for i, j, d in zip(first, second, apart, strict=True)} == want
    root = join_pairs(np.lexsort((second, first, apart)), first, second, mass, 0.5, 1.2)
    expected, total = np.arange(count), mass.copy()
    for a, b in sorted(want, key=want.get):
        i, j = expected[a], expected[b]
        if i != j and min(total[i], total[j]) < 0.5 and total[i] + total[j] <= 1.2:
            expected[expected == j] = i
            total[i] += total[j]
    np.testing.assert_array_equal(root, expected)


@given(seeds, st.integers(0, 12), st.sampled_from([0.0, 0.3]))
@settings(max_examples=40, deadline=None)
def test_boxes_that_overlap(seed: int, count: int, above: float):
    rng = np.random.default_rng(seed)
    corner = rng.uniform(0, 100, (count, 2))
    boxes = np.hstack([corner, corner + rng.choice([0.0, 20.0, 60.0], (count, 2))])
    first, second, shared = overlapping_boxes(boxes, above)
    table = iou(boxes, boxes)
    want = {(i, j): table[i, j] for i in range(count) for j in range(i + 1, count) if table[i, j] > above}
    assert {(int(i), int(j)): pytest.approx(s) for i, j, s in zip(first, second, shared, strict=True)} == want
    alive = rng.random(count) < 0.7
    for i in range(count):
        other, overlap = overlaps_with(boxes, i, alive, above)
        mine = [j for j in range(count) if j != i and alive[j] and table[i, j] > above]
        np.testing.assert_array_equal(other, mine)
        np.testing.assert_allclose(overlap, table[i, mine])


def test_first_come_first_served():
    taker, thing = np.array([0, 1, 1, 2]), np.array([0, 0, 1, 1])
    np.testing.assert_array_equal(serve(np.array([1, 0, 2, 3]), taker, thing, 3, 2), [-1, 0, 1])
    np.testing.assert_array_equal(serve(np.array([0, 2]), taker, thing, 4, 2), [0, 1, -1, -1])


def test_claims():
    x, weight = np.array([[0.0, 1, 2, 10, 11]]), np.array([1.0, 1, 2, 1, 0])
    # The second asks for what the first has; the third for the rest.
    point, which = np.array([0, 1, 1, 2, 2, 3, 4]), np.array([0, 0, 1, 1, 2, 2, 2])
    centre, claimed = claim(x, weight, np.array([0, 1, 3]), point, which)
    np.testing.assert_allclose(centre, [[0.5, (2 * 2 + 10) / 3]])
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
