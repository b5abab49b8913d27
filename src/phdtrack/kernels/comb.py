"""From the masses of blocks to their offspring: who gets how many teeth of the resampling comb, and in which order.

Masses are summed in fixed point, so that the order of the sum cannot matter, and a block's stretch of the comb is known
without looking at the others' particles. Blocks are put in the order of a grid's cells, so that neighbours stay neighbours.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.box_blocks import BLOCK
from phdtrack.kernels.overlaps import cell_of

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
FIXED = 2.0**32


@njit(cache=True, nogil=True)
def by_cells(extents: F4) -> I8:
    """(S,) the sources in the order of the cells that their centres lie in; cells are as large as boxes are on average."""
    n = extents.shape[0]
    x, y = np.empty(n), np.empty(n)
    width, height = 0.0, 0.0
    for i in range(n):
        x[i], y[i] = 0.5 * (extents[i, 0] + extents[i, 2]), 0.5 * (extents[i, 1] + extents[i, 3])
        width += extents[i, 4]
        height += extents[i, 5]
    if n == 0:
        return np.zeros(0, np.int64)
    x0, y0 = x.min(), y.min()
    nx = min(int((x.max() - x0) * n / max(width, 1e-9)), 2048) + 1
    ny = min(int((y.max() - y0) * n / max(height, 1e-9)), 2048) + 1
    if nx * ny > 4 * n + 16:
        shrink = np.sqrt((4 * n + 16) / (nx * ny))
        nx, ny = max(1, int(nx * shrink)), max(1, int(ny * shrink))
    per_x, per_y = nx / max(x.max() - x0, 1e-9), ny / max(y.max() - y0, 1e-9)
    start, cell = np.zeros(nx * ny + 1, np.int64), np.empty(n, np.int64)
    for i in range(n):
        cell[i] = cell_of(y[i], y0, per_y, ny) * nx + cell_of(x[i], x0, per_x, nx)
        start[cell[i] + 1] += 1
    for c in range(nx * ny):
        start[c + 1] += start[c]
    order = np.empty(n, np.int64)
    for i in range(n):
        order[start[cell[i]]] = i
        start[cell[i]] += 1
    return order


@njit(cache=True, nogil=True)
def comb(mass: F8, order: I8, count: int, offset: float) -> tuple[I8, I8, F8, F8]:
    """The teeth of a comb of ``count`` teeth over the sources in ``order``, their masses in steps of 2⁻³².

    Tooth k stands at (k + offset)/count of the total, 0 ≤ offset < 1.

    Returns
    -------
    teeth, place : (S,) number of teeth on each source, and the number of its first.
    phase, width : (S,) in steps of the comb: where the first tooth stands from the source's beginning, and how wide it is.
    """
    n = mass.size
    teeth, place = np.zeros(n, np.int64), np.zeros(n, np.int64)
    phase, width = np.zeros(n), np.zeros(n)
    total = 0
    for i in range(n):
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
        upto = min(int(np.ceil(reached * per - offset)), count) if reached < total else count
        upto = max(upto, done)
        teeth[i], place[i] = upto - done, done
        phase[i], width[i] = done + offset - begin, size * per
        done = upto
    return teeth, place, phase, width


@njit(cache=True, nogil=True)
def cut(extents: F4, order: I8, teeth: I8, reach: float) -> tuple[I8, I8]:
    """Where the offspring of the sources in ``order`` are cut into blocks of at most ``BLOCK`` neighbours.

    Sources are put together while their common extent is at most ``reach`` boxes. A source that is wider than that itself is
    to be parted along its longer side, and its offspring are halved: what has drifted apart is parted in a few frames.

    Returns
    -------
    start : (B + 1,) of the new blocks.  divided : (S,) 1 or 2 where a source is to be parted along x or y, else 0.
    """
    n = order.size
    divided = np.zeros(n, np.int64)
    start = np.zeros(2 * n + teeth.sum() // BLOCK + 2, np.int64)
    blocks, filled, done = 0, 0, 0
    box = np.empty(4, np.float32)
    for o in range(n):
        i = order[o]
        if teeth[i] == 0:
            continue
        e = extents[i]
        wide, high = e[2] - e[0], e[3] - e[1]
        if wide > reach * e[4] or high > reach * e[5]:
            # In boxes, without a division: a state that somebody gives may have no size.
            divided[i] = 1 if wide * e[5] >= high * e[4] else 2
        fits = filled > 0 and divided[i] == 0
        if fits:
            left, top, right, bottom = min(box[0], e[0]), min(box[1], e[1]), max(box[2], e[2]), max(box[3], e[3])
            fits = right - left <= reach * e[4] and bottom - top <= reach * e[5]
        if filled > 0 and not fits:
            blocks += 1
            start[blocks] = done
            filled = 0
        if fits:
            box[0], box[1], box[2], box[3] = left, top, right, bottom
        else:
            box[:] = e[:4]
        left_over = teeth[i]
        most = BLOCK
        if divided[i]:
            most = min(BLOCK, max(1, (left_over + 1) // 2))
        while left_over > 0:
            take = min(left_over, most - filled)
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
