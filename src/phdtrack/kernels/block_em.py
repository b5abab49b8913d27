"""Expectation and maximisation over blocks of particles: one iteration for a Gaussian mixture [M09 §III-B].

A block that only one component reaches belongs to it wholly, and its sums are known. In the others each particle is shared
in the ratio of the components' densities there.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.blocks import Real, load_steps, load_weight, products, sums, weigh, whole
from phdtrack.kernels.cache import njit
from phdtrack.kernels.clustering import add_part, centred
from phdtrack.kernels.fast32 import ENTRY, FAST, VECTOR, exp32
from phdtrack.kernels.overlaps import overlapping, rectangle_grid

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]


@njit(**VECTOR)
def reaches(centre: F8, scale: F8, reach: float, alive: F8) -> tuple[F8, F8]:
    """Corners (2, k) of the rectangles that the centres reach."""
    k = centre.shape[1]
    lower, upper = np.empty((2, k)), np.empty((2, k))
    for j in range(k):
        for r in range(2):
            half = reach * scale[r, j] if alive[j] > 0.0 else 0.0
            lower[r, j], upper[r, j] = centre[r, j] - half, centre[r, j] + half
    if not np.isfinite(lower.sum() + upper.sum()):
        raise ValueError("centres and their deviations must be finite")
    return lower, upper


@njit(**VECTOR)
def reaching(
    known: F8, b: int, d: int, lower: F8, upper: F8, frame: F8, cells: I8, item: I8, corner: I8, alive: F8, near: I8
) -> int:
    """Write into ``near`` (k,) the living components that reach into block b's box, ascending; how many."""
    left, top, right, bottom = known[b, 1], known[b, 2], known[b, 1 + d], known[b, 2 + d]
    found = overlapping(left, top, right, bottom, lower, upper, frame, cells, item, corner, near)
    count = 0
    for c in range(found):
        j = near[c]
        if alive[j] > 0.0:
            at = count
            while at > 0 and near[at - 1] > j:
                near[at] = near[at - 1]
                at -= 1
            near[at] = j
            count += 1
    return count


@njit(**VECTOR)
def holds(lower: F8, upper: F8, j: int, known: F8, b: int, d: int) -> bool:
    """Whether rectangle j holds all of block b's box."""
    inside: bool = lower[0, j] <= known[b, 1] and known[b, 1 + d] <= upper[0, j]
    return inside and lower[1, j] <= known[b, 2] and known[b, 2 + d] <= upper[1, j]


@njit(**VECTOR)
def whitening(cov: F8) -> tuple[F8, F8]:
    """A = L⁻¹ (k, d, d) with Σ = L·Lᵀ, so that |A(x − m)|² = (x − m)ᵀ Σ⁻¹ (x − m), and −½ log|Σ| (k,)."""
    k, d = cov.shape[0], cov.shape[1]
    inverse, log_scale = np.zeros((k, d, d)), np.zeros(k)
    factor = np.zeros((d, d))
    for j in range(k):
        for r in range(d):
            for s in range(r + 1):
                rest = cov[j, r, s]
                for q in range(s):
                    rest -= factor[r, q] * factor[s, q]
                # A covariance that rounding left without a direction is as thin there as a number can tell.
                factor[r, s] = math.sqrt(max(rest, 1e-300)) if r == s else rest / factor[s, s]
            log_scale[j] -= math.log(factor[r, r])
            inverse[j, r, r] = 1.0 / factor[r, r]
            for s in range(r):
                total = 0.0
                for q in range(s, r):
                    total += factor[r, q] * inverse[j, q, s]
                inverse[j, r, s] = -total / factor[r, r]
    return inverse, log_scale


@njit(**VECTOR)
def log_density(
    step: Real, n: int, centre: F8, known: F8, b: int, inverse: F8, constant: float, half: F8, j: int, shifted: Real,
    part: Real, out: Real,
) -> None:  # fmt: skip
    """log(wⱼ·N(x; mⱼ, Σⱼ)) up to a common constant for n particles; −∞ where they are out of reach."""
    real = step.dtype.type
    d = centre.shape[0]
    for i in range(n):
        out[i] = real(0)
    for r in range(d):
        row, to, at = step[r], shifted[r], real(centre[r, j] - known[b, 1 + 2 * d + r])
        for i in range(n):
            to[i] = row[i] - at
        for i in range(n):
            part[i] = real(0)
        for s in range(r + 1):
            row, factor = shifted[s], real(inverse[j, r, s])
            for i in range(n):
                part[i] += factor * row[i]
        for i in range(n):
            out[i] += part[i] * part[i]
    x, y, rx, ry = shifted[0], shifted[1], real(half[0, j]), real(half[1, j])
    top, minus, nothing = real(constant), real(-0.5), real(-np.inf)
    for i in range(n):
        out[i] = top + minus * out[i] if (abs(x[i]) <= rx) & (abs(y[i]) <= ry) else nothing


