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
def sorted_rows(x: F8, place: I8) -> int:
    """Write the rows that ``x`` (d,) shows into ``place`` (d,), behind them those of NaN; how many it shows."""
    seen, behind = 0, x.size
    for r in range(x.size):
        if not math.isnan(x[r]):
            place[seen] = r
            seen += 1
    for r in range(x.size - 1, -1, -1):
        if math.isnan(x[r]):
            behind -= 1
            place[behind] = r
    return seen


@njit(**INNER)
def completed(
    mean: F8,
    cov: F8,
    floor: F8,
    m: int,
    x: F8,
    place: I8,
    seen: int,
    ordered: F8,
    root: F8,
    step: F8,
    y: F8,
    whole: F8,
    loose: F8,
) -> float:
    """log N_m of the ``seen`` rows of ``x`` that ``place`` names first; the others as component m expects them, given these.

    ``whole`` (d,) is the sample with these expectations, ``loose`` (d, d) their covariance beside ``floor`` (d,) in the rows
    that are shown. Cholesky's factor of the covariance with the rows in this order has both. ``ordered``, ``root`` (d, d),
    ``step``, ``y`` (d,) are working space.
    """
    d = x.size
    for r in range(d):
        step[r] = x[place[r]] - mean[m, place[r]]
        for s in range(d):
            ordered[r, s] = cov[m, place[r], place[s]]
    factor(ordered, root)
    value: float = -0.5 * (norm2(step[:seen], root, y) + seen * math.log(2.0 * math.pi))
    for r in range(d):
        if r < seen:
            value -= math.log(root[r, r])
            whole[place[r]] = x[place[r]]
        else:
            whole[place[r]] = mean[m, place[r]]
            for t in range(seen):
                whole[place[r]] += root[r, t] * y[t]
        for s in range(r + 1):
            left = floor[place[r]] if r == s and r < seen else 0.0
            if s >= seen:
                for t in range(seen, s + 1):
                    left += root[r, t] * root[s, t]
            loose[place[r], place[s]] = left
            loose[place[s], place[r]] = left
    return value


@njit(**INNER)
def shared(weight: F8, alive: int, share: F8) -> float:
    """Turn log N_m(x) in ``share`` into o_m = π_m N_m(x) / Σ_j π_j N_j(x); the logarithm of the sum."""
    largest = -math.inf
    for m in range(alive):
        share[m] = share[m] + math.log(weight[m]) if weight[m] > 0.0 else -math.inf
        largest = max(largest, share[m])
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
def moved(mean: F8, cov: F8, x: F8, loose: F8, m: int, rho: float) -> None:
    """Mean and covariance of component m a part ``rho`` nearer to the sample [M09 (18), (19)].

    ``loose`` (d, d) is added to the sample's scatter: F, above which every covariance then stays, and the covariance of what
    the sample does not show.
    """
    d = x.size
    for r in range(d):
        for s in range(r + 1):
            scatter = (x[r] - mean[m, r]) * (x[s] - mean[m, s]) + loose[r, s]
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


@njit(**INNER)
def thinned(weight: F8, mean: F8, cov: F8, root: F8, log_norm: F8, alive: int) -> int:
    """Remove the components whose weight is not positive, all but the last; weights of sum 1 again. How many are left."""
    m, total = 0, 0.0
    while m < alive:
        if weight[m] <= 0.0 and alive > 1:
            alive -= 1
            overwritten(weight, mean, cov, root, log_norm, m, alive)
        else:
            total += weight[m]
            m += 1
    for m in range(alive):
        weight[m] /= total
    return alive


@njit(**ENTRY)
def recursive_em(
    weight: F8,
    mean: F8,
    cov: F8,
    alive: int,
    uniform: float,
    samples: F8,
    worth: F8,
    order: I8,
    settings: F8,
    log_extent: F8,
    floor: F8,
    steady: int,
) -> tuple[int, float]:
    """Run through ``samples`` (n, d) in ``order`` (K,); changes weight (M,), mean (M, d), cov (M, d, d) in place.

    A sample moves everything ``worth`` (n,) times as far as one of 1. Rows of NaN are what it does not show: it is
    explained by the others, and what is expected there given these stands for them.

    ``settings``: τ, the samples 1/β that the rule remembers at most, least share of the uniform density; ``log_extent`` (d,)
    logarithms of the volume's sides. The first ``steady`` samples are taken with the rate β = min(1/memory, ½/(τM)). Later
    ones have the estimate settle: without the prior, at a rate that falls like 1/k, and each counts for the Gaussians by the
    probability that it came from them. Gives the number of components left and the share of the uniform density.
    """
    tau, memory, least = settings[0], settings[1], settings[2]
    d = mean.shape[1]
    root, log_norm, share = np.empty(cov.shape), np.empty(weight.size), np.empty(weight.size)
    step, y, whole, place = np.empty(d), np.empty(d), np.empty(d), np.empty(d, np.int64)
    ordered, other, loose, still = np.empty((d, d)), np.empty((d, d)), np.empty((d, d)), np.zeros((d, d))
    for r in range(d):
        still[r, r] = floor[r]
    for m in range(alive):
        refactored(cov, root, log_norm, m)
    late = 0.0
    for k in range(order.size):
        x, w = samples[order[k]], worth[order[k]]
        seen, log_flat = sorted_rows(x, place), 0.0
        for r in range(seen):
            log_flat -= log_extent[place[r]]
        for m in range(alive):
            if seen < d:
                share[m] = completed(mean, cov, floor, m, x, place, seen, ordered, other, step, y, whole, loose)
            else:
                for r in range(d):
                    step[r] = x[r] - mean[m, r]
                share[m] = log_norm[m] - 0.5 * norm2(step, root[m], y)
        log_gauss = shared(weight, alive, share)
        rate = min(1.0 / memory, BOUND / (tau * alive))
        odds = math.exp(min(700.0, log_gauss - log_flat)) * (1.0 - uniform) / uniform
        flat = 1.0 / (1.0 + odds)
        prior, beta = tau * rate, min(1.0, rate * w)
        if k >= steady:
            late += rate * w
            prior, beta = 0.0, beta / (1.0 + late)
        uniform += beta * (flat - uniform)
        uniform = min(1.0 - least, max(least, uniform))
        beta *= 1.0 - flat if k >= steady else 1.0
        drop = prior / (1.0 - alive * prior)
        for m in range(alive):
            before = weight[m]
            weight[m] += beta * (share[m] / (1.0 - alive * prior) - drop - before)
            rho = min(1.0, beta * share[m] / before)
            if rho > NOTHING:
                if seen < d:
                    completed(mean, cov, floor, m, x, place, seen, ordered, other, step, y, whole, loose)
                    moved(mean, cov, whole, loose, m, rho)
                else:
                    moved(mean, cov, x, still, m, rho)
                refactored(cov, root, log_norm, m)
        alive = thinned(weight, mean, cov, root, log_norm, alive)
    return alive, uniform
