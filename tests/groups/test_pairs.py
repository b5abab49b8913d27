"""Groups by pairs: the two-state chain against enumeration, clusters against all partitions, and
simulated walks.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np
import pytest

from phdtrack.groups.pairs import (
    ARRIVAL_TIME,
    COMPANY,
    FREEDOM,
    JOINING,
    MEMORY,
    NEIGHBOURHOOD,
    PARTING_TIME,
    SPEED_DIFFERENCE,
    STRANGERS,
    WIDE,
    WIDE_SHARE,
    Pairs,
    PairState,
    Walkers,
)
from phdtrack.kernels.clustering import EXACT, clusters
from phdtrack.types import F8, I8

PAIRS = Pairs()


def partitions(n: int) -> Iterator[list[int]]:
    """All ways to label n nodes, each once."""
    for label in itertools.product(range(n), repeat=n):
        if all(label[i] <= max(label[:i], default=-1) + 1 for i in range(n)):
            yield list(label)


def total(gain: F8, label: I8 | list[int]) -> float:
    same = np.equal.outer(label, label)
    return float(np.triu(gain * same, 1).sum())


def symmetric(rng: np.random.Generator, n: int, shift: float = 0.0) -> F8:
    gain = np.triu(rng.normal(shift, 1, (n, n)), 1)
    out: F8 = gain + gain.T
    return out


@pytest.mark.parametrize("n", [1, 2, 3, 5, pytest.param(7, marks=pytest.mark.slow)])
def test_clusters_are_the_best_partition(n: int) -> None:
    rng = np.random.default_rng(n)
    for _ in range(20):
        gain = symmetric(rng, n, rng.choice([-0.5, 0.0, 0.5]))
        found = clusters(gain)
        assert total(gain, found) == pytest.approx(
            max(total(gain, label) for label in partitions(n))
        )
        firsts = [found.tolist().index(k) for k in range(found.max() + 1)]
        assert firsts == sorted(firsts)


def test_many_nodes_are_clustered_well() -> None:
    """Planted clusters are found; and no single node that moves would gain."""
    rng = np.random.default_rng(1)
    n = 3 * EXACT
    planted = rng.integers(0, 4, n)
    gain = np.where(np.equal.outer(planted, planted), 1.0, -1.0) + 0.2 * symmetric(rng, n)
    found = clusters(gain)
    assert np.array_equal(np.equal.outer(found, found), np.equal.outer(planted, planted))
    gain = symmetric(rng, n)
    found = clusters(gain)
    best = total(gain, clusters(gain))
    for i in range(n):
        for k in range(n):
            moved = found.copy()
            moved[i] = k
            assert total(gain, moved) <= best + 1e-6
    assert clusters(np.zeros((0, 0))).tolist() == []


def walkers(
    time: float, people: dict[int, tuple[float, float, float, float]], variance: float = 0.0
) -> Walkers:
    mean = np.array(list(people.values()), np.float64).reshape(-1, 4).T
    who = np.array(list(people), np.int64)
    return Walkers(who, mean, np.tile(variance * np.eye(4), (len(who), 1, 1)), time)


def student(x2: float, variance: float) -> float:
    """Student's t in two dimensions, without the constant that does not depend on the variance."""
    return (1 + x2 / (FREEDOM * variance)) ** (-(FREEDOM + 2) / 2) / variance


def row_odds(w: Walkers, strangers: float) -> float:
    """p(row | together) / p(row | apart) of the first two people, as the module says it."""
    dx, dy, du, dv = w.mean[:, 0] - w.mean[:, 1]
    p, v = (w.covariance[0, k, k] + w.covariance[1, k, k] for k in (0, 2))
    near = sum(
        share * math.exp(-(dx**2 + dy**2) / (2 * (s**2 + p))) / (2 * math.pi * (s**2 + p))
        for share, s in ((1 - WIDE_SHARE, PAIRS.distance), (WIDE_SHARE, WIDE))
    )
    density = (1 + strangers) / (math.pi * NEIGHBOURHOOD**2)
    step = SPEED_DIFFERENCE**2 + v
    is_neighbour = COMPANY <= math.hypot(dx, dy) < NEIGHBOURHOOD
    of_each = [
        (is_neighbour * (du**2 + dv**2) + STRANGERS * 2 * (w.mean[2:, k] ** 2).sum())
        / (is_neighbour + STRANGERS)
        for k in (0, 1)
    ]
    own = step + float(sum(of_each)) / 2
    return near / density * student(du**2 + dv**2, step) / student(du**2 + dv**2, own)


