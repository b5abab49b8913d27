"""Learning a scene's density from samples: recursive MAP-EM, then EM for the whole model with split and merge moves.

Recursive MAP-EM [M09 §IV-B, (16)-(20); Z04]: for a sample x with responsibilities o_m = π_m N_m(x) / Σ_j π_j N_j(x), rate β,
M components and τ = N/2, N the number of parameters of a component,

    π_m ← π_m + β [(o_m − τβ)/(1 − Mτβ) − π_m]
    μ_m ← μ_m + β (o_m/π_m)(x − μ_m)
    Σ_m ← Σ_m + β (o_m/π_m)((x − μ_m)(x − μ_m)ᵀ + F − Σ_m)

A component whose weight turns negative is removed. α_u follows the same rule with τ = 0. What the paper leaves open:

* The rule needs β < 1/(Mτ), 6e-4 with the paper's grids, so that one pass over a few hundred samples hardly moves a weight.
  The samples are taken in several passes, each in another order, with β = min(1/n, ½/(Mτ)) for n samples. Then the estimate
  settles: without the prior, with a rate that falls like 1/k.
* β o_m/π_m stays below 1, and F, a small diagonal, keeps every covariance above itself.
* Samples are weighted, and may have gaps (NaN): a birth that a person marked has a place but no velocity. The recursion
  fills a gap from the nearest complete sample; EM afterwards treats it as a missing value.
* α_u begins at 1 − 1e-3, because from 1 nothing is ever learned, and stays within [1e-3, 1 − 1e-3].

The recursion ends in a local optimum. EM for the whole model, uniform part included, then tries moves: a component goes; one
is split along its longest axis; a new one begins where samples crowd. The move that makes

    −log p(x_1 … x_n) + Σ_m τ [log n_m + (d + 2)/(n_m − d − 2)] + M/2 log n

smallest stays, if it makes it smaller: the N parameters of a component are known from the n_m samples that it explains, and
its weight from all [S78]. The fraction is half of the correction for few samples [B94]: with all of it eight marks are no
place, and with none of it eight samples that lie together by chance are one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from phdtrack.checks import Count, Share, check
from phdtrack.errors import InputError
from phdtrack.kernels.em import Gaussians, Moments, Recursion, em_step, one_block, recursive_em
from phdtrack.scene.mixture import SceneDensity, marginal
from phdtrack.types import F8, I8

MIN_UNIFORM = 1e-3
# Samples taken at the steady rate, at most; passes while the rate falls.
MAX_TAKEN, SETTLING_PASSES = 1_000_000, 20
# EM has converged where a step gains fewer nats; steps at most.
CONVERGED, MAX_STEPS = 1e-3, 200
# Steps of EM after which moves are compared, and for a new component; how many of the best moves are fitted wholly.
TRIAL_STEPS, NEW_STEPS, FULL_TRIALS = 5, 10, 2
# Samples among which crowds are looked for, at most: the time grows with their number squared.
MAX_CROWD_SAMPLES = 1000


@dataclass(frozen=True, slots=True)
class RecursiveEM:
    """Settings of the learner.

    Parameters
    ----------
    memory : samples 1/β that are remembered at most; 0 for the weight of the samples that are given at once.
    passes : passes over the samples at the steady rate; 0 for as many as part two components that explain the same.
    floor : standard deviations of F as parts of the samples' own.
    seed : of the orders in which the samples are taken.
    moves : split and merge moves at most; 0 for samples of which more are to come.
    """

    memory: Count = 0
    passes: Count = 0
    floor: Share = 0.01
    seed: int = 0
    moves: Count = 20

    def __post_init__(self) -> None:
        check(self)

    def learn(self, density: SceneDensity, samples: F8, weight: F8 | None = None) -> SceneDensity:
        """``density`` after the samples: the same for the same samples. Samples outside the volume are left out.

        Parameters
        ----------
        density : where learning begins.
        samples : (d, n), NaN where a sample does not show a component.
        weight : (n,) from 0, 1 for each where it is None.

        Raises
        ------
        InputError : samples of another dimension, infinite or without any component; wrong weights; no Gaussians to move.
        """
        weights = np.ones(samples.shape[-1]) if weight is None else weight
        _check_samples(density, samples, weights)
        shown = np.where(np.isnan(samples), density.low[:, None], samples)
        used = density.contains(shown) & (weights > 0)
        x, weights = np.ascontiguousarray(samples[:, used]), np.ascontiguousarray(weights[used])
        n = x.shape[1]
        if n == 0:
            return density
        tau, total = parameters(density.dim) / 2, float(weights.sum())
        passes = self.passes or _passes(n, total, len(density), tau)
        rng = np.random.default_rng(self.seed)
        order = np.concatenate([rng.permutation(n) for _ in range(passes + min(passes, SETTLING_PASSES))])
        _, variance = known_moments(x, weights)
        floor: F8 = np.maximum(self.floor**2 * variance, (1e-4 * (density.high - density.low)) ** 2)
        volume = float(np.log(density.high - density.low).sum())
        left, uniform = recursive_em(
            Gaussians(density.weight, density.mean, density.covariance),
            min(density.uniform, 1 - MIN_UNIFORM),
            np.ascontiguousarray(_filled(x, variance).T),
            weights,
            order,
            Recursion(tau, self.memory or total, MIN_UNIFORM, volume, passes * n, floor),
        )
        found = SceneDensity(density.low, density.high, uniform, *left)
        return improved(found, Samples.of(x, weights, floor, MIN_UNIFORM), self.moves) if self.moves else found


def grid(
    low: F8, high: F8, counts: tuple[int, int], centre: F8, spread: F8, uniform: float = 1 - MIN_UNIFORM
) -> SceneDensity:
    """A density of counts[0] × counts[1] Gaussians over the positions, where learning begins [M09 §IV-B].

    M09 takes 12 × 10 for births and 16 × 14 for false alarms.

    Parameters
    ----------
    low, high : (d,) bounds of the volume; rows 0 and 1 are the position.
    counts : Gaussians across and down; in position each is as wide as the grid's step.
    centre, spread : (d,) mean and standard deviation of the other components (mean size, zero velocity).
    uniform : α_u.
    """
    extent = high - low
    steps = np.array(counts)
    across, down = (low[k] + extent[k] * (np.arange(steps[k]) + 0.5) / steps[k] for k in range(2))
    place = np.stack([part.ravel() for part in np.meshgrid(across, down)])
    mean = np.vstack([place, np.tile(centre[2:, None], place.shape[1])])
    deviation = np.concatenate([extent[:2] / steps, spread[2:]])
    m = place.shape[1]
    return SceneDensity(low, high, uniform, np.full(m, 1 / m), mean, np.tile(np.diag(deviation**2), (m, 1, 1)))


def parameters(dim: int) -> int:
    """N, the number of parameters of a component: mean and covariance; 27 in six dimensions, 14 in four."""
    return dim + dim * (dim + 1) // 2


def known_moments(samples: F8, weight: F8) -> tuple[F8, F8]:
    """Weighted means and variances (d,) of samples (d, n) over the values that are not NaN."""
    counts = np.where(np.isnan(samples), 0.0, weight)
    values, total = np.where(np.isnan(samples), 0.0, samples), np.maximum(counts.sum(axis=1), 1e-300)
    mean = (counts * values).sum(axis=1) / total
    return mean, (counts * (values - mean[:, None]) ** 2).sum(axis=1) / total


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Weighted samples with gaps.

    ``x`` (d, n), NaN in gaps; ``weight`` (n,); ``floor`` (d,) added to variances; ``min_uniform`` share of the uniform part;
    ``groups``: the samples (k,) that show the same rows (r,).
    """

    x: F8
    weight: F8
    floor: F8
    min_uniform: float
    groups: tuple[tuple[I8, I8], ...]

    @classmethod
    def of(cls, x: F8, weight: F8, floor: F8, min_uniform: float) -> Samples:
        """Grouped by the rows that they show."""
        shown, group = np.unique(~np.isnan(x), axis=1, return_inverse=True)
        each = [(np.flatnonzero(group.ravel() == g), np.flatnonzero(shown[:, g])) for g in range(shown.shape[1])]
        return cls(x, weight, floor, min_uniform, tuple(each))

    @property
    def total(self) -> float:
        """Sum of the weights."""
        return float(self.weight.sum())


