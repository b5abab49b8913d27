"""Newborn particles around the measurements: where they lie, and the density of the proposal that they were drawn from.

The newborn of measurement j are the columns first[j] … first[j + 1] − 1. All of a frame are placed from one table of points
of a truncated standard Gaussian, of which each measurement takes its own stretch: each one's newborn follow the proposal
exactly; those of two measurements in one frame are not independent of each other, which changes no expectation.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, FAST, HALF, exp32
from phdtrack.kernels.grid import make_grid, overlapping

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
F = np.float32
GOLDEN = 0.6180339887498949
U = np.uint64
Real = NDArray[np.floating[Any]]


class Proposal(NamedTuple):
    """The Gaussians about N measurements that newborn particles are drawn from.

    ``mean`` (d, N) states; ``rows`` (r,) of the state that measurements show; ``root``, ``inverse`` (N, r, r) the Cholesky
    factor of what is shown and its inverse; ``velocity`` (N, 2, 2) a factor for velocities; ``peak`` (N,) the density at the
    mean, J_j of them together; ``reach`` (2, N) half the extent in position.
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
    """The proposals from states (d, N) and covariances (N, d, d).

    Parameters
    ----------
    rows, counts : (r,) rows of the state that measurements show, and (N,) newborn of each measurement.
    limit, kept : the squared radius at which a Gaussian is cut, and the part of it inside.
    """
    count, r = counts.size, rows.size
    root, inverse, velocity = np.zeros((count, r, r)), np.zeros((count, r, r)), np.empty((count, 2, 2))
    peak, reach = np.empty(count), np.empty((2, count))
    for j in range(count):
        peak[j] = counts[j] / (kept * (2.0 * np.pi) ** (0.5 * r))
        for a in range(r):
            for b in range(a + 1):
                rest = cov[j, rows[a], rows[b]]
                for c in range(b):
                    rest -= root[j, a, c] * root[j, b, c]
                root[j, a, b] = np.sqrt(rest) if a == b else rest / root[j, b, b]
            peak[j] /= root[j, a, a]
            inverse[j, a, a] = 1.0 / root[j, a, a]
            for b in range(a):
                total = 0.0
                for c in range(b, a):
                    total += root[j, a, c] * inverse[j, c, b]
                inverse[j, a, b] = -total / root[j, a, a]
        for a in range(reach.shape[0]):
            reach[a, j] = np.sqrt(limit * cov[j, rows[a], rows[a]])
        # The covariance of a uniform direction and a Gaussian amplitude is half the amplitude's variance.
        velocity[j, 0, 0], velocity[j, 0, 1] = np.sqrt(2.0 * cov[j, 2, 2]), 0.0
        velocity[j, 1, 0] = 2.0 * cov[j, 3, 2] / velocity[j, 0, 0] if cov[j, 2, 2] > 0.0 else 0.0
        velocity[j, 1, 1] = np.sqrt(max(2.0 * cov[j, 3, 3] - velocity[j, 1, 0] ** 2, 0.0))
    return Proposal(mean, rows, root, inverse, velocity, peak, reach)


@njit(**ENTRY)
def standard_points(normal: F8, uniform: F8, radii: F8) -> F8:
    """(r + 3, P) standard Gaussian vectors inside a truncated region, velocities, and exp(−r²/2) of each vector.

    The quantiles of the radii are a golden-section sequence, so that every stretch of the points has about every radius: the
    importance weights of a flat γ follow the radius alone, and a thousand independent ones would leave the mass of the
    newborn uncertain by 9 %. Velocities have uniform direction and standard Gaussian amplitude [M07 §2].

    Parameters
    ----------
    normal, uniform : (r + 1, P), (P + 1,) standard normal numbers and uniform ones.
    radii : (K,) the radii at equal steps of the quantile.
    """
    r, count = normal.shape[0] - 1, normal.shape[1]
    out, cells = np.empty((r + 3, count)), radii.size - 1
    for i in range(count):
        turn = uniform[count] + GOLDEN * i
        place = (turn - np.floor(turn)) * cells
        below = min(int(place), cells - 1)
        radius, square = radii[below] + (radii[below + 1] - radii[below]) * (place - below), 0.0
        for a in range(r):
            square += normal[a, i] * normal[a, i]
        for a in range(r):
            out[a, i] = normal[a, i] * radius / np.sqrt(square)
        angle = 2.0 * np.pi * uniform[i]
        out[r, i], out[r + 1, i] = normal[r, i] * np.cos(angle), normal[r, i] * np.sin(angle)
        out[r + 2, i] = np.exp(-0.5 * radius * radius)
    return out


