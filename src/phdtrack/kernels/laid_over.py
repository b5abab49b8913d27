"""A learned scene laid over births and false alarms that are spread around each detection (`models.learned_scene`)."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.gm_model import ABOUT, ENTRIES, FIXED, PLACES, ROWS, BoxNumbers, D, M, box_numbers, noise
from phdtrack.kernels.neighbourhoods import summed_densities
from phdtrack.kernels.scene_density import given_detections, mixture_density, newborn_velocities, uncorrelated

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

# Rows of the tables of boxes: what `given_detections` and `mixture_density` take of Gaussians, one below the other.
GIVEN_ROWS, MIXTURE_ROWS = D + ENTRIES + 2, M + M * (M + 1) // 2 + 1
# Columns of bounds behind what is flat: those below, and those above.
BOUNDS = 2 * M


@njit(**INNER)
def _around(z: F8, volume: float, reach: float, smallest: float, largest: float) -> F8:
    """(N,) l(z): Σ 1/V over the neighbourhoods, of ``volume`` w²h², in which each of the boxes ``z`` lies."""
    density = np.empty(z.shape[1])
    for j in range(density.size):
        area = z[2, j] * z[3, j]
        density[j] = 1.0 / (volume * (area * area))
    out: F8 = summed_densities(z[:4], density, reach, smallest, largest)
    return out


@njit(**ENTRY)
def laid_clutter(
    z: F8, rate: float, low: F8, high: F8, flat: F8, mean: F8, whiten: F8, log_peak: F8, beside: float, volume: float,
    reach: float, smallest: float, largest: float,
) -> F8:  # fmt: skip
    """(N,) ``beside`` l(z) + r̄ p(z|c) at boxes ``z`` (4 or more, N).

    ``rate`` to ``log_peak`` are as `context_density.mixture_density` takes them; a neighbourhood reaches ``reach`` boxes,
    holds sizes from ``smallest`` to ``largest`` times its own, and has the ``volume`` of so many w²h².
    """
    out: F8 = mixture_density(z, rate, low, high, flat, mean, whiten, log_peak)
    local = _around(z, volume, reach, smallest, largest)
    for j in range(out.size):
        out[j] += beside * local[j]
    return out


@njit(**INNER)
def _likelier(
    z: F8, state: F8, cov: F8, order: I8, low: F8, high: F8, flat: float, mean: F8, triangle: F8, peak2: F8, near: F8,
    among_low: F8, among_high: F8, among_flat: F8, among_mean: F8, among_whiten: F8, among_peak: F8,
) -> tuple[F8, F8, F8]:  # fmt: skip
    """p(z|b) / p(z|o) at the first components of ``z``, and states and covariances, as `laid_births` has them."""
    ratio, x, p = given_detections(
        state, cov, order, among_low.size, low, high, flat, mean, triangle, peak2, near
    )  # fmt: skip
    objects = mixture_density(z, 1.0, among_low, among_high, among_flat, among_mean, among_whiten, among_peak)
    for j in range(ratio.size):
        ratio[j] = max(ratio[j], flat) / objects[j]
    return ratio, x, p


@njit(**ENTRY)
def laid_births(
    state: F8, noise: F8, order: I8, shown: int, low: F8, high: F8, flat: float, mean: F8, cov: F8, peak2: F8, near: F8,
    among_low: F8, among_high: F8, among_flat: F8, among_mean: F8, among_whiten: F8, among_peak: F8, beside: float,
    volume: float, reach: float, smallest: float, largest: float,
) -> tuple[F8, F8, F8]:  # fmt: skip
    """``beside`` l(z) p(z|b) / p(z|o) at detections, and states with the mean and covariance of what these do not show.

    ``state`` to ``near`` are as `context_density.given_detections` takes them (``shown`` components are), ``among_*`` is
    p(z|o) as `mixture_density` takes it, and the others are as in `laid_clutter`. p(z|b) is nowhere below ``flat``. Returns
    (N,), (d, N), (N, d, d).
    """
    z = np.empty((shown, state.shape[1]))
    for r in range(shown):
        for j in range(state.shape[1]):
            z[r, j] = state[order[r], j]
    density, x, p = _likelier(
        z, state, noise, order, low, high, flat, mean, cov, peak2, near, among_low, among_high, among_flat, among_mean,
        among_whiten, among_peak,
    )  # fmt: skip
    local = _around(z, volume, reach, smallest, largest)
    for j in range(density.size):
        density[j] *= beside * local[j]
    return density, x, p


@njit(**ENTRY)
def laid_about(
    state: F8, deviation: F8, order: I8, shown: int, low: F8, high: F8, flat: float, mean: F8, cov: F8, peak2: F8, near: F8,
    among_low: F8, among_high: F8, among_flat: F8, among_mean: F8, among_whiten: F8, among_peak: F8, beside: float,
    volume: float, reach: float, smallest: float, largest: float,
) -> tuple[F4, F4]:  # fmt: skip
    """`laid_births` for noise without correlations, of standard deviations (d, N), as the fused particle filter reads it.

    Returns densities (N,), and (5, N) `newborn_velocities`.
    """
    density, x, p = laid_births(
        state, uncorrelated(deviation), order, shown, low, high, flat, mean, cov, peak2, near, among_low, among_high,
        among_flat, among_mean, among_whiten, among_peak, beside, volume, reach, smallest, largest,
    )  # fmt: skip
    single = np.empty(density.size, np.float32)
    for j in range(density.size):
        single[j] = density[j]
    return single, newborn_velocities(x, p, order[shown], order[shown + 1])


@njit(**INNER)
def _told_alone(z: F8, b: BoxNumbers) -> tuple[F8, F8]:
    """States (d, N) at rest that boxes ``z`` tell of, and their covariances (N, d, d)."""
    m, n = z.shape
    boxes, state, cov = np.empty((1, m)), np.empty((D, n)), np.empty((n, D, D))
    for j in range(n):
        for r in range(m):
            boxes[0, r] = z[r, j]
        here = noise(b, z[2, j], z[3, j], boxes, 0)
        speed = max(b.deviation_fixed if b.scaling == FIXED else b.deviation_scaled * np.sqrt(z[2, j] * z[3, j]), 1e-6)
        for r in range(D):
            for s in range(D):
                cov[j, r, s] = 0.0
            state[r, j], cov[j, r, r] = 0.0, speed * speed
        for a in range(M):
            state[ROWS[a], j], cov[j, ROWS[a], ROWS[a]] = z[a, j], here[a]
    return state, cov


@njit(**INNER)
def births_by_place(z: F8, b: BoxNumbers, bounds: F8, births: F8, objects: F8) -> tuple[F8, F8, F8]:
    """p(z|b) / p(z|o) at boxes ``z`` (4 or more, N), and states (d, N), (N, d, d) with the velocities that were learned.

    ``births`` (29, M): means, triangles of covariances, peak2 and reach as `given_detections` takes them; ``objects``
    (15, K): means, L⁻¹ and logarithms of the peaks as `mixture_density` does. ``bounds`` (19,): of births what is flat, and
    low and high; of objects the same, with what is flat twice.
    """
    order = np.empty(D, np.int64)
    for r in range(M):
        order[r] = ROWS[r]
    order[M], order[M + 1] = 2, 3
    state, cov = _told_alone(z, b)
    out: tuple[F8, F8, F8] = _likelier(
        z, state, cov, order, bounds[1 : 1 + M], bounds[1 + M : 1 + BOUNDS], bounds[0], births[:D],
        births[D : D + ENTRIES], births[D + ENTRIES], births[D + ENTRIES + 1], bounds[3 + BOUNDS : 3 + BOUNDS + M],
        bounds[3 + BOUNDS + M :], bounds[1 + BOUNDS : 3 + BOUNDS], objects[:M], objects[M : MIXTURE_ROWS - 1],
        objects[MIXTURE_ROWS - 1],
    )  # fmt: skip
    return out


@njit(**INNER)
def clutter_by_place(z: F8, bounds: F8, alarms: F8) -> F8:
    """(N,) r̄ p(z|c) at boxes ``z`` (4 or more, N); (0,) where it was not learned.

    ``alarms`` (15, M) are as objects are in `births_by_place`; ``bounds`` (11,): the rate, what is flat, twice, low and
    high; not learned: (0,).
    """
    if bounds.size == 0:
        return np.empty(0)
    out: F8 = mixture_density(
        z, bounds[0], bounds[3 : 3 + M], bounds[3 + M :], bounds[1:3], alarms[:M], alarms[M : MIXTURE_ROWS - 1],
        alarms[MIXTURE_ROWS - 1],
    )  # fmt: skip
    return out


@njit(**ENTRY)
def scene_about(z: F8, model: F8, bounds: F8, entrances: F8, objects: F8, around: F8, alarms: F8) -> tuple[F8, F8]:
    """What `gm_step.box_step` is given of a learned scene at the boxes ``z`` (m, N), in one call.

    ``bounds``, ``entrances`` and ``objects`` are those of `births_by_place`, ``around`` and ``alarms`` those of
    `clutter_by_place`. Returns how many times as many births there are, with the velocities (N, 6), (0, 6) where births are
    not by place; and r̄ p(z|c) (N,), (0,) where false alarms are not.
    """
    b, kappa = box_numbers(model), clutter_by_place(z, around, alarms)
    if b.birth != PLACES:
        return np.empty((0, ABOUT)), kappa
    ratio, x, p = births_by_place(z, b, bounds, entrances, objects)
    rows = np.empty((ratio.size, ABOUT))
    for j in range(ratio.size):
        rows[j, 0], rows[j, 1], rows[j, 2] = ratio[j], x[2, j], x[3, j]
        rows[j, 3], rows[j, 4], rows[j, 5] = p[j, 2, 2], p[j, 3, 2], p[j, 3, 3]
    return rows, kappa
