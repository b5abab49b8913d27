"""γ(x): new targets, and the three ways to draw them.

``measurement``: around the detections that nothing predicted accounts for [M07 §2]; ``uniform``: anywhere [D14 Alg. 2];
``fixed``: from given Gaussians [E13 §4]. Rates are expected births per second.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from phdtrack.arrays import draw, sum_by
from phdtrack.checks import NonNegative, PositiveCount, Probability, Share, check
from phdtrack.errors import InputError
from phdtrack.kernels.box_model import births_about, births_of_boxes
from phdtrack.kernels.gaussian import Births
from phdtrack.kernels.grid import points_in_rectangles
from phdtrack.kernels.neighbourhoods import summed_densities
from phdtrack.kernels.pairs import quadratic_form
from phdtrack.models.box_sensor import BoxSensor
from phdtrack.models.volume import REACH, SIZES, Volume, image_volume, in_neighbourhood, local_volume
from phdtrack.protocols import Sensor
from phdtrack.types import F4, F8, I8, GaussianMixture, Particles

# The part of a Gaussian proposal that newborn particles are drawn from. Outside, the importance ratio of a flat γ to the
# proposal grows like exp(r²/2) and its variance is infinite: that mass is dropped.
KEPT = 0.99
# A density of births at what measurements show (r, L), drawn about the measurements (L,).
Gamma = Callable[[F8, I8], F8]


@dataclass(frozen=True, slots=True)
class MeasurementBirth:
    """γ uniform over the image or around the detections, drawn around the detections [M07 §2].

    Parameters
    ----------
    births_per_second : expected births per second: in all where spread over the ``image``, around each detection where
        ``local``.
    particles : Jmax, particles drawn around a detection of which nothing is predicted.
    volume : ``image`` or ``local``: what γ is spread over (see `models.volume`).
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

        def gamma(x: F8, of: I8) -> F8:
            return self._intensity(x, z[: len(x)]) * seconds

        return particles_about(covered, sensor.states(z), sensor.observed, self.particles, gamma, rng)

    def components(self, z: F8, covered: F8, sensor: Sensor, seconds: float) -> GaussianMixture:
        """Gaussians about the detections that have the density of γ there, see `gaussians_about`."""
        return gaussians_about(z, covered, sensor, lambda x: self._intensity(x, z[: len(x)]) * seconds)

    def gaussians(self, z: F8, sensor: Sensor, seconds: float) -> Births:
        """γT as Gaussians around the detections, see `births_around`."""
        density = self.density(z) * seconds
        if type(sensor) is BoxSensor and sensor.scaling != "previous":
            boxes: Births = births_of_boxes(
                np.ascontiguousarray(z), sensor.numbers, sensor.speed, density, *newborn_shape(4)
            )
            return boxes
        return births_around(sensor.states(z), sensor.observed, density)

    def density(self, z: F8) -> F8:
        """(N,) γ per second at the detections themselves."""
        if self.volume == "image":
            return self._intensity(z[:4], z)
        each = self.births_per_second / local_volume(z)
        local: F8 = summed_densities(np.ascontiguousarray(z[:4]), each, REACH, *SIZES)
        return local

    def expected(self, z: F8, seconds: float) -> float:
        """births_per_second·seconds, of each detection where ``local``."""
        return self.births_per_second * seconds * (z.shape[1] if self.volume == "local" else 1)

    def _intensity(self, observed: F8, z: F8) -> F8:
        """γ per second at positions and sizes (m, L); 0 where a size is not positive."""
        if self.volume == "image":
            return np.where((observed[2:4] > 0).all(0), self.births_per_second / image_volume(self.frame_size), 0.0)
        point, which = points_in_rectangles(observed[0], observed[1], z[:2] - z[2:4], z[:2] + z[2:4])
        near = in_neighbourhood(observed[:, point], z[:, which])
        density = self.births_per_second / local_volume(z)[which[near]]
        return sum_by(point[near], density, observed.shape[1])


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

    def components(self, z: F8, covered: F8, sensor: Sensor, seconds: float) -> GaussianMixture:
        """There is none: raises `InputError`."""
        raise InputError(
            "births that are uniform over the image have no form as a Gaussian mixture",
            where="UniformBirth",
            cure="Use births around the detections (birth.kind=measurement), at given places (fixed), or particles",
        )

    def gaussians(self, z: F8, sensor: Sensor, seconds: float) -> Births:
        """There are none: raises `InputError`."""
        self.components(z, z[0], sensor, seconds)
        raise NotImplementedError

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

    def components(self, z: F8, covered: F8, sensor: Sensor, seconds: float) -> GaussianMixture:
        """The given Gaussians, of total mass weight·seconds, whatever was measured [V06 (22)]."""
        return GaussianMixture(self.mixture.weight * seconds, self.mixture.mean, self.mixture.covariance)

    def gaussians(self, z: F8, sensor: Sensor, seconds: float) -> Births:
        """The given Gaussians, of total mass weight·seconds, whatever was measured [V06 (22)]."""
        return births_at(self.mixture, seconds)

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
    velocities, which therefore cancels in the weight: ``gamma`` gives its density at what measurements show (r, L), drawn
    about the measurements (L,).

    ``seen`` are the states and covariances that the measurements show, as `Sensor.states` gives them, ``rows`` are
    `Sensor.observed`, ``particles`` is Jmax.
    """
    mean, cov = seen
    observed = list(rows)
    counts = np.ceil(particles * np.clip(1.0 - covered, 0.0, 1.0)).astype(np.int64)
    parent = np.repeat(np.arange(mean.shape[1]), counts)
    if len(parent) == 0:
        return Particles(np.zeros((len(mean), 0)), np.zeros(0))
    observed_cov = cov[:, observed][:, :, observed]
    limit = _chi2_quantile(len(observed))
    state = mean[:, parent]
    root = np.linalg.cholesky(observed_cov)
    state[observed] += np.einsum("jrs,sj->rj", root[parent], _truncated_normal(len(observed), counts, rng))
    _draw_velocity(state, cov, parent, rng)
    density = gamma(state[observed], parent)
    # Of a small box the noise's region reaches sizes below 0, where nothing is born.
    possible = density > 0
    state, density = state[:, possible], density[possible]
    log_proposal = _log_mixture(state[observed], mean[observed], observed_cov, counts, limit)
    return Particles(state, density * np.exp(-log_proposal))


def births_at(mixture: GaussianMixture, seconds: float) -> Births:
    """The Gaussians of a mixture, whose weights are births per second, over the interval ``seconds``."""
    none = np.full(len(mixture), -1)
    cov = np.ascontiguousarray(mixture.covariance)
    mean = np.ascontiguousarray(mixture.mean.T)
    return Births(mixture.weight * seconds, mean, cov, none, np.zeros(len(mixture)), cov)


def births_around(seen: tuple[F8, F8], rows: tuple[int, ...], density: F8) -> Births:
    """A Gaussian around each detection where births are possible, of the flat density γT there.

    Parameters
    ----------
    seen : states (d, N) and covariances (N, d, d) that the detections alone show, as `Sensor.states` gives them.
    rows : `Sensor.observed`, the rows of the state that a detection shows, with covariance R.
    density : (N,) γT at the detections, per unit of measurement volume; none is born where it is 0.

    Two conditions choose the mass m of a Gaussian and its covariance aR in the observed rows. Seen through the noise R it
    has the density of the flat γ at the detection, and its mass is that of γ in the 99 % region {r² ≤ r₀²}, as of particles.
    In n dimensions, V_n the volume of the unit ball,

        m = γ V_n r₀ⁿ √|R|,     m N(0; 0, (1 + a) R) = γ     ⇒     1 + a = (V_n r₀ⁿ)^(2/n) / 2π

    (a = 3.70 for boxes, 3.61 for points). Filters divide m where Gaussians of several detections overlap.
    """
    mean, first = seen
    volume, stretch = newborn_shape(len(rows))
    out: Births = births_about(mean, first, np.array(rows), density, volume, stretch)
    return out


def gaussians_about(
    z: F8, covered: F8, sensor: Sensor, gamma: Callable[[F8], F8], seen: tuple[F8, F8] | None = None
) -> GaussianMixture:
    """A Gaussian about each detection with M_j < 1; two conditions choose its mass m and covariance aR.

    It is at rest, unless states and covariances like those of `Sensor.states` are given, ``seen``, with other velocities.

    Seen through the noise R it has the density of the flat γ at the detection, and its mass is that of γ in the 99 %
    region {r² ≤ r₀²}, as of the particles. In n dimensions, V_n the volume of the unit ball,

        m = γ V_n r₀ⁿ √|R|,     m N(0; 0, (1 + a) R) = γ     ⇒     1 + a = (V_n r₀ⁿ)^(2/n) / 2π

    (a = 3.70 for boxes, 3.61 for points). Where regions overlap the Gaussians share γ: each is divided by
    Σ_i γ_i exp(−d²_ij/2) / γ_j over those whose region reaches its detection, d in (1 + a) R_i.
    """
    mean, cov = seen or sensor.states(z)
    rows = list(sensor.observed)
    density = gamma(z[: len(rows)])
    fresh = np.flatnonzero((covered < 1.0) & (density > 0))
    mean, cov, density = np.ascontiguousarray(mean[:, fresh]), cov[fresh], density[fresh]
    noise = cov[:, rows][:, :, rows]
    volume, stretch = newborn_shape(len(rows))
    wide = stretch * noise
    limit = _chi2_quantile(len(rows))
    reach = np.sqrt(limit * np.stack([wide[:, 0, 0], wide[:, 1, 1]]))
    shown = np.ascontiguousarray(mean[rows])
    point, which = points_in_rectangles(shown[0], shown[1], shown[:2] - reach, shown[:2] + reach)
    distance2 = quadratic_form(shown, shown, np.linalg.inv(wide), point, which)
    inside = distance2 <= limit
    shared = sum_by(point[inside], (density[which] * np.exp(-0.5 * distance2))[inside], len(fresh))
    mass = density * volume * np.sqrt(np.linalg.det(noise)) * density / shared
    cov[np.ix_(range(len(fresh)), rows, rows)] = wide - noise
    return GaussianMixture(mass, mean, cov)


def _chi2_quantile(dof: int) -> float:
    """The squared radius that holds the kept part of a standard Gaussian in ``dof`` dimensions (13.28 in four)."""
    return float(_squared_radius(dof, np.array([KEPT]))[0])


def _squared_radius(dof: int, part: F8) -> F8:
    """The squared radii that hold these parts of a standard Gaussian in ``dof`` dimensions.

    In an even number of them by halving, from 1 − F(r²) = e^(−r²/2) Σ_{k < dof/2} (r²/2)^k / k!: SciPy, which has them all,
    takes long to import.
    """
    if dof % 2:
        from scipy.special import chdtri

        return np.asarray(chdtri(dof, 1 - part), np.float64)
    low, high = np.zeros(len(part)), np.full(len(part), 400.0)
    for _ in range(64):
        half = (low + high) / 4
        left = np.exp(-half) * sum(half**k / math.factorial(k) for k in range(dof // 2))
        outside = left < 1 - part
        low, high = np.where(outside, low, 2 * half), np.where(outside, 2 * half, high)
    # Next to 1 the sum above is rounded: nothing is held by no radius.
    middle: F8 = np.where(part > 0, (low + high) / 2, 0.0)
    return middle


@lru_cache(maxsize=8)
def newborn_shape(dof: int) -> tuple[float, float]:
    """Volume of the kept region of a unit Gaussian, and 1 + a of `gaussians_about`, in ``dof`` dimensions."""
    ball = math.pi ** (dof / 2) / math.gamma(dof / 2 + 1)
    volume = ball * _chi2_quantile(dof) ** (dof / 2)
    return volume, volume ** (2 / dof) / (2 * math.pi)


@lru_cache(maxsize=1)
def region() -> tuple[float, F4]:
    """The squared radius of a Gaussian's kept part in four dimensions, and the radii at equal steps of its quantile."""
    return _chi2_quantile(4), _radius_table(4)[1].astype(np.float32)


