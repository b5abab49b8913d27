"""Which points lie in which rectangles, in time linear in the points and the answers.

The points (particles) are sorted into the cells of a grid by counting; each rectangle (the gate of a detection, the
reach of a cluster) then looks at the cells that it overlaps. What is returned is exact: the grid only saves looking.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]


@njit(cache=True)
def _cell(value: float, origin: float, size: float, count: int) -> int:
    """Index of the cell that holds ``value``, clamped to the grid."""
    position = (value - origin) / size
    if not position > 0.0:  # also NaN
        return 0
    if position >= count - 1:
        return count - 1
    return int(position)


@njit(cache=True)
def _grid(px: F8, py: F8, lower: F8, upper: F8) -> tuple[float, float, float, float, int, int]:
    """Origin, cell size and number of cells: about one mean gate per cell, never many more cells than points."""
    x0, x1 = px.min(), px.max()
    y0, y1 = py.min(), py.max()
    n = lower.shape[1]
    width = max((upper[0] - lower[0]).sum() / n, 1e-9 + (x1 - x0) * 1e-6)
    height = max((upper[1] - lower[1]).sum() / n, 1e-9 + (y1 - y0) * 1e-6)
    nx = 1 + int((x1 - x0) / width)
    ny = 1 + int((y1 - y0) / height)
    most = max(64, px.size)
    if nx * ny > most:
        shrink = np.sqrt(most / (nx * ny))
        nx, ny = max(1, int(nx * shrink)), max(1, int(ny * shrink))
        width, height = (x1 - x0) / nx + 1e-12, (y1 - y0) / ny + 1e-12
    return x0, y0, width, height, nx, ny


@njit(cache=True)
def _sort_into_cells(px: F8, py: F8, x0: float, y0: float, width: float, height: float, nx: int, ny: int) -> tuple[I8, I8]:
    """Counting sort: where each cell's points start (cells + 1,), and the points in cell order, stable."""
    cell = np.empty(px.size, np.int64)
    start = np.zeros(nx * ny + 1, np.int64)
    for i in range(px.size):
        c = _cell(py[i], y0, height, ny) * nx + _cell(px[i], x0, width, nx)
        cell[i] = c
        start[c + 1] += 1
    for c in range(nx * ny):
        start[c + 1] += start[c]
    place = start[:-1].copy()
    order = np.empty(px.size, np.int64)
    for i in range(px.size):
        order[place[cell[i]]] = i
        place[cell[i]] += 1
    return start, order


@njit(cache=True)
def gated_pairs(px: F8, py: F8, lower: F8, upper: F8) -> tuple[I8, I8]:
    """All pairs (point, rectangle) with the point inside the closed rectangle, ordered by rectangle.

    Parameters
    ----------
    px, py : (L,) positions of the points.
    lower, upper : (2, N) corners of the rectangles.

    Returns
    -------
    point, rectangle : (P,) indices of the pairs.

    Raises
    ------
    ValueError : a position or a rectangle is NaN or infinite.
    """
    n = lower.shape[1]
    if px.size == 0 or n == 0:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    # Indices made of NaN would be written through.
    if not np.isfinite(px.sum() + py.sum() + lower.sum() + upper.sum()):
        raise ValueError("positions and rectangles must be finite")
    x0, y0, width, height, nx, ny = _grid(px, py, lower, upper)
    start, order = _sort_into_cells(px, py, x0, y0, width, height, nx, ny)
    capacity = px.size + 16
    point, rectangle = np.empty(capacity, np.int64), np.empty(capacity, np.int64)
    found = 0
    for j in range(n):
        left, top, right, bottom = lower[0, j], lower[1, j], upper[0, j], upper[1, j]
        first, last = _cell(left, x0, width, nx), _cell(right, x0, width, nx)
        for row in range(_cell(top, y0, height, ny), _cell(bottom, y0, height, ny) + 1):
            # The cells of one grid row are neighbours in memory: one stretch of points covers them all.
            for k in range(start[row * nx + first], start[row * nx + last + 1]):
                i = order[k]
                if left <= px[i] <= right and top <= py[i] <= bottom:
                    if found == capacity:
                        capacity *= 2
                        more_points, more_rectangles = np.empty(capacity, np.int64), np.empty(capacity, np.int64)
                        more_points[:found], more_rectangles[:found] = point, rectangle
                        point, rectangle = more_points, more_rectangles
                    point[found], rectangle[found] = i, j
                    found += 1
    return point[:found].copy(), rectangle[:found].copy()
