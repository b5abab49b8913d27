"""The chains of the MCMC filter: Metropolis–Hastings over the joint state of all targets [K05, D14 Alg. 1].

`given_chain` serves where it is known which target gave which measurement; `jump_chain` samples which targets are there and
which measurement each gave as well. See `filters.mcmc`. The pairwise potential that keeps targets apart is
ψ(x, y) = exp(−strength · penalty(x, y)): the penalty is the overlap of boxes (intersection over union), or exp(−|x − y|²/2)
of positions in units of its range.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.particle_models import BLOCK, distance, move, normals, prepare, seen

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
# Rows of the counts: what a step proposed.
REDRAW, ANCESTOR = range(2)
ADD, DELETE, LEAVE, COME_BACK, UPDATE, REASSIGN, EXCHANGE = range(7)


class Chain(NamedTuple):
    """How a chain runs.

    ``burn`` steps before the first that is kept, one of every ``thin``, until ``samples`` are kept; ``share`` of steps that
    move several targets (exchanges, other ancestors); ``strength`` of the interaction, of ``boxes`` or of positions; of
    given associations whether all targets of a sample have a ``joint`` ancestor, and whether acceptance is ``greedy`` [D14
    Alg. 1].
    """

    burn: int
    thin: int
    samples: int
    share: float
    strength: float
    boxes: bool
    joint: bool
    greedy: bool


class Ancestors(NamedTuple):
    """What targets come from.

    ``origin`` (d, n·M): the M states of each of n targets in the frame before, those of a target beside each other.
    ``running``, ``log`` (k, M): the laws by which ancestors are proposed, for all targets together (k = 1) or for each (k =
    n): sums of their probabilities, and their logarithms. ``size`` (2, n): of each target's box, or the range of the
    interaction.
    """

    origin: F8
    running: F8
    log: F8


@njit(**INNER)
def _draw(
    motion: Any,
    sensor: Any,
    table: Any,
    ancestors: Ancestors,
    t: int,
    r: int,
    scratch: F8,
    rng: np.random.Generator,
    out: F8,
) -> float:
    """log g of measurement t and a draw of f(·|x) of state r of target t, which is written to ``out`` (d,)."""
    origin = ancestors.origin
    column, d = t * (origin.shape[1] // table.shape[1]) + r, out.size
    for a in range(d):
        scratch[a * BLOCK] = origin[a, column]
    for k in range(normals(motion)):
        scratch[(8 + k) * BLOCK] = rng.standard_normal()
    move(motion, scratch, 0)
    for a in range(d):
        out[a] = scratch[a * BLOCK]
    prepare(sensor, scratch, 0)
    d2, factor = distance(sensor, seen(sensor, table, t), scratch, 0)
    return math.log(float(factor)) - 0.5 * float(d2)


@njit(**INNER)
def _ancestor(ancestors: Ancestors, law: int, rng: np.random.Generator) -> int:
    """A draw of an ancestor by its law."""
    running = ancestors.running[law]
    return int(np.searchsorted(running, rng.random() * running[-1], side="right"))


@njit(**ENTRY)
def given_chain(
    motion: Any, sensor: Any, table: Any, ancestors: Ancestors, chain: Chain, rng: np.random.Generator, kept: F8
) -> I8:
    """Samples of targets whose measurements are known, from the samples of the frame before [D14 Alg. 1].

    Parameters
    ----------
    motion, sensor : records of `kernels.particle_models`.
    table : (k, n) measurement of each target, as the sensor has it.
    ancestors : what targets come from.
    chain : how it runs.
    kept : (d, n·N) is filled with the kept samples.

    Returns
    -------
    (2, 2) proposed and accepted, of redraws of one target (first row) and of changes of the common ancestor.
    """
    n, scratch, counts = table.shape[1], np.empty(16 * BLOCK), np.zeros((2, 2), np.int64)
    # In row 0 the present sample, in row 1 the proposal.
    x = np.empty((2, n, kept.shape[0]))
    fit, ancestor = np.zeros((2, n)), np.zeros((2, n), np.int64)
    for step in range(-1, chain.burn + chain.thin * chain.samples):
        # The chain starts at a proposal for all.
        everything = step < 0 or (chain.joint and rng.random() < chain.share)
        first = 0 if everything else int(rng.random() * n)
        last, gain = n if everything else first + 1, 0.0
        common = _ancestor(ancestors, 0, rng) if chain.joint and everything else ancestor[0, first]
        for t in range(first, last):
            ancestor[1, t] = common if chain.joint else _ancestor(ancestors, t, rng)
            fit[1, t] = _draw(motion, sensor, table, ancestors, t, ancestor[1, t], scratch, rng, x[1, t])
            # Alg. 1's weight is the likelihood: where a ratio takes its place, a common factor does not cancel.
            fit[1, t] -= 0.0 if chain.joint or chain.greedy else ancestors.log[t, ancestor[1, t]]
            gain += fit[1, t] - fit[0, t]
        accepted, kind = step < 0, ANCESTOR if everything else REDRAW
        if not accepted:
            if everything:
                gain -= ancestors.log[0, common] - ancestors.log[0, ancestor[0, 0]]
            accepted = gain >= (0.0 if chain.greedy else math.log(1.0 - rng.random()))
            counts[kind, 0] += 1
            counts[kind, 1] += accepted
        for t in range(first, last):
            # D14's Alg. 1 takes the ratio for the weight of a state that stays.
            fit[0, t] = fit[1, t] if accepted else gain if chain.greedy else fit[0, t]
            ancestor[0, t] = ancestor[1, t] if accepted else ancestor[0, t]
            for a in range(kept.shape[0]):
                x[0, t, a] = x[1, t, a] if accepted else x[0, t, a]
        if step >= chain.burn and (step - chain.burn + 1) % chain.thin == 0:
            for t in range(n):
                for a in range(kept.shape[0]):
                    kept[a, t * chain.samples + (step - chain.burn) // chain.thin] = x[0, t, a]
    return counts


class Options(NamedTuple):
    """What C candidates may be, see `option_tables`, and where.

    ``member`` (T,) is the state of each entry, ``place`` (L, 4) where states are: corners of boxes, or positions in units
    of the interaction's range.
    """

    first: I8
    seen_by: I8
    total: F8
    start: I8
    running: F8
    member: I8
    place: F8


class Sample(NamedTuple):
    """The chain's present sample: option and state (−1: not there) of each candidate, and who holds each measurement."""

    option: I8
    state: I8
    taken: I8


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
    seen_by, total : (O,) measurement of each option, −1 for none, and its weight.
    start : (O + 1,) its entries are start[o] … start[o + 1] − 1.
    running : (T,) sums of weights within each option.
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
            while e < entries and candidate[e] == c and which[e] == seen_by[o]:
                total[o] += weight[e]
                running[e] = total[o]
                e += 1
            o += 1
    first[count], start[o] = o, e
    return first, seen_by[:o].copy(), total[:o].copy(), start[: o + 1].copy(), running


