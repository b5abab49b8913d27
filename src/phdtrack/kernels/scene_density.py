"""A learned density at many points, and what it says of detections: how likely births are there, and how fast [M09 (14)].

Both ask every Gaussian of every point, but most only whether it is near.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, INNER, VECTOR

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

# What adds less than e^-30, 1e-13, of the uniform part is left out, and around detections, where particles of single
# precision are drawn, e^-16, 1e-7.
NEGLIGIBLE, COARSE = 30.0, 16.0
BATCH = 96
# Components of a box.
BOX = 4


@njit(**VECTOR)
def _distances2(x: F8, j: int, mean: F8, whiten: F8, step: F8, row: F8, out: F8) -> None:
    """(M,) squared distances of column ``j`` from the means; ``step`` (d, M) and ``row`` (M,) are scratch."""
    d = step.shape[0]
    for m in range(out.size):
        out[m] = 0.0
    for r in range(d):
        for m in range(out.size):
            step[r, m] = x[r, j] - mean[r, m]
            row[m] = 0.0
        for s in range(r + 1):
            for m in range(out.size):
                row[m] += whiten[r * (r + 1) // 2 + s, m] * step[s, m]
        for m in range(out.size):
            out[m] += row[m] * row[m]


@njit(**VECTOR)
def _box_distances2(x: F8, j: int, mean: F8, whiten: F8, out: F8) -> None:
    """The same of four components, as boxes have them, in one loop: few Gaussians are not worth the start of many."""
    for m in range(out.size):
        a, b = x[0, j] - mean[0, m], x[1, j] - mean[1, m]
        c, d = x[2, j] - mean[2, m], x[3, j] - mean[3, m]
        first, second = whiten[0, m] * a, whiten[1, m] * a + whiten[2, m] * b
        third = whiten[3, m] * a + whiten[4, m] * b + whiten[5, m] * c
        fourth = whiten[6, m] * a + whiten[7, m] * b + whiten[8, m] * c + whiten[9, m] * d
        out[m] = first * first + second * second + third * third + fourth * fourth


@njit(**ENTRY)
def mixture_density(x: F8, scale: float, low: F8, high: F8, flat: F8, mean: F8, whiten: F8, log_peak: F8) -> F8:
    """(n,) ``scale`` times the uniform part and Gaussians at the columns of ``x`` that lie from ``low`` to ``high`` (d,).

    Of ``x`` the first d rows count. ``flat`` (2,): the uniform part, above 0, and what is elsewhere; ``mean`` (d, M),
    ``whiten`` (d(d + 1)/2, M) inverse Cholesky factors, row by row, and ``log_peak`` (M,) logarithms of the Gaussians'
    peaks.
    """
    d, n, many = low.size, x.shape[1], log_peak.size
    out, cut = np.empty(n), np.log(flat[0]) - NEGLIGIBLE
    step, row, distance2 = np.empty((d, many)), np.empty(many), np.empty(many)
    for j in range(n):
        out[j] = flat[0]
        for r in range(d):
            if not low[r] <= x[r, j] <= high[r]:
                out[j] = -1.0
        if out[j] < 0.0:
            out[j] = scale * flat[1]
            continue
        if d == BOX:
            _box_distances2(x, j, mean, whiten, distance2)
        else:
            _distances2(x, j, mean, whiten, step, row, distance2)
        for m in range(many):
            log = log_peak[m] - 0.5 * distance2[m]
            if log > cut:
                out[j] += np.exp(log)
        out[j] *= scale
    return out


@njit(**VECTOR)
def _beyond(place: float, noise: float, a: int, mean: F8, cov: F8, reach: F8, out: F8) -> None:
    """Raise ``out`` above 0 for the Gaussians that component ``a`` alone puts further than ``reach`` from a detection."""
    for m in range(reach.size):
        step = place - mean[a, m]
        out[m] = max(out[m], step * step - reach[m] * (cov[a * (a + 3) // 2, m] + noise))


@njit(**VECTOR)
def _beyond_box(z: F8, r: F8, mean: F8, cov: F8, reach: F8, out: F8) -> None:
    """All of it of four components ``z`` with variances ``r`` (4,), in one loop: few Gaussians are not worth more."""
    for m in range(reach.size):
        a, b, c, d = z[0] - mean[0, m], z[1] - mean[1, m], z[2] - mean[2, m], z[3] - mean[3, m]
        far = max(a * a - reach[m] * (cov[0, m] + r[0]), b * b - reach[m] * (cov[2, m] + r[1]))
        far = max(far, max(c * c - reach[m] * (cov[5, m] + r[2]), d * d - reach[m] * (cov[9, m] + r[3])))
        out[m] = max(far, -reach[m])


@njit(**VECTOR)
def _put(work: F8, row: int, table: F8, of: int, which: I8, count: int, sign: float) -> None:
    """sign·table for the columns ``which`` of a row ``of`` the table."""
    for k in range(count):
        work[row, k] = sign * table[of, which[k]]


@njit(**VECTOR)
def _plus(work: F8, row: int, noise: F8, a: int, c: int, of: I8, count: int) -> None:
    """row + the noise's element (a, c) of the detections ``of``."""
    for k in range(count):
        work[row, k] += noise[of[k], a, c]


