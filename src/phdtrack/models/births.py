"""γ(x): new targets, and the ways to draw them; β(x|ξ): targets that come out of targets.

`MeasurementBirth`, `PlaneBirth` and `PointBirth` draw around the detections that nothing predicted accounts for [M07 §2], in
the image, on the ground and of points; `UniformBirth` anywhere [D14 Alg. 2]; `FixedBirth` from given Gaussians [E13 §4].
Rates are expected births per second. The papers leave spawning out (β = 0, `NoSpawn`); the term stays in the model.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np

from phdtrack.arrays import chi2_quantile, draw
from phdtrack.errors import InputError, NonNegative, PositiveCount, Probability, Share, check
from phdtrack.kernels.gaussian import Births, NewTargets
from phdtrack.kernels.neighbourhoods import summed_densities
from phdtrack.kernels.newborn import density_within, place_newborn, proposal_density, proposals, standard_points
from phdtrack.models.volumes import (
    EVERYWHERE,
    REACH,
    SIZES,
    PlaneVolume,
    Region,
    Volume,
    area,
    check_region,
    image_area,
    image_volume,
    inside,
    local_density,
    local_volume,
)
from phdtrack.protocols import Sensor
from phdtrack.types import F8, I8, GaussianMixture, ParticleBlocks, Particles

# The part of a Gaussian proposal that newborn particles are drawn from. Outside, the importance ratio of a flat γ to the
# proposal grows like exp(r²/2) and its variance is infinite: that mass is dropped.
KEPT = 0.99
# So many more points are drawn than one detection needs, so that detections have different ones.
SPARE = 128
# A density of births at what measurements show (r, L); those about measurement j are first[j] … first[j + 1] − 1.
Gamma = Callable[[F8, I8], F8]


@dataclass(frozen=True, slots=True)
class MeasurementBirth:
    """γ uniform over the image or around the detections, drawn around the detections [M07 §2].

    Parameters
    ----------
    births_per_second : expected births per second: in all where spread over the ``image``, around each detection where
        ``local``.
    particles : Jmax, particles drawn around a detection of which nothing is predicted.
    volume : ``image`` or ``local``: what γ is spread over (see `models.volumes`).
    frame_size : the image's width and height in pixels, needed for ``image``.
    """

    births_per_second: NonNegative = 0.25
    particles: PositiveCount = 1000
    volume: Volume = "image"
    frame_size: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        check(self)

    def sample(self, z: F8, covered: F8, sensor: Sensor, seconds: float, rng: np.random.Generator) -> Particles:
        """Particles around the detections that weigh what γ is there [M07 §2], see `particles_about`."""

        return particles_about(
            covered,
            sensor.states(z),
            sensor.observed,
            self.particles,
            lambda x, first: self._intensity(x, first, z[:4]) * seconds,
            rng,
        )

    def gaussians(self, z: F8, sensor: Sensor, seconds: float) -> Births:
        """γT around the detections."""
        return births_around(sensor.states(z), self.density(z) * seconds)

    def density(self, z: F8) -> F8:
        """(N,) γ per second at the detections themselves."""
        if self.volume == "image":
            everywhere: F8 = self.births_per_second / image_volume(self.frame_size) * ((z[2] > 0) & (z[3] > 0))
            return everywhere
        each = self.births_per_second / local_volume(z)
        local: F8 = summed_densities(np.ascontiguousarray(z[:4]), z[0].argsort(), each, REACH, *SIZES)
        return local

    def expected(self, z: F8, seconds: float) -> float:
        """births_per_second·seconds, of each detection where ``local``."""
        return self.births_per_second * seconds * (z.shape[1] if self.volume == "local" else 1)

    def _intensity(self, shown: F8, first: I8, z: F8) -> F8:
        """γ per second at positions and sizes (4, L), which lie in the runs ``first``; 0 where a size is not positive."""
        if self.volume == "image":
            return self.density(shown)
        lower = np.concatenate([z[:2] - REACH * z[2:4], SIZES[0] * z[2:4]])
        upper = np.concatenate([z[:2] + REACH * z[2:4], SIZES[1] * z[2:4]])
        out: F8 = density_within(np.ascontiguousarray(shown), first, lower, upper, self.births_per_second / local_volume(z))
        return out


@dataclass(frozen=True, slots=True)
class UniformBirth:
    """γ uniform over positions in the frame and, of targets with a size, a range of it; drawn anywhere [D14 Alg. 2].

    Parameters
    ----------
    frame_size : width and height of the image, pixels.
    births_per_second : expected births per second.
    particles : particles drawn per frame, D14's J = 10.
    min_size, max_size : range of sizes as fractions of the frame's width and height.
    """

    frame_size: tuple[float, float]
    births_per_second: NonNegative = 2.5
    particles: PositiveCount = 10
    min_size: Share = 0.02
    max_size: Probability = 0.5

    def __post_init__(self) -> None:
        check(self)
        if self.min_size > self.max_size:
            raise InputError(
                f"expected min_size ≤ max_size, got {self.min_size:g} and {self.max_size:g}", where="UniformBirth.min_size"
            )

    def sample(self, z: F8, covered: F8, sensor: Sensor, seconds: float, rng: np.random.Generator) -> Particles:
        """``count`` particles of mass births_per_second·seconds / count each, whatever was measured."""
        size = np.array(self.frame_size)[:, None]
        drawn = size * rng.random((2, self.particles))
        if len(sensor.observed) > 2:
            drawn = np.vstack([drawn, size * rng.uniform(self.min_size, self.max_size, (2, self.particles))])
        mean, cov = sensor.states(np.vstack([drawn, np.ones((max(0, len(z) - len(drawn)), self.particles))]))
        state = mean.copy()
        _draw_velocity(state, cov, np.arange(self.particles), rng)
        return Particles(state, np.full(self.particles, self.births_per_second * seconds / self.particles))

    def gaussians(self, z: F8, sensor: Sensor, seconds: float) -> Births:
        """There are none: raises `InputError`."""
        raise InputError(
            "births that are uniform over the image have no form as a Gaussian mixture",
            where="UniformBirth",
            cure="Use births around the detections (birth.kind=measurement), at given places (fixed), or particles",
        )

    def expected(self, z: F8, seconds: float) -> float:
        """births_per_second·seconds."""
        return self.births_per_second * seconds


@dataclass(frozen=True, slots=True)
class FixedBirth:
    """γ a given mixture of Gaussians whose weights are births per second, ``count`` particles each [E13 §4]."""

    mixture: GaussianMixture
    particles: PositiveCount = 300

    def __post_init__(self) -> None:
        check(self)

    def sample(self, z: F8, covered: F8, sensor: Sensor, seconds: float, rng: np.random.Generator) -> Particles:
        """``count`` particles from each Gaussian, of total mass weight·seconds, whatever was measured."""
        return draw(self.mixture, self.particles, seconds, rng)

    def gaussians(self, z: F8, sensor: Sensor, seconds: float) -> Births:
        """The given Gaussians, of total mass weight·seconds, whatever was measured [V06 (22)]."""
        around = births_around(sensor.states(z), np.zeros(z.shape[1]))
        return with_given(around, self.mixture, seconds)

    def expected(self, z: F8, seconds: float) -> float:
        """The mixture's mass, over seconds."""
        return self.mixture.mass * seconds


