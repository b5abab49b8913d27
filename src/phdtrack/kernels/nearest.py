"""To which centres the particles of a block are nearest: by its box where that decides, by each particle where not.

Tables, one row each, so that what is known of one block or cluster lies together in memory:

* ``known`` (B, 1 + 4d) of `blocks.summarise`: mass, then the box's low and high corner, a point in the middle, Σw·x.
* ``table`` (room, 4 + 5d) of clusters: mass, the position where the centre was filed (2), the distance² of its farthest
  particle, then centre, scale, mean, Σw·x, one over the scale.
* ``flags`` (room, 7) of clusters: see the names below.
* ``link`` (2, E), ``head`` (B,): lists of the centres near each block: entry e stands for centre link[0, e] and is followed
  by entry link[1, e]; block b's list begins with head[b], and ends with −1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.blocks import Real, U
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import VECTOR
from phdtrack.kernels.overlaps import overlapping

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
I4 = NDArray[np.int32]
MIXED, NOBODY = -2, -1
# A centre is filed with every block in this many times its reach, so that it may move that much before it is filed again.
ROOM = 1.5
# Columns of ``table``, and those of ``flags``: particles; whether the centre has moved; whether the cluster has particles;
# from which it was divided; how often a stray was parted from it; its farthest particle; how often the centre has moved.
MASS, X, Y, APART, CENTRE = 0, 1, 2, 3, 4
COUNT, MOVED, ALIVE, PARENT, STRAYS, FARTHEST, STEPS = 0, 1, 2, 3, 4, 5, 6


@njit(**VECTOR)
def least_excess(d: int, table: F8, a: int, b: int, known: F8, block: int) -> float:
    """The least of |x − c_b|² − |x − c_a|², each in its own deviations, over a block's box: above 0 nothing is nearer to b.

    A sum over components of parabolas, each of which is least at an end of its side or at its vertex.
    """
    total = 0.0
    for r in range(d):
        sa, sb = table[a, CENTRE + 4 * d + r], table[b, CENTRE + 4 * d + r]
        pa, pb = sa * sa, sb * sb
        ca, cb = table[a, CENTRE + r], table[b, CENTRE + r]
        left, right = known[block, 1 + r], known[block, 1 + d + r]
        least = pb * (left - cb) * (left - cb) - pa * (left - ca) * (left - ca)
        at_right = pb * (right - cb) * (right - cb) - pa * (right - ca) * (right - ca)
        least = at_right if at_right < least else least
        if pb > pa:
            vertex = (pb * cb - pa * ca) / (pb - pa)
            if left < vertex < right:
                at_vertex = pb * (vertex - cb) * (vertex - cb) - pa * (vertex - ca) * (vertex - ca)
                least = at_vertex if at_vertex < least else least
        total += least
    return total


@njit(**VECTOR)
def reached(
    x: float, y: float, rx: float, ry: float, lower: F8, upper: F8, frame: F8, cells: I8, item: I8, corner: I8, found: I8
) -> int:  # fmt: skip
    """Write the blocks near a centre at (x, y) that reaches this far into ``found`` (B,), with room to move; how many."""
    wide, high = ROOM * rx, ROOM * ry
    some: int = overlapping(x - wide, y - high, x + wide, y + high, lower, upper, frame, cells, item, corner, found)
    return some


@njit(**VECTOR)
def file_centre(j: int, count: int, found: I8, head: I8, link: I8, used: int) -> tuple[I8, int]:
    """Put centre j on the lists of the first ``count`` blocks in ``found``.

    Gives the lists, which may have grown, and how much of them is used.
    """
    if used + count > link.shape[1]:
        longer = np.empty((2, 2 * (used + count)), np.int64)
        for e in range(used):
            longer[0, e], longer[1, e] = link[0, e], link[1, e]
        link = longer
    for p in range(count):
        link[0, used], link[1, used] = j, head[found[p]]
        head[found[p]] = used
        used += 1
    return link, used


@njit(**VECTOR)
def contenders(
    d: int, table: F8, flags: I8, reach: float, known: F8, b: int, e: int, link: I8, near: I8
) -> tuple[int, bool, int]:
    """Write into ``near`` the living centres that may own a particle of block b, whose list begins with e, ascending.

    How many; whether the first owns all of it; and the one nearest to the middle of the block (−1: none).
    """
    left, top, right, bottom = known[b, 1], known[b, 2], known[b, 1 + d], known[b, 2 + d]
    count = 0
    while e >= 0:
        j = link[0, e]
        e = link[1, e]
        x, y, rx, ry = table[j, CENTRE], table[j, CENTRE + 1], reach * table[j, CENTRE + d], reach * table[j, CENTRE + d + 1]
        if flags[j, ALIVE] == 0 or left > x + rx or right < x - rx or top > y + ry or bottom < y - ry:
            continue
        at = count
        while at > 0 and near[at - 1] > j:
            at -= 1
        # A centre that has been filed again stands in the list twice.
        if at > 0 and near[at - 1] == j:
            continue
        for q in range(count, at, -1):
            near[q] = near[q - 1]
        near[at] = j
        count += 1
    # An integer, not a literal: `least_excess` would be compiled for both.
    best, first = np.inf, int(NOBODY)
    if count == 1:
        first = near[0]
    for c in range(count if count > 1 else 0):
        j, distance2 = near[c], 0.0
        for r in range(d):
            step = (known[b, 1 + 2 * d + r] - table[j, CENTRE + r]) * table[j, CENTRE + 4 * d + r]
            distance2 += step * step
        if distance2 < best or first < 0:
            best, first = distance2, j
    if first < 0:
        return 0, False, first
    x, y = table[first, CENTRE], table[first, CENTRE + 1]
    rx, ry = reach * table[first, CENTRE + d], reach * table[first, CENTRE + d + 1]
    if left < x - rx or right > x + rx or top < y - ry or bottom > y + ry:
        return count, False, first
    kept = 0
    for c in range(count):
        j = near[c]
        if j == first or not least_excess(d, table, first, j, known, b) > 0.0:
            near[kept] = j
            kept += 1
    return kept, kept == 1, first


@njit(**VECTOR)
def squares(scratch: Real, n: int, d: int, table: F8, j: int, known: F8, b: int) -> None:
    """Write into the row of ``scratch`` behind an even number of them the scaled distance² of n particles from centre j.

    The d rows before are x − origin; where d is odd, one of zeros follows them.
    """
    real, out = scratch.dtype.type, d + d % 2
    for r in range(0, d, 2):
        # Two components at a time: what is summed is read and written half as often.
        s = r + 1 if r + 1 < d else r
        x, y = real(table[j, CENTRE + r] - known[b, 1 + 2 * d + r]), real(table[j, CENTRE + s] - known[b, 1 + 2 * d + s])
        per_x, per_y = real(table[j, CENTRE + 4 * d + r]), real(table[j, CENTRE + 4 * d + s] if s > r else 0.0)
        if r == 0:
            for i in range(U(n)):
                p, q = (scratch[r, i] - x) * per_x, (scratch[r + 1, i] - y) * per_y
                scratch[out, i] = p * p + q * q
        else:
            for i in range(U(n)):
                p, q = (scratch[r, i] - x) * per_x, (scratch[r + 1, i] - y) * per_y
                scratch[out, i] += p * p + q * q


@njit(**VECTOR)
def nearest_in_block(
    scratch: Real, n: int, d: int, table: F8, reach: float, known: F8, b: int, near: I8, count: int, which: I4
) -> None:
    """For each of n particles the nearest of the centres ``near`` that reach it (−1: none); the lower index wins a tie."""
    real = scratch.dtype.type
    distance2, best, beyond = d + d % 2, d + d % 2 + 1, real(np.inf)
    for i in range(U(n)):
        scratch[best, i] = beyond
        which[i] = np.int32(NOBODY)
    for c in range(count):
        j = near[c]
        squares(scratch, n, d, table, j, known, b)
        x, y, rx, ry = table[j, CENTRE], table[j, CENTRE + 1], reach * table[j, CENTRE + d], reach * table[j, CENTRE + d + 1]
        inside = known[b, 1] >= x - rx and known[b, 1 + d] <= x + rx
        if not (inside and known[b, 2] >= y - ry and known[b, 2 + d] <= y + ry):
            at_x, at_y = real(x - known[b, 1 + 2 * d]), real(y - known[b, 2 + 2 * d])
            to_rx, to_ry = real(rx), real(ry)
            for i in range(U(n)):
                # Read before it is asked for: a reading that depends on a condition becomes a branch.
                now, far_x, far_y = scratch[distance2, i], abs(scratch[0, i] - at_x), abs(scratch[1, i] - at_y)
                scratch[distance2, i] = now if (far_x <= to_rx) & (far_y <= to_ry) else beyond
        name = np.int32(j)
        for i in range(U(n)):
            now, held, before = scratch[distance2, i], scratch[best, i], which[i]
            closer = now < held
            scratch[best, i] = now if closer else held
            which[i] = name if closer else before
