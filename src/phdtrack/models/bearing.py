"""Turning targets that a radar or sonar sees by bearing and range [V06 §IV-C].

**Motion.** State x = (px, py, vx, vy, ω): metres, metres per second, radians per second, anticlockwise; the time unit is the
second. Nearly constant speed and turn rate; with α = ωT, over an interval T

    p' = p + T [s(α) −c(α); c(α) s(α)] v,   s(α) = sin α / α,   c(α) = (1 − cos α) / α
    v' = [cos α −sin α; sin α cos α] v,   ω' = ω

which for ω → 0 is constant velocity. White noise pushes the velocity along each axis, as in `models.plane`, and the turn
rate: variances of ω' are u² T² (``piecewise``, as printed) or u² T (``continuous``).

**Sensor.** Measurement z = (θ, r): θ in radians, from the y axis towards the x axis, and r in metres, with independent
Gaussian noises:

    θ = atan2(px − ox, py − oy) + σ_θ n₁,    r = |p − o| + σ_r n₂

Bearings are compared the short way round. g(z|x) is a density per radian and metre, and so must be κ(z): uniform clutter
over a half disc of radius R that is uniform in bearing and range has the volume πR. The sensor is not linear: Gaussians go
through it by sigma points (`models.gaussian`).

    p_D(x) = p_D · exp(−|p − o|² / 2ℓ²)

falls with the range where a ``fade`` ℓ is given.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from phdtrack.arrays import GATE, chi2_quantile, to_cxcywh
from phdtrack.errors import NonNegative, Positive, Probability, Share, check
from phdtrack.kernels.particle_models import BearingRange, SensorNumbers, TurningWalk, walk
from phdtrack.models.births import NoSpawn, Spawn
from phdtrack.models.plane import Form, fill, push, variances
from phdtrack.models.volumes import EVERYWHERE, Region, check_region, inside
from phdtrack.models.warp import no_image
from phdtrack.types import F8, Bool, Detections, ParticleBlocks, Particles

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


TURN = 2 * math.pi


@dataclass(frozen=True, slots=True)
class BearingSensor:
    """g and p_D of bearings and ranges [V06 §IV-C].

    Parameters
    ----------
    bearing : σ_θ, standard deviation of the bearing, radians.
    reach : σ_r, standard deviation of the range, metres.
    detection_probability : p_D of a target at the sensor's place.
    fade : ℓ, metres over which p_D falls; 0: it does not.
    origin : where the sensor stands, metres.
    birth_speed : standard deviation of an unknown velocity's amplitude, m/s.
    turn : standard deviation of an unknown turn rate, rad/s.
    size : side of the square that is drawn about a position, metres.
    gate_probability : part of the detections of a target that its gate holds; detections touch no particles beyond. 1: no
        gate.
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

    @property
    def _gate(self) -> float:
        """G, the gate's half-width in deviations."""
        return math.sqrt(chi2_quantile(2, self.gate_probability))

    def __post_init__(self) -> None:
        check(self)

    @property
    def observed(self) -> tuple[int, ...]:
        """Rows of the state that a measurement shows: the position."""
        return (0, 1)

    @property
    def linear(self) -> bool:
        """It is not."""
        return False

    def measure(self, detections: Detections) -> F8:
        """(2, N) bearings and ranges of the middles of boxes on the plane, metres."""
        return self.expected(to_cxcywh(detections.xyxy))

    def expected(self, x: F8) -> F8:
        """(2, …) bearing and range of the positions, the first two rows of ``x`` [V06 §IV-C]."""
        east, north = x[0] - self.origin[0], x[1] - self.origin[1]
        return np.stack([np.arctan2(east, north), np.hypot(east, north)])

    def innovation(self, z: F8, seen: F8) -> F8:
        """Differences of bearings, from −π to π, and of ranges."""
        turn = z[0] - seen[0]
        return np.stack([turn - TURN * np.rint(turn / TURN), z[1] - seen[1]])

    def distance2(self, z: F8, x: F8) -> F8:
        """Squared deviations of the bearing and of the range, in those of the noise."""
        turn, longer = self.innovation(z, self.expected(x))
        out: F8 = (turn / self.bearing) ** 2 + (longer / self.reach) ** 2
        return out

    def log_likelihood(self, z: F8, x: F8) -> F8:
        """log g(z|x), density per radian and metre [V06 §IV-C]."""
        return -0.5 * self.distance2(z, x) - math.log(TURN * self.bearing * self.reach)

    def covariance(self, z: F8, x: F8) -> F8:
        """(P, 2, 2) noise covariance of bearing and range, the same for all."""
        return np.tile(np.diag([self.bearing**2, self.reach**2]), (z.shape[1], 1, 1))

    @property
    def angles(self) -> tuple[bool, ...]:
        """The bearing is an angle."""
        return (True, False)

    def target_noise(self, x: F8) -> F8:
        """(L, 2, 2) R."""
        return self.covariance(x, x)

    def measurement_noise(self, z: F8) -> F8:
        """(0, 2, 2): R belongs to the targets."""
        return np.zeros((0, 2, 2))

    def p_detect(self, x: F8) -> F8:
        """p_D, falling with the range where ``fade`` says so."""
        if self.fade == 0:
            return np.full(x.shape[1], self.detection_probability)
        out: F8 = self.detection_probability * np.exp(-0.5 * (self.expected(x)[1] / self.fade) ** 2)
        return out

    @property
    def occlusion(self) -> bool:
        """Targets hide no others."""
        return False

    def particle_model(self, z: F8) -> SensorNumbers:
        """The numbers of g and p_D for the particle filters, and a column for each measurement [V06 §IV-C]."""
        factor = 1 / (TURN * self.bearing * self.reach)
        x, y = self.origin
        model = BearingRange(float(x), float(y), 1 / self.bearing, 1 / self.reach, factor, 10 * self.reach)
        return SensorNumbers(model, np.ascontiguousarray(z[:2], np.float64), np.zeros(0))

    def watching(self, targets: F8) -> BearingSensor:
        """The sensor itself."""
        return self

    def gate(self, z: F8) -> tuple[F8, F8]:
        """Rectangles about the pieces of rings that reach G deviations of bearing and of range."""
        wide, deep = self._gate * self.bearing, self._gate * self.reach
        near, far = np.maximum(z[1] - deep, 0.0), np.maximum(z[1] + deep, 0.0)
        # sin θ gives x, and y = sin(θ + π/2).
        sides = [_between(z[0] + quarter, wide, near, far) for quarter in (0.0, math.pi / 2)]
        place = np.array(self.origin)[:, None]
        return place + np.stack([low for low, _ in sides]), place + np.stack([high for _, high in sides])

    def states(self, z: F8) -> tuple[F8, F8]:
        """Targets at rest that would give z, with the covariance of what z alone tells, to first order."""
        n = z.shape[1]
        x, cov = np.zeros((5, n)), np.zeros((n, 5, 5))
        x[0], x[1] = self.origin[0] + z[1] * np.sin(z[0]), self.origin[1] + z[1] * np.cos(z[0])
        cov[:, :2, :2] = self._plane_covariance(z)
        cov[:, 2, 2] = cov[:, 3, 3] = self.birth_speed**2 / 2
        cov[:, 4, 4] = self.turn**2
        return x, cov

    def _plane_covariance(self, polar: F8) -> F8:
        """(n, 2, 2) covariances of positions by the noise of bearing and range (2, n)."""
        sin, cos = np.sin(polar[0]), np.cos(polar[0])
        # At the sensor's place no bearing tells anything, and no position is better known than by its range.
        across = np.maximum(np.abs(polar[1]) * self.bearing, self.reach * self.bearing)
        root = np.stack([np.stack([across * cos, self.reach * sin]), np.stack([-across * sin, self.reach * cos])])
        out: F8 = np.einsum("abn,cbn->nac", root, root)
        return out

    def noise(self, x: F8) -> F8:
        """(5, n) deviations by which components at ``x`` are resolved: of the position there, of what is not measured."""
        out = np.empty((5, x.shape[1]))
        out[:2] = np.sqrt(np.diagonal(self._plane_covariance(self.expected(x)), axis1=1, axis2=2).T)
        out[2:4], out[4] = self.birth_speed / math.sqrt(2), self.turn
        return out

    def boxes(self, x: F8) -> F8:
        """(n, 4) squares of ``size`` about the positions, metres."""
        half = self.size / 2
        return np.concatenate([x[:2] - half, x[:2] + half]).T.copy()


def _between(angle: F8, wide: float, near: F8, far: F8) -> tuple[F8, F8]:
    """(n,) least and largest ρ sin φ over φ within ``wide`` of ``angle`` and ρ from ``near`` to ``far``."""
    first, last = angle - wide, angle + wide
    ends = np.sort(np.stack([np.sin(first), np.sin(last)]), axis=0)
    low = np.where(_holds(first, last, -math.pi / 2), -1.0, ends[0])
    high = np.where(_holds(first, last, math.pi / 2), 1.0, ends[1])
    return low * np.where(low < 0, far, near), high * np.where(high > 0, far, near)


def _holds(first: F8, last: F8, angle: float) -> Bool:
    """Whether ``angle`` lies, whole turns aside, between ``first`` and ``last``."""
    out: Bool = np.floor((last - angle) / TURN) >= np.ceil((first - angle) / TURN)
    return out
