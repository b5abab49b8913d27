"""The density of a scene's births or false alarms: a uniform part over a volume and Gaussians beside it [M09 (14), (15)].

    p(x) = α_u 1/V + α_g Σ_m π_m N(x; μ_m, Σ_m) / Z_m     inside the volume, 0 outside;     α_u + α_g = 1, Σ π_m = 1

Z_m is the part of the m-th Gaussian that lies inside: the volume cuts the Gaussians off, so that p integrates to 1 over it.
The volume is a box, low ≤ x ≤ high.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from phdtrack.errors import InputError
from phdtrack.kernels.context_density import mixture_density
from phdtrack.scene.inside import mass_inside
from phdtrack.types import F8, Bool

# A Gaussian of which less than this lies inside is as good as outside, and never divided by less.
LEAST_INSIDE = 1e-6
# Of births, on states of boxes, what detections show: all but the two velocities.
SHOWN = (0, 1, 4, 5)


@dataclass(frozen=True, eq=False)
class ContextDensity:
    """p(x) on a volume.

    Attributes
    ----------
    low, high : (d,) bounds of the volume.
    uniform : α_u, share of the uniform part.
    weight : (M,) π_m, of sum 1.     mean : (d, M).     covariance : (M, d, d).

    Raises
    ------
    InputError : shapes that do not fit, bounds without a volume, α_u outside (0, 1], weights or covariances that are none.
    """

    low: F8
    high: F8
    uniform: float
    weight: F8
    mean: F8
    covariance: F8

    def __post_init__(self) -> None:
        if problem := _problem(self):
            raise InputError(
                problem, where="ContextDensity", cure="Give bounds, shares, means and covariances of one dimension"
            )

    def __len__(self) -> int:
        return len(self.weight)

    @property
    def dim(self) -> int:
        """Number d of components of x."""
        return len(self.low)

    @property
    def volume(self) -> float:
        """V, in the product of the components' units."""
        return float(np.prod(self.high - self.low))

    @cached_property
    def inside(self) -> F8:
        """(M,) Z_m, the part of each Gaussian inside the volume."""
        return mass_inside(self.mean, self.covariance, self.low, self.high)

    @property
    def flat(self) -> float:
        """α_u/V, the uniform part."""
        return self.uniform / self.volume

    @cached_property
    def share(self) -> F8:
        """(M,) α_g π_m / Z_m, by which the Gaussians are weighed; 0 of one that is as good as outside."""
        return (1 - self.uniform) * self.weight * (self.inside > LEAST_INSIDE) / np.maximum(self.inside, LEAST_INSIDE)

    @cached_property
    def _whitening(self) -> tuple[F8, F8]:
        """L⁻¹ (M, d, d), and logarithms of the Gaussians' peaks (M,)."""
        root = np.linalg.cholesky(self.covariance)
        log_det = np.log(np.einsum("mrr->mr", root)).sum(axis=1)
        with np.errstate(divide="ignore"):
            log_peak = np.log(self.share) - log_det - 0.5 * self.dim * math.log(2 * math.pi)
        return np.linalg.inv(root), log_peak

    @cached_property
    def table(self) -> tuple[F8, F8, F8]:
        """The Gaussians as `mixture_density` takes them: means (d, M), L⁻¹ (d(d + 1)/2, M), logarithms of the peaks (M,)."""
        whiten, log_peak = self._whitening
        rows, columns = np.tril_indices(self.dim)
        return np.ascontiguousarray(self.mean), np.ascontiguousarray(whiten[:, rows, columns].T), log_peak

    def parts(self, x: F8) -> F8:
        """(1 + M, L) logarithms of the uniform part and of each Gaussian's at ``x`` (d, L), as if there were no border."""
        whiten, log_peak = self._whitening
        out = np.empty((1 + len(self), x.shape[1]))
        out[0] = math.log(self.flat)
        for m in range(len(self)):
            step = whiten[m] @ (x - self.mean[:, m, None])
            out[1 + m] = log_peak[m] - 0.5 * np.einsum("rl,rl->l", step, step)
        return out

    def shares(self, x: F8) -> F8:
        """(1 + M, L) the probability that a draw of p at ``x`` (d, L) came from the uniform part and from each Gaussian."""
        parts = self.parts(x)
        out: F8 = np.exp(parts - np.logaddexp.reduce(parts, axis=0))
        return out

    def contains(self, x: F8) -> Bool:
        """(L,) whether the columns of ``x`` (d, L) lie in the volume."""
        inside: Bool = np.logical_and.reduce((x >= self.low[:, None]) & (x <= self.high[:, None]), axis=0)
        return inside

    def log(self, x: F8) -> F8:
        """(L,) log p at the columns of ``x`` (d, L); −inf outside the volume."""
        out: F8 = np.where(self.contains(x), np.logaddexp.reduce(self.parts(x), axis=0), -math.inf)
        return out

    def __call__(self, x: F8) -> F8:
        """(L,) p at the columns of ``x`` (d, L). Raises `InputError` where x has another dimension."""
        if len(x) != self.dim:
            raise InputError(f"expected {self.dim} components, got {len(x)}", where="ContextDensity")
        out: F8 = mixture_density(np.ascontiguousarray(x), 1.0, self.low, self.high, np.array([self.flat, 0.0]), *self.table)
        return out

    def sample(self, count: int, rng: np.random.Generator) -> F8:
        """(d, count) draws of p; those of a Gaussian that fall outside are drawn again."""
        share = (1 - self.uniform) * self.weight * (self.inside > LEAST_INSIDE)
        chances = np.append(self.uniform, share)
        part = rng.choice(len(chances), size=count, p=chances / chances.sum()) - 1
        x = rng.uniform(self.low[:, None], self.high[:, None], (self.dim, count))
        root = np.linalg.cholesky(self.covariance)
        missing = np.flatnonzero(part >= 0)
        while len(missing):
            which = part[missing]
            drawn = self.mean[:, which] + np.einsum("jrs,sj->rj", root[which], rng.standard_normal((self.dim, len(missing))))
            fits = self.contains(drawn)
            x[:, missing[fits]] = drawn[:, fits]
            missing = missing[~fits]
        return x


