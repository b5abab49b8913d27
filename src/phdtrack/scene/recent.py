"""Samples of the last minutes, older ones worth less, and a density that follows them.

A density that is moved by single samples, as the recursive rule does it, follows many false alarms a second well and one
birth in ten seconds badly: its rate must stay below ½/(Mτ). So the samples themselves are kept, at most a few a batch, with
weights that fade as exp(−age/memory), and the density is learned again from them, beginning from what it was. Where samples
that it does not explain lie together, more than a component must explain to stay (τ), a new component begins.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from phdtrack.scene.batch_em import parameters
from phdtrack.scene.density import ContextDensity
from phdtrack.scene.learner import LEAST_UNIFORM, RecursiveEM
from phdtrack.types import F8, Bool

# Memories after which a sample is dropped: it is worth 14 % then.
OLDEST = 2.0
# Passes over the samples each time: the density begins where it was.
_LEARNER = RecursiveEM(passes=3, floor=0.005, moves=0)
# New components a time, and samples that are looked at for them.
_NEW, _LOOKED_AT = 4, 200
# Steps of EM for the share of the uniform part.
_STEPS = 20
# How far samples lie apart that are of one place, in parts of their size: boxes of the same thing, people at a door.
_NEAR, _DOOR = 0.15, 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Recent:
    """``samples`` (d, n), what each was worth when it came (``weight`` (n,)), and when that was (``time`` (n,), seconds)."""

    samples: F8
    weight: F8
    time: F8

    @classmethod
    def empty(cls, dim: int) -> Recent:
        """No samples of dimension ``dim``."""
        return cls(np.zeros((dim, 0)), np.zeros(0), np.zeros(0))

    def __len__(self) -> int:
        return len(self.weight)

    @property
    def many(self) -> float:
        """The number of equal samples that say as much, where none is old."""
        squares = float(np.square(self.weight).sum())
        return float(self.weight.sum()) ** 2 / squares if squares > 0 else 0.0

    def take(self, which: Bool) -> Recent:
        """The samples of a mask (n,)."""
        return Recent(self.samples[:, which], self.weight[which], self.time[which])

    def joined(self, other: Recent) -> Recent:
        """The samples of both."""
        return Recent(
            np.hstack([self.samples, other.samples]),
            np.concatenate([self.weight, other.weight]),
            np.concatenate([self.time, other.time]),
        )

    def worth(self, now: float, memory: float) -> F8:
        """(n,) what each is worth at ``now``, scaled so that they add up to the number of equal ones that say as much."""
        weight = self.weight * np.exp((self.time - now) / memory)
        total, squares = float(weight.sum()), float(np.square(weight).sum())
        return weight * (total / squares) if squares > 0 else weight


def thinned(samples: F8, weight: F8, most: int) -> tuple[F8, F8]:
    """At most ``most`` samples, each worth as much, in place of (d, k) with weights (k,): every so much weight one."""
    total = float(weight.sum())
    if len(weight) <= most or not total > 0:
        return samples, weight
    teeth = (np.arange(most) + 0.5) * (total / most)
    chosen = np.minimum(np.searchsorted(np.cumsum(weight), teeth), len(weight) - 1)
    return samples[:, chosen], np.full(most, total / most)


def relearned(density: ContextDensity, window: Recent, now: float, memory: float) -> ContextDensity:
    """The density of the samples in the window, from what it was before."""
    worth = window.worth(now, memory)
    begun = _with_new(density, window, worth)
    if not len(begun):
        return begun
    # A sample from nowhere would otherwise pull the nearest component over to itself.
    explained = 1 - begun.shares(window.samples)[0]
    return _mixed(_LEARNER.learn(begun, window.samples, worth * explained), window.samples, worth)


def _mixed(density: ContextDensity, samples: F8, worth: F8) -> ContextDensity:
    """The same Gaussians with the share of the uniform part that fits the samples best."""
    parts = density.parts(samples)
    ratio = np.exp(np.minimum(700.0, np.logaddexp.reduce(parts[1:], axis=0) - parts[0]))
    ratio *= density.uniform / (1 - density.uniform)
    share = density.uniform
    for _ in range(_STEPS):
        share = float(np.average(share / (share + (1 - share) * ratio), weights=worth))
    return replace(density, uniform=min(1 - LEAST_UNIFORM, max(LEAST_UNIFORM, share)))


def _with_new(density: ContextDensity, window: Recent, worth: F8) -> ContextDensity:
    """With components where samples lie together more than the density says.

    How densely they lie about one is estimated from the others among the newest, with a Gaussian kernel. Where that is more
    than twice the density they are unexplained. The place of most of them comes first, and they are explained then.
    """
    newest = slice(max(0, len(window) - _LOOKED_AT), None)
    x, left = window.samples[:, newest], worth[newest]
    spread, found = _spread(density, window.samples), []
    scaled = (x - x.mean(axis=1)[:, None]) / spread[:, None]
    length2 = np.square(scaled).sum(axis=0)
    near = np.exp(np.minimum(0.0, scaled.T @ scaled - 0.5 * (length2[:, None] + length2)))
    others = near @ left - near.diagonal() * left
    peak = left.sum() * math.sqrt(2 * math.pi) ** density.dim * float(spread.prod())
    left = left * (others > 2 * peak * density(x))
    for _ in range(_NEW):
        mass = near @ left
        best = int(np.argmax(mass)) if len(mass) else 0
        if not len(mass) or mass[best] <= parameters(density.dim) / 2:
            break
        found.append((float(mass[best]), x @ (near[best] * left) / mass[best]))
        left = left * (1 - near[best])
    if found:
        means = np.stack([mean for _, mean in found], axis=1)
        density = _joined(density, np.array([mass for mass, _ in found]), means, np.diag(spread**2), float(worth.sum()))
    return _with_rest(density, window, worth)


def _with_rest(density: ContextDensity, window: Recent, worth: F8) -> ContextDensity:
    """With one component for all that is left to the uniform part, where that is enough: it may be much smaller than the
    volume, as boxes of people anywhere in the image are."""
    left = worth * density.shares(window.samples)[0]
    mass = float(left.sum())
    if mass <= parameters(density.dim) / 2:
        return density
    mean = (window.samples @ left / mass)[:, None]
    step = window.samples - mean
    cov = (left * step) @ step.T / mass + np.diag((1e-3 * (density.high - density.low)) ** 2)
    return _joined(density, np.array([mass]), mean, cov, float(worth.sum()))


def _joined(density: ContextDensity, mass: F8, mean: F8, covariance: F8, total: float) -> ContextDensity:
    """With more components, at ``mean`` (d, k), all with one covariance (d, d), that explain ``mass`` (k,) of ``total``."""
    explained = (1 - density.uniform) * max(total - float(mass.sum()), 1e-3 * total)
    weight = np.concatenate([density.weight * explained, mass])
    uniform = min(1 - LEAST_UNIFORM, max(LEAST_UNIFORM, 1 - float(weight.sum()) / total))
    cov = np.concatenate([density.covariance, np.tile(covariance, (len(mass), 1, 1))])
    return ContextDensity(density.low, density.high, uniform, weight / weight.sum(), np.hstack([density.mean, mean]), cov)


def _spread(density: ContextDensity, samples: F8) -> F8:
    """(d,) within which samples may be of one place: parts of their size, of velocities their deviation."""
    extent, size = density.high - density.low, samples[-2:].mean(axis=1)
    spread: F8 = np.maximum(samples.std(axis=1), 1e-3 * extent)
    spread[:2] = np.maximum((_NEAR if density.dim == 4 else _DOOR) * size, 1e-3 * extent[:2])
    spread[-2:] = np.maximum(_NEAR * size, 1e-3 * extent[-2:])
    return spread
