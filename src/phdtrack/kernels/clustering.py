"""What is done with clusters of particles in blocks: which particles no centre reaches, and the moments of the clusters."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.blocks import Real, U, load, load_steps, load_weight, products, spread, sums, weigh, whole
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, FAST, VECTOR
from phdtrack.kernels.nearest import MIXED, file_centre, reached

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
I4 = NDArray[np.int32]


@njit(**(ENTRY | {"fastmath": FAST}))
def outside(
    state: Real, start: I8, known: F8, most: int, lower: F8, upper: F8, frame: F8, cells: I8, item: I8, corner: I8,
    centres: F8, scales: F8, reach: float,
) -> tuple[I8, I8, I8, int]:  # fmt: skip
    """The particles that none of k centres (d, k) reaches, in their order; and which centres are near each block.

    A centre reaches ``reach`` of its deviations ``scales`` (d, k) in position. ``known`` as in `blocks.summarise`; at most
    ``most`` particles in a block; ``lower`` … ``corner``: the grid over the blocks' boxes. The lists of the centres near
    the blocks, ``head`` (B,) and ``link`` (2, ≥ E), are those of `nearest`; the last number is E.
    """
    d, blocks, used, count = state.shape[0], start.size - 1, 0, 0
    head, link, found = np.empty(blocks, np.int64), np.empty((2, 2 * blocks + 64), np.int64), np.empty(blocks, np.int64)
    for b in range(blocks):
        head[b] = -1
    for j in range(centres.shape[1]):
        rx, ry = reach * scales[0, j], reach * scales[1, j]
        some = reached(centres[0, j], centres[1, j], rx, ry, lower, upper, frame, cells, item, corner, found)
        link, used = file_centre(j, some, found, head, link, used)
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
    return out[:count], head, link, used


@njit(**VECTOR)
def add_part(mass: float, first: F8, second: F8, shift: F8, j: int, total: F8, mean: F8, cov: F8) -> None:
    """Add to cluster j's raw moments those of a part, given about a point that lies ``shift`` (d,) from the reference."""
    total[j] += mass
    for r in range(shift.size):
        mean[r, j] += first[r] + mass * shift[r]
        for s in range(r + 1):
            cov[j, r, s] += second[r, s] + first[r] * shift[s] + shift[r] * first[s] + mass * shift[r] * shift[s]


@njit(**VECTOR)
def centred(k: int, total: F8, mean: F8, cov: F8, reference: F8) -> None:
    """Turn raw moments of k clusters about ``reference`` (d, k) into masses, means and covariances, in place."""
    for j in range(k):
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
def add_masked(
    state: Real, weight: Real, begin: int, n: int, known: F8, b: int, own: I4, k: int, scratch: Real,
    one: F8, two: F8, shift: F8, reference: F8, total: F8, mean: F8, cov: F8,
) -> None:  # fmt: skip
    """Add a mixed block's particles to the raw moments of the k clusters that they are said to be in by ``own``."""
    d, at, full, nobody = state.shape[0], U(begin), whole(n), np.int32(k)
    even, zero = d + d % 2, state.dtype.type(0)
    w, of_each = 2 * even, 2 * even + 1
    load_steps(state, begin, n, known, b, scratch)
    load_weight(weight, begin, n, scratch, of_each)
    for i in range(U(n), U(full)):
        scratch[w, i] = zero
    # The clusters of the block in ascending order.
    last = np.int32(-1)
    while True:
        j = nobody
        for i in range(U(n)):
            now = own[at + i]
            j = min(j, now if now > last else nobody)
        if j == nobody:
            break
        for i in range(U(n)):
            now = scratch[of_each, i]
            scratch[w, i] = now if own[at + i] == j else zero
        m = weigh(scratch, full, d)
        sums(scratch, full, even, one)
        products(scratch, full, even, two)
        for r in range(d):
            shift[r] = known[b, 1 + 2 * d + r] - reference[r, j]
        add_part(m, one, two, shift, np.int64(j), total, mean, cov)
        last = j


@njit(**VECTOR)
def cluster_moments(
    state: Real, weight: Real, start: I8, known: F8, second: F8, blocks: I8, label: I4, own: I4, k: int, scratch: Real,
    one: F8, two: F8, shift: F8, reference: F8, total: F8, mean: F8, cov: F8,
) -> None:  # fmt: skip
    """Masses, means and covariances of k clusters, of which ``blocks`` consist: the first of (k,), (d, k) and (k, d, d).

    ``label``, ``own`` : a block's cluster, −1 for none, `MIXED` where the particles have their own. What is ``known`` of a
    block, with ``second`` unless that is (0, even d, even d), is enough where it is not mixed. ``reference`` (d, k): a
    point in the middle of each cluster.
    Working memory: ``scratch`` as in `blocks.summarise`; ``one``, ``shift`` (d,), ``two`` (even d, even d).
    """
    d = state.shape[0]
    for j in range(k):
        total[j] = 0.0
        for r in range(d):
            mean[r, j] = 0.0
            for s in range(d):
                cov[j, r, s] = 0.0
    for q in range(blocks.size):
        b = blocks[q]
        begin, n, whose = start[b], start[b + 1] - start[b], np.int64(label[b])
        if whose >= 0:
            for r in range(d):
                middle = known[b, 1 + 2 * d + r]
                one[r], shift[r] = known[b, 1 + 3 * d + r] - known[b, 0] * middle, middle - reference[r, whose]
            if second.shape[0] > 0:
                add_part(known[b, 0], one, second[b], shift, whose, total, mean, cov)
            else:
                load(state, weight, begin, n, known, b, scratch)
                spread(weight, scratch, n, two)
                add_part(known[b, 0], one, two, shift, whose, total, mean, cov)
        elif whose == MIXED:
            add_masked(
                state, weight, begin, n, known, b, own, k, scratch, one, two, shift, reference, total, mean, cov
            )  # fmt: skip
    centred(k, total, mean, cov, reference)
