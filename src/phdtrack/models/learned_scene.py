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
from phdtrack.context.density import LEAST_INSIDE
from phdtrack.models.births import gaussians_about, particles_about
from phdtrack.protocols import Sensor
from phdtrack.types import F8, I8, GaussianMixture, Particles


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

    @property
    def _hidden(self) -> list[int]:
        return [r for r in range(self.density.dim) if r not in self.observed]

    def sample(self, z: F8, covered: F8, sensor: Sensor, dt: float, rng: np.random.Generator) -> Particles:
        """Particles around the detections with the evidence and the velocities of γT there [M07 §2, M09 (12)]."""
        at = self.around(sensor.states(z), dt)
        rows = self.observed
        return particles_about(covered, (at.mean, at.covariance), rows, self.most, lambda x, of: at.flat(x, of), rng)

    def around(self, seen: tuple[F8, F8], dt: float) -> Around:
        """What γT is around detections whose states and covariances, as `Sensor.states` gives them, are ``seen``."""
        state, cov = seen[0].copy(), seen[1].copy()
        rows, hidden, p = list(self.observed), self._hidden, self.density
        n, many = state.shape[1], len(p)
        log = np.full((1 + many, n), np.log(p.uniform / self.shown.volume))
        mean, spread = np.zeros((1 + many, n, len(hidden))), np.empty((1 + many, n, len(hidden), len(hidden)))
        mean[0], spread[0] = state[hidden].T, cov[:, hidden][:, :, hidden]
        for m in range(many):
            log[1 + m], mean[1 + m], spread[1 + m] = self._given(m, state[rows], cov[:, rows][:, :, rows])
        total = np.logaddexp.reduce(log, axis=0)
        share = np.exp(log - total)
        velocity = np.einsum("mn,mnv->nv", share, mean)
        step = mean - velocity
        state[hidden] = velocity.T
        within = np.einsum("mn,mnvw->nvw", share, spread) + np.einsum("mn,mnv,mnw->nvw", share, step, step)
        cov[np.ix_(range(n), hidden, hidden)] = within
        inside = self.shown.contains(state[rows])
        return Around(state, cov, np.where(inside, self.rate * dt * np.exp(total), 0.0))

    def _given(self, m: int, shown: F8, noise: F8) -> tuple[F8, F8, F8]:
        """Of Gaussian m: log of its part of ∫ g p (n,), mean (n, v) and covariance (n, v, v) of velocities given z."""
        rows, hidden, p = list(self.observed), self._hidden, self.density
        sigma = p.covariance[m]
        cross = sigma[np.ix_(hidden, rows)]
        total = sigma[np.ix_(rows, rows)] + noise
        step = (shown - p.mean[rows, m, None]).T
        gain = cross @ np.linalg.inv(total)
        distance2 = np.einsum("nr,nr->n", step, np.linalg.solve(total, step[:, :, None])[:, :, 0])
        share = (1 - p.uniform) * p.weight[m] / max(float(p.inside[m]), LEAST_INSIDE)
        _, log_det = np.linalg.slogdet(2 * np.pi * total)
        log = np.log(share) - 0.5 * (log_det + distance2) if share > 0 else np.full(len(step), -np.inf)
        velocity = p.mean[hidden, m] + np.einsum("nvr,nr->nv", gain, step)
        return log, velocity, sigma[np.ix_(hidden, hidden)] - gain @ cross.T

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