def particles_about(
    covered: F8,
    seen: tuple[F8, F8],
    rows: tuple[int, ...],
    particles: int,
    gamma: Callable[[F8, I8], F8],
    rng: np.random.Generator,
) -> Particles:
    """J_j = ⌈Jmax·max(0, 1 − M_j)⌉ particles around z_j with importance weights γ(x) / Σ_i J_i p_i(x) [M07 §2].

    What a measurement shows is drawn from the observation noise inside its 99 % region (the mass of γ outside all these
    regions is dropped), the velocity about its mean with uniform direction and Gaussian amplitude. γ uses the same law of
    velocities, which therefore cancels in the weight: ``gamma`` gives its density at what measurements show (r, L), of which
    those about measurement j are first[j] … first[j + 1] − 1.

    ``seen`` are the states and covariances that the measurements show, as `Sensor.states` gives them, ``rows`` are
    `Sensor.observed`, ``particles`` is Jmax.
    """
    mean, cov = seen
    observed = list(rows)
    counts = np.ceil(particles * np.clip(1.0 - covered, 0.0, 1.0)).astype(np.int64)
    if not counts.any():
        return Particles(np.zeros((len(mean), 0)), np.zeros(0))
    limit = chi2_quantile(len(observed), KEPT)
    about = proposals(mean, cov, np.array(observed), counts, limit, KEPT)
    first, begin = np.zeros(len(counts) + 1, np.int64), (SPARE * rng.random(len(counts))).astype(np.int64)
    np.cumsum(counts, out=first[1:])
    many = int(counts.max()) + SPARE
    points = standard_points(rng.standard_normal((len(observed) + 1, many)), rng.random(many + 1), _radii(len(observed)))
    # Boxes in the precision of their filter: there are many.
    state = np.empty((len(mean), first[-1]), np.float32 if len(observed) == 4 else np.float64)
    place_newborn(about, points.astype(state.dtype), begin, first, state)
    shown = state[observed]
    density = gamma(shown, first)
    weight = density / proposal_density(about, shown, first, points[-1], begin, limit)
    # Of a small box the noise's region reaches sizes below 0, where nothing is born.
    possible = density > 0
    if not possible.all():
        first = np.concatenate([[0], np.cumsum(possible)])[first]
        state, weight = state[:, possible], weight[possible]
    return Particles(state, weight, np.unique(first))


