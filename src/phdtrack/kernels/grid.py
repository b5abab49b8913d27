"""The one spatial grid: which rectangles or points of the position plane overlap a query rectangle.

Rectangles are sorted into the cells of a regular grid by counting; a point is a rectangle whose
corners are equal. A query visits the cells that it touches and returns exactly the rectangles that
overlap it: the grid only saves comparisons.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from phdtrack.kernels import F8, I8, Bool
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.small_arrays import copy_into, flags, zeros


class Grid(NamedTuple):
    """N closed rectangles, sorted into cells.

    lower, upper : (2, N) corners.
    x0, y0 : the grid's lowest corner.
    per_x, per_y : cells per unit length.
    columns, rows : numbers of cells along x and y.
    start, item : the rectangles in cell c = row · columns + column are item[start[c]] …
        item[start[c + 1] − 1], ascending.
    corner : (2, N) the first column and row of each rectangle.
    """

    lower: F8
    upper: F8
    x0: float
    y0: float
    per_x: float
    per_y: float
    columns: int
    rows: int
    start: I8
    item: I8
    corner: I8


@njit(**INNER)
def cell_of(value: float, origin: float, per_cell: float, count: int) -> int:
    """Index of the cell that holds ``value``, clamped to the grid; ``per_cell`` is one over the
    cell's size.
    """
    if not (value > origin and per_cell > 0.0):  # also NaN
        return 0
    position = (value - origin) * per_cell
    if position >= count - 1:
        return count - 1
    return int(position)


@njit(**INNER)
def sorted_by_cell(cell: I8, count: int) -> tuple[I8, I8]:
    """(count + 1,) where the items of each cell begin, and (n,) the items by their ``cell`` (n,),
    ascending in each (counting sort).
    """
    begin = zeros(count + 1)
    order = np.empty(cell.size, np.int64)
    for i in range(cell.size):
        begin[cell[i]] += 1
    for c in range(count):
        begin[c + 1] += begin[c]
    # From the last item back: the end of a cell becomes its beginning.
    for back in range(cell.size):
        i = cell.size - 1 - back
        begin[cell[i]] -= 1
        order[begin[cell[i]]] = i
    return begin, order


@njit(**INNER)
def sorted_along(values: F8) -> tuple[I8, I8, float, float]:
    """Sort finite values (n,) into cells of equal size, about one in each.

    Where each cell begins (cells + 1,); (n,) the values by cell, ascending by number in each; low
    and scale: a value lies in cell (value − low)·scale.
    """
    low = np.inf
    high = -np.inf
    for j in range(values.size):
        low = min(low, values[j])
        high = max(high, values[j])
    count = max(values.size, 1)
    scale = 0.0
    if values.size == 0:
        low = 0.0
    if high > low:
        scale = count / (high - low)
    cell = np.empty(values.size, np.int64)
    for j in range(values.size):
        cell[j] = cell_of(values[j], low, scale, count)
    begin, order = sorted_by_cell(cell, count)
    return begin, order, low, scale


@njit(**INNER)
def within(value: float, reach: float, cells: tuple[I8, I8, float, float]) -> tuple[int, int]:
    """The first and one past the last place in the order of `sorted_along` of the values that may
    be within ``reach`` of a value.
    """
    begin, _, low, scale = cells
    first = cell_of(value - reach, low, scale, begin.size - 1)
    last = cell_of(value + reach, low, scale, begin.size - 1)
    return begin[first], begin[last + 1]


@njit(**INNER)
def _axis(lower: F8, upper: F8, axis: int, size: float) -> tuple[float, float, float]:
    """Origin, extent and cell size along an axis: the rectangles' mean extent, at least ``size``
    and a thousandth of the whole extent.
    """
    n = lower.shape[1]
    low = np.inf
    high = -np.inf
    total = 0.0
    for j in range(n):
        low = min(low, lower[axis, j])
        high = max(high, upper[axis, j])
        total += upper[axis, j] - lower[axis, j]
    if n == 0:
        return 0.0, 0.0, 1.0
    size = max(size, total / n, (high - low) * 1e-3, 1e-9)
    return low, high - low, size


@njit(**ENTRY)
def make_grid(lower: F8, upper: F8, width: float = 0.0, height: float = 0.0) -> Grid:
    """A grid over N closed rectangles, with finite corners (2, N); the same array twice for points.

    It has at most 4 N + 16 cells, as large as the average rectangle if these are few enough, and no
    smaller than ``width`` and ``height``.
    """
    n = lower.shape[1]
    across = 0 * n
    x0, wide, width = _axis(lower, upper, across, width)
    y0, high, height = _axis(lower, upper, across + 1, height)
    nx = 1.0 + np.floor(wide / width)
    ny = 1.0 + np.floor(high / height)
    per_x = 1.0 / width
    per_y = 1.0 / height
    if nx * ny > 4 * n + 16:
        shrink = np.sqrt((4 * n + 16) / (nx * ny))
        fewer_x = max(1.0, np.floor(nx * shrink))
        fewer_y = max(1.0, np.floor(ny * shrink))
        per_x = per_x * fewer_x / nx
        per_y = per_y * fewer_y / ny
        nx = fewer_x
        ny = fewer_y
    columns = int(nx)
    rows = int(ny)
    start = zeros(columns * rows + 1)
    corner = np.empty((2, n), np.int64)
    last = np.empty((2, n), np.int64)
    for j in range(n):
        corner[0, j] = cell_of(lower[0, j], x0, per_x, columns)
        last[0, j] = cell_of(upper[0, j], x0, per_x, columns)
        corner[1, j] = cell_of(lower[1, j], y0, per_y, rows)
        last[1, j] = cell_of(upper[1, j], y0, per_y, rows)
        for row in range(corner[1, j], last[1, j] + 1):
            for column in range(corner[0, j], last[0, j] + 1):
                start[row * columns + column + 1] += 1
    for c in range(columns * rows):
        start[c + 1] += start[c]
    place = start.copy()
    item = np.empty(start[columns * rows], np.int64)
    for j in range(n):
        for row in range(corner[1, j], last[1, j] + 1):
            for column in range(corner[0, j], last[0, j] + 1):
                item[place[row * columns + column]] = j
                place[row * columns + column] += 1
    return Grid(lower, upper, x0, y0, per_x, per_y, columns, rows, start, item, corner)


@njit(**INNER)
def overlapping(left: float, top: float, right: float, bottom: float, grid: Grid, out: I8) -> int:
    """Write the rectangles that the closed box overlaps into ``out`` (N,), each once, by cells;
    returns how many there are.
    """
    lower = grid.lower
    upper = grid.upper
    corner = grid.corner
    count = 0
    x0 = cell_of(left, grid.x0, grid.per_x, grid.columns)
    x1 = cell_of(right, grid.x0, grid.per_x, grid.columns)
    y0 = cell_of(top, grid.y0, grid.per_y, grid.rows)
    y1 = cell_of(bottom, grid.y0, grid.per_y, grid.rows)
    for row in range(y0, y1 + 1):
        for column in range(x0, x1 + 1):
            cell = row * grid.columns + column
            for k in range(grid.start[cell], grid.start[cell + 1]):
                j = grid.item[k]
                # A rectangle in several cells counts in the first that it shares with the box.
                if column != max(x0, corner[0, j]) or row != max(y0, corner[1, j]):
                    continue
                if (
                    lower[0, j] <= right
                    and upper[0, j] >= left
                    and lower[1, j] <= bottom
                    and upper[1, j] >= top
                ):
                    out[count] = j
                    count += 1
    return count


@njit(**ENTRY)
def overlapping_pairs(low: F8, high: F8, grid: Grid) -> tuple[I8, I8]:
    """Pairs (i, j) (P,) of rectangles i, with corners ``low`` and ``high`` (2, M), and j of the
    grid that overlap.

    They are ordered by i, then by cell.
    """
    m = low.shape[1]
    count = 0
    near = np.empty(grid.lower.shape[1], np.int64)
    first = np.empty(4 * m + 16, np.int64)
    second = np.empty(4 * m + 16, np.int64)
    for i in range(m):
        some = overlapping(low[0, i], low[1, i], high[0, i], high[1, i], grid, near)
        if count + some > first.size:
            longer_first = np.empty(2 * (count + some), np.int64)
            longer_second = np.empty(2 * (count + some), np.int64)
            copy_into(first[:count], longer_first)
            copy_into(second[:count], longer_second)
            first = longer_first
            second = longer_second
        first[count : count + some] = i
        copy_into(near[:some], second[count:])
        count += some
    return first[:count].copy(), second[:count].copy()


@njit(**ENTRY)
def points_in_rectangles(at: F8, lower: F8, upper: F8) -> tuple[I8, I8]:
    """Pairs (P,) of points (2, L) and closed rectangles (2, N) that contain them, by rectangle;
    ValueError if one is not finite.
    """
    # Cells made of infinities would lie outside the grid.
    if not np.isfinite(at.sum() + lower.sum() + upper.sum()):
        raise ValueError("positions and rectangles must be finite")
    rectangle, point = overlapping_pairs(lower, upper, make_grid(at, at, 0.0, 0.0))
    return point, rectangle


@njit(**ENTRY)
def may_be_crowded(at: F8, half: F8, most: int) -> bool:
    """False if `uncrowded` keeps all points, because no box holds more than ``most``, its own
    included; for the same arguments, which may be NaN or infinite here: such points are in no box.
    """
    x = np.empty(at.shape[1])
    n = 0 * at.shape[1]
    place = np.empty(at.shape[1], np.int64)
    for i in range(at.shape[1]):
        if np.isfinite(at[0, i] + at[1, i] + half[0, i] + half[1, i]):
            x[n] = at[0, i]
            place[n] = i
            n += 1
    cells = sorted_along(x[:n])
    for k in range(n):
        i = place[k]
        begin, end = within(x[k], half[0, i], cells)
        if end - begin <= most:
            continue
        near = 0
        for q in range(begin, end):
            j = place[cells[1][q]]
            near += (
                abs(at[0, j] - at[0, i]) <= half[0, i] and abs(at[1, j] - at[1, i]) <= half[1, i]
            )
        if near > most:
            return True
    return False


@njit(**ENTRY)
def uncrowded(at: F8, half: F8, most: int) -> Bool:
    """(N,) true for the points that are kept, in their order: a point is dropped if it and ``most``
    kept ones lie in each other's boxes.

    ``at``, ``half`` (2, N): the points, and half the sides of a closed box about each, finite.
    ``most``: at least 1.
    """
    lower = np.empty(at.shape)
    upper = np.empty(at.shape)
    for a in range(at.shape[0]):
        for i in range(at.shape[1]):
            lower[a, i] = at[a, i] - half[a, i]
            upper[a, i] = at[a, i] + half[a, i]
    grid = make_grid(lower, upper, 0.0, 0.0)
    kept: Bool = flags(at.shape[1], True)
    for i in range(at.shape[1]):
        row = cell_of(at[1, i], grid.y0, grid.per_y, grid.rows)
        column = cell_of(at[0, i], grid.x0, grid.per_x, grid.columns)
        cell = row * grid.columns + column
        near = 0
        for k in range(grid.start[cell], grid.start[cell + 1]):
            j = grid.item[k]
            if j >= i or near == most:
                break
            x = abs(at[0, j] - at[0, i])
            y = abs(at[1, j] - at[1, i])
            mutual = x <= half[0, i] and x <= half[0, j] and y <= half[1, i] and y <= half[1, j]
            near += kept[j] and mutual
        kept[i] = near < most
    return kept
