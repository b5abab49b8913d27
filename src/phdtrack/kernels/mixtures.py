"""Gaussian mixtures: densities, expectation-maximisation [M09 §III-B], and its recursive form [M09
(16)-(20)].

`log_densities` and `densities_inside` evaluate Gaussians that were `whitened` once. `em_step` gives
the mass, mean and covariance of each component's samples, from which the caller makes the next
mixture. `recursive_em` takes one sample at a time.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from phdtrack.kernels import F8, I8, Real
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, FAST, INNER, VECTOR, exp_of, log_of
from phdtrack.kernels.gaussian import LOG_2PI, factor, norm2
from phdtrack.kernels.triangular import invert_lower

# Points that are evaluated at a time.
CHUNK = 128
# Logarithms below this are those of a density of 0; a density is also 0 if it is LEAST nats below
# another one at the same place.
NOTHING = -1e30
LEAST = -60.0
# A term that is so many nats (54 log 2) below a sum does not change its last digit.
ROUNDED = 37.5
# A component of less mass than this has no samples: its square must not vanish.
NO_MASS = 1e-100
# A sample with a smaller share moves a component by no more than rounding.
NEGLIGIBLE = 1e-14
# The largest value of M·τ·β: at 1 the recursive rule for the weights divides by 0.
MAX_PRIOR = 0.5


class Gaussians(NamedTuple):
    """k weighted Gaussians: ``weight`` (k,), ``mean`` (d, k), ``covariance`` (k, d, d)."""

    weight: F8
    mean: F8
    covariance: F8


class Whitened(NamedTuple):
    """k Gaussians, ready to be evaluated: ``mean`` (d, k), ``inverse`` (k, d, d) L⁻¹ of the
    covariances L Lᵀ, and ``log_peak`` (k,) logarithms of weight times peak density."""

    mean: F8
    inverse: F8
    log_peak: F8


@njit(**ENTRY)
def whitened(mixture: Gaussians) -> Whitened:
    """The Gaussians, ready to be evaluated."""
    count = mixture.covariance.shape[0]
    d = mixture.covariance.shape[1]
    inverse = np.zeros((count, d, d))
    log_peak = np.empty(count)
    root = np.zeros((d, d))
    for j in range(count):
        log_det = factor(mixture.covariance[j], root)
        log_weight = -math.inf
        if mixture.weight[j] > 0.0:
            log_weight = math.log(mixture.weight[j])
        log_peak[j] = log_weight - 0.5 * (log_det + d * LOG_2PI)
        invert_lower(root, inverse[j])
    return Whitened(mixture.mean, inverse, log_peak)


@njit(**VECTOR)
def steps_from(x: Real, begin: int, size: int, mean: F8, j: int, step: Real) -> None:
    """Write x − m of component ``j`` into ``step`` (d, ≥ size)."""
    real = x.dtype.type
    for r in range(x.shape[0]):
        row = x[r]
        to = step[r]
        at = real(mean[r, j])
        for i in range(size):
            to[i] = row[begin + i] - at


@njit(**VECTOR)
def log_density_of(
    step: Real, size: int, inverse: F8, log_peak: float, part: Real, out: Real
) -> None:
    """log(weight · N(x; m, Σ)) of ``size`` samples whose x − m is in ``step``; ``part`` is
    scratch.
    """
    real = step.dtype.type
    for i in range(size):
        out[i] = real(0)
    for r in range(step.shape[0]):
        for i in range(size):
            part[i] = real(0)
        for s in range(r + 1):
            row = step[s]
            scale = real(inverse[r, s])
            for i in range(size):
                part[i] += scale * row[i]
        for i in range(size):
            out[i] += part[i] * part[i]
    top = real(log_peak)
    half = real(-0.5)
    for i in range(size):
        out[i] = top + half * out[i]


@njit(**(ENTRY | {"fastmath": FAST}))
def log_densities(x: F8, gaussians: Whitened) -> F8:
    """(k, n) log(weight · N(x)) of every Gaussian at points ``x`` (d, n)."""
    d, n = x.shape
    mean, inverse, log_peak = gaussians
    out = np.empty((log_peak.size, n))
    step = np.empty((d, CHUNK))
    part = np.empty(CHUNK)
    for begin in range(0, n, CHUNK):
        size = min(CHUNK, n - begin)
        for j in range(log_peak.size):
            steps_from(x, begin, size, mean, j, step)
            log_density_of(step, size, inverse[j], log_peak[j], part, out[j, begin:])
    return out


class Volume(NamedTuple):
    """The volume of a density: its bounds ``low`` and ``high`` (d,), the density ``flat`` that is
    added inside, and the density ``outside``."""

    low: F8
    high: F8
    flat: float
    outside: float


@njit(**VECTOR)
def _log_densities_at(
    x: F8, i: int, mean: F8, inverse: F8, log_peak: F8, step: F8, out: F8
) -> None:
    """Write log(weight · N) of k Gaussians at point i into ``out`` (k,); see `densities_inside`.
    ``step`` (d + 1, k) is scratch.
    """
    d, k = mean.shape
    part = step[d]
    for j in range(k):
        out[j] = log_peak[j]
    for r in range(d):
        for j in range(k):
            step[r, j] = x[r, i] - mean[r, j]
            part[j] = inverse[r, r, j] * step[r, j]
        for s in range(r):
            for j in range(k):
                part[j] += inverse[r, s, j] * step[s, j]
        for j in range(k):
            out[j] -= 0.5 * part[j] * part[j]


@njit(**ENTRY)
def densities_inside(x: F8, gaussians: Whitened, volume: Volume) -> F8:
    """(n,) the volume's flat density plus those of the Gaussians at points ``x`` (d, n).

    For a few points and many Gaussians: ``gaussians`` are `Whitened`, with L⁻¹ as (d, d, k). Those
    that do not change the last digit of the flat density are not added.
    """
    d, n = x.shape
    mean, inverse, log_peak = gaussians
    low, high, flat, outside = volume
    least = math.log(flat) - ROUNDED if flat > 0.0 else -np.inf
    step = np.empty((d + 1, log_peak.size))
    each = np.empty(log_peak.size)
    out = np.full(n, outside)
    for i in range(n):
        inside = True
        for r in range(d):
            inside &= low[r] <= x[r, i] <= high[r]
        if not inside:
            continue
        _log_densities_at(x, i, mean, inverse, log_peak, step, each)
        total = flat
        for value in each:
            if value > least:
                total += math.exp(value)
        out[i] = total
    return out


class Candidates(NamedTuple):
    """The components that each of B blocks of samples may belong to.

    ``start`` (B + 1,): block b holds the samples from start[b] to start[b + 1]. ``first`` (B + 1,)
    and ``component`` (P,): its components are component[first[b]:first[b + 1]].
    """

    start: I8
    first: I8
    component: I8


class Moments(NamedTuple):
    """Moments of the samples of each component after an expectation step.

    ``mass`` (k,): Σ of the samples' weights times responsibilities. ``mean`` (d, k), ``covariance``
    (k, d, d) of each component's samples, unchanged without mass. ``background``: mass of the
    background density. ``log_likelihood``: Σ weight · log density, nats.
    """

    mass: F8
    mean: F8
    covariance: F8
    background: float
    log_likelihood: float


class Recursion(NamedTuple):
    """Settings of the recursive form.

    ``prior``: τ, half the number of parameters of a component. ``memory``: 1/β, the number of
    samples that are remembered. ``min_uniform``: smallest share of the uniform density.
    ``log_volume``: logarithm of the volume of the uniform density. ``steady``: number of samples
    taken at the constant rate; later ones have a rate that falls like 1/k, without the prior.
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
    """Candidates with which every sample may belong to every component."""
    return Candidates(np.array([0, samples]), np.array([0, components]), np.arange(components))