def moments(p: SceneDensity, samples: Samples) -> Moments:
    """One step of EM for p, its uniform part included. Truncation is left out.

    A sample with gaps stands for its conditional mean and second moment given what it shows, as in EM with missing values.
    """
    count, extent = len(p), np.log(p.high - p.low)
    mass, first, second = np.zeros(count), np.zeros((p.dim, count)), np.zeros((count, p.dim, p.dim))
    background = log_likelihood = 0.0
    for which, rows in samples.groups:
        mixture = Gaussians(
            (1 - p.uniform) * p.weight, np.ascontiguousarray(p.mean[rows]), p.covariance[:, rows[:, None], rows]
        )
        flat = np.full(len(which), math.log(p.uniform) - extent[rows].sum())
        x = np.ascontiguousarray(samples.x[rows[:, None], which])
        found = em_step(x, samples.weight[which], flat, mixture, one_block(len(which), count))
        step, cov = np.zeros((p.dim, count)), np.empty((count, p.dim, p.dim))
        step[rows] = found.mean - mixture.mean
        cov[:, rows[:, None], rows] = found.covariance + np.diag(samples.floor[rows])
        rest = np.setdiff1d(np.arange(p.dim), rows)
        if len(rest):
            across = p.covariance[:, rest[:, None], rows]
            gain = across @ np.linalg.inv(mixture.covariance)
            step[rest] = np.einsum("mur,rm->um", gain, step[rows])
            seen = gain @ found.covariance
            cov[:, rest[:, None], rows], cov[:, rows[:, None], rest] = seen, seen.transpose(0, 2, 1)
            left = p.covariance[:, rest[:, None], rest] - gain @ across.transpose(0, 2, 1)
            cov[:, rest[:, None], rest] = seen @ gain.transpose(0, 2, 1) + left
        mass += found.mass
        first += found.mass * step
        second += found.mass[:, None, None] * (cov + step.T[:, :, None] * step.T[:, None, :])
        background += found.background
        log_likelihood += found.log_likelihood
    step, divisor = first / np.maximum(mass, 1e-300), np.maximum(mass, 1e-300)[:, None, None]
    cov = second / divisor - step.T[:, :, None] * step.T[:, None, :]
    return Moments(mass, p.mean + step, 0.5 * (cov + cov.transpose(0, 2, 1)), background, log_likelihood)


