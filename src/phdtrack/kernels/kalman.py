"""Kalman prediction and update of many Gaussians at once.

A measurement shows some rows of the state, so that H is a choice of rows and H P a choice of entries. The update of a pair
(Gaussian i, measurement j) goes through the Cholesky factor L of S = H P Hᵀ + R: with W = L⁻¹ H P and y = L⁻¹ (z − H m)

    m' = m + Wᵀ y     P' = P − Wᵀ W     d² = yᵀ y

which is symmetric by construction and needs no inverse.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]


@njit(cache=True)
def predicted_covariance(cov: F8, f: F8, q: F8) -> F8:
    """(n, d, d) F P Fᵀ + Q of each; all three are (n, d, d)."""
    n, d, _ = cov.shape
    out = np.empty((n, d, d))
    half = np.empty((d, d))
    for i in range(n):
        for r in range(d):
            for s in range(d):
                total = 0.0
                for t in range(d):
                    total += f[i, r, t] * cov[i, t, s]
                half[r, s] = total
        for r in range(d):
            for s in range(r + 1):
                total = q[i, r, s]
                for t in range(d):
                    total += half[r, t] * f[i, s, t]
                out[i, r, s] = total
                out[i, s, r] = total
    return out


@njit(cache=True)
def factor(s: F8) -> float:
    """Cholesky factor of ``s`` (m, m) in its own lower triangle; its determinant's root, NaN where not positive definite."""
    root = 1.0
    for r in range(s.shape[0]):
        for c in range(r + 1):
            value = s[r, c]
            for t in range(c):
                value -= s[r, t] * s[c, t]
            if r == c:
                s[r, r] = np.sqrt(value) if value > 0.0 else np.nan
                root *= s[r, r]
            else:
                s[r, c] = value / s[c, c]
    return root


@njit(cache=True)
def updated(mean: F8, cov: F8, z: F8, noise: F8, rows: I8, point: I8, which: I8) -> tuple[F8, F8]:
    """Means (d, P) and covariances (P, d, d) of the pairs (Gaussian ``point``, measurement ``which``) after the update.

    ``mean`` (d, J), ``cov`` (J, d, d); ``z`` (≥ r, N); ``noise`` (P, r, r) of each pair; ``rows`` (r,) of the state that
    the first components of z show. NaN where H P Hᵀ + R is not positive definite.
    """
    d, m, count = mean.shape[0], rows.size, point.size
    out_mean, out_cov = np.empty((d, count)), np.empty((count, d, d))
    s, w, y = np.empty((m, m)), np.empty((m, d)), np.empty(m)
    for p in range(count):
        i, j = point[p], which[p]
        for a in range(m):
            for b in range(a + 1):
                s[a, b] = cov[i, rows[a], rows[b]] + noise[p, a, b]
        factor(s)
        for a in range(m):
            value = z[a, j] - mean[rows[a], i]
            for t in range(a):
                value -= s[a, t] * y[t]
            y[a] = value / s[a, a]
            for r in range(d):
                value = cov[i, rows[a], r]
                for t in range(a):
                    value -= s[a, t] * w[t, r]
                w[a, r] = value / s[a, a]
        for r in range(d):
            value = mean[r, i]
            for a in range(m):
                value += w[a, r] * y[a]
            out_mean[r, p] = value
            for c in range(r + 1):
                value = cov[i, r, c]
                for a in range(m):
                    value -= w[a, r] * w[a, c]
                out_cov[p, r, c] = value
                out_cov[p, c, r] = value
    return out_mean, out_cov
