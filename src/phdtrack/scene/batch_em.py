"""Maximum likelihood of a `ContextDensity`, its uniform part included, from samples that are all there: EM in batches.

Samples may be worth more or less than one, and may not show everything (NaN): a component then explains what is shown, and
its mean and second moment given that stand for the rest. What of the Gaussians lies beyond the volume is not cut off.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from phdtrack.scene.density import ContextDensity
from phdtrack.types import F8, I8

# EM has settled where a step gains fewer nats; steps at most.
SETTLED, MOST = 1e-3, 200


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """The samples ``which`` (k,), of which the ``rows`` are shown: ``x`` (r, k)."""

    which: I8
    rows: I8
    x: F8


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """``x`` (d, n), NaN where they do not show something, and the same in ``groups``; ``worth`` (n,); what is added to
    variances, ``floor`` (d,); ``least`` share of the uniform part."""

    x: F8
    worth: F8
    floor: F8
    least: float
    groups: tuple[Group, ...]

    @classmethod
    def of(cls, x: F8, worth: F8, floor: F8, least: float) -> Samples:
        """Grouped by what they show."""
        shown, group = np.unique(~np.isnan(x), axis=1, return_inverse=True)
        groups = []
        for g in range(shown.shape[1]):
            which, rows = np.flatnonzero(group.ravel() == g), np.flatnonzero(shown[:, g])
            groups.append(Group(which, rows, np.ascontiguousarray(x[rows[:, None], which])))
        return cls(x, worth, floor, least, tuple(groups))

    @property
    def total(self) -> float:
        """n, what they are worth together."""
        return float(self.worth.sum())


def parameters(dim: int) -> int:
    """N, the parameters of a component: mean and covariance; 27 in six dimensions, 14 in four."""
    return dim + dim * (dim + 1) // 2


def log_parts(p: ContextDensity, samples: Samples) -> F8:
    """(1 + M, n) log α_u/V and log α_g π_m N_m(x) of what the samples show."""
    out = np.empty((1 + len(p), len(samples.worth)))
    extent, share = np.log(p.high - p.low), np.log((1 - p.uniform) * p.weight)
    for group in samples.groups:
        rows = group.rows
        root = np.linalg.cholesky(p.covariance[:, rows[:, None], rows])
        y = np.linalg.inv(root) @ (group.x - p.mean[rows].T[:, :, None])
        peak = share - np.log(np.einsum("mrr->mr", root)).sum(axis=1) - 0.5 * len(rows) * math.log(2 * math.pi)
        out[0, group.which] = math.log(p.uniform) - extent[rows].sum()
        out[1:, group.which] = peak[:, None] - 0.5 * np.einsum("mrn,mrn->mn", y, y)
    return out


def likelihood(p: ContextDensity, samples: Samples) -> float:
    """log p(x_1 … x_n), nats."""
    return float(samples.worth @ np.logaddexp.reduce(log_parts(p, samples), axis=0))


def fitted(p: ContextDensity, samples: Samples, steps: int = MOST) -> ContextDensity:
    """``p`` after at most so many steps of EM; components that explain less than τ = N/2 samples go, all but the last."""
    before = -math.inf
    for _ in range(steps):
        parts = log_parts(p, samples)
        total = np.logaddexp.reduce(parts, axis=0)
        now = float(samples.worth @ total)
        if now - before < SETTLED:
            break
        before = now
        belongs = np.exp(parts - total) * samples.worth
        mass = belongs[1:].sum(axis=1)
        keep = mass > min(parameters(p.dim) / 2, 0.999 * float(mass.max()))
        if keep.all():
            uniform = min(1 - samples.least, max(samples.least, float(belongs[0].sum()) / samples.total))
            mean, cov = moments(p, belongs[1:], samples)
            p = replace(p, uniform=uniform, weight=mass / mass.sum(), mean=mean, covariance=cov)
        else:
            p, before = taken(p, np.flatnonzero(keep)), -math.inf
    return p


def taken(p: ContextDensity, which: I8) -> ContextDensity:
    """``p`` with the components ``which`` alone."""
    weight = p.weight[which]
    return replace(p, weight=weight / weight.sum(), mean=p.mean[:, which], covariance=p.covariance[which])


def moments(p: ContextDensity, belongs: F8, samples: Samples) -> tuple[F8, F8]:
    """Means (d, M) and covariances (M, d, d) of the samples by what of each ``belongs`` (M, n) to the components."""
    mass = belongs.sum(axis=1)
    whole, loose = np.empty((len(p), *samples.x.shape)), np.zeros(p.covariance.shape)
    for group in samples.groups:
        rows, rest, which = group.rows, np.setdiff1d(np.arange(p.dim), group.rows), group.which
        share = belongs[:, which].sum(axis=1) / mass
        whole[:, rows[:, None], which] = group.x
        loose[:, rows, rows] += share[:, None] * samples.floor[rows]
        if len(rest):
            across = p.covariance[:, rest[:, None], rows]
            gain = across @ np.linalg.inv(p.covariance[:, rows[:, None], rows])
            expected = p.mean[rest].T[:, :, None] + gain @ (group.x - p.mean[rows].T[:, :, None])
            whole[:, rest[:, None], which] = expected
            left = p.covariance[:, rest[:, None], rest] - gain @ across.transpose(0, 2, 1)
            loose[:, rest[:, None], rest] += share[:, None, None] * left
    mean = np.einsum("mn,mrn->mr", belongs, whole) / mass[:, None]
    step = whole - mean[:, :, None]
    cov = (belongs[:, None] * step) @ step.transpose(0, 2, 1) / mass[:, None, None] + loose
    return np.ascontiguousarray(mean.T), 0.5 * (cov + cov.transpose(0, 2, 1))
