"""The steps of the Rauch–Tung–Striebel smoother over n Gaussians at once [R65]; their formulas:
docs/methods.md, Smoothing.

Means are (n, d), covariances (n, d, d), measurements (n, r); all C-contiguous.
"""

from __future__ import annotations

import math

import numpy as np

from phdtrack.kernels import F8, I8, Bool
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER

# A pivot that is smaller than this share of its own diagonal element is rounding: the matrix is
# singular there.
_SINGULAR = 1e-14


@njit(**INNER)
def _factor(a: F8, low: F8) -> float:
    """Fill ``low`` with the factors of a = L D Lᵀ, D on the diagonal, 0 where a is singular;
    returns log |a| of the regular part.
    """
    log_determinant = 0.0
    for j in range(a.shape[0]):
        pivot = a[j, j]
        for k in range(j):
            pivot -= low[j, k] * low[j, k] * low[k, k]
        if pivot > _SINGULAR * a[j, j]:
            log_determinant += math.log(pivot)
        else:
            pivot = 0.0
        low[j, j] = pivot
        for i in range(j + 1, a.shape[0]):
            total = a[i, j]
            for k in range(j):
                total -= low[i, k] * low[j, k] * low[k, k]
            low[i, j] = total / pivot if pivot > 0.0 else 0.0
    return log_determinant


@njit(**INNER)
def _solved(low: F8, b: F8) -> None:
    """Replace ``b`` (d, m) by a⁻¹ b, with 0 in the components in which a is singular."""
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
    """Add a b aᵀ to ``out``, both symmetric; ``between`` is scratch for a b."""
    _multiplied(a, b, between)
    for i in range(a.shape[0]):
        for j in range(i + 1):
            total = out[i, j]
            for k in range(a.shape[1]):
                total += between[i, k] * a[j, k]
            out[i, j] = out[j, i] = total


@njit(**ENTRY)
def predicted(covariance: F8, jacobian: F8, noise: F8) -> F8:
    """(n, d, d) F P Fᵀ + Q."""
    out = noise.copy()
    between = np.empty(covariance.shape[1:])
    for n in range(len(covariance)):
        _add_turned(jacobian[n], covariance[n], between, out[n])
    return out


@njit(**INNER)
def _room(d: int, r: int) -> tuple[F8, F8, F8, F8, F8, F8, F8]:
    """Scratch arrays of an update."""
    small = np.empty((2, r, r))
    wide = np.empty((2, d, r))
    square = np.empty((2, d, d))
    return small[0], small[1], np.empty((r, d)), wide[0], wide[1], square[0], square[1]


@njit(**INNER)
def _update(
    mean: F8, covariance: F8, step: F8, noise: F8, rows: I8, room: tuple[F8, ...], out: F8
) -> None:
    """Fill ``mean`` and ``out`` with the Gaussian given a measurement of these rows, whose
    innovation is ``step`` (r,).
    """
    s, low, part, gain, narrow, left, between = room
    for i in range(len(rows)):
        for j in range(len(mean)):
            part[i, j] = covariance[rows[i], j]
        for j in range(len(rows)):
            s[i, j] = covariance[rows[i], rows[j]] + noise[i, j]
    _factor(s, low)
    _solved(low, part)
    left[:] = 0.0
    for i in range(len(mean)):
        left[i, i] = 1.0
        for j in range(len(rows)):
            gain[i, j] = part[j, i]
            left[i, rows[j]] -= part[j, i]
            mean[i] += part[j, i] * step[j]
    out[:] = 0.0
    _add_turned(left, covariance, between, out)
    _add_turned(gain, noise, narrow, out)


@njit(**ENTRY)
def updated(mean: F8, covariance: F8, z: F8, noise: F8, rows: I8) -> tuple[F8, F8]:
    """Means and covariances given measurements of these rows of the state."""
    mean_out = mean.copy()
    out = np.empty(covariance.shape)
    room = _room(mean.shape[1], len(rows))
    for n in range(len(mean)):
        _update(mean_out[n], covariance[n], z[n] - mean[n][rows], noise[n], rows, room, out[n])
    return mean_out, out