def fitted(p: SceneDensity, samples: Samples, steps: int = MAX_STEPS) -> SceneDensity:
    """``p`` after at most so many steps of EM; components that explain less than τ samples go, all but the last."""
    before = -math.inf
    for _ in range(steps):
        now = moments(p, samples)
        if now.log_likelihood - before < CONVERGED:
            break
        before = now.log_likelihood
        keep = now.mass > min(parameters(p.dim) / 2, 0.999 * float(now.mass.max()))
        if keep.all():
            uniform = min(1 - samples.min_uniform, max(samples.min_uniform, now.background / samples.total))
            weight = now.mass / now.mass.sum()
            p = replace(p, uniform=uniform, weight=weight, mean=now.mean, covariance=now.covariance)
        else:
            p, before = taken(p, np.flatnonzero(keep)), -math.inf
    return p


def taken(p: SceneDensity, which: I8) -> SceneDensity:
    """``p`` with only the components ``which``."""
    weight = p.weight[which]
    return replace(p, weight=weight / weight.sum(), mean=p.mean[:, which], covariance=p.covariance[which])


def improved(p: SceneDensity, samples: Samples, moves: int) -> SceneDensity:
    """``p`` fitted to the samples, after at most so many split and merge moves."""
    p = fitted(p, samples)
    length = criterion(p, samples)
    for _ in range(moves):
        better = _best_move(p, length, samples)
        if better is None:
            break
        p, length = better
    return p


def criterion(p: SceneDensity, samples: Samples) -> float:
    """What moves make smaller, nats [S78; B94]."""
    tau = parameters(p.dim) / 2
    n = np.maximum(samples.total * (1 - p.uniform) * p.weight, tau)
    price = tau * (np.log(n) + (p.dim + 2) / (n - p.dim - 2)) + 0.5 * math.log(samples.total)
    return float(price.sum()) - moments(p, samples).log_likelihood


def _best_move(p: SceneDensity, length: float, samples: Samples) -> tuple[SceneDensity, float] | None:
    """The best of what a move makes of ``p``, with its criterion; None where that is not below ``length``."""
    count = len(p)
    without = [taken(p, np.delete(np.arange(count), m)) for m in range(count)] if count > 1 else []
    candidates = (*without, *(_split(p, m) for m in range(count)), *_with_crowds(p, samples))
    trials = [fitted(trial, samples, TRIAL_STEPS) for trial in candidates]
    lengths = np.array([criterion(trial, samples) for trial in trials])
    found = None
    for i in np.argsort(lengths)[:FULL_TRIALS]:
        trial = fitted(trials[i], samples)
        now = criterion(trial, samples)
        if now < length - CONVERGED:
            found, length = (trial, now), now
    return found


def _split(p: SceneDensity, m: int) -> SceneDensity:
    """``p`` with component m in two halves along the longest axis of its correlation matrix."""
    deviation = np.sqrt(np.diag(p.covariance[m]))
    values, vectors = np.linalg.eigh(p.covariance[m] / np.outer(deviation, deviation))
    # The mean of half a normal distribution is √(2/π) deviations from its middle.
    step = math.sqrt(2 / math.pi * values[-1]) * vectors[:, -1] * deviation
    half = p.covariance[m] - np.outer(step, step)
    others = np.delete(np.arange(len(p)), m)
    weight = np.concatenate([p.weight[others], np.full(2, p.weight[m] / 2)])
    mean = np.column_stack([p.mean[:, others], p.mean[:, m] - step, p.mean[:, m] + step])
    return replace(p, weight=weight, mean=mean, covariance=np.concatenate([p.covariance[others], [half, half]]))


