"""Birth models: γ(x), the intensity of new targets, and ways to sample it.

`MeasurementBirth`, `PlaneBirth` and `PointBirth` draw around detections that no predicted target
explains [M07 §2], of boxes in the image, on the ground and of points; `UniformBirth` draws anywhere
[D14 Alg. 2]; `FixedBirth` from fixed Gaussians [E13 §4]. Rates are expected births per second.
"""

from __future__ import annotations

import abc
import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from phdtrack.arrays import chi2_quantile, draw, reused
from phdtrack.errors import Checked, InputError, NonNegative, PositiveCount, check
from phdtrack.kernels.gaussian import Births, NewTargets
from phdtrack.kernels.newborn import place_newborn, proposals, standard_points
from phdtrack.models.volumes import (
    EVERYWHERE,
    Region,
    area,
    image_area,
    image_volume,
    inside,
    local_area,
    local_density,
)
from phdtrack.protocols import Sensor
from phdtrack.types import F8, GaussianMixture, Particles

# The part of a Gaussian proposal that newborn particles are drawn from. Outside, the importance
# ratio of a flat γ to the proposal grows like exp(r²/2) and its variance is infinite: that mass is
# dropped.
KEPT = 0.99
# Points that are drawn beyond those that one detection needs, so that detections use different
# ones.
SPARE = 128
# Largest number of particles born in a frame: with very many detections each has fewer.
MOST_BORN = 300_000
# Largest number of expected births: after a long gap arrays would become as long.
MOST_EXPECTED = 3000.0


