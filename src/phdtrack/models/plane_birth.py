"""γ on the ground plane: new people around the detections that nothing predicted accounts for [M07 §2, E13 §4]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.checks import NonNegative, PositiveCount, check
from phdtrack.kernels.gaussian import Births
from phdtrack.models.births import births_around, particles_about
from phdtrack.models.region import EVERYWHERE, PlaneVolume, Region, area, check_region, inside, local_density
from phdtrack.protocols import Sensor
from phdtrack.types import F8, Particles


@dataclass(frozen=True, slots=True)
class PlaneBirth:
    """γ uniform over a region of the ground or around the detections, drawn around the detections.

    Parameters
    ----------
    births_per_second : expected births per second: in all where spread over the ``region``, around each detection where
        ``local``.
    particles : Jmax, particles drawn around a detection of which nothing is predicted.
    volume : ``region`` or ``local``: what γ is spread over (see `models.region`).
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
