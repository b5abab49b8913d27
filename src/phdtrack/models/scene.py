"""γ and κ learned from a scene: γ(x) = s̄ p(x|b), κ(z) = r̄ p(z|c) [M09 (12)–(15)].

Newborn particles are drawn around detections that no predicted target explains, as in
`births.MeasurementBirth`. Around each, γ is flat, with the value that makes the evidence of births
there exact:

    ∫ g(z|x) γ(x) dx = s̄ [α_u/V + α_g Σ_m π_m N(z; μ_m, Σ_m + R) / Z_m]

for a sensor that shows some components of the state with noise R. Velocities have the mean and
covariance of the same mixture given z; those of the uniform part are the sensor's. So α_u = 1 is
`MeasurementBirth` over the same volume. The Gaussian-mixture filters use the Gaussians themselves.

**Added to the model's own.** The default γ and κ are scale-invariant and the same everywhere
(`models.volumes`), and high enough in crowds: a κ spread over a whole frame and all sizes is so low
that targets claim any detection nearby. With their rate a, l(z) = 1/(4w²h²), and p(z|o) the density
of objects' detections,

    κ(z) = a l(z) + r̄ p(z|c)      γ(z) = a l(z) p(z|b) / p(z|o)

so that an unknown scene is the default model, learned false alarms are added, and the total number
of births stays the same but moves to places where births were observed. This is ours, not M09's; a
= 0 is M09's.

All of it is tied to pixels of the image, and holds only for a fixed camera (`refuse_standing`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from phdtrack.errors import Checked, InputError, NonNegative, PositiveCount
from phdtrack.kernels.box import OBSERVED
from phdtrack.kernels.gaussian import Births, Expected, learned_births
from phdtrack.models.births import FixedBirth, MeasurementBirth, births_around, particles_about
from phdtrack.models.clutter import BoxClutter
from phdtrack.models.volumes import local_density
from phdtrack.protocols import Birth, Clutter, Model, Sensor
from phdtrack.scene import LearnedDensity, SceneDensity, TrackedObjects, marginal, shown_volume
from phdtrack.types import F8, GaussianMixture, Particles

TINY = float(np.finfo(np.float64).tiny)
# Gaussians that add less than e^-16, 1e-7, of the uniform part at a detection are left out.
NEGLIGIBLE = 16.0


@dataclass(frozen=True, eq=False)
class SceneBirth(Checked):
    """γ(x) = s̄ p(x|b) on states [M09 (12), (14)].

    Parameters
    ----------
    births_per_second : s̄, expected births per second.
    density : p(x|b) on states (6).
    particles : Jmax, particles drawn around a detection without predicted mass.
    births_per_detection : births a second in the neighbourhood of a box in an unknown scene; 0: s̄
        p(x|b) alone.
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
        density, (mean, covariance) = self.around(sensor.states(z), seconds)
        states = (np.ascontiguousarray(mean), covariance)
        return particles_about(covered, states, OBSERVED, self.particles, density, rng)

    def gaussians(self, z: F8, sensor: Sensor, seconds: float) -> Births:
        """γT around the detections, and the learned Gaussians if there are no births around
        detections.

        Learned Gaussians are not truncated at the volume; their parts inside have the mass of γT.
        """
        measured = sensor.states(z)
        if self.births_per_detection > 0:
            density, learned = self.around(measured, seconds)
            return births_around(learned, density)
        contained = self._shown.contains(z[: len(OBSERVED)])
        flat = np.where(contained, self.births_per_second * self._shown.flat * seconds, 0.0)
        # The parts of the Gaussians inside the volume have their masses.
        weight, mean, covariance = self.density.gaussians
        learned_births = GaussianMixture(self.births_per_second * weight, mean, covariance)
        return births_around(measured, flat, learned_births, seconds)

    def expected_count(self, z: F8, seconds: float) -> float:
        """s̄T, or the number of births around all detections."""
        if self.births_per_detection > 0:
            return float(self.births_per_detection * seconds * z.shape[1])
        return self.births_per_second * seconds

    def around(self, measured: tuple[F8, F8], seconds: float) -> tuple[F8, tuple[F8, F8]]:
        """γT (N,) at detections, and the states (d, N) and covariances (N, d, d) of newborn, with
        learned velocities.

        ``measured``: the states that the detections imply, from `Sensor.states`.
        """
        state, noise = measured
        shown = self._shown
        weight, predicted, gate = self._learned
        if self.births_per_detection:
            z = state[np.array(OBSERVED)]
            objects: F8 | float = 1 / shown.volume
            if self.among is not None:
                objects = self.among(z, outside=self.among.flat)
            rate = local_density(z, self.births_per_detection * seconds) / objects
            least = shown.flat
        else:
            rate = np.full(state.shape[1], self.births_per_second * seconds)
            least = 0.0
        volume = (shown.low, shown.high, shown.flat)
        seen = (np.ascontiguousarray(state), np.ascontiguousarray(noise))
        density, mean, covariance = learned_births(
            seen, weight, tuple(predicted), gate, volume, rate, least
        )
        return density, (mean.T, covariance)

    @cached_property
    def _shown(self) -> SceneDensity:
        """p of the observed components, velocities integrated out."""
        return marginal(self.density, OBSERVED)

    @cached_property
    def _learned(self) -> tuple[F8, Expected, float]:
        """The weights of the Gaussians of p, their predicted measurements, and the distance beyond
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
    density : p(z|c) on observed components (r). Outside of its volume κ is that of its uniform
        part: a detection there is no more certain to be a target than one in an empty place.
    clutter_per_detection : additional false alarms a frame in the neighbourhood of a box; 0: none.
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
            return learned + local_density(z, self.clutter_per_detection)
        return learned


def in_one_volume(birth: Birth, clutter: Clutter) -> tuple[Birth, Clutter]:
    """Birth and clutter over one volume: if one was learned and the other is uniform over the
    image, the other gets the volume of the learned one.

    This is the frame and the sizes that are detected. Over all sizes in the frame a density is
    thousands of times smaller, and probabilities of existence depend on the ratio of the two.
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
    """Likelihood ratios of false alarms to objects at a position, from a person's labels.

    A flickering light is detected again and again as if a person stood there; no filter can
    recognise it by its motion. But on labelled frames every detection is known to be a false alarm
    or an object. With G(z) the Gaussians of κ(z), T(z) the density per frame of objects'
    detections, λ the share of false alarms that become tracks although κ is known, and B(z) as many
    detections as objects have, distributed as the Gaussians of p(z|b), the ratios are

        λ G(z)/T(z)           of a false alarm that became a track
        κ(z)/(T(z) + B(z))    of any false alarm

    B counts because targets enter where others did, which many more frames have shown; it does not
    count for false alarms that become tracks, because the tracker's own tracks begin there, too.
    This is ours, not M09's.

    Parameters
    ----------
    clutter : false alarms.
    tracked : the share of them that become tracks, and the density of objects.
    births : the density of entering targets, None if it was not learned.
    """

    clutter: LearnedDensity
    tracked: TrackedObjects
    births: LearnedDensity | None = None

    def log(self, z: F8) -> F8:
        """(2, N) logarithms of λG/T and of κ/(T + B) at boxes ``z`` (4, N)."""
        objects = self.tracked.objects
        alarms = self.clutter.density
        # The Gaussians count inside the volume only; the uniform parts continue beyond it.
        gaussians = self.clutter.rate * alarms.gaussian_part(z)
        present = objects.rate * objects.density(z, outside=objects.density.flat)
        entering: F8 | float = 0.0
        if self._entrances is not None:
            entering = objects.rate * self._entrances.gaussian_part(z)
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
    """The error of a part that is tied to pixels, under a moving camera."""
    return InputError(
        f"{what} holds for places in the image of a camera that stands still",
        where="camera motion",
        cure="Leave it out, or do not compensate the camera's motion",
    )


def refuse_standing(model: Model) -> None:
    """Raise `InputError` if births or false alarms of the model are tied to pixels, which a moving
    camera leaves behind.
    """
    if isinstance(model.birth, FixedBirth | SceneBirth):
        raise not_standing("where targets appear (birth.kind=places, or a learned scene)")
    if isinstance(model.clutter, SceneClutter):
        raise not_standing("where false alarms are (a learned scene)")
