"""What is done with clusters of particles in blocks: which particles no centre reaches, and the moments of the clusters."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.blocks import Real, gather, load_weight, weigh
from phdtrack.kernels.fast32 import ENTRY, FAST, VECTOR
from phdtrack.kernels.nearest import MIXED

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
I4 = NDArray[np.int32]
Bool = NDArray[np.bool_]


@njit(**(ENTRY | {"fastmath": FAST}))
def outside(
    state: Real, start: I8, known: F8, lower: F8, upper: F8, which: I8, block: I8, covered: Bool, free: Bool, out: I8
) -> int:
    """Write into ``out`` (L,) the particles that lie in none of k rectangles, in their order; how many.

    The pairs (which, block) name at least all blocks that each rectangle, with corners ``lower`` and ``upper`` (2, k),
    overlaps. ``known`` as in `blocks.summarise`; ``covered`` (B,) and ``free`` (L,) are working memory.
    """
    d = state.shape[0]
    for b in range(covered.size):
        covered[b] = False
    for p in range(which.size):
        j, b = which[p], block[p]
        held = lower[0, j] <= known[b, 1] and known[b, 1 + d] <= upper[0, j]
        if held and lower[1, j] <= known[b, 2] and known[b, 2 + d] <= upper[1, j]:
            covered[b] = True
    for b in range(covered.size):
        for i in range(start[b], start[b + 1] if not covered[b] else 0):
            free[i] = True
    for p in range(which.size):
        j, b = which[p], block[p]
        if covered[b]:
            continue
        left, top, right, bottom = lower[0, j], lower[1, j], upper[0, j], upper[1, j]
        for i in range(start[b], start[b + 1]):
            x, y = state[0, i], state[1, i]
            free[i] &= not ((x >= left) & (x <= right) & (y >= top) & (y <= bottom))
    found = 0
    for b in range(covered.size):
        for i in range(start[b], start[b + 1] if not covered[b] else 0):
            if free[i]:
                out[found] = i
                found += 1
    return found


@njit(**VECTOR)
def add_part(mass: float, first: F8, second: F8, shift: F8, j: int, total: F8, mean: F8, cov: F8) -> None:
    """Add to cluster j's raw moments those of a part, given about a point that lies ``shift`` (d,) from the reference."""
    total[j] += mass
    for r in range(shift.size):
        mean[r, j] += first[r] + mass * shift[r]
        for s in range(r + 1):
            cov[j, r, s] += second[r, s] + first[r] * shift[s] + shift[r] * first[s] + mass * shift[r] * shift[s]


@njit(**VECTOR)
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


@njit(**VECTOR)
def add_members(
    state: Real, begin: int, n: int, j: int, scratch: Real, one: F8, two: F8, reference: F8, total: F8, mean: F8, cov: F8
) -> None:
    """Add particles, whose weights stand in ``scratch``, to the moments of cluster j about ``reference``."""
    d = state.shape[0]
    for r in range(d):
        row, out, zero = state[r, begin : begin + n], scratch[r], state.dtype.type(reference[r, j])
        for i in range(n):
            out[i] = row[i] - zero
    total[j] += weigh(scratch, n, d)
    gather(scratch, n, one, two)
    for r in range(d):
        mean[r, j] += one[r]
        for s in range(r + 1):
            cov[j, r, s] += two[r, s]


@njit(**(ENTRY | {"fastmath": FAST}))
def cluster_moments(
    state: Real, weight: Real, start: I8, label: I4, own: I4, cluster: I8, reference: F8,
    scratch: Real, which: I4, one: F8, two: F8, total: F8, mean: F8, cov: F8,
) -> None:  # fmt: skip
    """Write masses (k,), means (d, k) and covariances (k, d, d) of the clusters into zeros.

    Label j counts for cluster ``cluster[j]``, or for none where that is −1. Moments are taken about ``reference`` (d, k), a
    point in the middle of each cluster, exact in the states' precision, because the difference of moments about a far point
    loses all digits. Working memory: ``scratch`` (2·even d + 2, ≥ n) zeros, ``which`` (≥ n,), ``one`` (d,), ``two``
    (even d, even d).
    """
    w, of_each, zero = scratch[scratch.shape[0] - 2], scratch[scratch.shape[0] - 1], scratch.dtype.type(0)
    nobody = np.int32(reference.shape[1])
    for b in range(label.size):
        begin, n = start[b], start[b + 1] - start[b]
        mine = own[begin : begin + n]
        if label[b] >= 0 and cluster[label[b]] >= 0:
            load_weight(weight, begin, n, w)
            add_members(state, begin, n, cluster[label[b]], scratch, one, two, reference, total, mean, cov)
        if label[b] != MIXED:
            continue
        load_weight(weight, begin, n, of_each)
        for i in range(n):
            which[i] = cluster[mine[i]] if mine[i] >= 0 else -1
        # The clusters of a mixed block in ascending order.
        last = np.int32(-1)
        while True:
            j = nobody
            for i in range(n):
                j = which[i] if (which[i] > last) & (which[i] < j) else j
            if j == nobody:
                break
            for i in range(n):
                w[i] = of_each[i] if which[i] == j else zero
            add_members(state, begin, n, np.int64(j), scratch, one, two, reference, total, mean, cov)
            last = j
    centred(total, mean, cov, reference)