@njit(**VECTOR)
def _responsibilities(
    table: Real, count: int, size: int, weight: Real, background: Real, top: Real, total: Real
) -> float:
    """Turn log densities in ``table`` (≥ count, ≥ size) into weight times responsibility; returns Σ
    weight · log density.

    The logarithm in ``background`` becomes the weight times the responsibility of the background;
    ``top``, ``total`` are scratch.
    """
    real = table.dtype.type
    log_likelihood: Any = 0.0
    nothing = real(NOTHING)
    least = real(LEAST)
    zero = real(0)
    for i in range(size):
        top[i] = background[i]
    for c in range(count):
        for i in range(size):
            top[i] = max(top[i], table[c, i])
    for i in range(size):
        # A density of 0 everywhere: any logarithm will do.
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
def _add_moments(
    step: Real, share: Real, size: int, j: int, mass: F8, first: F8, second: F8
) -> None:
    """Add the sums over samples of share, share · step and share · step · stepᵀ to component
    ``j``'s.
    """
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
            second[j, r, s] += total * (
                known.covariance[b, r, s] + step * (known.mean[s, b] - mean[s, j])
            )


@njit(**INNER)
def _from_sums(mixture: Gaussians, mass: F8, first: F8, second: F8) -> tuple[F8, F8]:
    """Means (d, k) and covariances (k, d, d) from sums of steps from the old means."""
    mean = mixture.mean.copy()
    cov = mixture.covariance.copy()
    for j in range(mass.size):
        if mass[j] < NO_MASS:
            continue
        for r in range(mean.shape[0]):
            mean[r, j] += first[j, r] / mass[j]
            for s in range(r + 1):
                cov[j, r, s] = second[j, r, s] / mass[j] - first[j, r] * first[j, s] / (
                    mass[j] * mass[j]
                )
                cov[j, s, r] = cov[j, r, s]
    return mean, cov


