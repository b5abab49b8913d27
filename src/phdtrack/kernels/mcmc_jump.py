"""A chain over who is there, who gave which measurement, and where everybody is [K05, its reversible-jump form].

Every candidate (a target of the frame before, or a newborn at a measurement) has a list of options: the first is that he is
not there, each other one that he is, unseen or seen by one measurement. An option has a weight and a table of states to draw
from; a measurement goes to one candidate at most. `jump_chain` says what a step does; `filters.mcmc_jump` says why it
is right and makes the tables.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.mcmc_apart import crowding, penalty

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

# Rows of the counts: what a step proposed.
ADD, DELETE, LEAVE, COME_BACK, UPDATE, REASSIGN, EXCHANGE = range(7)


class Options(NamedTuple):
    """What candidates may be: `option_tables`, with ``member`` (T,) the state of each entry.

    ``place`` (L, 4), ``strength`` and ``boxes`` are the interaction, see `mcmc_apart`; without it no place is read.
    (Kernels that steps call take the arrays one by one: out of a tuple each would be counted as referred to at every use.)
    """

    first: I8
    seen_by: I8
    total: F8
    start: I8
    running: F8
    member: I8
    place: F8
    strength: float
    boxes: bool


@njit(**ENTRY)
def option_tables(candidate: I8, which: I8, weight: F8, absent: F8) -> tuple[I8, I8, F8, I8, F8]:
    """Options of sorted entries.

    Parameters
    ----------
    candidate, which, weight : (T,) entries, one a state: whose it is, by which measurement he is seen in it (−1: by none),
        and its weight; ascending in the first two.
    absent : (C,) weight of each candidate's not being there.

    Returns
    -------
    first : (C + 1,) candidate c's options are first[c] … first[c + 1] − 1, the first of them that he is not there.
    seen_by : (O,) measurement of each option, −1 for none.        total : (O,) its weight.
    start : (O + 1,) its entries are start[o] … start[o + 1] − 1.        running : (T,) sums of weights within each option.
    """
    count, entries = absent.size, candidate.size
    first, most = np.empty(count + 1, np.int64), count + entries
    seen_by, total, start = np.full(most, -1), np.zeros(most), np.empty(most + 1, np.int64)
    running = np.empty(entries)
    o, e = 0, 0
    for c in range(count):
        first[c] = o
        total[o], start[o] = absent[c], e
        o += 1
        while e < entries and candidate[e] == c:
            seen_by[o], start[o] = which[e], e
            reached = 0.0
            while e < entries and candidate[e] == c and which[e] == seen_by[o]:
                reached += weight[e]
                running[e] = reached
                e += 1
            total[o] = reached
            o += 1
    first[count], start[o] = o, e
    return first, seen_by[:o].copy(), total[:o].copy(), start[: o + 1].copy(), running


@njit(**INNER)
def free_weight(o: int, a: int, b: int, seen_by: I8, total: F8, taken: I8) -> float:
    """Weight of an option for candidates a or b; 0 where its measurement is somebody else's."""
    j = seen_by[o]
    if j < 0 or taken[j] < 0 or taken[j] == a or taken[j] == b:
        weight: float = total[o]
        return weight
    return 0.0


@njit(**INNER)
def _state(o: int, start: I8, running: F8, member: I8, rng: np.random.Generator) -> int:
    """A state of option ``o``, by weight."""
    low, high = start[o], start[o + 1] - 1
    aim = rng.random() * running[high]
    while low < high:
        middle = (low + high) // 2
        if running[middle] > aim:
            high = middle
        else:
            low = middle + 1
    out: int = member[low]
    return out


@njit(**INNER)
def _choose(c: int, begin: int, first: I8, seen_by: I8, total: F8, taken: I8, rng: np.random.Generator) -> int:
    """One of the free options of ``c`` from ``begin`` on, by weight; −1 where all weigh nothing."""
    end, reached = first[c + 1], 0.0
    for o in range(begin, end):
        reached += free_weight(o, c, c, seen_by, total, taken)
    aim = rng.random() * reached
    chosen = -1
    for o in range(begin, end):
        weight = free_weight(o, c, c, seen_by, total, taken)
        if weight > 0.0:
            chosen = o
            aim -= weight
            if aim < 0.0:
                break
    return chosen


