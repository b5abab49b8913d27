"""What stands between the two sweeps: births, evidence, masses and the comb, all linear in the first sweep's sums."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.box_blocks import BLOCK, GSCALE
from phdtrack.kernels.fast32 import ENTRY
from phdtrack.kernels.newborn import PEAK

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
# κ + C below this is 0: likelihoods in single precision have no tail below 1e-38 (`fast32.exp32` ends there), and the
# reciprocal must be a number in single precision.
FAINT = 1e-30


@njit(**ENTRY)
def births(which: I8, sums: F4, unit: float, most: int, kept: float, touching: I8, table: F4) -> tuple[I8, I8, I8]:
    """J_j = ⌈Jmax·max(0, 1 − M_j)⌉ newborn a detection [M07 §2], and the proposals' peaks J_j p_j(z_j) into ``table``.

    Returns
    -------
    many : (N,) J_j.  batch_start, gain_start : (N + 1,) where each one's batches and its sums by neighbour and batch begin.
    """
    n = touching.size
    covered = np.empty(n)
    for j in range(n):
        covered[j] = 0.0
    for e in range(which.size):
        covered[which[e]] += sums[1, e]
    many, batch_start, gain_start = np.empty(n, np.int64), np.empty(n + 1, np.int64), np.empty(n + 1, np.int64)
    batch_start[0], gain_start[0] = 0, 0
    for j in range(n):
        missing = 1.0 - unit * covered[j]
        missing = missing if missing > 0.0 else 0.0
        many[j] = int(np.ceil(most * (missing if missing < 1.0 else 1.0)))
        batches = (many[j] + BLOCK - 1) // BLOCK
        batch_start[j + 1] = batch_start[j] + batches
        gain_start[j + 1] = gain_start[j] + batches * touching[j]
        table[PEAK, j] = many[j] * table[GSCALE, j] / kept
    return many, batch_start, gain_start


@njit(**ENTRY)
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
) -> tuple[F8, F8, F8, F4, int, tuple[float, float, float]]:
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
    masses : before the update, without the newborn; the newborn's; all after the update.
    """
    n, blocks = touching.size, alive.size
    evidence, weight = np.empty(n), np.empty(n)
    for j in range(n):
        evidence[j], weight[j] = 0.0, 0.0
    for e in range(which.size):
        evidence[which[e]] += sums[0, e]
    for j in range(n):
        evidence[j] *= unit
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
    mass, batch_mass = np.empty(blocks + n), np.empty(base.size, np.float32)
    before, newborn, after = 0.0, 0.0, 0.0
    for b in range(blocks):
        before += alive[b]
        total = (1.0 - p_detect) * alive[b]
        for e in range(first[b], first[b + 1]):
            total += weight[which[e]] * sums[0, e]
        mass[b] = unit * total
        after += mass[b]
    for j in range(n):
        mass[blocks + j] = 0.0
        batches = batch_start[j + 1] - batch_start[j]
        for g in range(batches):
            newborn += base[batch_start[j] + g]
            total = (1.0 - p_detect) * base[batch_start[j] + g]
            for m in range(touching[j]):
                total += weight[near[near_start[j] + m]] * gains[gain_start[j] + m * batches + g]
            batch_mass[batch_start[j] + g] = total
            mass[blocks + j] += batch_mass[batch_start[j] + g]
        after += mass[blocks + j]
    return evidence, weight, mass, batch_mass, vanished, (unit * before, newborn, after)
