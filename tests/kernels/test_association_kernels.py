"""Prediction, edges and identities of the association against their plain twins."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack.kernels.association import find_edges, predict_covariances
from phdtrack.kernels.constant_velocity import move_boxes
from phdtrack.kernels.identities import claim, follow
from reference import association_twin as twin

seeds = st.integers(0, 2**32 - 1)
ROWS = np.array([0, 1, 4, 5])


def spreads(rng: np.random.Generator, n: int, d: int, scale: float) -> np.ndarray:
    root = rng.normal(size=(n, d, d))
    return scale * (root @ root.transpose(0, 2, 1) / d + 0.1 * np.eye(d))


def unchanged(call, *arrays):
    """What ``call`` gives; it may not write into what it receives."""
    before = [np.copy(a) for a in arrays]
    result = call(*arrays)
    for was, now in zip(before, arrays, strict=True):
        np.testing.assert_array_equal(was, now)
    return result


@given(seeds, st.sampled_from([6, 8]), st.integers(0, 20), st.sampled_from([0.3, 1.0, 3.5]), st.booleans())
@settings(max_examples=40, deadline=None)
def test_boxes_move_as_the_matrices_say(seed: int, d: int, n: int, dt: float, scaled: bool):
    x = np.random.default_rng(seed).normal(20, 15, (d, n))
    ours = unchanged(lambda x: move_boxes(x, dt, 0.05, 0.1, 1.0, scaled), x)
    for mine, theirs in zip(ours, twin.moved_boxes(x, dt, 0.05, 0.1, 1.0, scaled), strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-12, atol=1e-12)


@given(seeds, st.sampled_from([4, 6]), st.integers(0, 12), st.integers(0, 4), st.sampled_from(["velocity", "one", "each"]))
@settings(max_examples=60, deadline=None)
def test_covariances_are_predicted(seed: int, d: int, count: int, n: int, kind: str):
    rng = np.random.default_rng(seed)
    jacobian = rng.normal(size=(count + n if kind == "each" else 1, d, d))
    if kind == "velocity":
        jacobian[0] = np.eye(d) + np.eye(d, k=2) * (np.arange(d) < 2)[:, None]
    arrays = spreads(rng, count, d, 4.0), jacobian, spreads(rng, count + n, d, 1.0)
    out = np.empty((count, d, d))
    unchanged(lambda *a: predict_covariances(*a, out), *arrays)
    np.testing.assert_allclose(out, twin.predicted(*arrays), rtol=1e-10, atol=1e-10)


def case(seed: int, count: int, n: int, side: float):
    rng = np.random.default_rng(seed)
    bounds = [(0, side), (0, side), (-3, 3), (-3, 3), (32, 44), (32, 44)]
    mean = np.array([rng.uniform(low, high, count + n) for low, high in bounds])
    cov = spreads(rng, count + n, 6, 1.0) * rng.uniform(0.5, 60, count + n)[:, None, None]
    noise, sigma = spreads(rng, n, 6, 2.0), rng.uniform(1, 5, (6, n))
    return mean, cov, noise, sigma, np.sort(rng.integers(1, 12, count).astype(float))[::-1].copy(), ROWS


@given(seeds, st.integers(0, 40), st.integers(0, 8), st.sampled_from([30.0, 150.0]), st.sampled_from([2.0, 4.0, 8.0]))
@settings(max_examples=60, deadline=None)
def test_edges_are_all_pairs_worth_taking(seed: int, count: int, n: int, side: float, gate: float):
    arrays = case(seed, count, n, side)
    options = 1.0, gate, float(np.log(0.8)), 3.0
    start, target, gain = unchanged(lambda *a: find_edges(*a, *options), *arrays)
    ours = {}
    for i in range(n):
        columns = target[start[i] : start[i + 1]]
        assert (np.diff(columns) > 0).all()
        ours.update({(i, int(c)): g for c, g in zip(columns, gain[start[i] : start[i + 1]], strict=True)})
    assert len(start) == n + 1
    assert ours == pytest.approx(twin.edges(*arrays, *options), abs=1e-8)


def test_the_cases_have_edges_and_others():
    kept = [len(twin.edges(*case(seed, 30, 6, 60.0), 1.0, 4.0, np.log(0.8), 3.0)) for seed in range(5)]
    assert all(5 < k < 175 for k in kept), kept


def test_positions_that_are_none_are_refused():
    arrays = case(1, 10, 3, 30.0)
    arrays[0][0, -1] = np.nan
    with pytest.raises(ValueError, match="finite"):
        find_edges(*arrays, 1.0, 8.0, -0.2, 3.0)


@given(seeds, st.integers(0, 6), st.integers(1, 14), st.integers(1, 4), st.sampled_from([0.0, 2.0]))
@settings(max_examples=80, deadline=None)
def test_identities_are_claimed_as_by_dictionaries(seed: int, ahead: int, frames: int, shortest: int, least: float):
    """Frame after frame under links that change meanwhile, with ``ahead`` vertices known that are not given yet."""
    rng = np.random.default_rng(seed)
    first, used = 5, 0
    none, never = np.zeros(0, np.int64), np.zeros(0, np.bool_)
    record = (none, none, np.zeros(0), never, never)
    for _ in range(frames):
        n = int(rng.integers(0, 4))
        old = len(record[0])
        total = old + n + ahead
        # Any earlier vertex once: links of a past frame may have been undone since.
        previous = np.full(total, -1)
        free = list(range(total))
        for v in range(total):
            open_ones = [u for u in free if u < v]
            if open_ones and rng.random() < 0.8:
                u = open_ones[int(rng.integers(max(0, len(open_ones) - 4), len(open_ones)))]
                free.remove(u)
                # Within a frame nobody follows another.
                if not old <= u < old + n or v >= old + n:
                    previous[v] = first + u
        gain = np.where(previous >= 0, rng.uniform(0, 6, total), 0.0)
        onward, worth = follow(first, first, previous, gain)
        for v, u in enumerate(previous):
            assert u < 0 or (onward[u - first] == first + v and worth[u - first] == gain[v])
        assert (onward >= 0).sum() == (previous >= 0).sum()
        names, holder, absent, names_used = twin.claimed(first, n, used, record, onward, worth, shortest, least)
        before = [a.copy() for a in record]
        after, gone, used = claim(first, n, used, record, onward, worth, shortest, least)
        for was, now in zip(before, record, strict=True):
            np.testing.assert_array_equal(was, now)
        record = after
        assert used == names_used
        assert record[0].tolist() == [names[first + k] for k in range(old + n)]
        assert (first + gone).tolist() == absent
        held = {int(record[0][k]): k for k in np.flatnonzero(record[4])}
        assert {name: first + k for name, k in held.items()} == {name: h[0] for name, h in holder.items()}
        for name, k in held.items():
            assert [record[1][k], record[3][k]] == [holder[name][1], holder[name][3]]
            assert record[2][k] == pytest.approx(holder[name][2], abs=1e-12)