def test_odds_are_those_of_a_two_state_chain() -> None:
    """By every sequence of states, together or apart, of what was seen up to a row, and of all that
    was seen.
    """
    rng = np.random.default_rng(3)
    times = np.array([0.0, 0.4, 0.9, 1.0, 2.5])
    walk = [
        walkers(t, {3: (t, 0, 1, 0.1), 8: (t + 0.2, d, *rng.normal([1, 0], 0.4))}, 0.02)
        for t, d in zip(times, [0.8, 1.4, 2.5, 2.0, 0.9], strict=True)
    ]
    frames = [walkers(-1.0, {3: (-1, 0, 1, 0)}), *walk, walkers(3.3, {8: (3, 0, 1, 0)})]
    steps = np.diff(times)
    odds = np.array([row_odds(w, 0.0) for w in walk])
    speed = np.array([np.hypot(*w.mean[2:]).mean() for w in walk[1:]])
    odds[1:] **= np.minimum(np.minimum(steps * speed / PAIRS.path, steps / MEMORY), 1)
    prior = PAIRS.prior_odds * math.exp(-1.0 / ARRIVAL_TIME)

    def chance(states: tuple[int, ...], rows: int) -> float:
        value = prior if states[0] else 1.0
        for k in range(rows):
            value *= odds[k] if states[k] else 1.0
            if k:
                parted = 1 - math.exp(-steps[k - 1] / PARTING_TIME)
                change = parted if states[k - 1] else JOINING * parted
                value *= change if states[k] != states[k - 1] else 1 - change
        return value

    def ratio(k: int, rows: int, end: float = 1.0) -> float:
        sums = [0.0, 0.0]
        for states in itertools.product((0, 1), repeat=rows):
            sums[states[k]] += chance(states, rows) * (end if states[-1] else 1.0)
        return math.log(sums[1] / sums[0])

    wide = Pairs(max_log_odds=1e6)
    state = PairState()
    forward = []
    for frame in frames:
        state, _ = wide.extend(state, frame)
        if frame.time >= 0 and len(frame.identity) == 2:
            forward.append(float(state.pairs.value[0]))
    assert forward == pytest.approx([ratio(k, k + 1) for k in range(5)], abs=1e-9)
    end = math.exp(-(3.3 - 2.5) / ARRIVAL_TIME)
    whole = [ratio(k, 5, end) for k in range(5)]
    found = wide.over_time(frames)
    assert [len(set(label.tolist())) == 1 for label in found[1:-1]] == [
        value > 0 for value in whole
    ]
    smoothed = [float(odds[0]) for odds, _ in wide.log_odds(frames)[1:-1]]
    assert smoothed == pytest.approx(whole, abs=1e-9)


def together(found: list[I8]) -> list[bool]:
    return [len(label) > 1 and bool(label[0] == label[1]) for label in found]


def online(frames: list[Walkers], pairs: Pairs = PAIRS) -> list[I8]:
    state = PairState()
    out = list[I8]()
    for frame in frames:
        state, label = pairs.extend(state, frame)
        out.append(label)
    return out


def side_by_side(
    apart: float, frames: int = 50, speed: float = 1.2, variance: float = 0.0
) -> list[Walkers]:
    return [
        walkers(
            0.2 * k,
            {1: (0.2 * k * speed, 0, speed, 0), 2: (0.2 * k * speed, apart, speed, 0)},
            variance,
        )
        for k in range(frames)
    ]


