"""Sums over the detections around a detection: densities that are spread over overlapping neighbourhoods."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]


@njit(**ENTRY)
def summed_densities(z: F8, order: I8, density: F8, reach: float, smallest: float, largest: float) -> F8:
    """(N,) Σ_j density_j over the detections z_j = (px, py, w, h) in whose neighbourhood each detection lies.

    ``z`` (4, N), ``order`` (N,) their numbers by px, rising, ``density`` (N,). A neighbourhood reaches ``reach`` boxes from
    its centre and holds sizes between ``smallest`` and ``largest`` times its own.
    """
    n, out = order.size, np.empty(order.size)
    for i in range(n):
        out[i] = 0.0
    for p in range(n):
        j, k = order[p], p
        x, y, w, h = z[0, j], z[1, j], z[2, j], z[3, j]
        left, right, top, bottom = x - reach * w, x + reach * w, y - reach * h, y + reach * h
        while k > 0 and z[0, order[k - 1]] >= left:
            k -= 1
        while k < n and z[0, order[k]] <= right:
            i = order[k]
            near, wide, high = top <= z[1, i] <= bottom, z[2, i], z[3, i]
            if near and smallest * w <= wide <= largest * w and smallest * h <= high <= largest * h:
                out[i] += density[j]
            k += 1
    return out
