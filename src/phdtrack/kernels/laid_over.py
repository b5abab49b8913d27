"""A learned scene laid over births and false alarms that are spread around each detection (`models.learned_scene`)."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.neighbourhoods import summed_densities
from phdtrack.kernels.scene_density import given_detections, mixture_density, newborn_velocities, uncorrelated

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

# Components of a measured box, and rows of a table of Gaussians as `mixture_density` takes it, one below the other.
M = 4
MIXTURE_ROWS = M + M * (M + 1) // 2 + 1


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
def clutter_by_place(z: F8, bounds: F8, alarms: F8) -> F8:
    """(N,) r̄ p(z|c) at boxes ``z`` (4 or more, N); (0,) where it was not learned.

    ``alarms`` (15, M) have means, L⁻¹ and logarithms of the peaks as `mixture_density` takes them; ``bounds`` (11,): the
    rate, what is flat, twice, low and
    high; not learned: (0,).
    """
    if bounds.size == 0:
        return np.empty(0)
    out: F8 = mixture_density(
        z, bounds[0], bounds[3 : 3 + M], bounds[3 + M :], bounds[1:3], alarms[:M], alarms[M : MIXTURE_ROWS - 1],
        alarms[MIXTURE_ROWS - 1],
    )  # fmt: skip
    return out
