"""How point targets move in the image: constant velocity, with noise on every component [D14].

State x = (px, py, vx, vy), pixels and pixels per time unit. Over T = 1 position and velocity of an axis are disturbed
independently, both with variance q:

    Q(1) = q I,        and for whole T, of T such steps,   Q(T) = q [T³/3 − T²/2 + 7T/6   (T² − T)/2]
                                                                    [(T² − T)/2            T        ]

for the position and velocity of an axis. As a polynomial in T this holds for every T > 0: it is what white noise of
density q [[7/6, −1/2], [−1/2, 1]] on position and velocity gives, positive definite, and an interval cut anywhere gives the
same as the whole.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from phdtrack.checks import NonNegative, Probability, check
from phdtrack.kernels.particle_models import Walk, walk
from phdtrack.models import warp as warp_of
from phdtrack.models.spawning import NoSpawn, Spawn
from phdtrack.types import F8, ParticleBlocks, Particles


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