def _with_crowds(p: SceneDensity, samples: Samples) -> list[SceneDensity]:
    """``p`` with one more component, fitted while ``p`` stays as it is: each begins in another crowd of samples."""
    complete = np.flatnonzero(np.isfinite(samples.x).all(axis=0) & (samples.weight > 0))
    x, weight = np.ascontiguousarray(samples.x[:, complete]), samples.weight[complete]
    parts, found = p.log_parts(x), []
    log_density, floor = np.logaddexp.reduce(parts, axis=0), np.diag(samples.floor)
    for near in _crowds(p, np.argmax(parts, axis=0), x, samples.floor):
        share = len(near) / len(samples.weight)
        mean, cov = x[:, near].mean(axis=1)[:, None], (np.cov(x[:, near], bias=True) + floor)[None]
        for _ in range(NEW_STEPS):
            mixture = Gaussians(np.array([share]), mean, cov)
            now = em_step(x, weight, log_density + math.log(1 - share), mixture, one_block(len(complete), 1))
            mean, cov, share = now.mean, now.covariance + floor, min(float(now.mass[0]) / samples.total, 0.5)
        if share * samples.total > parameters(p.dim) / 2:
            uniform = (1 - share) * p.uniform
            all_weights = np.append((1 - share) * (1 - p.uniform) * p.weight, share) / (1 - uniform)
            all_covariances = np.concatenate([p.covariance, cov])
            found.append(SceneDensity(p.low, p.high, uniform, all_weights, np.hstack([p.mean, mean]), all_covariances))
    return found


def _crowds(p: SceneDensity, owner: I8, x: F8, floor: F8) -> list[I8]:
    """Of the samples x (d, n) of each part, ``owner`` (n,), those around the one that lies in the densest unexplained crowd.

    A crowd are the nearest samples in position, as many as a component must explain.
    """
    k = math.ceil(parameters(p.dim) / 2) + 1
    place, owner = np.ascontiguousarray(x[:2, :MAX_CROWD_SAMPLES]), owner[:MAX_CROWD_SAMPLES]
    if place.shape[1] <= k:
        return []
    scaled = place / np.sqrt(place.var(axis=1) + floor[:2])[:, None]
    distance2 = np.square(scaled[:, :, None] - scaled[:, None]).sum(axis=0)
    near = np.argpartition(distance2, k - 1, axis=1)[:, :k]
    radius2 = np.maximum(np.take_along_axis(distance2, near, axis=1).max(axis=1), 1e-12)
    score = -np.log(radius2) - marginal(p, (0, 1)).log(place)
    members = (np.flatnonzero(owner == part) for part in np.unique(owner))
    return [near[those[np.argmax(score[those])]] for those in members]


def _filled(x: F8, variance: F8) -> F8:
    """Samples (d, n) whose gaps are filled from the nearest complete one, with 0 where there is none."""
    gaps = np.isnan(x)
    complete = x[:, ~gaps.any(axis=0)]
    out = np.where(gaps, 0.0, x)
    if complete.shape[1]:
        for j in np.flatnonzero(gaps.any(axis=0)):
            step = np.where(gaps[:, [j]], 0.0, complete - out[:, [j]])
            nearest = np.argmin((np.square(step) / np.maximum(variance, 1e-300)[:, None]).sum(axis=0))
            out[gaps[:, j], j] = complete[gaps[:, j], nearest]
    return out


def _passes(n: int, total: float, components: int, tau: float) -> int:
    """Passes over n samples of this total weight, after which one of two equal components has gone.

    The first takes the memory of the slowest rate, 2Mτ samples; the weights of equal ones part like exp(2τk/n).
    """
    return min(max(20, math.ceil(6 * components * tau / total), math.ceil(1.5 * total / tau)), max(5, MAX_TAKEN // n))


def _check_samples(density: SceneDensity, samples: F8, weight: F8) -> None:
    """Raise `InputError` where the learner cannot take the samples."""
    if samples.ndim != 2 or len(samples) != density.dim:
        raise InputError(f"expected samples ({density.dim}, n), got shape {samples.shape}", where="samples")
    if np.isinf(samples).any() or np.isnan(samples).all(axis=0).any():
        raise InputError(
            "every sample must be finite in what it shows, and show something", where="samples", cure="Leave the others out"
        )
    if weight.shape != samples.shape[1:] or not (np.isfinite(weight) & (weight >= 0)).all():
        raise InputError(f"expected finite weights from 0, one for each of {samples.shape[1]} samples", where="weight")
    if len(density) == 0:
        raise InputError("a density without Gaussians learns nothing", where="density", cure="Begin with scene.grid(…)")