@lru_cache(maxsize=8)
def _radius_table(dof: int) -> tuple[F8, F8]:
    """Quantiles, and the radii at them, of a standard Gaussian in ``dof`` dimensions inside its kept part."""
    quantile = np.linspace(0, 1, 2049)
    return quantile, np.sqrt(_squared_radius(dof, KEPT * quantile))


def _truncated_normal(rows: int, counts: I8, rng: np.random.Generator) -> F8:
    """(rows, Σcounts) standard Gaussian vectors inside the kept part, ``counts`` (N,) of them for each detection.

    The radii of one detection's vectors are stratified: the importance weights of a flat γ follow the radius alone, and a
    thousand independent ones would leave the mass of the newborn uncertain by 9 %.
    """
    total = int(counts.sum())
    direction = rng.standard_normal((rows, total))
    rank = np.arange(total) - np.repeat(np.cumsum(counts) - counts, counts)
    radius = np.interp((rank + rng.random(total)) / np.repeat(counts, counts), *_radius_table(rows))
    out: F8 = direction * (radius / np.sqrt((direction**2).sum(0)))
    return out


def _draw_velocity(state: F8, cov: F8, parent: I8, rng: np.random.Generator) -> None:
    """Add to rows 2 and 3 velocities of uniform direction and Gaussian amplitude, with the covariance that is there."""
    n = state.shape[1]
    root = math.sqrt(2) * np.linalg.cholesky(cov[:, 2:4, 2:4])[parent]
    amplitude, angle = rng.standard_normal(n), rng.uniform(0, 2 * math.pi, n)
    x, y = amplitude * np.cos(angle), amplitude * np.sin(angle)
    state[2] += root[:, 0, 0] * x
    state[3] += root[:, 1, 0] * x + root[:, 1, 1] * y


def _log_mixture(points: F8, mean: F8, cov: F8, counts: I8, limit: float) -> F8:
    """(L,) log Σ_i J_i p_i(x), p_i the Gaussian about ``mean[:, i]`` cut at Mahalanobis distance² ``limit``."""
    # A particle on the rim of its own region may come out just outside by rounding.
    limit *= 1 + 1e-9
    reach = np.sqrt(limit * np.stack([cov[:, 0, 0], cov[:, 1, 1]]))
    point, which = points_in_rectangles(points[0], points[1], mean[:2] - reach, mean[:2] + reach)
    distance2 = quadratic_form(points, mean, np.linalg.inv(cov), point, which)
    _, log_det = np.linalg.slogdet(cov)
    log_norm = -0.5 * log_det - 0.5 * len(points) * math.log(2 * math.pi) - math.log(KEPT)
    inside = distance2 <= limit
    density = counts[which] * np.exp(log_norm[which] - 0.5 * distance2)
    total = sum_by(point[inside], density[inside], points.shape[1])
    # Far from the origin rounding can throw a particle out of every region: it weighs nothing.
    out: F8 = np.log(total, out=np.full_like(total, np.inf), where=total > 0)
    return out
