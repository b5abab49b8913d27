"""The density of a scene's births or false alarms: a uniform part and truncated Gaussians [M09
(14), (15), (21)].

Equations: docs/methods.md, A learned scene. The volume is a box, low ≤ x ≤ high; outside of it p is
0. Z_m, the mass of the m-th Gaussian inside, is computed by separation of variables [A. Genz,
*Numerical computation of multivariate normal probabilities*, J. Comp. Graph. Stat. 1 (1992)] on a
fixed lattice; for independent components it is exact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from phdtrack.errors import InputError
from phdtrack.kernels.box import OBSERVED
from phdtrack.kernels.mixtures import Gaussians, densities_inside, log_densities, whitened
from phdtrack.types import F8, Bool

# A Gaussian with less mass inside the volume counts as outside.
MIN_TRUNCATED_MASS = 1e-6
# Richtmyer's lattice: multiples of the square roots of primes, folded.
_LATTICE = np.sqrt(np.array([2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0]))
_POINTS = 512


@dataclass(frozen=True, eq=False)
class SceneDensity:
    """p(x) on a volume. Raises `InputError` if shapes do not fit, or bounds, shares or covariances
    are invalid.

    Attributes
    ----------
    low, high : (d,) bounds of the volume.
    uniform : α_u, share of the uniform part.
    weight : (M,) π_m, of sum 1.
    mean : (d, M).
    covariance : (M, d, d).
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
                problem,
                where="SceneDensity",
                cure="Give bounds, shares, means and covariances of one dimension",
            )

    def __len__(self) -> int:
        return len(self.weight)

    @property
    def dim(self) -> int:
        """Number d of components of x."""
        return len(self.low)

    @cached_property
    def has_places(self) -> bool:
        """True if the density is informative about positions: more than a hundredth is not
        uniform, and some position is three times as likely as the average. A Gaussian fitted to
        uniform positions is 1.9 times as likely in its middle."""
        place = marginal(self, (0, 1))
        return self.uniform < 0.99 and bool(
            (place(place.mean) * place.volume).max(initial=0.0) >= 3
        )

    @cached_property
    def volume(self) -> float:
        """V, in the product of the components' units."""
        return float(np.prod(self.high - self.low))

    @cached_property
    def truncated_mass(self) -> F8:
        """(M,) Z_m, the mass of each Gaussian inside the volume."""
        return mass_inside(self.mean, self.covariance, self.low, self.high)

    @cached_property
    def flat(self) -> float:
        """α_u/V, the uniform part."""
        return self.uniform / self.volume

    @cached_property
    def gaussians(self) -> Gaussians:
        """The untruncated Gaussians with weights α_g π_m / Z_m; 0 for those outside."""
        mass = np.maximum(self.truncated_mass, MIN_TRUNCATED_MASS)
        weight = (1 - self.uniform) * self.weight / mass
        inside = self.truncated_mass > MIN_TRUNCATED_MASS
        return Gaussians(
            weight * inside, np.ascontiguousarray(self.mean), np.ascontiguousarray(self.covariance)
        )

    @cached_property
    def _whitened(self) -> tuple[F8, F8, F8]:
        """The Gaussians, prepared for evaluation, as a plain tuple: Numba would look up the class
        of a named one at every call.
        """
        return tuple(whitened(self.gaussians))

    @cached_property
    def _side_by_side(self) -> tuple[F8, F8, F8]:
        """The Gaussians, prepared as `densities_inside` takes them."""
        mean, inverse, log_peak = self._whitened
        return mean, np.ascontiguousarray(np.moveaxis(inverse, 0, 2)), log_peak

    def log_parts(self, x: F8) -> F8:
        """(1 + M, L) logarithms of the uniform part and of each Gaussian at ``x`` (d, L), also
        outside the volume.
        """
        gaussians: F8 = log_densities(np.ascontiguousarray(x), self._whitened)
        return np.vstack([np.full((1, x.shape[1]), math.log(self.flat)), gaussians])

    def log_ratio(self, x: F8) -> F8:
        """(L,) logarithm of the ratio of the Gaussians' density, normalised, to the uniform
        density 1/V at ``x`` (d, L).
        """
        gaussians: F8 = np.logaddexp.reduce(self.log_parts(x)[1:], axis=0)
        return gaussians - math.log((1 - self.uniform) / self.volume)

    def contains(self, x: F8) -> Bool:
        """(L,) True for columns of ``x`` (d, L) in the volume."""
        return np.asarray(
            np.logical_and.reduce((x >= self.low[:, None]) & (x <= self.high[:, None]), axis=0)
        )

    def log(self, x: F8) -> F8:
        """(L,) log p at the columns of ``x`` (d, L); −inf outside the volume."""
        return np.where(self.contains(x), np.logaddexp.reduce(self.log_parts(x), axis=0), -math.inf)

    def __call__(self, x: F8, outside: float = 0.0) -> F8:
        """(L,) p at the columns of ``x`` (d, L), and ``outside`` for those outside the volume.

        Raises `InputError` if x has another dimension.
        """
        if len(x) != self.dim:
            raise InputError(f"expected {self.dim} components, got {len(x)}", where="SceneDensity")
        return self._summed(x, self.flat, outside)

    def gaussian_part(self, x: F8) -> F8:
        """(L,) p at the columns of ``x`` (d, L) without the uniform part; 0 outside the volume."""
        return self._summed(x, 0.0, 0.0)

    def _summed(self, x: F8, flat: float, outside: float) -> F8:
        """(L,) ``flat`` plus the Gaussians in the volume, and ``outside`` elsewhere."""
        volume = (self.low, self.high, flat, outside)
        density: F8 = densities_inside(np.ascontiguousarray(x), self._side_by_side, volume)
        return density


