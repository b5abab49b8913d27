"""Boxes in the image: motion and sensor.

**Motion.** State x = (px, py, vx, vy, w, h): centre, velocity per time unit (a frame at 25 Hz in
M07 and M09), width and height; constant velocity of the centre, random walk of the size. One
white-noise acceleration drives position and velocity of an axis, so f is degenerate in (p, v) and
has no density in the full state space.

With ``scaled_noise`` all noises are multiples of the target's own size ("state-dependent
variances", SDV), because large objects in the image accelerate faster [M09 (11)]; without, they are
constants ("fixed variances", FV). The papers print T²/2 and T for an interval T, under which a gap
of two frames is not two steps of one. The covariance used is

    position             a² (T³/3 − min(T, T³)/12)
    position, velocity   a² T²/2
    velocity             a² T
    size                 b² T

equal to the papers' at T = 1 and, for whole T, to T of their steps. For T < 1 the subtracted term
keeps it positive semidefinite with one noise an axis, as printed.

**Sensor.** Measurement z = (px, py, w, h): centre and size of the detected box. The likelihood is
Gaussian with diagonal covariance [M07 §2, M09 §III]; its deviations follow a size (w, h), whose
name is ``scaling``:

    σ_w = max(s·w, floor)   σ_h = max(s·h, floor)   σ_px = σ_w/2   σ_py = σ_h/2

``particle``: the size of the state itself [M09 §III]; ``detection``: the size of the detection
[M07 §2]; ``fixed``: constants (M09's fair comparison, FV); ``given``: the covariance that each
detection brings. The normaliser 1/∏σ differs per particle and is kept.

p_D is a constant, as in the papers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, Literal

import numpy as np

from phdtrack.arrays import GATE, chi2_quantile
from phdtrack.errors import Checked, InputError, NonNegative, Positive, Probability, Share
from phdtrack.kernels.box import (
    DETECTION,
    FIXED,
    GIVEN,
    OBSERVED,
    PARTICLE,
    BoxDynamics,
    Noise,
    box_covariances,
    box_deviations,
    centres_and_sizes,
    moved_boxes,
    states_of_boxes,
)
from phdtrack.kernels.particle_models import BoxWalk, GivenSize, OwnSize, SensorNumbers
from phdtrack.models import warp
from phdtrack.types import F8, Detections

_SCALINGS = {"particle": PARTICLE, "detection": DETECTION, "fixed": FIXED, "given": GIVEN}
Scaling = Literal["particle", "detection", "fixed", "given"]
# Smallest variance of the linear-Gaussian view, pixels².
TINY = 1e-12
_NO_NOISE = np.zeros((0, 4, 4))


# The records for kernels are cached, because a step of ten targets takes hardly longer than making
# them.
@lru_cache(maxsize=8)
def _box_noise(scaling: Scaling, share: float, floor: float, fixed: tuple[float, float]) -> Noise:
    """`BoxNoise` for the kernels."""
    return _SCALINGS[scaling], share, floor, fixed[0] ** 2, fixed[1] ** 2


# Intervals that differ in their last digits only, as those of a steady stream, are a few.
@lru_cache(maxsize=64)
def _box_dynamics(
    dt: float, seconds: float, noises: tuple[float, float, float, bool, float, float, float]
) -> BoxDynamics:
    """`BoxMotion.dynamics`; ``noises``: its other numbers."""
    acceleration, size_noise, min_size, scaled, survival, width, height = noises
    a2 = acceleration**2
    return BoxDynamics(
        dt,
        a2 * (dt**3 / 3 - min(dt, dt**3) / 12),
        a2 * dt**2 / 2,
        a2 * dt,
        size_noise**2 * dt,
        min_size,
        scaled,
        survival**seconds,
        width,
        height,
    )


@dataclass(frozen=True, slots=True)
class BoxSensor(Checked):
    """g and p_D for boxes.

    Parameters
    ----------
    detection_probability : probability p_D that a target is detected in a frame.
    box_noise : s, deviation of the measured size as a fraction of the size.
    min_noise : smallest σ_w and σ_h, pixels; M09 has none (0).
    scaling : the size that the deviations scale with, see above.
    fixed_noise : deviations of position and of size in pixels, for ``scaling="fixed"``.
    birth_speed : standard deviation of an unknown velocity's amplitude, in box sizes √(wh) per time
        unit. No paper gives it; 0.06 is 1.5 box sizes per second at 25 Hz, a brisk walk for a
        standing person.
    birth_speed_pixels : the same in pixels per time unit, for ``scaling="fixed"``; 20 gives M09's
        initial velocity variance of 200 along each axis.
    gate_probability : part of the detections of a target that its gate holds; detections touch no
        particles beyond. 1: no gate.
    """

    detection_probability: Probability = 0.79
    box_noise: Positive = 0.14
    min_noise: NonNegative = 1.0
    scaling: Scaling = "particle"
    fixed_noise: tuple[Positive, Positive] = (3.0**0.5, 6.0**0.5)
    birth_speed: NonNegative = 0.13
    birth_speed_pixels: NonNegative = 20.0
    gate_probability: Share = GATE
    occlusion: ClassVar[bool] = False
    observed: ClassVar[tuple[int, ...]] = OBSERVED
    linear: ClassVar[bool] = True
    angles: ClassVar[tuple[bool, ...]] = (False, False, False, False)

    @property
    def _gate(self) -> float:
        """G, the gate's half-width in deviations."""
        return math.sqrt(chi2_quantile(4, self.gate_probability))

    def predicted_measurements(self, x: F8) -> F8:
        """(4, L) centre and size of the boxes."""
        return x[list(OBSERVED)]

    def innovation(self, z: F8, predicted: F8) -> F8:
        """The differences of measurements from predicted ones, row by row."""
        return z[: len(predicted)] - predicted

    def measure(self, detections: Detections) -> F8:
        """(4, N) centres and sizes; (8, N) with variances below them if the scaling is ``given``.

        The likelihood is diagonal: only the diagonal of a detection's covariance is used. Raises
        `InputError` if the scaling is ``given`` and there is no covariance, or a variance is not
        above 0.
        """
        z = np.asarray(centres_and_sizes(np.ascontiguousarray(detections.xyxy, np.float64)))
        if self.scaling != "given":
            return z
        if len(detections) == 0:
            return np.zeros((8, 0))
        if detections.covariance is None:
            raise InputError(
                "the sensor's scaling is 'given', but the detections bring no covariance",
                cure=(
                    "Use a detector that states one, or another scaling: particle, detection, fixed"
                ),
            )
        variance = np.diagonal(detections.covariance, axis1=1, axis2=2).T
        if not (variance > 0).all():
            raise InputError(
                "expected variances above 0 pixels² in the detections' covariance, got"
                f" {variance.min():g}",
                cure="Give the detector's own noise, or another scaling",
            )
        return np.vstack([z, variance])

    def _deviations(self, z: F8) -> F8:
        """(4, N) deviations of the components of z, by its own size unless they are given or
        fixed.
        """
        if self.scaling == "given":
            return np.sqrt(z[4:8])
        sides = np.maximum(self.box_noise * z[2:4], self.min_noise)
        position, size = self.fixed_noise if self.scaling == "fixed" else (sides / 2, sides)
        return np.concatenate(
            [np.broadcast_to(position, sides.shape), np.broadcast_to(size, sides.shape)]
        )

    def covariance(self, z: F8, x: F8) -> F8:
        """(P, 4, 4) diagonal noise covariance of (px, py, w, h) for pairs of columns; sizes are
        those of the mean state.
        """
        noise = self.target_noise(np.ascontiguousarray(x))
        if len(noise):
            return noise
        return self.measurement_noise(np.ascontiguousarray(z))

    def target_noise(self, x: F8) -> F8:
        """(L, 4, 4) R if it scales with the target or is constant, else (0, 4, 4)."""
        if self.scaling in ("detection", "given"):
            return _NO_NOISE
        return np.asarray(box_covariances(x[4:6], self._numbers))

    def measurement_noise(self, z: F8) -> F8:
        """(N, 4, 4) R if it scales with the detection, else (0, 4, 4)."""
        if self.scaling == "given":
            return np.maximum(z[4:8], TINY).T[:, :, None] * np.eye(4)
        if self.scaling != "detection":
            return _NO_NOISE
        return np.asarray(box_covariances(z[2:4], self._numbers))

    def p_detect(self, x: F8) -> F8:
        """p_D, everywhere."""
        p = np.empty(x.shape[1])
        p.fill(self.detection_probability)
        return p

    def particle_model(self, z: F8) -> SensorNumbers:
        """The numbers of g and p_D for the particle filters, and a column for each measurement [M07
        §2, M09 §III].
        """
        detection = np.array([self.detection_probability], np.float32)
        if self.scaling == "particle":
            # A floor of zero would let the deviation of a vanishing box vanish.
            model = OwnSize(np.float32(self.box_noise), np.float32(max(self.min_noise, 1e-3)))
            return SensorNumbers(model, np.ascontiguousarray(z[:4], np.float32), detection)
        table = np.concatenate([z[:4], 1 / self._deviations(z)]).astype(np.float32)
        return SensorNumbers(GivenSize(np.float32((2 * math.pi) ** -2)), table, detection)

    def watching(self, targets: F8) -> BoxSensor:
        """The sensor itself: in the image no target hides another."""
        return self

    def gate(self, z: F8) -> tuple[F8, F8]:
        """Rectangles in the image that contain all states with z within their gates.

        If σ scales with the state's own size w, the states within G deviations of z in position and
        in size reach max(sG/2 · w_z/√(1 − G²s²), G·floor/2) from it, for G·s < 1.
        """
        g = self._gate
        if self.scaling == "particle":
            # G·s ≥ 1 would let every larger box in: the size alone no longer bounds the distance.
            reach = g * self.box_noise / 2 / math.sqrt(max(1 - (g * self.box_noise) ** 2, 0.05))
            half = np.maximum(reach * z[2:4], g * self.min_noise / 2)
        else:
            half = g * self._deviations(z)[:2]
        return z[:2] - half, z[:2] + half

    def states(self, z: F8) -> tuple[F8, F8]:
        """States at rest that z alone implies, and their covariances.

        The velocity of uniform direction and Gaussian amplitude a has variance a²/2 per axis.
        """
        states: tuple[F8, F8] = states_of_boxes(np.ascontiguousarray(z), self._numbers, self._speed)
        return states

    @property
    def _numbers(self) -> Noise:
        """The noise for the kernels of boxes."""
        return _box_noise(self.scaling, self.box_noise, self.min_noise, self.fixed_noise)

    @property
    def _speed(self) -> float:
        """Deviation of an unknown velocity's components, in box sizes, or in pixels if the noise is
        fixed.
        """
        speed = self.birth_speed
        if self.scaling == "fixed":
            speed = self.birth_speed_pixels
        return speed / math.sqrt(2)

    @property
    def noise_of_target(self) -> bool:
        """True if R scales with the target or is constant, and so `target_noise` is not empty."""
        return self.scaling in ("particle", "fixed")

    @property
    def numbers(self) -> tuple[Noise, float, float, bool]:
        """The sensor in numbers: of `kernels.pmb_boxes.BoxWorld` those behind the factors."""
        return self._numbers, self._speed, self.detection_probability, self.noise_of_target

    def noise(self, x: F8) -> F8:
        """Deviations by which the state's components are resolved: of a measured box of this size,
        and of an unknown velocity.
        """
        return np.asarray(box_deviations(np.ascontiguousarray(x), self._numbers, self._speed))

    def boxes(self, x: F8) -> F8:
        """(n, 4) the boxes of the states."""
        half = 0.5 * x[4:6]
        out = np.empty((x.shape[1], 4))
        out[:, :2] = (x[:2] - half).T
        out[:, 2:] = (x[:2] + half).T
        return out