@njit(**INNER)
def _penalty(place: F8, a: int, b: int, boxes: bool) -> float:
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
def _free(o: int, a: int, b: int, can: Options, now: Sample) -> float:
    """Weight of an option for candidates a or b; 0 where its measurement belongs to another target."""
    j = can.seen_by[o]
    if j < 0 or now.taken[j] < 0 or now.taken[j] == a or now.taken[j] == b:
        weight: float = can.total[o]
        return weight
    return 0.0


@njit(**INNER)
def _state(o: int, can: Options, rng: np.random.Generator) -> int:
    """A state of option ``o``, by weight."""
    low, high = can.start[o], can.start[o + 1] - 1
    aim = rng.random() * can.running[high]
    while low < high:
        middle = (low + high) // 2
        if can.running[middle] > aim:
            high = middle
        else:
            low = middle + 1
    out: int = can.member[low]
    return out


@njit(**INNER)
def _choose(a: int, b: int, begin: int, can: Options, now: Sample, rng: np.random.Generator) -> tuple[int, int]:
    """Free options of ``a`` from ``begin`` on and of ``b``, by weight; without ``b`` (−1) the second is −1."""
    end, chosen, other, reached = can.first[a + 1], -1, -1, 0.0
    low, high = (can.first[b], can.first[b + 1]) if b >= 0 else (0, 1)
    for again in range(2):
        aim = rng.random() * reached if again else np.inf
        for o in range(begin, end):
            for p in range(low, high):
                weight = _free(o, a, b if b >= 0 else a, can, now)
                if b >= 0:
                    same = can.seen_by[o] >= 0 and can.seen_by[o] == can.seen_by[p]
                    weight *= 0.0 if same else _free(p, a, b, can, now)
                if not again:
                    reached += weight
                elif weight > 0.0:
                    chosen, other = o, p if b >= 0 else -1
                    aim -= weight
                    if aim < 0.0:
                        return chosen, other
    return chosen, other


@njit(**INNER)
def _kind(was: int, becomes: int, absence: int, newborn: bool, can: Options) -> int:
    """Which row of the counts a change of option belongs to; −1 where a target stays absent."""
    if was == absence:
        if becomes == absence:
            return -1
        return ADD if newborn else COME_BACK
    if becomes == absence:
        return DELETE if newborn else LEAVE
    return UPDATE if can.seen_by[was] == can.seen_by[becomes] else REASSIGN


@njit(**INNER)
def _crowd(a: int, b: int, i: int, k: int, can: Options, now: Sample, boxes: bool) -> float:
    """Penalties of ``a`` in state ``i`` and ``b`` in state ``k`` (−1: not there) with all other targets and each other."""
    total = _penalty(can.place, i, k, boxes) if i >= 0 and k >= 0 else 0.0
    for c in range(now.state.size):
        if now.state[c] >= 0 and c != a and c != b:
            total += _penalty(can.place, i, now.state[c], boxes) if i >= 0 else 0.0
            total += _penalty(can.place, k, now.state[c], boxes) if k >= 0 else 0.0
    return total


