"""The chains of the MCMC filter against plain twins that draw from the same generator: equal step by step."""

from __future__ import annotations

import numpy as np
import pytest

from phdtrack.kernels.mcmc import Options, independent_chain, jump_chain, linear_chain, option_tables, total_penalty
from reference.mcmc_twin import JumpChain
from reference.mcmc_twin import independent_chain as independent_twin
from reference.mcmc_twin import linear_chain as linear_twin
from reference.mcmc_twin import option_tables as tables_twin
from reference.mcmc_twin import total_penalty as penalty_twin


def places(rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, 4) boxes of which many overlap."""
    corner = rng.uniform(0, 3, (count, 2))
    return np.hstack([corner, corner + rng.uniform(0.5, 2, (count, 2))])


@pytest.mark.parametrize("boxes", [True, False])
def test_penalties(boxes: bool, rng):
    for count in (0, 1, 2, 7):
        place = places(rng, count)
        assert total_penalty(place, boxes) == pytest.approx(penalty_twin(place, boxes), rel=1e-12)
    same = np.array([[0.0, 0, 1, 1], [0.0, 0, 1, 1]])
    assert total_penalty(same, boxes) == 1.0


@pytest.mark.parametrize("greedy", [False, True])
@pytest.mark.parametrize("strength", [0.0, 2.0])
def test_chain_of_independent_targets(greedy: bool, strength: float, rng):
    n, steps = 3, 200
    target, weight = rng.integers(n, size=steps), rng.normal(0, 2, steps)
    height, start, place = -rng.standard_exponential(steps), rng.normal(0, 2, n), places(rng, n + steps)
    given = target, weight, height, start, place, strength, True, greedy, np.array([20, 3])
    kept, accepted = independent_chain(*given)
    expected, count = independent_twin(*given)
    np.testing.assert_array_equal(kept, expected)
    assert accepted == count
    assert 0 < accepted < steps
    assert kept.shape == (n, 60)


@pytest.mark.parametrize("n", [1, 3])
def test_chain_with_a_common_ancestor(n: int, rng):
    d, many, steps = 4, 6, 130
    origin, z = rng.normal(0, 1, (d, n * many)), rng.normal(0, 1, (2, n))
    inverse = np.column_stack([rng.uniform(1, 2, n), rng.uniform(-0.5, 0.5, n), rng.uniform(1, 2, n)])
    step, root = rng.normal(0, 1, (d, d)), rng.normal(0, 1, (d, d))
    share = rng.dirichlet(np.ones(many))
    switch, keep = rng.random(steps) < 0.4, np.array([10, 2])
    kept = np.empty((d, n * 60))
    ours, theirs = np.random.default_rng(4), np.random.default_rng(4)
    counts = linear_chain(
        origin, z, inverse, step, root, np.cumsum(share), np.log(share), switch, keep, ours, kept
    )  # fmt: skip
    expected, count = linear_twin(
        origin, z, inverse, step, root, np.cumsum(share), np.log(share), switch, keep, theirs
    )  # fmt: skip
    np.testing.assert_allclose(kept.reshape(d, n, 60), expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(counts, count)
    assert (counts[:, 1] > 0).all()
    assert (counts[:, 1] < counts[:, 0]).all()
    assert ours.random() == theirs.random()


def entries(rng: np.random.Generator, many: int, measurements: int):
    """Sorted entries of candidates: each has some states for some of the measurements, and some for none."""
    rows = []
    for c in range(many):
        some = np.flatnonzero(rng.random(measurements) < 0.6)
        for j in [-1, *some]:
            rows += [(c, j)] * int(rng.integers(1, 4))
    candidate, which = np.array(rows).T.copy()
    return candidate, which, rng.uniform(0.1, 3, len(rows)), rng.uniform(0.1, 2, many)


def test_tables_of_options(rng):
    candidate, which, weight, absent = entries(rng, 5, 4)
    first, seen_by, total, start, running = option_tables(candidate, which, weight, absent)
    expected = tables_twin(candidate, which, weight, absent)
    assert len(first) == 6
    for c, options in enumerate(expected):
        assert first[c + 1] - first[c] == len(options)
        for o, (j, w, table) in zip(range(first[c], first[c + 1]), options, strict=True):
            assert seen_by[o] == j
            assert total[o] == pytest.approx(w)
            assert list(range(start[o], start[o + 1])) == [e for e, _ in table]
            np.testing.assert_allclose(running[start[o] : start[o + 1]], [r for _, r in table])


def test_no_candidates(rng):
    none = np.zeros(0, np.int64)
    tables = option_tables(none, none, np.zeros(0), np.zeros(0))
    can = Options(*tables, none, np.zeros((0, 4)), 0.0, True)
    options, states, chance, counts = jump_chain(0, 2, can, np.zeros((0, 2), np.int64), 0.5, np.array([1, 1, 5]), rng)
    assert options.shape == states.shape == chance.shape == (0, 5)
    assert counts.sum() == 0


@pytest.mark.parametrize("strength", [0.0, 1.5])
@pytest.mark.parametrize("exchange", [0.0, 0.5])
def test_chain_over_who_is_there(strength: float, exchange: float, rng):
    many, measurements = 5, 4
    candidate, which, weight, absent = entries(rng, many, measurements)
    member = rng.permutation(len(candidate))
    place, keep = places(rng, len(candidate)), np.array([3, 2, 40])
    pairs = np.array([(a, b) for a in range(many) for b in range(a + 1, many)])
    tables = option_tables(candidate, which, weight, absent)
    ours, theirs = np.random.default_rng(4), np.random.default_rng(4)
    can = Options(*tables, member, place, strength, True)
    options, states, chance, counts = jump_chain(2, measurements, can, pairs, exchange, keep, ours)
    twin = JumpChain(2, measurements, tables_twin(candidate, which, weight, absent), member, place, strength, True, theirs)
    expected = twin.run(pairs, exchange, keep)
    np.testing.assert_array_equal(options - tables[0][:-1, None], expected[0])
    np.testing.assert_array_equal(states, expected[1])
    np.testing.assert_allclose(chance, expected[2], rtol=1e-9)
    np.testing.assert_array_equal(counts, expected[3])
    assert (counts[:6, 1] > 0).all()
    assert (counts[6, 1] > 0) == (exchange > 0)
    assert (counts[:, 1].sum() < counts[:, 0].sum()) == (strength > 0)
    assert ours.random() == theirs.random()
