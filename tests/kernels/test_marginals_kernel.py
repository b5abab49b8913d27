"""Who has which measurement: belief propagation against its twin, and against every assignment."""

from __future__ import annotations

import numpy as np
import pytest

from inner_kernels import from_python
from phdtrack.kernels.association import EDGE, ROUNDS, SETTLED, beliefs
from reference import pmb_twin as twin

[beliefs_of] = from_python(beliefs)


def marginals(odds, target, which, targets: int, n: int):
    """The kernel's marginals of pairs."""
    edges = np.zeros(len(odds), EDGE)
    edges["odds"] = odds
    edges["target"] = target
    edges["measurement"] = which
    missed, own = beliefs_of(edges, targets, n)
    return edges["mu"], missed, own


def of_table(psi: np.ndarray, order: np.ndarray | None = None):
    """The kernel's marginals of a table of odds (T, N), as tables; pairs in this order."""
    target, which = np.nonzero(psi)
    order = np.arange(len(target)) if order is None else order
    target = target[order]
    which = which[order]
    pair, missed, own = marginals(psi[target, which], target, which, *psi.shape)
    table = np.zeros_like(psi)
    table[target, which] = pair
    return table, missed, own


def odds(rng: np.random.Generator, targets: int, n: int, density: float = 0.6) -> np.ndarray:
    """A table of odds of all orders of magnitude from 0.01 to 1000, with gaps."""
    return 10 ** rng.uniform(-2, 3, (targets, n)) * (rng.random((targets, n)) < density)


def same(a, b, **tolerance) -> None:
    for x, y in zip(a, b, strict=True):
        np.testing.assert_allclose(x, y, **tolerance)


@pytest.mark.parametrize("seed", range(20))
def test_messages_are_those_of_the_whole_table(seed: int):
    rng = np.random.default_rng(seed)
    psi = odds(rng, int(rng.integers(1, 8)), int(rng.integers(1, 8)))
    same(of_table(psi), twin.propagated(psi, ROUNDS, SETTLED), rtol=1e-12, atol=1e-15)


def forest(rng: np.random.Generator, targets: int, n: int) -> np.ndarray:
    """Odds whose pairs form no cycle."""
    psi = np.zeros((targets, n))
    root = np.arange(targets + n)
    for place in rng.permutation(targets * n):
        t, j = divmod(int(place), n)
        if root[t] != root[targets + j]:
            root[root == root[t]] = root[targets + j]
            psi[t, j] = 10 ** rng.uniform(-2, 3)
    return psi


@pytest.mark.parametrize("seed", range(20))
def test_marginals_are_exact_on_trees(seed: int):
    rng = np.random.default_rng(seed)
    psi = forest(rng, int(rng.integers(1, 5)), int(rng.integers(1, 5)))
    same(of_table(psi), twin.enumerated(psi), rtol=0, atol=1e-9)


def test_marginals_are_nearly_exact_with_cycles():
    """The greatest error of 300 small tables, odds of up to 1000: 0.014 on average, 0.22 at worst,
    0.0004 of half.
    """
    rng = np.random.default_rng(1)
    error = []
    for _ in range(300):
        psi = odds(rng, int(rng.integers(2, 5)), int(rng.integers(2, 5)), 0.8)
        error.append(
            max(
                np.abs(a - b).max()
                for a, b in zip(of_table(psi), twin.enumerated(psi), strict=True)
            )
        )
    assert 1e-3 < np.mean(error) < 0.02
    assert np.median(error) < 1e-3
    assert np.max(error) < 0.25


def test_impossible_and_certain_pairs():
    one = np.arange(2)
    pair, missed, own = marginals(np.array([0.0, 1e15]), one, one, 2, 2)
    np.testing.assert_allclose(pair, [0, 1], atol=1e-14)
    np.testing.assert_allclose(missed, [1, 0], atol=1e-14)
    np.testing.assert_allclose(own, [1, 0], atol=1e-14)
    # Two that cannot be missed and want the same: one has it, either as likely; nothing overflows.
    pair, missed, own = marginals(np.full(2, 1e15), one, np.zeros(2, np.int64), 2, 1)
    np.testing.assert_allclose(pair, 0.5)
    np.testing.assert_allclose(missed, 0.5)
    np.testing.assert_allclose(own, 0, atol=1e-14)
    huge = of_table(np.full((3, 3), 1e300))
    assert all(np.isfinite(x).all() for x in huge)
