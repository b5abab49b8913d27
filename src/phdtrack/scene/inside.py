"""How much of a Gaussian lies in a box with sides along the axes.

Genz's separation of variables: with Σ = L Lᵀ the integral over the box becomes one over the unit cube, whose integrand is
a product of one-dimensional masses and nearly flat; a lattice of fixed points integrates it. For independent components it
is exact. A. Genz, *Numerical computation of multivariate normal probabilities*, J. Comp. Graph. Stat. 1 (1992).
"""

from __future__ import annotations

import numpy as np

from phdtrack.types import F8

# Richtmyer's lattice: multiples of the square roots of primes, folded.
_ROOTS = np.sqrt(np.array([2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0]))
_POINTS = 512


def mass_inside(mean: F8, covariance: F8, low: F8, high: F8) -> F8:
    """(M,) mass of N(·; mean[:, m], covariance[m]) between ``low`` and ``high`` (d,); d at most 8.

    ``mean`` is (d, M), ``covariance`` (M, d, d), positive definite. Accurate to about 1e-3 for the covariances of states.
    """
    from scipy.special import ndtr, ndtri

    d, count = mean.shape
    if count == 0:
        return np.zeros(0)
    root = np.linalg.cholesky(covariance)
    lattice = np.abs(2 * np.modf(np.outer(_ROOTS[: d - 1], np.arange(1, _POINTS + 1)))[0] - 1)
    y = np.zeros((d, count, _POINTS))
    product = np.ones((count, _POINTS))
    for r in range(d):
        shift = np.einsum("ms,smp->mp", root[:, r, :r], y[:r]) + mean[r][:, None]
        scale = root[:, r, r][:, None]
        below, above = ndtr((low[r] - shift) / scale), ndtr((high[r] - shift) / scale)
        product *= above - below
        if r < d - 1:
            # Where nothing is left the point does not matter; ndtri must not be given 0 or 1.
            y[r] = ndtri(np.clip(below + lattice[r] * (above - below), 1e-300, 1 - 1e-16))
    inside: F8 = product.mean(axis=1)
    return inside
