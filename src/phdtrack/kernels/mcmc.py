"""The chains of the MCMC filter: Metropolis–Hastings over the joint state of all targets [K05, D14 Alg. 1].

`independent_chain` and `linear_chain` serve where it is known which target gave which measurement (`filters.mcmc_given`);
`jump_chain` samples which targets are there and which measurement each gave as well (`filters.mcmc`). The pairwise potential
that keeps targets apart is ψ(x, y) = exp(−strength · penalty(x, y)): the penalty is the overlap of boxes (intersection over
union), or exp(−|x − y|²/2) of points with positions in units of its range.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, INNER

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
Bool = NDArray[np.bool_]
# Rows of the counts: what a step proposed.
ADD, DELETE, LEAVE, COME_BACK, UPDATE, REASSIGN, EXCHANGE = range(7)


@njit(**INNER)
def penalty(place: F8, a: int, b: int, boxes: bool) -> float:
    """Of rows a and b of ``place`` (L, 4): corners of boxes, or scaled positions in the first two columns."""
    if not boxes:
        dx, dy = place[a, 0] - place[b, 0], place[a, 1] - place[b, 1]
        near: float = np.exp(-0.5 * (dx * dx + dy * dy))
        return near
    wide = min(place[a, 2], place[b, 2]) - max(place[a, 0], place[b, 0])
    tall = min(place[a, 3], place[b, 3]) - max(place[a, 1], place[b, 1])
    if wide <= 0.0 or tall <= 0.0:
        return 0.0
    shared = wide * tall
    own = (place[a, 2] - place[a, 0]) * (place[a, 3] - place[a, 1])
    other = (place[b, 2] - place[b, 0]) * (place[b, 3] - place[b, 1])
    overlap: float = shared / (own + other - shared)
    return overlap


@njit(**INNER)
def crowding(place: F8, row: int, others: I8, skip: int, besides: int, boxes: bool) -> float:
    """Sum of the penalties of ``row`` with the rows ``others``, −1 for none, of which two places are passed over."""
    total = 0.0
    for k in range(others.size):
        if others[k] >= 0 and k != skip and k != besides:
            total += penalty(place, row, others[k], boxes)
    return total


@njit(**ENTRY)
def total_penalty(place: F8, boxes: bool) -> float:
    """Sum of the penalties of all pairs of rows."""
    total = 0.0
    for a in range(place.shape[0]):
        for b in range(a):
            total += penalty(place, a, b, boxes)
    return total


@njit(**ENTRY)
def independent_chain(
    target: I8, weight: F8, height: F8, start: F8, place: F8, strength: float, boxes: bool, greedy: bool, keep: I8
) -> tuple[I8, int]:
    """Accept or reject proposals, each for one target.

    Parameters
    ----------
    target, weight : (S,) the target of each proposal, and its log-likelihood, less the logarithm of the proposal's law where
        that is not constant; never less it where ``greedy``, in which a constant does not cancel.
    height : (S,) logarithms of uniform numbers.
    start : (n,) those of the states that the chain starts from.
    place : (n + S, 4) where these and the proposals are, see `mcmc_apart`; read where ``strength`` is above 0.
    greedy : accept ratios of 1 and more only, and take the ratio for the target's weight where it is less [D14 Alg. 1].
    keep : (2,) steps before the first kept sample, and steps for each one that is kept.

    Returns
    -------
    kept : (n, N) what each target's state is in each kept sample: a number below n is a start, n + s proposal s.
    accepted : number of accepted proposals.
    """
    n, burn, thin = start.size, keep[0], keep[1]
    kept = np.empty((n, (target.size - burn) // thin), np.int64)
    now, cached = np.arange(n), start.copy()
    accepted = 0
    for s in range(target.size):
        t = target[s]
        gain = weight[s] - cached[t]
        if strength > 0.0:
            gain -= strength * (crowding(place, n + s, now, t, t, boxes) - crowding(place, now[t], now, t, t, boxes))
        if gain >= (0.0 if greedy else height[s]):
            now[t], cached[t] = n + s, weight[s]
            accepted += 1
        elif greedy:
            cached[t] = gain
        if s >= burn and (s - burn + 1) % thin == 0:
            for k in range(n):
                kept[k, (s - burn) // thin] = now[k]
    return kept, accepted


@njit(**INNER)
def _moved(origin: F8, column: int, step: F8, root: F8, rng: np.random.Generator, out: F8) -> None:
    """A draw of N(F ξ, L Lᵀ) about column ``column`` of ``origin`` (d, L), into ``out`` (d,)."""
    d = out.size
    for i in range(d):
        out[i] = 0.0
    for j in range(d):
        x, noise = origin[j, column], rng.standard_normal()
        for i in range(d):
            out[i] += step[i, j] * x + root[i, j] * noise


@njit(**INNER)
def _fit(z: F8, inverse: F8, t: int, x: F8) -> float:
    """log g(z_t|x) up to a constant: −½ dᵀ R⁻¹ d of the position; ``inverse`` (n, 3) holds xx, xy, yy."""
    dx, dy = z[0, t] - x[0], z[1, t] - x[1]
    out: float = -0.5 * (inverse[t, 0] * dx * dx + 2.0 * inverse[t, 1] * dx * dy + inverse[t, 2] * dy * dy)
    return out


@njit(**ENTRY)
def linear_chain(
    origin: F8, z: F8, inverse: F8, step: F8, root: F8, running: F8, log_proposal: F8, switch: Bool, keep: I8,
    rng: np.random.Generator, kept: F8,
) -> I8:  # fmt: skip
    """The chain with one common ancestor, for x = F ξ + L ν and positions as measurements.

    Parameters
    ----------
    origin : (d, n·M) the samples of the frame before, those of a target beside each other.
    z, inverse : (2, n) positions, and (n, 3) R⁻¹ of each, packed as xx, xy, yy.
    step, root : (d, d) F and L.
    running, log_proposal : (M,) the law that ancestors are proposed by: sums of its probabilities, and their logarithms.
    switch : (S,) which steps change the ancestor; the others redraw one target.
    keep : (2,) steps before the first kept sample, and steps for each one that is kept.
    kept : (d, n·N) is filled with the kept samples.

    Returns (2, 2) proposed and accepted, of redraws (first row) and of changes of the ancestor.
    """
    d, n = origin.shape[0], z.shape[1]
    many, count = origin.shape[1] // n, kept.shape[1] // n
    counts = np.zeros((2, 2), np.int64)
    now, new = np.empty((n, d)), np.empty((n, d))
    fit, fits = np.empty(n), np.empty(n)
    ancestor = np.searchsorted(running, rng.random() * running[-1], side="right")
    for t in range(n):
        _moved(origin, t * many + ancestor, step, root, rng, now[t])
        fit[t] = _fit(z, inverse, t, now[t])
    for s in range(switch.size):
        if switch[s]:
            other = np.searchsorted(running, rng.random() * running[-1], side="right")
            gain = log_proposal[ancestor] - log_proposal[other]
            for t in range(n):
                _moved(origin, t * many + other, step, root, rng, new[t])
                fits[t] = _fit(z, inverse, t, new[t])
                gain += fits[t] - fit[t]
            counts[1, 0] += 1
            if gain >= 0.0 or rng.random() < np.exp(gain):
                now, new, fit, fits, ancestor = new, now, fits, fit, other
                counts[1, 1] += 1
        else:
            t = int(rng.random() * n)
            _moved(origin, t * many + ancestor, step, root, rng, new[t])
            trial = _fit(z, inverse, t, new[t])
            counts[0, 0] += 1
            if trial >= fit[t] or rng.random() < np.exp(trial - fit[t]):
                fit[t] = trial
                for i in range(d):
                    now[t, i] = new[t, i]
                counts[0, 1] += 1
        if s >= keep[0] and (s - keep[0] + 1) % keep[1] == 0:
            place = (s - keep[0]) // keep[1]
            for t in range(n):
                for i in range(d):
                    kept[i, t * count + place] = now[t, i]
    return counts


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
