"""Clusters that are near each other, boxes that overlap, and who is served first: what is done with the clusters found."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.overlaps import overlapping, rectangle_grid

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
Bool = NDArray[np.bool_]


@njit(nogil=True, cache=True)
def near_pairs(x: F8, scale: F8, reach: float, among: I8) -> tuple[I8, I8, F8]:
    """Pairs i < j in ``among`` of points (d, k) with Σ_r ((x_ri − x_rj)/s_ri)² ≤ reach², ordered by i, j; and that sum."""
    at = np.empty((2, among.size))
    for p in range(among.size):
        at[0, p], at[1, p] = x[0, among[p]], x[1, among[p]]
    frame, cells, item, corner = rectangle_grid(at, at)
    near = np.empty(among.size, np.int64)
    first, second, apart = [0 for _ in range(0)], [0 for _ in range(0)], [0.0 for _ in range(0)]
    for p in range(among.size):
        i = among[p]
        rx, ry = reach * scale[0, i], reach * scale[1, i]
        left, top, right, bottom = x[0, i] - rx, x[1, i] - ry, x[0, i] + rx, x[1, i] + ry
        count = overlapping(left, top, right, bottom, at, at, frame, cells, item, corner, near)
        for c in range(count):
            if near[c] <= p:
                continue
            j, distance2 = among[near[c]], 0.0
            for r in range(x.shape[0]):
                step = (x[r, i] - x[r, j]) / scale[r, i]
                distance2 += step * step
            if distance2 <= reach * reach:
                first.append(i)
                second.append(j)
                apart.append(distance2)
    return np.array(first, np.int64), np.array(second, np.int64), np.array(apart, np.float64)


@njit(nogil=True, cache=True)
def join_pairs(order: I8, first: I8, second: I8, mass: F8, lightest: float, heaviest: float) -> I8:
    """(k,) the cluster that each of the clusters has become part of: itself, or another.

    The pairs are joined in ``order`` while one of the two, with what it was joined to, is lighter than ``lightest`` and
    the union is no heavier than ``heaviest``.
    """
    root = np.arange(mass.size)
    total = mass.copy()
    for p in order:
        i, j = first[p], second[p]
        while root[i] != i:
            i = root[i]
        while root[j] != j:
            j = root[j]
        if i != j and min(total[i], total[j]) < lightest and total[i] + total[j] <= heaviest:
            root[j] = i
            total[i] += total[j]
    for i in range(mass.size):
        while root[root[i]] != root[i]:
            root[i] = root[root[i]]
    return root


@njit(nogil=True, cache=True)
def box_overlap(xyxy: F8, a: int, b: int) -> float:
    """Intersection over union of rows a and b of (n, 4) boxes; 0 where both have no area."""
    wide = min(xyxy[a, 2], xyxy[b, 2]) - max(xyxy[a, 0], xyxy[b, 0])
    high = min(xyxy[a, 3], xyxy[b, 3]) - max(xyxy[a, 1], xyxy[b, 1])
    shared = max(wide, 0.0) * max(high, 0.0)
    union = (xyxy[a, 2] - xyxy[a, 0]) * (xyxy[a, 3] - xyxy[a, 1])
    union += (xyxy[b, 2] - xyxy[b, 0]) * (xyxy[b, 3] - xyxy[b, 1]) - shared
    return shared / union if union > 0.0 else 0.0


@njit(nogil=True, cache=True)
def overlapping_boxes(xyxy: F8, above: float) -> tuple[I8, I8, F8]:
    """Pairs i < j of (n, 4) boxes whose overlap (IoU) is above the bound, ordered by i, j; and their overlaps."""
    n = xyxy.shape[0]
    lower, upper = np.empty((2, n)), np.empty((2, n))
    for i in range(n):
        for r in range(2):
            lower[r, i], upper[r, i] = xyxy[i, r], xyxy[i, 2 + r]
    frame, cells, item, corner = rectangle_grid(lower, upper)
    near = np.empty(n, np.int64)
    first, second, shared = [0 for _ in range(0)], [0 for _ in range(0)], [0.0 for _ in range(0)]
    for i in range(n):
        left, top, right, bottom = lower[0, i], lower[1, i], upper[0, i], upper[1, i]
        count = overlapping(left, top, right, bottom, lower, upper, frame, cells, item, corner, near)
        for c in range(count):
            j = near[c]
            if j > i:
                overlap = box_overlap(xyxy, i, j)
                if overlap > above:
                    first.append(i)
                    second.append(j)
                    shared.append(overlap)
    return np.array(first, np.int64), np.array(second, np.int64), np.array(shared, np.float64)


@njit(nogil=True, cache=True)
def serve(order: I8, taker: I8, thing: I8, takers: int, things: int) -> I8:
    """(takers,) what each taker gets (−1: nothing): pairs are granted in ``order`` while both are free."""
    got, gone = np.full(takers, -1, np.int64), np.zeros(things, np.bool_)
    for p in order:
        i, j = taker[p], thing[p]
        if got[i] < 0 and not gone[j]:
            got[i] = j
            gone[j] = True
    return got


@njit(nogil=True, cache=True)
def claim(x: F8, weight: F8, asked: I8, point: I8, which: I8) -> tuple[F8, Bool]:
    """Centres (d, m) among points (d, L): each of ``asked`` claims what it reaches and nobody before it has claimed.

    The pairs (point, which) say which points the asked one ``which`` reaches, ordered by ``which``. A point that is claimed
    already asks no more. Also which points (L,) have been claimed.
    """
    d = x.shape[0]
    claimed = np.zeros(x.shape[1], np.bool_)
    centre, mass = np.zeros((d, asked.size)), np.zeros(asked.size)
    found, p = 0, 0
    for a in range(asked.size):
        free = not claimed[asked[a]]
        while p < point.size and which[p] == a:
            i = point[p]
            if free and not claimed[i]:
                claimed[i] = True
                mass[found] += weight[i]
                for r in range(d):
                    # About the asked point: sums far from the origin lose their digits.
                    centre[r, found] += weight[i] * (x[r, i] - x[r, asked[a]])
            p += 1
        if free and mass[found] > 0.0:
            for r in range(d):
                centre[r, found] = x[r, asked[a]] + centre[r, found] / mass[found]
            found += 1
    return centre[:, :found].copy(), claimed


@njit(nogil=True, cache=True)
def overlaps_with(xyxy: F8, i: int, alive: Bool, above: float) -> tuple[I8, F8]:
    """The other boxes ``alive`` (n,) that box i overlaps (IoU) by more than the bound, and their overlaps."""
    other, shared = np.empty(xyxy.shape[0], np.int64), np.empty(xyxy.shape[0])
    found = 0
    for j in range(xyxy.shape[0]):
        if alive[j] and j != i:
            overlap = box_overlap(xyxy, i, j)
            if overlap > above:
                other[found], shared[found] = j, overlap
                found += 1
    return other[:found].copy(), shared[:found].copy()