@njit(**INNER)
def _pair_weight(o: int, p: int, a: int, b: int, seen_by: I8, total: F8, taken: I8) -> float:
    """Weight of options ``o`` of a and ``p`` of b together; 0 where they are not free, or the same measurement."""
    if seen_by[o] >= 0 and seen_by[o] == seen_by[p]:
        return 0.0
    weight: float = free_weight(o, a, b, seen_by, total, taken) * free_weight(p, a, b, seen_by, total, taken)
    return weight


@njit(**INNER)
def _choose_two(a: int, b: int, first: I8, seen_by: I8, total: F8, taken: I8, rng: np.random.Generator) -> tuple[int, int]:
    """One of the free pairs of options of ``a`` and ``b``, by the product of weights."""
    reached = 0.0
    for o in range(first[a], first[a + 1]):
        for p in range(first[b], first[b + 1]):
            reached += _pair_weight(o, p, a, b, seen_by, total, taken)
    aim = rng.random() * reached
    chosen, other = -1, -1
    for o in range(first[a], first[a + 1]):
        for p in range(first[b], first[b + 1]):
            weight = _pair_weight(o, p, a, b, seen_by, total, taken)
            if weight > 0.0:
                chosen, other = o, p
                aim -= weight
                if aim < 0.0:
                    return chosen, other
    return chosen, other


@njit(**INNER)
def _kind(was: int, becomes: int, absence: int, newborn: bool, seen_by: I8) -> int:
    """Which row of the counts a change of option belongs to; −1 where somebody stays away."""
    if was == absence:
        if becomes == absence:
            return -1
        return ADD if newborn else COME_BACK
    if becomes == absence:
        return DELETE if newborn else LEAVE
    return UPDATE if seen_by[was] == seen_by[becomes] else REASSIGN


@njit(**INNER)
def _crowd(c: int, besides: int, i: int, place: F8, boxes: bool, state: I8) -> float:
    """Penalties of candidate ``c``, in state ``i`` or not there (−1), with all others but ``besides``."""
    return crowding(place, i, state, c, besides, boxes) if i >= 0 else 0.0


@njit(**INNER)
def _refused(more: float, strength: float, rng: np.random.Generator) -> bool:
    """Hastings: a proposal with so much more of a penalty is accepted with probability exp(−strength · more)."""
    return more > 0.0 and rng.random() >= np.exp(-strength * more)


@njit(**INNER)
def _give_back(c: int, option: I8, seen_by: I8, taken: I8) -> None:
    j = seen_by[option[c]]
    if j >= 0:
        taken[j] = -1


@njit(**INNER)
def _take(c: int, o: int, i: int, option: I8, state: I8, seen_by: I8, taken: I8) -> None:
    option[c], state[c] = o, i
    j = seen_by[o]
    if j >= 0:
        taken[j] = c


@njit(**INNER)
def redraw_one(
    c: int, newborn: bool, first: I8, seen_by: I8, total: F8, start: I8, running: F8, member: I8, place: F8, strength: float,
    boxes: bool, option: I8, state: I8, taken: I8, rng: np.random.Generator, counts: I8,
) -> None:  # fmt: skip
    """A step that moves one candidate, given all others."""
    o = _choose(c, first[c], first, seen_by, total, taken, rng)
    i = -1 if o == first[c] else _state(o, start, running, member, rng)
    kind = _kind(option[c], o, first[c], newborn, seen_by)
    if kind < 0:
        return
    counts[kind, 0] += 1
    if strength > 0.0 and _refused(
        _crowd(c, c, i, place, boxes, state) - _crowd(c, c, state[c], place, boxes, state), strength, rng
    ):
        return
    counts[kind, 1] += 1
    _give_back(c, option, seen_by, taken)
    _take(c, o, i, option, state, seen_by, taken)


@njit(**INNER)
def _crowd_of_two(a: int, b: int, i: int, k: int, place: F8, boxes: bool, state: I8) -> float:
    """Penalties of ``a`` in state ``i`` and ``b`` in state ``k`` with everybody and each other."""
    total: float = _crowd(a, b, i, place, boxes, state) + _crowd(b, a, k, place, boxes, state)
    return total + penalty(place, i, k, boxes) if i >= 0 and k >= 0 else total


