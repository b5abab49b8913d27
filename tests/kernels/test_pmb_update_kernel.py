"""Weights of hypotheses about Bernoulli targets, their union and their best, against naive twins."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from phdtrack.kernels.marginals import ROUNDS, SETTLED
from phdtrack.kernels.pmb_update import foremost, united, weighed
from reference import pmb_twin as twin


def targets_of(rng: np.random.Generator, count: int):
    """Targets with up to four hypotheses each, as lists and as the kernel's columns."""
    exist, several = rng.uniform(0.02, 1, count), rng.integers(1, 5, count)
    first = np.concatenate([[0], np.cumsum(several)])
    weight = np.concatenate([np.sort(rng.dirichlet(np.ones(n)))[::-1] for n in several])
    seen = rng.uniform(0, 1, first[-1])
    lists = [
        (exist[t], list(zip(weight[a:b], seen[a:b], strict=True))) for t, (a, b) in enumerate(itertools.pairwise(first))
    ]
    return exist, first, weight, seen, lists


def pairs_of(rng: np.random.Generator, first: np.ndarray, n: int):
    """Some pairs of hypotheses and measurements with densities, ordered by hypothesis, and the same by target."""
    point, which = np.nonzero(rng.random((first[-1], n)) < 0.4)
    density = 10 ** rng.uniform(-3, 1, len(point))
    target = np.searchsorted(first, point, side="right") - 1
    named = zip(target.tolist(), (point - first[target]).tolist(), which.tolist(), strict=True)
    return point, which, density, dict(zip(named, density, strict=True))


@pytest.mark.parametrize("limits", [(1e-3, 0.01, 10), (0.2, 0.1, 3), (0.0, 0.0, 1), (1e-9, 1e-9, 1000)])
@pytest.mark.parametrize("seed", range(6))
def test_weights_after_a_measurement(seed: int, limits: tuple[float, float, int]):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(0, 7))
    exist, first, weight, seen, lists = targets_of(rng, int(rng.integers(1, 7)))
    point, which, density, pairs = pairs_of(rng, first, n)
    alone = 10 ** rng.uniform(-3, 0, n)
    kept, own, told = twin.weighed(lists, pairs, alone, *limits, ROUNDS, SETTLED)
    target, r, begin, source, taken, share, nobodys, of_pairs = weighed(
        exist, first, weight, seen, point, which, density, alone, *limits
    )
    assert target.tolist() == [t for t, *_ in kept]
    np.testing.assert_allclose(r, [p for _, p, _ in kept], rtol=1e-9)
    np.testing.assert_allclose(nobodys, own, rtol=1e-9)
    np.testing.assert_allclose(of_pairs, list(told.values()), rtol=1e-9, atol=1e-300)
    assert begin[0] == 0
    for i, (t, _, options) in enumerate(kept):
        here = slice(begin[i], begin[i + 1])
        mine = list(zip((source[here] - first[t]).tolist(), taken[here].tolist(), strict=True))
        assert mine == [(c, j) for c, j, _ in options]
        np.testing.assert_allclose(share[here], [p for *_, p in options], rtol=1e-9)
        assert share[here].sum() == pytest.approx(1)


def test_a_target_that_cannot_be_missed_and_is_missed():
    """r = p_D = 1 and no measurement: it is given up, and nothing is divided by 0."""
    one, none = np.ones(1), np.zeros(0, np.int64)
    found = weighed(one, np.array([0, 1]), one, one, none, none, np.zeros(0), np.zeros(0), 1e-3, 0.01, 10)
    assert [len(x) for x in found] == [0, 0, 1, 0, 0, 0, 0, 0]


def test_no_targets():
    none, zeros = np.zeros(0, np.int64), np.zeros(0)
    found = weighed(zeros, np.zeros(1, np.int64), zeros, zeros, none, none, zeros, np.ones(2), 1e-3, 0.01, 10)
    np.testing.assert_array_equal(found[6], np.ones(2))
    assert found[2].tolist() == [0]


@pytest.mark.parametrize("limit", [0.0, 0.01, 4.0, 1e9])
def test_hypotheses_that_say_the_same_are_one(limit: float):
    rng = np.random.default_rng(4)
    _, first, weight, _, _ = targets_of(rng, 40)
    count = len(weight)
    mean, static = rng.integers(0, 3, (4, count)) * rng.choice([0.05, 1.0], count), rng.random(count) < 0.3
    variance = 1 + rng.gamma(2.0, 1.0, (4, count))
    begin, kept, heavier = united(first, weight, np.ascontiguousarray(np.vstack([mean, variance]).T), static, limit)
    at = 0
    for a, b in itertools.pairwise(first):
        mine = [(weight[c], mean[:, c], variance[:, c], static[c]) for c in range(a, b)]
        wanted, sums = twin.united(mine, limit)
        assert (kept[at : at + len(wanted)] - a).tolist() == wanted
        np.testing.assert_allclose(heavier[at : at + len(wanted)], sums, rtol=1e-12)
        at += len(wanted)
        assert at in begin
    assert len(kept) == at == begin[-1]
    assert (len(kept) == count) == (limit == 0)


@pytest.mark.parametrize("seed", range(3))
def test_the_best_hypothesis_and_the_presence(seed: int):
    rng = np.random.default_rng(seed)
    exist, first, weight, _, _ = targets_of(rng, 20)
    static = rng.random(len(weight)) < 0.5
    best, presence = foremost(exist, first, weight, static)
    for t in range(20):
        moving = [c for c in range(first[t], first[t + 1]) if not static[c]]
        assert best[t] == max(moving, key=lambda c: weight[c], default=-1)
        assert presence[t] == pytest.approx(exist[t] * sum(weight[c] for c in moving))
    assert (best < 0).any()
