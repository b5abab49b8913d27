"""Components, competing tracks, and Murty's k best assignments: as their definitions and
enumeration have them.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from phdtrack.kernels.association import best_assignments, best_pairs, competing, components
from phdtrack.kernels.branching import children, equal_rows
from reference import hypotheses_twin as twins


def problem(seed: int, whole: bool = False):
    """A cluster of a few measurements, tracks and hypotheses; whole numbers make ties."""
    rng = np.random.default_rng(seed)
    m = int(rng.integers(1, 5))
    tracks = int(rng.integers(0, 6))
    parents = int(rng.integers(1, 4))
    draw = (
        (lambda *size: rng.integers(-3, 4, size).astype(float))
        if whole
        else (lambda *size: rng.normal(0, 2, size))
    )
    gain = np.where(rng.random((m, tracks)) < 0.7, draw(m, tracks), -np.inf)
    held = np.full((parents, min(tracks, 3) + 1), -1)
    for row in held:
        size = int(rng.integers(0, len(row)))
        row[rng.permutation(len(row))[:size]] = rng.permutation(tracks)[:size]
    return np.ascontiguousarray(gain), draw(m), held.astype(np.int64), draw(parents)


@given(
    st.integers(0, 2**32 - 1),
    st.booleans(),
    st.sampled_from([1, 2, 5, 12, 3000]),
    st.sampled_from([-0.5, -3.0, -8.0, -np.inf]),
)
@settings(max_examples=250, deadline=None)
def test_assignments_are_the_best_in_order(seed: int, whole: bool, most: int, log_ratio: float):
    world = problem(seed, whole)
    wanted = twins.all_assignments(*world)
    best = wanted[0][0]
    everything = {item[1:]: item[0] for item in wanted}
    wanted = [item for item in wanted if item[0] >= best + log_ratio - 1e-9][:most]
    parent, choice, weight = best_assignments(*world, most, log_ratio - 1e-9)
    np.testing.assert_allclose(weight, [item[0] for item in wanted], atol=1e-9)
    found = [(int(p), tuple(c.tolist())) for p, c in zip(parent, choice, strict=True)]
    assert len(set(found)) == len(wanted), "each once"
    if not whole:
        assert found == [item[1:] for item in wanted]
    np.testing.assert_allclose(weight, [everything[one] for one in found])


@pytest.mark.parametrize("seed", range(20))
def test_best_pairs_have_the_largest_sum(seed: int):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 30))
    gain = np.where(rng.random((count, count)) < 0.2, rng.normal(1, 2, (count, count)), -np.inf)
    row, column = np.nonzero(np.isfinite(gain))
    found = best_pairs(row, column, gain[row, column], count)
    chosen = np.flatnonzero(found >= 0)
    assert len(set(found[chosen].tolist())) == len(chosen)
    # A row may stay alone: as with a pair of gain 0.
    worth = np.maximum(gain, 0)
    assert gain[chosen, found[chosen]].sum() == pytest.approx(
        worth[linear_sum_assignment(worth, maximize=True)].sum()
    )


def test_best_hundred_of_many_assignments():
    """12 measurements, 12 tracks, 10¹² assignments: the best hundred, each once, and no better
    neighbour is left out.
    """
    rng = np.random.default_rng(4)
    gain = rng.normal(2, 1, (12, 12))
    alone = rng.normal(0, 1, 12)
    held = np.tile(np.arange(12), (2, 1))
    parent, choice, weight = best_assignments(gain, alone, held, np.array([0.0, -0.3]), 100, -20.0)
    assert len(weight) == 100
    assert (np.diff(weight) <= 1e-9).all()
    assert len({(int(p), *c.tolist()) for p, c in zip(parent, choice, strict=True)}) == 100
    for p, c, w in zip(parent, choice, weight, strict=True):
        taken = c[c >= 0]
        assert len(set(taken.tolist())) == len(taken)
        assert w == pytest.approx(
            -0.3 * p + alone.sum() + sum(gain[j, k] for j, k in enumerate(c) if k >= 0)
        )
    # Neighbours of those given: exchange of two tracks, or one given up. What is better than the
    # last is among them.
    given_ = {(int(p), *c.tolist()) for p, c in zip(parent, choice, strict=True)}
    for p, c, w in zip(parent[:30], choice[:30], weight[:30], strict=True):
        for i in range(12):
            for j in range(i):
                other = c.copy()
                other[[i, j]] = c[[j, i]]
                value = w
                for row in (i, j):
                    value += (gain[row, other[row]] if other[row] >= 0 else 0) - (
                        gain[row, c[row]] if c[row] >= 0 else 0
                    )
                assert value < weight[-1] + 1e-9 or (int(p), *other.tolist()) in given_


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=100, deadline=None)
def test_components_are_those_of_the_graph(seed: int):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 15))
    first, second = rng.integers(0, count, (2, int(rng.integers(0, 15))))
    np.testing.assert_array_equal(
        components(count, first, second), twins.components(count, first, second)
    )


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=100, deadline=None)
def test_tracks_that_share_measurements_compete(seed: int):
    rng = np.random.default_rng(seed)
    forms = int(rng.integers(1, 12))
    window = int(rng.integers(1, 4))
    tracks = int(rng.integers(1, 6))
    leaf = rng.integers(-1, forms, (int(rng.integers(1, 5)), tracks))
    # A form belongs to one track.
    leaf = np.where(leaf % tracks == np.arange(tracks), leaf, -1)
    trace = np.where(rng.random((forms, window)) < 0.5, rng.integers(0, 5, (forms, window)), -1)
    np.testing.assert_array_equal(competing(leaf, trace, 5), twins.competing(leaf, trace))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=100, deadline=None)
def test_children_are_all_assignments_of_the_leaves(seed: int):
    """Leaves and measurements of the whole frame in, numbers of branches out."""
    rng = np.random.default_rng(seed)
    leaves = int(rng.integers(1, 7))
    count = int(rng.integers(1, 6))
    columns = np.sort(rng.permutation(count)[: int(rng.integers(1, min(count, 3) + 1))])
    held = np.full((int(rng.integers(1, 4)), min(leaves, 3)), -1)
    for row in held:
        # A track's forms are other leaves than any other track's.
        for t in range(len(row)):
            mine = np.arange(t, leaves, len(row))
            row[t] = rng.choice([-1, *mine])
    gain = np.where(rng.random((leaves, count)) < 0.7, rng.normal(0, 2, (leaves, count)), -np.inf)
    gain[np.setdiff1d(np.arange(leaves), held)] = -np.inf
    leaf, measurement = np.nonzero(np.isfinite(gain[:, columns]))
    measurement = columns[measurement]
    missed = rng.normal(-1, 0.5, leaves)
    alone = rng.normal(0, 2, count)
    begins = rng.random(count) < 0.7
    weight = rng.dirichlet(np.ones(len(held)))
    branch, share, unassigned = children(
        held,
        weight,
        (leaf, measurement, gain[leaf, measurement]),
        columns,
        missed,
        alone,
        begins,
        (3000, -np.inf),
    )
    base = np.log(weight) + np.where(held >= 0, missed[held], 0.0).sum(axis=1)
    wanted = {}
    nobody = np.zeros(len(columns))
    every = twins.all_assignments((gain[:, columns] - alone[columns]).T, alone[columns], held, base)
    total = sum(np.exp(w) for w, *_ in every)
    for log_weight, p, choice in every:
        took = {c: int(j) for c, j in zip(choice, columns, strict=True) if c >= 0}
        tracks = [(x + 1) * (count + 1) + took.get(x, -1) + 1 for x in held[p].tolist() if x >= 0]
        new = [int(j) + 1 for c, j in zip(choice, columns, strict=True) if c < 0 and begins[j]]
        key = frozenset(tracks + new)
        wanted[key] = wanted.get(key, 0.0) + np.exp(log_weight) / total
        nobody += (np.array(choice) < 0) * np.exp(log_weight) / total
    found = {}
    for row, w in zip(branch.tolist(), share, strict=True):
        key = frozenset(x for x in row if x >= 0)
        found[key] = found.get(key, 0.0) + w
    assert found.keys() == wanted.keys()
    np.testing.assert_allclose([found[k] for k in wanted], list(wanted.values()), rtol=1e-9)
    np.testing.assert_allclose(unassigned, nobody, rtol=1e-9, atol=1e-12)
    assert (branch >= 0).any(axis=0).all()


@given(st.lists(st.lists(st.integers(-1, 3), min_size=3, max_size=3), min_size=1, max_size=60))
@settings(deadline=None)
def test_equal_rows_have_the_index_of_the_first(rows: list[list[int]]):
    assert equal_rows(np.array(rows)).tolist() == [rows.index(row) for row in rows]
