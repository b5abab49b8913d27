"""Which of many rectangles a box overlaps: a grid whose cells list the rectangles that reach into them.

The counterpart of `gating` (points in rectangles) for blocks of particles: one question per block instead of one per point.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
F4 = NDArray[np.float32]


@njit(**INNER)
def cell_of(value: float, origin: float, per_cell: float, count: int) -> int:
    """Index of the cell that holds ``value``, clamped to the grid; ``per_cell`` is one over the cell's size."""
    position = (value - origin) * per_cell
    if not position > 0.0:  # also NaN
        return 0
    if position >= count - 1:
        return count - 1
    return int(position)


@njit(**ENTRY)
def rectangle_grid(lower: F8, upper: F8) -> tuple[F8, I8, I8, I8]:
    """A grid over the rectangles ``lower``, ``upper`` (2, N), its cells about as large as they are.

    Returns
    -------
    frame : (6,) origin x and y, cells per pixel in x and y, number of cells in x and y.
    start, item : the rectangles of cell c (row by row) are item[start[c]] … item[start[c + 1] − 1].
    corner : (2, N) the first cell of each rectangle in x and y.
    """
    n = lower.shape[1]
    frame, corner, last = np.empty(6), np.empty((2, n), np.int64), np.empty((2, n), np.int64)
    cells = 1.0
    # As many axes as there are and not 2: the compiler would write the loops out.
    for axis in range(lower.shape[0]):
        low, high, total = np.inf, -np.inf, 0.0
        for j in range(n):
            low = lower[axis, j] if lower[axis, j] < low else low
            high = upper[axis, j] if upper[axis, j] > high else high
            total += upper[axis, j] - lower[axis, j]
        if n == 0:
            low, high = 0.0, 0.0
        size, least = total / (n if n else 1), (high - low) * 1e-3
        size = size if size > least else least
        size = size if size > 1e-9 else 1e-9
        frame[axis], frame[2 + axis] = low, 1.0 / size
        frame[4 + axis] = 1.0 + np.floor((high - low) / size)
        cells *= frame[4 + axis]
    if cells > 4 * n + 16:
        shrink = np.sqrt((4 * n + 16) / cells)
        for axis in range(2):
            count = np.floor(frame[4 + axis] * shrink)
            count = count if count > 1.0 else 1.0
            frame[2 + axis] *= count / frame[4 + axis]
            frame[4 + axis] = count
    nx, ny = int(frame[4]), int(frame[5])
    start = np.empty(nx * ny + 1, np.int64)
    for c in range(nx * ny + 1):
        start[c] = 0
    for j in range(n):
        for axis in range(2):
            count = nx if axis == 0 else ny
            corner[axis, j] = cell_of(lower[axis, j], frame[axis], frame[2 + axis], count)
            last[axis, j] = cell_of(upper[axis, j], frame[axis], frame[2 + axis], count)
        for row in range(corner[1, j], last[1, j] + 1):
            for column in range(corner[0, j], last[0, j] + 1):
                start[row * nx + column + 1] += 1
    for c in range(nx * ny):
        start[c + 1] += start[c]
    place, item = np.empty(nx * ny, np.int64), np.empty(start[nx * ny], np.int64)
    for c in range(nx * ny):
        place[c] = start[c]
    for j in range(n):
        for row in range(corner[1, j], last[1, j] + 1):
            for column in range(corner[0, j], last[0, j] + 1):
                item[place[row * nx + column]] = j
                place[row * nx + column] += 1
    return frame, start, item, corner


@njit(**INNER)
def overlapping(
    left: float,
    top: float,
    right: float,
    bottom: float,
    lower: F8,
    upper: F8,
    frame: F8,
    start: I8,
    item: I8,
    corner: I8,
    found: I8,
) -> int:
    """Write into ``found`` (N,) the rectangles that the closed box overlaps, each once; returns how many."""
    nx, ny = int(frame[4]), int(frame[5])
    x0, x1 = cell_of(left, frame[0], frame[2], nx), cell_of(right, frame[0], frame[2], nx)
    y0, y1 = cell_of(top, frame[1], frame[3], ny), cell_of(bottom, frame[1], frame[3], ny)
    count = 0
    for row in range(y0, y1 + 1):
        for column in range(x0, x1 + 1):
            for k in range(start[row * nx + column], start[row * nx + column + 1]):
                j = item[k]
                # A rectangle in several cells counts in the first that it shares with the box.
                first_x, first_y = corner[0, j] if corner[0, j] > x0 else x0, corner[1, j] if corner[1, j] > y0 else y0
                if column != first_x or row != first_y:
                    continue
                if lower[0, j] <= right and upper[0, j] >= left and lower[1, j] <= bottom and upper[1, j] >= top:
                    found[count] = j
                    count += 1
    return count
