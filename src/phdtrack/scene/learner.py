"""Learning where targets are born, or where a detector is wrong, one sample after the other [M09 §IV, (16)–(20)].

Recursive MAP-EM [Z04]: for a sample x with responsibilities
o_m = π_m N_m(x) / Σ_j π_j N_j(x), rate β, M components and τ = N/2, N their number of parameters,

    π_m ← π_m + β [(o_m − τβ)/(1 − Mτβ) − π_m]
    μ_m ← μ_m + β (o_m/π_m)(x − μ_m)
    Σ_m ← Σ_m + β (o_m/π_m)((x − μ_m)(x − μ_m)ᵀ + F − Σ_m)

A component whose weight turns negative is removed: one must explain more than τ of the last 1/β samples to stay. α_u follows
the same rule with τ = 0, the Gaussians do not depend on it. What the paper leaves open:

* The rule asks for β < 1/(Mτ), which with the paper's grids is 6e-4: a few hundred samples in one pass would hardly move a
  weight. Samples are taken again and again, each pass in another order, with β = min(1/n, ½/(Mτ)) for n samples: the rate
  rises as components go, up to the one at which the prior counts against n samples. Then the estimate settles: without
  the prior, with β that falls like 1/k, and a sample moves the Gaussians by the probability that it is not the uniform
  part's. That is maximum likelihood with the components that the rule has left.
* Which are left depends on the start: `context.moves` then looks for those that are missing, or one too many, which may be
  where the uniform part explains as much.
* β o_m/π_m is kept below 1, and F, a small diagonal, keeps every covariance above itself.
* A sample may be worth less than one, or more: β is multiplied by that. A sample may not show every component (a birth
  that a person marked has a place and no velocity): o_m is of what it shows, and the rest is replaced by its mean and its
  second moment given that, as in EM with missing values.
* α_u begins at 1 − 1e-3: from 1 nothing would ever be learned. It never leaves [1e-3, 1 − 1e-3].
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from phdtrack.checks import Count, Share, check
from phdtrack.errors import InputError
from phdtrack.kernels.recursive_em import recursive_em
from phdtrack.scene.batch_em import Samples, parameters
from phdtrack.scene.density import ContextDensity
from phdtrack.scene.moves import improved
from phdtrack.types import F8

LEAST_UNIFORM = 1e-3
# Samples taken at most while the rate is steady; passes while it falls.
_MOST = 1_000_000
_SETTLING = 20


@dataclass(frozen=True, slots=True)
class RecursiveEM:
    """Settings of the learner.

    Parameters
    ----------
    memory : samples 1/β that are remembered at most; 0 for what those given at once are worth.
    passes : how often the samples are gone through while the rate is steady; 0: until of two components that explain the
        same one has gone, which takes a multiple of n/2τ passes, or a million samples have been taken.
    floor : F, its standard deviations as parts of the samples' own.
    seed : of the orders in which the samples are taken.
    moves : components that are removed, parted or begun afterwards at most, where that explains the samples better for its
        price (`context.moves`); 0: none, for samples of which more are to come.
    """

    memory: Count = 0
    passes: Count = 0
    floor: Share = 0.01
    seed: int = 0
    moves: Count = 20

    def __post_init__(self) -> None:
        check(self)

    def learn(self, density: ContextDensity, samples: F8, weight: F8 | None = None) -> ContextDensity:
        """``density`` after the ``samples`` (d, n): the same for the same samples. Those outside the volume are left out.

        NaN stands for what a sample does not show. ``weight`` (n,) from 0 is what each is worth, 1 where it is not given.
        Raises `InputError` where samples have another dimension, are infinite or show nothing, weights are none, or the
        density has no Gaussians to move.
        """
        worth = np.ones(samples.shape[-1]) if weight is None else weight
        _fit(density, samples, worth)
        counts = density.contains(_shown(samples, density.low)) & (worth > 0)
        x, worth = np.ascontiguousarray(samples[:, counts].T), np.ascontiguousarray(worth[counts])
        n, d = x.shape
        if n == 0:
            return density
        tau, total = parameters(d) / 2, float(worth.sum())
        passes = self.passes or _passes(n, total, len(density), tau)
        rng = np.random.default_rng(self.seed)
        order = np.concatenate([rng.permutation(n) for _ in range(passes + min(passes, _SETTLING))])
        left, mean, cov = density.weight.copy(), np.ascontiguousarray(density.mean.T), density.covariance.copy()
        floor = self._floor(density, x, worth)
        settings = np.array([tau, self.memory or total, LEAST_UNIFORM])
        alive, uniform = recursive_em(
            left, mean, cov, len(left), min(density.uniform, 1 - LEAST_UNIFORM), x, worth, order, settings,
            np.log(density.high - density.low), floor, passes * n,
        )  # fmt: skip
        kept = left[:alive] / left[:alive].sum()
        found = ContextDensity(density.low, density.high, uniform, kept, mean[:alive].T.copy(), cov[:alive].copy())
        if self.moves:
            found = improved(found, Samples.of(np.ascontiguousarray(x.T), worth, floor, LEAST_UNIFORM), self.moves)
        return found

    def _floor(self, density: ContextDensity, x: F8, worth: F8) -> F8:
        """(d,) F: a part of the samples' variance, and, where that is nothing, of the volume's extent."""
        extent = density.high - density.low
        counts = np.where(np.isnan(x), 0.0, worth[:, None])
        total = np.maximum(counts.sum(axis=0), 1e-300)
        values = np.where(np.isnan(x), 0.0, x)
        variance = (counts * (values - (counts * values).sum(axis=0) / total) ** 2).sum(axis=0) / total
        out: F8 = np.maximum(self.floor**2 * variance, (1e-4 * extent) ** 2)
        return out


def grid(
    low: F8, high: F8, counts: tuple[int, int], centre: F8, spread: F8, uniform: float = 1 - LEAST_UNIFORM
) -> ContextDensity:
    """Where learning begins: counts[0] × counts[1] Gaussians over the positions, rows 0 and 1 [M09 §V].

    ``centre`` and ``spread`` (d,) are mean and standard deviation of the other components (mean size, zero speed); in
    position a Gaussian is as wide as the grid's step. M09 takes 12 × 10 for births and 16 × 14 for false alarms.
    """
    extent = high - low
    steps = np.array(counts)
    across, down = (low[k] + extent[k] * (np.arange(steps[k]) + 0.5) / steps[k] for k in range(2))
    place = np.stack([part.ravel() for part in np.meshgrid(across, down)])
    mean = np.vstack([place, np.tile(centre[2:, None], place.shape[1])])
    deviation = np.concatenate([extent[:2] / steps, spread[2:]])
    m = place.shape[1]
    return ContextDensity(low, high, uniform, np.full(m, 1 / m), mean, np.tile(np.diag(deviation**2), (m, 1, 1)))


def _passes(n: int, total: float, components: int, tau: float) -> int:
    """Passes over n samples worth ``total``, after which what explains nothing has gone, and of two equal components one.

    The first takes the memory of the slowest rate, 2Mτ samples; the weights of equal ones part like exp(2τk/n).
    """
    return min(max(20, math.ceil(6 * components * tau / total), math.ceil(1.5 * total / tau)), max(5, _MOST // n))


def _shown(samples: F8, low: F8) -> F8:
    """The samples with ``low`` (d,), a place in the volume, for what they do not show."""
    return np.where(np.isnan(samples), low[:, None], samples)


def _fit(density: ContextDensity, samples: F8, worth: F8) -> None:
    if samples.ndim != 2 or len(samples) != density.dim:
        raise InputError(f"expected samples ({density.dim}, n), got shape {samples.shape}", where="samples")
    if np.isinf(samples).any() or np.isnan(samples).all(axis=0).any():
        raise InputError(
            "every sample must be finite in what it shows, and show something", where="samples", cure="Leave the others out"
        )
    if worth.shape != samples.shape[1:] or not (np.isfinite(worth) & (worth >= 0)).all():
        raise InputError(f"expected finite weights from 0, one for each of {samples.shape[1]} samples", where="weight")
    if len(density) == 0:
        raise InputError("a density without Gaussians learns nothing", where="density", cure="Begin with context.grid(…)")
