"""Which rectangles meet, and who claims which points: what is done with the clusters found."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY
from phdtrack.kernels.overlaps import overlapping

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
Bool = NDArray[np.bool_]


@njit(**ENTRY)
def meeting(
    low: F8, high: F8, lower: F8, upper: F8, frame: F8, cells: I8, item: I8, corner: I8, found: I8, pairs: I8
) -> int:
    """Write into ``pairs`` (2, P) the pairs (i, j) of closed rectangles that overlap, ordered by i; how many there are.

    Those with corners ``low`` and ``high`` (2, M) against those with ``lower`` and ``upper`` (2, N), of which the rest is
    the grid (`overlaps.rectangle_grid`); ``found`` (N,) is working memory. What has no room is counted but not written.
    """
    count = 0
    for i in range(low.shape[1]):
        some = overlapping(low[0, i], low[1, i], high[0, i], high[1, i], lower, upper, frame, cells, item, corner, found)
        for c in range(some if count + some <= pairs.shape[1] else 0):
            pairs[0, count + c], pairs[1, count + c] = i, found[c]
        count += some
    return count


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
