"""How people move on the ground: constant velocity, pushed by a white-noise acceleration.

State x = (px, py, vx, vy): metres and metres per second in the world's axes; the time unit is the second. One noise n of
deviation a drives position and velocity of an axis. Two forms of the covariance Q of an interval T [E13 §4]:

    piecewise     a² (T⁴/4, T³/2, T²): n is constant over the interval, as the papers print it
    continuous    a² (T³/3, T²/2, T): n is white, and a gap of two frames is the same as two steps of one

for position, position and velocity, velocity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from phdtrack.checks import NonNegative, Probability, check
from phdtrack.kernels.particle_models import Walk, walk
from phdtrack.models.region import EVERYWHERE, Region, check_region, inside
from phdtrack.models.spawning import NoSpawn, Spawn
from phdtrack.models.warp import no_image
from phdtrack.types import F8, ParticleBlocks, Particles

Form = Literal["piecewise", "continuous"]


@dataclass(frozen=True, slots=True)
class PlaneMotion:
    """f and p_S on the ground plane [E13 §4].

    Parameters
    ----------
    acceleration : a; ``continuous``: standard deviation of the velocity's change over one second, m/s; ``piecewise``: of the
        acceleration, m/s², E13's is 1.
    survival_probability : probability p_S that a target is still there after one second.
    form : ``continuous`` or ``piecewise``, see above.
    borders : left, low, right and high border in metres; a target that has left it does not survive. All 0: no border.
    births : the spawning part β.
    """

    acceleration: NonNegative = 7**-0.5
    survival_probability: Probability = 0.99**7
    form: Form = "continuous"
    borders: Region = EVERYWHERE
    births: Spawn = field(default_factory=NoSpawn)

    def __post_init__(self) -> None:
        check(self)
        check_region(self.borders, "PlaneMotion.borders")

    @property
    def dim(self) -> int:
        """Number of state components, 4."""
        return 4

    def sample(self, x: F8, dt: float, rng: np.random.Generator) -> F8:
        """One draw of f(·|ξ) for each column ξ of ``x`` [E13 §4]."""
        moved = x.copy()
        moved[0:2] += dt * x[2:4]
        push(moved, variances(self.acceleration, dt, self.form), rng)
        return moved

    def p_survive(self, x: F8, seconds: float) -> F8:
        """p_S^seconds inside the region, 0 outside."""
        return np.where(inside(x, self.borders), self.survival_probability**seconds, 0.0)

    def particle_model(self, dt: float, seconds: float) -> Walk:
        """The numbers of f over ``dt`` and p_S over ``seconds`` for the particle filters [E13 §4]."""
        return walk(dt, variances(self.acceleration, dt, self.form), self.survival_probability**seconds, self.borders)

    def transition(self, x: F8, dt: float) -> tuple[F8, F8, F8]:
        """Mean, Jacobian and noise covariance of f(·|x) over ``dt`` seconds [E13 §4]."""
        n = x.shape[1]
        mean = x.copy()
        mean[0:2] += dt * x[2:4]
        f, q = np.eye(4), np.zeros((4, 4, n))
        f[0, 2] = f[1, 3] = dt
        fill(q, variances(self.acceleration, dt, self.form))
        # Laid out in memory as `BoxMotion` does, for which the kernels are compiled.
        return mean, np.ndarray((n, 4, 4), np.float64, f, 0, (0, *f.strides)), q.transpose(2, 0, 1)

    def spawn(self, parents: Particles | ParticleBlocks, dt: float, rng: np.random.Generator) -> Particles:
        """Draws of the spawning term."""
        return self.births.sample(parents, dt, rng)

    def warp_states(self, x: F8, warp: F8) -> F8:
        """Raises `InputError`: the ground does not move with the image."""
        raise no_image("a target on the ground")

    def warp_jacobian(self, x: F8, warp: F8) -> F8:
        """Raises `InputError`."""
        raise no_image("a target on the ground")


def variances(acceleration: float, dt: float, form: Form) -> tuple[float, float, float]:
    """Of position, of position and velocity, of velocity of an axis, over ``dt`` seconds; see the head of this module."""
    a2 = acceleration**2
    if form == "piecewise":
        return a2 * dt**4 / 4, a2 * dt**3 / 2, a2 * dt**2
    return a2 * dt**3 / 3, a2 * dt**2 / 2, a2 * dt


def push(x: F8, of: tuple[float, float, float], rng: np.random.Generator) -> None:
    """Add a draw of the noise ``of`` positions and velocities to the first four rows of ``x``, which the caller owns."""
    place, both, speed = of
    kick = math.sqrt(speed) * rng.standard_normal((2, x.shape[1]))
    x[2:4] += kick
    if speed > 0:
        x[0:2] += both / speed * kick
        # What is left of the position's variance beside the part that the velocity's noise explains.
        rest = place - both**2 / speed
        if rest > 1e-12 * place:
            x[0:2] += math.sqrt(rest) * rng.standard_normal((2, x.shape[1]))


def fill(q: F8, of: tuple[float, float, float]) -> None:
    """Put the noise ``of`` positions and velocities into covariances ``q`` (d, d, n), which the caller owns."""
    place, both, speed = of
    for axis in range(2):
        q[axis, axis], q[axis, axis + 2], q[axis + 2, axis], q[axis + 2, axis + 2] = place, both, both, speed
