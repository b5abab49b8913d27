"""What a frame makes of the hypotheses of Bernoulli targets: their weights, for any model (`filters.pmb` has the equations).

Targets are slices of the hypotheses: those of target t are first[t] … first[t + 1] − 1, their weights sum to one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.marginals import beliefs

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
B1 = NDArray[np.bool_]

# Targets of which nobody ever believed more are forgotten when they are given up.
BELIEVED = 0.05
# What a target that cannot be missed is missed with: impossible, but comparable.
NEVER = 1e-15


class Pruning(NamedTuple):
    """Least probability that a target is there; least share of its hypotheses, how many of them at most."""

    least: float
    share: float
    most: float


class Survivors(NamedTuple):
    """Targets and hypotheses after a measurement, in arrays that may be longer.

    ``targets``, ``hypotheses``: how many there are, T' and K. ``target`` (T',) which each was, ``exist`` (T',), ``first``
    (T' + 1,). Of the hypotheses (K,): ``source`` the one before, ``which`` the measurement, −1: missed; ``weight``. ``own``
    (N,) the probability that a measurement is no earlier target's, ``told`` (P,) that of each pair.
    """

    targets: int
    hypotheses: int
    target: I8
    exist: F8
    first: I8
    source: I8
    which: I8
    weight: F8
    own: F8
    told: F8


class Odds(NamedTuple):
    """Of ``edges`` pairs (E,) of targets and measurements, those of hypotheses joined, ``target``, ``column`` and ``odds``.

    ``edge`` (P,) that of each pair of a hypothesis, ``gain`` (P,) its part of the odds; ``kept`` (T,) probability of who was
    missed that he is there.
    """

    kept: F8
    gain: F8
    edge: I8
    target: I8
    column: I8
    odds: F8
    edges: int


@njit(**INNER)
def _odds(exist: F8, first: I8, weight: F8, seen: F8, point: I8, which: I8, density: F8, pairs: int, alone: F8) -> Odds:
    """How much more likely each target's detection by each measurement is than that it was missed."""
    kept, gain, odds, edge = np.empty(exist.size), np.empty(pairs), np.zeros(pairs), np.empty(pairs, np.int64)
    target, column, place = np.empty(pairs, np.int64), np.empty(pairs, np.int64), np.empty(alone.size, np.int64)
    for j in range(place.size):
        place[j] = -1
    # A literal zero is a type of its own.
    count, q = 0 * pairs, 0 * pairs
    for t in range(exist.size):
        detected, begun = 0.0, count
        for c in range(first[t], first[t + 1]):
            detected += weight[c] * seen[c]
        missed = max(1.0 - exist[t] * detected, NEVER)
        kept[t] = min(max(exist[t] * (1.0 - detected), 0.0) / missed, 1.0)
        while q < pairs and point[q] < first[t + 1]:
            c, j = point[q], which[q]
            if place[j] < begun:
                place[j], target[count], column[count] = count, t, j
                count += 1
            edge[q] = place[j]
            gain[q] = exist[t] * weight[c] * seen[c] * density[q] / (missed * alone[j])
            odds[edge[q]] += gain[q]
            q += 1
    return Odds(kept, gain, edge, target, column, odds, count)


@njit(**INNER)
def survivors(
    exist: F8, first: I8, weight: F8, seen: F8, point: I8, which: I8, density: F8, pairs: int, alone: F8, limits: Pruning
) -> Survivors:
    """As `weighed`, of the first ``pairs`` rows of ``point``, ``which`` and ``density``."""
    before = _odds(exist, first, weight, seen, point, which, density, pairs, alone)
    belief, nothing, own = beliefs(before.odds, before.target, before.column, before.edges, exist.size, alone.size)
    room, most, told = weight.size + pairs, int(limits.most), np.empty(pairs)
    out_target, out_exist = np.empty(exist.size, np.int64), np.empty(exist.size)
    out_first = np.empty(exist.size + 1, np.int64)
    source, taken, heavy = np.empty(room, np.int64), np.empty(room, np.int64), np.empty(room)
    option, value = np.empty(room, np.int64), np.empty(room)
    out_first[0] = 0
    used, k, q = 0 * pairs, 0 * pairs, 0 * pairs
    for t in range(exist.size):
        unseen, alive = 0.0, nothing[t] * before.kept[t]
        there, options = alive, 0 * pairs
        while q < pairs and point[q] < first[t + 1]:
            e = before.edge[q]
            told[q] = belief[e] * before.gain[q] / before.odds[e] if before.odds[e] > 0.0 else 0.0
            option[options], value[options] = q, told[q]
            there += told[q]
            options, q = options + 1, q + 1
        for c in range(first[t], first[t + 1]):
            unseen += weight[c] * (1.0 - seen[c])
        for c in range(first[t], first[t + 1]):
            share = weight[c] * (1.0 - seen[c]) / unseen if unseen > 0.0 else 0.0
            option[options], value[options] = -1 - c, alive * share
            options += 1
        # Who has become more probable may be at the beginning, however rare births are beside false alarms.
        if there < limits.least and not there > exist[t]:
            continue
        # The heaviest in turn: there are few.
        total, begin = 0.0, k
        while k - begin < most:
            best = 0 * pairs
            for o in range(1, options):
                if value[o] > value[best]:
                    best = o
            if not value[best] > 0.0 or value[best] < limits.share * there:
                break
            heavy[k], total = value[best], total + value[best]
            if option[best] < 0:
                source[k], taken[k] = -1 - option[best], -1
            else:
                source[k], taken[k] = point[option[best]], which[option[best]]
            value[best] = -1.0
            k += 1
        if k == begin:
            continue
        for i in range(begin, k):
            heavy[i] /= total
        out_target[used], out_exist[used] = t, min(there, 1.0)
        used += 1
        out_first[used] = k
    return Survivors(used, k, out_target, out_exist, out_first, source, taken, heavy, own, told)


@njit(**ENTRY)
def weighed(
    exist: F8, first: I8, weight: F8, seen: F8, point: I8, which: I8, density: F8, alone: F8, least: float, share: float,
    most: int,
) -> tuple[I8, F8, I8, I8, I8, F8, F8, F8]:  # fmt: skip
    """Update the probabilities of targets and hypotheses, and drop the least of both [W15].

    Parameters
    ----------
    exist : (T,) r.      first : (T + 1,).      weight, seen : (C,) of hypotheses; probability to be detected.
    point, which, density : (P,) hypothesis, measurement and q(z) of each pair; hypotheses do not fall.
    alone : (N,) κ + γ̂, above 0.
    least, share, most : as in `Pruning`.

    Returns
    -------
    The arrays of `Survivors`.
    """
    s = survivors(exist, first, weight, seen, point, which, density, len(point), alone, Pruning(least, share, float(most)))
    t, k = s.targets, s.hypotheses
    return s.target[:t], s.exist[:t], s.first[: t + 1], s.source[:k], s.which[:k], s.weight[:k], s.own, s.told


@njit(**INNER)
def alike(rows: F8, dim: int, static: B1, i: int, k: int, limit: float) -> bool:
    """Whether k says what i says: of one kind, and all in all within √limit deviations of i."""
    if static[i] != static[k]:
        return False
    distance2 = 0.0
    for r in range(dim):
        step = rows[i, r] - rows[k, r]
        distance2 += step * step / max(rows[i, dim + r], 1e-12)
    return distance2 < limit


@njit(**INNER)
def merged(first: I8, weight: F8, rows: F8, dim: int, static: B1, limit: float) -> tuple[I8, I8, F8]:
    """As `united`, of the first hypotheses; the rows may be longer. All weights are returned, by hypothesis before."""
    kept, heavier = np.empty(weight.size, np.int64), weight.copy()
    begin = np.empty(first.size, np.int64)
    begin[0] = 0
    k = 0 * first.size
    for t in range(first.size - 1):
        begun = k
        for c in range(first[t], first[t + 1]):
            i = begun
            while i < k and not alike(rows, dim, static, kept[i], c, limit):
                i += 1
            if i < k:
                heavier[kept[i]] += weight[c]
            else:
                kept[k] = c
                k += 1
        begin[t + 1] = k
    return begin, kept[:k].copy(), heavier


@njit(**ENTRY)
def united(first: I8, weight: F8, rows: F8, static: B1, limit: float) -> tuple[I8, I8, F8]:
    """Hypotheses of one target that say the same become one, the heavier, with the weight of both.

    ``first`` (T + 1,); of hypotheses (C,), heaviest first within a target: ``weight``, ``rows`` (C, 2d) of means and
    variances, ``static``. Returns ``first``, which are kept, and their weights. See `alike` for what is the same.
    """
    begin, kept, heavier = merged(first, weight, rows, rows.shape[1] // 2, static, limit)
    return begin, kept, heavier[kept]


@njit(**INNER)
def best_of(exist: F8, first: I8, weight: F8, static: B1) -> tuple[I8, F8]:
    """As `foremost`."""
    best, presence = np.empty(exist.size, np.int64), np.empty(exist.size)
    for t in range(exist.size):
        total, best[t] = 0.0, -1
        for c in range(first[t], first[t + 1]):
            if not static[c]:
                total += weight[c]
                if best[t] < 0 or weight[c] > weight[best[t]]:
                    best[t] = c
        presence[t] = exist[t] * total
    return best, presence


@njit(**ENTRY)
def foremost(exist: F8, first: I8, weight: F8, static: B1) -> tuple[I8, F8]:
    """Of each target the heaviest hypothesis that is not static, −1: none, and the probability of all of those (T,)."""
    out: tuple[I8, F8] = best_of(exist, first, weight, static)
    return out
