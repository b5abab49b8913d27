"""The fused particle PHD filter in two sweeps over blocks of particles [M07 §2, M09 §III].

The first sweep moves the particles and sums, for each block and each detection near it, what the detections' evidence
C(z) is made of. Everything that the filter needs then follows from these sums: births, C(z), the mass of every block, and
the stretch of the resampling comb that falls to each. The second sweep weighs the particles again and picks their offspring.
Newborn particles are drawn again in the second sweep where somebody survives, and never stored.

A block's work depends on nothing but its own number, so that any division among threads gives the same bits. Blocks are
ranges [lo, hi); sums over blocks are taken in their order, in float64.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.box_blocks import (
    ALIVE,
    BLOCK,
    LANES,
    N0,
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
    drift,
    extent,
    fill_normals,
    likelihood,
    load,
    move,
    own_precisions,
    pad,
    store,
    summed,
)
from phdtrack.kernels.fast32 import ENTRY, HALF, LEAN, VECTOR
from phdtrack.kernels.newborn import place_newborn, stretch, weigh_newborn
from phdtrack.kernels.overlaps import overlapping

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
I4 = NDArray[np.int32]
U4 = NDArray[np.uint32]
I8 = NDArray[np.int64]
F = np.float32
EXTENTS = 6
BELOW_ONE = F(1.0 - 2.0**-24)
# Rows as unsigned numbers: a gather need not ask whether its index is negative.
AT_X, AT_Y, AT_VX, AT_VY, AT_W, AT_H = (np.uint32(row) for row in (X, Y, VX, VY, W, H))
ZEROTH = np.uint32(0)
STAGE_MOVE, STAGE_DRIFT = np.uint32(0), np.uint32(1)


@njit(**ENTRY)
def sweep_old(
    lo: int,
    hi: int,
    state: F4,
    start: I8,
    motion: F4,
    key: I8,
    detections: F4,
    own: bool,
    sensor: F4,
    lower: F8,
    upper: F8,
    frame: F8,
    cell_start: I8,
    cell_item: I8,
    corner: I8,
    moved: F4,
    extents: F4,
    alive: F8,
) -> tuple[I8, I8, F4]:
    """Move the blocks lo … hi − 1 into ``moved`` and sum their likelihoods.

    Parameters
    ----------
    state, start : the blocks, see `types.ParticleBlocks`.
    motion : see `box_blocks.move`, and beside it the rest of the position's noise for dt > 1.
    sensor : spread, floor, and the squared radii of the regions that count as explained and in which births are drawn.
    lower, upper : gates of the detections; frame, cell_start, cell_item, corner : their grid (`overlaps`).
    moved, extents, alive : outputs: states after the motion (a width below 0 marks what did not survive), extents (B, 6) and
        number of survivors of each block.

    Returns
    -------
    first : (hi − lo + 1,) where each block's sums begin.  which : the detection.
    sums : (2, E) Σg, and how many particles are explained; or more columns, of any content.
    """
    k0, k1 = np.uint32(key[0]), np.uint32(key[1])
    s = np.empty(ROWS * BLOCK, np.float32)
    found = np.empty(lower.shape[1] + 1, np.int64)
    first = np.empty(hi - lo + 1, np.int64)
    first[0] = 0
    which, sums = np.empty(4 * (hi - lo) + 64, np.int64), np.empty((2, 4 * (hi - lo) + 64), np.float32)
    used = 0
    for b in range(lo, hi):
        at, n = start[b], start[b + 1] - start[b]
        load(s, n, state, at)
        full = pad(s, n, state.shape[0])
        fill_normals(s, full, np.uint32(b), STAGE_MOVE, k0, k1)
        move(s, full, motion)
        bury(s, n, full)
        if motion[7] > ZERO:
            fill_normals(s, full, np.uint32(b), STAGE_DRIFT, k0, k1)
            drift(s, full, motion[7])
        alive[b] = extent(s, full, extents, b)
        store(s, n, moved, at)
        if alive[b] < n:
            for i in range(n):
                moved[4, at + i] = s[W + i] if s[ALIVE + i] > ZERO else -s[W + i]
        near = overlapping(
            np.float64(extents[b, 0]),
            np.float64(extents[b, 1]),
            np.float64(extents[b, 2]),
            np.float64(extents[b, 3]),
            lower,
            upper,
            frame,
            cell_start,
            cell_item,
            corner,
            found,
        )
        if used + near > which.size:
            which, sums = _longer(which, sums, 2 * (used + near))
        if own and near:
            own_precisions(s, full, sensor[0], sensor[1])
        for m in range(near):
            which[used] = found[m]
            sums[0, used], sums[1, used] = likelihood(s, full, detections, found[m], sensor[2], own)
            used += 1
        first[b - lo + 1] = used
    return first, which[:used], sums


@njit(**LEAN)
def _longer(which: I8, sums: F4, size: int) -> tuple[I8, F4]:
    """The same lists with room for ``size``."""
    longer, wider = np.empty(size, np.int64), np.empty((2, size), np.float32)
    for e in range(which.size):
        longer[e], wider[0, e], wider[1, e] = which[e], sums[0, e], sums[1, e]
    return longer, wider


@njit(**ENTRY)
def sweep_born(
    lo: int,
    hi: int,
    many: I8,
    batch_start: I8,
    points: F4,
    room: int,
    key: I8,
    detections: F4,
    own: bool,
    sensor: F4,
    local: bool,
    flat: np.float32,
    near_start: I8,
    near: I8,
    touching: I8,
    gain_start: I8,
    base: F4,
    gains: F4,
) -> None:
    """Draw and weigh the newborn of the detections lo … hi − 1 and sum their likelihoods, in batches of ``BLOCK``.

    Parameters
    ----------
    points, room : standard points of the frame, and how far into them a detection's stretch may begin.
    many : (N,) J_j.  batch_start : (N + 1,) where each detection's batches begin.
    near_start, near : the neighbours of each detection; first the ``touching`` (N,) in whose gates its newborn can lie.
    gain_start : (N + 1,) where each detection's sums begin; touching × batches of them.
    base : (batches,) output: the newborn's mass.  gains : output: Σ weight·g, by neighbour, then batch.
    """
    k0, k1 = np.uint32(key[0]), np.uint32(key[1])
    s = np.empty(ROWS * BLOCK, np.float32)
    for j in range(lo, hi):
        neighbour = near[near_start[j] : near_start[j + 1]]
        batches = batch_start[j + 1] - batch_start[j]
        at = stretch(j, room, k0, k1)
        for rank in range(0, many[j], BLOCK):
            n = many[j] - rank
            n = n if n < BLOCK else BLOCK
            full = (n + LANES - 1) // LANES * LANES
            place_newborn(s, full, points, at + rank, detections, j)
            weigh_newborn(s, full, detections, j, neighbour, neighbour.size, sensor[3], local, flat)
            bury(s, n, full)
            base[batch_start[j] + rank // BLOCK] = summed(s, full)
            if own:
                own_precisions(s, full, sensor[0], sensor[1])
            for m in range(touching[j]):
                total, _ = likelihood(s, full, detections, neighbour[m], sensor[2], own)
                gains[gain_start[j] + m * batches + rank // BLOCK] = total


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
    flat: np.float32,
    near_start: I8,
    near: I8,
    touching: I8,
    batch_mass: F4,
    speed: F4,
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
    batch_mass : mass of each batch of newborn after the update.  speed : (N,) deviation of the velocity's amplitude.
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
                        _part(s, n, moved.shape[0], X if divided[source] == 1 else Y, upto)
                    full = pad(s, n, moved.shape[0])
                    _survivors(s, full)
                    bury(s, n, full)
                    near_here = which[first[source] : first[source + 1]]
                else:
                    n = many[j] - g * BLOCK
                    n = n if n < BLOCK else BLOCK
                    full = (n + LANES - 1) // LANES * LANES
                    place_newborn(s, full, points, begin + g * BLOCK, detections, j)
                    neighbour = near[near_start[j] : near_start[j + 1]]
                    weigh_newborn(s, full, detections, j, neighbour, neighbour.size, sensor[3], local, flat)
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
                out[2, at + t], out[3, at + t] = speed[j] * points[5, i], speed[j] * points[6, i]


@njit(**LEAN)
def _survivors(s: F4, n: int) -> None:
    """ALIVE from the sign of the width, which becomes positive again."""
    for i in range(n):
        s[ALIVE + i] = F(1.0) if s[W + i] > ZERO else ZERO
        s[W + i] = abs(s[W + i])


@njit(**LEAN)
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


@njit(**LEAN)
def _part(s: F4, n: int, rows: int, row: int, target: I4) -> None:
    """Put the block's particles that lie before the middle of its extent along a row before the others.

    ``rows`` of the state are put in order; ``target`` (n,) is for scratch.
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
    for r in range(rows):
        part = s[r * BLOCK : r * BLOCK + n]
        for i in range(n):
            s[N0 + i] = part[i]
        for i in range(n):
            part[target[i]] = s[N0 + i]


@njit(**LEAN)
def _pick(s: F4, n: int, teeth: int, at: int, phase: float, width: float, upto: I4, owner: U4, out: F4) -> None:
    """Write the offspring of a block: the particles on whose stretch of the weights a tooth of the comb falls.

    In units of the comb's step the block is ``width`` wide and its teeth stand at phase, phase + 1, …
    """
    total = ZERO
    for i in range(n):
        total += s[SUM + i]
        s[N0 + i] = total
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


@njit(**VECTOR)
def _teeth_before(s: F4, n: int, scale: np.float32, shift: np.float32, teeth: int, upto: I4) -> None:
    """How many teeth stand before the end of each particle's stretch, from the running sum in N0."""
    most = np.int32(teeth)
    for i in range(n):
        here = np.int32(s[N0 + i] * scale + shift)
        upto[i] = here if here < most else most
