"""What stands between the two sweeps: births, evidence, masses and the comb, all linear in the first sweep's sums."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.box_blocks import BLOCK, GSCALE
from phdtrack.kernels.comb import by_cells, comb, cut
from phdtrack.kernels.newborn import PEAK

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
# κ + C below this is 0: likelihoods in single precision have no tail below 1e-38 (`fast32.exp32` ends there), and the
# reciprocal must be a number in single precision.
FAINT = 1e-30


@njit(cache=True, nogil=True)
def births(which: I8, sums: F4, unit: float, most: int, kept: float, touching: I8, table: F4) -> tuple[I8, I8, I8]:
    """J_j = ⌈Jmax·max(0, 1 − M_j)⌉ newborn a detection [M07 §2], and the proposals' peaks J_j p_j(z_j) into ``table``.

    Returns
    -------
    many : (N,) J_j.  batch_start, gain_start : (N + 1,) where each one's batches and its sums by neighbour and batch begin.
    """
    n = touching.size
    covered = np.zeros(n)
    for e in range(which.size):
        covered[which[e]] += sums[1, e]
    many, batch_start, gain_start = np.empty(n, np.int64), np.zeros(n + 1, np.int64), np.zeros(n + 1, np.int64)
    for j in range(n):
        many[j] = int(np.ceil(most * min(max(1.0 - unit * covered[j], 0.0), 1.0)))
        batches = (many[j] + BLOCK - 1) // BLOCK
        batch_start[j + 1] = batch_start[j] + batches
        gain_start[j + 1] = gain_start[j] + batches * touching[j]
        table[PEAK, j] = many[j] * table[GSCALE, j] / kept
    return many, batch_start, gain_start


@njit(cache=True, nogil=True)
def account(
    first: I8,
    which: I8,
    sums: F4,
    alive: F8,
    unit: float,
    batch_start: I8,
    near_start: I8,
    near: I8,
    touching: I8,
    gain_start: I8,
    base: F4,
    gains: F4,
    kappa: F8,
    p_detect: float,
) -> tuple[F8, F8, F8, F4, int]:
    """The evidence of every detection, and the masses after the update [M07 (6), M09 (6)].

    Parameters
    ----------
    first, which, sums, alive : of the first sweep over the particles that were there; ``unit`` is the weight of each.
    batch_start … gains : of the newborn, see `sweeps.sweep_born`.
    kappa : (N,) κ.  p_detect : p_D.

    Returns
    -------
    evidence : (N,) C.  weight : (N,) p_D/(κ + C).
    mass : (B + N,) of each block, then of each detection's newborn.  batch_mass : of each batch of newborn.
    vanished : how many detections have κ + C = 0 (below `FAINT`), and no weight.
    """
    n, blocks = touching.size, alive.size
    evidence, weight = np.zeros(n), np.zeros(n)
    for e in range(which.size):
        evidence[which[e]] += sums[0, e]
    evidence *= unit
    for j in range(n):
        batches = batch_start[j + 1] - batch_start[j]
        for m in range(touching[j]):
            total = 0.0
            for g in range(gain_start[j] + m * batches, gain_start[j] + (m + 1) * batches):
                total += gains[g]
            evidence[near[near_start[j] + m]] += total
    vanished = 0
    for j in range(n):
        evidence[j] *= p_detect
        if kappa[j] + evidence[j] >= FAINT:
            weight[j] = p_detect / (kappa[j] + evidence[j])
        else:
            evidence[j] = 0.0
            vanished += 1
    mass, batch_mass = np.zeros(blocks + n), np.empty(base.size, np.float32)
    for b in range(blocks):
        total = (1.0 - p_detect) * alive[b]
        for e in range(first[b], first[b + 1]):
            total += weight[which[e]] * sums[0, e]
        mass[b] = unit * total
    for j in range(n):
        batches = batch_start[j + 1] - batch_start[j]
        for g in range(batches):
            total = (1.0 - p_detect) * base[batch_start[j] + g]
            for m in range(touching[j]):
                total += weight[near[near_start[j] + m]] * gains[gain_start[j] + m * batches + g]
            batch_mass[batch_start[j] + g] = total
            mass[blocks + j] += batch_mass[batch_start[j] + g]
    return evidence, weight, mass, batch_mass, vanished


@njit(cache=True, nogil=True)
def share_out(
    mass: F8, extents: F4, z: F8, reach: F8, count: int, offset: float, compact: float
) -> tuple[I8, I8, I8, F8, F8, I8, I8]:
    """The order of the sources, the teeth of the comb on each, and how the offspring are cut into blocks.

    ``extents`` (B, 6) are the blocks'; ``z`` (4, N) and ``reach`` (2, N) say where the newborn lie. See `comb` for the rest.
    """
    blocks, n = extents.shape[0], z.shape[1]
    everything = np.empty((blocks + n, 6), np.float32)
    everything[:blocks] = extents
    for j in range(n):
        for axis in range(2):
            everything[blocks + j, axis] = z[axis, j] - reach[axis, j]
            everything[blocks + j, 2 + axis] = z[axis, j] + reach[axis, j]
            everything[blocks + j, 4 + axis] = z[2 + axis, j]
    order = by_cells(everything)
    teeth, place, phase, width = comb(mass, order, count, offset)
    start, divided = cut(everything, order, teeth, compact)
    return order, teeth, place, phase, width, start, divided