def births_around(seen: tuple[F8, F8], density: F8) -> Births:
    """γT around detections and nowhere else.

    Parameters
    ----------
    seen : states (d, N) and covariances (N, d, d) that the detections alone show, as `Sensor.states` gives them.
    density : (N,) γT at the detections, per unit of measurement volume.
    """
    mean, covariance = seen
    d = len(mean)
    return Births(
        NewTargets(density, np.ascontiguousarray(mean.T), covariance), np.zeros(0), np.zeros((0, d)), np.zeros((0, d, d))
    )


def with_given(births: Births, mixture: GaussianMixture, seconds: float) -> Births:
    """The births with the Gaussians of a mixture, whose weights are births per second, over the interval ``seconds``."""
    return Births(
        births.around,
        mixture.weight * seconds,
        np.ascontiguousarray(mixture.mean.T),
        np.ascontiguousarray(mixture.covariance),
    )


@lru_cache(maxsize=8)
def _radii(dof: int) -> F8:
    """The radii at equal steps of the quantile of a standard Gaussian in ``dof`` dimensions inside its kept part."""
    from scipy.special import gammaincinv

    radii: F8 = np.sqrt(2 * gammaincinv(dof / 2, KEPT * np.linspace(0, 1, 2049)))
    return radii


def _draw_velocity(state: F8, cov: F8, parent: I8, rng: np.random.Generator) -> None:
    """Add to rows 2 and 3 velocities of uniform direction and Gaussian amplitude, with the covariance that is there."""
    n = state.shape[1]
    root = math.sqrt(2) * np.linalg.cholesky(cov[:, 2:4, 2:4])[parent]
    amplitude, angle = rng.standard_normal(n), rng.uniform(0, 2 * math.pi, n)
    x, y = amplitude * np.cos(angle), amplitude * np.sin(angle)
    state[2] += root[:, 0, 0] * x
    state[3] += root[:, 1, 0] * x + root[:, 1, 1] * y


@dataclass(frozen=True, slots=True)
class PointBirth:
    """γ uniform over the image, drawn around the detections.

    Parameters
    ----------
    births_per_second : expected births per second.
    particles : Jmax, particles drawn around a detection of which nothing is predicted.
    frame_size : the image's width and height in pixels.
    """

    births_per_second: NonNegative = 0.25
    particles: PositiveCount = 500
    frame_size: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        check(self)

    def sample(self, z: F8, covered: F8, sensor: Sensor, seconds: float, rng: np.random.Generator) -> Particles:
        """Particles around the detections that weigh what γ is there [M07 §2], see `births.particles_about`."""
        return particles_about(
            covered, sensor.states(z), sensor.observed, self.particles, lambda x, first: self._intensity(x) * seconds, rng
        )

    def gaussians(self, z: F8, sensor: Sensor, seconds: float) -> Births:
        """γT around the detections."""
        return births_around(sensor.states(z), self._intensity(z[:2]) * seconds)

    def expected(self, z: F8, seconds: float) -> float:
        """births_per_second·seconds."""
        return self.births_per_second * seconds

    def _intensity(self, place: F8) -> F8:
        """γ per second and pixel² at positions (2, L).

        The image has no border here: a centroid measured with noise may lie a little outside, and so may its target.
        """
        return np.full(place.shape[1], self.births_per_second / image_area(self.frame_size))