def marginal(p: SceneDensity, rows: tuple[int, ...]) -> SceneDensity:
    """The marginal density of the components ``rows``; truncation in the others is ignored.

    Parameters
    ----------
    p : the density of all components.
    rows : numbers of the components that are kept, from 0.

    Returns
    -------
    The density of these components.
    """
    keep = list(rows)
    return SceneDensity(
        p.low[keep],
        p.high[keep],
        p.uniform,
        p.weight,
        p.mean[keep],
        p.covariance[:, keep][:, :, keep],
    )


def shown_volume(p: SceneDensity) -> float:
    """V of the positions and sizes of boxes, pixel⁴, for a density of boxes (d = 4) or of their
    states (d = 6).

    Parameters
    ----------
    p : a density of boxes or of their states.

    Returns
    -------
    The volume, pixel⁴.
    """
    if p.dim == len(OBSERVED):
        return p.volume
    return marginal(p, OBSERVED).volume


def mass_inside(mean: F8, covariance: F8, low: F8, high: F8) -> F8:
    """(M,) masses of Gaussians, d ≤ 8, in the box from ``low`` to ``high``, accurate to about 1e-3
    for box states.

    Parameters
    ----------
    mean : (d, M).
    covariance : (M, d, d).
    low, high : (d,) bounds of the box.
    """
    from scipy.special import ndtr, ndtri

    d, count = mean.shape
    if count == 0:
        return np.zeros(0)
    root = np.linalg.cholesky(covariance)
    lattice = np.abs(2 * np.modf(np.outer(_LATTICE[: d - 1], np.arange(1, _POINTS + 1)))[0] - 1)
    y = np.zeros((d, count, _POINTS))
    product = np.ones((count, _POINTS))
    for r in range(d):
        shift = np.einsum("ms,smp->mp", root[:, r, :r], y[:r]) + mean[r][:, None]
        scale = root[:, r, r][:, None]
        below = ndtr((low[r] - shift) / scale)
        above = ndtr((high[r] - shift) / scale)
        product *= above - below
        if r < d - 1:
            # Without mass the point does not matter, but ndtri must not get 0 or 1.
            y[r] = ndtri(np.clip(below + lattice[r] * (above - below), 1e-300, 1 - 1e-16))
    return np.asarray(product.mean(axis=1))


def place_map(p: SceneDensity, shape: tuple[int, int], step: float) -> F8:
    """A map of p's Gaussians by position, for all sizes and velocities, with largest value 1 [M09
    Figs. 7, 8].

    A quarter of the mean size is added as standard deviation, because boxes cover more than their
    centre.

    Parameters
    ----------
    p : the density; its last two components are width and height.
    shape : rows and columns of the map, whose corner is at p's lower bounds.
    step : side of a cell, pixels.
    """
    cov = p.covariance.copy()
    for axis in range(2):
        cov[:, axis, axis] += (0.25 * p.mean[p.dim - 2 + axis]) ** 2
    place = marginal(replace(p, covariance=cov), (0, 1))
    down, across = np.meshgrid(
        (np.arange(shape[0]) + 0.5) * step, (np.arange(shape[1]) + 0.5) * step, indexing="ij"
    )
    positions = np.stack([across.ravel(), down.ravel()]) + place.low[:, None]
    density = np.exp(place.log_parts(positions)[1:]).sum(axis=0)
    return np.asarray((density / max(density.max(initial=0.0), 1e-300)).reshape(shape))


def _problem(p: SceneDensity) -> str:
    """A sentence on the first problem of the density, "" if there is none."""
    d = len(p.low)
    m = len(p.weight)
    parts = (p.low, p.high, p.weight, p.mean, p.covariance)
    if [part.shape for part in parts] != [(d,), (d,), (m,), (d, m), (m, d, d)]:
        shapes = ", ".join(str(part.shape) for part in parts)
        return f"bounds, weights, means and covariances do not fit each other: shapes {shapes}"
    if not all(np.isfinite(part).all() for part in parts):
        return "every number must be finite"
    if not (p.high > p.low).all():
        return f"every upper bound must exceed the lower one, got {p.low} and {p.high}"
    if not 0 < p.uniform <= 1:
        return f"the share of the uniform part must be above 0 and at most 1, got {p.uniform:g}"
    if m == 0:
        if p.uniform == 1:
            return ""
        return "without Gaussians the uniform part must have the share 1"
    if (p.weight < 0).any() or abs(p.weight.sum() - 1) > 1e-9:
        return f"the Gaussians' weights must be 0 or more with sum 1, got {p.weight.sum():.12g}"
    if (np.linalg.eigvalsh(p.covariance) <= 0).any():
        return "every covariance must be positive definite"
    return ""
