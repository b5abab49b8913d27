"""The comb over sources, the order of sources, and the cut into blocks."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack.kernels.box_blocks import BLOCK
from phdtrack.kernels.comb import by_cells, comb, cut
from reference import fused_twin as twins

masses = st.lists(st.one_of(st.floats(0, 3), st.just(0.0), st.floats(0, 1e-8)), min_size=1, max_size=25).map(np.array)
offsets = st.floats(0, 1, exclude_max=True)


def shuffled(n: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).permutation(n)


@given(masses.filter(lambda m: m.sum() > 1e-6), st.integers(1, 3000), offsets, st.integers(0, 99))
@settings(max_examples=100, deadline=None)
def test_every_source_has_its_share_of_the_teeth(mass, count: int, offset: float, seed: int):
    order = shuffled(len(mass), seed)
    teeth, place, phase, width = comb(mass, order, count, offset)
    share = count * mass / mass.sum()
    rounding = 1e-6 * count + len(mass) * count / (mass.sum() * 2**32)
    assert teeth.sum() == count
    assert (teeth >= 0).all()
    assert (np.abs(teeth - share) < 1 + rounding).all()
    np.testing.assert_allclose(width, share, atol=rounding)
    np.testing.assert_array_equal(place[order], np.cumsum(teeth[order]) - teeth[order])
    # Phases are consistent with one comb over everything: where a source begins, its first tooth is that far away.
    begin = np.cumsum(width[order]) - width[order]
    np.testing.assert_allclose(phase[order], place[order] + offset - begin, atol=1e-9 * count)
    some = teeth > 0
    assert (phase[some] > -1e-9 * count).all()
    assert (phase[some] + teeth[some] - 1 <= width[some] + 1e-9 * count).all()


@given(masses.filter(lambda m: m.sum() > 0.1), st.integers(1, 60), st.sampled_from([0.0, 0.25, 0.5, 0.875]))
@settings(max_examples=60, deadline=None)
def test_teeth_stand_where_exact_fractions_put_them(mass, count: int, offset: float):
    order = shuffled(len(mass), 3)
    teeth, place, phase, width = comb(mass, order, count, offset)
    wanted, span = twins.comb(mass, order, count, offset)
    for i in order:
        # A tooth within rounding of an edge may be on either side of it.
        edge = min(abs(k + offset - x) for k in range(-1, count + 1) for x in span[i])
        if edge > 1e-9:
            assert teeth[i] == len(wanted[i])
            if teeth[i]:
                assert place[i] == wanted[i][0]
                assert phase[i] == pytest.approx(wanted[i][0] + offset - span[i][0], abs=1e-9)
        assert width[i] == pytest.approx(span[i][1] - span[i][0], abs=1e-9)


def test_the_average_over_offsets_is_the_share():
    mass = np.array([0.1, 0.0, 0.35, 0.551, 1e-3])
    grid = (np.arange(1000) + 0.5) / 1000
    teeth = np.mean([comb(mass, shuffled(5), 7, o)[0] for o in grid], axis=0)
    np.testing.assert_allclose(teeth, 7 * mass / mass.sum(), atol=2e-3)


def test_the_order_changes_no_share_and_small_sources_are_not_lost():
    """A million small masses after a large one: in single precision they would have none."""
    n = 300
    mass = np.append(np.full(n, 1e-7), 1.0)
    grid = (np.arange(50) + 0.5) / 50
    for order in (np.arange(n + 1), np.arange(n + 1)[::-1].copy()):
        teeth = np.mean([comb(mass, order, 1000, o)[0] for o in grid], axis=0)
        assert teeth[:n].sum() == pytest.approx(1000 * 3e-5 / (1 + 3e-5), abs=0.021)
    a, b = (comb(mass, order, 1000, 0.5)[3] for order in (np.arange(n + 1), shuffled(n + 1)))
    np.testing.assert_array_equal(a, b)


def test_no_mass_has_no_teeth():
    for mass in (np.zeros(0), np.zeros(3), np.full(3, 1e-12)):
        teeth, place, phase, width = comb(mass, np.arange(len(mass)), 10, 0.5)
        assert not teeth.any()
        assert not place.any()
        assert not phase.any()
        assert not width.any()


def boxes(x, y, w=10.0, h=20.0, half=1.0) -> np.ndarray:
    """(S, 6) extents about centres."""
    x, y = np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float))
    w, h = np.broadcast_to(w, x.shape), np.broadcast_to(h, x.shape)
    return np.stack([x - half, y - half, x + half, y + half, w, h], axis=1).astype(np.float32)


@given(st.integers(0, 60), st.integers(0, 2**32 - 1), st.sampled_from([0.0, 10.0, 1e3, 1e7]))
@settings(max_examples=60, deadline=None)
def test_the_order_is_a_permutation(n: int, seed: int, spread: float):
    rng = np.random.default_rng(seed)
    order = by_cells(boxes(*rng.uniform(-spread, spread, (2, n)), *rng.uniform(0.01, 90, (2, n))))
    assert sorted(order.tolist()) == list(range(n))


def test_neighbours_stay_together():
    """Sources about eight places far from each other: those of one place follow each other."""
    rng = np.random.default_rng(4)
    which = rng.integers(0, 8, 80)
    order = by_cells(boxes(200.0 * (which % 4) + rng.uniform(-2, 2, 80), 300.0 * (which // 4) + rng.uniform(-2, 2, 80)))
    changes = np.count_nonzero(np.diff(which[order]))
    assert changes == 7


@given(st.integers(0, 25), st.integers(0, 2**32 - 1), st.sampled_from([3.0, 30.0, 3e3]), st.sampled_from([0.5, 1.0, 4.0]))
@settings(max_examples=100, deadline=None)
def test_blocks_cover_everything_and_are_small_and_compact(n: int, seed: int, spread: float, reach: float):
    rng = np.random.default_rng(seed)
    extents = boxes(*rng.uniform(0, spread, (2, n)), *rng.uniform(5, 40, (2, n)), rng.uniform(0.5, 30, n))
    teeth = rng.choice([0, 1, 2, 3, 40, 255, 256, 257, 700], n)
    order = by_cells(extents)
    start, divided = cut(extents, order, teeth, reach)
    sizes = np.diff(start)
    assert (start[0], start[-1]) == (0, teeth.sum())
    assert ((sizes > 0) & (sizes <= BLOCK)).all()
    assert start.size - 1 <= 2 * n + teeth.sum() // BLOCK + 1
    wide, high = extents[:, 2] - extents[:, 0], extents[:, 3] - extents[:, 1]
    over = np.maximum(wide / (reach * extents[:, 4]), high / (reach * extents[:, 5]))
    some = teeth > 0
    clear = np.abs(over - 1) > 1e-5
    np.testing.assert_array_equal((divided > 0)[some & clear], (over > 1)[some & clear])
    assert not divided[~some].any()
    # The sources in each block.
    owner = np.repeat(order, teeth[order])
    for lo, hi in pairwise(start):
        inside = np.unique(owner[lo:hi])
        if len(inside) > 1:
            assert not divided[inside].any(), "a divided source has blocks of its own"
            e = extents[inside]
            assert np.ptp(e[:, [0, 2]]) <= reach * e[:, 4].max() * (1 + 1e-5)
            assert np.ptp(e[:, [1, 3]]) <= reach * e[:, 5].max() * (1 + 1e-5)
    for i in np.flatnonzero(divided):
        if teeth[i] > 1:
            assert len(np.unique(np.searchsorted(start, np.flatnonzero(owner == i), side="right"))) >= 2


def test_a_source_is_parted_along_its_longer_side_in_boxes():
    extents = [[0, 0, 30, 30, 10, 20], [0, 0, 11, 90, 10, 20], [0, 0, 9, 19, 10, 20], [0, 0, 1, 1, 0, 0]]
    _, divided = cut(np.array(extents, np.float32), np.arange(4), np.full(4, 10), 1.0)
    assert divided.tolist()[:3] == [1, 2, 0]
    assert divided[3] > 0, "without a size everything is wide"


def test_full_blocks_of_compact_sources():
    """Ten sources of a hundred at one place make four blocks, not ten."""
    start, _ = cut(boxes(np.zeros(10), np.zeros(10)), np.arange(10), np.full(10, 100), 1.0)
    assert start.tolist() == [0, 256, 512, 768, 1000]