def uniform_density(low: F8, high: F8) -> ContextDensity:
    """The uniform density alone."""
    d = len(low)
    return ContextDensity(low, high, 1.0, np.zeros(0), np.zeros((d, 0)), np.zeros((0, d, d)))


def marginal(p: ContextDensity, rows: tuple[int, ...]) -> ContextDensity:
    """The density of the components ``rows`` alone. Gaussians are taken not to leak through the other borders."""
    keep = list(rows)
    return ContextDensity(p.low[keep], p.high[keep], p.uniform, p.weight, p.mean[keep], p.covariance[:, keep][:, :, keep])


def _problem(p: ContextDensity) -> str:
    """What is wrong with it, or nothing."""
    d, m = len(p.low), len(p.weight)
    if p.high.shape != (d,) or p.mean.shape != (d, m) or p.covariance.shape != (m, d, d):
        shapes = (p.low.shape, p.high.shape, p.weight.shape, p.mean.shape, p.covariance.shape)
        return f"bounds, weights, means and covariances do not fit each other: shapes {', '.join(map(str, shapes))}"
    if not all(np.isfinite(part).all() for part in (p.low, p.high, p.weight, p.mean, p.covariance)):
        return "every number must be finite"
    if not (p.high > p.low).all():
        return f"every bound above must exceed the one below, got {p.low} and {p.high}"
    if not 0 < p.uniform <= 1:
        return f"the share of the uniform part must be above 0 and at most 1, got {p.uniform:g}"
    if m == 0:
        return "" if p.uniform == 1 else "without Gaussians the uniform part has the share 1"
    if (p.weight < 0).any() or abs(p.weight.sum() - 1) > 1e-9:
        return f"the Gaussians' weights must be from 0 and of sum 1, got {p.weight.sum():.12g}"
    if (np.linalg.eigvalsh(p.covariance) <= 0).any():
        return "every covariance must be positive definite"
    return ""