@njit(**INNER)
def redraw_two(
    a: int, b: int, first: I8, seen_by: I8, total: F8, start: I8, running: F8, member: I8, place: F8, strength: float,
    boxes: bool, option: I8, state: I8, taken: I8, rng: np.random.Generator, counts: I8,
) -> None:  # fmt: skip
    """A step that moves two candidates at once, given all others."""
    o, p = _choose_two(a, b, first, seen_by, total, taken, rng)
    i = -1 if o == first[a] else _state(o, start, running, member, rng)
    k = -1 if p == first[b] else _state(p, start, running, member, rng)
    counts[EXCHANGE, 0] += 1
    if strength > 0.0 and _refused(
        _crowd_of_two(a, b, i, k, place, boxes, state) - _crowd_of_two(a, b, state[a], state[b], place, boxes, state),
        strength,
        rng,
    ):
        return
    counts[EXCHANGE, 1] += 1
    _give_back(a, option, seen_by, taken)
    _give_back(b, option, seen_by, taken)
    _take(a, o, i, option, state, seen_by, taken)
    _take(b, p, k, option, state, seen_by, taken)


@njit(**INNER)
def _chance(
    c: int, first: I8, seen_by: I8, total: F8, start: I8, running: F8, member: I8, place: F8, strength: float,
    boxes: bool, option: I8, state: I8, taken: I8, rng: np.random.Generator,
) -> tuple[int, float]:  # fmt: skip
    """The state of one who is there, or would be, and the probability that he is, given it and all others."""
    there = 0.0
    for o in range(first[c] + 1, first[c + 1]):
        there += free_weight(o, c, c, seen_by, total, taken)
    if there <= 0.0:
        return member[start[first[c] + 1]], 0.0
    i = state[c]
    if i < 0:
        i = _state(_choose(c, first[c] + 1, first, seen_by, total, taken, rng), start, running, member, rng)
    if strength > 0.0:
        there *= np.exp(-strength * _crowd(c, c, i, place, boxes, state))
    return i, there / (there + total[first[c]])


@njit(**ENTRY)
def jump_chain(
    old: int, measurements: int, can: Options, pairs: I8, exchange: float, keep: I8, rng: np.random.Generator
) -> tuple[I8, I8, F8, I8]:
    """Samples of the options and states of all candidates.

    A step picks a candidate and draws one of his free options by weight, and of it a state; with probability ``exchange`` it
    picks one of ``pairs`` and draws for both together. Without interaction that is a draw from the conditional law and
    always accepted; with it, it is accepted with probability min(1, ψ of the new state / ψ of the old one).

    Parameters
    ----------
    old : candidates before this one were there in the frame before; the others are newborn.
    measurements : how many there are.        pairs : (K, 2) candidates that compete for a measurement.
    keep : (3,) sweeps before the first kept sample, sweeps for each one that is kept, and how many are kept. A sweep has as
        many steps as there are candidates.

    Returns
    -------
    options, states : (C, N) each candidate's in each kept sample. Of one who is not there, the state is a draw from where
        he would be.
    chance : (C, N) the probability that he is there, given that state and all the others in the sample.
    counts : (7, 2) proposed and accepted, by kind.
    """
    first, seen_by, total, start, running, member, place, strength, boxes = can
    many, kept = first.size - 1, keep[2]
    option, state, taken = first[:-1].copy(), np.full(many, -1), np.full(measurements, -1)
    options, states = np.empty((many, kept), np.int64), np.empty((many, kept), np.int64)
    chance, counts = np.empty((many, kept)), np.zeros((7, 2), np.int64)
    for sweep in range(keep[0] + keep[1] * kept):
        for _ in range(many):
            if pairs.shape[0] > 0 and rng.random() < exchange:
                k = int(rng.random() * pairs.shape[0])
                redraw_two(
                    pairs[k, 0], pairs[k, 1], first, seen_by, total, start, running, member, place, strength, boxes,
                    option, state, taken, rng, counts,
                )  # fmt: skip
            else:
                c = int(rng.random() * many)
                redraw_one(
                    c, c >= old, first, seen_by, total, start, running, member, place, strength, boxes,
                    option, state, taken, rng, counts,
                )  # fmt: skip
        if sweep >= keep[0] and (sweep - keep[0] + 1) % keep[1] == 0:
            n = (sweep - keep[0]) // keep[1]
            for c in range(many):
                options[c, n] = option[c]
                states[c, n], chance[c, n] = _chance(
                    c, first, seen_by, total, start, running, member, place, strength, boxes,
                    option, state, taken, rng,
                )  # fmt: skip
    return options, states, chance, counts
