"""First states of new targets where births are given, or learned, for the fused step of the box model.

By place, they are those around the measurements, with the velocities that were learned. Else γ is their Gaussians, and its
flat part as Gaussians about the measurements: γ̂(z) sums over all, and the first state has the mean and covariance of their
posteriors. Kernels of their own, so that only who needs them compiles them.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.gm_model import (
    ENTRIES,
    NOWHERE,
    PLACES,
    ROWS,
    BoxNumbers,
    D,
    M,
    Scene,
    box_numbers,
    entry,
    newborn,
    possible,
    sorted_boxes,
)
from phdtrack.kernels.gm_step import DENSITY, FACTOR, PAIR, Y, given, paired
from phdtrack.kernels.laid_over import births_by_place, clutter_by_place
from phdtrack.kernels.pmb_rows import MIXED, ROW, VARIANCE, told_alone

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

TINY = float(np.finfo(np.float64).tiny)


@njit(**INNER)
def _paired(scene: Scene, b: BoxNumbers, births: F8, gate: float) -> tuple[F8, F8, I8, F8, int, F8]:
    """Means (B', d) and triangles (B', 21) of the Gaussians; pairs of them and measurements, their values and how many there
    are as in `gm_step`, but that in the place of a pair's density stands its part of γ̂; (N,) γ̂ in the scene's order."""
    n = len(scene.boxes)
    room, none = len(births) + n, 0 * n
    w, x, p, t = np.empty(room), np.empty((room, D)), np.empty((room, ENTRIES)), np.empty(room, np.int64)
    used = given(births, w, x, p, t, none, none)
    density = np.zeros(n)
    if b.birth != NOWHERE:
        gamma = np.empty(n)
        for j in range(n):
            gamma[j] = b.born if possible(b, scene.boxes, j) else 0.0
        # Births by place are told otherwise: there are no rows about the measurements.
        used = newborn(scene, b, gamma, births[:0], density, w, x, p, t, used, used)
    index, value = np.empty((4 * n + 16, 2), np.int64), np.empty((4 * n + 16, PAIR))
    index, value, found = paired(x, p, none, used, scene, b, gate, index, value, none)
    for q in range(found):
        value[q, DENSITY] *= b.p_detect * w[index[q, 0]]
        density[index[q, 1]] += value[q, DENSITY]
    return x, p, index, value, found, density


@njit(**ENTRY)
def birth_states(z: F8, births: F8, gate: float, model: F8) -> F8:
    """Rows (N, 15) of what targets are that begin with the measurements ``z`` (m, N), behind each γ̂ there.

    ``births`` (B, 1 + d + 21) weight, mean and triangle of the covariance of each Gaussian; ``model`` the values of
    `BoxNumbers`. Raises ValueError where the position of a measurement is NaN or infinite.
    """
    n = z.shape[1]
    if n == 0:
        return np.empty((0, ROW + 1))
    b, scene = box_numbers(model), sorted_boxes(z)
    x, p, index, value, found, density = _paired(scene, b, births, gate)
    out = np.empty((n, ROW))
    for j in range(n):
        told_alone(scene.boxes, j, b, out, j)
        if density[j] > 0.0:
            for e in range(VARIANCE, ROW):
                out[j, e] = 0.0
    _posteriors(x, p, index, value, found, density, out)
    rows = np.empty((n, ROW + 1))
    for j in range(n):
        rows[scene.order[j], ROW] = density[j]
        for r in range(ROW):
            rows[scene.order[j], r] = out[j, r]
    return rows


@njit(**ENTRY)
def scene_states(z: F8, model: F8, bounds: F8, entrances: F8, objects: F8, around: F8, alarms: F8) -> tuple[F8, F8]:
    """What `pmb_step.pmb_box_step` is given of a learned scene at the boxes ``z`` (m, N), in one call.

    ``bounds`` to ``alarms`` are as in `laid_over.scene_about`. Returns rows of what targets are that begin there, behind
    each how many times as many do (N, 15), (0, 15) where they are not by place; and r̄ p(z|c) as is there.
    """
    b, given = box_numbers(model), clutter_by_place(z, around, alarms)
    if b.birth != PLACES:
        return np.empty((0, ROW + 1)), given
    ratio, x, p = births_by_place(z, b, bounds, entrances, objects)
    rows = np.empty((ratio.size, ROW + 1))
    for j in range(ratio.size):
        for r in range(D):
            rows[j, r], rows[j, VARIANCE + r] = x[r, j], p[j, r, r]
        for c in range(2):
            rows[j, MIXED + c] = p[j, c + 2, c]
        rows[j, ROW] = ratio[j]
    return rows, given


@njit(**INNER)
def _posteriors(x: F8, p: F8, index: I8, value: F8, found: int, density: F8, out: F8) -> None:
    """Mean and covariance of all posteriors of each measurement, weighed, into ``out``, which holds what it tells alone."""
    # Moments about what the measurement shows, so that nothing is lost when their squares are subtracted.
    step, w = np.empty(D), np.empty((M, D))
    about = np.zeros((len(out), D))
    for q in range(found):
        j = index[q, 1]
        part = value[q, DENSITY] / max(density[j], TINY)
        i = index[q, 0]
        for r in range(D):
            step[r] = x[i, r] - out[j, r]
        for a in range(M):
            for r in range(D):
                total = p[i, entry(max(ROWS[a], r), min(ROWS[a], r))]
                for e in range(a):
                    total -= value[q, FACTOR + entry(a, e)] * w[e, r]
                w[a, r] = total
                step[r] += total * value[q, FACTOR + entry(a, a)] * value[q, Y + a]
        for r in range(D):
            about[j, r] += part * step[r]
            left = p[i, entry(r, r)] + step[r] * step[r]
            for a in range(M):
                left -= w[a, r] * w[a, r] * value[q, FACTOR + entry(a, a)]
            out[j, VARIANCE + r] += part * left
        for c in range(2):
            left = p[i, entry(c + 2, c)] + step[c] * step[c + 2]
            for a in range(M):
                left -= w[a, c] * w[a, c + 2] * value[q, FACTOR + entry(a, a)]
            out[j, MIXED + c] += part * left
    for j in range(len(about)):
        if not density[j] > 0.0:
            continue
        for r in range(D):
            out[j, r] += about[j, r]
            out[j, VARIANCE + r] -= about[j, r] * about[j, r]
        for c in range(2):
            out[j, MIXED + c] -= about[j, c] * about[j, c + 2]