@njit(**VECTOR)
def _from(work: F8, row: int, x: F8, a: int, of: I8, count: int) -> None:
    """row + the component ``a`` of the detections ``of``."""
    for k in range(count):
        work[row, k] += x[a, of[k]]


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
def _felt(
    x: F8, noise: F8, j: int, order: I8, r: int, mean: F8, cov: F8, reach: F8, far: F8, shown: F8, which: I8, of: I8,
    count: int,
) -> int:  # fmt: skip
    """Put detection ``j`` with the Gaussians that no component alone puts out of its reach behind the pairs; how many.

    ``far`` (M,) and ``shown`` (2, r) are scratch.
    """
    if r == BOX:
        for a in range(r):
            shown[0, a], shown[1, a] = x[order[a], j], noise[j, order[a], order[a]]
        _beyond_box(shown[0], shown[1], mean, cov, reach, far)
    else:
        for m in range(reach.size):
            far[m] = -reach[m]
        for a in range(r):
            _beyond(x[order[a], j], noise[j, order[a], order[a]], a, mean, cov, reach, far)
    for m in range(reach.size):
        which[count], of[count] = m, j
        count += not far[m] > 0.0
    return count


@njit(**INNER)
def _gathered(x: F8, noise: F8, order: I8, r: int, mean: F8, cov: F8, which: I8, of: I8, count: int, work: F8) -> None:
    """The Gaussians with their detections' noise, and the steps from their means, of all pairs, into ``work``."""
    d = order.size
    for a in range(d):
        for c in range(a + 1):
            e = a * (a + 1) // 2 + c
            _put(work, e, cov, e, which, count, 1.0)
            if a < r:
                _plus(work, e, noise, order[a], order[c], of, count)
        step = d * (d + 1) // 2 + a
        _put(work, step, mean, a, which, count, -1.0)
        if a < r:
            _from(work, step, x, order[a], of, count)


