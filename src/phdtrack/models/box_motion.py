"""How boxes move in the image: constant velocity of the centre, random walk of the size.

State x = (px, py, vx, vy, w, h): centre, velocity per time unit (a frame at 25 Hz in M07 and M09), width and height. One
white-noise acceleration n drives position and velocity of an axis, so f is degenerate in (p, v): it has no density in the
full state space, and whoever needs one convolves it with the covariance of the state it is evaluated at.

With ``scaled_noise`` all noises are multiples of the target's own size ("state-dependent variances", SDV), because large
objects
in the image accelerate faster [M09 (11)]; without, they are constants ("fixed variances", FV).

Interval T: the papers print T²/2 and T, under which a gap of two frames is not two steps of one. The covariance used is

    position  a² (T³/3 − min(T, T³)/12)     position, velocity  a² T²/2     velocity  a² T      size  b² T

equal to the papers' at T = 1 and, for whole T, to T of their steps. For T < 1 the subtracted term keeps it positive
semidefinite with one noise an axis, as printed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from phdtrack.checks import NonNegative, Positive, Probability, check
from phdtrack.kernels.box_model import BoxDynamics
from phdtrack.kernels.constant_velocity import box_motion_noise
from phdtrack.kernels.particle_models import BoxWalk
from phdtrack.models import warp as warp_of
from phdtrack.models.spawning import NoSpawn, Spawn
from phdtrack.types import F8, ParticleBlocks, Particles


@dataclass(frozen=True, slots=True)
class BoxMotion:
    """f, p_S and β for boxes [M09 (11)].

    Parameters
    ----------
    acceleration : standard deviation of the acceleration, in widths (x) and heights (y) per time unit², or in pixels
        per time unit² where not ``scaled_noise``.
    size_noise : standard deviation of the change of size, in widths and heights per √time unit, or in pixels.
    survival_probability : probability p_S that a target is still there after one second.
    scaled_noise : state-dependent variances (SDV); False for fixed ones (FV).
    remember_size : carry the size before the last prediction in rows 6 and 7, for the likelihood scaling ``previous``.
    min_size : widths and heights are reflected at this many pixels: no particle takes w ≤ 0.
    frame_size : width and height of the image in pixels; a target whose box has left it does not survive. (0, 0): no such
        border.
    births : the spawning part β.
    roughening : what is added to the acceleration of draws (`sample`), and to them alone, as its deviation: few particles
        that move by little noise soon come from one ancestor, which need not have had the right velocity [G93].
    """

    acceleration: NonNegative = 0.03
    size_noise: NonNegative = 0.1
    survival_probability: Probability = 0.99**25
    scaled_noise: bool = True
    remember_size: bool = False
    min_size: Positive = 1.0
    frame_size: tuple[float, float] = (0.0, 0.0)
    births: Spawn = field(default_factory=NoSpawn)
    roughening: NonNegative = 0.0

    def __post_init__(self) -> None:
        check(self)

    @property
    def dim(self) -> int:
        """Number of state components: 6, or 8 with the remembered size."""
        return 8 if self.remember_size else 6

    @property
    def drawn(self) -> float:
        """Deviation of the acceleration that draws have: the motion's own, roughened."""
        return math.hypot(self.acceleration, self.roughening)

    def _unit(self, x: F8) -> F8:
        """(2, L) what the noises are multiples of."""
        size: F8 = np.maximum(x[4:6], self.min_size) if self.scaled_noise else np.ones((2, x.shape[1]))
        return size

    def sample(self, x: F8, dt: float, rng: np.random.Generator) -> F8:
        """One draw of f(·|ξ) for each column ξ of ``x`` [M09 (11)], roughened."""
        unit = self._unit(x)
        noise = rng.standard_normal((4, x.shape[1]))
        kick = self.drawn * np.sqrt(dt) * unit * noise[:2]
        moved = np.empty_like(x)
        moved[0:2] = x[0:2] + dt * (x[2:4] + 0.5 * kick)
        moved[2:4] = x[2:4] + kick
        moved[4:6] = x[4:6] + self.size_noise * np.sqrt(dt) * unit * noise[2:4]
        moved[4:6] = self.min_size + np.abs(moved[4:6] - self.min_size)
        if dt > 1:
            # What is left of the position's variance beside the part that the velocity's noise explains.
            rest = self.drawn * np.sqrt((dt**3 - dt) / 12)
            moved[0:2] += rest * unit * rng.standard_normal((2, x.shape[1]))
        if self.remember_size:
            moved[6:8] = x[4:6]
        return moved

    def p_survive(self, x: F8, seconds: float) -> F8:
        """p_S^seconds inside the image, 0 where the whole box has left it."""
        stays = np.full(x.shape[1], self.survival_probability**seconds)
        width, height = self.frame_size
        if width > 0 and height > 0:
            half = 0.5 * x[4:6]
            inside = (x[0] > -half[0]) & (x[0] < width + half[0]) & (x[1] > -half[1]) & (x[1] < height + half[1])
            stays[~inside] = 0.0
        return stays

    def particle_model(self, dt: float, seconds: float) -> BoxWalk:
        """The numbers of f over ``dt`` and p_S over ``seconds`` for the particle filters [M09 (11)]."""
        root, (width, height) = math.sqrt(dt), self.frame_size
        rest = self.drawn * math.sqrt((dt**3 - dt) / 12) if dt > 1 else 0.0
        framed = width > 0 and height > 0
        return BoxWalk(*(
            np.float32(value)
            for value in (
                dt, self.drawn * root, self.size_noise * root, rest, self.min_size, self.scaled_noise,
                self.survival_probability**seconds, width * framed, height * framed,
            )
        ))  # fmt: skip

    def transition(self, x: F8, dt: float) -> tuple[F8, F8, F8]:
        """Mean, Jacobian and noise covariance of f(·|x) over the interval ``dt`` [M09 (11)]."""
        d, n = x.shape
        f = np.eye(d)
        f[0, 2] = f[1, 3] = dt
        mean = x.copy()
        mean[0:2] += dt * x[2:4]
        if d == 8:
            f[6:8] = np.eye(2, 8, 4)
            mean[6:8] = x[4:6]
        # By planes, which is how whoever predicts many states goes through it.
        noise = np.zeros((d, d, n))
        box_motion_noise(mean[4:6], float(dt), self.acceleration, self.size_noise, self.min_size, self.scaled_noise, noise)
        # One Jacobian for all, as np.broadcast_to would give it in more time than the rest takes for a few states.
        return mean, np.ndarray((n, d, d), np.float64, f, 0, (0, *f.strides)), noise.transpose(2, 0, 1)

    def dynamics(self, dt: float, seconds: float) -> BoxDynamics:
        """The motion over an interval of ``dt`` time units, as the kernels of boxes take it."""
        return BoxDynamics(
            float(dt), self.acceleration, self.size_noise, self.min_size, self.scaled_noise,
            self.survival_probability**seconds, *self.frame_size,
        )  # fmt: skip

    def spawn(self, parents: Particles | ParticleBlocks, dt: float, rng: np.random.Generator) -> Particles:
        """Draws of the spawning term."""
        return self.births.sample(parents, dt, rng)

    def warp_states(self, x: F8, warp: F8) -> F8:
        """States in the pixels of the next frame: centre, velocity and sizes carried by the homography ``warp``."""
        return warp_of.warp_states(x, warp, self._sizes)

    def warp_jacobian(self, x: F8, warp: F8) -> F8:
        """(L, d, d) Jacobians of `warp_states`."""
        return warp_of.warp_jacobian(x, warp, self._sizes)

    @property
    def _sizes(self) -> tuple[int, ...]:
        """The rows that are lengths."""
        return tuple(range(4, self.dim))
