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
    """Targets and hypotheses after a measurement.

    ``target`` (T',) which each was, ``exist`` (T',), ``first`` (T' + 1,). Of the hypotheses (K,): ``source`` the one before,
    ``which`` the measurement, −1: missed; ``weight``. ``own`` (N,) the probability that a measurement is no earlier
    target's, ``told`` (P,) that of each pair.
    """

    target: I8
    exist: F8
    first: I8
    source: I8
    which: I8
    weight: F8
    own: F8
    told: F8


@njit(**INNER)
def _edges(first: I8, point: I8, which: I8, gain: F8, pairs: int, n: int) -> tuple[I8, I8, I8, F8, int]:
    """Pairs of hypotheses joined to pairs of targets: of each pair its edge, of each edge target, measurement, Σ gain."""
    edge, target, column, total = (
        np.empty(pairs, np.int64), np.empty(pairs, np.int64), np.empty(pairs, np.int64), np.empty(pairs)
    )  # fmt: skip
    place = np.empty(n, np.int64)
    for j in range(n):
        place[j] = -1
    count, q = 0 * pairs, 0 * pairs
    for t in range(first.size - 1):
        begun = count
        while q < pairs and point[q] < first[t + 1]:
            j = which[q]
            if place[j] < begun:
                place[j], target[count], column[count], total[count] = count, t, j, 0.0
                count += 1
            edge[q] = place[j]
            total[place[j]] += gain[q]
            q += 1
    return edge, target, column, total, count


@njit(**INNER)
def survivors(
    exist: F8, first: I8, weight: F8, seen: F8, point: I8, which: I8, density: F8, pairs: int, alone: F8, limits: Pruning
) -> Survivors:
    """As `weighed`, of the first ``pairs`` rows of ``point``, ``which`` and ``density``."""
    targets, count, n = exist.size, weight.size, alone.size
    missed, kept, gain, told = np.empty(targets), np.empty(targets), np.empty(pairs), np.empty(pairs)
    for t in range(targets):
        detected = 0.0
        for c in range(first[t], first[t + 1]):
            detected += weight[c] * seen[c]
        missed[t] = max(1.0 - exist[t] * detected, NEVER)
        kept[t] = min(max(exist[t] * (1.0 - detected), 0.0) / missed[t], 1.0)
    t = 0 * pairs
    for q in range(pairs):
        while point[q] >= first[t + 1]:
            t += 1
        gain[q] = exist[t] * weight[point[q]] * seen[point[q]] * density[q] / (missed[t] * alone[which[q]])
    edge, target, column, odds, edges = _edges(first, point, which, gain, pairs, n)
    belief, nothing, own = beliefs(odds, target, column, edges, targets, n)
    for q in range(pairs):
        told[q] = belief[edge[q]] * gain[q] / odds[edge[q]] if odds[edge[q]] > 0.0 else 0.0
    room, most = count + pairs, int(limits.most)
    out_target, out_exist, out_first = np.empty(targets, np.int64), np.empty(targets), np.empty(targets + 1, np.int64)
    source, taken, heavy = np.empty(room, np.int64), np.empty(room, np.int64), np.empty(room)
    option, value = np.empty(room, np.int64), np.empty(room)
    out_first[0] = 0
    used, k, q = 0 * pairs, 0 * pairs, 0 * pairs
    for t in range(targets):
        there, options = nothing[t] * kept[t], 0 * pairs
        while q < pairs and point[q] < first[t + 1]:
            option[options], value[options] = q, told[q]
            there += told[q]
            options, q = options + 1, q + 1
        unseen = 0.0
        for c in range(first[t], first[t + 1]):
            unseen += weight[c] * (1.0 - seen[c])
        for c in range(first[t], first[t + 1]):
            share = weight[c] * (1.0 - seen[c]) / unseen if unseen > 0.0 else 0.0
            option[options], value[options] = -1 - c, nothing[t] * kept[t] * share
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
    return Survivors(
        out_target[:used], out_exist[:used], out_first[: used + 1], source[:k], taken[:k], heavy[:k], own, told
    )  # fmt: skip


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
    The fields of `Survivors`.
    """
    s = survivors(exist, first, weight, seen, point, which, density, len(point), alone, Pruning(least, share, float(most)))
    return s.target, s.exist, s.first, s.source, s.which, s.weight, s.own, s.told


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
    """As `united`; the rows may be longer."""
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
    out = np.empty(k)
    for i in range(k):
        out[i] = heavier[kept[i]]
    return begin, kept[:k].copy(), out


@njit(**ENTRY)
def united(first: I8, weight: F8, rows: F8, static: B1, limit: float) -> tuple[I8, I8, F8]:
    """Hypotheses of one target that say the same become one, the heavier, with the weight of both.

    ``first`` (T + 1,); of hypotheses (C,), heaviest first within a target: ``weight``, ``rows`` (C, 2d) of means and
    variances, ``static``. Returns ``first``, which are kept, and their weights. See `alike` for what is the same.
    """
    out: tuple[I8, I8, F8] = merged(first, weight, rows, rows.shape[1] // 2, static, limit)
    return out


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
