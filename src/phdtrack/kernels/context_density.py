"""A learned density at many points, and what it says of detections: how likely births are there, and how fast [M09 (14)].

Both ask every Gaussian of every point, but most only whether it is near: what adds less than a part of 1e-16 to the uniform
part is left out.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, INNER, VECTOR

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

# e^-40 is 4e-18.
NEGLIGIBLE = 40.0


@njit(**ENTRY)
def mixture_density(x: F8, low: F8, high: F8, flat: F8, mean: F8, whiten: F8, log_norm: F8) -> F8:
    """(n,) the uniform part and Gaussians at the columns of ``x`` (d, n) that lie from ``low`` to ``high`` (d,).

    ``flat`` (2,): the uniform part, above 0, and what is elsewhere; ``mean`` (M, d), ``whiten`` (M, d, d) inverse Cholesky
    factors and ``log_norm`` (M,) logarithms of the Gaussians' peaks.
    """
    d, n = x.shape
    out, cut = np.empty(n), np.log(flat[0]) - NEGLIGIBLE
    for j in range(n):
        inside = True
        for r in range(d):
            inside &= low[r] <= x[r, j] <= high[r]
        if not inside:
            out[j] = flat[1]
            continue
        total = flat[0]
        for m in range(log_norm.size):
            log = log_norm[m]
            for r in range(d):
                y = 0.0
                for s in range(r + 1):
                    y += whiten[m, r, s] * (x[s, j] - mean[m, s])
                log -= 0.5 * y * y
                if not log > cut:
                    break
            if log > cut:
                total += np.exp(log)
        out[j] = total
    return out


@njit(**VECTOR)
def _beyond(place: float, noise: float, a: int, mean: F8, cov: F8, reach: F8, out: F8) -> None:
    """Raise ``out`` above 0 for the Gaussians that component ``a`` alone puts further than ``reach`` from a detection."""
    for m in range(reach.size):
        step = place - mean[a, m]
        out[m] = max(out[m], step * step - reach[m] * (cov[a * (a + 3) // 2, m] + noise))


@njit(**VECTOR)
def _put(work: F8, row: int, table: F8, of: int, which: I8, count: int, sign: float, plus: float) -> None:
    """sign·table + plus for the columns ``which`` of a row ``of`` the table."""
    for k in range(count):
        work[row, k] = sign * table[of, which[k]] + plus


@njit(**VECTOR)
def _less(work: F8, row: int, a: int, factor: F8, count: int) -> None:
    """row − factor · row a."""
    for k in range(count):
        work[row, k] -= work[a, k] * factor[k]


@njit(**VECTOR)
def _divided(work: F8, row: int, inverse: F8, factor: F8, count: int) -> None:
    """row / pivot."""
    for k in range(count):
        factor[k] = work[row, k] * inverse[k]


@njit(**VECTOR)
def _pivot(work: F8, row: int, step: int, inverse: F8, peak2: F8, distance2: F8, count: int) -> None:
    """The pivot's inverse, and what it does to 1/|S| and to d²."""
    for k in range(count):
        inverse[k] = 1.0 / work[row, k]
        peak2[k] *= inverse[k]
        distance2[k] += work[step, k] * work[step, k] * inverse[k]


