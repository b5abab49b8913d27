"""One frame of the GM-PHD filter for the box model in one call: predict, births, update, prune, merge, cap.

It computes what predict, update and reduce of `filters.gm_phd` compute, to rounding, and a test holds it to that. It is
faster because nothing that the pruning would drop is ever made, because a Gaussian that meets several measurements is
factored once and one that meets none not at all, and because there is no Python between the steps.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.gm_model import (
    DETECTION,
    ENTRIES,
    GIVEN,
    LOCAL,
    NOWHERE,
    PLACES,
    ROWS,
    BoxNumbers,
    D,
    M,
    Scene,
    around_each,
    box_numbers,
    cells,
    crowding,
    entry,
    newborn,
    noise,
    possible,
    predicted,
    sorted_boxes,
    widest,
)
from phdtrack.kernels.gm_reduce import reduced

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

AXES = (0, 1, 2, 3, 4, 5)
NORM = 1.0 / (2.0 * math.pi) ** 2
# The reciprocal of anything smaller may overflow.
SMALLEST = float(np.finfo(np.float64).tiny)
# Columns of a table of pairs: d², density N(z; Hm, S), y = L⁻¹(z − Hm) (M); then S = L D Lᵀ, L below its diagonal and 1/D
# in it, as a lower triangle.
DISTANCE2, DENSITY, Y, FACTOR = 0, 1, 2, 2 + M
PAIR = FACTOR + M * (M + 1) // 2


class Limits(NamedTuple):
    """Settings of the filter, see `filters.gm_phd.GMPHD`; yes is 1, no 0."""

    gate: float
    region: float
    prune: float
    merge: float
    most: float
    redistribute: float
    split: float
    skip_empty: float


@njit(**INNER)
def _limits(t: F8) -> Limits:
    """The settings from an array, which costs less to hand over than a tuple."""
    return Limits(t[0], t[1], t[2], t[3], t[4], t[5], t[6], t[7])


@njit(**INNER)
def _factor(p: F8, i: int, variance: tuple[float, float, float, float], u: F8, root: F8) -> float:
    """H P Hᵀ + R = L D Lᵀ of a Gaussian in ``root`` (PAIR,), L D in ``u`` (M, M); 1/√det, NaN if not positive definite."""
    scale = 1.0
    for a in range(M):
        pivot = p[i, entry(ROWS[a], ROWS[a])] + variance[a]
        for c in range(a):
            value = p[i, entry(ROWS[a], ROWS[c])]
            for t in range(c):
                value -= u[a, t] * root[FACTOR + entry(c, t)]
            u[a, c] = value
            root[FACTOR + entry(a, c)] = value * root[FACTOR + entry(c, c)]
            pivot -= value * root[FACTOR + entry(a, c)]
        root[FACTOR + entry(a, a)] = 1.0 / pivot if pivot > 0.0 else np.nan
        scale *= root[FACTOR + entry(a, a)]
    root_of_inverse: float = np.sqrt(scale)
    return root_of_inverse


@njit(**INNER)
def _longer(index: I8, value: F8, used: int, more: int) -> tuple[I8, F8]:
    """The tables, of which so many rows are used, copied into ones that have room for ``more`` and for as many again."""
    longer, wider = np.empty((2 * used + more, 2), np.int64), np.empty((2 * used + more, PAIR))
    for q in range(used):
        longer[q, 0], longer[q, 1] = index[q, 0], index[q, 1]
        for e in range(PAIR):
            wider[q, e] = value[q, e]
    return longer, wider


@njit(**INNER)
def paired(
    x: F8, p: F8, first: int, last: int, scene: Scene, b: BoxNumbers, gate: float, index: I8, value: F8, found: int
) -> tuple[I8, F8, int]:
    """The pairs (Gaussian, measurement) within the gate, d² ≤ gate², of the Gaussians ``first`` to ``last``.

    They go behind the first ``found`` of ``index`` (P, 2) Gaussian, measurement, and ``value`` (P, PAIR). Returns the
    tables, or longer ones, and how many pairs there are then.
    """
    boxes, start, nx = scene.boxes, scene.start, scene.nx
    widest_x, widest_y = widest(boxes, b)
    own = not (b.scaling == DETECTION or b.scaling == GIVEN)
    u, root, scale = np.empty((M, M)), np.empty(PAIR), 0.0
    limit = gate * gate
    for i in range(first, last):
        here = noise(b, x[i, 4], x[i, 5], boxes, 0)
        vx, vy = (here[0], here[1]) if own else (widest_x, widest_y)
        half_x, half_y = gate * np.sqrt(p[i, entry(0, 0)] + vx), gate * np.sqrt(p[i, entry(1, 1)] + vy)
        left, right, top, bottom = cells(x[i, 0], x[i, 1], half_x, half_y, scene)
        made, most = False, 0
        for line in range(top, bottom + 1):
            most += start[line * nx + right + 1] - start[line * nx + left]
        # A call for every Gaussian would be a tenth of all.
        if found + most > len(index):
            index, value = _longer(index, value, found, most)
        for line in range(top, bottom + 1):
            for j in range(start[line * nx + left], start[line * nx + right + 1]):
                if not own:
                    here = noise(b, 0.0, 0.0, boxes, j)
                # One component alone is never further than all: most that are not met end here.
                far = False
                for a in range(M):
                    y = boxes[j, a] - x[i, ROWS[a]]
                    far |= y * y > limit * (p[i, entry(ROWS[a], ROWS[a])] + here[a])
                if far:
                    continue
                if not (made and own):
                    scale = _factor(p, i, here, u, root)
                    made = True
                distance2 = 0.0
                for a in range(M):
                    y = boxes[j, a] - x[i, ROWS[a]]
                    for t in range(a):
                        y -= root[FACTOR + entry(a, t)] * root[Y + t]
                    root[Y + a] = y
                    distance2 += y * y * root[FACTOR + entry(a, a)]
                if distance2 <= limit:
                    index[found, 0], index[found, 1] = i, j
                    for e in range(Y, PAIR):
                        value[found, e] = root[e]
                    value[found, DISTANCE2], value[found, DENSITY] = distance2, NORM * scale * np.exp(-0.5 * distance2)
                    found += 1
    return index, value, found


@njit(**INNER)
def _posterior(x: F8, p: F8, i: int, value: F8, q: int, w: F8, k: int) -> None:
    """m + Wᵀ D⁻¹ y and P − Wᵀ D⁻¹ W, W = L⁻¹ H P, of Gaussian i and pair q, in the k-th place.

    ``w`` (2, M, D) is scratch.
    """
    for a in range(M):
        for r in range(D):
            total = p[i, entry(max(ROWS[a], r), min(ROWS[a], r))]
            for t in range(a):
                total -= value[q, FACTOR + entry(a, t)] * w[0, t, r]
            w[0, a, r] = total
            w[1, a, r] = total * value[q, FACTOR + entry(a, a)]
    for r in range(D):
        total = x[i, r]
        for a in range(M):
            total += w[1, a, r] * value[q, Y + a]
        x[k, r] = total
        for c in range(r + 1):
            total = p[i, entry(r, c)]
            for a in range(M):
                total -= w[1, a, r] * w[0, a, c]
            p[k, entry(r, c)] = total


@njit(**INNER)
def given(births: F8, w: F8, x: F8, p: F8, t: I8, used: int, fresh: int) -> int:
    """Put a mixture (B, 1 + d + 21) behind the first ``used`` Gaussians, with tags from ``fresh`` on; how many there are."""
    for k in range(len(births)):
        w[used], t[used] = births[k, 0], fresh + k
        for r in range(D):
            x[used, r] = births[k, 1 + r]
        for e in range(ENTRIES):
            p[used, e] = births[k, 1 + D + e]
        used += 1
    return used


@njit(**INNER)
def _births(
    index: I8, value: F8, found: int, scene: Scene, b: BoxNumbers, region: float, crowded: F8, about: F8,
    w: F8, x: F8, p: F8, t: I8, used: int, fresh: int,
) -> int:  # fmt: skip
    """Put newborn about what no mass within ``region`` explains behind the first ``used``; how many there are then."""
    n = len(scene.boxes)
    covered, gamma = np.zeros(n), np.empty(n)
    for j in range(n):
        if b.birth == PLACES:
            gamma[j] = b.born * crowded[j] * about[scene.order[j], 0]
            continue
        density = b.born * crowded[j] if b.birth == LOCAL else b.born
        gamma[j] = density if possible(b, scene.boxes, j) else 0.0
    for q in range(found):
        if value[q, DISTANCE2] <= region:
            covered[index[q, 1]] += w[index[q, 0]]
    count: int = newborn(scene, b, gamma, about, covered, w, x, p, t, used, fresh)
    return count


@njit(**INNER)
def _weighed(
    index: I8, value: F8, found: int, order: I8, b: BoxNumbers, crowded: F8, kappa: F8, w: F8, table: F8
) -> tuple[float, int]:
    """The weight of each pair's posterior in the place of its density; their sum, and measurements with κ + C = 0.

    C(z) and κ(z) go to the rows of ``table`` (2, N), as they were measured; ``kappa`` comes to κ where that is by place.
    """
    n = order.size
    total, explained, after, vanished = np.zeros(n), np.empty(n), 0.0, 0
    for q in range(found):
        value[q, DENSITY] *= b.p_detect * w[index[q, 0]]
        total[index[q, 1]] += value[q, DENSITY]
    for j in range(n):
        clutter = b.false
        if b.clutter == LOCAL:
            clutter *= crowded[j]
        elif b.clutter == PLACES:
            clutter = kappa[order[j]] + (clutter * crowded[j] if clutter > 0.0 else 0.0)
        known = clutter + total[j] >= SMALLEST
        explained[j] = 1.0 / (clutter + total[j]) if known else 0.0
        vanished += not known
        after += total[j] * explained[j]
        table[0, order[j]], table[1, order[j]] = total[j], clutter
    for q in range(found):
        value[q, DENSITY] *= explained[index[q, 1]]
    return after, vanished


@njit(**INNER)
def _posteriors(
    index: I8, value: F8, found: int, w: F8, x: F8, p: F8, t: I8, used: int, prune: float
) -> tuple[F8, F8, F8, I8, int]:
    """Append the posteriors of the pairs that are no lighter than ``prune``; the arrays, and how many are in use."""
    count = 0
    for q in range(found):
        count += value[q, DENSITY] >= prune
    if used + count > w.size:
        w, x, p, t = _larger(w, x, p, t, used, used + count)
    scratch = np.empty((2, M, D))
    for q in range(found):
        if value[q, DENSITY] >= prune:
            w[used], t[used] = value[q, DENSITY], t[index[q, 0]]
            _posterior(x, p, index[q, 0], value, q, scratch, used)
            used += 1
    return w, x, p, t, used


@njit(**INNER)
def _larger(w: F8, x: F8, p: F8, t: I8, used: int, size: int) -> tuple[F8, F8, F8, I8]:
    """The same Gaussians in larger arrays."""
    wider, longer, larger, further = np.empty(size), np.empty((size, D)), np.empty((size, ENTRIES)), np.empty(size, np.int64)
    for i in range(used):
        wider[i], further[i] = w[i], t[i]
        for r in range(D):
            longer[i, r] = x[i, r]
        for e in range(ENTRIES):
            larger[i, e] = p[i, e]
    return wider, longer, larger, further


@njit(**INNER)
def _sum(w: F8, first: int, last: int) -> float:
    """The sum of ``w`` from ``first`` to before ``last``."""
    total = 0.0
    for i in range(first, last):
        total += w[i]
    return total


@njit(**ENTRY)
def box_step(
    weight: F8, mean: F8, cov: F8, tag: I8, z: F8, births: F8, about: F8, kappa: F8, model: F8, settings: F8, fresh: int
) -> tuple[F8, F8, F8, I8, F8, float, float, float, int, int]:
    """Predict, births, update, prune, merge and cap.

    Parameters
    ----------
    weight, mean, cov, tag : (J,), (d, J), (J, d, d), (J,) the mixture before the frame.
    z : (m, N) measurements.
    births : a mixture of births that is given: (B, 1 + d + 21) weight, mean and triangle of the covariance of each.
    about : (N, 6) how many times as many births there are at the measurements, and mean and covariance of the velocities
        there, where the model says that they are by place, else (0, 6).
    kappa : (N,) what comes to κ at the measurements where the model says that it is by place, else (0,).
    model, settings : the values of `BoxNumbers` and of `Limits`.
    fresh : the next new tag.

    Returns
    -------
    weight, mean, cov, tag : (K,), (d, K), (K, d, d), (K,) the mixture after it; table : (2, N) C(z) and κ(z); the masses
    predicted (with births), born, and after the update (before anything is dropped); the number of measurements with
    κ + C = 0; the next new tag.

    Raises
    ------
    ValueError : the position of a measurement is NaN or infinite.
    """
    b, limits = box_numbers(model), _limits(settings)
    n = z.shape[1]
    # A literal zero is a type of its own, for which the functions below would be compiled once more.
    none = 0 * n
    found, vanished = none, none
    # Rarely more than this: what is not used is not touched.
    room = 2 * weight.size + 3 * n + len(births) + 8
    w, x, p, t = np.empty(room), np.empty((room, D)), np.empty((room, ENTRIES)), np.empty(room, np.int64)
    index, value = np.empty((room, 2), np.int64), np.empty((room, PAIR))
    old = predicted(weight, mean, cov, tag, b, w, x, p, t)
    used = given(births, w, x, p, t, old, fresh)
    table, missed, after = np.empty((2, n)), 1.0 - b.p_detect, 0.0
    if n > 0:
        scene = sorted_boxes(z)
        crowded = crowding(scene, b) if around_each(b) else w
        index, value, found = paired(x, p, none, old, scene, b, limits.gate, index, value, found)
        if b.birth != NOWHERE:
            used = _births(
                index, value, found, scene, b, limits.region, crowded, about, w, x, p, t, used, fresh + used - old
            )
        index, value, found = paired(x, p, old, used, scene, b, limits.gate, index, value, found)
        after, vanished = _weighed(index, value, found, scene.order, b, crowded, kappa, w, table)
    elif limits.skip_empty > 0.0:
        missed = 1.0
    before, born = _sum(w, none, used), _sum(w, old, used)
    after += missed * before
    for i in range(used):
        w[i] *= missed
    fresh += used - old
    w, x, p, t, used = _posteriors(index, value, found, w, x, p, t, used, limits.prune)
    wanted = after if limits.redistribute > 0.0 else -1.0
    w, mean, cov, t, fresh = reduced(
        w[:used], x, p, t, AXES, limits.prune, limits.merge, int(limits.most), wanted, limits.split, fresh
    )
    return w, mean, cov, t, table, before, born, after, vanished, fresh
