"""The chain of the MCMC filter: Metropolis–Hastings over the existence of targets and their
measurements [K05].

See `filters.mcmc`. The potential that keeps two targets apart is exp(−strength · overlap), where
the overlap is the intersection over union of their boxes.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from phdtrack.kernels import F8, I8
from phdtrack.kernels.box import overlap_of
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.grid import make_grid, overlapping
from phdtrack.kernels.particle_models import BLOCK, distance, prepare, seen


class Chain(NamedTuple):
    """Settings of a chain.

    ``burn``: sweeps before the first that is kept; then one of every ``thin`` is kept, until there
    are ``samples``. ``share`` of steps that move two candidates; ``strength`` of the interaction,
    0: none.
    """

    burn: int
    thin: int
    samples: int
    share: float
    strength: float


class Options(NamedTuple):
    """The options of C candidates, and the states (entries) of each option.

    Candidate c's options are ``first``[c] … first[c + 1] − 1; the first of them is that the target
    does not exist. ``measurement``, ``total`` (O,): measurement of each option, −1 for none, and
    its weight; its entries are ``start``[o] … start[o + 1] − 1. ``running``, ``member`` (T,): sums
    of weights within each option, and the state of each entry. ``box`` (L, 4): left, top, right,
    bottom of each state. The candidates with a box that may overlap one of candidate c, ascending,
    are ``near``[near_start[c]] … near[``near_start``[c + 1] − 1]. Without interaction both are
    empty.
    """

    first: I8
    measurement: I8
    total: F8
    start: I8
    running: F8
    member: I8
    box: F8
    near: I8
    near_start: I8


class Sample(NamedTuple):
    """The chain's present sample: option and state (−1: none) of each candidate, and the candidate
    of each measurement.
    """

    option: I8
    state: I8
    owner: I8


@njit(**ENTRY)
def pair_likelihoods(x: F8, sensor: Any, table: Any, member: I8, which: I8) -> tuple[F8, F8]:
    """(P,) squared distances and g(z|x) of pairs of states, columns of ``x`` (d, L), and
    measurements of ``table``.
    """
    distance2 = np.empty(member.size)
    likelihood = np.empty(member.size)
    s = np.empty(16 * BLOCK)
    for p in range(member.size):
        for r in range(x.shape[0]):
            s[r * BLOCK] = x[r, member[p]]
        prepare(sensor, s, 0)
        distance2[p], factor = distance(sensor, seen(sensor, table, which[p]), s, 0)
        likelihood[p] = factor * np.exp(-0.5 * distance2[p])
    return distance2, likelihood


@njit(**ENTRY)
def make_options(candidate: I8, which: I8, member: I8, weight: F8, absent: F8, box: F8) -> Options:
    """The options of T entries, which ascend in their candidate and measurement.

    ``which`` (T,): the measurement, −1: none; ``member`` (T,): the state. ``absent`` (C,): weight
    of each candidate's not existing. ``box`` (L, 4): of the states.
    """
    count = absent.size
    entries = candidate.size
    first = np.empty(count + 1, np.int64)
    most = count + entries
    measurement = np.full(most, -1)
    total = np.zeros(most)
    start = np.empty(most + 1, np.int64)
    running = np.empty(entries)
    o = 0
    e = 0
    for c in range(count):
        first[c] = o
        total[o] = absent[c]
        start[o] = e
        o += 1
        while e < entries and candidate[e] == c:
            measurement[o] = which[e]
            start[o] = e
            while e < entries and candidate[e] == c and which[e] == measurement[o]:
                total[o] += weight[e]
                running[e] = total[o]
                e += 1
            o += 1
    first[count] = o
    start[o] = e
    near, near_start = _neighbours(candidate, member, box, count)
    return Options(
        first,
        measurement[:o].copy(),
        total[:o].copy(),
        start[: o + 1].copy(),
        running,
        member,
        box,
        near,
        near_start,
    )


@njit(**INNER)
def _neighbours(candidate: I8, member: I8, box: F8, count: int) -> tuple[I8, I8]:
    """The candidates near each of ``count``, as in `Options`: those whose states' boxes together
    overlap its own.
    """
    low = np.full((2, count), np.inf)
    high = np.full((2, count), -np.inf)
    start = np.zeros(count + 1, np.int64)
    near = np.empty(0, np.int64)
    neighbour = np.empty(count, np.int64)
    if len(box) == 0:
        return near, start
    for e in range(candidate.size):
        c = candidate[e]
        i = member[e]
        for a in range(2):
            low[a, c] = min(low[a, c], box[i, a])
            high[a, c] = max(high[a, c], box[i, a + 2])
    grid = make_grid(low, high, 0.0, 0.0)
    for c in range(count):
        some = overlapping(low[0, c], low[1, c], high[0, c], high[1, c], grid, neighbour)
        near = np.concatenate((near, np.sort(neighbour[:some])))
        start[c + 1] = near.size
    return near, start


@njit(**INNER)
def _free(j: int, a: int, b: int, owner: I8) -> bool:
    """True if measurement j (−1: none) has no owner except candidates a and b."""
    return j < 0 or owner[j] < 0 or owner[j] == a or owner[j] == b


@njit(**INNER)
def _weight(o: int, p: int, a: int, b: int, measurement: I8, total: F8, owner: I8) -> float:
    """Weight of option o for candidate a, and of option p for candidate b unless b < 0; 0 if they
    are not free.
    """
    if not _free(measurement[o], a, b, owner):
        return 0.0
    weight: float = total[o]
    if b >= 0:
        same = measurement[o] >= 0 and measurement[o] == measurement[p]
        if same or not _free(measurement[p], a, b, owner):
            return 0.0
        weight *= total[p]
    return weight


@njit(**INNER)
def _state(o: int, can: Options, rng: np.random.Generator) -> int:
    """A state of option ``o``, by weight."""
    running = can.running[can.start[o] : can.start[o + 1]]
    aim = rng.random() * running[-1]
    place = min(np.searchsorted(running, aim, side="right"), running.size - 1)
    out: int = can.member[can.start[o] + place]
    return out


@njit(**INNER)
def _choose(
    a: int, b: int, begin: int, can: Options, now: Sample, rng: np.random.Generator
) -> tuple[int, int]:
    """Free options of ``a`` from ``begin`` on and of ``b``, by weight; without ``b`` (−1) the
    second is of no meaning.
    """
    measurement = can.measurement
    total = can.total
    owner = now.owner
    end = can.first[a + 1]
    chosen = -1
    other = -1
    reached = 0.0
    low = 0
    high = 1
    if b >= 0:
        low = can.first[b]
        high = can.first[b + 1]
    for o in range(begin, end):
        for p in range(low, high):
            reached += _weight(o, p, a, b, measurement, total, owner)
    aim = rng.random() * reached
    for o in range(begin, end):
        for p in range(low, high):
            weight = _weight(o, p, a, b, measurement, total, owner)
            if weight > 0.0:
                chosen = o
                other = p
                aim -= weight
                if aim < 0.0:
                    return chosen, other
    return chosen, other


@njit(**INNER)
def _overlap(box: F8, i: int, k: int) -> float:
    """Overlap of states i and k (−1: none)."""
    if i < 0 or k < 0:
        return 0.0
    overlap: float = overlap_of(box, i, box, k)
    return overlap


@njit(**INNER)
def _crowd(a: int, b: int, i: int, k: int, can: Options, now: Sample) -> float:
    """Overlaps of ``a`` in state ``i`` and ``b`` in state ``k`` (−1: none) with all other targets
    and each other.
    """
    box = can.box
    near = can.near
    state = now.state
    total: float = _overlap(box, i, k)
    p = can.near_start[a]
    p_end = can.near_start[a + 1]
    q = 0 * a
    q_end = 0 * a
    if b >= 0:
        q = can.near_start[b]
        q_end = can.near_start[b + 1]
    while p < p_end or q < q_end:
        # The next candidate that is near one of the two.
        if q == q_end or (p < p_end and near[p] <= near[q]):
            c = near[p]
        else:
            c = near[q]
        other = c != a and c != b
        if p < p_end and near[p] == c:
            if other:
                total += _overlap(box, i, state[c])
            p += 1
        if q < q_end and near[q] == c:
            if other:
                total += _overlap(box, k, state[c])
            q += 1
    return total


@njit(**INNER)
def _assign(c: int, o: int, i: int, can: Options, now: Sample) -> None:
    """Give candidate ``c`` option ``o`` and state ``i``."""
    now.option[c] = o
    now.state[c] = i
    j = can.measurement[o]
    if j >= 0:
        now.owner[j] = c


@njit(**INNER)
def _redraw(
    a: int, b: int, can: Options, now: Sample, chain: Chain, rng: np.random.Generator
) -> None:
    """A step that moves candidate ``a``, or ``a`` and ``b`` at once (b < 0: ``a`` only), given all
    others.
    """
    o, p = _choose(a, b, can.first[a], can, now, rng)
    i = -1
    if o != can.first[a]:
        i = _state(o, can, rng)
    k = -1
    was = -1
    if b >= 0:
        if p != can.first[b]:
            k = _state(p, can, rng)
        was = now.state[b]
    elif i < 0 and now.state[a] < 0:
        return
    if chain.strength > 0.0:
        more = _crowd(a, b, i, k, can, now) - _crowd(a, b, now.state[a], was, can, now)
        # Hastings: accepted with probability exp(−strength · more).
        if more > 0.0 and rng.random() >= np.exp(-chain.strength * more):
            return
    for c in (a, b):
        if c >= 0 and can.measurement[now.option[c]] >= 0:
            now.owner[can.measurement[now.option[c]]] = -1
    _assign(a, o, i, can, now)
    if b >= 0:
        _assign(b, p, k, can, now)


@njit(**INNER)
def _chance(
    c: int, can: Options, now: Sample, chain: Chain, rng: np.random.Generator
) -> tuple[int, float]:
    """A target's state, drawn if it does not exist, and the probability that it exists, given that
    state and all others.
    """
    exists = 0.0
    absence = can.first[c]
    for o in range(absence + 1, can.first[c + 1]):
        exists += _weight(o, 0, c, -1, can.measurement, can.total, now.owner)
    if exists <= 0.0:
        return can.member[can.start[absence + 1]], 0.0
    i = now.state[c]
    if i < 0:
        o, _ = _choose(c, -1, absence + 1, can, now, rng)
        i = _state(o, can, rng)
    if chain.strength > 0.0:
        exists *= np.exp(-chain.strength * _crowd(c, -1, i, -1, can, now))
    return i, exists / (exists + can.total[absence])


@njit(**ENTRY)
def jump_chain(
    measurements: int, can: Options, pairs: I8, chain: Chain, rng: np.random.Generator
) -> tuple[I8, I8, F8]:
    """Samples of the options and states of all candidates.

    A step picks a candidate and draws one of its free options by weight, and of that a state; with
    probability ``chain.share`` it picks one of ``pairs`` and draws for both together. Without
    interaction that is a draw from the conditional law and always accepted; with it, the
    probability is min(1, ψ of the new state / ψ of the old one). A sweep has as many steps as there
    are candidates.

    ``pairs`` (K, 2) compete for one of so many ``measurements``. Returns (C, N) each candidate's
    options and states in each kept sample, a drawn state if it does not exist there, and the
    probability (C, N) that it exists, given that state and all others in the sample.
    """
    many = can.first.size - 1
    kept = chain.samples
    now = Sample(can.first[:-1].copy(), np.full(many, -1), np.full(measurements, -1))
    options = np.empty((many, kept), np.int64)
    states = np.empty((many, kept), np.int64)
    chance = np.empty((many, kept))
    for sweep in range(chain.burn + chain.thin * kept):
        for _ in range(many):
            if pairs.shape[0] > 0 and rng.random() < chain.share:
                k = int(rng.random() * pairs.shape[0])
                _redraw(pairs[k, 0], pairs[k, 1], can, now, chain, rng)
            else:
                _redraw(int(rng.random() * many), -1, can, now, chain, rng)
        if sweep >= chain.burn and (sweep - chain.burn + 1) % chain.thin == 0:
            n = (sweep - chain.burn) // chain.thin
            for c in range(many):
                options[c, n] = now.option[c]
                states[c, n], chance[c, n] = _chance(c, can, now, chain, rng)
    return options, states, chance
