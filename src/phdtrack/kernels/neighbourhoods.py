"""Sums over the detections around a detection: densities that are spread over overlapping neighbourhoods."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY
from phdtrack.kernels.grid import make_grid, overlapping

F8 = NDArray[np.float64]


@njit(**ENTRY)
def summed_densities(z: F8, density: F8, reach: float, smallest: float, largest: float) -> F8:
    """(N,) Σ_j density_j over the detections z_j = (px, py, w, h) in whose neighbourhood each detection lies.

    ``z`` (4, N), ``density`` (N,). A neighbourhood reaches ``reach`` boxes from its centre and holds sizes between
    ``smallest`` and ``largest`` times its own.
    """
    n = z.shape[1]
    lower, upper = np.empty((2, n)), np.empty((2, n))
    for axis in range(lower.shape[0]):
        for j in range(n):
            lower[axis, j] = z[axis, j] - reach * z[2 + axis, j]
            upper[axis, j] = z[axis, j] + reach * z[2 + axis, j]
    grid = make_grid(lower, upper, 0.0, 0.0)
    found = np.empty(n + 1, np.int64)
    out = np.empty(n)
    for i in range(n):
        out[i] = 0.0
        x, y, w, h = z[0, i], z[1, i], z[2, i], z[3, i]
        for m in range(overlapping(x, y, x, y, grid, found)):
            j = found[m]
            if smallest * z[2, j] <= w <= largest * z[2, j] and smallest * z[3, j] <= h <= largest * z[3, j]:
                out[i] += density[j]
    return out
