"""What the box sensor says of a few states, without the cost of many small array operations."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, INNER

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
ROOT_2, LEAST_SPEED = math.sqrt(2.0), 1e-6


@njit(**ENTRY)
def box_noise(x: F8, size_row: int, spread: float, floor: float, speed: float) -> F8:
    """(d, n) deviations of box states whose noise follows the size in rows ``size_row`` and the next.

    σ_w = max(s·w, floor), σ_h likewise, half of them in position; a velocity's amplitude deviates by ``speed``·√(wh).
    """
    d, n = x.shape
    out = np.empty((d, n))
    for i in range(n):
        sw, sh = spread * x[size_row, i], spread * x[size_row + 1, i]
        sw, sh = floor if sw < floor else sw, floor if sh < floor else sh
        velocity = speed * np.sqrt(x[4, i] * x[5, i]) / ROOT_2
        velocity = LEAST_SPEED if velocity < LEAST_SPEED else velocity
        out[0, i], out[1, i], out[2, i], out[3, i] = 0.5 * sw, 0.5 * sh, velocity, velocity
        for r in range(4, d, 2):
            out[r, i], out[r + 1, i] = sw, sh
    return out


@njit(**ENTRY)
def box_gate(z: F8, factor: float, least: float) -> tuple[F8, F8]:
    """Corners (2, n) of the rectangles that reach ``factor`` sizes, but at least ``least``, from the centre of z."""
    n = z.shape[1]
    lower, upper = np.empty((2, n)), np.empty((2, n))
    for r in range(lower.shape[0]):
        for i in range(n):
            half = factor * z[2 + r, i]
            half = least if half < least else half
            lower[r, i], upper[r, i] = z[r, i] - half, z[r, i] + half
    return lower, upper


@njit(**ENTRY)
def box_corners(x: F8) -> F8:
    """(n, 4) left, top, right, bottom of box states (d, n)."""
    out = np.empty((x.shape[1], 4))
    for i in range(x.shape[1]):
        for r in range(2):
            out[i, r], out[i, 2 + r] = x[r, i] - 0.5 * x[4 + r, i], x[r, i] + 0.5 * x[4 + r, i]
    return out


@njit(**ENTRY)
def apart(boxes: F8, order: I8, overlap: float) -> I8:
    """(k,) which of the boxes (n, 4) are left if each goes that overlaps one left before it by more than ``overlap`` (IoU).

    ``order`` (n,): their numbers by left sides, rising. Who is compared begins left of a box's end, and somebody from there
    on reaches it.
    """
    n = order.size
    place, reach, left = np.empty(n, np.int64), np.empty(n), np.empty(n, np.int64)
    farthest, k = -np.inf, 0 * n
    for p in range(n):
        right = boxes[order[p], 2]
        farthest = right if right > farthest else farthest
        place[order[p]], reach[p] = p, farthest
    for j in range(n):
        p = place[j]
        while p > 0 and reach[p - 1] > boxes[j, 0]:
            p -= 1
        while p < n and boxes[order[p], 0] < boxes[j, 2]:
            i = order[p]
            if i < j and place[i] >= 0 and overlap_of(boxes, i, j) > overlap:
                place[j] = -1
                break
            p += 1
        if place[j] >= 0:
            left[k] = j
            k += 1
    return left[:k].copy()


@njit(**INNER)
def overlap_of(boxes: F8, i: int, j: int) -> float:
    """IoU of two of the boxes (n, 4); 0 of such as have no area."""
    wide = min(boxes[i, 2], boxes[j, 2]) - max(boxes[i, 0], boxes[j, 0])
    high = min(boxes[i, 3], boxes[j, 3]) - max(boxes[i, 1], boxes[j, 1])
    if not (wide > 0.0 and high > 0.0):
        return 0.0
    union = (boxes[i, 2] - boxes[i, 0]) * (boxes[i, 3] - boxes[i, 1])
    union += (boxes[j, 2] - boxes[j, 0]) * (boxes[j, 3] - boxes[j, 1])
    share: float = wide * high / (union - wide * high)
    return share
