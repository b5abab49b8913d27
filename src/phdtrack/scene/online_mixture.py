"""Births or false alarms that follow the scene: an online mixture with forgetting, and evidence whether to use it.

The recursive rule, moved by single samples, follows many false alarms per second well, and one birth in ten seconds badly:
its rate must stay below ½/(Mτ). So the samples of the last minutes are kept, a few of each batch, with weights that fade as
exp(−age/memory), and the density is learned again from them, beginning from what it was. Where samples that it does not
explain crowd, more than a component must explain to stay (τ), a new component begins.

A density is in use while it explains new samples, before it learns them, better than another density: the prequential
gain of a sample is log p(x) − log q(x), and its mean over recent samples must exceed two standard errors.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from phdtrack.scene.em import MIN_UNIFORM, RecursiveEM, parameters
from phdtrack.scene.files import LearnedDensity
from phdtrack.scene.mixture import SceneDensity, uniform_density
from phdtrack.scene.training import Sizes, predictive, with_prior
from phdtrack.types import F8, Bool

# Samples from which the evidence decides, and standard errors that its mean must be away from 0.
MIN_EVIDENCE, STANDARD_ERRORS = 10.0, 2.0
# The evidence fades over so many samples at least, or over this part of the memory's.
MIN_FADING, FADING_SHARE = 30.0, 1 / 20
# Samples that are kept of a batch; samples that stand for what was learned before; memories after which one is dropped.
KEPT_PER_BATCH, MAX_PRIOR_SAMPLES, MAX_AGE = 12, 400, 2.0
# Passes over the samples each time: the density begins where it was.
LEARNER = RecursiveEM(passes=3, floor=0.005, moves=0)
# New components at a time, and newest samples among which they are looked for; steps of EM for the uniform share.
MAX_NEW, NEWEST, UNIFORM_STEPS = 4, 200, 20
# How far samples of one place lie apart, in parts of their size: boxes of one thing, targets at an entrance.
NEAR_BOX, NEAR_ENTRANCE = 0.15, 1.0


@dataclass(frozen=True, slots=True)
class Evidence:
    """Gains of recent samples: their number (older ones count for less), mean and mean square."""

    count: float = 0.0
    mean: float = 0.0
    square: float = 0.0

    def with_gains(self, gain: F8, weight: F8, fading: float) -> Evidence:
        """With the gains (k,) of samples of weight (k,); older ones fade over ``fading`` samples."""
        new = float(weight.sum())
        old = self.count * math.exp(-new / fading)
        total = old + new
        if not new > 0:
            return self
        mean = (old * self.mean + float((weight * gain).sum())) / total
        square = (old * self.square + float((weight * np.square(gain)).sum())) / total
        return Evidence(total, mean, square)

    @property
    def error(self) -> float:
        """The standard error of the mean."""
        return math.sqrt(max(self.square - self.mean**2, 0.0) / max(self.count, 1.0))

    @property
    def positive(self) -> bool:
        """Whether the density explains new samples better than the other one."""
        return self.count >= MIN_EVIDENCE and self.mean > STANDARD_ERRORS * self.error

    @property
    def negative(self) -> bool:
        """Whether it explains them worse."""
        return self.count >= MIN_EVIDENCE and self.mean < -STANDARD_ERRORS * self.error


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """Samples (d, k) of the last seconds with ``weight`` (k,).

    ``exposure``: time in which they came, in time units for births, in frames for false alarms; ``rate`` of it per second.
    """

    samples: F8
    weight: F8
    exposure: float
    rate: float


@dataclass(frozen=True, slots=True, eq=False)
class RecentSamples:
    """``samples`` (d, n), the ``weight`` (n,) of each when it came, and that ``time`` (n,), seconds."""

    samples: F8
    weight: F8
    time: F8

    @classmethod
    def empty(cls, dim: int) -> RecentSamples:
        """No samples of dimension ``dim``."""
        return cls(np.zeros((dim, 0)), np.zeros(0), np.zeros(0))

    def __len__(self) -> int:
        return len(self.weight)

    @property
    def effective(self) -> float:
        """The effective number of samples, (Σw)²/Σw²."""
        squares = float(np.square(self.weight).sum())
        return float(self.weight.sum()) ** 2 / squares if squares > 0 else 0.0

    def take(self, which: Bool) -> RecentSamples:
        """The samples of a mask (n,)."""
        return RecentSamples(self.samples[:, which], self.weight[which], self.time[which])

    def joined(self, samples: F8, weight: F8, time: float) -> RecentSamples:
        """With more samples of one time."""
        times = np.concatenate([self.time, np.full(len(weight), time)])
        return RecentSamples(np.hstack([self.samples, samples]), np.concatenate([self.weight, weight]), times)

    def faded(self, now: float, memory: float) -> F8:
        """(n,) weights at ``now``, scaled so that they add up to the effective number of samples."""
        weight = self.weight * np.exp((self.time - now) / memory)
        total, squares = float(weight.sum()), float(np.square(weight).sum())
        return weight * (total / squares) if squares > 0 else weight


@dataclass(frozen=True, slots=True, eq=False)
class OnlineMixture:
    """Births, false alarms or objects as they are learned online.

    Attributes
    ----------
    density : what was learned, the uniform one at first.      recent : from which samples.
    amount, exposure : sum of weights and time in which they came, both fading: their ratio is the rate.
    evidence : for the density, of recent samples; ``newest`` : of the last batch.
    trusted : whether the density is in use.
    """

    density: SceneDensity
    recent: RecentSamples
    amount: float = 0.0
    exposure: float = 0.0
    evidence: Evidence = field(default_factory=Evidence)
    newest: Evidence = field(default_factory=Evidence)
    trusted: bool = False

    @classmethod
    def unknown(cls, low: F8, high: F8) -> OnlineMixture:
        """Nothing learned of a volume."""
        return cls(uniform_density(low, high), RecentSamples.empty(len(low)))

    @classmethod
    def of(cls, learned: LearnedDensity, memory: float, rate: float) -> OnlineMixture:
        """What was learned before, as if it had come within the ``memory`` (s) before now; ``rate`` as of `Batch`.

        Draws of its Gaussians stand for the samples; the uniform part is mostly the prior.
        """
        count = max(1, min(MAX_PRIOR_SAMPLES, learned.samples))
        seen = replace(learned.density, uniform=MIN_UNIFORM) if len(learned.density) else learned.density
        amount = learned.rate * memory * rate
        drawn = seen.sample(count, np.random.default_rng(0))
        recent = RecentSamples(drawn, np.full(count, amount / count), np.zeros(count))
        return cls(learned.density, recent, amount, memory * rate, trusted=True)

    @property
    def rate(self) -> float:
        """s̄ or r̄, 0 before anything was seen."""
        return self.amount / self.exposure if self.exposure > 0 else 0.0

    def scored(self, batch: Batch, memory: float, gain: Callable[[F8], F8] | None = None) -> OnlineMixture:
        """With the evidence of a batch that it has not learned yet.

        Parameters
        ----------
        batch : the new samples.
        memory : seconds.
        gain : gives the gains of samples (d, k); None for those over the uniform density.
        """
        inside = self.density.contains(batch.samples)
        samples, weight = batch.samples[:, inside], batch.weight[inside]
        gains = self.density.log(samples) + math.log(self.density.volume) if gain is None else gain(samples)
        fading = max(MIN_FADING, FADING_SHARE * memory * batch.rate * self.rate)
        newest = Evidence().with_gains(gains, weight, math.inf)
        return replace(self, evidence=self.evidence.with_gains(gains, weight, fading), newest=newest)

    def decided(self) -> OnlineMixture:
        """In use if the evidence is positive, out of use if it, or that of the last batch, is negative; else as it was."""
        against = self.evidence.negative or self.newest.negative
        return replace(self, trusted=not against and (self.trusted or self.evidence.positive))

    def updated(self, batch: Batch, now: float, memory: float) -> OnlineMixture:
        """After learning from a batch at ``now`` seconds, with forgetting."""
        fade = math.exp(-batch.exposure / (batch.rate * memory))
        amount, exposure = fade * self.amount + float(batch.weight.sum()), fade * self.exposure + batch.exposure
        inside = self.density.contains(batch.samples) & (batch.weight > 0)
        samples, weight = thinned(batch.samples[:, inside], batch.weight[inside], KEPT_PER_BATCH)
        if not len(weight):
            return replace(self, amount=amount, exposure=exposure)
        recent = self.recent.take(self.recent.time > now - MAX_AGE * memory).joined(samples, weight, now)
        density = relearned(self.density, recent, now, memory)
        return replace(self, density=density, recent=recent, amount=amount, exposure=exposure)

    def learned(self, sizes: Sizes) -> LearnedDensity | None:
        """The density with the shrinkage prior over the sizes that may appear; None before a component was learned."""
        if not len(self.density):
            return None
        n = self.recent.effective
        return with_prior(LearnedDensity(self.rate, predictive(self.density, n), math.ceil(n)), sizes)


def thinned(samples: F8, weight: F8, count: int) -> tuple[F8, F8]:
    """At most ``count`` samples of equal weight in place of (d, k) with weights (k,), by systematic resampling."""
    total = float(weight.sum())
    if len(weight) <= count or not total > 0:
        return samples, weight
    teeth = (np.arange(count) + 0.5) * (total / count)
    chosen = np.minimum(np.searchsorted(np.cumsum(weight), teeth), len(weight) - 1)
    return samples[:, chosen], np.full(count, total / count)


def relearned(density: SceneDensity, recent: RecentSamples, now: float, memory: float) -> SceneDensity:
    """The density of recent samples at ``now`` seconds, learned from what it was before."""
    weight = recent.faded(now, memory)
    begun = _with_rest(_with_new(density, recent, weight), recent, weight)
    if not len(begun):
        return begun
    # A sample from nowhere would otherwise pull the nearest component over to itself.
    explained = 1 - begun.responsibilities(recent.samples)[0]
    density = LEARNER.learn(begun, recent.samples, weight * explained)
    parts = density.log_parts(recent.samples)
    ratio = np.exp(np.minimum(700.0, np.logaddexp.reduce(parts[1:], axis=0) - parts[0]))
    ratio *= density.uniform / (1 - density.uniform)
    share = density.uniform
    for _ in range(UNIFORM_STEPS):
        share = float(np.average(share / (share + (1 - share) * ratio), weights=weight))
    return replace(density, uniform=min(1 - MIN_UNIFORM, max(MIN_UNIFORM, share)))


def _with_new(density: SceneDensity, recent: RecentSamples, weight: F8) -> SceneDensity:
    """With components where samples lie more densely than the density says.

    How densely they lie around one is estimated from the other newest samples with a Gaussian kernel. Where that is more
    than twice the density they are unexplained. The densest place comes first; its samples are explained then.
    """
    newest = slice(max(0, len(recent) - NEWEST), None)
    x, left = recent.samples[:, newest], weight[newest]
    spread, found = _spread(density, recent.samples), list[tuple[float, F8]]()
    scaled = (x - x.mean(axis=1)[:, None]) / spread[:, None]
    length2 = np.square(scaled).sum(axis=0)
    near = np.exp(np.minimum(0.0, scaled.T @ scaled - 0.5 * (length2[:, None] + length2)))
    others = near @ left - near.diagonal() * left
    peak = left.sum() * math.sqrt(2 * math.pi) ** density.dim * float(spread.prod())
    left = left * (others > 2 * peak * density(x))
    for _ in range(MAX_NEW):
        mass = near @ left
        best = int(np.argmax(mass)) if len(mass) else 0
        if not len(mass) or mass[best] <= parameters(density.dim) / 2:
            break
        found.append((float(mass[best]), x @ (near[best] * left) / mass[best]))
        left = left * (1 - near[best])
    if not found:
        return density
    masses, means = np.array([mass for mass, _ in found]), np.stack([mean for _, mean in found], axis=1)
    return _joined(density, masses, means, np.diag(spread**2), float(weight.sum()))


def _with_rest(density: SceneDensity, recent: RecentSamples, weight: F8) -> SceneDensity:
    """With one component for what is left to the uniform part, if that is enough: it may be much smaller than the volume."""
    left = weight * density.responsibilities(recent.samples)[0]
    mass = float(left.sum())
    if mass <= parameters(density.dim) / 2:
        return density
    mean = (recent.samples @ left / mass)[:, None]
    step = recent.samples - mean
    cov = (left * step) @ step.T / mass + np.diag((1e-3 * (density.high - density.low)) ** 2)
    return _joined(density, np.array([mass]), mean, cov, float(weight.sum()))


def _joined(density: SceneDensity, mass: F8, mean: F8, covariance: F8, total: float) -> SceneDensity:
    """With more components at ``mean`` (d, k), all of one covariance (d, d), that explain ``mass`` (k,) of ``total``."""
    explained = (1 - density.uniform) * max(total - float(mass.sum()), 1e-3 * total)
    weight = np.concatenate([density.weight * explained, mass])
    uniform = min(1 - MIN_UNIFORM, max(MIN_UNIFORM, 1 - float(weight.sum()) / total))
    cov = np.concatenate([density.covariance, np.tile(covariance, (len(mass), 1, 1))])
    return SceneDensity(density.low, density.high, uniform, weight / weight.sum(), np.hstack([density.mean, mean]), cov)


def _spread(density: SceneDensity, samples: F8) -> F8:
    """(d,) within which samples may be of one place: parts of their size; of velocities their deviation."""
    extent, size = density.high - density.low, samples[-2:].mean(axis=1)
    spread: F8 = np.maximum(samples.std(axis=1), 1e-3 * extent)
    spread[:2] = np.maximum((NEAR_BOX if density.dim == 4 else NEAR_ENTRANCE) * size, 1e-3 * extent[:2])
    spread[-2:] = np.maximum(NEAR_BOX * size, 1e-3 * extent[-2:])
    return spread
