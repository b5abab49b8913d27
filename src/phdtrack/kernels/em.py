"""Gaussian mixtures: expectation-maximisation [M09 §III-B], its recursive form [M09 (16)-(20)], and densities.

This is the one EM of the package. `em_step` is one batch step: give it the weighted samples (d, n), the logarithm of the
density beside the mixture at each (a uniform part, other components; (0,) for none), the mixture, and the components that
each block of samples may belong to (`one_block` where all may). It gives the mass, mean and covariance of each component's
samples, from which the caller makes the next mixture. `recursive_em` takes one sample at a time. `log_densities` has each
Gaussian's density at points.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, FAST, INNER, VECTOR, exp_of, log_of
from phdtrack.kernels.gaussian import LOG_2PI, factor, norm2
from phdtrack.kernels.mixtures import CHUNK, Gaussians, log_density_of, steps_from, whitened

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
Real = NDArray[np.floating[Any]]

# Logarithms below this are those of a density that is 0.
NOTHING = -1e30
# A density that is so much (nats) below another one at the same place counts as 0 there.
LEAST = -60.0
# A component of less mass than this has no samples: its square must not vanish.
NO_MASS = 1e-100
# A share of a sample below which nothing of a component moves by more than rounding.
NEGLIGIBLE = 1e-14
# The largest value of M·τ·β: at 1 the recursive rule for the weights divides by 0.
MAX_PRIOR = 0.5


class Candidates(NamedTuple):
    """The components that each of B blocks of samples may belong to.

    ``start`` (B + 1,): block b holds the samples from start[b] to start[b + 1]. ``first`` (B + 1,) and ``component`` (P,):
    its components are component[first[b]:first[b + 1]].
    """

    start: I8
    first: I8
    component: I8


class Moments(NamedTuple):
    """What one step of EM makes of the samples.

    ``mass`` (k,): Σ of the samples' weights times responsibilities. ``mean`` (d, k), ``covariance`` (k, d, d): of each
    component's samples; those of a component without mass are as before. ``background``: mass of the background density.
    ``log_likelihood``: Σ weight · log density, nats.
    """

    mass: F8
    mean: F8
    covariance: F8
    background: float
    log_likelihood: float


class Recursion(NamedTuple):
    """How the recursive form learns.

    ``prior``: τ, half the number of parameters of a component. ``memory``: samples 1/β that are remembered at most.
    ``min_uniform``: smallest share of the uniform density. ``log_volume``: logarithm of the volume of the uniform density.
    ``steady``: number of samples taken at the constant rate; later ones have a rate that falls like 1/k, without the prior.
    ``floor`` (d,): variances added to every sample's scatter, so that no covariance vanishes.
    """

    prior: float
    memory: float
    min_uniform: float
    log_volume: float
    steady: int
    floor: F8


def nothing_known(dim: int) -> Gaussians:
    """The moments of no blocks."""
    return Gaussians(np.zeros(0), np.zeros((dim, 0)), np.zeros((0, dim, dim)))


def one_block(samples: int, components: int) -> Candidates:
    """Candidates where every sample may belong to every component."""
    return Candidates(np.array([0, samples]), np.array([0, components]), np.arange(components))


@njit(**VECTOR)
def _responsibilities(
    table: Real, count: int, size: int, weight: Real, background: Real, top: Real, total: Real
) -> float:  # fmt: skip
    """Turn log densities in ``table`` (≥ count, ≥ size) into weight times responsibility; gives Σ weight · log density.

    The logarithm in ``background`` becomes the weight times the responsibility of the background; ``top``, ``total`` are
    scratch.
    """
    real = table.dtype.type
    log_likelihood: Any = 0.0
    nothing, least, zero = real(NOTHING), real(LEAST), real(0)
    for i in range(size):
        top[i] = background[i]
    for c in range(count):
        for i in range(size):
            top[i] = table[c, i] if table[c, i] > top[i] else top[i]
    for i in range(size):
        top[i] = top[i] if top[i] > nothing else zero
        background[i] = exp_of(background[i] - top[i]) if background[i] - top[i] > least else zero
    for c in range(count):
        for i in range(size):
            # No numbers below the smallest normal one: they are slow.
            table[c, i] = exp_of(table[c, i] - top[i]) if table[c, i] - top[i] > least else zero
    for i in range(size):
        total[i] = background[i]
    for c in range(count):
        for i in range(size):
            total[i] += table[c, i]
    for i in range(size):
        log_likelihood += weight[i] * (top[i] + log_of(total[i])) if total[i] > zero else zero
        top[i] = weight[i] / total[i] if total[i] > zero else zero
    for i in range(size):
        background[i] *= top[i]
    for c in range(count):
        for i in range(size):
            table[c, i] *= top[i]
    return float(log_likelihood)


@njit(**VECTOR)
def _add_moments(step: Real, share: Real, size: int, j: int, mass: F8, first: F8, second: F8) -> None:
    """Add the sums over samples of share, share · step and share · step · stepᵀ to component ``j``'s."""
    zero = step.dtype.type(0)
    total = zero
    for i in range(size):
        total += share[i]
    mass[j] += total
    for r in range(step.shape[0]):
        row = step[r]
        total = zero
        for i in range(size):
            total += share[i] * row[i]
        first[j, r] += total
        for s in range(r + 1):
            other = step[s]
            total = zero
            for i in range(size):
                total += share[i] * row[i] * other[i]
            second[j, r, s] += total