@njit(**INNER)
def _summed(work: F8, weight: F8, of: I8, count: int, order: I8, r: int, total: F8, x: F8, p: F8) -> None:
    """Add Gaussians to their detections: their weights, and, of what is not shown, first and second moments."""
    d = order.size
    side = d * (d + 1) // 2
    for k in range(count):
        j, w = of[k], weight[k]
        total[j] += w
        for a in range(r, d):
            x[order[a], j] -= w * work[side + a, k]
            for c in range(r, a + 1):
                value = work[a * (a + 1) // 2 + c, k] + work[side + a, k] * work[side + c, k]
                p[j, order[a], order[c]] += w * value


@njit(**INNER)
def _uniform(x: F8, p: F8, order: I8, r: int, flat: float, total: F8) -> None:
    """Begin the sums of `_summed` with the uniform part."""
    d = order.size
    for j in range(total.size):
        total[j] = flat
        for a in range(r, d):
            for c in range(r, d):
                p[j, order[a], order[c]] = flat * (p[j, order[a], order[c]] + x[order[a], j] * x[order[c], j])
        for a in range(r, d):
            x[order[a], j] *= flat


@njit(**INNER)
def _centred(x: F8, p: F8, order: I8, r: int, total: F8) -> None:
    """From the sums of `_summed` to means and covariances."""
    d = order.size
    for j in range(total.size):
        for a in range(r, d):
            x[order[a], j] /= total[j]
        for a in range(r, d):
            for c in range(r, a + 1):
                i, s = order[a], order[c]
                p[j, i, s] = p[j, i, s] / total[j] - x[i, j] * x[s, j]
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
    x, p, total, far, shown = state.copy(), noise.copy(), np.empty(n), np.empty(many), np.empty((2, r))
    # Several detections at a time: loops over few Gaussians are not worth their start.
    room = many + BATCH
    work, which, of = np.empty((d * (d + 3) // 2, room)), np.empty(room, np.int64), np.empty(room, np.int64)
    inverse, weight, square, distance2 = np.empty(room), np.empty(room), np.empty(room), np.empty(room)
    _uniform(x, p, order, r, flat, total)
    count = 0 * n
    for j in range(n):
        count = _felt(state, noise, j, order, r, mean, cov, reach, far, shown, which, of, count)
        if count == 0 or (count < BATCH and j < n - 1):
            continue
        _gathered(state, noise, order, r, mean, cov, which, of, count, work)
        for k in range(count):
            square[k], distance2[k] = peak2[which[k]], 0.0
        _eliminated(work, r, d, inverse, weight, square, distance2, count)
        for k in range(count):
            weight[k] = np.sqrt(square[k]) * np.exp(-0.5 * distance2[k])
        _summed(work, weight, of, count, order, r, total, x, p)
        count = 0 * n
    _centred(x, p, order, r, total)
    for j in range(n):
        for a in range(r):
            if not low[a] <= state[order[a], j] <= high[a]:
                total[j] = 0.0
    return total, x, p


@njit(**INNER)
def uncorrelated(deviation: F8) -> F8:
    """(n, d, d) covariances of noise with these deviations (d, n)."""
    d, n = deviation.shape
    noise = np.empty((n, d, d))
    for j in range(n):
        for a in range(d):
            for c in range(d):
                noise[j, a, c] = 0.0
            noise[j, a, a] = deviation[a, j] * deviation[a, j]
    return noise


@njit(**INNER)
def newborn_velocities(x: F8, p: F8, first: int, second: int) -> F4:
    """(5, n) of two components of states (d, n), (n, d, d): their means, and the lower triangle that turns a velocity of
    uniform direction and standard Gaussian amplitude into one of their covariance."""
    n = x.shape[1]
    velocity = np.empty((5, n), np.float32)
    for j in range(n):
        velocity[0, j], velocity[1, j] = x[first, j], x[second, j]
        # Amplitude times direction has half the variance an axis.
        root = np.sqrt(2.0 * p[j, first, first])
        slope = 2.0 * p[j, second, first] / root
        velocity[2, j], velocity[3, j] = root, slope
        velocity[4, j] = np.sqrt(max(2.0 * p[j, second, second] - slope * slope, 0.0))
    return velocity


@njit(**ENTRY)
def newborn_about(
    state: F8, deviation: F8, scale: float, order: I8, r: int, low: F8, high: F8, flat: float, mean: F8, cov: F8,
    peak2: F8, reach: F8,
) -> tuple[F4, F4]:  # fmt: skip
    """`given_detections` in one call for noise without correlations, as the fused particle filter reads it.

    ``deviation`` (d, n) are its standard deviations; the others are as there. Returns ``scale`` times the densities (n,),
    and (5, n) `newborn_velocities` of the two components that are not shown.
    """
    total, x, p = given_detections(state, uncorrelated(deviation), order, r, low, high, flat, mean, cov, peak2, reach)
    density = np.empty(total.size, np.float32)
    for j in range(total.size):
        density[j] = scale * total[j]
    return density, newborn_velocities(x, p, order[r], order[r + 1])
