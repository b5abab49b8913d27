"""Who the neighbours of a detection's newborn are: whose proposals, densities and gates reach where they are drawn."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.overlaps import overlapping, rectangle_grid

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]


@njit(cache=True, nogil=True)
def neighbours(z: F8, reach: F8, lower: F8, upper: F8, local: bool) -> tuple[I8, I8, I8]:
    """For each detection those that matter to its newborn; first those in whose gates the newborn can lie.

    Parameters
    ----------
    z : (4, N) detections.  reach : (2, N) half the extent in which newborn are drawn around each.
    lower, upper : (2, N) their gates.  local : whether the density of births lies around the detections, ±1 box.

    Returns
    -------
    start : (N + 1,), near : the neighbours of detection j are near[start[j]] … near[start[j + 1] − 1].
    touching : (N,) how many of them, at the front, are gates that the newborn can lie in.
    """
    n = z.shape[1]
    low, high = np.empty((2, n)), np.empty((2, n))
    for axis in range(2):
        for j in range(n):
            half = max(reach[axis, j], z[2 + axis, j]) if local else reach[axis, j]
            low[axis, j] = min(z[axis, j] - half, lower[axis, j])
            high[axis, j] = max(z[axis, j] + half, upper[axis, j])
    frame, cell_start, cell_item, corner = rectangle_grid(low, high)
    start, touching = np.zeros(n + 1, np.int64), np.zeros(n, np.int64)
    near = np.empty(8 * n + 64, np.int64)
    found = np.empty(n + 1, np.int64)
    used = 0
    for j in range(n):
        left, right = z[0, j] - reach[0, j], z[0, j] + reach[0, j]
        top, bottom = z[1, j] - reach[1, j], z[1, j] + reach[1, j]
        count = overlapping(left, top, right, bottom, low, high, frame, cell_start, cell_item, corner, found)
        if used + count > near.size:
            longer = np.empty(2 * (used + count), np.int64)
            longer[:used] = near[:used]
            near = longer
        inside = used
        for m in range(count):
            k = found[m]
            if lower[0, k] <= right and upper[0, k] >= left and lower[1, k] <= bottom and upper[1, k] >= top:
                near[inside] = k
                inside += 1
        touching[j] = inside - used
        for m in range(count):
            k = found[m]
            if not (lower[0, k] <= right and upper[0, k] >= left and lower[1, k] <= bottom and upper[1, k] >= top):
                near[inside] = k
                inside += 1
        used += count
        start[j + 1] = used
    return start, near[:used], touching
