"""γ and κ as a scene has taught them: γ(x) = s̄ p(x|b), κ(z) = r̄ p(z|c) [M09 (12)–(15)].

Newborn are drawn around the detections that nothing predicted accounts for, as of `births.MeasurementBirth`. Around each, γ
is taken as flat, with the value that makes the evidence of what is born there exact:

    ∫ g(z|x) γ(x) dx = s̄ [α_u/V + α_g Σ_m π_m N(z; μ_m, Σ_m + R) / Z_m]

for a sensor that shows some components of the state with noise R. Velocities have the mean and covariance of the same
mixture given z, with uniform direction and Gaussian amplitude; of the uniform part those of the sensor. So α_u = 1 is
`MeasurementBirth` over the same volume. The Gaussian-mixture filters take the Gaussians themselves.

**Added to the model's own.** The default γ and κ are no densities of a scene: they are spread around each detection, and
are therefore high where much is detected. Filters need that where people stand close: κ spread over a whole frame is so low
that targets take whatever is near. With a rate a around each detection, l(z) the density around the detections per unit of
rate, and p(z|o) the density of objects' detections,

    κ(z) = a l(z) + r̄ p(z|c)      γ(z) = a l(z) p(z|b) / p(z|o)

so that a scene of which nothing is known is the default model, learned false alarms are added, and the total number of
births stays the same but goes to places where births were seen. This is ours, not M09's; a = 0 is M09's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from phdtrack.checks import NonNegative, PositiveCount, check
from phdtrack.kernels.gaussian import Births
from phdtrack.kernels.laid_over import laid_about, laid_births, laid_clutter
from phdtrack.kernels.scene_density import COARSE, given_detections, mixture_density, newborn_about
from phdtrack.models.births import MeasurementBirth, births_around, births_at, gaussians_about, particles_about
from phdtrack.models.clutter import LocalClutter
from phdtrack.models.volume import REACH, SIZES
from phdtrack.protocols import Model, Sensor
from phdtrack.scene import LearnedDensity, SceneDensity, TrackedObjects, marginal, uniform_density
from phdtrack.scene.mixture import OBSERVED
from phdtrack.types import F4, F8, I8, GaussianMixture, Particles

TINY = float(np.finfo(np.float64).tiny)
# What `models.volume` calls local: the volume in w²h², how far it reaches in boxes, the sizes in it.
_NEIGHBOURHOOD = ((2 * REACH) ** 2 * (SIZES[1] - SIZES[0]) ** 2, REACH, *SIZES)


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

    def flat(self, x: F8, first: I8) -> F8:
        """(L,) γT at ``x`` (r, L), in runs about the detections; 0 where a size is not positive."""
        return np.where((x[2:] > 0).all(axis=0), np.repeat(self.density, np.diff(first)), 0.0)


@dataclass(frozen=True, eq=False)
class SceneBirth:
    """γ(x) = s̄ p(x|b) on states [M09 (12), (14)].

    Parameters
    ----------
    births_per_second : s̄, expected births per second.
    density : p(x|b) on states (d).
    observed : the rows of the state that measurements show; the others are velocities.
    particles : Jmax, particles drawn around a detection of which nothing is predicted.
    around_detections : births a second around each detection, of boxes, where nothing is known; 0: s̄ p(x|b) alone.
    among : p(z|o), for births beside others; None: uniform over the volume.
    """

    births_per_second: NonNegative
    density: SceneDensity
    observed: tuple[int, ...] = OBSERVED
    particles: PositiveCount = 1000
    around_detections: NonNegative = 0.0
    among: SceneDensity | None = None

    def __post_init__(self) -> None:
        check(self)

    @cached_property
    def shown(self) -> SceneDensity:
        """p of what measurements show, velocities integrated out."""
        return marginal(self.density, self.observed)

    def sample(self, z: F8, covered: F8, sensor: Sensor, seconds: float, rng: np.random.Generator) -> Particles:
        """Particles around the detections with the evidence and the velocities of γT there [M07 §2, M09 (12)]."""
        at = self.around(sensor.states(z), seconds)
        rows = self.observed
        return particles_about(covered, (at.mean, at.covariance), rows, self.particles, at.flat, rng)

    def around(self, seen: tuple[F8, F8], seconds: float) -> Around:
        """What γT is around detections whose states and covariances, as `Sensor.states` gives them, are ``seen``."""
        if self.around_detections > 0:
            density, state, cov = laid_births(
                *seen, *self._table, *self._among, self.around_detections * seconds, *_NEIGHBOURHOOD
            )
            return Around(state, cov, density)
        density, state, cov = given_detections(*seen, *self._table)
        return Around(state, cov, self.births_per_second * seconds * density)

    def about(self, state: F8, deviation: F8, seconds: float) -> tuple[F4, F4]:
        """`around` in single precision for noise without correlations: densities (N,), and velocities (5, N).

        ``state`` (d, N) are those at rest, ``deviation`` (d, N) the noise's; velocities as `newborn_about` gives them.
        """
        if self.around_detections > 0:
            laid: tuple[F4, F4] = laid_about(
                state, deviation, *self._table, *self._among, self.around_detections * seconds, *_NEIGHBOURHOOD
            )
            return laid
        alone: tuple[F4, F4] = newborn_about(state, deviation, self.births_per_second * seconds, *self._table)
        return alone

    @cached_property
    def _table(self) -> tuple[I8, int, F8, F8, float, F8, F8, F8, F8]:
        """The density as `given_detections` takes it."""
        p, shown = self.density, self.shown
        order = np.array([*self.observed, *(r for r in range(p.dim) if r not in self.observed)])
        lower, r = np.tril_indices(p.dim), shown.dim
        cov = p.covariance[:, order][:, :, order]
        peak2 = np.square(p.scaled_weight) / (2 * np.pi) ** r
        with np.errstate(divide="ignore"):
            log_peak = 0.5 * (np.log(peak2) - np.linalg.slogdet(cov[:, :r, :r])[1])
        # Below 0 nothing is near enough.
        reach = 2 * np.maximum(log_peak - np.log(shown.flat) + COARSE, -1.0)
        triangles = np.ascontiguousarray(cov[:, *lower].T)
        return order, r, shown.low, shown.high, shown.flat, p.mean[order], triangles, peak2, reach

    @cached_property
    def _among(self) -> tuple[F8, F8, F8, F8, F8, F8]:
        """p(z|o) as `mixture_density` takes it, nowhere below its uniform part."""
        p = uniform_density(self.shown.low, self.shown.high) if self.among is None else self.among
        return p.low, p.high, np.full(2, p.flat), *p.table

    @property
    def flat(self) -> float:
        """The uniform part of γ, per second and unit of what measurements show."""
        return self.births_per_second * self.shown.flat

    @cached_property
    def given(self) -> GaussianMixture:
        """The Gaussians of γ, whose parts inside the volume have its masses, per second."""
        return GaussianMixture(
            self.births_per_second * self.density.scaled_weight, self.density.mean, self.density.covariance
        )

    def components(self, z: F8, covered: F8, sensor: Sensor, seconds: float) -> GaussianMixture:
        """The learned Gaussians as they are, and the uniform part as Gaussians about the detections (`gaussians_about`).

        What of a Gaussian lies beyond the volume is not cut off here; the parts inside have the masses of γT. Births that
        are spread around each detection are Gaussians about the detections, with the velocities that were learned.
        """
        if self.around_detections > 0:
            at = self.around(sensor.states(z), seconds)
            return gaussians_about(z, covered, sensor, lambda x: at.density, (at.mean, at.covariance))
        given = self.given
        spread = gaussians_about(z, covered, sensor, lambda x: np.where(self.shown.contains(x), self.flat * seconds, 0.0))
        return GaussianMixture(
            np.concatenate([given.weight * seconds, spread.weight]),
            np.hstack([given.mean, spread.mean]),
            np.concatenate([given.covariance, spread.covariance]),
        )

    def gaussians(self, z: F8, sensor: Sensor, seconds: float) -> Births:
        """γT as Gaussians: around the detections, and with a rate of 0 there the learned ones too, see `components`."""
        seen = sensor.states(z)
        if self.around_detections > 0:
            at = self.around(seen, seconds)
            return births_around((at.mean, at.covariance), self.observed, at.density)
        given, observed = births_at(self.given, seconds), z[: len(self.observed)]
        spread = births_around(seen, self.observed, np.where(self.shown.contains(observed), self.flat * seconds, 0.0))
        return Births(*(np.concatenate(parts) for parts in zip(given, spread, strict=True)))

    def expected(self, z: F8, seconds: float) -> float:
        """s̄T, or so many of each detection as there are beside."""
        if self.around_detections > 0:
            return float(self.around_detections * seconds * z.shape[1])
        return self.births_per_second * seconds


@dataclass(frozen=True, eq=False)
class SceneClutter:
    """κ(z) = r̄ p(z|c) on measurements [M09 (13), (15)].

    Parameters
    ----------
    clutter_per_frame : r̄, expected false alarms per frame.
    density : p(z|c) on what measurements show (r). Where it does not reach, κ is that of its uniform part: a detection
        beyond the volume is no more certain to be a target than one in an empty place.
    around_detections : false alarms a frame around each detection, of boxes, that come to these; 0: none.
    """

    clutter_per_frame: NonNegative
    density: SceneDensity
    around_detections: NonNegative = 0.0

    def __post_init__(self) -> None:
        check(self)

    def intensity(self, z: F8) -> F8:
        """(N,) κ per frame and unit of measurement space."""
        z, rate = np.ascontiguousarray(z), float(self.clutter_per_frame)
        if self.around_detections > 0 and z.shape[1]:
            laid: F8 = laid_clutter(z, rate, *self._table, float(self.around_detections), *_NEIGHBOURHOOD)
            return laid
        out: F8 = mixture_density(z, rate, *self._table)
        return out

    @cached_property
    def _table(self) -> tuple[F8, F8, F8, F8, F8, F8]:
        """The density as `mixture_density` takes it, nowhere below its uniform part."""
        return self.density.low, self.density.high, np.full(2, self.density.flat), *self.density.table

    @cached_property
    def rows(self) -> tuple[F8, F8]:
        """The same of boxes as `kernels.laid_over.clutter_by_place` takes it: bounds, and false alarms."""
        low, high, flat, *alarms = self._table
        return np.concatenate([[float(self.clutter_per_frame)], flat, low, high]), np.vstack(alarms)


def with_scene(
    model: Model,
    births: LearnedDensity | None,
    clutter: LearnedDensity | None,
    followed: TrackedObjects | None,
    particles: int,
) -> Model:
    """The model with what a scene has taught, beside its own births and false alarms where these are spread around each
    detection; None: as they are. ``particles`` is Jmax."""
    birth, false = model.birth, model.clutter
    if births is not None:
        own = birth.births_per_second if isinstance(birth, MeasurementBirth) and birth.volume == "local" else 0.0
        birth = SceneBirth(
            births.rate * model.rate, births.density, particles=particles, around_detections=own, among=objects_of(followed)
        )
    if clutter is not None:
        own = false.clutter_per_frame if isinstance(false, LocalClutter) else 0.0
        false = SceneClutter(clutter.rate, clutter.density, own)
    return replace(model, birth=birth, clutter=false)


def objects_of(followed: TrackedObjects | None) -> SceneDensity | None:
    """p(z|o), None where it is not known."""
    return None if followed is None else followed.objects.density


@dataclass(frozen=True, eq=False)
class FalseAlarmRatio:
    """Likelihood ratios of false alarms to objects at a place, from what a person marked.

    A light that flickers is detected again and again as if a person stood there; no filter can tell it by its motion. But on
    the frames that were looked at every detection is known to be a false alarm or an object. With G(z) the Gaussians of
    κ(z), T(z) the density per frame of objects' detections, λ the share of false alarms that become tracks although κ is
    known, and B(z) as many detections as objects have, spread as the Gaussians of p(z|b), the ratios are

        λ G(z)/T(z)  of a false alarm that became a track      κ(z)/(T(z) + B(z))  of any false alarm

    B counts because targets enter where others did, which many more frames have shown; where false alarms become tracks
    births tell nothing, as the tracker's own tracks begin there, too. This is ours, not M09's.

    Parameters
    ----------
    clutter : false alarms.
    tracked : which of them become tracks, and where objects are.
    births : where targets enter, None where that was not learned.
    """

    clutter: LearnedDensity
    tracked: TrackedObjects
    births: LearnedDensity | None = None

    def log(self, z: F8) -> F8:
        """(2, N) logarithms of λG/T and of κ/(T + B) at boxes ``z`` (4, N)."""
        z, objects = np.ascontiguousarray(z), self.tracked.objects
        gaussians = mixture_density(z, self.clutter.rate, *_table(self.clutter.density, TINY))
        # The uniform part of objects goes on beyond the volume.
        present = mixture_density(z, objects.rate, *_table(objects.density, objects.density.flat))
        entering = 0.0
        if self.births is not None:
            entering = mixture_density(z, objects.rate, *_table(marginal(self.births.density, OBSERVED), TINY))
        flat = self.clutter.rate * self.clutter.density.flat
        tracked = np.maximum(self.tracked.share * gaussians, TINY) / np.maximum(present, TINY)
        return np.log([tracked, np.maximum(gaussians + flat, TINY) / np.maximum(present + entering, TINY)])


def _table(p: SceneDensity, flat: float) -> tuple[F8, F8, F8, F8, F8, F8]:
    """The Gaussians of a density with the uniform part ``flat`` everywhere, as `mixture_density` takes them."""
    return p.low, p.high, np.full(2, flat), *p.table
