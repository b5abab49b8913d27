"""The steps of the Rauch–Tung–Striebel smoother over n Gaussians at once [R65]. See `models.rts`, which has the formulas.

Means are (n, d), covariances (n, d, d), measurements (n, r); all C-contiguous.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
# A pivot that is smaller than this share of its own diagonal element is rounding: the matrix is singular there.
_SINGULAR = 1e-14


@njit(**INNER)
def _factor(a: F8, low: F8) -> float:
    """Fill ``low`` with the factors of a = L D Lᵀ, D on the diagonal, 0 where a is singular; log |a| of what is not."""
    log_determinant = 0.0
    for j in range(a.shape[0]):
        pivot = a[j, j]
        for k in range(j):
            pivot -= low[j, k] * low[j, k] * low[k, k]
        if not pivot > _SINGULAR * a[j, j]:
            pivot = 0.0
        else:
            log_determinant += math.log(pivot)
        low[j, j] = pivot
        for i in range(j + 1, a.shape[0]):
            total = a[i, j]
            for k in range(j):
                total -= low[i, k] * low[j, k] * low[k, k]
            low[i, j] = total / pivot if pivot > 0.0 else 0.0
    return log_determinant


@njit(**INNER)
def _solved(low: F8, b: F8) -> None:
    """Put a⁻¹ b in the place of ``b`` (d, m); where a is singular the solution that is 0 there."""
    for c in range(b.shape[1]):
        for i in range(b.shape[0]):
            for k in range(i):
                b[i, c] -= low[i, k] * b[k, c]
        for i in range(b.shape[0] - 1, -1, -1):
            b[i, c] = b[i, c] / low[i, i] if low[i, i] > 0.0 else 0.0
            for k in range(i + 1, b.shape[0]):
                b[i, c] -= low[k, i] * b[k, c]


@njit(**INNER)
def _multiplied(a: F8, b: F8, out: F8) -> None:
    """Fill ``out`` with a b."""
    for i in range(a.shape[0]):
        for j in range(b.shape[1]):
            total = 0.0
            for k in range(a.shape[1]):
                total += a[i, k] * b[k, j]
            out[i, j] = total


@njit(**INNER)
def _add_turned(a: F8, b: F8, between: F8, out: F8) -> None:
    """Add a b aᵀ to ``out``; ``between`` is room for a b."""
    _multiplied(a, b, between)
    for i in range(a.shape[0]):
        for j in range(a.shape[0]):
            total = 0.0
            for k in range(a.shape[1]):
                total += between[i, k] * a[j, k]
            out[i, j] += total


@njit(**ENTRY)
def predicted(covariance: F8, jacobian: F8, noise: F8) -> F8:
    """(n, d, d) F P Fᵀ + Q."""
    out, between = noise.copy(), np.empty(covariance.shape[1:])
    for n in range(len(covariance)):
        _add_turned(jacobian[n], covariance[n], between, out[n])
    return out


@njit(**ENTRY)
def updated(mean: F8, covariance: F8, z: F8, noise: F8, rows: I8) -> tuple[F8, F8]:
    """Means and covariances given measurements of these rows of the state."""
    d, r = mean.shape[1], len(rows)
    mean_out, out = mean.copy(), np.zeros(covariance.shape)
    s, low, part, gain = np.empty((r, r)), np.empty((r, r)), np.empty((r, d)), np.empty((d, r))
    left, between, narrow = np.empty((d, d)), np.empty((d, d)), np.empty((d, r))
    for n in range(len(mean)):
        for i in range(r):
            part[i] = covariance[n, rows[i]]
            for j in range(r):
                s[i, j] = covariance[n, rows[i], rows[j]] + noise[n, i, j]
        _factor(s, low)
        _solved(low, part)
        left[:] = np.eye(d)
        for i in range(d):
            for j in range(r):
                gain[i, j] = part[j, i]
                left[i, rows[j]] -= part[j, i]
                mean_out[n, i] += part[j, i] * (z[n, j] - mean[n, rows[j]])
        _add_turned(left, covariance[n], between, out[n])
        _add_turned(gain, noise[n], narrow, out[n])
    return mean_out, out


@njit(**ENTRY)
def smoothed(now: tuple[F8, F8], ahead: tuple[F8, F8, F8, F8], later: tuple[F8, F8]) -> tuple[F8, F8]:
    """Filtered Gaussians given what the next frame says after all.

    ``now`` and ``later`` are means and covariances, ``ahead`` the predictions' with the Jacobian and noise they came of.
    """
    mean, covariance = now
    expected, expected_covariance, jacobian, noise = ahead
    d = mean.shape[1]
    mean_out, out = mean.copy(), np.zeros(covariance.shape)
    low, part, gain, left = np.empty((d, d)), np.empty((d, d)), np.empty((d, d)), np.empty((d, d))
    between, added = np.empty((d, d)), np.empty((d, d))
    for n in range(len(mean)):
        _factor(expected_covariance[n], low)
        _multiplied(jacobian[n], covariance[n], part)
        _solved(low, part)
        for i in range(d):
            for j in range(d):
                gain[i, j] = part[j, i]
                mean_out[n, i] += part[j, i] * (later[0][n, j] - expected[n, j])
        _multiplied(gain, jacobian[n], between)
        left[:] = np.eye(d) - between
        added[:] = noise[n] + later[1][n]
        _add_turned(left, covariance[n], between, out[n])
        _add_turned(gain, added, between, out[n])
    return mean_out, out


@njit(**ENTRY)
def log_densities(step: F8, covariance: F8, noise: F8, rows: I8) -> F8:
    """(2, n) log densities, but for constants, of Gaussians at a distance ``step`` (n, r) with covariance H P Hᵀ + R: of the
    first two components of measurements, and of the others."""
    n, r = step.shape
    out = np.zeros((2, n))
    for part in range(2):
        first, last = (0, min(2, r)) if part == 0 else (min(2, r), r)
        size = last - first
        s, low, v = np.empty((size, size)), np.empty((size, size)), np.empty((size, 1))
        for k in range(n if size else 0):
            for i in range(size):
                v[i, 0] = step[k, first + i]
                for j in range(size):
                    a, b = first + i, first + j
                    s[i, j] = covariance[k, rows[a], rows[b]] + noise[k, a, b]
            total = _factor(s, low)
            _solved(low, v)
            for i in range(size):
                total += step[k, first + i] * v[i, 0]
            out[part, k] = -0.5 * total
    return out