@njit(**(ENTRY | {"fastmath": FAST}))
def place_newborn(about: Proposal, points: Real, begin: I8, first: I8, out: Real) -> None:
    """Write newborn states into ``out`` (d, L), from ``points`` (r + 2, P), of each measurement from ``begin`` (N,) on."""
    d, count = about.mean.shape
    r, real = about.rows.size, out.dtype.type
    for j in range(count):
        at, n, source = U(first[j]), first[j + 1] - first[j], U(begin[j])
        for a in range(d):
            middle = real(about.mean[a, j])
            for i in range(U(n)):
                out[a, at + i] = middle
        for a in range(r):
            row = U(about.rows[a])
            for c in range(a + 1):
                factor = real(about.root[j, a, c])
                if factor != real(0):
                    for i in range(U(n)):
                        out[row, at + i] += factor * points[c, source + i]
        for a in range(2):
            for c in range(a + 1):
                factor = real(about.velocity[j, a, c])
                if factor != real(0):
                    for i in range(U(n)):
                        out[2 + a, at + i] += factor * points[r + c, source + i]


@njit(**(ENTRY | {"fastmath": FAST}))
def proposal_density(about: Proposal, shown: Real, first: I8, own: Real, begin: I8, limit: float) -> Real:
    """(L,) Σ_i J_i p_i(x) at newborn particles that show ``shown`` (r, L) [M07 §2].

    p_i is cut at the squared radius ``limit``. ``own`` (P,): exp(−r²/2) of the points that a measurement's own newborn were
    placed from: on the rim of its region rounding could put a particle outside.
    """
    r, count = shown.shape[0], first.size - 1
    lower, upper = about.mean[:2] - about.reach, about.mean[:2] + about.reach
    grid, found = make_grid(lower, upper, 0.0, 0.0), np.empty(count, np.int64)
    longest = 0
    for j in range(count):
        longest = max(longest, first[j + 1] - first[j])
    real = shown.dtype.type
    out, squares, part = np.empty(first[count]), np.empty(longest, shown.dtype), np.empty(longest, shown.dtype)
    for j in range(count):
        at, n = first[j], first[j + 1] - first[j]
        if n == 0:
            continue
        for i in range(n):
            out[at + i] = about.peak[j] * own[begin[j] + i]
        for m in range(overlapping(lower[0, j], lower[1, j], upper[0, j], upper[1, j], grid, found)):
            k = found[m]
            if k == j or about.peak[k] == 0.0:
                continue
            for i in range(n):
                squares[i] = real(0)
            for a in range(r):
                for i in range(n):
                    part[i] = real(0)
                for c in range(a + 1):
                    factor, middle = real(about.inverse[k, a, c]), real(about.mean[about.rows[c], k])
                    if factor != real(0):
                        for i in range(n):
                            part[i] += factor * (shown[c, at + i] - middle)
                for i in range(n):
                    squares[i] += part[i] * part[i]
            peak, rim = about.peak[k], real(limit)
            for i in range(n):
                density = peak * float(exp32(-HALF * F(squares[i])))
                out[at + i] += density if squares[i] <= rim else 0.0
    return out


@njit(**ENTRY)
def density_within(shown: Real, first: I8, lower: F8, upper: F8, density: F8) -> F8:
    """(L,) Σ_k density_k over the boxes ``lower``, ``upper`` (r, N) of measurement space that hold each of ``shown`` (r, L).

    Particles lie in runs, ``first`` (M + 1,), of which each is asked for its neighbours once.
    """
    r, count = shown.shape[0], first.size - 1
    grid, found = make_grid(lower[:2].copy(), upper[:2].copy(), 0.0, 0.0), np.empty(lower.shape[1], np.int64)
    out, held = np.zeros(shown.shape[1]), np.empty(shown.shape[1], np.bool_)
    for j in range(count):
        begin, end = first[j], first[j + 1]
        if end == begin:
            continue
        left, top, right, bottom = np.inf, np.inf, -np.inf, -np.inf
        for i in range(begin, end):
            x, y = shown[0, i], shown[1, i]
            left, right, top, bottom = min(left, x), max(right, x), min(top, y), max(bottom, y)
        for m in range(overlapping(left, top, right, bottom, grid, found)):
            k = found[m]
            for i in range(begin, end):
                held[i] = True
            for a in range(r):
                low, high = lower[a, k], upper[a, k]
                for i in range(begin, end):
                    held[i] &= (shown[a, i] >= low) & (shown[a, i] <= high)
            for i in range(begin, end):
                out[i] += density[k] if held[i] else 0.0
    return out
