"""K-means over blocks of particles: which centre each particle belongs to, and what the centres' clusters are.

Most blocks lie near one centre only, or nearer to it than to any other by all of their bounding box. What such a block adds
to its cluster is known from its sums, and none of its particles is looked at again. A block with particles of several
clusters, or of none, is mixed: its particles have labels of their own.

Centres are (d, k), ``scale`` the deviations by which distances are measured, (d, k); a centre reaches ``reach`` deviations
in position, and one with ``alive`` not above 0 reaches nowhere. ``label`` (B,) is a block's cluster, −1 for none, −2 for a
mixed block, whose particles' clusters stand in ``own`` (L,).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.blocks import Real, even, gather, load_steps, load_weight, weigh, widest
from phdtrack.kernels.fast32 import FAST
from phdtrack.kernels.overlaps import overlapping, rectangle_grid

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
I4 = NDArray[np.int32]
Bool = NDArray[np.bool_]
MIXED = -2


@njit(nogil=True, fastmath=FAST)
def reaches(centre: F8, scale: F8, reach: float, alive: F8) -> tuple[F8, F8]:
    """Corners (2, k) of the rectangles that the centres reach."""
    k = centre.shape[1]
    lower, upper = np.empty((2, k)), np.empty((2, k))
    for j in range(k):
        for r in range(2):
            half = reach * scale[r, j] if alive[j] > 0.0 else 0.0
            lower[r, j], upper[r, j] = centre[r, j] - half, centre[r, j] + half
    if not np.isfinite(lower.sum() + upper.sum()):
        raise ValueError("centres and their deviations must be finite")
    return lower, upper


@njit(nogil=True, fastmath=FAST)
def reaching(
    low: Real, high: Real, lower: F8, upper: F8, frame: F8, cells: I8, item: I8, corner: I8, alive: F8, near: I8
) -> int:
    """Write into ``near`` (k,) the living centres that reach into a block's box, ascending; how many."""
    found = overlapping(low[0], low[1], high[0], high[1], lower, upper, frame, cells, item, corner, near)
    count = 0
    for c in range(found):
        j = near[c]
        if alive[j] > 0.0:
            at = count
            while at > 0 and near[at - 1] > j:
                near[at] = near[at - 1]
                at -= 1
            near[at] = j
            count += 1
    return count


@njit(nogil=True, fastmath=FAST)
def holds(lower: F8, upper: F8, j: int, low: Real, high: Real) -> bool:
    """Whether rectangle j holds all of a block's box."""
    inside: bool = lower[0, j] <= low[0] and high[0] <= upper[0, j] and lower[1, j] <= low[1] and high[1] <= upper[1, j]
    return inside


@njit(nogil=True, cache=True, fastmath=FAST)
def block_grid(low: Real, high: Real) -> tuple[F8, F8, F8, I8, I8, I8]:
    """A grid over the blocks' boxes in position, as `overlaps.overlapping` asks it: their corners (2, B), and the grid."""
    blocks = low.shape[0]
    lower, upper = np.empty((2, blocks)), np.empty((2, blocks))
    for b in range(blocks):
        for r in range(2):
            lower[r, b], upper[r, b] = low[b, r], high[b, r]
    frame, cells, item, corner = rectangle_grid(lower, upper)
    return lower, upper, frame, cells, item, corner


@njit(nogil=True, cache=True, fastmath=FAST)
def outside(state: Real, start: I8, low: Real, high: Real, centre: F8, scale: F8, reach: float) -> I8:
    """The particles that no centre reaches, in their order."""
    alive = np.ones(centre.shape[1])
    lower, upper = reaches(centre, scale, reach, alive)
    frame, cells, item, corner = rectangle_grid(lower, upper)
    near = np.empty(centre.shape[1], np.int64)
    free = np.empty(widest(start), np.bool_)
    found, out = 0, np.empty(state.shape[1], np.int64)
    for b in range(start.size - 1):
        begin, n = start[b], start[b + 1] - start[b]
        if n == 0:
            continue
        count = reaching(low[b], high[b], lower, upper, frame, cells, item, corner, alive, near)
        held = False
        for c in range(count):
            held |= holds(lower, upper, near[c], low[b], high[b])
        if held:
            continue
        x, y = state[0, begin : begin + n], state[1, begin : begin + n]
        for i in range(n):
            free[i] = True
        for c in range(count):
            j = near[c]
            for i in range(n):
                free[i] &= not (
                    (x[i] >= lower[0, j]) & (x[i] <= upper[0, j]) & (y[i] >= lower[1, j]) & (y[i] <= upper[1, j])
                )
        for i in range(n):
            if free[i]:
                out[found] = begin + i
                found += 1
    return out[:found].copy()


