"""How targets turn: nearly constant speed and turn rate, the coordinated turn of the tracking literature [V06 §IV-C].

State x = (px, py, vx, vy, ω): metres, metres per second, radians per second, anticlockwise; the time unit is the second.
With α = ωT, over an interval T

    p' = p + T [s(α) −c(α); c(α) s(α)] v,   s(α) = sin α / α,   c(α) = (1 − cos α) / α
    v' = [cos α −sin α; sin α cos α] v,   ω' = ω

which for ω → 0 is constant velocity. White noise pushes the velocity along each axis, as in `plane_motion`, and the turn
rate: variances of ω' are u² T² (``piecewise``, as printed) or u² T (``continuous``). Noise of position and velocity is
added in the plane's axes, whatever the direction of motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from phdtrack.checks import NonNegative, Probability, check
from phdtrack.kernels.particle_models import TurningWalk, walk
from phdtrack.models.plane_motion import Form, fill, push, variances
from phdtrack.models.region import EVERYWHERE, Region, check_region, inside
from phdtrack.models.spawning import NoSpawn, Spawn
from phdtrack.models.warp import no_image
from phdtrack.types import F8, ParticleBlocks, Particles

# Below this angle the series of s' is exact to rounding, and its closed form is not.
SMALL = 1e-2


@dataclass(frozen=True, slots=True)
class TurningMotion:
    """f and p_S of turning targets [V06 §IV-C].

    Parameters
    ----------
    acceleration : ``continuous``: standard deviation of the velocity's change over one second, m/s; ``piecewise``: of the
        acceleration, m/s².
    turning : u, the same of the turn rate, rad/s; ``piecewise``: of the angular acceleration, rad/s².
    survival_probability : probability p_S that a target is still there after one second.
    form : ``continuous`` or ``piecewise``, see above.
    borders : left, low, right and high border in metres; a target that has left it does not survive. All 0: no border.
    births : the spawning part β.
    """

    acceleration: NonNegative = 5.0
    turning: NonNegative = math.pi / 180
    survival_probability: Probability = 0.99
    form: Form = "continuous"
    borders: Region = EVERYWHERE
    births: Spawn = field(default_factory=NoSpawn)

    def __post_init__(self) -> None:
        check(self)
        check_region(self.borders, "TurningMotion.borders")

    @property
    def dim(self) -> int:
        """Number of state components, 5."""
        return 5

    def _turn_variance(self, dt: float) -> float:
        """Of the turn rate, over ``dt`` seconds."""
        return self.turning**2 * dt * (dt if self.form == "piecewise" else 1.0)

    def sample(self, x: F8, dt: float, rng: np.random.Generator) -> F8:
        """One draw of f(·|ξ) for each column ξ of ``x`` [V06 §IV-C]."""
        moved = turned(x, dt)
        push(moved, variances(self.acceleration, dt, self.form), rng)
        moved[4] += math.sqrt(self._turn_variance(dt)) * rng.standard_normal(x.shape[1])
        return moved

    def p_survive(self, x: F8, seconds: float) -> F8:
        """p_S^seconds inside the region, 0 outside."""
        return np.where(inside(x, self.borders), self.survival_probability**seconds, 0.0)

    def particle_model(self, dt: float, seconds: float) -> TurningWalk:
        """The numbers of f over ``dt`` and p_S over ``seconds`` for the particle filters [V06 §IV-C]."""
        noise = variances(self.acceleration, dt, self.form)
        straight = walk(dt, noise, self.survival_probability**seconds, self.borders)
        return TurningWalk(straight, math.sqrt(self._turn_variance(dt)))

    def transition(self, x: F8, dt: float) -> tuple[F8, F8, F8]:
        """Mean, Jacobian and noise covariance of f(·|x) over ``dt`` seconds [V06 §IV-C]."""
        n = x.shape[1]
        q = np.zeros((5, 5, n))
        fill(q, variances(self.acceleration, dt, self.form))
        q[4, 4] = self._turn_variance(dt)
        return turned(x, dt), slopes(x, dt), np.ascontiguousarray(q.transpose(2, 0, 1))

    def spawn(self, parents: Particles | ParticleBlocks, dt: float, rng: np.random.Generator) -> Particles:
        """Draws of the spawning term."""
        return self.births.sample(parents, dt, rng)

    def warp_states(self, x: F8, warp: F8) -> F8:
        """Raises `InputError`: the ground does not move with the image."""
        raise no_image("a target on the ground")

    def warp_jacobian(self, x: F8, warp: F8) -> F8:
        """Raises `InputError`."""
        raise no_image("a target on the ground")


def turned(x: F8, dt: float) -> F8:
    """(5, n) states ``x`` (5, n) after ``dt`` seconds on their circles, without noise [V06 §IV-C]."""
    angle = x[4] * dt
    along, across = dt * _sinc(angle), dt * _across(angle)
    cos, sin = np.cos(angle), np.sin(angle)
    vx, vy = x[2], x[3]
    return np.stack(
        [x[0] + along * vx - across * vy, x[1] + across * vx + along * vy, cos * vx - sin * vy, sin * vx + cos * vy, x[4]]
    )


def slopes(x: F8, dt: float) -> F8:
    """(n, 5, 5) Jacobians of `turned`."""
    angle = x[4] * dt
    along, across = dt * _sinc(angle), dt * _across(angle)
    cos, sin = np.cos(angle), np.sin(angle)
    # s' and c' by angle; c/α = s(α/2)²/2 needs no difference of neighbours.
    faster = dt**2 * _sinc_slope(angle)
    wider = dt**2 * (_sinc(angle) - 0.5 * _sinc(0.5 * angle) ** 2)
    vx, vy = x[2], x[3]
    f = np.zeros((5, 5, x.shape[1]))
    f[range(5), range(5)] = 1.0
    f[0, 2], f[0, 3], f[0, 4] = along, -across, faster * vx - wider * vy
    f[1, 2], f[1, 3], f[1, 4] = across, along, wider * vx + faster * vy
    f[2, 2], f[2, 3], f[2, 4] = cos, -sin, -dt * (sin * vx + cos * vy)
    f[3, 2], f[3, 3], f[3, 4] = sin, cos, dt * (cos * vx - sin * vy)
    return np.ascontiguousarray(f.transpose(2, 0, 1))


def _sinc(angle: F8) -> F8:
    """s(α) = sin α/α."""
    out: F8 = np.sinc(angle / math.pi)
    return out


def _across(angle: F8) -> F8:
    """c(α) = (1 − cos α)/α."""
    out: F8 = 0.5 * angle * _sinc(0.5 * angle) ** 2
    return out


def _sinc_slope(angle: F8) -> F8:
    """s'(α) = (cos α − s(α))/α."""
    small = np.abs(angle) < SMALL
    safe = np.where(small, 1.0, angle)
    series = angle * (-1 / 3 + angle**2 * (1 / 30 - angle**2 / 840))
    out: F8 = np.where(small, series, (np.cos(safe) - _sinc(safe)) / safe)
    return out
