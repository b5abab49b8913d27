"""Gaussian densities of many small vectors at once."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

F8 = NDArray[np.float64]


@njit(cache=True)
def gaussian_parts(step: F8, cov: F8) -> tuple[F8, F8]:
    """(P,) squared Mahalanobis norms and log-determinants: ``step`` (m, P), ``cov`` (P, m, m) positive definite.

    Solved by Cholesky factors in place; NaN where a matrix is not positive definite.
    """
    m, count = step.shape
    distance2, log_det = np.empty(count), np.empty(count)
    root, y = np.empty((m, m)), np.empty(m)
    for p in range(count):
        total, log_total = 0.0, 0.0
        for r in range(m):
            for s in range(r + 1):
                value = cov[p, r, s]
                for t in range(s):
                    value -= root[r, t] * root[s, t]
                root[r, s] = np.sqrt(value) if r == s else value / root[s, s]
            value = step[r, p]
            for t in range(r):
                value -= root[r, t] * y[t]
            y[r] = value / root[r, r]
            total += y[r] * y[r]
            log_total += 2.0 * np.log(root[r, r])
        distance2[p], log_det[p] = total, log_total
    return distance2, log_det
