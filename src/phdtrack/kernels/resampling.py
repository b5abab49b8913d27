"""Systematic resampling of particles in blocks [M07 §2].

The comb is laid over the masses of the blocks after the update, which follow from sums of
likelihoods. Only the particles of blocks that get a tooth are weighed, and only particles that get
one are copied.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from phdtrack.kernels import F8, I4, I8, U4, Real
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, FAST, INNER, VECTOR, whole
from phdtrack.kernels.fast32 import D as U
from phdtrack.kernels.grid import cell_of, sorted_by_cell
from phdtrack.kernels.particle_models import BLOCK, Number, X, Y
from phdtrack.kernels.particles import ROWS, SUM, WEIGHT, Part, Sums, load_part, update_weights

QUARTER = BLOCK // 4
# Offspring that are written for every particle, even if it has fewer.
COPIES = 4
FIXED = 2.0**32
SMALL = 1e-9
MOST_CELLS = 2048.0


class Comb(NamedTuple):
    """The resampling comb over blocks in their order.

    ``teeth``, ``first`` (B,): number of offspring of each, and the column of the first; ``phase``,
    ``width`` (B,): position of its first tooth and its width, in steps of the comb; ``divided``
    (B,): 1 or 2 if its particles are to be divided along x or y, else 0.
    """

    teeth: I8
    first: I8
    phase: F8
    width: F8
    divided: I8


@njit(**ENTRY)
def by_cells(extents: Real) -> I8:
    """(B,) the blocks in the order of the cells that their centres lie in; cells are as large as
    the average neighbourhood.
    """
    n = extents.shape[0]
    x0, wide, nx, per_x = _cells(extents, 0)
    y0, high, ny, per_y = _cells(extents, 1)
    if nx * ny > 4 * n + 16:
        shrink = np.sqrt((4 * n + 16) / (nx * ny))
        nx = max(int(nx * shrink), 1)
        ny = max(int(ny * shrink), 1)
        per_x = nx / max(wide, SMALL)
        per_y = ny / max(high, SMALL)
    cell = np.empty(n, np.int64)
    for i in range(n):
        x = 0.5 * (extents[i, 0] + extents[i, 2])
        y = 0.5 * (extents[i, 1] + extents[i, 3])
        cell[i] = cell_of(y, y0, per_y, ny) * nx + cell_of(x, x0, per_x, nx)
    order: I8
    _, order = sorted_by_cell(cell, nx * ny)
    return order


@njit(**INNER)
def _cells(extents: Real, axis: int) -> tuple[float, float, int, float]:
    """Origin, extent, number of cells, and cells per unit along an axis, of the blocks' centres."""
    n = extents.shape[0]
    low = np.inf
    high = -np.inf
    size = 0.0
    for i in range(n):
        centre = 0.5 * (extents[i, axis] + extents[i, axis + 2])
        low = min(low, centre)
        high = max(high, centre)
        size += extents[i, axis + 4]
    extent = 0.0
    if n > 0:
        extent = high - low
    count = int(min(extent * n / max(size, SMALL), MOST_CELLS)) + 1
    return low, extent, count, count / max(extent, SMALL)


@njit(**ENTRY)
def comb(mass: F8, extents: Real, count: int, offset: float) -> tuple[Comb, I8]:
    """A comb of ``count`` teeth over the blocks, and ``start`` (B',) of the blocks of offspring.

    Tooth k stands at (k + offset)/count of the total, 0 ≤ offset < 1. Masses (B,) count in steps of
    2⁻³² of the total, so that the order of a sum cannot matter. A block that is wider than its
    neighbourhood is to be divided along its longer side: particles that have drifted apart are
    separate after a few frames.
    """
    n = mass.size
    order = by_cells(extents)
    teeth = np.zeros(n, np.int64)
    first = np.zeros(n, np.int64)
    divided = np.zeros(n, np.int64)
    phase = np.zeros(n)
    width = np.zeros(n)
    scale = FIXED / max(mass.sum(), 1e-300)
    total = 0
    reached = 0
    done = 0
    for b in range(n):
        total += int(mass[b] * scale)
    per = count / max(total, 1)
    for b in order:
        size = int(mass[b] * scale)
        begin = reached * per
        reached += size
        upto = int(np.ceil(reached * per - offset))
        upto = count if reached >= total else max(min(upto, count), done)
        teeth[b] = upto - done
        first[b] = done
        phase[b] = done + offset - begin
        width[b] = size * per
        done = upto
        wide = extents[b, 2] - extents[b, 0]
        high = extents[b, 3] - extents[b, 1]
        if wide > extents[b, 4] or high > extents[b, 5]:
            # In neighbourhoods, without a division: a fixed state may have no size.
            divided[b] = 1 if wide * extents[b, 5] >= high * extents[b, 4] else 2
    return Comb(teeth, first, phase, width, divided), offspring_blocks(
        order, teeth, divided, extents
    )


