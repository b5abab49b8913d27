"""What a point target looks like to a detector: the centroid of its box, with the same noise everywhere [D14].

Measurement z = (px, py), g(z|x) = N(z; (px, py), r I), r in pixels². (D14 prints z = (px, py, 1, 1), which would observe a
constant velocity of 1; it is not meant.) A source of detections may put more rows into z, such as the label of the target
that a detection is known to come from: they are not compared.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from phdtrack.arrays import GATE, chi2_quantile, to_cxcywh
from phdtrack.checks import Positive, Probability, Share, check
from phdtrack.errors import InputError
from phdtrack.kernels.particle_models import SensorNumbers, position_numbers
from phdtrack.types import F8, Detections


@dataclass(frozen=True, slots=True)
class PointSensor:
    """g and p_D for point targets [D14].

    Parameters
    ----------
    detection_probability : probability p_D that a target is detected in a frame; D14's is 1.
    noise_variance : r, variance of each coordinate, pixels²; D14's are 0.5, 1 and 2.
    birth_speed : standard deviation of an unknown velocity's amplitude, pixels per time unit.
    size : width and height in pixels of the boxes of states, which have none of their own.
    gate_probability : part of the detections of a target that its gate holds; detections touch no particles beyond. 1: no
        gate.
    """

    detection_probability: Probability = 0.95
    noise_variance: Positive = 1.0
    birth_speed: Positive = 2.0
    size: tuple[Positive, Positive] = (20.0, 50.0)
    gate_probability: Share = GATE

    @property
    def _gate(self) -> float:
        """G, the gate's half-width in deviations."""
        return math.sqrt(chi2_quantile(2, self.gate_probability))

    def __post_init__(self) -> None:
        check(self)
        if not all(math.isfinite(side) and side > 0 for side in self.size):
            raise InputError(f"expected a width and a height above 0, got {self.size}", where="PointSensor.size")

    @property
    def observed(self) -> tuple[int, ...]:
        """Rows of the state that a measurement shows: the position."""
        return (0, 1)

    @property
    def linear(self) -> bool:
        """A measurement is the position."""
        return True

    def measure(self, detections: Detections) -> F8:
        """(2, N) centroids of the boxes."""
        return np.ascontiguousarray(to_cxcywh(detections.xyxy)[:2])

    def expected(self, x: F8) -> F8:
        """(2, L) the positions."""
        return x[:2]

    def innovation(self, z: F8, seen: F8) -> F8:
        """(2, …) z − ``seen``."""
        out: F8 = z[:2] - seen
        return out

    def distance2(self, z: F8, x: F8) -> F8:
        """Squared Mahalanobis distance |z − p|² / r."""
        dx, dy = z[0] - x[0], z[1] - x[1]
        out: F8 = (dx * dx + dy * dy) / self.noise_variance
        return out

    def log_likelihood(self, z: F8, x: F8) -> F8:
        """log g(z|x), density per pixel² [D14]."""
        out: F8 = -0.5 * self.distance2(z, x) - math.log(2 * math.pi * self.noise_variance)
        return out

    def covariance(self, z: F8, x: F8) -> F8:
        """(P, 2, 2) noise covariance r I of (px, py)."""
        return np.tile(self.noise_variance * np.eye(2), (z.shape[1], 1, 1))

    @property
    def angles(self) -> tuple[bool, ...]:
        """None of the components is an angle."""
        return (False, False)

    def target_noise(self, x: F8) -> F8:
        """(L, 2, 2) R."""
        return self.covariance(x, x)

    def measurement_noise(self, z: F8) -> F8:
        """(0, 2, 2): R belongs to the targets."""
        return np.zeros((0, 2, 2))

    def p_detect(self, x: F8) -> F8:
        """p_D, everywhere."""
        return np.full(x.shape[1], self.detection_probability)

    @property
    def occlusion(self) -> bool:
        """Points hide nobody."""
        return False

    def particle_model(self, z: F8) -> SensorNumbers:
        """The numbers of g and p_D for the particle filters, and a column for each measurement."""
        return SensorNumbers(*position_numbers(z, self.covariance(z, z)), np.array([self.detection_probability]))

    def watching(self, targets: F8) -> PointSensor:
        """Itself: points hide nobody."""
        return self

    def gate(self, z: F8) -> tuple[F8, F8]:
        """Squares that reach G deviations along each axis from the centroid."""
        half = self._gate * math.sqrt(self.noise_variance)
        return z[:2] - half, z[:2] + half

    def states(self, z: F8) -> tuple[F8, F8]:
        """Points at rest that would give z, with the covariance of what z alone tells."""
        n = z.shape[1]
        x = np.zeros((4, n))
        x[:2] = z[:2]
        known = np.array([self.noise_variance, self.noise_variance, self.birth_speed**2 / 2, self.birth_speed**2 / 2])
        return x, np.tile(np.diag(known), (n, 1, 1))

    def noise(self, x: F8) -> F8:
        """(4, n) deviations by which components are resolved: of a centroid, of an unknown velocity."""
        out = np.empty((4, x.shape[1]))
        out[:2], out[2:] = math.sqrt(self.noise_variance), self.birth_speed / math.sqrt(2)
        return out

    def boxes(self, x: F8) -> F8:
        """(n, 4) boxes of the set size about the positions."""
        half = np.array(self.size)[:, None] / 2
        return np.concatenate([x[:2] - half, x[:2] + half]).T.copy()