@njit(**INNER)
def _take(c: int, o: int, i: int, can: Options, now: Sample) -> None:
    """Candidate ``c`` has option ``o`` and state ``i`` from now on."""
    now.option[c], now.state[c] = o, i
    j = can.seen_by[o]
    if j >= 0:
        now.taken[j] = c


@njit(**INNER)
def _redraw(a: int, b: int, old: int, can: Options, now: Sample, chain: Chain, rng: np.random.Generator, counts: I8) -> None:
    """A step that moves candidate ``a``, or ``a`` and ``b`` at once (b < 0: ``a`` only), given all others."""
    o, p = _choose(a, b, can.first[a], can, now, rng)
    i = -1 if o == can.first[a] else _state(o, can, rng)
    k, kind, was = -1, EXCHANGE, -1
    if b >= 0:
        k, was = -1 if p == can.first[b] else _state(p, can, rng), now.state[b]
    else:
        kind = _kind(now.option[a], o, can.first[a], a >= old, can)
        if kind < 0:
            return
    counts[kind, 0] += 1
    if chain.strength > 0.0:
        more = _crowd(a, b, i, k, can, now, chain.boxes) - _crowd(a, b, now.state[a], was, can, now, chain.boxes)
        # Hastings: accepted with probability exp(−strength · more).
        if more > 0.0 and rng.random() >= np.exp(-chain.strength * more):
            return
    counts[kind, 1] += 1
    for c in (a, b):
        if c >= 0 and can.seen_by[now.option[c]] >= 0:
            now.taken[can.seen_by[now.option[c]]] = -1
    _take(a, o, i, can, now)
    if b >= 0:
        _take(b, p, k, can, now)


@njit(**INNER)
def _chance(c: int, can: Options, now: Sample, chain: Chain, rng: np.random.Generator) -> tuple[int, float]:
    """The state of one who is there, or would be, and the probability that he is, given it and all others."""
    there, absence = 0.0, can.first[c]
    for o in range(absence + 1, can.first[c + 1]):
        there += _free(o, c, c, can, now)
    if there <= 0.0:
        return can.member[can.start[absence + 1]], 0.0
    i = now.state[c]
    if i < 0:
        o, _ = _choose(c, -1, absence + 1, can, now, rng)
        i = _state(o, can, rng)
    if chain.strength > 0.0:
        there *= np.exp(-chain.strength * _crowd(c, -1, i, -1, can, now, chain.boxes))
    return i, there / (there + can.total[absence])


@njit(**ENTRY)
def jump_chain(
    old: int, measurements: int, can: Options, pairs: I8, chain: Chain, rng: np.random.Generator
) -> tuple[I8, I8, F8, I8]:
    """Samples of the options and states of all candidates.

    A step picks a candidate and draws one of his free options by weight, and of it a state; with probability
    ``chain.share`` it picks one of ``pairs`` and draws for both together. Without interaction that is a draw from the
    conditional law and always accepted; with it, it is accepted with probability min(1, ψ of the new state / ψ of the old
    one).

    Parameters
    ----------
    old : candidates before this one were there in the frame before; the others are newborn.
    measurements : how many there are.
    can : what candidates may be.
    pairs : (K, 2) candidates that compete for a measurement.
    chain : how it runs, in sweeps of as many steps as there are candidates.

    Returns
    -------
    options, states : (C, N) each candidate's in each kept sample. Of one who is not there, the state is a draw from where
        he would be.
    chance : (C, N) the probability that he is there, given that state and all the others in the sample.
    counts : (7, 2) proposed and accepted, by kind.
    """
    many, kept = can.first.size - 1, chain.samples
    now = Sample(can.first[:-1].copy(), np.full(many, -1), np.full(measurements, -1))
    options, states = np.empty((many, kept), np.int64), np.empty((many, kept), np.int64)
    chance, counts = np.empty((many, kept)), np.zeros((7, 2), np.int64)
    for sweep in range(chain.burn + chain.thin * kept):
        for _ in range(many):
            if pairs.shape[0] > 0 and rng.random() < chain.share:
                k = int(rng.random() * pairs.shape[0])
                _redraw(pairs[k, 0], pairs[k, 1], old, can, now, chain, rng, counts)
            else:
                _redraw(int(rng.random() * many), -1, old, can, now, chain, rng, counts)
        if sweep >= chain.burn and (sweep - chain.burn + 1) % chain.thin == 0:
            n = (sweep - chain.burn) // chain.thin
            for c in range(many):
                options[c, n] = now.option[c]
                states[c, n], chance[c, n] = _chance(c, can, now, chain, rng)
    return options, states, chance, counts
