"""γ and κ as a scene has taught them: γ(x) = s̄ p(x|b), κ(z) = r̄ p(z|c) [M09 (12)–(15)].

Newborn are drawn around the detections that nothing predicted accounts for, as of `births.MeasurementBirth`, and weigh what
γ is at their position and size. Their velocity is drawn from p(v | position, size), which leaves no velocity in the
weight: that of a Gaussian's newborn from its own conditional law, that of the uniform part's from the sensor's, of uniform
direction and Gaussian amplitude. So α_u = 1 is `MeasurementBirth` over the same volume.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from phdtrack.checks import NonNegative, PositiveCount, check
from phdtrack.context import ContextDensity, marginal
from phdtrack.context.density import LEAST_INSIDE
from phdtrack.models.births import gaussians_about, particles_about
from phdtrack.protocols import Sensor
from phdtrack.types import F8, I8, GaussianMixture, Particles


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

    @cached_property
    def _conditional(self) -> tuple[F8, F8]:
        """Per Gaussian: gain B (M, v, r) and covariance (M, v, v) of velocities given what is shown."""
        rows, rest = list(self.observed), self._hidden
        cov = self.density.covariance
        cross = cov[:, rest][:, :, rows]
        gain: F8 = cross @ np.linalg.inv(cov[:, rows][:, :, rows])
        return gain, cov[:, rest][:, :, rest] - gain @ cross.transpose(0, 2, 1)

    @property
    def _hidden(self) -> list[int]:
        return [r for r in range(self.density.dim) if r not in self.observed]

    def sample(self, z: F8, covered: F8, sensor: Sensor, dt: float, rng: np.random.Generator) -> Particles:
        """Particles around the detections that weigh what γT is there [M07 §2, M09 (12)]."""
        born = particles_about(z, covered, sensor, self.most, lambda x: self.rate * dt * self.shown(x), rng)
        if len(born) == 0 or len(self.density) == 0:
            return born
        state = born.state.copy()
        shown = state[list(self.observed)]
        cumulated = np.cumsum(self.shown.shares(shown), axis=0)
        part = (rng.random(len(born)) * cumulated[-1] >= cumulated).sum(axis=0) - 1
        of = np.flatnonzero(part >= 0)
        mean = self._velocity(part[of], shown[:, of])
        root = np.linalg.cholesky(self._conditional[1])
        noise = rng.standard_normal(mean.shape)
        state[np.array(self._hidden)[:, None], of] = mean + np.einsum("jvw,wj->vj", root[part[of]], noise)
        return Particles(state, born.weight)

    def components(self, z: F8, covered: F8, sensor: Sensor, dt: float) -> GaussianMixture:
        """The learned Gaussians as they are, and the uniform part as Gaussians about the detections (`gaussians_about`).

        What of a Gaussian lies beyond the volume is not cut off here; the parts inside have the masses of γT.
        """
        p = self.density
        flat = self.rate * dt * p.uniform / self.shown.volume
        spread = gaussians_about(z, covered, sensor, lambda x: np.where(self.shown.contains(x), flat, 0.0))
        given = self.rate * dt * (1 - p.uniform) * p.weight / np.maximum(p.inside, LEAST_INSIDE)
        return GaussianMixture(
            np.concatenate([given, spread.weight]),
            np.hstack([p.mean, spread.mean]),
            np.concatenate([p.covariance, spread.covariance]),
        )

    def expected(self, z: F8, dt: float) -> float:
        """s̄T."""
        return self.rate * dt

    def _velocity(self, part: I8, shown: F8) -> F8:
        """(v, n) mean velocity of Gaussian ``part`` (n,) given what is shown (r, n)."""
        gain, _ = self._conditional
        mean = self.density.mean[:, part]
        step = shown - mean[list(self.observed)]
        out: F8 = mean[self._hidden] + np.einsum("jvr,rj->vj", gain[part], step)
        return out


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
        p = self.density
        out: F8 = self.rate * np.maximum(p(z[: p.dim]), p.uniform / p.volume)
        return out