@njit(**INNER)
def offspring_blocks(order: I8, teeth: I8, divided: I8, extents: Real) -> I8:
    """The first columns of the blocks of offspring, and behind them the end of the last.

    Offspring are put together into blocks of at most `BLOCK` while their common extent is at most
    the neighbourhood's. Those of a block that is divided are halved.
    """
    start = np.zeros(2 * order.size + teeth.sum() // BLOCK + 2, np.int64)
    blocks = 0
    filled = 0
    common = np.zeros(4)
    for b in order:
        rest = teeth[b]
        if rest == 0:
            continue
        fits = _join(common, extents, b) and divided[b] == 0
        if filled > 0 and not fits:
            blocks = blocks + 1
            filled = 0
        if filled == 0:
            for side in range(4):
                common[side] = extents[b, side]
        most = BLOCK
        if divided[b] > 0 and rest < 2 * BLOCK:
            most = (rest + 1) // 2
        while rest > 0:
            some = min(rest, most - filled)
            filled += some
            rest -= some
            start[blocks + 1] = start[blocks] + filled
            if filled >= most or (rest == 0 and divided[b] > 0):
                blocks = blocks + 1
                filled = 0
    if filled > 0:
        blocks = blocks + 1
    return start[: blocks + 1]


@njit(**INNER)
def _join(common: F8, extents: Real, b: int) -> bool:
    """Grow the ``common`` extent (4,) by that of block b; True if it is no wider than a
    neighbourhood.
    """
    for side in range(2):
        common[side] = min(common[side], float(extents[b, side]))
        common[side + 2] = max(common[side + 2], float(extents[b, side + 2]))
    across: bool = common[2] - common[0] <= extents[b, 4]
    along: bool = common[3] - common[1] <= extents[b, 5]
    return across and along


@njit(**(ENTRY | {"fastmath": FAST}))
def pick(
    lo: int,
    hi: int,
    part: Part,
    sums: Sums,
    sensor: Number,
    table: Real,
    missed: float,
    factor: F8,
    teeth: Comb,
    out: Real,
) -> None:
    """Write the offspring of the blocks lo … hi − 1, weighed as by `weigh`, into their columns of
    ``out``.
    """
    state, share, detect, start = part
    many, place, phase, width, divided = teeth
    s = np.empty(ROWS * BLOCK, state.dtype)
    upto = np.empty(BLOCK, np.int32)
    order = np.empty(BLOCK, np.uint32)
    owner = np.empty(out.shape[1] + COPIES, np.uint32)
    for b in range(lo, hi):
        n = start[b + 1] - start[b]
        if many[b] == 0:
            continue
        load_part(sensor, s, n, state, share, detect, start[b])
        update_weights(
            sensor, table, s, whole(n), sums.which, sums.first[b], sums.first[b + 1], missed, factor
        )
        if divided[b] > 0:
            divide(s, n, X if divided[b] == 1 else Y, order)
        own_teeth(s, n, many[b], phase[b], width[b], upto, owner)
        if divided[b] > 0:
            for t in range(many[b]):
                owner[t] = order[owner[t]]
        begin = U(start[b])
        to = U(place[b])
        for r in range(state.shape[0]):
            for t in range(U(many[b])):
                out[r, to + t] = state[r, begin + owner[t]]


@njit(**INNER)
def divide(s: Real, n: int, row: int, order: U4) -> None:
    """Write the order that puts the particles before the middle of their extent along a row first,
    and sort their weights.
    """
    least = s[row]
    most = s[row]
    count = 0
    for i in range(n):
        least = min(least, s[row + i])
        most = max(most, s[row + i])
    middle = s.dtype.type(0.5) * (least + most)
    for before in (True, False):
        for i in range(n):
            if (s[row + i] < middle) == before:
                order[count] = i
                s[SUM + count] = s[WEIGHT + i]
                count += 1
    for i in range(n):
        s[WEIGHT + i] = s[SUM + i]


@njit(**INNER)
def own_teeth(s: Real, n: int, count: int, phase: float, width: float, upto: I4, owner: U4) -> None:
    """Write the particle in whose stretch of the weights each tooth of the comb falls.

    In steps of the comb the block is ``width`` wide and its ``count`` teeth stand at phase, phase +
    1, … Rounding can leave the last teeth beyond the last sum: they belong to the last particle
    with a weight.
    """
    total = running_sum(s, n)
    last = n - 1
    begin = U(0)
    # Below 1, or a tooth at the very beginning would fall on particles without weight there.
    shift = min(1.0 - phase, 1.0 - 2.0**-24)
    teeth_before(s, n, width / total if total > 0.0 else 0.0, shift, count, upto)
    for i in range(U(n)):
        # So many without a branch, which would be mispredicted; the next particle overwrites what
        # is too much.
        for t in range(U(COPIES)):
            owner[begin + t] = i
        for t in range(begin + U(COPIES), U(upto[i])):
            owner[t] = i
        begin = U(upto[i])
    while last > 0 and not s[WEIGHT + last] > 0.0:
        last -= 1
    for t in range(begin, U(count)):
        owner[t] = last


@njit(**INNER)
def running_sum(s: Real, n: int) -> float:
    """Write the running sum of the weights into SUM, of four quarters at once so that none waits
    for another; returns the whole sum.
    """
    zero = s.dtype.type(0)
    for i in range(n, BLOCK):
        s[WEIGHT + i] = zero
    a = zero
    b = zero
    c = zero
    e = zero
    for i in range(QUARTER):
        a += s[WEIGHT + i]
        b += s[WEIGHT + QUARTER + i]
        c += s[WEIGHT + 2 * QUARTER + i]
        e += s[WEIGHT + 3 * QUARTER + i]
        s[SUM + i] = a
        s[SUM + QUARTER + i] = b
        s[SUM + 2 * QUARTER + i] = c
        s[SUM + 3 * QUARTER + i] = e
    b += a
    c += b
    for i in range(QUARTER):
        s[SUM + QUARTER + i] += a
        s[SUM + 2 * QUARTER + i] += b
        s[SUM + 3 * QUARTER + i] += c
    return float(c + e)


@njit(**VECTOR)
def teeth_before(s: Real, n: int, scale: float, shift: float, count: int, upto: I4) -> None:
    """Write how many teeth stand before the end of each particle's stretch."""
    most = np.int32(count)
    per = s.dtype.type(scale)
    more = s.dtype.type(shift)
    for i in range(n):
        upto[i] = min(most, np.int32(s[SUM + i] * per + more))
