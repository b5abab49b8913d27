"""Births, false alarms or objects as an online mixture with forgetting, and the evidence whether to use it [M09 §VI].

The recursive rule, moved by single samples, follows many false alarms per second well, and one birth in ten seconds badly:
its rate must stay below ½/(Mτ). So the samples of the last minutes are kept, a few of each batch, with weights that fade as
exp(−age/memory), and the density is learned again from them, beginning from what it was. Where samples that it does not
explain crowd, more than a component must explain to stay (τ), a new component begins.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from phdtrack.scene.em import MIN_UNIFORM, best_uniform, learn, limited_uniform, parameters
from phdtrack.scene.files import LearnedDensity
from phdtrack.scene.mixture import SceneDensity, uniform_density
from phdtrack.scene.training import predictive, with_prior
from phdtrack.types import F8

# Samples from which the evidence decides, and standard errors that its mean must be away from 0.
MIN_EVIDENCE, STANDARD_ERRORS = 10.0, 2.0
# The evidence fades over so many samples at least, or over this part of the memory's.
MIN_FADING, FADING_SHARE = 30.0, 1 / 20
# Samples that are kept of a batch; samples that stand for what was learned before; memories after which one is dropped.
KEPT_PER_BATCH, MAX_PRIOR_SAMPLES, MAX_AGE = 12, 400, 2.0
# Passes of the recursion over the samples each time, which begins where it was, and its floor.
PASSES, FLOOR = 3, 0.005
# New components at a time, and newest samples among which they are looked for; steps of EM for the uniform share.
MAX_NEW, NEWEST, UNIFORM_STEPS = 4, 200, 20
# How far samples of one place lie apart, in parts of their size: boxes of one thing, targets at an entrance.
NEAR_BOX, NEAR_ENTRANCE = 0.15, 1.0


@dataclass(frozen=True, slots=True)
class Evidence:
    """Gains of recent samples: their number (older ones count for less), sum and sum of squares."""

    count: float = 0.0
    total: float = 0.0
    squares: float = 0.0

    @classmethod
    def of(cls, gain: F8, weight: F8) -> Evidence:
        """The gains (k,) of samples of weight (k,)."""
        return cls(float(weight.sum()), float(weight @ gain), float(weight @ np.square(gain)))

    def joined(self, new: Evidence, fading: float) -> Evidence:
        """With newer gains; older ones fade over ``fading`` samples."""
        fade = math.exp(-new.count / fading)
        return Evidence(fade * self.count + new.count, fade * self.total + new.total, fade * self.squares + new.squares)

    @property
    def mean(self) -> float:
        """The mean gain; 0 without samples."""
        return self.total / self.count if self.count else 0.0

    @property
    def sign(self) -> int:
        """1 where the density explains new samples better than the other one, −1 where worse, 0 while that is not sure."""
        if self.count < MIN_EVIDENCE:
            return 0
        error = math.sqrt(max(self.squares / self.count - self.mean**2, 0.0) / self.count)
        if abs(self.mean) <= STANDARD_ERRORS * error:
            return 0
        return 1 if self.mean > 0 else -1


class Batch(NamedTuple):
    """Samples (d, k) of the last seconds with ``weight`` (k,).

    ``exposure``: time in which they came, in time units for births, in frames for false alarms; ``rate`` of it per second.
    """

    samples: F8
    weight: F8
    exposure: float
    rate: float

    @property
    def seconds(self) -> float:
        """How long it took."""
        return self.exposure / self.rate


@dataclass(frozen=True, slots=True, eq=False)
class OnlineMixture:
    """Births, false alarms or objects as they are learned online.

    Attributes
    ----------
    density : what was learned, the uniform one at first.
    memory : seconds after which a sample counts for 37 %.
    samples, weight, time : (d, n), (n,), (n,) recent samples, their weights when they came, and that time, seconds.
    amount, exposure : sum of weights and time in which they came, both fading: their ratio is the rate.
    clock : seconds for which it was learned.
    evidence : for the density, of recent samples; ``newest`` : of the last batch.
    trusted : whether the density is in use.
    """

    density: SceneDensity
    memory: float
    samples: F8
    weight: F8
    time: F8
    amount: float = 0.0
    exposure: float = 0.0
    clock: float = 0.0
    evidence: Evidence = field(default_factory=Evidence)
    newest: Evidence = field(default_factory=Evidence)
    trusted: bool = False

    @classmethod
    def unknown(cls, volume: tuple[F8, F8], memory: float) -> OnlineMixture:
        """Nothing learned of a volume with these bounds."""
        return cls(uniform_density(*volume), memory, np.zeros((len(volume[0]), 0)), np.zeros(0), np.zeros(0))

    def known(self, learned: LearnedDensity | None, rate: float) -> OnlineMixture:
        """What was learned before, as if it had come within the memory before now, in the volume of this one.

        Draws of its Gaussians stand for the samples; the uniform part is mostly the prior. ``rate`` as of `Batch`.
        """
        if learned is None:
            return self
        count = max(1, min(MAX_PRIOR_SAMPLES, learned.samples))
        seen = replace(learned.density, uniform=MIN_UNIFORM) if len(learned.density) else learned.density
        exposure, drawn = self.memory * rate, seen.sample(count, np.random.default_rng(0))
        amount, density = learned.rate * exposure, replace(learned.density, low=self.density.low, high=self.density.high)
        weight = np.full(count, amount / count)
        return OnlineMixture(density, self.memory, drawn, weight, np.zeros(count), amount, exposure, trusted=True)

    @property
    def rate(self) -> float:
        """s̄ or r̄, 0 before anything was seen."""
        return self.amount / self.exposure if self.exposure > 0 else 0.0

    def scored(self, batch: Batch, gain: Callable[[F8], F8] | None = None) -> OnlineMixture:
        """In use or not after the evidence of a batch that it has not learned yet.

        It comes into use where the evidence is for it, and out of use where that, or that of the batch alone, is against it.
        ``gain`` gives the gains of samples (d, k); None for those over the uniform density.
        """
        inside = self.density.contains(batch.samples)
        samples, weight = batch.samples[:, inside], batch.weight[inside]
        gains = self.density.log(samples) + math.log(self.density.volume) if gain is None else gain(samples)
        fading = max(MIN_FADING, FADING_SHARE * self.memory * batch.rate * self.rate)
        newest = Evidence.of(gains, weight)
        evidence = self.evidence.joined(newest, fading)
        trusted = evidence.sign >= 0 and newest.sign >= 0 and (self.trusted or evidence.sign > 0)
        return replace(self, evidence=evidence, newest=newest, trusted=trusted)

    def updated(self, batch: Batch) -> OnlineMixture:
        """After learning from a batch, with forgetting."""
        now, fade = self.clock + batch.seconds, math.exp(-batch.seconds / self.memory)
        amount, exposure = fade * self.amount + float(batch.weight.sum()), fade * self.exposure + batch.exposure
        known = replace(self, amount=amount, exposure=exposure, clock=now)
        inside = self.density.contains(batch.samples) & (batch.weight > 0)
        samples, weight = _thinned(batch.samples[:, inside], batch.weight[inside], KEPT_PER_BATCH)
        if not len(weight):
            return known
        kept = self.time > now - MAX_AGE * self.memory
        samples, weight = np.hstack([self.samples[:, kept], samples]), np.concatenate([self.weight[kept], weight])
        time = np.append(self.time[kept], np.full(len(weight) - int(kept.sum()), now))
        density = _relearned(self.density, samples, _faded(weight, now - time, self.memory))
        return replace(known, density=density, samples=samples, weight=weight, time=time)

    def learned(self, sizes: F8) -> LearnedDensity | None:
        """The density with the shrinkage prior over the ``sizes`` (2, n) detected; None before a component was learned."""
        if not len(self.density):
            return None
        n = _effective(self.weight)
        return with_prior(LearnedDensity(self.rate, predictive(self.density, n), math.ceil(n)), sizes)


def _thinned(samples: F8, weight: F8, count: int) -> tuple[F8, F8]:
    """At most ``count`` samples of equal weight in place of (d, k) with weights (k,), by systematic resampling."""
    total = float(weight.sum())
    if len(weight) <= count or not total > 0:
        return samples, weight
    points = (np.arange(count) + 0.5) * (total / count)
    chosen = np.minimum(np.searchsorted(np.cumsum(weight), points), len(weight) - 1)
    return samples[:, chosen], np.full(count, total / count)


def _faded(weight: F8, age: F8, memory: float) -> F8:
    """(n,) weights of samples of this age, seconds, scaled so that they add up to the effective number of samples."""
    out = weight * np.exp(-age / memory)
    return out * (_effective(out) / out.sum()) if out.any() else out


def _effective(weight: F8) -> float:
    """The effective number of samples, (Σw)²/Σw²."""
    squares = float(np.square(weight).sum())
    return float(weight.sum()) ** 2 / squares if squares > 0 else 0.0


def _relearned(density: SceneDensity, samples: F8, weight: F8) -> SceneDensity:
    """The density of samples (d, n) with weights (n,), the newest last, learned from what it was before."""
    begun = _with_rest(_with_new(density, samples, weight), samples, weight)
    if not len(begun):
        return begun
    # A sample from nowhere would otherwise pull the nearest component over to itself.
    explained = 1 - begun.responsibilities(samples)[0]
    density = learn(begun, samples, weight * explained, passes=PASSES, floor=FLOOR, moves=0)
    return replace(density, uniform=best_uniform(density.log_ratio(samples), weight, density.uniform, UNIFORM_STEPS))


def _with_new(density: SceneDensity, samples: F8, weight: F8) -> SceneDensity:
    """With components where samples lie more densely than the density says.

    How densely they lie around one is estimated from the other newest samples with a Gaussian kernel. Where that is more
    than twice the density they are unexplained. The densest place comes first; its samples are explained then.
    """
    x, left = samples[:, -NEWEST:], weight[-NEWEST:]
    spread, mass, means = _spread(density, samples), list[float](), list[F8]()
    scaled = (x - x.mean(axis=1)[:, None]) / spread[:, None]
    length2 = np.square(scaled).sum(axis=0)
    near = np.exp(np.minimum(0.0, scaled.T @ scaled - 0.5 * (length2[:, None] + length2)))
    others = near @ left - near.diagonal() * left
    peak = left.sum() * math.sqrt(2 * math.pi) ** density.dim * float(spread.prod())
    left = left * (others > 2 * peak * density(x))
    for _ in range(MAX_NEW):
        around = near @ left
        best = int(np.argmax(around))
        if around[best] <= parameters(density.dim) / 2:
            break
        mass.append(float(around[best]))
        means.append(x @ (near[best] * left) / around[best])
        left = left * (1 - near[best])
    return _joined(density, mass, means, np.diag(spread**2), float(weight.sum()))


def _with_rest(density: SceneDensity, samples: F8, weight: F8) -> SceneDensity:
    """With one component for what is left to the uniform part, if that is enough: it may be much smaller than the volume."""
    left = weight * density.responsibilities(samples)[0]
    mass = float(left.sum())
    if mass <= parameters(density.dim) / 2:
        return density
    mean = samples @ left / mass
    step = samples - mean[:, None]
    cov = (left * step) @ step.T / mass + np.diag((1e-3 * (density.high - density.low)) ** 2)
    return _joined(density, [mass], [mean], cov, float(weight.sum()))


def _joined(density: SceneDensity, mass: list[float], means: list[F8], covariance: F8, total: float) -> SceneDensity:
    """With more components at the means (d,), all of one covariance (d, d), that explain ``mass`` of ``total``."""
    if not mass:
        return density
    explained = (1 - density.uniform) * max(total - sum(mass), 1e-3 * total)
    weight = np.append(density.weight * explained, mass)
    uniform = limited_uniform(1 - float(weight.sum()) / total)
    mean = np.column_stack([density.mean, *means])
    cov = np.concatenate([density.covariance, *([covariance[None]] * len(mass))])
    return SceneDensity(density.low, density.high, uniform, weight / weight.sum(), mean, cov)


def _spread(density: SceneDensity, samples: F8) -> F8:
    """(d,) within which samples may be of one place: parts of their size; of velocities their deviation."""
    extent, size = density.high - density.low, samples[-2:].mean(axis=1)
    spread: F8 = np.maximum(samples.std(axis=1), 1e-3 * extent)
    spread[:2] = np.maximum((NEAR_BOX if density.dim == 4 else NEAR_ENTRANCE) * size, 1e-3 * extent[:2])
    spread[-2:] = np.maximum(NEAR_BOX * size, 1e-3 * extent[-2:])
    return spread
