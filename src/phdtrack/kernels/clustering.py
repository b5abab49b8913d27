"""What is done with clusters of particles in blocks: which particles no centre reaches, and the moments of the clusters."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.blocks import Real, U, gather, load_weight, weigh
from phdtrack.kernels.fast32 import ENTRY, FAST, VECTOR
from phdtrack.kernels.nearest import MIXED, file_centre

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
I4 = NDArray[np.int32]


@njit(**(ENTRY | {"fastmath": FAST}))
def outside(
    state: Real, start: I8, known: F8, most: int, lower: F8, upper: F8, frame: F8, cells: I8, item: I8, corner: I8,
    centres: F8, scales: F8, reach: float,
) -> tuple[I8, I8, I8]:  # fmt: skip
    """The particles that none of k centres (d, k) reaches, in their order; and which centres are near each block.

    A centre reaches ``reach`` of its deviations ``scales`` (d, k) in position. ``known`` as in `blocks.summarise`; at most
    ``most`` particles in a block; ``lower`` … ``corner``: the grid over the blocks' boxes. The lists of the centres near
    the blocks, ``head`` (B,) and ``link`` (2, E), are those of `nearest`.
    """
    d, blocks, used, count = state.shape[0], start.size - 1, 0, 0
    head, link, found = np.empty(blocks, np.int64), np.empty((2, 2 * blocks + 64), np.int64), np.empty(blocks, np.int64)
    for b in range(blocks):
        head[b] = -1
    for j in range(centres.shape[1]):
        rx, ry = reach * scales[0, j], reach * scales[1, j]
        link, used = file_centre(
            j, centres[0, j], centres[1, j], rx, ry, lower, upper, frame, cells, item, corner, head, link, used, found
        )  # fmt: skip
    out, free = np.empty(state.shape[1], np.int64), np.empty(most, np.bool_)
    for b in range(blocks):
        begin, n, covered, e = start[b], start[b + 1] - start[b], False, head[b]
        while e >= 0 and not covered:
            j = link[0, e]
            e = link[1, e]
            rx, ry = reach * scales[0, j], reach * scales[1, j]
            covered = centres[0, j] - rx <= known[b, 1] and known[b, 1 + d] <= centres[0, j] + rx
            covered &= centres[1, j] - ry <= known[b, 2] and known[b, 2 + d] <= centres[1, j] + ry
        if covered:
            continue
        for i in range(n):
            free[i] = True
        e = head[b]
        while e >= 0:
            j = link[0, e]
            e = link[1, e]
            rx, ry = reach * scales[0, j], reach * scales[1, j]
            left, top, right, bottom = centres[0, j] - rx, centres[1, j] - ry, centres[0, j] + rx, centres[1, j] + ry
            for i in range(n):
                x, y = state[0, begin + i], state[1, begin + i]
                free[i] &= not ((x >= left) & (x <= right) & (y >= top) & (y <= bottom))
        for i in range(n):
            if free[i]:
                out[count] = begin + i
                count += 1
    return out[:count], head, link[:, :used]


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
    state: Real, begin: int, n: int, each: float, j: int, scratch: Real, one: F8, two: F8, reference: F8,
    total: F8, mean: F8, cov: F8,
) -> None:  # fmt: skip
    """Add n particles to the moments of cluster j about ``reference``.

    Their weights are ``each``, or, where that is 0, stand in ``scratch``.
    """
    d, at = state.shape[0], U(begin)
    for r in range(d):
        zero = state.dtype.type(reference[r, j])
        for i in range(U(n)):
            scratch[r, i] = state[r, at + i] - zero
    unit, left = each, 0
    if each > 0.0:
        total[j] += n * each
    else:
        total[j] += weigh(scratch, n, d)
        unit, left = 1.0, d + d % 2
    gather(scratch, n, left, one, two)
    for r in range(d):
        mean[r, j] += unit * one[r]
        for s in range(r + 1):
            cov[j, r, s] += unit * two[r, s]


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
    nobody, zero = np.int32(reference.shape[1]), state.dtype.type(0)
    w, of_each = scratch.shape[0] - 2, scratch.shape[0] - 1
    # Where all weigh the same, what is added up need not be weighed one by one.
    each = float(weight[0]) if weight.size == 1 else 0.0
    for b in range(label.size):
        begin, n = start[b], start[b + 1] - start[b]
        if label[b] >= 0 and cluster[label[b]] >= 0:
            if each == 0.0:
                load_weight(weight, begin, n, scratch, w)
            add_members(state, begin, n, each, cluster[label[b]], scratch, one, two, reference, total, mean, cov)
        if label[b] != MIXED:
            continue
        load_weight(weight, begin, n, scratch, of_each)
        for i in range(n):
            which[i] = cluster[own[begin + i]] if own[begin + i] >= 0 else -1
        # The clusters of a mixed block in ascending order.
        last = np.int32(-1)
        while True:
            j = nobody
            for i in range(U(n)):
                j = which[i] if (which[i] > last) & (which[i] < j) else j
            if j == nobody:
                break
            for i in range(U(n)):
                scratch[w, i] = scratch[of_each, i] if which[i] == j else zero
            add_members(state, begin, n, 0.0, np.int64(j), scratch, one, two, reference, total, mean, cov)
            last = j
    centred(total, mean, cov, reference)
