"""Gaussian densities of many small vectors at once."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

F8 = NDArray[np.float64]


@njit(cache=True)
def factor(cov: F8, root: F8) -> float:
    """Cholesky's factor of ``cov`` (m, m) into the lower part of ``root`` (m, m); gives log |cov|.

    NaN where the matrix is not positive definite.
    """
    product = 1.0
    for r in range(cov.shape[0]):
        for s in range(r + 1):
            value = cov[r, s]
            for t in range(s):
                value -= root[r, t] * root[s, t]
            root[r, s] = np.sqrt(value) if r == s else value / root[s, s]
        product *= root[r, r]
    log_det: float = 2.0 * np.log(product)
    return log_det


@njit(cache=True)
def norm2(step: F8, root: F8, y: F8) -> float:
    """Squared Mahalanobis norm of ``step`` (m,) under the matrix that ``root`` factors; ``y`` (m,) is working space."""
    total = 0.0
    for r in range(step.size):
        value = step[r]
        for t in range(r):
            value -= root[r, t] * y[t]
        y[r] = value / root[r, r]
        total += y[r] * y[r]
    return total


@njit(cache=True)
def gaussian_parts(step: F8, cov: F8) -> tuple[F8, F8]:
    """(P,) squared Mahalanobis norms and log-determinants: ``step`` (m, P), ``cov`` (P, m, m) positive definite.

    Solved by Cholesky factors in place; NaN where a matrix is not positive definite.
    """
    m, count = step.shape
    distance2, log_det = np.empty(count), np.empty(count)
    root, y = np.empty((m, m)), np.empty(m)
    for p in range(count):
        log_det[p] = factor(cov[p], root)
        distance2[p] = norm2(step[:, p], root, y)
    return distance2, log_det
