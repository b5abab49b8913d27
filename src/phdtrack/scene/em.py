"""Learning a scene's density from samples: recursive MAP-EM, then EM for the whole model with split
and merge moves.

Equations of the first [M09 §IV-B, (16)-(20); Z04]: docs/methods.md, A learned scene; β is the rate,
and τ = N/2, N the number of parameters of a component. Choices that the paper leaves open:

* The rule needs β < 1/(Mτ), 6e-4 with the paper's grids: one pass over a few hundred samples hardly
  changes a weight. So there are several passes over the samples, each in another order, with
  β = min(1/n, ½/(Mτ)) for n samples. Final passes without the prior, with a rate that falls like
  1/k, let the estimate settle.
* β o_m/π_m stays below 1, and F, a small diagonal, is a lower bound of every covariance.
* Samples may have gaps (NaN): a birth that a person marked has a position but no velocity. Gaps are
  filled from the nearest complete sample.
* α_u starts at 1 − 1e-3, because nothing is ever learned from 1, and stays in [1e-3, 1 − 1e-3].

The recursion ends in a local optimum. EM for the whole model, including the uniform part, then
tries moves: remove a component; split one along its longest axis; add one in a crowd of samples.
The move that minimises

    −log p(x_1 … x_n) + Σ_m τ [log n_m + (d + 2)/(n_m − d − 2)] + M/2 log n

is kept if it lowers this: the N parameters of a component are estimated from the n_m samples that
it explains, and its weight from all samples [S78]. The fraction is half of the correction for few
samples [B94]: with the full correction eight marks are not enough for a component, and without it
eight samples that lie together by chance are.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from phdtrack.errors import InputError
from phdtrack.kernels.mixtures import (
    Gaussians,
    Moments,
    Recursion,
    em_step,
    nothing_known,
    one_block,
    recursive_em,
)
from phdtrack.scene.mixture import SceneDensity, marginal
from phdtrack.types import F8, I8

MIN_UNIFORM = 1e-3
# Standard deviations of F as shares of those of the samples; largest number of moves.
FLOOR = 0.01
MAX_MOVES = 20
_EACH = np.ones(1)
# Largest number of recursion steps at the constant rate; passes at the falling rate.
MAX_RECURSIONS = 1_000_000
SETTLING_PASSES = 20
# EM has converged when a step gains fewer nats; largest number of steps.
CONVERGED = 1e-3
MAX_STEPS = 200
# Steps of EM before moves are compared, and for a new component; number of the best moves that are
# fitted to convergence.
TRIAL_STEPS = 5
NEW_STEPS = 10
FULL_TRIALS = 2
# Largest number of samples that are searched for crowds: the time is quadratic in it.
MAX_CROWD_SAMPLES = 1000


def learn(density: SceneDensity, samples: F8) -> SceneDensity:
    """Learn a density from the samples (d, n), starting from ``density``; NaN marks components
    that a sample does not have. The recursion of `learn_recursively`, then split–merge EM.

    The result is deterministic, and ``density`` itself without samples. Samples outside the volume
    are ignored. Raises `InputError` for samples of another dimension, infinite or without any
    component, and for a ``density`` without Gaussians.

    Parameters
    ----------
    density : where learning starts.
    samples : (d, n), in the units of ``density``; NaN where a component is not known.

    Returns
    -------
    The learned density.
    """
    used = _used(density, samples)
    if used is None:
        return density
    return split_merge(_recursion(density, used), used)


def learn_recursively(density: SceneDensity, samples: F8) -> SceneDensity:
    """Learn a density by the recursion alone, as M09 prints it [M09 §IV-B, (16)-(20)].

    Parameters
    ----------
    density : where learning starts.
    samples : (d, n), as in `learn`, which says what it raises.

    Returns
    -------
    The learned density.
    """
    used = _used(density, samples)
    return density if used is None else _recursion(density, used)


def _used(density: SceneDensity, samples: F8) -> Samples | None:
    """The samples in the volume, without gaps, and the floor of variances; None without any."""
    _check_samples(density, samples)
    used = density.contains(np.where(np.isnan(samples), density.low[:, None], samples))
    x = np.ascontiguousarray(samples[:, used])
    if x.shape[1] == 0:
        return None
    x = _filled(x)
    extent = density.high - density.low
    mean = x.mean(axis=1)[:, None]
    floor: F8 = np.maximum(FLOOR**2 * np.square(x - mean).mean(axis=1), (1e-4 * extent) ** 2)
    return Samples(x, floor)


def _recursion(density: SceneDensity, samples: Samples) -> SceneDensity:
    """The recursion over the samples, several times in other orders."""
    x, floor = samples
    n = x.shape[1]
    tau = parameters(density.dim) / 2
    rng = np.random.default_rng(0)
    # The memory of the slowest rate is 2Mτ samples; the weights of two equal components, one of
    # which should vanish, separate like exp(2τk/n).
    passes = min(
        max(20, math.ceil(6 * len(density) * tau / n), math.ceil(1.5 * n / tau)),
        max(5, MAX_RECURSIONS // n),
    )
    order = np.concatenate(
        [rng.permutation(n) for _ in range(passes + min(passes, SETTLING_PASSES))]
    )
    volume = float(np.log(density.high - density.low).sum())
    gaussians, uniform = recursive_em(
        Gaussians(density.weight, density.mean, density.covariance),
        min(density.uniform, 1 - MIN_UNIFORM),
        np.ascontiguousarray(x.T),
        order,
        Recursion(tau, float(n), MIN_UNIFORM, volume, passes * n, floor),
    )
    return SceneDensity(density.low, density.high, uniform, *gaussians)


def grid(
    low: F8,
    high: F8,
    counts: tuple[int, int],
    centre: F8,
    spread: F8,
    uniform: float = 1 - MIN_UNIFORM,
) -> SceneDensity:
    """A density of counts[0] × counts[1] Gaussians of equal weight over the positions, from which
    learning starts [M09 §IV-B].

    M09 uses 12 × 10 for births and 16 × 14 for false alarms.

    Parameters
    ----------
    low, high : (d,) bounds of the volume; rows 0 and 1 are the position.
    counts : Gaussians across and down; their standard deviation is the step of the grid.
    centre, spread : (d,) mean and standard deviation of the other components (mean size, zero
        velocity).
    uniform : α_u.

    Returns
    -------
    The density.
    """
    extent = high - low
    steps = np.array(counts)
    across, down = (low[k] + extent[k] * (np.arange(steps[k]) + 0.5) / steps[k] for k in range(2))
    place = np.stack([part.ravel() for part in np.meshgrid(across, down)])
    m = place.shape[1]
    mean = np.vstack([place, np.tile(centre[2:, None], m)])
    deviation = np.concatenate([extent[:2] / steps, spread[2:]])
    return SceneDensity(
        low, high, uniform, np.full(m, 1 / m), mean, np.tile(np.diag(deviation**2), (m, 1, 1))
    )


def parameters(dim: int) -> int:
    """N, the number of parameters of a component: mean and covariance; 27 in six dimensions, 14 in
    four.
    """
    return dim + dim * (dim + 1) // 2


def limited_uniform(share: float) -> float:
    """α_u within its limits."""
    return min(1 - MIN_UNIFORM, max(MIN_UNIFORM, share))


def best_uniform(log_ratio: F8) -> float:
    """α_u of maximum likelihood within its limits, by EM, for the (n,) `SceneDensity.log_ratio` of
    the samples.
    """
    ratio = np.exp(np.minimum(700.0, log_ratio))
    share = 0.5
    for _ in range(MAX_STEPS):
        share = limited_uniform(float(np.mean(share / (share + (1 - share) * ratio))))
    return share


class Samples(NamedTuple):
    """Samples ``x`` (d, n), and the ``floor`` (d,) that is added to variances."""

    x: F8
    floor: F8

    @property
    def total(self) -> float:
        """Their number."""
        return float(self.x.shape[1])


def moments(p: SceneDensity, samples: Samples) -> Moments:
    """One step of EM for p, including its uniform part; ignores truncation."""
    mixture = Gaussians((1 - p.uniform) * p.weight, p.mean, p.covariance)
    n = samples.x.shape[1]
    flat = np.full(n, math.log(p.flat))
    updated: Moments = em_step(
        samples.x, _EACH, flat, mixture, one_block(n, len(p)), nothing_known(p.dim)
    )
    return updated._replace(covariance=updated.covariance + np.diag(samples.floor))


def fit_em(p: SceneDensity, samples: Samples, steps: int = MAX_STEPS) -> SceneDensity:
    """Fit ``p`` by at most ``steps`` steps of EM. Components that explain less than τ samples are
    removed, except the last.

    Parameters
    ----------
    p : the initial density.
    samples : the data.
    steps : largest number of steps.
    """
    before = -math.inf
    for _ in range(steps):
        now = moments(p, samples)
        if now.log_likelihood - before < CONVERGED:
            break
        before = now.log_likelihood
        keep = now.mass > min(parameters(p.dim) / 2, 0.999 * float(now.mass.max()))
        if keep.all():
            uniform = limited_uniform(now.background / samples.total)
            weight = now.mass / now.mass.sum()
            p = replace(p, uniform=uniform, weight=weight, mean=now.mean, covariance=now.covariance)
        else:
            p = _without(p, np.flatnonzero(~keep))
            before = -math.inf
    return p


def split_merge(p: SceneDensity, samples: Samples) -> SceneDensity:
    """Fit ``p`` by split–merge EM."""
    p = fit_em(p, samples)
    length = criterion(p, samples)
    for _ in range(MAX_MOVES):
        trials = [fit_em(trial, samples, TRIAL_STEPS) for trial in _moves(p, samples)]
        best = np.argsort([criterion(trial, samples) for trial in trials])[:FULL_TRIALS]
        fitted = [fit_em(trials[i], samples) for i in best]
        lengths = [criterion(trial, samples) for trial in fitted]
        shortest = int(np.argmin(lengths))
        if not lengths[shortest] < length - CONVERGED:
            break
        p = fitted[shortest]
        length = lengths[shortest]
    return p


def criterion(p: SceneDensity, samples: Samples) -> float:
    """The description length that moves minimise, nats [S78; B94]."""
    tau = parameters(p.dim) / 2
    n = np.maximum(samples.total * (1 - p.uniform) * p.weight, tau)
    penalty = tau * (np.log(n) + (p.dim + 2) / (n - p.dim - 2)) + 0.5 * math.log(samples.total)
    return float(penalty.sum()) - moments(p, samples).log_likelihood


def _moves(p: SceneDensity, samples: Samples) -> list[SceneDensity]:
    """The results of all moves from ``p``."""
    results = []
    if len(p) > 1:
        results += [_without(p, np.array([m])) for m in range(len(p))]
    results += [_split(p, m) for m in range(len(p))]
    return results + _with_crowds(p, samples)


def _without(p: SceneDensity, removed: I8) -> SceneDensity:
    """``p`` without the components ``removed``."""
    weight = np.delete(p.weight, removed)
    mean = np.delete(p.mean, removed, axis=1)
    covariance = np.delete(p.covariance, removed, axis=0)
    return replace(p, weight=weight / weight.sum(), mean=mean, covariance=covariance)


def _split(p: SceneDensity, m: int) -> SceneDensity:
    """``p`` with component m split along the longest axis of its correlation matrix."""
    deviation = np.sqrt(np.diag(p.covariance[m]))
    values, vectors = np.linalg.eigh(p.covariance[m] / np.outer(deviation, deviation))
    # The mean of half a normal distribution is √(2/π) standard deviations from its centre.
    step = math.sqrt(2 / math.pi * values[-1]) * vectors[:, -1] * deviation
    half = p.covariance[m] - np.outer(step, step)
    weight = np.append(np.delete(p.weight, m), np.full(2, p.weight[m] / 2))
    mean = np.column_stack([np.delete(p.mean, m, axis=1), p.mean[:, m] - step, p.mean[:, m] + step])
    return replace(
        p,
        weight=weight,
        mean=mean,
        covariance=np.concatenate([np.delete(p.covariance, m, axis=0), [half] * 2]),
    )


def _with_crowds(p: SceneDensity, samples: Samples) -> list[SceneDensity]:
    """The densities with one more component, each fitted to another crowd of samples while the
    components of ``p`` stay fixed.
    """
    n = samples.x.shape[1]
    x = samples.x
    floor = np.diag(samples.floor)
    parts = p.log_parts(x)
    results = []
    log_density = np.logaddexp.reduce(parts, axis=0)
    for near in _crowds(p, np.argmax(parts, axis=0), x, samples.floor):
        share = len(near) / n
        mean = x[:, near].mean(axis=1)[:, None]
        cov = (np.cov(x[:, near], bias=True) + floor)[None]
        for _ in range(NEW_STEPS):
            mixture = Gaussians(np.array([share]), mean, cov)
            others = log_density + math.log(1 - share)
            now = em_step(x, _EACH, others, mixture, one_block(n, 1), nothing_known(len(x)))
            mean = now.mean
            cov = now.covariance + floor
            share = min(float(now.mass[0]) / samples.total, 0.5)
        if share * samples.total > parameters(p.dim) / 2:
            uniform = (1 - share) * p.uniform
            weight = np.append((1 - share) * (1 - p.uniform) * p.weight, share) / (1 - uniform)
            means = np.hstack([p.mean, mean])
            covariances = np.concatenate([p.covariance, cov])
            results.append(SceneDensity(p.low, p.high, uniform, weight, means, covariances))
    return results


def _crowds(p: SceneDensity, owner: I8, x: F8, floor: F8) -> list[I8]:
    """The densest crowd among the samples x (d, n) of each part of the mixture, as indices of
    samples. ``owner`` (n,) is the part that explains each sample best.

    A crowd is a sample with its nearest neighbours in position, as many as a component must
    explain. Its density is compared with that of the mixture.
    """
    k = math.ceil(parameters(p.dim) / 2) + 1
    place = np.ascontiguousarray(x[:2, :MAX_CROWD_SAMPLES])
    owner = owner[:MAX_CROWD_SAMPLES]
    if place.shape[1] <= k:
        return []
    scaled = place / np.sqrt(place.var(axis=1) + floor[:2])[:, None]
    distance2 = np.square(scaled[:, :, None] - scaled[:, None]).sum(axis=0)
    near = np.argpartition(distance2, k - 1, axis=1)[:, :k]
    radius2 = np.maximum(np.take_along_axis(distance2, near, axis=1).max(axis=1), 1e-12)
    score = -np.log(radius2) - marginal(p, (0, 1)).log(place)
    owned_samples = (np.flatnonzero(owner == part) for part in np.unique(owner))
    return [near[owned[np.argmax(score[owned])]] for owned in owned_samples]


def _filled(x: F8) -> F8:
    """Fill the gaps of samples (d, n) from the nearest complete sample, or with 0 if there is
    none.
    """
    gaps = np.isnan(x)
    complete = x[:, ~gaps.any(axis=0)]
    out = np.where(gaps, 0.0, x)
    if not complete.shape[1]:
        return out
    scale = np.maximum(complete.std(axis=1), 1e-150)
    for j in np.flatnonzero(gaps.any(axis=0)):
        step = np.where(gaps[:, j], 0.0, (complete - out[:, [j]]).T / scale)
        nearest = np.argmin(np.square(step).sum(axis=1))
        out[gaps[:, j], j] = complete[gaps[:, j], nearest]
    return out


def _check_samples(density: SceneDensity, samples: F8) -> None:
    """Raise `InputError` if nothing can be learned from the samples."""
    if samples.ndim != 2 or len(samples) != density.dim:
        raise InputError(
            f"expected samples ({density.dim}, n), got shape {samples.shape}", where="samples"
        )
    if np.isinf(samples).any() or np.isnan(samples).all(axis=0).any():
        raise InputError(
            "every sample needs at least one component, and no infinite one",
            where="samples",
            cure="Omit the others",
        )
    if len(density) == 0:
        raise InputError(
            "a density without Gaussians cannot learn",
            where="density",
            cure="Start with scene.grid(…)",
        )
