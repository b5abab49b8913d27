"""γ and κ as a scene has taught them: γ(x) = s̄ p(x|b), κ(z) = r̄ p(z|c) [M09 (12)–(15)].

Newborn are drawn around the detections that nothing predicted accounts for, as of
`births.MeasurementBirth`. Around each, γ is taken as flat, with the value that makes the evidence
of what is born there exact:

    ∫ g(z|x) γ(x) dx = s̄ [α_u/V + α_g Σ_m π_m N(z; μ_m, Σ_m + R) / Z_m]

for a sensor that shows some components of the state with noise R. Velocities have the mean and
covariance of the same mixture given z; of the uniform part those of the sensor. So α_u = 1 is
`MeasurementBirth` over the same volume. The Gaussian-mixture filters take the Gaussians themselves.

**Added to the model's own.** The default γ and κ are the same everywhere at every scale
(`models.volumes`), and high enough where people stand close: a κ spread over a whole frame and all
sizes is so low that targets take whatever is near. With their rate a, l(z) = 1/(4w²h²), and p(z|o)
the density of objects' detections,

    κ(z) = a l(z) + r̄ p(z|c)      γ(z) = a l(z) p(z|b) / p(z|o)

so that a scene of which nothing is known is the default model, learned false alarms are added, and
the total number of births stays the same but goes to places where births were seen. This is ours,
not M09's; a = 0 is M09's.

All of it lies at pixels of the image, and holds while the camera stands still (`refuse_standing`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from phdtrack.errors import Checked, InputError, NonNegative, PositiveCount
from phdtrack.kernels.gaussian import Births, Expected, Measurements, NewTargets, first_states
from phdtrack.models.births import FixedBirth, MeasurementBirth, births_around, particles_about
from phdtrack.models.clutter import BoxClutter
from phdtrack.models.volumes import local_volume
from phdtrack.protocols import Birth, Clutter, Model, Sensor
from phdtrack.scene import LearnedDensity, SceneDensity, TrackedObjects, marginal, shown_volume
from phdtrack.scene.mixture import OBSERVED
from phdtrack.types import F8, GaussianMixture, Particles

TINY = float(np.finfo(np.float64).tiny)
# At detections, what of a Gaussian adds less than e^-16, 1e-7, of the uniform part is left out.
NEGLIGIBLE = 16.0


@dataclass(frozen=True, eq=False)
class SceneBirth(Checked):
    """γ(x) = s̄ p(x|b) on states [M09 (12), (14)].

    Parameters
    ----------
    births_per_second : s̄, expected births per second.
    density : p(x|b) on states (6).
    particles : Jmax, particles drawn around a detection of which nothing is predicted.
    births_per_detection : births a second in the neighbourhood of a box, where nothing is known; 0:
        s̄ p(x|b) alone.
    among : p(z|o), for births around detections; None: uniform over the volume.
    """

    births_per_second: NonNegative
    density: SceneDensity
    particles: PositiveCount = 1000
    births_per_detection: NonNegative = 0.0
    among: SceneDensity | None = None

    def sample(
        self, z: F8, covered: F8, sensor: Sensor, seconds: float, rng: np.random.Generator
    ) -> Particles:
        """Particles around the detections with the evidence and the velocities of γT there [M07 §2,
        M09 (12)].
        """
        density, seen = self.around(sensor.states(z), seconds)
        return particles_about(covered, seen, OBSERVED, self.particles, density, rng)

    def gaussians(self, z: F8, sensor: Sensor, seconds: float) -> Births:
        """γT around the detections, and the learned Gaussians where there are no births around
        detections.

        What of a learned Gaussian lies beyond the volume is not cut off; the part inside has the
        mass of γT.
        """
        seen = sensor.states(z)
        if self.births_per_detection > 0:
            density, learned = self.around(seen, seconds)
            return births_around(learned, density)
        contained = self._shown.contains(z[: len(OBSERVED)])
        flat = np.where(contained, self.births_per_second * self._shown.flat * seconds, 0.0)
        # The parts of the Gaussians inside the volume have their masses.
        weight, mean, covariance = self.density.gaussians
        return births_around(
            seen, flat, GaussianMixture(self.births_per_second * weight, mean, covariance), seconds
        )

    def expected(self, z: F8, seconds: float) -> float:
        """s̄T, or with births around detections so many of each."""
        if self.births_per_detection > 0:
            return float(self.births_per_detection * seconds * z.shape[1])
        return self.births_per_second * seconds

    def around(self, seen: tuple[F8, F8], seconds: float) -> tuple[F8, tuple[F8, F8]]:
        """γT (N,) at detections, and the states (d, N) and covariances (N, d, d) about which
        newborn are drawn.

        ``seen`` are the states that the detections show, as `Sensor.states` gives them; velocities
        are those learned.
        """
        state, noise = seen
        shown = self._shown
        weight, given, gate = self._learned
        rows = np.array(OBSERVED)
        n = state.shape[1]
        z = np.ascontiguousarray(state[rows])
        nothing = np.zeros(n)
        flat = NewTargets(
            np.full(n, shown.flat), np.ascontiguousarray(state.T), np.ascontiguousarray(noise)
        )
        measured = Measurements(
            np.ascontiguousarray(z.T), noise[:, rows[:, None], rows], nothing, (0.0,) * len(rows)
        )
        found = first_states(
            Births(flat, weight, given.z, given.covariance), nothing + 1.0, given, measured, gate
        )
        density = np.where(shown.contains(z), found.density, 0.0)
        # What a detection shows stays as it shows it.
        hidden = np.setdiff1d(np.arange(len(state)), rows)
        mean = state.copy()
        covariance = noise.copy()
        mean[hidden] = found.mean.T[hidden]
        block = (slice(None), hidden[:, None], hidden)
        covariance[block] = found.covariance[block]
        if not self.births_per_detection:
            return self.births_per_second * seconds * density, (mean, covariance)
        objects = 1 / shown.volume if self.among is None else self.among(z, outside=self.among.flat)
        local = self.births_per_detection * seconds / local_volume(z)
        return local * np.maximum(density, shown.flat) / objects, (mean, covariance)

    @cached_property
    def _shown(self) -> SceneDensity:
        """p of what measurements show, velocities integrated out."""
        return marginal(self.density, OBSERVED)

    @cached_property
    def _learned(self) -> tuple[F8, Expected, float]:
        """The weights of the Gaussians of p, what they say of measurements, and the distance beyond
        which none counts.
        """
        weight, columns, covariance = self.density.gaussians
        mean = np.ascontiguousarray(columns.T)
        rows = np.array(OBSERVED)
        k = len(weight)
        r = len(OBSERVED)
        log_det = np.linalg.slogdet(2 * np.pi * covariance[:, rows[:, None], rows])[1]
        peak = float(np.max(np.log(np.maximum(weight, TINY)) - 0.5 * log_det, initial=-math.inf))
        gate = math.sqrt(max(0.0, 2 * (peak - math.log(self._shown.flat) + NEGLIGIBLE)))
        return (
            weight,
            Expected(rows, mean, covariance, covariance, np.zeros((0, r, r)), np.ones(k)),
            gate,
        )


@dataclass(frozen=True, eq=False)
class SceneClutter(Checked):
    """κ(z) = r̄ p(z|c) on measurements [M09 (13), (15)].

    Parameters
    ----------
    clutter_per_frame : r̄, expected false alarms per frame.
    density : p(z|c) on what measurements show (r). Where it does not reach, κ is that of its
        uniform part: a detection beyond the volume is no more certain to be a target than one in an
        empty place.
    clutter_per_detection : false alarms a frame in the neighbourhood of a box that are added; 0:
        none.
    """

    clutter_per_frame: NonNegative
    density: SceneDensity
    clutter_per_detection: NonNegative = 0.0

    def intensity(self, z: F8) -> F8:
        """(N,) κ per frame and unit of measurement space."""
        learned = self.clutter_per_frame * self.density(
            z[: self.density.dim], outside=self.density.flat
        )
        if self.clutter_per_detection:
            return learned + self.clutter_per_detection / local_volume(z)
        return learned


def in_one_volume(birth: Birth, clutter: Clutter) -> tuple[Birth, Clutter]:
    """Both, where one was learned and the other is uniform over the image: that one gets the volume
    of the learned one.

    This is the frame and the sizes that are detected. Over all sizes of the frame a density is
    thousands of times less, and what the filter believes depends on the ratio of the two.
    """
    if (
        isinstance(clutter, SceneClutter)
        and isinstance(birth, MeasurementBirth)
        and birth.births_per_second
    ):
        return replace(birth, volume=shown_volume(clutter.density)), clutter
    if (
        isinstance(birth, SceneBirth)
        and isinstance(clutter, BoxClutter)
        and clutter.clutter_per_frame
    ):
        return birth, replace(clutter, volume=shown_volume(birth.density))
    return birth, clutter


@dataclass(frozen=True, eq=False)
class FalseAlarmRatio:
    """Likelihood ratios of false alarms to objects at a place, from what a person marked.

    A light that flickers is detected again and again as if a person stood there; no filter can tell
    it by its motion. But on the frames that were looked at every detection is known to be a false
    alarm or an object. With G(z) the Gaussians of κ(z), T(z) the density per frame of objects'
    detections, λ the share of false alarms that become tracks although κ is known, and B(z) as many
    detections as objects have, spread as the Gaussians of p(z|b), the ratios are

        λ G(z)/T(z)  of a false alarm that became a track      κ(z)/(T(z) + B(z))  of any false
        alarm

    B counts because targets enter where others did, which many more frames have shown; where false
    alarms become tracks births tell nothing, as the tracker's own tracks begin there, too. This is
    ours, not M09's.

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
        objects = self.tracked.objects
        alarms = self.clutter.density
        # The Gaussians count inside the volume only; the uniform parts go on beyond it.
        gaussians = self.clutter.rate * alarms.gaussian_part(z)
        present = objects.rate * objects.density(z, outside=objects.density.flat)
        entering = (
            0.0 if self._entrances is None else objects.rate * self._entrances.gaussian_part(z)
        )
        tracked = np.maximum(self.tracked.share * gaussians, TINY) / np.maximum(present, TINY)
        any_alarm = np.maximum(gaussians + self.clutter.rate * alarms.flat, TINY)
        return np.log([tracked, any_alarm / np.maximum(present + entering, TINY)])

    @cached_property
    def _entrances(self) -> SceneDensity | None:
        """p(z|b) of boxes."""
        if self.births is None:
            return None
        return marginal(self.births.density, OBSERVED)


def not_standing(what: str) -> InputError:
    """The error of a part that lies at pixels, under a camera that moves."""
    return InputError(
        f"{what} holds for places in the image of a camera that stands still",
        where="camera motion",
        cure="Leave it out, or do not compensate the camera's motion",
    )


def refuse_standing(model: Model) -> None:
    """Raise `InputError` where births or false alarms of the model lie at pixels, which a moving
    camera leaves behind.
    """
    if isinstance(model.birth, FixedBirth | SceneBirth):
        raise not_standing("where targets appear (birth.kind=places, or a learned scene)")
    if isinstance(model.clutter, SceneClutter):
        raise not_standing("where false alarms are (a learned scene)")