@njit(**INNER)
def _add_known(known: Gaussians, b: int, j: int, mean: F8, mass: F8, first: F8, second: F8) -> None:
    """Add the sums of all samples of block ``b`` to component ``j``'s."""
    total = known.weight[b]
    mass[j] += total
    for r in range(mean.shape[0]):
        step = known.mean[r, b] - mean[r, j]
        first[j, r] += total * step
        for s in range(r + 1):
            second[j, r, s] += total * (known.covariance[b, r, s] + step * (known.mean[s, b] - mean[s, j]))


@njit(**INNER)
def _from_sums(mixture: Gaussians, mass: F8, first: F8, second: F8) -> tuple[F8, F8]:
    """Means (d, k) and covariances (k, d, d) from sums of steps from the old means."""
    mean, cov = mixture.mean.copy(), mixture.covariance.copy()
    for j in range(mass.size):
        if mass[j] < NO_MASS:
            continue
        for r in range(mean.shape[0]):
            mean[r, j] += first[j, r] / mass[j]
            for s in range(r + 1):
                cov[j, r, s] = second[j, r, s] / mass[j] - first[j, r] * first[j, s] / (mass[j] * mass[j])
                cov[j, s, r] = cov[j, r, s]
    return mean, cov


@njit(**(ENTRY | {"fastmath": FAST}))
def em_step(
    x: Real, weight: F8, log_background: F8, mixture: Gaussians, candidates: Candidates, known: Gaussians
) -> Moments:  # fmt: skip
    """Expectation and the sums of maximisation for weighted samples [M09 §III-B].

    The new weights, a floor under covariances and a prior are left to the caller. Samples of blocks without candidates count
    for no component. Those of a block with one candidate and no background are all that component's: their densities are not
    computed and not in ``log_likelihood``.

    Parameters
    ----------
    x : (d, n) samples, in float32 or float64.
    weight : (n,) of the samples, or (1,) for all of them.
    log_background : (n,) logarithm of the density beside the mixture at each sample; (0,) for none.
    mixture : the Gaussians, whose weights count the background in: density = background + Σ weight · N(x).
    candidates : the components that each block of samples may belong to (`one_block` for all).
    known : mass, mean and covariance of each block, so that no sample of one with one candidate is looked at; or of none.
    """
    d, (start, first_of, component) = x.shape[0], candidates
    _, inverse, log_peak = whitened(mixture)
    count = mixture.weight.size
    mass, first, second = np.zeros(count), np.zeros((count, d)), np.zeros((count, d, d))
    widest = np.max(np.diff(first_of)) if first_of.size > 1 else 0
    step, table = np.empty((d, CHUNK), x.dtype), np.empty((widest, CHUNK), x.dtype)
    part, total = np.empty(CHUNK, x.dtype), np.empty(CHUNK, x.dtype)
    own, beside = np.empty(CHUNK, x.dtype), np.empty(CHUNK, x.dtype)
    background, log_likelihood = 0.0, 0.0
    for b in range(start.size - 1):
        near = component[first_of[b] : first_of[b + 1]]
        if near.size == 1 and log_background.size == 0 and known.weight.size > 0:
            _add_known(known, b, near[0], mixture.mean, mass, first, second)
            continue
        for begin in range(start[b], start[b + 1], CHUNK):
            size = min(CHUNK, start[b + 1] - begin)
            for i in range(size):
                own[i] = weight[begin + i] if weight.size > 1 else weight[0]
                beside[i] = log_background[begin + i] if log_background.size else -np.inf
            if near.size == 1 and log_background.size == 0:
                steps_from(x, begin, size, mixture.mean, near[0], step)
                _add_moments(step, own, size, near[0], mass, first, second)
                continue
            for c in range(near.size):
                steps_from(x, begin, size, mixture.mean, near[c], step)
                log_density_of(step, size, inverse[near[c]], log_peak[near[c]], part, table[c])
            log_likelihood += _responsibilities(table, near.size, size, own, beside, part, total)
            for i in range(size):
                background += beside[i]
            for c in range(near.size):
                steps_from(x, begin, size, mixture.mean, near[c], step)
                _add_moments(step, table[c], size, near[c], mass, first, second)
    mean, cov = _from_sums(mixture, mass, first, second)
    return Moments(mass, mean, cov, background, log_likelihood)


