"""Prediction, edges and identities of the association against their plain twins."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from inner_kernels import from_python
from phdtrack.kernels.association import (
    LANES,
    determinants,
    find_edges,
    near_pairs,
    predict_covariances,
)
from phdtrack.kernels.constant_velocity import box_motion_noise, predict_boxes
from phdtrack.kernels.identities import come_back, hand_on
from phdtrack.kernels.linking import link_states
from reference import association_twin as twin
from reference import kernel_twins

determinants, find_edges, near_pairs = from_python(determinants, find_edges, near_pairs)

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


@given(seeds, st.integers(0, 20), st.sampled_from([0.3, 1.0, 3.5]), st.booleans())
@settings(max_examples=40, deadline=None)
def test_boxes_are_pushed_as_the_matrices_say(seed: int, n: int, dt: float, scaled: bool):
    x = np.random.default_rng(seed).normal(20, 15, (6, n))
    out = np.zeros((6, 6, n))
    unchanged(lambda size: box_motion_noise(size, dt, 0.05, 0.1, 1.0, scaled, out), x[4:6])
    _, _, noise = twin.moved_boxes(x, dt, 0.05, 0.1, 1.0, scaled)
    np.testing.assert_allclose(out.transpose(2, 0, 1), noise, rtol=1e-12, atol=1e-12)


@given(seeds, st.integers(0, 300), st.integers(0, 4), st.sampled_from([0.3, 1.0, 3.5]), st.booleans())
@settings(max_examples=30, deadline=None)
def test_boxes_are_moved_as_the_matrices_say(seed: int, count: int, n: int, dt: float, scaled: bool):
    """Two states in front are gone, and the new ones behind stay where they are."""
    rng = np.random.default_rng(seed)
    x, p = rng.normal(20, 15, (6, 2 + count + n)), spreads(rng, 2 + count + n, 6, 4.0)
    mean, cov, noise = x[:, 2:].copy(), np.empty((21, count + n)), np.zeros((21, n))
    unchanged(
        lambda old, new, place: predict_boxes(old, 2, new, dt, 0.05, 0.1, 1.0, scaled, place, mean, cov, noise),
        *(planes(p[: 2 + count]), p[2 + count :], places(6)),
    )
    moved, f, q = twin.moved_boxes(x[:, 2:], dt, 0.05, 0.1, 1.0, scaled)
    np.testing.assert_allclose(mean[:, :count], moved[:, :count], rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(mean[:, count:], x[:, 2 + count :])
    expected = np.concatenate((twin.predicted(p[2 : 2 + count], f[None], q[:count]), p[2 + count :]))
    np.testing.assert_allclose(cov, planes(expected), rtol=1e-10, atol=1e-10)
    seen = places(6)[np.ix_(ROWS, ROWS)]
    np.testing.assert_allclose(noise[seen], q[count:][:, ROWS[:, None], ROWS].transpose(1, 2, 0), rtol=1e-12)


def places(d: int) -> np.ndarray:
    """The plane of each element of a (d, d) matrix."""
    row, column = np.tril_indices(d)
    place = np.empty((d, d), np.int64)
    place[row, column] = place[column, row] = np.arange(len(row))
    return place


def planes(matrices: np.ndarray) -> np.ndarray:
    """(k, n) lower triangles of (n, d, d)."""
    row, column = np.tril_indices(matrices.shape[1])
    return np.ascontiguousarray(matrices[:, row, column].T)


@given(seeds, st.sampled_from([4, 6]), st.integers(0, 12), st.integers(0, 4), st.sampled_from(["velocity", "one", "each"]))
@settings(max_examples=60, deadline=None)
def test_covariances_are_predicted(seed: int, d: int, count: int, more: int, kind: str):
    """Of ``more`` + count + ``more`` states those between."""
    rng = np.random.default_rng(seed)
    jacobian = rng.normal(size=(count if kind == "each" else 1, d, d))
    if kind == "velocity":
        jacobian[0] = np.eye(d) + np.eye(d, k=2) * (np.arange(d) < 2)[:, None]
    cov, noise = spreads(rng, count + 2 * more, d, 4.0), spreads(rng, count + more, d, 1.0)
    off = jacobian - np.eye(d)
    row, column = off.any(axis=0).nonzero()
    value = np.array(np.broadcast_to(off[:, row, column].T, (len(row), count)))
    out = np.full((d * (d + 1) // 2, count + 2 * more), 7.0)
    # Those in front are partly gone from the window, partly predicted already.
    skip = more // 2
    arrays = planes(cov), noise.transpose(1, 2, 0).copy(), row, column, value, places(d)
    unchanged(lambda old, q, r, c, v, p: predict_covariances(old, skip, q, r, c, v, p, out, more - skip), *arrays)
    here = slice(more - skip, more - skip + count)
    expected = twin.predicted(cov[more : more + count], jacobian, noise[:count])
    np.testing.assert_allclose(out[:, here], planes(expected), rtol=1e-10, atol=1e-10)
    assert (np.delete(out, here, axis=1) == 7.0).all()


@given(seeds, st.integers(0, 150), st.integers(1, 4))
@settings(max_examples=30, deadline=None)
def test_determinants(seed: int, count: int, m: int):
    rng = np.random.default_rng(seed)
    cov, rows = spreads(rng, count, 5, 3.0), rng.permutation(5)[:m]
    out, work = np.empty(count), np.empty((m + 3, m, LANES))
    unchanged(lambda c, p: determinants(c, p, work, out), planes(cov), places(5)[np.ix_(rows, rows)])
    np.testing.assert_allclose(out, [np.linalg.det(c[np.ix_(rows, rows)]) for c in cov], rtol=1e-9)


def test_what_is_no_covariance_has_no_determinant():
    out = np.empty(2)
    determinants(planes(np.array([-np.eye(2), np.eye(2)])), places(2), np.empty((5, 2, LANES)), out)
    np.testing.assert_array_equal(out, [np.nan, 1.0])


def case(seed: int, count: int, n: int, side: float):
    rng = np.random.default_rng(seed)
    bounds = [(0, side), (0, side), (-3, 3), (-3, 3), (32, 44), (32, 44)]
    mean = np.array([rng.uniform(low, high, count + n) for low, high in bounds])
    cov = spreads(rng, count + n, 6, 1.0) * rng.uniform(0.5, 60, count + n)[:, None, None]
    noise, sigma = spreads(rng, n, 6, 2.0), rng.uniform(1, 5, (6, n))
    return mean, cov, noise, sigma, np.sort(rng.integers(1, 12, count).astype(float))[::-1].copy(), ROWS


def edges(mean, cov, noise, sigma, since, rows, dt, gate, log_miss, consistent):
    """As compressed rows: the kernels one after the other, which write into nothing but their outputs."""
    d, n, count = len(mean), sigma.shape[1], len(since)
    packed, plane = planes(cov), places(d)[np.ix_(rows, rows)]
    work, det, open_end = np.empty((len(rows) + 3, len(rows), LANES)), np.empty(count + n), np.empty(n)
    determinants(packed, plane, work, det)
    determinants(planes(noise + 2 * np.array([np.diag(s**2) for s in sigma.T])), plane, work, open_end)
    open_end = 0.5 * (gate**2 + np.log(open_end))
    price = (since - dt) * log_miss
    pairs = 0

    def near(room: int):
        state, column = np.full(room, -1), np.full(room, -1)
        side = int(n**0.5) + 1
        grid = np.zeros(side * side + 1, np.int64), np.empty(n, np.int64)
        found = unchanged(
            lambda *given: near_pairs(*given, consistent, 0, det.copy(), *grid, state, column),
            *(mean, packed, open_end, price, rows, plane),
        )
        return found, state, column

    pairs, *_ = near(0)
    again, state, column = near(pairs + 3)
    assert again == pairs
    assert (state[pairs:] == -1).all()
    assert (np.diff(column[:pairs]) >= 0).all()
    start, target = np.zeros(n + 1, np.int64), np.empty(pairs, np.int64)
    gain, value = np.empty(pairs), np.empty(pairs)
    unchanged(
        lambda m, c, o, p, r, q: find_edges(
            m, c, o, p, r, q, consistent, state[:pairs], column[:pairs], 100, work, start, target, gain, value
        ),
        *(mean, packed, open_end, price, rows, plane),
    )
    return start, target - 100, gain


@given(seeds, st.integers(0, 40), st.integers(1, 12), st.sampled_from([30.0, 150.0]), st.sampled_from([2.0, 4.0, 8.0]))
@settings(max_examples=60, deadline=None)
def test_edges_are_all_pairs_worth_taking(seed: int, count: int, n: int, side: float, gate: float):
    arrays = case(seed, count, n, side)
    options = 1.0, gate, float(np.log(0.8)), 3.0
    start, target, gain = edges(*arrays, *options)
    ours = {}
    for i in range(n):
        columns = target[start[i] : start[i + 1]]
        assert (np.diff(columns) > 0).all()
        ours.update({(i, int(c)): g for c, g in zip(columns, gain[start[i] : start[i + 1]], strict=True)})
    assert len(start) == n + 1
    assert ours == pytest.approx(twin.edges(*arrays, *options), abs=1e-8)


def test_one_new_state_and_states_in_one_place():
    """The grid over the new states has no extent along an axis."""
    for same in ([0, 1], [1], [0]):
        arrays = case(3, 30, 5, 60.0)
        arrays[0][same, 30:] = 30.0
        start, target, gain = edges(*arrays, 1.0, 4.0, np.log(0.8), 3.0)
        row = np.repeat(np.arange(5), np.diff(start))
        ours = dict(zip(zip(row.tolist(), target[: start[-1]].tolist(), strict=True), gain[: start[-1]], strict=True))
        expected = twin.edges(*arrays, 1.0, 4.0, np.log(0.8), 3.0)
        assert ours == pytest.approx(expected, abs=1e-8)
        assert expected


@pytest.mark.parametrize("known", [slice(0, 30), slice(30, 35), slice(28, 31)], ids=["old", "new", "some of both"])
def test_states_known_exactly_are_linked_too(known):
    """The sum of the two covariances decides; that of one of them may be none."""
    arrays = case(4, 30, 5, 60.0)
    # Those of both kinds lie far from one another.
    arrays[1][known], arrays[0][0, 28:30] = 0.0, 1e4
    start, target, gain = edges(*arrays, 1.0, 4.0, np.log(0.8), 3.0)
    row = np.repeat(np.arange(5), np.diff(start))
    ours = dict(zip(zip(row.tolist(), target[: start[-1]].tolist(), strict=True), gain[: start[-1]], strict=True))
    arrays[1][28:30] += np.eye(6)
    expected = twin.edges(*arrays, 1.0, 4.0, np.log(0.8), 3.0)
    assert ours == pytest.approx(expected, abs=1e-8)
    assert len(expected) > 5


def test_the_cases_have_edges_and_others():
    kept = [len(twin.edges(*case(seed, 30, 6, 60.0), 1.0, 4.0, np.log(0.8), 3.0)) for seed in range(5)]
    assert all(5 < k < 175 for k in kept), kept


@given(seeds, st.integers(0, 40), st.integers(0, 12), st.sampled_from([6.0, 40.0]), st.booleans())
@settings(max_examples=60, deadline=None)
def test_a_frame_is_linked_as_by_plain_edges_and_the_best_matching(
    seed: int, count: int, n: int, span: float, infinite: bool
):
    """One frame from a window without links: what is too old is closed, the others find their best ends."""
    mean, cov, noise, sigma, since, rows = case(seed, count, n, 60.0)
    packed, plane = planes(cov), places(6)[np.ix_(rows, rows)]
    if infinite and n:
        mean[0, count] = np.nan
    size, room = count + 3, 12 * 40
    older, empty, zero = np.zeros(count, np.int64), np.empty(0, np.int64), np.zeros(count)
    columns = np.append([-2, 55, -2], np.full(count, -1))
    # The first of the rows with edges of their own is there already, without any.
    was = (since - 1.0, np.full(count, -1), zero, zero, columns, np.zeros(size), np.zeros(2, np.int64), empty, np.empty(0))
    age, worth, u = np.empty((3, count + n))
    previous, onward, v = np.empty(count + n, np.int64), np.empty(size + n, np.int64), np.empty(size + n)
    begins, target, gain = np.empty(n + 2, np.int64), np.empty(room, np.int64), np.empty(room)
    side, log_miss = int(n**0.5) + 1, float(np.log(0.8))
    found, closed, gone = link_states(
        *(1.0, span, 4.0, log_miss, 3.0, 53, 50, older, empty, np.empty(0), mean, packed, planes(noise), sigma, rows, plane),
        *(np.empty((7, 4, LANES)), was, age, previous, worth, u, onward, v, begins, target, gain),
        *(np.empty(room, np.int64), np.empty(room, np.int64), np.empty(room), np.empty((3, size + n))),
        *(np.empty((2, size + n), np.int64), np.zeros(side * side + 1, np.int64), np.zeros(size + n, np.uint8)),
    )
    np.testing.assert_allclose(age[:count], since)
    assert closed == (since > span).sum()
    assert gone == 1, "the second column still has a row"
    assert (onward[3 : 3 + closed] == -2).all()
    if infinite and n:
        assert found == -1
        return
    links = twin.edges(mean, cov, noise, sigma, since, rows, 1.0, 4.0, log_miss, 3.0) if n else {}
    links = {(i, c): g for (i, c), g in links.items() if c >= closed}
    row = np.repeat(np.arange(n), np.diff(begins[1:]))
    ends = target[: begins[-1]] - 53
    ours = dict(zip(zip(row.tolist(), ends.tolist(), strict=True), gain[: begins[-1]].tolist(), strict=True))
    assert ours == pytest.approx(links, abs=1e-8)
    best = kernel_twins.best_matching(n, count, links)
    assert worth.sum() == pytest.approx(best, abs=1e-8)
    taken = {(r, int(c) - 53) for r, c in enumerate(previous[count:]) if c >= 0}
    assert sum(links[pair] for pair in taken) == pytest.approx(best, abs=1e-8)
    assert {(int(o) - 53 - count, c) for c, o in enumerate(onward[3:]) if o >= 0} == taken


@given(seeds, st.integers(0, 6), st.integers(1, 14), st.integers(1, 4), st.sampled_from([0.0, 2.0]))
@settings(max_examples=80, deadline=None)
def test_identities_are_claimed_as_by_dictionaries(seed: int, ahead: int, frames: int, shortest: int, least: float):
    """Frame after frame under links that change meanwhile, with ``ahead`` vertices known that are not given yet."""
    rng, ages = np.random.default_rng(seed), 4
    first, used, fresh = 5, 0, 5
    none, never = np.zeros(0, np.int64), np.zeros(0, np.bool_)
    record = (none, none, np.zeros(0), never, never, none)
    waits, known, asked = np.zeros((2, ages), np.int64), none, np.zeros((2, ages), np.int64)
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
        # What is settled comes apart from what is open.
        open_from = int(rng.integers(0, total + 1))
        final = np.flatnonzero(previous[:open_from] >= 0)
        settled = first + final, previous[final], gain[final]
        onward, worth = np.full(total, -1), np.zeros(total)
        for v in np.flatnonzero(previous >= 0):
            onward[previous[v] - first], worth[previous[v] - first] = first + v, gain[v]
        names, holder, absent, names_used = twin.claimed(first, n, used, record, onward, worth, shortest, least)
        twin.asked(first, record, holder, asked)
        before = [a.copy() for a in (*record, *settled, known)]
        after = [np.full(old + n, 7, part.dtype) for part in record]
        absences, source, space = np.empty(old, np.int64), np.empty(old, np.int64), np.empty(n, np.int64)
        ends = np.empty(total, np.int64), np.empty(total)
        open_links = first + open_from, previous[open_from:], gain[open_from:]
        used, missing = hand_on(
            first,
            *open_links,
            *settled,
            used,
            shortest,
            least,
            *record,
            known,
            fresh,
            *ends,
            *after,
            waits,
            absences,
            source,
            space,
        )
        np.testing.assert_array_equal(ends[0], onward)
        np.testing.assert_array_equal(ends[1], worth)
        for was, now in zip(before, (*record, *settled, known), strict=True):
            np.testing.assert_array_equal(was, now)
        missed = np.append(record[5] + 1, np.zeros(n, np.int64))
        record = tuple(after)
        np.testing.assert_array_equal(record[5], missed)
        np.testing.assert_array_equal(waits, asked)
        assert used == names_used
        assert record[0].tolist() == [names[first + k] for k in range(old + n)]
        gone = first + absences[:missing]
        assert gone.tolist() == [v for v in absent if onward[v - first] >= 0 or missed[v - first] < ages]
        there = [*known.tolist(), *range(fresh, first + old)]
        assert source[:missing].tolist() == [there.index(v) if v in there else -1 for v in gone.tolist()]
        known, fresh = gone[rng.random(missing) < 0.9], first + old
        held = {int(record[0][k]): k for k in np.flatnonzero(record[4])}
        assert {name: first + k for name, k in held.items()} == {name: h[0] for name, h in holder.items()}
        for name, k in held.items():
            assert [record[1][k], record[3][k]] == [holder[name][1], holder[name][3]]
            assert record[2][k] == pytest.approx(holder[name][2], abs=1e-12)


@pytest.mark.parametrize(("survive", "detect"), [(0.99, 0.95), (0.9, 0.5), (1.0, 1.0), (0.0, 0.3)])
def test_how_likely_the_missing_come_back(survive: float, detect: float):
    rng = np.random.default_rng(5)
    asked = rng.integers(0, 20, 12)
    waits = np.array([asked, rng.binomial(asked, 0.4)])
    for counts in (np.zeros_like(waits), waits):
        out = np.empty(12)
        # Of those that have left nothing is learned.
        unchanged(lambda s, d, w: come_back(s, d, w, out), np.array([survive, 0.0]), np.array([detect, 0.7]), counts)  # noqa: B023
        np.testing.assert_allclose(out, twin.returning(survive, detect, counts), atol=1e-12)
        assert (np.diff(out) <= 1e-12).all()