@njit(**ENTRY)
def smooth(
    now: tuple[F8, F8], ahead: tuple[F8, F8, F8, F8], later: tuple[F8, F8], onward: Bool
) -> None:
    """Replace filtered Gaussians by those given the smoothed ones of the next frame, the last
    first, if ``onward``.

    ``now`` and ``later`` (smoothed) are means and covariances, ``ahead`` those of the predictions
    with their Jacobians and noises.
    """
    mean, covariance = now
    predicted_mean, predicted_covariance, jacobian, noise = ahead
    d = mean.shape[1]
    low = np.empty((d, d))
    part = np.empty((d, d))
    gain = np.empty((d, d))
    left = np.empty((d, d))
    between = np.empty((d, d))
    added = np.empty((d, d))
    before = np.empty((d, d))
    for n in range(len(mean) - 1, -1, -1):
        if not onward[n]:
            continue
        _factor(predicted_covariance[n], low)
        _multiplied(jacobian[n], covariance[n], part)
        _solved(low, part)
        for i in range(d):
            for j in range(d):
                gain[i, j] = part[j, i]
                mean[n, i] += part[j, i] * (later[0][n, j] - predicted_mean[n, j])
                added[i, j] = noise[n, i, j] + later[1][n, i, j]
                before[i, j] = covariance[n, i, j]
        _multiplied(gain, jacobian[n], between)
        for i in range(d):
            for j in range(d):
                left[i, j] = 0.0 - between[i, j]
            left[i, i] += 1.0
        covariance[n] = 0.0
        _add_turned(left, before, between, covariance[n])
        _add_turned(gain, added, between, covariance[n])


@njit(**INNER)
def log_density(step: F8, covariance: F8, noise: F8, rows: I8, first: int, room: F8) -> float:
    """Log density, without constants, of the innovation ``step`` (r,), whose covariance is H P Hᵀ +
    R: of n components of the measurement from the ``first`` on, with scratch ``room`` (3, n, n).
    """
    s = room[0]
    low = room[1]
    v = room[2, :, :1]
    size = room.shape[1]
    for i in range(size):
        v[i, 0] = step[first + i]
        for j in range(size):
            s[i, j] = covariance[rows[first + i], rows[first + j]] + noise[first + i, first + j]
    total = _factor(s, low)
    _solved(low, v)
    for i in range(size):
        total += step[first + i] * v[i, 0]
    return float(-0.5 * total)


@njit(**INNER)
def _copy(matrix: F8, out: F8) -> None:
    """Copy a matrix. Numba's own assignment compiles its error messages, too, for a second."""
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            out[i, j] = matrix[i, j]


@njit(**INNER)
def _scale_noise(noise: F8, factor: F8, out: F8) -> None:
    """Scale the noise (d, d) of a motion by a path's factors (d,)."""
    for i in range(len(factor)):
        for j in range(len(factor)):
            out[i, j] = noise[i, j] * factor[i] * factor[j]


@njit(**ENTRY)
def filtered(
    at: I8,
    now: tuple[F8, F8],
    ahead: tuple[F8, F8, F8],
    kept: tuple[F8, F8, F8, F8],
    measured: tuple[F8, F8, I8],
    scales: tuple[F8, F8],
    evidence: F8,
) -> None:
    """Predict Gaussians of one frame for the next one and update each with its measurement there.

    ``at`` (n, 4): row of each in ``now`` (means and covariances), its row in the next frame, its
    path, the column of its measurement, −1 for none. ``ahead``: means, Jacobians and noises of the
    motion. ``kept``: predictions, Jacobians and noises, filled if they are not empty.
    ``measured``: measurements as states (d, Z), covariances, and the rows that they show.
    ``scales`` (K, d), (K, r): factors of each path's noises. Adds to ``evidence`` (2, K).
    """
    mean, covariance = now
    moved, jacobian, noise = ahead
    state, spread, rows = measured
    d = mean.shape[1]
    r = len(rows)
    added = np.empty((d, d))
    between = np.empty((d, d))
    prediction = np.empty((d, d))
    own = np.empty((r, r))
    step = np.empty(r)
    # The first two components of a measurement, and the others.
    room = _room(d, r)
    half = min(2, r)
    place = np.empty((3, half, half))
    size = np.empty((3, r - half, r - half))
    for n in range(len(at)):
        before = at[n, 0]
        here = at[n, 1]
        path = at[n, 2]
        column = at[n, 3]
        _scale_noise(noise[n], scales[0][path], added)
        _copy(added, prediction)
        _add_turned(jacobian[n], covariance[before], between, prediction)
        for i in range(d):
            mean[here, i] = moved[n, i]
        if len(kept[0]):
            for i in range(d):
                kept[0][here, i] = moved[n, i]
            _copy(prediction, kept[1][here])
            _copy(jacobian[n], kept[2][here])
            _copy(added, kept[3][here])
        if column < 0:
            _copy(prediction, covariance[here])
            continue
        for i in range(r):
            step[i] = state[rows[i], column] - moved[n, rows[i]]
            for j in range(r):
                own[i, j] = (
                    spread[column, rows[i], rows[j]] * scales[1][path, i] * scales[1][path, j]
                )
        # A literal 0 would be a type of its own, and compiled for.
        evidence[0, path] += log_density(step, prediction, own, rows, np.int64(0), place)
        evidence[1, path] += log_density(step, prediction, own, rows, half, size)
        _update(mean[here], prediction, step, own, rows, room, covariance[here])