def test_companions_are_grouped_and_passers_by_are_not() -> None:
    assert all(together(online(side_by_side(0.8))))
    assert not any(together(online(side_by_side(4.5))))
    passing = [
        walkers(0.2 * k, {1: (0.24 * k, 0, 1.2, 0), 2: (12 - 0.24 * k, 0.8, -1.2, 0)})
        for k in range(50)
    ]
    assert not any(together(PAIRS.over_time(passing)))
    assert not any(together(online(passing)))


def test_pair_evidence_decays_and_pairs_may_part() -> None:
    """Two who walked together stay a group through a step aside; after they have parted for good
    they are none.
    """
    aside = [1.0] * 60 + [2.6] * 3 + [1.0] * 20
    frames = [
        walkers(0.2 * k, {1: (0.24 * k, 0, 1.2, 0), 2: (0.24 * k, d, 1.2, 0)})
        for k, d in enumerate(aside)
    ]
    assert all(together(online(frames)))
    away = [1.0] * 60 + [1.0 + 0.3 * k for k in range(60)]
    frames = [
        walkers(0.2 * k, {1: (0.24 * k, 0, 1.2, 0), 2: (0.24 * k, d, 1.2, 1.5 * (k > 60))})
        for k, d in enumerate(away)
    ]
    found = together(PAIRS.over_time(frames))
    assert all(found[:55])
    assert not any(found[85:])


def test_uncertain_people_give_less_evidence() -> None:
    def evidence(variance: float) -> float:
        state = PairState()
        for frame in side_by_side(0.5, 3, variance=variance):
            state, _ = PAIRS.extend(state, frame)
        return float(state.pairs.value[0])

    assert evidence(0.0) > evidence(0.3) > evidence(3.0)


def test_strangers_who_wait_side_by_side_are_no_group() -> None:
    """They came half a minute apart and stand for five; two who came together are one."""
    for later, expected in ((30.0, False), (0.0, True)):
        frames = []
        for k in range(750):
            time = 0.4 * k
            people = {1: (min(0.0, time - 10.0), 0.0, float(time < 10.0), 0.0)}
            if time >= later:
                walked = time - later
                people[2] = (min(0.0, walked - 10.0), 0.7, float(walked < 10.0), 0.0)
            frames.append(walkers(time, people))
        for found in (together(PAIRS.over_time(frames)), together(online(frames))):
            assert set(found[110:740]) == {expected}


def test_equal_steps_say_little_where_all_go_one_way() -> None:
    def odds(others: float) -> float:
        crowd = {k: (2.0 * (k % 3), 2.0 + k // 3, others, 0.0) for k in range(3, 9)}
        frame = walkers(0.0, {1: (0, 0, 1.2, 0), 2: (0, 0.8, 1.2, 0)} | crowd)
        state, _ = PAIRS.extend(PairState(), frame)
        return float(state.pairs.value[0])

    assert odds(1.2) < odds(-1.2)


def test_chain_of_strangers_is_not_a_group() -> None:
    """Four abreast are one group. Two couples are two, though one of each passes close to one of
    the other for a while.
    """
    row = [
        walkers(0.2 * k, {i: (0.24 * k, 0.9 * i, 1.2, 0) for i in range(1, 5)}) for k in range(50)
    ]
    assert all(len(set(label.tolist())) == 1 for label in PAIRS.over_time(row))
    couples = [
        walkers(
            0.2 * k,
            {i: (0.24 * k, 0.8 * i, 1.2, 0) for i in (1, 2)}
            | {i: (10 - 0.12 * k, 0.8 * i + 0.5, -0.6, 0) for i in (3, 4)},
        )
        for k in range(50)
    ]
    for found in (PAIRS.over_time(couples), online(couples)):
        assert all(label.tolist() == [0, 0, 1, 1] for label in found[3:])


def test_lost_identities_are_forgotten() -> None:
    state = PairState()
    for frame in [*side_by_side(1.0, 5), walkers(100.0, {9: (0, 0, 0, 0)})]:
        state, label = PAIRS.extend(state, frame)
    assert label.tolist() == [0]
    assert state.people.key.tolist() == [9]
    assert len(state.pairs.key) == 0
    assert PAIRS.over_time([]) == []
    assert PAIRS.over_time([walkers(0.0, {})])[0].tolist() == []