@njit(**VECTOR)
def responsibilities(table: Real, count: int, n: int, weight: Real, top: Real, total: Real) -> None:
    """Turn the log densities in ``table`` (≥ count, ≥ n) into the weight of each particle that each component has."""
    real = table.dtype.type
    for i in range(n):
        top[i] = table[0, i]
        total[i] = real(0)
    for c in range(1, count):
        row = table[c]
        for i in range(n):
            top[i] = row[i] if row[i] > top[i] else top[i]
    for c in range(count):
        row = table[c]
        for i in range(n):
            # Nobody reaches the particle where the best is −∞; nobody shall have it.
            near = row[i] > real(-np.inf)
            row[i] = real(exp32(np.float32(row[i] - top[i]))) if near else real(0)
            total[i] += row[i]
    for i in range(n):
        total[i] = weight[i] / total[i] if total[i] > real(0) else real(0)
    for c in range(count):
        row = table[c]
        for i in range(n):
            row[i] *= total[i]


@njit(**(ENTRY | {"fastmath": FAST}))
def em_step(
    state: Real, weight: Real, start: I8, known: F8, most: int, first: F8, second: F8,
    amount: F8, centre: F8, cov: F8, scale: F8, reach: float,
) -> tuple[F8, F8, F8]:  # fmt: skip
    """Masses (k,), means (d, k) and covariances (k, d, d) after one iteration from ``amount``, ``centre`` and ``cov``.

    ``scale`` (d, k): a component reaches ``reach`` of these deviations in position. The blocks: ``known`` and ``second`` of
    `blocks.summarise`, ``first`` (B, d) the sums of s that belong to ``second``, at most ``most`` particles in each.
    """
    d, k = centre.shape
    lower, upper = reaches(centre, scale, reach, amount)
    half = 0.5 * (upper - lower)
    frame, cells, item, corner = rectangle_grid(lower, upper)
    inverse, log_scale = whitening(cov)
    even = second.shape[1]
    near, table, width = np.empty(k, np.int64), np.empty((k, most), state.dtype), whole(most)
    scratch, shifted = np.zeros((2 * even + 1, width), state.dtype), np.zeros((even, most), state.dtype)
    w, part = np.empty((1, width), state.dtype), np.empty(most, state.dtype)
    total, mean, out = np.zeros(k), np.zeros((d, k)), np.zeros((k, d, d))
    shift, one, two, nothing = np.empty(d), np.empty(d), np.empty((even, even)), state.dtype.type(0)
    for b in range(start.size - 1):
        begin, n = start[b], start[b + 1] - start[b]
        if n == 0:
            continue
        count = reaching(known, b, d, lower, upper, frame, cells, item, corner, amount, near)
        if count == 1 and holds(lower, upper, near[0], known, b, d):
            j = near[0]
            for r in range(d):
                shift[r] = known[b, 1 + 2 * d + r] - centre[r, j]
            add_part(known[b, 0], first[b], second[b], shift, j, total, mean, out)
        elif count > 0:
            load_steps(state, begin, n, known, b, scratch)
            load_weight(weight, begin, n, w, 0)
            for c in range(count):
                j = near[c]
                constant = math.log(amount[j]) + log_scale[j]
                log_density(scratch, n, centre, known, b, inverse, constant, half, j, shifted, part, table[c])
            responsibilities(table, count, n, w[0], shifted[0], shifted[1])
            for c in range(count):
                j = near[c]
                for i in range(n):
                    scratch[2 * even, i] = table[c, i]
                for i in range(n, whole(n)):
                    scratch[2 * even, i] = nothing
                m = weigh(scratch, whole(n), d)
                sums(scratch, whole(n), even, one)
                products(scratch, whole(n), even, two)
                for r in range(d):
                    shift[r] = known[b, 1 + 2 * d + r] - centre[r, j]
                add_part(m, one, two, shift, j, total, mean, out)
    centred(k, total, mean, out, centre)
    return total, mean, out
