"""γ for point targets: anywhere in the image, drawn around the detections that nothing predicted accounts for [M07 §2].

D14 draws newborn particles anywhere instead, whatever was detected: `births.UniformBirth`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.checks import NonNegative, PositiveCount, check
from phdtrack.kernels.gaussian import Births
from phdtrack.models.births import births_around, particles_about
from phdtrack.models.volume import image_area
from phdtrack.protocols import Sensor
from phdtrack.types import F8, Particles


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
