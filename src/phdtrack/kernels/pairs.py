"""Sums and distances over pairs (point i, centre j): the inner loops of K-means and EM.

A list of pairs instead of a table keeps the work linear: a point is paired only with the centres near it.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]


@njit(cache=True)
def scaled_distance2(x: F8, centre: F8, scale: F8, point: I8, which: I8) -> F8:
    """(P,) Σ_r ((x_ri − c_rj) / s_rj)² of the pairs; ``x`` (d, L), ``centre`` and ``scale`` (d, k)."""
    out = np.zeros(point.size)
    for r in range(x.shape[0]):
        for p in range(point.size):
            step = (x[r, point[p]] - centre[r, which[p]]) / scale[r, which[p]]
            out[p] += step * step
    return out


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


@njit(cache=True)
def nearest(distance2: F8, point: I8, which: I8, count: int) -> tuple[I8, F8]:
    """For each of ``count`` points the centre of its closest pair (−1: it has no pair) and that distance² (inf).

    The lower index wins a tie.
    """
    label = np.full(count, -1, np.int64)
    best = np.full(count, np.inf)
    for p in range(point.size):
        i = point[p]
        if distance2[p] < best[i] or (distance2[p] == best[i] and which[p] < label[i]):
            best[i] = distance2[p]
            label[i] = which[p]
    return label, best


@njit(cache=True)
def moments(x: F8, weight: F8, point: I8, which: I8, k: int) -> tuple[F8, F8, F8]:
    """Mass (k,), mean (d, k) and covariance (k, d, d) of the points of each centre, pair p weighing ``weight[p]``.

    A centre without mass has mean and covariance zero. Two passes: the covariance is taken about the mean, because the
    difference of raw moments loses all digits for positions far from the origin.
    """
    d = x.shape[0]
    mass, mean, cov = np.zeros(k), np.zeros((d, k)), np.zeros((k, d, d))
    for p in range(point.size):
        i, j, w = point[p], which[p], weight[p]
        mass[j] += w
        for r in range(d):
            mean[r, j] += w * x[r, i]
    for j in range(k):
        if mass[j] > 0.0:
            for r in range(d):
                mean[r, j] /= mass[j]
    step = np.empty(d)
    for p in range(point.size):
        i, j, w = point[p], which[p], weight[p]
        for r in range(d):
            step[r] = x[r, i] - mean[r, j]
            for s in range(r + 1):
                cov[j, r, s] += w * step[r] * step[s]
    for j in range(k):
        if mass[j] > 0.0:
            for r in range(d):
                for s in range(r + 1):
                    cov[j, r, s] /= mass[j]
                    cov[j, s, r] = cov[j, r, s]
    return mass, mean, cov


@njit(cache=True)
def shares(log_density: F8, point: I8, count: int) -> F8:
    """(P,) exp(log_density) of each pair over the sum of its point's pairs: responsibilities, safe from underflow."""
    top = np.full(count, -np.inf)
    for p in range(point.size):
        top[point[p]] = max(top[point[p]], log_density[p])
    total = np.zeros(count)
    out = np.empty(point.size)
    for p in range(point.size):
        out[p] = np.exp(log_density[p] - top[point[p]])
        total[point[p]] += out[p]
    for p in range(point.size):
        out[p] /= total[point[p]]
    return out
