"""Points in the image: how they move, and what a detector shows of them [D14].

**Motion.** State x = (px, py, vx, vy), pixels and pixels per time unit. Over T = 1 position and velocity of an axis are
disturbed independently, both with variance q:

    Q(1) = q I,        and for whole T, of T such steps,   Q(T) = q [T³/3 − T²/2 + 7T/6   (T² − T)/2]
                                                                    [(T² − T)/2            T        ]

for the position and velocity of an axis. As a polynomial in T this holds for every T > 0: it is what white noise of
density q [[7/6, −1/2], [−1/2, 1]] on position and velocity gives, and an interval cut anywhere gives the same as the whole.

**Sensor.** Measurement z = (px, py), the centroid of a box, g(z|x) = N(z; (px, py), r I), r in pixels². (D14 prints
z = (px, py, 1, 1), which would observe a constant velocity of 1; it is not meant.) A source of detections may put more rows
into z, such as the label of the target that a detection is known to come from: they are not compared.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from phdtrack.arrays import GATE, chi2_quantile, to_cxcywh
from phdtrack.errors import InputError, NonNegative, Positive, Probability, Share, check
from phdtrack.kernels.particle_models import SensorNumbers, Walk, position_numbers, walk
from phdtrack.models import warp as warp_of
from phdtrack.models.births import NoSpawn, Spawn
from phdtrack.types import F8, Detections, ParticleBlocks, Particles


@dataclass(frozen=True, slots=True)
class PointMotion:
    """f and p_S for point targets [D14].

    Parameters
    ----------
    noise_variance : q, of each component's noise over one time unit, pixels²; D14's is 2.
    survival_probability : probability p_S that a target is still there after one second; D14's is 1.
    births : the spawning part β.
    """

    noise_variance: NonNegative = 2.0
    survival_probability: Probability = 0.99**25
    births: Spawn = field(default_factory=NoSpawn)

    def __post_init__(self) -> None:
        check(self)

    @property
    def dim(self) -> int:
        """Number of state components, 4."""
        return 4

    def _variances(self, dt: float) -> tuple[float, float, float]:
        """Of position, of position and velocity, of velocity, over ``dt`` time units."""
        place = dt**3 / 3 - dt**2 / 2 + 7 * dt / 6
        return self.noise_variance * place, self.noise_variance * (dt**2 - dt) / 2, self.noise_variance * dt

    def sample(self, x: F8, dt: float, rng: np.random.Generator) -> F8:
        """One draw of f(·|ξ) for each column ξ of ``x`` [D14]."""
        place, both, speed = self._variances(dt)
        noise = rng.standard_normal((4, x.shape[1]))
        moved = x.copy()
        moved[0:2] += dt * x[2:4]
        if speed > 0:
            # What is left of the position's variance beside the part that the velocity's noise explains.
            moved[0:2] += both / math.sqrt(speed) * noise[2:4] + math.sqrt(place - both**2 / speed) * noise[0:2]
            moved[2:4] += math.sqrt(speed) * noise[2:4]
        return moved

    def p_survive(self, x: F8, seconds: float) -> F8:
        """p_S^seconds, everywhere."""
        return np.full(x.shape[1], self.survival_probability**seconds)

    def particle_model(self, dt: float, seconds: float) -> Walk:
        """The numbers of f over ``dt`` and p_S over ``seconds`` for the particle filters [D14]."""
        return walk(dt, self._variances(dt), self.survival_probability**seconds, (0, 0, 0, 0))

    def transition(self, x: F8, dt: float) -> tuple[F8, F8, F8]:
        """Mean, Jacobian and noise covariance of f(·|x) over ``dt`` time units [D14]."""
        n = x.shape[1]
        mean = x.copy()
        mean[0:2] += dt * x[2:4]
        f, q = np.eye(4), np.zeros((4, 4, n))
        f[0, 2] = f[1, 3] = dt
        place, both, speed = self._variances(dt)
        for axis in range(2):
            q[axis, axis], q[axis, axis + 2], q[axis + 2, axis], q[axis + 2, axis + 2] = place, both, both, speed
        # Laid out in memory as `BoxMotion` does, for which the kernels are compiled.
        return mean, np.ndarray((n, 4, 4), np.float64, f, 0, (0, *f.strides)), q.transpose(2, 0, 1)

    def spawn(self, parents: Particles | ParticleBlocks, dt: float, rng: np.random.Generator) -> Particles:
        """Draws of the spawning term."""
        return self.births.sample(parents, dt, rng)

    def warp_states(self, x: F8, warp: F8) -> F8:
        """States in the pixels of the next frame, to which the homography ``warp`` leads."""
        return warp_of.warp_states(x, warp)

    def warp_jacobian(self, x: F8, warp: F8) -> F8:
        """(L, 4, 4) Jacobians of `warp_states`."""
        return warp_of.warp_jacobian(x, warp)


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
        """Points hide no others."""
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
