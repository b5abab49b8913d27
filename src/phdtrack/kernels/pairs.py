"""Distances over pairs (point i, centre j): a list of pairs instead of a table keeps the work linear."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.cache import njit

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]


@njit(cache=True)
def quadratic_form(x: F8, centre: F8, precision: F8, point: I8, which: I8) -> F8:
    """(P,) (x_i − c_j)ᵀ A_j (x_i − c_j) of the pairs; ``precision`` A is (k, d, d), symmetric."""
    d = x.shape[0]
    out = np.empty(point.size)
    step = np.empty(d)
    for p in range(point.size):
        i, j = point[p], which[p]
        for r in range(d):
            step[r] = x[r, i] - centre[r, j]
        total = 0.0
        for r in range(d):
            row = 0.5 * precision[j, r, r] * step[r]
            for s in range(r):
                row += precision[j, r, s] * step[s]
            total += 2.0 * row * step[r]
        out[p] = total
    return out