@njit(**INNER)
def _eliminated(work: F8, r: int, d: int, inverse: F8, factor: F8, peak2: F8, distance2: F8, count: int) -> None:
    """Gaussian elimination of the first ``r`` of ``d`` variables in ``count`` symmetric matrices with a right-hand side.

    ``work`` holds their lower triangles, row by row, then the right-hand sides. What is left of the other rows is the
    covariance given the first variables, and minus the mean's step.
    """
    side = d * (d + 1) // 2
    for a in range(r):
        _pivot(work, a * (a + 3) // 2, side + a, inverse, peak2, distance2, count)
        for i in range(a + 1, d):
            _divided(work, i * (i + 1) // 2 + a, inverse, factor, count)
            _less(work, side + i, side + a, factor, count)
            for c in range(a + 1, i + 1):
                _less(work, i * (i + 1) // 2 + c, c * (c + 1) // 2 + a, factor, count)


@njit(**INNER)
def _felt(x: F8, noise: F8, j: int, order: I8, r: int, mean: F8, cov: F8, reach: F8, far: F8, which: I8) -> int:
    """The Gaussians that no component alone puts out of reach of detection ``j``, into ``which``; how many."""
    for m in range(reach.size):
        far[m] = -reach[m]
    for a in range(r):
        _beyond(x[order[a], j], noise[j, order[a], order[a]], a, mean, cov, reach, far)
    count = 0
    for m in range(reach.size):
        which[count] = m
        count += not far[m] > 0.0
    return count


@njit(**INNER)
def _gathered(x: F8, noise: F8, j: int, order: I8, r: int, mean: F8, cov: F8, which: I8, count: int, work: F8) -> None:
    """The Gaussians ``which`` with the noise of detection ``j``, and its steps from their means, into ``work``."""
    d = order.size
    for a in range(d):
        for c in range(a + 1):
            e = a * (a + 1) // 2 + c
            _put(work, e, cov, e, which, count, 1.0, noise[j, order[a], order[c]] if a < r else 0.0)
        _put(work, d * (d + 1) // 2 + a, mean, a, which, count, -1.0, x[order[a], j] if a < r else 0.0)


@njit(**INNER)
def _moments(work: F8, weight: F8, count: int, j: int, order: I8, r: int, flat: float, total: float, x: F8, p: F8) -> None:
    """Mean and covariance of the components that are not shown, those of the uniform part being in ``x`` and ``p``."""
    d = order.size
    side = d * (d + 1) // 2
    for a in range(r, d):
        for c in range(r, a + 1):
            i, s = order[a], order[c]
            value = flat * (p[j, i, s] + x[i, j] * x[s, j])
            for k in range(count):
                value += weight[k] * (work[a * (a + 1) // 2 + c, k] + work[side + a, k] * work[side + c, k])
            p[j, i, s] = value / total
    for a in range(r, d):
        value = flat * x[order[a], j]
        for k in range(count):
            value -= weight[k] * work[side + a, k]
        x[order[a], j] = value / total
    for a in range(r, d):
        for c in range(r, a + 1):
            i, s = order[a], order[c]
            p[j, i, s] -= x[i, j] * x[s, j]
            p[j, s, i] = p[j, i, s]


@njit(**ENTRY)
def given_detections(
    state: F8, noise: F8, order: I8, r: int, low: F8, high: F8, flat: float, mean: F8, cov: F8, peak2: F8, reach: F8
) -> tuple[F8, F8, F8]:
    """A learned density seen through the noise at detections, and mean and covariance of what they do not show.

    Parameters
    ----------
    state, noise : (d, n), (n, d, d) states at which detections are, and covariance of what one detection says. Of what it
        does not show, they are mean and covariance under the uniform part.
    order : (d,) the components, the ``r`` that are shown first.
    low, high : (r,) where the density is not 0.
    flat : the uniform part, above 0.
    mean, cov : (d, M), (d(d + 1)/2, M) of the Gaussians: means, and lower triangles of the covariances, row by row; both in
        that order.
    peak2 : (M,) squares of the Gaussians' peaks, but for the determinant: (α π / Z)² / (2π)^r.
    reach : (M,) squared distance beyond which a Gaussian is left out.

    Returns
    -------
    (n,) densities; (d, n), (n, d, d) states and covariances with those of what is not shown.
    """
    (d, n), many = state.shape, reach.size
    x, p, density = state.copy(), noise.copy(), np.empty(n)
    work, which, far = np.empty((d * (d + 3) // 2, many)), np.empty(many, np.int64), np.empty(many)
    inverse, weight, square, distance2 = np.empty(many), np.empty(many), np.empty(many), np.empty(many)
    for j in range(n):
        count = _felt(state, noise, j, order, r, mean, cov, reach, far, which)
        _gathered(state, noise, j, order, r, mean, cov, which, count, work)
        for k in range(count):
            square[k], distance2[k] = peak2[which[k]], 0.0
        _eliminated(work, r, d, inverse, weight, square, distance2, count)
        total = flat
        for k in range(count):
            weight[k] = np.sqrt(square[k]) * np.exp(-0.5 * distance2[k])
            total += weight[k]
        _moments(work, weight, count, j, order, r, flat, total, x, p)
        inside = True
        for a in range(r):
            inside &= low[a] <= state[order[a], j] <= high[a]
        density[j] = total if inside else 0.0
    return density, x, p
