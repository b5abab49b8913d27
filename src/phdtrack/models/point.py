"""Points in the image: motion and sensor [D14].

**Motion.** State x = (px, py, vx, vy), pixels and pixels per time unit. Over T = 1 independent
noises of variance q act on position and velocity of an axis: Q(1) = q I. For whole T, of T such
steps,

    Q(T) = q [T³/3 − T²/2 + 7T/6   (T² − T)/2]
             [(T² − T)/2            T        ]

As a polynomial in T this holds for every T > 0: it is the covariance of white noise of density q
[[7/6, −1/2], [−1/2, 1]] on position and velocity, and an interval divided anywhere gives the same
as the whole.

**Sensor.** Measurement z = (px, py), the centroid of a box, g(z|x) = N(z; (px, py), r I), r in
pixels². (D14 prints z = (px, py, 1, 1), which would observe a constant velocity of 1; that is not
meant.) A source of detections may add rows to z, such as the label of the target of a detection:
they are not compared.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from phdtrack.arrays import GATE, to_cxcywh
from phdtrack.errors import NonNegative, Positive, Probability, Share
from phdtrack.kernels.particle_models import SensorNumbers, position_numbers
from phdtrack.models import warp
from phdtrack.models.positions import PositionMotion, PositionSensor, Variances
from phdtrack.models.volumes import EVERYWHERE, Region
from phdtrack.types import F8, Detections


@dataclass(frozen=True, slots=True)
class PointMotion(PositionMotion):
    """f and p_S for point targets [D14].

    Parameters
    ----------
    noise_variance : q, of each component's noise over one time unit, pixels²; D14's is 2.
    survival_probability : probability p_S that a target is still there after one second; D14's is
        1.
    borders : left, low, right and high border in pixels; a target that has left it does not
        survive. All 0: no border.
    """

    noise_variance: NonNegative = 2.0
    survival_probability: Probability = 0.99**25
    borders: Region = EVERYWHERE

    def _variances(self, dt: float) -> Variances:
        """Variances of position, of position and velocity, of velocity, over ``dt`` time units."""
        position = dt**3 / 3 - dt**2 / 2 + 7 * dt / 6
        return (
            self.noise_variance * position,
            self.noise_variance * (dt**2 - dt) / 2,
            self.noise_variance * dt,
        )

    warp_states = staticmethod(warp.warp_states)
    warp_jacobian = staticmethod(warp.warp_jacobian)


@dataclass(frozen=True, slots=True)
class PointSensor(PositionSensor):
    """g and p_D for point targets [D14].

    Parameters
    ----------
    detection_probability : probability p_D that a target is detected in a frame; D14's is 1.
    noise_variance : r, variance of each coordinate, pixels²; D14's are 0.5, 1 and 2.
    birth_speed : standard deviation of an unknown velocity's amplitude, pixels per time unit.
    size : width and height in pixels of the boxes of states, which have none of their own.
    gate_probability : part of the detections of a target that its gate holds; detections touch no
        particles beyond. 1: no gate.
    """

    detection_probability: Probability = 0.95
    noise_variance: Positive = 1.0
    birth_speed: Positive = 2.0
    size: tuple[Positive, Positive] = (20.0, 50.0)
    gate_probability: Share = GATE
    occlusion: ClassVar[bool] = False

    def _noise(self, z: F8) -> tuple[F8, F8, F8]:
        """R = r I."""
        r = np.full(z.shape[1:], self.noise_variance)
        return r, np.zeros_like(r), r

    def measure(self, detections: Detections) -> F8:
        """(2, N) centroids of the boxes."""
        return np.ascontiguousarray(to_cxcywh(detections.xyxy)[:2])

    def p_detect(self, x: F8) -> F8:
        """p_D, everywhere."""
        return np.full(x.shape[1], self.detection_probability)

    def particle_model(self, z: F8) -> SensorNumbers:
        """The numbers of g and p_D for the particle filters, and a column for each measurement."""
        return SensorNumbers(
            *position_numbers(z, self.covariance(z, z)), np.array([self.detection_probability])
        )

    def watching(self, targets: F8) -> PointSensor:
        """The sensor itself: points hide no others."""
        return self

    def noise(self, x: F8) -> F8:
        """(4, n) deviations by which components are resolved: of a centroid, and of an unknown
        velocity.
        """
        out = np.empty((4, x.shape[1]))
        out[:2] = math.sqrt(self.noise_variance)
        out[2:] = self.birth_speed / math.sqrt(2)
        return out

    def boxes(self, x: F8) -> F8:
        """(n, 4) boxes of the set size about the positions."""
        half = np.array(self.size)[:, None] / 2
        return np.concatenate([x[:2] - half, x[:2] + half]).T.copy()
