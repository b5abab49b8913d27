"""First states of new targets, for the fused step: from their measurement alone, or from Gaussians of births that are given.

With births given, or learned, γ is their Gaussians and its flat part as Gaussians about the measurements. Then γ̂(z) sums
over them, and the first state is their posteriors' mean and covariance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import INNER
from phdtrack.kernels.gm_model import ENTRIES, LOCAL, NOWHERE, ROWS, BoxNumbers, D, M, Scene, entry, newborn
from phdtrack.kernels.gm_step import DENSITY, FACTOR, PAIR, Y, given, paired
from phdtrack.kernels.pmb_rows import MIXED, VARIANCE, told_alone

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

TINY = float(np.finfo(np.float64).tiny)


class Births(NamedTuple):
    """γ̂ of each measurement (N,) in the scene's order; Gaussians and their ``found`` pairs with measurements.

    ``mean`` (B, d), ``triangle`` (B, 21), ``pair`` (P, 2), ``value`` (P, PAIR) as in `gm_step`, but that in the place of a
    pair's density stands its part of γ̂.
    """

    density: F8
    mean: F8
    triangle: F8
    pair: I8
    value: F8
    found: int


@njit(**INNER)
def _flat(scene: Scene, b: BoxNumbers, crowded: F8, scale: float) -> F8:
    """(N,) the flat part of γ about each measurement, times ``scale``."""
    gamma = np.empty(len(scene.boxes))
    for j in range(gamma.size):
        possible = True
        for a in range(M):
            possible &= b.low[a] <= scene.boxes[j, a] <= b.high[a]
        gamma[j] = scale * b.born * (crowded[j] if b.birth == LOCAL else 1.0) if possible else 0.0
    return gamma


@njit(**INNER)
def births_at(scene: Scene, b: BoxNumbers, crowded: F8, births: F8, gate: float) -> Births:
    """Of the model's flat births, or where Gaussians (B, 1 + d + 21) are given of all of them."""
    n = len(scene.boxes)
    none = 0 * n
    density = _flat(scene, b, crowded, b.p_detect if len(births) == 0 else 1.0)
    if len(births) == 0 or n == 0:
        return Births(
            density, np.empty((0, D)), np.empty((0, ENTRIES)), np.empty((0, 2), np.int64), np.empty((0, PAIR)), none
        )
    room = len(births) + n
    w, x, p, t = np.empty(room), np.empty((room, D)), np.empty((room, ENTRIES)), np.empty(room, np.int64)
    used = given(births, w, x, p, t, none, none)
    if b.birth != NOWHERE:
        covered = np.zeros(n)
        used = newborn(scene, b, density, covered, w, x, p, t, used, used)
    index, value = np.empty((4 * n + 16, 2), np.int64), np.empty((4 * n + 16, PAIR))
    index, value, found = paired(x, p, none, used, scene, b, gate, index, value, none)
    for j in range(n):
        density[j] = 0.0
    for q in range(found):
        value[q, DENSITY] *= b.p_detect * w[index[q, 0]]
        density[index[q, 1]] += value[q, DENSITY]
    return Births(density, x, p, index, value, found)


@njit(**INNER)
def first_states(scene: Scene, b: BoxNumbers, births: Births, place: I8, out: F8) -> None:
    """The first state of a target that begins with measurement j into the row place[j] of ``out``; −1: none does."""
    for j in range(place.size):
        if place[j] >= 0:
            told_alone(scene.boxes, j, b, out, place[j])
            if births.found > 0 and births.density[j] > 0.0:
                for e in range(VARIANCE, out.shape[1]):
                    out[place[j], e] = 0.0
    # Moments about what the measurement shows, so that nothing is lost when their squares are subtracted.
    step, w = np.empty(D), np.empty((M, D))
    about = np.zeros((place.size if births.found > 0 else 0, D))
    for q in range(births.found):
        j = births.pair[q, 1]
        k = place[j]
        if k < 0:
            continue
        part = births.value[q, DENSITY] / max(births.density[j], TINY)
        i, x, p = births.pair[q, 0], births.mean, births.triangle
        for r in range(D):
            step[r] = x[i, r] - out[k, r]
        for a in range(M):
            for r in range(D):
                total = p[i, entry(max(ROWS[a], r), min(ROWS[a], r))]
                for e in range(a):
                    total -= births.value[q, FACTOR + entry(a, e)] * w[e, r]
                w[a, r] = total
                step[r] += total * births.value[q, FACTOR + entry(a, a)] * births.value[q, Y + a]
        for r in range(D):
            about[j, r] += part * step[r]
            left = p[i, entry(r, r)] + step[r] * step[r]
            for a in range(M):
                left -= w[a, r] * w[a, r] * births.value[q, FACTOR + entry(a, a)]
            out[k, VARIANCE + r] += part * left
        for c in range(2):
            left = p[i, entry(c + 2, c)] + step[c] * step[c + 2]
            for a in range(M):
                left -= w[a, c] * w[a, c + 2] * births.value[q, FACTOR + entry(a, a)]
            out[k, MIXED + c] += part * left
    for j in range(len(about)):
        k = place[j]
        if k < 0 or not births.density[j] > 0.0:
            continue
        for r in range(D):
            out[k, r] += about[j, r]
            out[k, VARIANCE + r] -= about[j, r] * about[j, r]
        for c in range(2):
            out[k, MIXED + c] -= about[j, c] * about[j, c + 2]
