"""Clusters whose boxes overlap by more than a sensor would let stand are joined, the pair that overlaps most first."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.box import overlap_of
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.joining import join

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]


@njit(**ENTRY)
def join_alike(
    first: I8, second: I8, shared: F8, boxes: F8, overlap: float, mass: F8, mean: F8, cov: F8
) -> tuple[F8, F8, F8, I8]:  # fmt: skip
    """What is left of k clusters, (m,), (d, m), (m, d, d), and (m,) which of them is the heaviest part of each.

    Joined are those whose ``boxes`` (k, 4) overlap by more than ``overlap`` (IoU), while there are any; of pairs that
    overlap as much, the earlier. They are given as ``first``, ``second``, ``shared``, see `joining.likeness`. A union takes
    the place of its earlier part and keeps mass, mean and covariance of both; its box is the mean of theirs by mass.
    """
    first, second, shared = first.copy(), second.copy(), shared.copy()
    k, d, count = mass.size, mean.shape[0], first.size
    box, part, alive = boxes.copy(), np.arange(k), np.ones(k, np.bool_)
    weight, centre, spread = mass.copy(), mean.copy(), cov.copy()
    while count > 0:
        i, j = _foremost(first, second, shared, count)
        share = weight[j] / (weight[i] + weight[j])
        for r in range(box.shape[1]):
            box[i, r] += share * (box[j, r] - box[i, r])
        join(i, weight[j], centre, spread, j, weight, centre, spread)
        alive[j] = False
        if mass[part[j]] > mass[part[i]]:
            part[i] = part[j]
        kept = 0
        for p in range(count):
            if first[p] != i and second[p] != i and first[p] != j and second[p] != j:
                first[kept], second[kept], shared[kept] = first[p], second[p], shared[p]
                kept += 1
        if kept + k > first.size:
            first, second, shared = _longer(first, second, shared, kept, k)
        # All that are left, and not only the neighbours of its parts: there are few unions.
        count = kept
        for a in range(k):
            share = overlap_of(box, a, i) if alive[a] and a != i else 0.0
            if share > overlap:
                first[count], second[count], shared[count] = min(a, i), max(a, i), share
                count += 1
    left = 0
    for a in range(k):
        left += 1 if alive[a] else 0
    out_weight, out_part = np.empty(left), np.empty(left, np.int64)
    out_mean, out_cov = np.empty((d, left)), np.empty((left, d, d))
    at = 0
    for a in range(k):
        if alive[a]:
            out_weight[at], out_part[at] = weight[a], part[a]
            for r in range(d):
                out_mean[r, at] = centre[r, a]
                for s in range(d):
                    out_cov[at, r, s] = spread[a, r, s]
            at += 1
    return out_weight, out_mean, out_cov, out_part


@njit(**INNER)
def _foremost(first: I8, second: I8, shared: F8, count: int) -> tuple[int, int]:
    """Of so many pairs the one that overlaps most, the earlier where equal."""
    best = 0
    for p in range(1, count):
        earlier = first[p] < first[best] or (first[p] == first[best] and second[p] < second[best])
        if shared[p] > shared[best] or (shared[p] == shared[best] and earlier):
            best = p
    return first[best], second[best]


@njit(**INNER)
def _longer(first: I8, second: I8, shared: F8, count: int, more: int) -> tuple[I8, I8, F8]:
    """The pairs, of which so many are used, with room for ``more`` and as many again."""
    size = 2 * (count + more)
    a, b, c = np.empty(size, np.int64), np.empty(size, np.int64), np.empty(size)
    for p in range(count):
        a[p], b[p], c[p] = first[p], second[p], shared[p]
    return a, b, c
