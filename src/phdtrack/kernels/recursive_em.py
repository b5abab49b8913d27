"""Recursive MAP-EM for a Gaussian mixture beside a uniform density, one sample after the other [M09 (16)–(20)].

Components live in the first places of their arrays; one whose weight turns negative is overwritten by the last.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.gaussian import factor, norm2

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

# A share of a sample below which nothing of a component moves by more than rounding.
NOTHING = 1e-14
# The largest part of 1 that M·τ·β may reach: at 1 the rule for the weights divides by 0.
BOUND = 0.5


@njit(**INNER)
def responsibilities(weight: F8, mean: F8, root: F8, log_norm: F8, alive: int, x: F8, step: F8, y: F8, share: F8) -> float:
    """Write o_m = π_m N_m(x) / Σ_j π_j N_j(x) into ``share``; the logarithm of the sum."""
    largest = -math.inf
    for m in range(alive):
        for r in range(x.size):
            step[r] = x[r] - mean[m, r]
        value = math.log(weight[m]) + log_norm[m] - 0.5 * norm2(step, root[m], y) if weight[m] > 0.0 else -math.inf
        share[m] = value
        largest = max(largest, value)
    total = 0.0
    for m in range(alive):
        share[m] = math.exp(share[m] - largest)
        total += share[m]
    for m in range(alive):
        share[m] /= total
    return largest + math.log(total)


@njit(**INNER)
def refactored(cov: F8, root: F8, log_norm: F8, m: int) -> None:
    """Cholesky's factor of component m, and the logarithm of its density at its mean."""
    d = cov.shape[1]
    log_norm[m] = -0.5 * (factor(cov[m], root[m]) + d * math.log(2.0 * math.pi))


@njit(**INNER)
def moved(mean: F8, cov: F8, floor: F8, x: F8, m: int, rho: float) -> None:
    """Mean and covariance of component m a part ``rho`` nearer to the sample [M09 (18), (19)].

    ``floor`` is added to the sample's scatter: no covariance that began above it can fall below it.
    """
    d = x.size
    for r in range(d):
        for s in range(r + 1):
            scatter = (x[r] - mean[m, r]) * (x[s] - mean[m, s]) + (floor[r] if r == s else 0.0)
            cov[m, r, s] += rho * (scatter - cov[m, r, s])
            cov[m, s, r] = cov[m, r, s]
    for r in range(d):
        mean[m, r] += rho * (x[r] - mean[m, r])


@njit(**INNER)
def overwritten(weight: F8, mean: F8, cov: F8, root: F8, log_norm: F8, m: int, last: int) -> None:
    """Component ``last`` in the place of m."""
    d = mean.shape[1]
    weight[m], log_norm[m] = weight[last], log_norm[last]
    for r in range(d):
        mean[m, r] = mean[last, r]
        for s in range(d):
            cov[m, r, s], root[m, r, s] = cov[last, r, s], root[last, r, s]


@njit(**ENTRY)
def recursive_em(
    weight: F8, mean: F8, cov: F8, alive: int, uniform: float, samples: F8, order: I8, settings: F8, floor: F8, steady: int
) -> tuple[int, float]:
    """Run through ``samples`` (n, d) in ``order`` (K,); changes weight (M,), mean (M, d), cov (M, d, d) in place.

    ``settings``: τ, the samples 1/β that the rule remembers at most, log 1/V, least share of the uniform density. The first
    ``steady`` samples are taken with the rate β = min(1/memory, ½/(τM)). Later ones have the estimate settle: without the
    prior, at a rate that falls like 1/k, and each counts for the Gaussians by the probability that it came from them. Gives
    the number of components left and the share of the uniform density.
    """
    tau, memory, log_flat, least = settings[0], settings[1], settings[2], settings[3]
    d = mean.shape[1]
    root, log_norm = np.empty(cov.shape), np.empty(weight.size)
    share, step, y = np.empty(weight.size), np.empty(d), np.empty(d)
    for m in range(alive):
        refactored(cov, root, log_norm, m)
    late = 0.0
    for k in range(order.size):
        x = samples[order[k]]
        log_gauss = responsibilities(weight, mean, root, log_norm, alive, x, step, y, share)
        rate = min(1.0 / memory, BOUND / (tau * alive))
        odds = math.exp(min(700.0, log_gauss - log_flat)) * (1.0 - uniform) / uniform
        flat = 1.0 / (1.0 + odds)
        prior, beta = tau * rate, rate
        if k >= steady:
            late += rate
            prior, beta = 0.0, rate / (1.0 + late)
        uniform += beta * (flat - uniform)
        uniform = min(1.0 - least, max(least, uniform))
        beta *= 1.0 - flat if k >= steady else 1.0
        drop = prior / (1.0 - alive * prior)
        total = 0.0
        for m in range(alive):
            before = weight[m]
            weight[m] += beta * (share[m] / (1.0 - alive * prior) - drop - before)
            rho = min(1.0, beta * share[m] / before)
            if rho > NOTHING:
                moved(mean, cov, floor, x, m, rho)
                refactored(cov, root, log_norm, m)
        m = 0
        while m < alive:
            if weight[m] <= 0.0 and alive > 1:
                alive -= 1
                overwritten(weight, mean, cov, root, log_norm, m, alive)
            else:
                total += weight[m]
                m += 1
        for m in range(alive):
            weight[m] /= total
    return alive, uniform
