"""Which rectangles meet, who claims which points, which clusters are one: what is done with the clusters found."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.box import overlap_of
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.grid import make_grid, overlapping_pairs

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
Bool = NDArray[np.bool_]


@njit(**ENTRY)
def meeting(low: F8, high: F8, lower: F8, upper: F8) -> tuple[I8, I8]:
    """Pairs (i, j) (P,) of closed rectangles that overlap, ordered by i and then j.

    Those with corners ``low`` and ``high`` (2, M) against those with ``lower`` and ``upper`` (2, N).
    """
    first, second = overlapping_pairs(low, high, make_grid(lower, upper, 0.0, 0.0))
    for p in range(first.size):
        at, j = p, second[p]
        while at > 0 and first[at - 1] == first[p] and second[at - 1] > j:
            second[at] = second[at - 1]
            at -= 1
        second[at] = j
    return first, second


@njit(**INNER)
def nearest_first(distance2: F8, order: I8) -> None:
    """Write into ``order`` (P,) the places of the first P numbers, ascending, the lower place first where equal: a heap."""
    n = order.size
    for p in range(n):
        order[p] = p
    for turn in range(n // 2 + n):
        at, end = n // 2 - 1 - turn, n
        if at < 0:
            # The heap stands; the farthest of what is left goes to its end.
            at, end = 0, n - 1 - (turn - n // 2)
            order[0], order[end] = order[end], order[0]
        while 2 * at + 1 < end:
            below = 2 * at + 1
            if below + 1 < end and precedes(distance2, order[below], order[below + 1]):
                below += 1
            if precedes(distance2, order[below], order[at]):
                break
            order[at], order[below] = order[below], order[at]
            at = below


@njit(**INNER)
def precedes(distance2: F8, p: int, q: int) -> bool:
    """Whether place p comes before place q."""
    earlier: bool = distance2[p] < distance2[q] or (distance2[p] == distance2[q] and p < q)
    return earlier


@njit(**INNER)
def join_light(first: I8, second: I8, mass: F8, mean: F8, scale: F8, reach: float, lightest: float, split: float) -> I8:
    """(k,) the cluster that each has become part of: itself, or another.

    Pairs of clusters lighter than ``lightest`` whose means (d, k) are at most ``reach`` deviations ``scale`` (d, k) of the
    first apart are joined, nearest first, while one of the two, with what it was joined to, is too light and the union not
    above ``split``. They are among the pairs (first, second), which are in order.
    """
    k, count = mass.size, 0
    root, near = np.empty(k, np.int64), np.empty(first.size, np.int64)
    total, distance2 = np.empty(k), np.empty(first.size)
    for j in range(k):
        root[j], total[j] = j, mass[j]
    for p in range(first.size):
        i, j, apart = first[p], second[p], 0.0
        if i < j and 0.0 < mass[i] < lightest and 0.0 < mass[j] < lightest:
            for r in range(mean.shape[0]):
                step = (mean[r, i] - mean[r, j]) / scale[r, i]
                apart += step * step
            if apart <= reach * reach:
                near[count], distance2[count] = p, apart
                count += 1
    order = np.empty(count, np.int64)
    nearest_first(distance2, order)
    for q in range(count):
        a, b = first[near[order[q]]], second[near[order[q]]]
        while root[a] != a:
            a = root[a]
        while root[b] != b:
            b = root[b]
        low = total[a] if total[a] < total[b] else total[b]
        if a != b and low < lightest and total[a] + total[b] <= split:
            root[b] = a
            total[a] += total[b]
    for j in range(k):
        while root[root[j]] != root[j]:
            root[j] = root[root[j]]
    return root


@njit(**ENTRY)
def heavy_enough(mass: F8, mean: F8, cov: F8, scale: F8, reach: float, lightest: float, split: float) -> tuple[F8, F8, F8]:
    """Masses (m,), means (d, m) and covariances (m, d, d) of those that weigh ``lightest``, light ones joined.

    Arguments as in `join_light`, ``cov`` (k, d, d). A union keeps mass, mean and covariance of its parts.
    """
    at, low, high = np.empty((2, mass.size)), np.empty((2, mass.size)), np.empty((2, mass.size))
    for j in range(mass.size):
        for r in range(2):
            at[r, j], side = mean[r, j], reach * scale[r, j]
            low[r, j], high[r, j] = mean[r, j] - side, mean[r, j] + side
    first, second = meeting(low, high, at, at)
    root = join_light(first, second, mass, mean, scale, reach, lightest, split)
    d, k, kept = mean.shape[0], mass.size, 0
    total, place = np.empty(k), np.empty(k, np.int64)
    for j in range(k):
        total[j] = 0.0
    for j in range(k):
        total[root[j]] += mass[j]
    for j in range(k):
        place[j] = -1
        if root[j] == j and total[j] >= lightest:
            place[j] = kept
            kept += 1
    weight, centre, spread = np.empty(kept), np.empty((d, kept)), np.empty((kept, d, d))
    for i in range(kept):
        weight[i] = 0.0
    for j in range(k):
        i = place[root[j]]
        if i >= 0 and mass[j] > 0.0:
            join(i, mass[j], mean, cov, j, weight, centre, spread)
    return weight, centre, spread


@njit(**INNER)
def join(i: int, mass: float, mean: F8, cov: F8, j: int, weight: F8, centre: F8, spread: F8) -> None:
    """Put the union of cluster i of ``weight`` (m,), ``centre`` (d, m), ``spread`` (m, d, d), and another, in its place."""
    total, d = weight[i] + mass, mean.shape[0]
    share = mass / total
    for r in range(d):
        for s in range(d):
            if weight[i] > 0.0:
                apart = (mean[r, j] - centre[r, i]) * (mean[s, j] - centre[s, i])
                spread[i, r, s] += share * (cov[j, r, s] - spread[i, r, s]) + share * (1.0 - share) * apart
            else:
                spread[i, r, s] = cov[j, r, s]
    for r in range(d):
        centre[r, i] = centre[r, i] + share * (mean[r, j] - centre[r, i]) if weight[i] > 0.0 else mean[r, j]
    weight[i] = total


@njit(**ENTRY)
def likeness(boxes: F8, least: float) -> tuple[I8, I8, F8]:
    """Pairs i < j (P,) of boxes (n, 4) whose overlap (IoU) is above ``least``, and their overlaps (P,)."""
    n, count = boxes.shape[0], 0
    lower, upper = np.empty((2, n)), np.empty((2, n))
    for i in range(n):
        for r in range(2):
            lower[r, i], upper[r, i] = boxes[i, r], boxes[i, 2 + r]
    first, second = meeting(lower, upper, lower, upper)
    shared = np.empty(first.size)
    for p in range(first.size):
        i, j = first[p], second[p]
        share = overlap_of(boxes, i, j)
        if i < j and share > least:
            first[count], second[count], shared[count] = i, j, share
            count += 1
    return first[:count], second[:count], shared[:count]


@njit(**ENTRY)
def serve(which: I8, point: I8, distance2: F8, limit: float, floor: F8, detections: int, cov: F8) -> tuple[I8, F8]:
    """Pairs (detection, cluster) (P,) are served nearest first up to ``limit``; each has one of the other kind at most.

    Gives (k,) the detection that each cluster rests on, −1 for none; and ``cov`` (k, d, d) with a tenth of the deviations
    ``floor`` (d, k), squared, added to the diagonals.
    """
    d, k = floor.shape
    seen, taken, floored = np.empty(k, np.int64), np.empty(detections, np.bool_), np.empty((k, d, d))
    for z in range(detections):
        taken[z] = False
    for j in range(k):
        seen[j] = -1
        for r in range(d):
            for s in range(d):
                floored[j, r, s] = cov[j, r, s]
            floored[j, r, r] += 0.1 * floor[r, j] * (0.1 * floor[r, j])
    order = np.empty(which.size, np.int64)
    nearest_first(distance2, order)
    for q in range(which.size):
        z, j = which[order[q]], point[order[q]]
        if distance2[order[q]] <= limit and seen[j] < 0 and not taken[z]:
            seen[j], taken[z] = z, True
    return seen, floored


@njit(**ENTRY)
def claim(x: F8, weight: F8, asked: I8, which: I8, point: I8, claimed: Bool, centre: F8) -> int:
    """Centres (d, m) among points (d, L): each of ``asked`` claims what it reaches and nobody before it has claimed.

    The pairs (which, point) say which points the asked one ``which`` reaches, ordered by ``which``. A point that is claimed
    already asks no more. Written: ``claimed`` (L,), False at first, and the first m columns of ``centre``; returns m.
    """
    d, found, p = x.shape[0], 0, 0
    for a in range(asked.size):
        begin, free, mass = p, not claimed[asked[a]], 0.0
        while p < point.size and which[p] == a:
            if free and not claimed[point[p]]:
                mass += weight[point[p]]
            p += 1
        if not free or not mass > 0.0:
            continue
        for r in range(d):
            # About the asked point: sums far from the origin lose their digits.
            total = 0.0
            for q in range(begin, p):
                i = point[q]
                if not claimed[i]:
                    total += weight[i] * (x[r, i] - x[r, asked[a]])
            centre[r, found] = x[r, asked[a]] + total / mass
        for q in range(begin, p):
            claimed[point[q]] = True
        found += 1
    return found
