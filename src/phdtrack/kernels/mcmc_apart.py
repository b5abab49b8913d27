"""The pairwise potential that keeps targets apart [K05]: ψ(x, y) = exp(−strength · penalty(x, y)).

Where targets are boxes, the penalty is their overlap (intersection over union); where they are points, exp(−|x − y|²/2) with
positions in units of its range. Both lie between 0 and 1.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, INNER

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]


@njit(**INNER)
def penalty(place: F8, a: int, b: int, boxes: bool) -> float:
    """Of rows a and b of ``place`` (L, 4): corners of boxes, or scaled positions in the first two columns."""
    if not boxes:
        dx, dy = place[a, 0] - place[b, 0], place[a, 1] - place[b, 1]
        near: float = np.exp(-0.5 * (dx * dx + dy * dy))
        return near
    wide = min(place[a, 2], place[b, 2]) - max(place[a, 0], place[b, 0])
    tall = min(place[a, 3], place[b, 3]) - max(place[a, 1], place[b, 1])
    if wide <= 0.0 or tall <= 0.0:
        return 0.0
    shared = wide * tall
    own = (place[a, 2] - place[a, 0]) * (place[a, 3] - place[a, 1])
    other = (place[b, 2] - place[b, 0]) * (place[b, 3] - place[b, 1])
    overlap: float = shared / (own + other - shared)
    return overlap


@njit(**INNER)
def crowding(place: F8, row: int, others: I8, skip: int, besides: int, boxes: bool) -> float:
    """Sum of the penalties of ``row`` with the rows ``others``, −1 for none, of which two places are passed over."""
    total = 0.0
    for k in range(others.size):
        if others[k] >= 0 and k != skip and k != besides:
            total += penalty(place, row, others[k], boxes)
    return total


@njit(**ENTRY)
def total_penalty(place: F8, boxes: bool) -> float:
    """Sum of the penalties of all pairs of rows."""
    total = 0.0
    for a in range(place.shape[0]):
        for b in range(a):
            total += penalty(place, a, b, boxes)
    return total
