"""γ and κ as a scene has taught them: γ(x) = s̄ p(x|b), κ(z) = r̄ p(z|c) [M09 (12)–(15)].

Newborn are drawn around the detections that nothing predicted accounts for, as of `births.MeasurementBirth`. Around each, γ
is taken as flat, with the value that makes the evidence of what is born there exact:

    ∫ g(z|x) γ(x) dx = s̄ [α_u/V + α_g Σ_m π_m N(z; μ_m, Σ_m + R) / Z_m]

for a sensor that shows some components of the state with noise R. Velocities have the mean and covariance of the same
mixture given z, with uniform direction and Gaussian amplitude; of the uniform part those of the sensor. So α_u = 1 is
`MeasurementBirth` over the same volume. The Gaussian-mixture filters take the Gaussians themselves.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from phdtrack.checks import NonNegative, PositiveCount, check
from phdtrack.context import ContextDensity, marginal
from phdtrack.kernels.context_density import COARSE, given_detections, mixture_density, newborn_about
from phdtrack.models.births import gaussians_about, particles_about
from phdtrack.protocols import Sensor
from phdtrack.types import F4, F8, I8, GaussianMixture, Particles


@dataclass(frozen=True, slots=True, eq=False)
class Around:
    """γT around each of N detections.

    Attributes
    ----------
    mean : (d, N) state about which newborn are drawn.     covariance : (N, d, d) with which they are.
    density : (N,) γT there, per unit of what measurements show.
    """

    mean: F8
    covariance: F8
    density: F8

    def flat(self, x: F8, of: I8) -> F8:
        """(L,) γT at ``x`` (r, L), drawn about the detections ``of`` (L,); 0 where a size is not positive."""
        return np.where((x[2:] > 0).all(axis=0), self.density[of], 0.0)


@dataclass(frozen=True, eq=False)
class ContextBirth:
    """γ(x) = s̄ p(x|b) on states [M09 (12), (14)].

    Parameters
    ----------
    rate : s̄, expected births per time unit.
    density : p(x|b) on states (d).
    observed : the rows of the state that measurements show; the others are velocities.
    most : Jmax, particles drawn around a detection of which nothing is predicted.
    """

    rate: NonNegative
    density: ContextDensity
    observed: tuple[int, ...] = (0, 1, 4, 5)
    most: PositiveCount = 1000

    def __post_init__(self) -> None:
        check(self)

    @cached_property
    def shown(self) -> ContextDensity:
        """p of what measurements show, velocities integrated out."""
        return marginal(self.density, self.observed)

    def sample(self, z: F8, covered: F8, sensor: Sensor, dt: float, rng: np.random.Generator) -> Particles:
        """Particles around the detections with the evidence and the velocities of γT there [M07 §2, M09 (12)]."""
        at = self.around(sensor.states(z), dt)
        rows = self.observed
        return particles_about(covered, (at.mean, at.covariance), rows, self.most, lambda x, of: at.flat(x, of), rng)

    def around(self, seen: tuple[F8, F8], dt: float) -> Around:
        """What γT is around detections whose states and covariances, as `Sensor.states` gives them, are ``seen``."""
        density, state, cov = given_detections(*seen, *self._table)
        return Around(state, cov, self.rate * dt * density)

    def about(self, state: F8, deviation: F8, dt: float) -> tuple[F4, F4]:
        """`around` in single precision for noise without correlations: densities (N,), and velocities (5, N).

        ``state`` (d, N) are those at rest, ``deviation`` (d, N) the noise's; velocities as `newborn_about` gives them.
        """
        out: tuple[F4, F4] = newborn_about(state, deviation, self.rate * dt, *self._table)
        return out

    @cached_property
    def _table(self) -> tuple[I8, int, F8, F8, float, F8, F8, F8, F8]:
        """The density as `given_detections` takes it."""
        p, shown = self.density, self.shown
        order = np.array([*self.observed, *(r for r in range(p.dim) if r not in self.observed)])
        lower, r = np.tril_indices(p.dim), shown.dim
        cov = p.covariance[:, order][:, :, order]
        peak2 = np.square(p.share) / (2 * np.pi) ** r
        with np.errstate(divide="ignore"):
            log_peak = 0.5 * (np.log(peak2) - np.linalg.slogdet(cov[:, :r, :r])[1])
        # Below 0 nothing is near enough.
        reach = 2 * np.maximum(log_peak - np.log(shown.flat) + COARSE, -1.0)
        triangles = np.ascontiguousarray(cov[:, *lower].T)
        return order, r, shown.low, shown.high, shown.flat, p.mean[order], triangles, peak2, reach

    @property
    def flat(self) -> float:
        """The uniform part of γ, per time unit and unit of what measurements show."""
        return self.rate * self.shown.flat

    @cached_property
    def given(self) -> GaussianMixture:
        """The Gaussians of γ, whose parts inside the volume have its masses, per time unit."""
        return GaussianMixture(self.rate * self.density.share, self.density.mean, self.density.covariance)

    def components(self, z: F8, covered: F8, sensor: Sensor, dt: float) -> GaussianMixture:
        """The learned Gaussians as they are, and the uniform part as Gaussians about the detections (`gaussians_about`).

        What of a Gaussian lies beyond the volume is not cut off here; the parts inside have the masses of γT.
        """
        given = self.given
        spread = gaussians_about(z, covered, sensor, lambda x: np.where(self.shown.contains(x), self.flat * dt, 0.0))
        return GaussianMixture(
            np.concatenate([given.weight * dt, spread.weight]),
            np.hstack([given.mean, spread.mean]),
            np.concatenate([given.covariance, spread.covariance]),
        )

    def expected(self, z: F8, dt: float) -> float:
        """s̄T."""
        return self.rate * dt


@dataclass(frozen=True, eq=False)
class ContextClutter:
    """κ(z) = r̄ p(z|c) on measurements [M09 (13), (15)].

    Parameters
    ----------
    rate : r̄, expected false alarms per frame.
    density : p(z|c) on what measurements show (r). Where it does not reach, κ is that of its uniform part: a detection
        beyond the volume is no more certain to be a target than one in an empty place.
    """

    rate: NonNegative
    density: ContextDensity

    def __post_init__(self) -> None:
        check(self)

    def intensity(self, z: F8) -> F8:
        """(N,) κ per frame and unit of measurement space."""
        out: F8 = mixture_density(np.ascontiguousarray(z), float(self.rate), *self._table)
        return out

    @cached_property
    def _table(self) -> tuple[F8, F8, F8, F8, F8, F8]:
        """The density as `mixture_density` takes it, nowhere below its uniform part."""
        return self.density.low, self.density.high, np.full(2, self.density.flat), *self.density.table
