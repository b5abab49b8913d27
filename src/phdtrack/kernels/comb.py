"""From the masses of blocks to their offspring: who gets how many teeth of the resampling comb, and in which order.

Masses are summed in fixed point, so that the order of the sum cannot matter, and a block's stretch of the comb is known
without looking at the others' particles. Blocks are put in the order of a grid's cells, so that neighbours stay neighbours.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.box_blocks import BLOCK
from phdtrack.kernels.fast32 import ENTRY
from phdtrack.kernels.overlaps import cell_of

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
FIXED = 2.0**32
# An extent that is no extent, and the most cells along an axis.
SMALL, MOST = 1e-9, 2048.0
NOTHING = np.float32(0.0)


@njit(**ENTRY)
def by_cells(extents: F4) -> I8:
    """(S,) the sources in the order of the cells that their centres lie in; cells are as large as boxes are on average."""
    n = extents.shape[0]
    x, y = np.empty(n), np.empty(n)
    width, height = 0.0, 0.0
    for i in range(n):
        x[i], y[i] = 0.5 * (extents[i, 0] + extents[i, 2]), 0.5 * (extents[i, 1] + extents[i, 3])
        width += extents[i, 4]
        height += extents[i, 5]
    x0, y0, x1, y1 = np.inf, np.inf, -np.inf, -np.inf
    for i in range(n):
        x0, x1 = x[i] if x[i] < x0 else x0, x[i] if x[i] > x1 else x1
        y0, y1 = y[i] if y[i] < y0 else y0, y[i] if y[i] > y1 else y1
    wide, high = x1 - x0 if n else 0.0, y1 - y0 if n else 0.0
    columns, rows = wide * n / (width if width > SMALL else SMALL), high * n / (height if height > SMALL else SMALL)
    nx, ny = int(columns if columns < MOST else MOST) + 1, int(rows if rows < MOST else MOST) + 1
    if nx * ny > 4 * n + 16:
        shrink = np.sqrt((4 * n + 16) / (nx * ny))
        nx, ny = int(nx * shrink), int(ny * shrink)
        nx, ny = nx if nx > 1 else 1, ny if ny > 1 else 1
    per_x, per_y = nx / (wide if wide > SMALL else SMALL), ny / (high if high > SMALL else SMALL)
    start, cell, order = np.empty(nx * ny + 1, np.int64), np.empty(n, np.int64), np.empty(n, np.int64)
    for c in range(nx * ny + 1):
        start[c] = 0
    for i in range(n):
        cell[i] = cell_of(y[i], y0, per_y, ny) * nx + cell_of(x[i], x0, per_x, nx)
        start[cell[i] + 1] += 1
    for c in range(nx * ny):
        start[c + 1] += start[c]
    for i in range(n):
        order[start[cell[i]]] = i
        start[cell[i]] += 1
    return order


@njit(**ENTRY)
def comb(mass: F8, order: I8, count: int, offset: float) -> tuple[I8, I8, F8, F8]:
    """The teeth of a comb of ``count`` teeth over the sources in ``order``, their masses in steps of 2⁻³².

    Tooth k stands at (k + offset)/count of the total, 0 ≤ offset < 1.

    Returns
    -------
    teeth, place : (S,) number of teeth on each source, and the number of its first.
    phase, width : (S,) in steps of the comb: where the first tooth stands from the source's beginning, and how wide it is.
    """
    n = mass.size
    teeth, place, phase, width = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n), np.empty(n)
    total = 0
    for i in range(n):
        teeth[i], place[i], phase[i], width[i] = 0, 0, 0.0, 0.0
        total += int(mass[i] * FIXED)
    if total == 0:
        return teeth, place, phase, width
    per = count / total
    reached, done = 0, 0
    for o in range(n):
        i = order[o]
        size = int(mass[i] * FIXED)
        begin = reached * per
        reached += size
        upto = int(np.ceil(reached * per - offset))
        if reached >= total or upto > count:
            upto = count
        upto = upto if upto > done else done
        teeth[i], place[i] = upto - done, done
        phase[i], width[i] = done + offset - begin, size * per
        done = upto
    return teeth, place, phase, width


@njit(**ENTRY)
def cut(extents: F4, order: I8, teeth: I8, reach: float) -> tuple[I8, I8]:
    """Where the offspring of the sources in ``order`` are cut into blocks of at most ``BLOCK`` neighbours.

    Sources are put together while their common extent is at most ``reach`` boxes. A source that is wider than that itself is
    to be parted along its longer side, and its offspring are halved: what has drifted apart is parted in a few frames.

    Returns
    -------
    start : (B + 1,) of the new blocks.  divided : (S,) 1 or 2 where a source is to be parted along x or y, else 0.
    """
    n = order.size
    divided = np.empty(n, np.int64)
    total = 0
    for i in range(n):
        divided[i] = 0
        total += teeth[i]
    start = np.empty(2 * n + total // BLOCK + 2, np.int64)
    start[0] = 0
    blocks, filled, done = 0, 0, 0
    left, top, right, bottom = NOTHING, NOTHING, NOTHING, NOTHING
    for o in range(n):
        i = order[o]
        if teeth[i] == 0:
            continue
        x0, y0, x1, y1, w, h = (
            extents[i, 0],
            extents[i, 1],
            extents[i, 2],
            extents[i, 3],
            extents[i, 4],
            extents[i, 5],
        )
        wide, high = x1 - x0, y1 - y0
        if wide > reach * w or high > reach * h:
            # In boxes, without a division: a state that somebody gives may have no size.
            divided[i] = 1 if wide * h >= high * w else 2
        if filled > 0:
            left, top = left if left < x0 else x0, top if top < y0 else y0
            right, bottom = right if right > x1 else x1, bottom if bottom > y1 else y1
            if divided[i] or not (right - left <= reach * w and bottom - top <= reach * h):
                blocks += 1
                start[blocks] = done
                filled = 0
        if filled == 0:
            left, top, right, bottom = x0, y0, x1, y1
        left_over = teeth[i]
        most = BLOCK
        if divided[i] and left_over < 2 * BLOCK:
            most = (left_over + 1) // 2
        while left_over > 0:
            take = left_over if left_over < most - filled else most - filled
            filled += take
            done += take
            left_over -= take
            if filled >= most:
                blocks += 1
                start[blocks] = done
                filled = 0
        if divided[i] and filled > 0:
            blocks += 1
            start[blocks] = done
            filled = 0
    if filled > 0:
        blocks += 1
        start[blocks] = done
    return start[: blocks + 1], divided