@njit(**VECTOR)
def _explain_chunk(
    x: Real,
    begin: int,
    size: int,
    near: I8,
    gaussians: Whitened,
    weight: Real,
    background: Real,
    table: Real,
    step: Real,
    scratch: tuple[Real, Real],
) -> float:
    """Write weight times responsibility of the components ``near`` into ``table``, and of the
    background into ``background``; returns Σ weight · log density.
    """
    mean, inverse, log_peak = gaussians
    part, total = scratch
    for c in range(near.size):
        steps_from(x, begin, size, mean, near[c], step)
        log_density_of(step, size, inverse[near[c]], log_peak[near[c]], part, table[c])
    out: float = _responsibilities(table, near.size, size, weight, background, part, total)
    return out


@njit(**(ENTRY | {"fastmath": FAST}))
def em_step(
    x: Real,
    weight: F8,
    log_background: F8,
    mixture: Gaussians,
    candidates: Candidates,
    known: Gaussians,
) -> Moments:
    """Expectation and the sums of maximisation for weighted samples ``x`` (d, n) [M09 §III-B].

    The new weights, a floor under covariances and a prior are left to the caller. Samples of blocks
    without candidates count for no component. Those of a block with one candidate and no background
    are all that component's: their densities are not computed and not in ``log_likelihood``, and no
    sample is visited if the mass, mean and covariance of the blocks are ``known``.

    ``weight`` (n,) of the samples, or (1,) for all of them. ``log_background`` (n,): logarithm of a
    further density at each sample, (0,) for none; the weights of the ``mixture`` count it in:
    density = background + Σ weight · N(x).
    """
    d = x.shape[0]
    start, first_of, component = candidates
    gaussians = whitened(mixture)
    count = mixture.weight.size
    mass = np.zeros(count)
    first = np.zeros((count, d))
    second = np.zeros((count, d, d))
    widest = 0
    if first_of.size > 1:
        widest = np.max(np.diff(first_of))
    step = np.empty((d, CHUNK), x.dtype)
    table = np.empty((widest, CHUNK), x.dtype)
    scratch = np.empty(CHUNK, x.dtype), np.empty(CHUNK, x.dtype)
    own = np.empty(CHUNK, x.dtype)
    other = np.empty(CHUNK, x.dtype)
    background = 0.0
    log_likelihood = 0.0
    for b in range(start.size - 1):
        near = component[first_of[b] : first_of[b + 1]]
        alone = near.size == 1 and log_background.size == 0
        if alone and known.weight.size > 0:
            _add_known(known, b, near[0], mixture.mean, mass, first, second)
            continue
        for begin in range(start[b], start[b + 1], CHUNK):
            size = min(CHUNK, start[b + 1] - begin)
            for i in range(size):
                own[i] = weight[begin + i] if weight.size > 1 else weight[0]
                other[i] = log_background[begin + i] if log_background.size else -np.inf
            if alone:
                steps_from(x, begin, size, mixture.mean, near[0], step)
                _add_moments(step, own, size, near[0], mass, first, second)
                continue
            log_likelihood += _explain_chunk(
                x, begin, size, near, gaussians, own, other, table, step, scratch
            )
            for i in range(size):
                background += other[i]
            for c in range(near.size):
                steps_from(x, begin, size, mixture.mean, near[c], step)
                _add_moments(step, table[c], size, near[c], mass, first, second)
    mean, cov = _from_sums(mixture, mass, first, second)
    return Moments(mass, mean, cov, background, log_likelihood)