@dataclass(frozen=True, slots=True)
class PlaneBirth:
    """γ uniform over a region of the ground or around the detections, drawn around the detections.

    Parameters
    ----------
    births_per_second : expected births per second: in all where spread over the ``region``, around each detection where
        ``local``.
    particles : Jmax, particles drawn around a detection of which nothing is predicted.
    volume : ``region`` or ``local``: what γ is spread over (see `models.volumes`).
    borders : left, low, right and high border in metres, needed for ``region``.
    """

    births_per_second: NonNegative = 0.25
    particles: PositiveCount = 500
    volume: PlaneVolume = "local"
    borders: Region = EVERYWHERE

    def __post_init__(self) -> None:
        check(self)
        check_region(self.borders, "PlaneBirth.borders")

    def sample(self, z: F8, covered: F8, sensor: Sensor, seconds: float, rng: np.random.Generator) -> Particles:
        """Particles around the detections that weigh what γ is there [M07 §2], see `births.particles_about`."""
        return particles_about(
            covered, sensor.states(z), sensor.observed, self.particles, lambda x, first: self._intensity(x, z) * seconds, rng
        )

    def gaussians(self, z: F8, sensor: Sensor, seconds: float) -> Births:
        """γT around the detections."""
        return births_around(sensor.states(z), self._intensity(z[:2], z) * seconds)

    def expected(self, z: F8, seconds: float) -> float:
        """births_per_second·seconds, of each detection where ``local``."""
        return self.births_per_second * seconds * (z.shape[1] if self.volume == "local" else 1)

    def _intensity(self, place: F8, z: F8) -> F8:
        """γ per second and m² at positions (2, L)."""
        if self.volume == "region":
            return np.where(
                inside(place, self.borders), self.births_per_second / area(self.borders, "PlaneBirth.borders"), 0.0
            )
        return local_density(place, z, self.births_per_second)


class Spawn(Protocol):
    """The spawning part of a motion."""

    def sample(self, parents: Particles | ParticleBlocks, dt: float, rng: np.random.Generator) -> Particles:
        """Draws of ∫ β(x|ξ) D(ξ) dξ."""


@dataclass(frozen=True, slots=True)
class NoSpawn:
    """β = 0, as in all four papers."""

    def sample(self, parents: Particles | ParticleBlocks, dt: float, rng: np.random.Generator) -> Particles:
        """Nothing."""
        return Particles(np.zeros((len(parents.state), 0)), np.zeros(0))


@dataclass(frozen=True, slots=True)
class SplitSpawn:
    """Each target throws off new ones next to it, with its state displaced by a Gaussian.

    Parameters
    ----------
    rate : expected new targets of each target per time unit.
    distance : standard deviation of the displacement, in widths and heights of the parent.
    fraction : share of the parents that are drawn, which bounds the cost.
    """

    rate: NonNegative = 0.001
    distance: NonNegative = 0.5
    fraction: Probability = 0.1

    def __post_init__(self) -> None:
        check(self)

    def sample(self, parents: Particles | ParticleBlocks, dt: float, rng: np.random.Generator) -> Particles:
        """Draws of β(x|ξ) = rate·dt · N(x; ξ, distance² · size²) over the intensity ``parents``."""
        mass = self.rate * dt * parents.mass
        count = int(np.ceil(self.fraction * len(parents)))
        if count == 0 or mass <= 0:
            return Particles(np.zeros((len(parents.state), 0)), np.zeros(0))
        chosen = rng.choice(len(parents), size=count, p=parents.weight / parents.mass)
        state = parents.state[:, chosen].astype(np.float64)
        size: F8 = state[4:6]
        state[:2] += self.distance * size * rng.standard_normal((2, count))
        return Particles(state, np.full(count, mass / count))