@njit(nogil=True, fastmath=FAST)
def add_part(mass: float, first: F8, second: F8, shift: F8, j: int, total: F8, mean: F8, cov: F8) -> None:
    """Add to cluster j's raw moments those of a part, given about a point that lies ``shift`` (d,) from the reference."""
    total[j] += mass
    for r in range(shift.size):
        mean[r, j] += first[r] + mass * shift[r]
        for s in range(r + 1):
            cov[j, r, s] += second[r, s] + first[r] * shift[s] + shift[r] * first[s] + mass * shift[r] * shift[s]


@njit(nogil=True, fastmath=FAST)
def centred(total: F8, mean: F8, cov: F8, reference: F8) -> None:
    """Turn raw moments about ``reference`` (d, k) into masses, means (d, k) and covariances (k, d, d), in place."""
    for j in range(total.size):
        m = total[j]
        for r in range(mean.shape[0]):
            if m > 0.0:
                mean[r, j] /= m
            for s in range(r + 1):
                if m > 0.0:
                    cov[j, r, s] = cov[j, r, s] / m - mean[r, j] * mean[s, j]
                cov[j, s, r] = cov[j, r, s]
        for r in range(mean.shape[0]):
            mean[r, j] += reference[r, j]


@njit(nogil=True, cache=True, fastmath=FAST)
def cluster_moments(
    state: Real, weight: Real, start: I8, origin: Real, mass: F8, first: F8, second: F8,
    label: I4, own: I4, cluster: I8, reference: F8,
) -> tuple[F8, F8, F8]:  # fmt: skip
    """Masses (k,), means (d, k) and covariances (k, d, d) of the clusters.

    Label j counts for cluster ``cluster[j]``, or for none where that is −1. Moments are taken about ``reference`` (d, k), a
    point in the middle of each cluster, because the difference of moments about a far point loses all digits.
    """
    d, k = reference.shape
    most = widest(start)
    total, mean, cov = np.zeros(k), np.zeros((d, k)), np.zeros((k, d, d))
    step, weighted = np.zeros((even(d), most), state.dtype), np.zeros((even(d), most), state.dtype)
    w, mine = np.empty(most, state.dtype), np.empty(most, state.dtype)
    shift, one, two = np.empty(d), np.empty(d), np.empty((even(d), even(d)))
    done = np.empty(most, np.int64)
    for b in range(label.size):
        begin, n = start[b], start[b + 1] - start[b]
        if label[b] >= 0:
            j = cluster[label[b]]
            if j >= 0:
                for r in range(d):
                    shift[r] = origin[b, r] - reference[r, j]
                add_part(mass[b], first[b], second[b], shift, j, total, mean, cov)
        elif label[b] == MIXED:
            load_steps(state, begin, n, origin[b], step)
            load_weight(weight, begin, n, w)
            served = 0
            for i in range(n):
                j = cluster[own[begin + i]] if own[begin + i] >= 0 else -1
                known = j < 0
                for q in range(served):
                    known |= done[q] == j
                if known:
                    continue
                done[served] = j
                served += 1
                for q in range(n):
                    member = own[begin + q] >= 0 and cluster[own[begin + q]] == j
                    mine[q] = w[q] if member else state.dtype.type(0)
                m = weigh(mine, step, n, d, weighted)
                gather(weighted, step, n, 1.0, one, two)
                for r in range(d):
                    shift[r] = origin[b, r] - reference[r, j]
                add_part(m, one, two, shift, j, total, mean, cov)
    centred(total, mean, cov, reference)
    return total, mean, cov
