"""The second sweep of the fused particle PHD filter: weights anew, and the offspring of every block [M07 §2, M09 §III].

The comb (`kernels.comb`) has given each source, a block or the newborn of a detection, its number of teeth and where they
stand; here the particles that they fall on are copied out. See `sweeps` for the first sweep and the whole.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.box_blocks import (
    ALIVE,
    BLOCK,
    IH,
    IW,
    LANES,
    N0,
    N1,
    N2,
    N3,
    ROWS,
    SUM,
    VX,
    VY,
    ZERO,
    G,
    H,
    W,
    X,
    Y,
    bury,
    likelihood,
    load,
    own_precisions,
    pad,
)
from phdtrack.kernels.fast32 import ENTRY, HALF, INNER, VECTOR
from phdtrack.kernels.newborn import place_newborn, stretch, weigh_newborn

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
I4 = NDArray[np.int32]
U4 = NDArray[np.uint32]
I8 = NDArray[np.int64]
F = np.float32
BELOW_ONE = F(1.0 - 2.0**-24)
QUARTER = BLOCK // 4
# Rows as unsigned numbers: a gather need not ask whether its index is negative.
AT_X, AT_Y, AT_VX, AT_VY, AT_W, AT_H = (np.uint32(row) for row in (X, Y, VX, VY, W, H))
ZEROTH = np.uint32(0)


@njit(**ENTRY)
def sweep_offspring(
    lo: int,
    hi: int,
    order: I8,
    many_offspring: I8,
    place: I8,
    phase: F8,
    width: F8,
    divided: I8,
    moved: F4,
    start: I8,
    first: I8,
    which: I8,
    weight: F4,
    missed: np.float32,
    detections: F4,
    own: bool,
    sensor: F4,
    key: I8,
    many: I8,
    batch_start: I8,
    points: F4,
    room: int,
    local: bool,
    flat: F4,
    near_start: I8,
    near: I8,
    touching: I8,
    batch_mass: F4,
    velocity: F4,
    out: F4,
) -> None:
    """The offspring of the sources order[lo] … order[hi − 1], each into its own columns of ``out``.

    A source is a block (its number) or the newborn of a detection (its number behind the blocks').

    Parameters
    ----------
    many_offspring, place : (S,) how many offspring each source has, and their first column.
    divided : (S,) 1 or 2 where the source's particles are to be parted along x or y, so that blocks become compact.
    phase, width : (S,) in steps of the comb: where a source's first tooth stands, and how wide the source is.
    first, which : the detections near each block.  weight : (N,) p_D/(κ + C).  missed : 1 − p_D.
    batch_mass : mass of each batch of newborn after the update.  flat : (N,), see `newborn.weigh_newborn`.
    velocity : (5, N) of each detection's newborn the mean, and the lower triangle that a standard velocity is turned with.
    """
    k0, k1 = np.uint32(key[0]), np.uint32(key[1])
    blocks = start.size - 1
    most = 0
    for source in range(many_offspring.size):
        most = many_offspring[source] if many_offspring[source] > most else most
    s = np.empty(ROWS * BLOCK, np.float32)
    upto, owner = np.empty(BLOCK, np.int32), np.empty(most + 2, np.uint32)
    for o in range(lo, hi):
        source = order[o]
        teeth, at = many_offspring[source], place[source]
        if teeth == 0:
            continue
        old, j = source < blocks, source - blocks
        batches, total, begin = 1, width[source], 0
        if not old:
            batches, total = batch_start[j + 1] - batch_start[j], 0.0
            for g in range(batch_start[j], batch_start[j + 1]):
                total += batch_mass[g]
            begin = stretch(j, room, k0, k1)
        scale = width[source] / total
        reached, done = 0.0, 0
        # Of a detection's newborn only batches on which a tooth falls are drawn again.
        for g in range(batches):
            share, end = width[source], teeth
            if not old:
                share = batch_mass[batch_start[j] + g] * scale
                upto_here = int(reached + share - phase[source] + 1.0)
                if g < batches - 1 and upto_here < teeth:
                    end = upto_here
            if end > done:
                if old:
                    n = start[source + 1] - start[source]
                    load(s, n, moved, start[source])
                    if divided[source]:
                        _part(s, n, X if divided[source] == 1 else Y, upto)
                    full = pad(s, n)
                    _survivors(s, full)
                    bury(s, n, full)
                    near_here = which[first[source] : first[source + 1]]
                else:
                    n = many[j] - g * BLOCK
                    n = n if n < BLOCK else BLOCK
                    full = (n + LANES - 1) // LANES * LANES
                    place_newborn(s, full, points, begin + g * BLOCK, detections, j)
                    neighbour = near[near_start[j] : near_start[j + 1]]
                    weigh_newborn(s, full, detections, j, neighbour, neighbour.size, sensor[3], local, flat[j])
                    bury(s, n, full)
                    near_here = neighbour[: touching[j]]
                _posterior(s, full, near_here, weight, missed, detections, own, sensor)
                _pick(s, n, end - done, at + done, phase[source] + done - reached, share, upto, owner, out)
                done = end
            reached += share
        if not old:
            # Each offspring has a velocity of its own, also where a newborn particle has several.
            for t in range(teeth):
                i = (begin + t) % points.shape[1]
                x, y = points[5, i], points[6, i]
                out[2, at + t] = velocity[0, j] + velocity[2, j] * x
                out[3, at + t] = velocity[1, j] + velocity[3, j] * x + velocity[4, j] * y


@njit(**INNER)
def _survivors(s: F4, n: int) -> None:
    """ALIVE from the sign of the width, which becomes positive again."""
    for i in range(n):
        s[ALIVE + i] = F(1.0) if s[W + i] > ZERO else ZERO
        s[W + i] = abs(s[W + i])


@njit(**INNER)
def _posterior(s: F4, n: int, which: I8, weight: F4, missed: np.float32, d: F4, own: bool, sensor: F4) -> None:
    """The particles' weights after the update into SUM: [1 − p_D + Σ_z p_D g(z|x)/(κ + C)]·ALIVE [M07 (6), M09 (6)]."""
    for i in range(n):
        s[SUM + i] = missed * s[ALIVE + i]
    if own and which.size:
        own_precisions(s, n, sensor[0], sensor[1])
    for m in range(which.size):
        likelihood(s, n, d, which[m], sensor[2], own)
        factor = weight[which[m]]
        for i in range(n):
            s[SUM + i] += factor * s[G + i]


@njit(**INNER)
def _part(s: F4, n: int, row: int, target: I4) -> None:
    """Put the block's particles that lie before the middle of its extent along a row before the others.

    The rows N0 … N3, IW and IH and ``target`` (n,) are for scratch.
    """
    least, most = s[row], s[row]
    for i in range(n):
        least = s[row + i] if s[row + i] < least else least
        most = s[row + i] if s[row + i] > most else most
    middle = HALF * (least + most)
    right = 0
    for i in range(n):
        right += 1 if s[row + i] < middle else 0
    left = 0
    for i in range(n):
        before = s[row + i] < middle
        target[i] = left if before else right
        left, right = left + (1 if before else 0), right + (0 if before else 1)
    for i in range(n):
        s[N0 + i], s[N1 + i], s[N2 + i] = s[X + i], s[Y + i], s[VX + i]
        s[N3 + i], s[IW + i], s[IH + i] = s[VY + i], s[W + i], s[H + i]
    for i in range(n):
        to = np.uint32(target[i])
        s[AT_X + to], s[AT_Y + to], s[AT_VX + to] = s[N0 + i], s[N1 + i], s[N2 + i]
        s[AT_VY + to], s[AT_W + to], s[AT_H + to] = s[N3 + i], s[IW + i], s[IH + i]


@njit(**INNER)
def _pick(s: F4, n: int, teeth: int, at: int, phase: float, width: float, upto: I4, owner: U4, out: F4) -> None:
    """Write the offspring of a block: the particles on whose stretch of the weights a tooth of the comb falls.

    In units of the comb's step the block is ``width`` wide and its teeth stand at phase, phase + 1, …
    """
    total = _running(s, n)
    # Below 1, or a tooth at the very beginning would fall on particles without weight there.
    shift = F(1.0 - phase)
    shift = shift if shift < BELOW_ONE else BELOW_ONE
    _teeth_before(s, n, F(width) / total if total > ZERO else ZERO, shift, teeth, upto)
    # Where its teeth begin each particle puts its number; a later one overwrites those without any. The running maximum then
    # is the owner of each tooth: no branch to miss. Rounding can leave the last tooth beyond the last sum: it belongs to the
    # last particle that has a weight.
    for t in range(teeth):
        owner[t] = ZEROTH
    begin, last = 0, n
    while last > 1 and not s[SUM + last - 1] > ZERO:
        last -= 1
    for i in range(last):
        owner[begin] = i
        begin = upto[i]
    x, y, vx, vy = out[0, at : at + teeth], out[1, at : at + teeth], out[2, at : at + teeth], out[3, at : at + teeth]
    w, h = out[4, at : at + teeth], out[5, at : at + teeth]
    mine = ZEROTH
    for t in range(teeth):
        mine = owner[t] if owner[t] > mine else mine
        x[t], y[t], vx[t] = s[mine + AT_X], s[mine + AT_Y], s[mine + AT_VX]
        vy[t], w[t], h[t] = s[mine + AT_VY], s[mine + AT_W], s[mine + AT_H]


@njit(**INNER)
def _running(s: F4, n: int) -> np.float32:
    """The running sum of SUM into N0, of four quarters at once so that none waits for another's; gives the whole."""
    for i in range(n, BLOCK):
        s[SUM + i] = ZERO
    a, b, c, d = ZERO, ZERO, ZERO, ZERO
    for i in range(QUARTER):
        a += s[SUM + i]
        b += s[SUM + QUARTER + i]
        c += s[SUM + 2 * QUARTER + i]
        d += s[SUM + 3 * QUARTER + i]
        s[N0 + i], s[N0 + QUARTER + i], s[N0 + 2 * QUARTER + i], s[N0 + 3 * QUARTER + i] = a, b, c, d
    b += a
    c += b
    for i in range(QUARTER):
        s[N0 + QUARTER + i] += a
        s[N0 + 2 * QUARTER + i] += b
        s[N0 + 3 * QUARTER + i] += c
    return c + d


@njit(**VECTOR)
def _teeth_before(s: F4, n: int, scale: np.float32, shift: np.float32, teeth: int, upto: I4) -> None:
    """How many teeth stand before the end of each particle's stretch, from the running sum in N0."""
    most = np.int32(teeth)
    for i in range(n):
        here = np.int32(s[N0 + i] * scale + shift)
        upto[i] = here if here < most else most
