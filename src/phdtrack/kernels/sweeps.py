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
    ROWS,
    ZERO,
    W,
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
from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.newborn import place_newborn, stretch, weigh_newborn
from phdtrack.kernels.overlaps import overlapping

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
F = np.float32
EXTENTS = 6
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
        full = pad(s, n)
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


@njit(**INNER)
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
    flat: F4,
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
    flat : (N,), see `newborn.weigh_newborn`.
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
            weigh_newborn(s, full, detections, j, neighbour, neighbour.size, sensor[3], local, flat[j])
            bury(s, n, full)
            base[batch_start[j] + rank // BLOCK] = summed(s, full)
            if own:
                own_precisions(s, full, sensor[0], sensor[1])
            for m in range(touching[j]):
                total, _ = likelihood(s, full, detections, neighbour[m], sensor[2], own)
                gains[gain_start[j] + m * batches + rank // BLOCK] = total
