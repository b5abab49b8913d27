"""Newborn particles around the measurements: their states, and the density of their proposal.

The newborn of measurement j are the columns first[j] … first[j + 1] − 1. All of a frame are placed
from one table of points of a truncated standard Gaussian, of which each measurement uses its own
stretch: the newborn of each follow the proposal exactly; those of two measurements in one frame are
not independent of each other, which changes no expectation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from phdtrack.kernels import F8, I8, Real
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, FAST, VECTOR, F, cos_sin_turn, exp_of
from phdtrack.kernels.grid import make_grid, overlapping
from phdtrack.kernels.triangular import invert_lower

GOLDEN = 0.6180339887498949
U = np.uint64


class Proposal(NamedTuple):
    """The Gaussians about N measurements that newborn particles are drawn from.

    ``mean`` (d, N) states; ``rows`` (r,) of the state that measurements show; ``root``, ``inverse``
    (N, r, r): Cholesky factor of the covariance in these rows and its inverse; ``velocity`` (N, 2,
    2): factor for velocities; ``peak`` (N,): density at the mean, times J_j; ``reach`` (2, N): half
    the extent in position.
    """

    mean: F8
    rows: I8
    root: F8
    inverse: F8
    velocity: F8
    peak: F8
    reach: F8


@njit(**ENTRY)
def proposals(mean: F8, cov: F8, rows: I8, counts: I8, limit: float, kept: float) -> Proposal:
    """The proposals from states (d, N) and covariances (N, d, d), for ``counts`` (N,) newborn of
    each measurement.

    ``rows`` (r,) of the state are shown by measurements. ``limit``, ``kept``: the squared radius
    at which a Gaussian is truncated, and its mass inside.
    """
    count = counts.size
    r = rows.size
    root = np.zeros((count, r, r))
    inverse = np.zeros((count, r, r))
    velocity = np.empty((count, 2, 2))
    peak = np.empty(count)
    reach = np.empty((2, count))
    for j in range(count):
        peak[j] = counts[j] / (kept * (2.0 * np.pi) ** (0.5 * r))
        for a in range(r):
            for b in range(a + 1):
                rest = cov[j, rows[a], rows[b]]
                for c in range(b):
                    rest -= root[j, a, c] * root[j, b, c]
                root[j, a, b] = np.sqrt(rest) if a == b else rest / root[j, b, b]
            peak[j] /= root[j, a, a]
        invert_lower(root[j], inverse[j])
        for a in range(reach.shape[0]):
            reach[a, j] = np.sqrt(limit * cov[j, rows[a], rows[a]])
        # The covariance of a uniform direction and a Gaussian amplitude is half the amplitude's
        # variance.
        velocity[j, 0, 0] = np.sqrt(2.0 * cov[j, 2, 2])
        velocity[j, 0, 1] = 0.0
        velocity[j, 1, 0] = 2.0 * cov[j, 3, 2] / velocity[j, 0, 0] if cov[j, 2, 2] > 0.0 else 0.0
        velocity[j, 1, 1] = np.sqrt(max(2.0 * cov[j, 3, 3] - velocity[j, 1, 0] ** 2, 0.0))
    return Proposal(mean, rows, root, inverse, velocity, peak, reach)


@njit(**ENTRY)
def standard_points(normal: Real, uniform: F8, radii: F8) -> Real:
    """(r + 3, P) standard Gaussian vectors inside a truncated region, velocities, and exp(−r²/2) of
    each vector.

    The quantiles of the radii are a golden-section sequence, so that every stretch of the points
    covers all radii: the importance weights of a flat γ depend on the radius alone, and a thousand
    independent ones would leave the mass of the newborn uncertain by 9 %. Velocities have uniform
    direction and standard Gaussian amplitude [M07 §2]. ``normal`` (r + 1, P): standard normal
    numbers; ``uniform`` (P + 1,): uniform ones; ``radii`` (K,): at equal steps of the quantile.
    """
    r = normal.shape[0] - 1
    count = normal.shape[1]
    out = np.empty((r + 3, count), normal.dtype)
    cells = radii.size - 1
    real = normal.dtype.type
    for i in range(count):
        turn = uniform[count] + GOLDEN * i
        place = (turn - np.floor(turn)) * cells
        below = min(int(place), cells - 1)
        radius = radii[below] + (radii[below + 1] - radii[below]) * (place - below)
        square = 0.0
        for a in range(r):
            square += normal[a, i] * normal[a, i]
        for a in range(r):
            out[a, i] = normal[a, i] * radius / np.sqrt(square)
        cosine, sine = cos_sin_turn(F(uniform[i]))
        out[r, i] = normal[r, i] * cosine
        out[r + 1, i] = normal[r, i] * sine
        out[r + 2, i] = exp_of(real(-0.5 * radius * radius))
    return out


@njit(**(ENTRY | {"fastmath": FAST}))
def place_newborn(
    about: Proposal, points: Real, begin: I8, first: I8, limit: float, out: Real, density: Real
) -> None:
    """Write newborn states into ``out`` (d, L), and Σ_i J_i p_i(x) there into ``density`` (L,) [M07
    §2].

    Those of each measurement use ``points`` (r + 3, P) from ``begin`` (N,) on. p_i is truncated at
    the squared radius ``limit``.
    """
    mean, rows, root, inverse, velocity, peak, reach = about
    count = mean.shape[1]
    r = rows.size
    real = out.dtype.type
    lower = mean[:2] - reach
    upper = mean[:2] + reach
    grid = make_grid(lower, upper, 0.0, 0.0)
    near = np.empty(count, np.int64)
    squares = np.empty(np.max(np.diff(first)), out.dtype)
    for j in range(count):
        n = first[j + 1] - first[j]
        if n == 0:
            continue
        _place(mean, rows, root, velocity, points, j, begin[j], first[j], n, out)
        at = U(first[j])
        own = real(peak[j])
        source = U(begin[j])
        for i in range(U(n)):
            # Its own proposal by the radius: rounding could put a particle on the rim of the region
            # outside.
            density[at + i] = own * points[r + 2, source + i]
        some = overlapping(lower[0, j], lower[1, j], upper[0, j], upper[1, j], grid, near)
        for m in range(some):
            k = near[m]
            if k != j and peak[k] > 0.0:
                _squares(mean, rows, inverse, k, first[j], n, out, squares)
                scale = real(peak[k])
                rim = real(limit)
                zero = real(0)
                half = real(-0.5)
                for i in range(U(n)):
                    value = scale * exp_of(half * squares[i])
                    density[at + i] += value if squares[i] <= rim else zero


@njit(**VECTOR)
def _place(
    mean: F8,
    rows: I8,
    root: F8,
    velocity: F8,
    points: Real,
    j: int,
    begin: int,
    first: int,
    n: int,
    out: Real,
) -> None:
    """Write n states of measurement ``j`` from column ``first`` on, using the points from ``begin``
    on.
    """
    at = U(first)
    source = U(begin)
    r = rows.size
    real = out.dtype.type
    for a in range(mean.shape[0]):
        middle = real(mean[a, j])
        for i in range(U(n)):
            out[a, at + i] = middle
    for a in range(r + 2):
        row = U(rows[a] if a < r else 2 + a - r)
        lower = 0 if a < r else r
        for c in range(lower, a + 1):
            scale = real(root[j, a, c] if a < r else velocity[j, a - r, c - r])
            if scale != real(0):
                for i in range(U(n)):
                    out[row, at + i] += scale * points[c, source + i]


@njit(**VECTOR)
def _squares(
    mean: F8, rows: I8, inverse: F8, k: int, first: int, n: int, state: Real, squares: Real
) -> None:
    """Write the squared distances of n states from measurement ``k``."""
    at = U(first)
    r = rows.size
    real = state.dtype.type
    for i in range(U(n)):
        squares[i] = real(0)
    for a in range(r):
        diagonal = True
        for c in range(a):
            diagonal &= inverse[k, a, c] == 0.0
        if diagonal:
            row = U(rows[a])
            scale = real(inverse[k, a, a])
            middle = real(mean[rows[a], k])
            for i in range(U(n)):
                part = scale * (state[row, at + i] - middle)
                squares[i] += part * part
        else:
            for i in range(U(n)):
                part = real(0)
                for c in range(a + 1):
                    part += real(inverse[k, a, c]) * (
                        state[U(rows[c]), at + i] - real(mean[rows[c], k])
                    )
                squares[i] += part * part
