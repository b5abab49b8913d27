"""Gaussian mixtures: their densities at points, and Bayes' rule for a mixture as a prior.

`log_densities` and `mixture_density` evaluate Gaussians that were `whitened` once. `states_given` gives the state that a
measurement shows, of which the mixture is the prior [M09 (14)].
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, FAST, INNER, VECTOR
from phdtrack.kernels.gaussian import LOG_2PI, factor

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
Real = NDArray[np.floating[Any]]

# Points that are evaluated at a time.
CHUNK = 128


class Gaussians(NamedTuple):
    """k weighted Gaussians: ``weight`` (k,), ``mean`` (d, k), ``covariance`` (k, d, d)."""

    weight: F8
    mean: F8
    covariance: F8


class Whitened(NamedTuple):
    """k Gaussians, ready to be evaluated: ``mean`` (d, k), ``inverse`` (k, d, d) L⁻¹ of the covariances L Lᵀ, and
    ``log_peak`` (k,) logarithms of weight times peak density."""

    mean: F8
    inverse: F8
    log_peak: F8


@njit(**ENTRY)
def whitened(mixture: Gaussians) -> Whitened:
    """The Gaussians, ready to be evaluated."""
    count, d = mixture.covariance.shape[0], mixture.covariance.shape[1]
    inverse, log_peak, root = np.zeros((count, d, d)), np.empty(count), np.zeros((d, d))
    for j in range(count):
        log_det = factor(mixture.covariance[j], root)
        log_weight = math.log(mixture.weight[j]) if mixture.weight[j] > 0.0 else -math.inf
        log_peak[j] = log_weight - 0.5 * (log_det + d * LOG_2PI)
        for r in range(d):
            inverse[j, r, r] = 1.0 / root[r, r]
            for s in range(r):
                total = 0.0
                for q in range(s, r):
                    total += root[r, q] * inverse[j, q, s]
                inverse[j, r, s] = -total / root[r, r]
    return Whitened(mixture.mean, inverse, log_peak)


@njit(**VECTOR)
def steps_from(x: Real, begin: int, size: int, mean: F8, j: int, step: Real) -> None:
    """Write x − m of component ``j`` into ``step`` (d, ≥ size)."""
    real = x.dtype.type
    for r in range(x.shape[0]):
        row, to, at = x[r], step[r], real(mean[r, j])
        for i in range(size):
            to[i] = row[begin + i] - at


@njit(**VECTOR)
def log_density_of(step: Real, size: int, inverse: F8, log_peak: float, part: Real, out: Real) -> None:
    """log(weight · N(x; m, Σ)) of ``size`` samples whose x − m is in ``step``; ``part`` is scratch."""
    real = step.dtype.type
    for i in range(size):
        out[i] = real(0)
    for r in range(step.shape[0]):
        for i in range(size):
            part[i] = real(0)
        for s in range(r + 1):
            row, scale = step[s], real(inverse[r, s])
            for i in range(size):
                part[i] += scale * row[i]
        for i in range(size):
            out[i] += part[i] * part[i]
    top, half = real(log_peak), real(-0.5)
    for i in range(size):
        out[i] = top + half * out[i]


@njit(**(ENTRY | {"fastmath": FAST}))
def log_densities(x: F8, gaussians: Whitened) -> F8:
    """(k, n) log(weight · N(x)) of every Gaussian at points ``x`` (d, n)."""
    (d, n), (mean, inverse, log_peak) = x.shape, gaussians
    out, step, part = np.empty((log_peak.size, n)), np.empty((d, CHUNK)), np.empty(CHUNK)
    for begin in range(0, n, CHUNK):
        size = min(CHUNK, n - begin)
        for j in range(log_peak.size):
            steps_from(x, begin, size, mean, j, step)
            log_density_of(step, size, inverse[j], log_peak[j], part, out[j, begin:])
    return out


@njit(**ENTRY)
def mixture_density(x: F8, low: F8, high: F8, flat: float, outside: float, gaussians: Whitened, limit2: F8) -> F8:
    """(n,) ``flat`` plus the Gaussians at points ``x`` (d, n) from ``low`` to ``high`` (d,), and ``outside`` elsewhere.

    Beyond the squared distances ``limit2`` (k,) a Gaussian is left out; often one component alone shows that it is.
    """
    (d, n), (mean, inverse, log_peak) = x.shape, gaussians
    out, step = np.empty(n), np.empty(d)
    for j in range(n):
        inside = True
        for r in range(d):
            inside = inside and low[r] <= x[r, j] <= high[r]
        out[j] = flat if inside else outside
        for m in range(log_peak.size if inside else 0):
            distance2 = 0.0
            for r in range(d):
                step[r] = x[r, j] - mean[r, m]
                value = 0.0
                for s in range(r + 1):
                    value += inverse[m, r, s] * step[s]
                distance2 += value * value
                if distance2 > limit2[m]:
                    break
            if distance2 <= limit2[m]:
                out[j] += math.exp(log_peak[m] - 0.5 * distance2)
    return out


@njit(**INNER)
def _factor_shown(cov: F8, noise: F8, order: I8, step: F8, root: F8, y: F8) -> float:
    """The density at ``step`` of a Gaussian's shown part with noise, but for 2π; y (r,) becomes L⁻¹ step.

    ``root`` (d, r) becomes the factor L, with the inverse of its diagonal.
    """
    inverse, distance2 = 1.0, 0.0
    for a in range(y.size):
        value = step[a]
        for b in range(a + 1):
            total = cov[a, b] + noise[order[a], order[b]]
            for t in range(b):
                total -= root[a, t] * root[b, t]
            if b == a:
                root[a, a] = 1.0 / math.sqrt(total)
            else:
                root[a, b] = total * root[b, b]
                value -= root[a, b] * y[b]
        y[a] = value * root[a, a]
        inverse *= root[a, a]
        distance2 += y[a] * y[a]
    return inverse * math.exp(-0.5 * distance2)


@njit(**INNER)
def _add_hidden(cov: F8, step: F8, root: F8, y: F8, weight: float, first: F8, second: F8) -> None:
    """Add the moments of what a measurement does not show of one Gaussian, given it.

    ``step`` (d − r,) is the mean before, less the point about which the moments are; it becomes that given the measurement.
    """
    shown = y.size
    for i in range(step.size):
        a = shown + i
        for b in range(shown):
            total = cov[a, b]
            for t in range(b):
                total -= root[a, t] * root[b, t]
            root[a, b] = total * root[b, b]
            step[i] += root[a, b] * y[b]
        first[i] += weight * step[i]
        for k in range(i + 1):
            value = cov[a, shown + k] + step[i] * step[k]
            for t in range(shown):
                value -= root[a, t] * root[shown + k, t]
            second[i, k] += weight * value


@njit(**ENTRY)
def states_given(
    state: F8, noise: F8, order: I8, low: F8, high: F8, flat: float, mixture: Gaussians, limit2: F8
) -> tuple[F8, F8, F8]:
    """The density of measurements of a state from a uniform part and Gaussians, and the state given each measurement.

    Parameters
    ----------
    state, noise : (d, n), (n, d, d) states that the measurements show, and their covariances. Of what measurements do not
        show they are mean and covariance under the uniform part.
    order : (d,) the components of the state, those that are shown first.
    low, high : (r,) bounds of what is shown; the density is 0 beyond.
    flat : the uniform part.
    mixture : the Gaussians, in that order of components.
    limit2 : (k,) squared distances beyond which a Gaussian is left out.

    Returns
    -------
    (n,) densities; (d, n), (n, d, d) the states and covariances with mean and covariance of what is not shown.
    """
    (d, n), shown, (weight, mean, cov) = state.shape, low.size, mixture
    total, out, out_cov = np.empty(n), state.copy(), noise.copy()
    hidden, scale = d - shown, (2.0 * math.pi) ** (-0.5 * shown)
    step, y, root = np.empty(d), np.empty(shown), np.empty((d, shown))
    first, second = np.empty(hidden), np.empty((hidden, hidden))
    for j in range(n):
        total[j], inside = flat, True
        for a in range(shown):
            inside = inside and low[a] <= state[order[a], j] <= high[a]
        for a in range(hidden):
            first[a] = 0.0
            for c in range(a + 1):
                second[a, c] = flat * noise[j, order[shown + a], order[shown + c]]
        for m in range(limit2.size):
            near = True
            for a in range(shown):
                step[a] = state[order[a], j] - mean[a, m]
                near = step[a] * step[a] <= limit2[m] * (cov[m, a, a] + noise[j, order[a], order[a]])
                if not near:
                    break
            if not near:
                continue
            for a in range(shown, d):
                step[a] = mean[a, m] - state[order[a], j]
            part = weight[m] * scale * _factor_shown(cov[m], noise[j], order, step, root, y)
            total[j] += part
            _add_hidden(cov[m], step[shown:], root, y, part, first, second)
        for a in range(hidden):
            i = order[shown + a]
            out[i, j] += first[a] / total[j]
            for c in range(a + 1):
                k = order[shown + c]
                out_cov[j, i, k] = second[a, c] / total[j] - first[a] * first[c] / (total[j] * total[j])
                out_cov[j, k, i] = out_cov[j, i, k]
        if not inside:
            total[j] = 0.0
    return total, out, out_cov