@njit(**INNER)
def _shares(weight: F8, alive: int, log_density: F8) -> float:
    """Turn log N_m(x) into o_m = π_m N_m(x) / Σ_j π_j N_j(x) in place; gives the logarithm of the sum."""
    largest = -math.inf
    for m in range(alive):
        log_density[m] = log_density[m] + math.log(weight[m]) if weight[m] > 0.0 else -math.inf
        largest = max(largest, log_density[m])
    total = 0.0
    for m in range(alive):
        log_density[m] = math.exp(log_density[m] - largest)
        total += log_density[m]
    for m in range(alive):
        log_density[m] /= total
    return largest + math.log(total)


@njit(**INNER)
def _refactor(cov: F8, root: F8, log_peak: F8, m: int) -> None:
    """Write Cholesky's factor of component ``m`` and the logarithm of its peak density."""
    log_peak[m] = -0.5 * (factor(cov[m], root[m]) + cov.shape[1] * LOG_2PI)


@njit(**INNER)
def _move(mean: F8, cov: F8, x: F8, floor: F8, m: int, rate: float) -> None:
    """Move component ``m`` by a part ``rate`` of the way to the sample, in place [M09 (19), (20)]."""
    for r in range(x.size):
        for s in range(r + 1):
            scatter = (x[r] - mean[m, r]) * (x[s] - mean[m, s]) + (floor[r] if r == s else 0.0)
            cov[m, r, s] += rate * (scatter - cov[m, r, s])
            cov[m, s, r] = cov[m, r, s]
    for r in range(x.size):
        mean[m, r] += rate * (x[r] - mean[m, r])


@njit(**INNER)
def _without_empty(weight: F8, mean: F8, cov: F8, root: F8, log_peak: F8, alive: int) -> int:
    """Overwrite components of no positive weight by the last ones and normalise the weights; how many are left, ≥ 1."""
    m, total = 0, 0.0
    while m < alive:
        if weight[m] <= 0.0 and alive > 1:
            alive -= 1
            weight[m], log_peak[m] = weight[alive], log_peak[alive]
            mean[m], cov[m], root[m] = mean[alive], cov[alive], root[alive]
        else:
            total += weight[m]
            m += 1
    for m in range(alive):
        weight[m] /= total
    return alive


@njit(**ENTRY)
def recursive_em(
    mixture: Gaussians, uniform: float, samples: F8, weight: F8, order: I8, rule: Recursion
) -> tuple[Gaussians, float]:
    """The mixture and the share of a uniform density after one sample at a time [M09 (16)-(20)].

    A component whose weight turns negative is removed. After the steady samples, each one counts for the Gaussians by the
    probability that it did not come from the uniform density.

    Parameters
    ----------
    mixture : weights of sum 1, beside the uniform density.
    uniform : share of the uniform density at first.
    samples : (n, d), without gaps.
    weight : (n,), by which β is multiplied for each sample.
    order : (K,) indices of the samples in the order in which they are taken; they may repeat.
    rule : rate, prior and limits.
    """
    left, mean, cov = mixture.weight.copy(), np.ascontiguousarray(mixture.mean.T), mixture.covariance.copy()
    alive, d = left.size, mean.shape[1]
    root, log_peak, share = np.zeros(cov.shape), np.empty(alive), np.empty(alive)
    step, y = np.empty(d), np.empty(d)
    for m in range(alive):
        _refactor(cov, root, log_peak, m)
    late = 0.0
    for k in range(order.size):
        x, w = samples[order[k]], weight[order[k]]
        for m in range(alive):
            for r in range(d):
                step[r] = x[r] - mean[m, r]
            share[m] = log_peak[m] - 0.5 * norm2(step, root[m], y)
        log_mixture = _shares(left, alive, share)
        ratio = math.exp(min(700.0, log_mixture + rule.log_volume)) * (1.0 - uniform) / uniform
        flat, settling = 1.0 / (1.0 + ratio), k >= rule.steady
        rate = min(1.0 / rule.memory, MAX_PRIOR / (rule.prior * alive))
        prior, beta = rule.prior * rate, min(1.0, rate * w)
        if settling:
            late += rate * w
            prior, beta = 0.0, beta / (1.0 + late)
        uniform = min(1.0 - rule.min_uniform, max(rule.min_uniform, uniform + beta * (flat - uniform)))
        beta *= 1.0 - flat if settling else 1.0
        for m in range(alive):
            before = left[m]
            left[m] += beta * ((share[m] - prior) / (1.0 - alive * prior) - before)
            moved = min(1.0, beta * share[m] / before)
            if moved > NEGLIGIBLE:
                _move(mean, cov, x, rule.floor, m, moved)
                _refactor(cov, root, log_peak, m)
        alive = _without_empty(left, mean, cov, root, log_peak, alive)
    return Gaussians(left[:alive].copy(), mean[:alive].T.copy(), cov[:alive].copy()), uniform