def particles_about(
    covered: F8,
    measured: tuple[F8, F8],
    rows: tuple[int, ...],
    particles: int,
    gamma: F8,
    rng: np.random.Generator,
) -> Particles:
    """J_j = ⌈Jmax·max(0, 1 − M_j)⌉ particles around z_j with importance weights γ(x) / Σ_i J_i
    p_i(x) [M07 §2].

    They are in blocks, one for each measurement that has any. The observed components are drawn
    from the observation noise inside its 99 % region (the mass of γ outside all these regions is
    dropped), the velocity about its mean with uniform direction and Gaussian amplitude. γ uses the
    same law of velocities, which therefore cancels in the weight.

    Parameters
    ----------
    covered : array (N,), M_j, the mass predicted at each measurement.
    measured : the states (d, N) and covariances (N, d, d) that the measurements imply, from
        `Sensor.states`.
    rows : `Sensor.observed`.
    particles : Jmax.
    gamma : (N,) density of births, the same in the whole region of a measurement; 0 at boxes
        without extent.
    rng : random numbers.
    """
    mean, cov = measured
    observed = list(rows)
    particles = min(particles, MOST_BORN // max(len(covered), 1) + 1)
    counts = np.ceil(particles * np.clip(1.0 - covered, 0.0, 1.0)).astype(np.int64)
    if not counts.any():
        return Particles(np.zeros((len(mean), 0)), np.zeros(0))
    limit = chi2_quantile(len(observed), KEPT)
    about = proposals(mean, cov, np.array(observed), counts, limit, KEPT)
    first = np.zeros(len(counts) + 1, np.int64)
    begin = (SPARE * rng.random(len(counts))).astype(np.int64)
    np.cumsum(counts, out=first[1:])
    many = int(counts.max()) + SPARE
    # Boxes have the precision of their filter, because there are many.
    dtype: np.dtype[Any] = np.dtype(np.float32 if len(observed) == 4 else np.float64)
    normal = rng.standard_normal((len(observed) + 1, many), dtype=dtype.type)
    points = standard_points(normal, rng.random(many + 1), _radii(len(observed)))
    state = reused((len(mean), int(first[-1])), dtype)
    density = reused((int(first[-1]),), dtype)
    place_newborn(about, points, begin, first, limit, state, density)
    weight = np.divide(np.repeat(gamma.astype(dtype), np.diff(first)), density, out=density)
    # The region of a small box reaches sizes below 0, where nothing is born.
    if not (weight.min() > 0 and state[4:].min(initial=1) > 0):
        possible = (weight > 0) & (state[4:] > 0).all(axis=0)
        first = np.concatenate([[0], np.cumsum(possible)])[first]
        state = state[:, possible]
        weight = weight[possible]
    start = np.unique(first)
    if len(weight):
        # A detection is of one target at most.
        mass = np.add.reduceat(weight, start[:-1])
        if mass.max() > 1:
            weight = weight / np.repeat(np.maximum(mass, 1), np.diff(start)).astype(dtype)
    return Particles(state, weight, start)


def births_around(
    measured: tuple[F8, F8],
    density: F8,
    fixed: GaussianMixture | None = None,
    seconds: float = 1.0,
) -> Births:
    """γT around detections, and fixed Gaussians.

    Parameters
    ----------
    measured : the states (d, N) and covariances (N, d, d) that the detections alone imply, from
        `Sensor.states`.
    density : array (N,), γT at the detections, per unit of measurement volume.
    fixed : Gaussians whose weights are births per second; None for none.
    seconds : T, the interval of the fixed Gaussians.
    """
    mean, covariance = measured
    d = len(mean)
    around = NewTargets(density, np.ascontiguousarray(mean.T), covariance)
    if fixed is None:
        return Births(around, *_no_gaussians(d))
    fixed_mean = np.ascontiguousarray(fixed.mean.T)
    fixed_covariance = np.ascontiguousarray(fixed.covariance)
    return Births(around, fixed.weight * seconds, fixed_mean, fixed_covariance)


@lru_cache(maxsize=8)
def _no_gaussians(d: int) -> tuple[F8, F8, F8]:
    """Weights, means and covariances of no Gaussians of dimension ``d``."""
    return np.zeros(0), np.zeros((0, d)), np.zeros((0, d, d))


@lru_cache(maxsize=8)
def _radii(dof: int) -> F8:
    """The radii at equal steps of the quantile of a standard Gaussian in ``dof`` dimensions inside
    its kept part.
    """
    from scipy.special import gammaincinv

    return np.sqrt(2 * gammaincinv(dof / 2, KEPT * np.linspace(0, 1, 2049)))


class _AroundDetections(abc.ABC):
    """Births drawn around the detections [M07 §2]; a kind of birth has these fields and gives γ."""

    __slots__ = ()
    births_per_second: float
    particles: int

    def __post_init__(self) -> None:
        check(self)
        if self.births_per_second and self.births_per_detection:
            # Uniform births replace those around each detection.
            object.__setattr__(self, "births_per_detection", 0.0)

    @property
    def births_per_detection(self) -> float:
        """Births per second in the neighbourhood of a detection."""
        return 0.0

    @abc.abstractmethod
    def density(self, z: F8) -> F8:
        """(N,) γ per second at the detections ``z`` (m, N), and in the regions of their noise."""

    def sample(
        self, z: F8, covered: F8, sensor: Sensor, seconds: float, rng: np.random.Generator
    ) -> Particles:
        """Particles around the detections with the mass of γT there [M07 §2], see
        `particles_about`.
        """
        return particles_about(
            covered,
            sensor.states(z),
            sensor.observed,
            self.particles,
            self.density(z) * seconds,
            rng,
        )

    def gaussians(self, z: F8, sensor: Sensor, seconds: float) -> Births:
        """γT around the detections."""
        return births_around(sensor.states(z), self.density(z) * seconds)

    def expected_count(self, z: F8, seconds: float) -> float:
        """The mass of γT."""
        rate: float = self.births_per_second + self.births_per_detection * z.shape[1]
        return min(rate * seconds, MOST_EXPECTED)


@dataclass(frozen=True, slots=True)
class MeasurementBirth(_AroundDetections):
    """γ of boxes, uniform over the image or scale-invariant, drawn around the detections [M07 §2].

    Parameters
    ----------
    births_per_second : expected births per second, uniform over the image.
    births_per_detection : expected births per second in the neighbourhood of a box (see
        `models.volumes`), if ``births_per_second`` is 0.
    particles : Jmax, particles drawn around a detection without predicted mass.
    frame_size : the image's width and height in pixels, needed for births uniform over it.
    volume : of positions and sizes over which births are uniform, pixel⁴; 0: all of the frame's.
    """

    births_per_second: NonNegative = 0.0
    births_per_detection: NonNegative = 0.0125
    particles: PositiveCount = 1000
    frame_size: tuple[float, float] = (0.0, 0.0)
    volume: NonNegative = 0.0

    def density(self, z: F8) -> F8:
        """(N,) γ per second and pixel⁴ at the detections; 0 where a size is not positive.

        Parameters
        ----------
        z : (m, N) measurements.
        """
        if self.births_per_detection:
            return local_density(z, self.births_per_detection)
        flat = self.births_per_second / (self.volume or image_volume(self.frame_size))
        return np.where((z[2:4] > 0).all(axis=0), flat, 0.0)


@dataclass(frozen=True, slots=True)
class PointBirth(_AroundDetections):
    """γ uniform over the image, drawn around the detections.

    Parameters
    ----------
    births_per_second : expected births per second.
    particles : Jmax, particles drawn around a detection without predicted mass.
    frame_size : the image's width and height in pixels.
    """

    births_per_second: NonNegative = 0.25
    particles: PositiveCount = 500
    frame_size: tuple[float, float] = (0.0, 0.0)

    def density(self, z: F8) -> F8:
        """(N,) γ per second and pixel² at the detections.

        The image has no border here: a centroid measured with noise may lie a little outside, and
        so may its target.

        Parameters
        ----------
        z : (m, N) measurements.
        """
        return np.full(z.shape[1], self.births_per_second / image_area(self.frame_size))


@dataclass(frozen=True, slots=True)
class PlaneBirth(_AroundDetections):
    """γ on the ground, uniform over a region or scale-invariant, drawn around the detections.

    Parameters
    ----------
    births_per_second : expected births per second, uniform over the region.
    births_per_detection : expected births per second in the ellipse of a detection's noise (see
        `models.volumes`), if ``births_per_second`` is 0.
    particles : Jmax, particles drawn around a detection without predicted mass.
    borders : left, low, right and high border of the region in metres, needed for births uniform
        over it.
    """

    births_per_second: NonNegative = 0.0
    births_per_detection: NonNegative = 0.05
    particles: PositiveCount = 500
    borders: Region = EVERYWHERE

    def density(self, z: F8) -> F8:
        """(N,) γ per second and m² at the detections.

        Parameters
        ----------
        z : (m, N) measurements.
        """
        if self.births_per_detection:
            return self.births_per_detection / local_area(z)
        flat = self.births_per_second / area(self.borders, "PlaneBirth.borders")
        return np.where(inside(z[:2], self.borders), flat, 0.0)


@dataclass(frozen=True, slots=True)
class UniformBirth(Checked):
    """γ of points uniform over the image, drawn anywhere [D14 Alg. 2].

    Parameters
    ----------
    frame_size : width and height of the image, pixels.
    births_per_second : expected births per second.
    particles : particles drawn per frame, D14's J = 10.
    """

    frame_size: tuple[float, float]
    births_per_second: NonNegative = 2.5
    particles: PositiveCount = 10

    def sample(
        self, z: F8, covered: F8, sensor: Sensor, seconds: float, rng: np.random.Generator
    ) -> Particles:
        """Particles of equal mass anywhere, independent of measurements; velocities have uniform
        direction and Gaussian amplitude.
        """
        state, cov = sensor.states(
            np.array(self.frame_size)[:, None] * rng.random((2, self.particles))
        )
        amplitude = rng.standard_normal(self.particles)
        angle = rng.uniform(0, 2 * math.pi, self.particles)
        state[2:4] = (
            np.sqrt(2 * cov[:, 2, 2]) * amplitude * np.stack([np.cos(angle), np.sin(angle)])
        )
        return Particles(
            state, np.full(self.particles, self.births_per_second * seconds / self.particles)
        )

    def gaussians(self, z: F8, sensor: Sensor, seconds: float) -> Births:
        """Always raises `InputError`: there is no such mixture."""
        raise InputError(
            "births that are uniform over the image have no form as a Gaussian mixture",
            where="UniformBirth",
            cure="Use births around the detections (birth.kind=point), or particles",
        )

    def expected_count(self, z: F8, seconds: float) -> float:
        """births_per_second·seconds."""
        return self.births_per_second * seconds


@dataclass(frozen=True, slots=True)
class FixedBirth(Checked):
    """γ, a fixed mixture of Gaussians [E13 §4].

    Parameters
    ----------
    places : Gaussians whose weights are births per second.
    particles : newborn particles of each.
    """

    places: GaussianMixture
    particles: PositiveCount = 300

    def sample(
        self, z: F8, covered: F8, sensor: Sensor, seconds: float, rng: np.random.Generator
    ) -> Particles:
        """Particles from each Gaussian, of total mass weight·seconds, independent of
        measurements.
        """
        return draw(self.places, self.particles, seconds, rng)

    def gaussians(self, z: F8, sensor: Sensor, seconds: float) -> Births:
        """The Gaussians, of total mass weight·seconds, independent of measurements [V06 (22)]."""
        return births_around(sensor.states(z), np.zeros(z.shape[1]), self.places, seconds)

    def expected_count(self, z: F8, seconds: float) -> float:
        """The mixture's mass, over seconds."""
        return self.places.mass * seconds
