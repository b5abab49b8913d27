"""Turning targets, measured by bearing and range as by radar or sonar [V06 §IV-C].

**Motion.** State x = (px, py, vx, vy, ω): metres, metres per second, radians per second,
anticlockwise; the time unit is the second. Nearly constant speed and turn rate; with α = ωT, over
an interval T

    p' = p + T [s(α) −c(α); c(α) s(α)] v,   s(α) = sin α / α,   c(α) = (1 − cos α) / α
    v' = [cos α −sin α; sin α cos α] v,   ω' = ω

which for ω → 0 is constant velocity. White noise pushes the velocity along each axis
(`models.positions`), and the turn rate: variances of ω' are u² T² (``piecewise``, as printed) or u²
T (``continuous``).

**Sensor.** Measurement z = (θ, r): θ in radians, from the y axis towards the x axis, and r in
metres, with independent Gaussian noises:

    θ = atan2(px − ox, py − oy) + σ_θ n₁,    r = |p − o| + σ_r n₂

Bearings are compared the short way round. g(z|x) is a density per radian and metre, and so must be
κ(z): uniform clutter over a half disc of radius R that is uniform in bearing and range has the
volume πR. The sensor is not linear: Gaussians are transformed by sigma points (`models.gaussian`).

    p_D(x) = p_D · exp(−|p − o|² / 2ℓ²)

falls with the range if ``fade`` ℓ is not 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phdtrack.arrays import GATE, to_cxcywh
from phdtrack.errors import NonNegative, Positive, Probability, Share
from phdtrack.kernels.particle_models import (
    N0,
    N1,
    N2,
    N3,
    N4,
    VX,
    VY,
    Number,
    SensorNumbers,
    W,
    Walk,
    X,
    Y,
    distance,
    implements,
    move,
    neighbourhood,
    normals,
    seen,
    survives,
    walk,
)
from phdtrack.models.positions import Form, PositionMotion, PositionSensor
from phdtrack.models.volumes import EVERYWHERE, Region
from phdtrack.types import F8, Bool, Detections

Real = NDArray[np.floating[Any]]
# Below this angle the series of s' is exact to rounding, and its closed form is not.
SMALL = 1e-2


@dataclass(frozen=True, slots=True)
class TurningMotion(PositionMotion):
    """f and p_S of turning targets [V06 §IV-C].

    Parameters
    ----------
    acceleration : ``continuous``: standard deviation of the velocity's change over one second, m/s;
        ``piecewise``: of the acceleration, m/s².
    turning : u, the same of the turn rate, rad/s; ``piecewise``: of the angular acceleration,
        rad/s².
    survival_probability : probability p_S that a target is still there after one second.
    form : ``continuous`` or ``piecewise``, see `models.positions`.
    borders : left, low, right and high border in metres; a target that has left it does not
        survive. All 0: no border.
    """

    acceleration: NonNegative = 5.0
    turning: NonNegative = math.pi / 180
    survival_probability: Probability = 0.99
    form: Form = "continuous"
    borders: Region = EVERYWHERE
    dim: ClassVar[int] = 5

    def _turn_variance(self, dt: float) -> float:
        """Variance of the turn rate after ``dt`` seconds."""
        return self.turning**2 * dt * (dt if self.form == "piecewise" else 1.0)

    def particle_model(self, dt: float, seconds: float) -> TurningWalk:
        """The numbers of f over ``dt`` and p_S over ``seconds`` for the particle filters [V06
        §IV-C].
        """
        straight = walk(dt, self._variances(dt), self.survival_probability**seconds, self.borders)
        return TurningWalk(straight, math.sqrt(self._turn_variance(dt)))

    def transition(self, x: F8, dt: float) -> tuple[F8, F8, F8]:
        """Mean, Jacobian and noise covariance of f(·|x) over ``dt`` seconds [V06 §IV-C]."""
        q = self._noise_covariance(dt, x.shape[1])
        q[4, 4] = self._turn_variance(dt)
        return turned(x, dt), slopes(x, dt), np.ascontiguousarray(q.transpose(2, 0, 1))


def turned(x: F8, dt: float) -> F8:
    """(5, n) states ``x`` (5, n) after ``dt`` seconds on their circles, without noise [V06
    §IV-C].
    """
    angle = x[4] * dt
    along = dt * _sinc(angle)
    across = dt * _across(angle)
    cos = np.cos(angle)
    sin = np.sin(angle)
    vx = x[2]
    vy = x[3]
    return np.stack(
        [
            x[0] + along * vx - across * vy,
            x[1] + across * vx + along * vy,
            cos * vx - sin * vy,
            sin * vx + cos * vy,
            x[4],
        ]
    )


def slopes(x: F8, dt: float) -> F8:
    """(n, 5, 5) Jacobians of `turned`."""
    angle = x[4] * dt
    along = dt * _sinc(angle)
    across = dt * _across(angle)
    cos = np.cos(angle)
    sin = np.sin(angle)
    # s' and c' by angle; c/α = s(α/2)²/2 needs no difference of neighbours.
    faster = dt**2 * _sinc_slope(angle)
    wider = dt**2 * (_sinc(angle) - 0.5 * _sinc(0.5 * angle) ** 2)
    vx = x[2]
    vy = x[3]
    f = np.zeros((5, 5, x.shape[1]))
    f[range(5), range(5)] = 1.0
    f[0, 2] = along
    f[0, 3] = -across
    f[0, 4] = faster * vx - wider * vy
    f[1, 2] = across
    f[1, 3] = along
    f[1, 4] = wider * vx + faster * vy
    f[2, 2] = cos
    f[2, 3] = -sin
    f[2, 4] = -dt * (sin * vx + cos * vy)
    f[3, 2] = sin
    f[3, 3] = cos
    f[3, 4] = dt * (cos * vx - sin * vy)
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


WHOLE_TURN = 2 * math.pi


@dataclass(frozen=True, slots=True)
class BearingSensor(PositionSensor):
    """g and p_D of bearings and ranges [V06 §IV-C].

    Parameters
    ----------
    bearing : σ_θ, standard deviation of the bearing, radians.
    reach : σ_r, standard deviation of the range, metres.
    detection_probability : p_D of a target at the sensor.
    fade : ℓ, metres over which p_D falls; 0: it does not.
    origin : position of the sensor, metres.
    birth_speed : standard deviation of an unknown velocity's amplitude, m/s.
    turn : standard deviation of an unknown turn rate, rad/s.
    size : side of the square drawn around a position, metres.
    gate_probability : share of the detections of a target inside its gate; particles beyond it are
        not updated. 1: no gate.
    """

    bearing: Positive = math.pi / 90
    reach: Positive = 10.0
    detection_probability: Probability = 0.98
    fade: NonNegative = 0.0
    origin: tuple[float, float] = (0.0, 0.0)
    birth_speed: Positive = 50 * 2**0.5
    turn: Positive = math.pi / 30
    size: Positive = 10.0
    gate_probability: Share = GATE
    linear: ClassVar[bool] = False
    angles: ClassVar[tuple[bool, ...]] = (True, False)
    occlusion: ClassVar[bool] = False

    def measure(self, detections: Detections) -> F8:
        """(2, N) bearings and ranges of the middles of boxes on the plane, metres."""
        return self.predicted_measurements(to_cxcywh(detections.xyxy))

    def predicted_measurements(self, x: F8) -> F8:
        """(2, …) bearing and range of the positions, the first two rows of ``x`` [V06 §IV-C]."""
        east = x[0] - self.origin[0]
        north = x[1] - self.origin[1]
        return np.stack([np.arctan2(east, north), np.hypot(east, north)])

    def innovation(self, z: F8, predicted: F8) -> F8:
        """Differences of bearings, from −π to π, and of ranges."""
        turn = z[0] - predicted[0]
        return np.stack([turn - WHOLE_TURN * np.rint(turn / WHOLE_TURN), z[1] - predicted[1]])

    def _noise(self, z: F8) -> tuple[F8, F8, F8]:
        """The variances of bearing and range."""
        turn = np.full(z.shape[1:], self.bearing**2)
        longer = np.full(z.shape[1:], self.reach**2)
        return turn, np.zeros_like(turn), longer

    def p_detect(self, x: F8) -> F8:
        """p_D, falling with the range if ``fade`` is not 0."""
        if self.fade == 0:
            return np.full(x.shape[1], self.detection_probability)
        out: F8 = self.detection_probability * np.exp(
            -0.5 * (self.predicted_measurements(x)[1] / self.fade) ** 2
        )
        return out

    def particle_model(self, z: F8) -> SensorNumbers:
        """The numbers of g and p_D for the particle filters, and a column for each measurement [V06
        §IV-C].
        """
        factor = 1 / (WHOLE_TURN * self.bearing * self.reach)
        x, y = self.origin
        model = BearingRange(
            float(x), float(y), 1 / self.bearing, 1 / self.reach, factor, 10 * self.reach
        )
        return SensorNumbers(model, np.ascontiguousarray(z[:2], np.float64), np.zeros(0))

    def watching(self, targets: F8) -> BearingSensor:
        """The sensor itself."""
        return self

    def gate(self, z: F8) -> tuple[F8, F8]:
        """Rectangles around the ring segments within G deviations of bearing and range."""
        wide = self._gate * self.bearing
        deep = self._gate * self.reach
        near = np.maximum(z[1] - deep, 0.0)
        far = np.maximum(z[1] + deep, 0.0)
        # sin θ gives x, and y = sin(θ + π/2).
        sides = [_between(z[0] + quarter, wide, near, far) for quarter in (0.0, math.pi / 2)]
        place = np.array(self.origin)[:, None]
        return place + np.stack([low for low, _ in sides]), place + np.stack(
            [high for _, high in sides]
        )

    def states(self, z: F8) -> tuple[F8, F8]:
        """Targets at rest that would give z, with the covariance if z is all that is known, to
        first order.
        """
        n = z.shape[1]
        x = np.zeros((5, n))
        cov = np.zeros((n, 5, 5))
        x[0] = self.origin[0] + z[1] * np.sin(z[0])
        x[1] = self.origin[1] + z[1] * np.cos(z[0])
        cov[:, :2, :2] = self._plane_covariance(z)
        cov[:, 2, 2] = cov[:, 3, 3] = self.birth_speed**2 / 2
        cov[:, 4, 4] = self.turn**2
        return x, cov

    def _plane_covariance(self, polar: F8) -> F8:
        """(n, 2, 2) covariances of positions by the noise of bearing and range (2, n)."""
        sin = np.sin(polar[0])
        cos = np.cos(polar[0])
        # At the sensor the bearing carries no information, and no position is better known than by
        # its range.
        across = np.maximum(np.abs(polar[1]) * self.bearing, self.reach * self.bearing)
        root = np.stack(
            [
                np.stack([across * cos, self.reach * sin]),
                np.stack([-across * sin, self.reach * cos]),
            ]
        )
        out: F8 = np.einsum("abn,cbn->nac", root, root)
        return out

    def noise(self, x: F8) -> F8:
        """(5, n) deviations by which components at ``x`` are resolved: of the measured position,
        and of unmeasured components.
        """
        out = np.empty((5, x.shape[1]))
        out[:2] = np.sqrt(
            np.diagonal(self._plane_covariance(self.predicted_measurements(x)), axis1=1, axis2=2).T
        )
        out[2:4] = self.birth_speed / math.sqrt(2)
        out[4] = self.turn
        return out

    def boxes(self, x: F8) -> F8:
        """(n, 4) squares of ``size`` about the positions, metres."""
        half = self.size / 2
        return np.concatenate([x[:2] - half, x[:2] + half]).T.copy()


def _between(angle: F8, wide: float, near: F8, far: F8) -> tuple[F8, F8]:
    """(n,) least and largest ρ sin φ over φ within ``wide`` of ``angle`` and ρ from ``near`` to
    ``far``.
    """
    first = angle - wide
    last = angle + wide
    ends = np.sort(np.stack([np.sin(first), np.sin(last)]), axis=0)
    low = np.where(_holds(first, last, -math.pi / 2), -1.0, ends[0])
    high = np.where(_holds(first, last, math.pi / 2), 1.0, ends[1])
    return low * np.where(low < 0, far, near), high * np.where(high > 0, far, near)


def _holds(first: F8, last: F8, angle: float) -> Bool:
    """True if ``angle`` lies between ``first`` and ``last``, modulo whole turns."""
    out: Bool = np.floor((last - angle) / WHOLE_TURN) >= np.ceil((first - angle) / WHOLE_TURN)
    return out


# The functions that particle filters need of the two models (`phdtrack.kernels.particle_models`).


class TurningWalk(NamedTuple):
    """A random walk on circles: the turn rate in row 4 changes by ``turn``·n [V06 §IV-C]."""

    walk: Walk
    turn: float


class BearingRange(NamedTuple):
    """`BearingSensor`: position of the sensor, inverse deviations, the density's factor, extent of
    a block.
    """

    x: float
    y: float
    per_bearing: float
    per_range: float
    factor: float
    reach: float


@implements(normals, TurningWalk)
def _eight(model: Number) -> int:
    return 8


@implements(survives, TurningWalk)
def _survives_turning(model: Number, s: Real, i: int) -> Number:
    return survives(model.walk, s, i)


@implements(move, TurningWalk)
def _move_turning(model: Number, s: Real, i: int) -> None:
    straight = model.walk
    angle = s[W + i] * straight.dt
    vx = s[VX + i]
    vy = s[VY + i]
    half = 0.5 * angle
    along = math.sin(angle) / angle if abs(angle) > 1e-8 else 1.0
    across = math.sin(half) * math.sin(half) / half if abs(half) > 1e-8 else 0.0
    cos = math.cos(angle)
    sin = math.sin(angle)
    nx = s[N0 + i]
    ny = s[N1 + i]
    s[X + i] += (
        straight.dt * (along * vx - across * vy) + straight.coupled * nx + straight.rest * s[N2 + i]
    )
    s[Y + i] += (
        straight.dt * (across * vx + along * vy) + straight.coupled * ny + straight.rest * s[N3 + i]
    )
    s[VX + i] = cos * vx - sin * vy + straight.kick * nx
    s[VY + i] = sin * vx + cos * vy + straight.kick * ny
    s[W + i] += model.turn * s[N4 + i]


@implements(seen, BearingRange)
def _seen_bearing(model: Number, table: Real, j: int) -> Number:
    return table[0, j], table[1, j]


@implements(distance, BearingRange)
def _distance_bearing(model: Number, z: Number, s: Real, i: int) -> Number:
    east = s[X + i] - model.x
    north = s[Y + i] - model.y
    turn = z[0] - math.atan2(east, north)
    turn = (turn - 2.0 * math.pi * np.rint(turn / (2.0 * math.pi))) * model.per_bearing
    longer = (z[1] - math.sqrt(east * east + north * north)) * model.per_range
    return turn * turn + longer * longer, model.factor


@implements(neighbourhood, BearingRange)
def _neighbourhood_bearing(model: Number, s: Real, i: int) -> Number:
    return model.reach, model.reach
