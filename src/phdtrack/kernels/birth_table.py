"""The table of a frame's detections, and who the neighbours of each one's newborn are."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.box_blocks import GSCALE, IX, ZX
from phdtrack.kernels.fast32 import ENTRY
from phdtrack.kernels.newborn import BX, COLUMNS, DENSITY, PEAK, SX
from phdtrack.kernels.overlaps import overlapping

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
# The state's rows that a measurement shows.
OBSERVED = (0, 1, 4, 5)


@njit(**ENTRY)
def detection_table(
    z: F8, noise: F8, rate: float, volume: F8, limit: float, lower: F8, upper: F8, local: bool
) -> tuple[F4, F4, F8, F4, F8, F8]:
    """The detections' rows that `box_blocks` and `newborn` read, the proposals' peaks left out.

    Parameters
    ----------
    z : (4, N).  noise : (6, N) deviations of the states that would give them.
    rate, volume : γ's births per frame around each detection, and the volumes (N,) that they are spread over.
    limit : squared radius of the region in which newborn are drawn.
    lower, upper : (2, N) gates.  local : whether the density of births lies around the detections, ±1 box.

    Returns
    -------
    table : (rows, N).  speed : (N,) deviation of a new velocity's amplitude, √2 that of a component.
    reach : (2, N) half the extent in which newborn are drawn.
    extents : (N, 6) left, top, right and bottom of it, width and height of the box.
    low, high : (2, N) where each matters to newborn: where its own are drawn, in its gate, where it brings births.
    """
    n = z.shape[1]
    table, extents = np.empty((COLUMNS, n), np.float32), np.empty((n, 6), np.float32)
    speed, reach, low, high = np.empty(n, np.float32), np.empty((2, n)), np.empty((2, n)), np.empty((2, n))
    for j in range(n):
        product = (2.0 * np.pi) ** 2
        for k in range(4):
            sigma = noise[OBSERVED[k], j]
            product *= sigma
            table[ZX + k, j] = z[k, j]
            table[IX + k, j] = table[BX + k, j] = 1.0 / sigma
            table[SX + k, j] = sigma
        table[GSCALE, j] = 1.0 / product
        table[DENSITY, j] = rate / volume[j]
        speed[j] = np.sqrt(2.0) * noise[2, j]
        for axis in range(2):
            half, size = np.sqrt(limit) * noise[axis, j], z[2 + axis, j]
            reach[axis, j] = half
            if local and size > half:
                half = size
            least, most = z[axis, j] - half, z[axis, j] + half
            low[axis, j] = least if least < lower[axis, j] else lower[axis, j]
            high[axis, j] = most if most > upper[axis, j] else upper[axis, j]
            extents[j, axis] = z[axis, j] - reach[axis, j]
            extents[j, 2 + axis] = z[axis, j] + reach[axis, j]
            extents[j, 4 + axis] = size
        table[PEAK, j] = 0.0
    return table, speed, reach, extents, low, high


@njit(**ENTRY)
def neighbours(
    z: F8, reach: F8, lower: F8, upper: F8, low: F8, high: F8, frame: F8, cell_start: I8, cell_item: I8, corner: I8
) -> tuple[I8, I8, I8]:
    """For each detection those that matter to its newborn; first those in whose gates the newborn can lie.

    Parameters
    ----------
    z : (4, N) detections.  reach : (2, N) half the extent in which newborn are drawn around each.
    lower, upper : (2, N) their gates.  low, high : (2, N) where each matters, see `detection_table`.
    frame, cell_start, cell_item, corner : the grid of low, high (`overlaps`).

    Returns
    -------
    start : (N + 1,), near : the neighbours of detection j are near[start[j]] … near[start[j + 1] − 1].
    touching : (N,) how many of them, at the front, are gates that the newborn can lie in.
    """
    n = z.shape[1]
    start, touching = np.empty(n + 1, np.int64), np.empty(n, np.int64)
    start[0] = 0
    near = np.empty(8 * n + 64, np.int64)
    found = np.empty(n + 1, np.int64)
    used = 0
    for j in range(n):
        left, right = z[0, j] - reach[0, j], z[0, j] + reach[0, j]
        top, bottom = z[1, j] - reach[1, j], z[1, j] + reach[1, j]
        count = overlapping(left, top, right, bottom, low, high, frame, cell_start, cell_item, corner, found)
        if used + count > near.size:
            longer = np.empty(2 * (used + count), np.int64)
            for k in range(used):
                longer[k] = near[k]
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