@dataclass(frozen=True, slots=True)
class BoxMotion(Checked):
    """f and p_S for boxes [M09 (11)].

    Parameters
    ----------
    acceleration : standard deviation of the acceleration, in widths (x) and heights (y) per time
        unit², or in pixels per time unit² without ``scaled_noise``.
    size_noise : standard deviation of the change of size, in widths and heights per √time unit, or
        in pixels.
    survival_probability : probability p_S that a target is still there after one second.
    scaled_noise : state-dependent variances (SDV); False for fixed ones (FV).
    min_size : widths and heights are reflected at this many pixels: no particle takes w ≤ 0.
    frame_size : width and height of the image in pixels; a target whose box has left it does not
        survive. (0, 0): no such border.
    roughening : deviation that is added to the acceleration of particles alone: few particles that
        move with little noise soon have one common ancestor, which may have had a wrong velocity
        [G93].
    """

    acceleration: NonNegative = 0.005
    size_noise: NonNegative = 0.11
    survival_probability: Probability = 0.997**25
    scaled_noise: bool = True
    min_size: Positive = 1.0
    frame_size: tuple[float, float] = (0.0, 0.0)
    roughening: NonNegative = 0.005
    dim: ClassVar[int] = 6

    def p_survive(self, x: F8, seconds: float) -> F8:
        """p_S^seconds inside the image, 0 if the whole box has left it."""
        half = 0.5 * x[4:6]
        size = np.array(self.frame_size)[:, None]
        inside = ((x[:2] > -half) & (x[:2] < size + half)).all(axis=0) | (size.min() <= 0)
        return np.where(inside, self.survival_probability**seconds, 0.0)

    def particle_model(self, dt: float, seconds: float) -> BoxWalk:
        """The numbers of f over ``dt`` and p_S over ``seconds`` for the particle filters [M09
        (11)].
        """
        root = math.sqrt(dt)
        width, height = self.frame_size
        deviation = math.hypot(self.acceleration, self.roughening)
        rest = 0.0
        if dt > 1:
            rest = deviation * math.sqrt((dt**3 - dt) / 12)
        framed = width > 0 and height > 0
        numbers = (
            dt,
            deviation * root,
            self.size_noise * root,
            rest,
            self.min_size,
            self.scaled_noise,
            self.survival_probability**seconds,
            width * framed,
            height * framed,
        )
        return BoxWalk(*map(np.float32, numbers))

    def transition(self, x: F8, dt: float) -> tuple[F8, F8, F8]:
        """Mean, Jacobian and noise covariance of f(·|x) over the interval ``dt`` [M09 (11)]."""
        along = self.dynamics(dt, 0.0)
        # Noises by planes, which is how the kernels that predict many states read them.
        mean, f, noise = moved_boxes(np.ascontiguousarray(x), *map(float, along[:6]), along.scaled)
        # One Jacobian for all: np.broadcast_to would take longer than the rest for a few states.
        return (
            mean,
            np.ndarray((x.shape[1], *f.shape), np.float64, f, 0, (0, *f.strides)),
            noise.transpose(2, 0, 1),
        )

    def dynamics(self, dt: float, seconds: float) -> BoxDynamics:
        """The motion over an interval of ``dt`` time units, for the kernels of boxes [M09 (11)].

        Parameters
        ----------
        dt, seconds : the interval, in the model's time unit and in seconds.
        """
        return _box_dynamics(
            float(dt),
            seconds,
            (
                self.acceleration,
                self.size_noise,
                self.min_size,
                self.scaled_noise,
                self.survival_probability,
                *self.frame_size,
            ),
        )

    warp_states = staticmethod(warp.warp_states)
    warp_jacobian = staticmethod(warp.warp_jacobian)