@njit(**INNER)
def _move(mean: F8, cov: F8, step: F8, floor: F8, rate: float) -> None:
    """Move a component by a part ``rate`` of the way to a sample at mean + ``step``, in place [M09
    (19), (20)].
    """
    for r in range(step.size):
        for s in range(r + 1):
            scatter = step[r] * step[s] + (floor[r] if r == s else 0.0)
            cov[r, s] += rate * (scatter - cov[r, s])
            cov[s, r] = cov[r, s]
        mean[r] += rate * step[r]


@njit(**INNER)
def _with_weight(left: F8, mean: F8, cov: F8, root: F8, log_peak: F8) -> tuple[F8, F8, F8, F8, F8]:
    """The components with a weight above 0."""
    kept = np.flatnonzero(left > 0.0)
    return left[kept], mean[kept], cov[kept], root[kept], log_peak[kept]


@njit(**INNER)
def _factored(cov: F8) -> tuple[F8, F8]:
    """Cholesky factors of covariances (k, d, d), and logarithms (k,) of peak densities."""
    root = np.zeros(cov.shape)
    log_peak = np.empty(len(cov))
    for m in range(len(cov)):
        log_peak[m] = -0.5 * (factor(cov[m], root[m]) + cov.shape[1] * LOG_2PI)
    return root, log_peak


@njit(**INNER)
def _rates(rule: Recursion, k: int, count: int, late: float) -> tuple[float, float, float]:
    """The rate β for sample k, τβ, and the sum of rates since the end of the steady samples."""
    rate = min(1.0 / rule.memory, MAX_PRIOR / (rule.prior * count))
    if k < rule.steady:
        return min(1.0, rate), rule.prior * rate, late
    late += rate
    return min(1.0, rate) / (1.0 + late), 0.0, late


@njit(**ENTRY)
def recursive_em(
    mixture: Gaussians, uniform: float, samples: F8, order: I8, rule: Recursion
) -> tuple[Gaussians, float]:
    """The mixture and the share of a uniform density after one sample at a time [M09 (16)-(20)].

    A component whose weight turns negative is removed. After the steady samples, each one counts
    for the Gaussians by the probability that it did not come from the uniform density. That has the
    share ``uniform`` at first, which is not among the weights; these sum to 1. ``order`` (K,):
    indices of the ``samples`` (n, d) in the order in which they are taken; they may repeat.
    """
    left = mixture.weight.copy()
    mean = mixture.mean.T.copy()
    cov = mixture.covariance.copy()
    d = mean.shape[1]
    late = 0.0
    root, log_peak = _factored(cov)
    step = np.empty(d)
    y = np.empty(d)
    for k in range(order.size):
        x = samples[order[k]]
        count = left.size
        # o_m = π_m N_m(x) / Σ_j π_j N_j(x) [M09 (16)]
        share = np.empty(count)
        for m in range(count):
            for r in range(d):
                step[r] = x[r] - mean[m, r]
            share[m] = log_peak[m] - 0.5 * norm2(step, root[m], y) + np.log(left[m])
        top = share.max()
        share = np.exp(share - top)
        total = share.sum()
        share /= total
        # The probability that the sample came from the uniform density, and that density's share.
        log_ratio = min(700.0, top + math.log(total) + rule.log_volume)
        ratio = math.exp(log_ratio) * (1.0 - uniform) / uniform
        flat = 1.0 / (1.0 + ratio)
        beta, prior, late = _rates(rule, k, count, late)
        uniform = max(rule.min_uniform, uniform + beta * (flat - uniform))
        uniform = min(1.0 - rule.min_uniform, uniform)
        if k >= rule.steady:
            beta *= 1.0 - flat
        for m in range(count):
            moved = min(1.0, beta * share[m] / left[m])
            left[m] += beta * ((share[m] - prior) / (1.0 - count * prior) - left[m])
            if moved > NEGLIGIBLE:
                for r in range(d):
                    step[r] = x[r] - mean[m, r]
                _move(mean[m], cov[m], step, rule.floor, moved)
                log_peak[m] = -0.5 * (factor(cov[m], root[m]) + d * LOG_2PI)
        if left.min() <= 0.0:
            left, mean, cov, root, log_peak = _with_weight(left, mean, cov, root, log_peak)
        left /= left.sum()
    return Gaussians(left, mean.T.copy(), cov), uniform
