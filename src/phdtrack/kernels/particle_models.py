"""Models of particle filters: small compiled functions of one particle, chosen by the type of the
model's record.

A motion and a sensor provide a record of their numbers (`BoxWalk`, `OwnSize`, …). The functions
`move`, `survives`, `sees_velocity`, `prepare`, `seen`, `distance` and `neighbourhood` have one
implementation for each type of record. The sweeps (`kernels.particles`) call them, and Numba
compiles the sweeps for each type. To add a model, write a record and register its functions with
`implements`.

Particles lie in a scratch array: row r of particle i is ``s[r * BLOCK + i]``. Rows 0 to 7 are the
state, rows 8 to 15 hold standard normal numbers while particles are moved.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache, wraps
from typing import Any, NamedTuple

import numba
import numpy as np
from numba.extending import overload

from phdtrack.kernels import F8, Real
from phdtrack.kernels.cache import without_compilation
from phdtrack.kernels.fast32 import FAST, HALF, ONE, by_type

Number = Any
F = np.float32
# Particles of a block.
BLOCK = 256
X, Y, VX, VY, W, H = (BLOCK * row for row in range(6))
N0, N1, N2, N3, N4, N5 = (BLOCK * row for row in range(8, 14))
ZERO = F(0.0)
FOUR = F(4.0)
_COMPILE = {
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
    "no_cpython_wrapper": True,
    "fastmath": FAST,
}

_FORMS: dict[str, dict[type, Callable[..., Any]]] = {}


def implements(
    function: Callable[..., Any], *models: type
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """A decorator that registers an implementation of ``function`` for these types of records."""

    def register(form: Callable[..., Any]) -> Callable[..., Any]:
        _FORMS[function.__name__].update(dict.fromkeys(models, form))
        return form

    return register


def kernel_for(kernel: Callable[..., Any], model: Any) -> Callable[..., Any]:
    """The kernel that is called with this record: compiled anew in each process if the record's
    class is not of this package. If it were kept on disk, no program without that class could
    read what is kept.
    """
    if without_compilation() or type(model).__module__.startswith("phdtrack."):
        return kernel
    return _not_kept(kernel)


@cache
def _not_kept(kernel: Any) -> Callable[..., Any]:
    """The kernel with the same options, not kept on disk."""
    compiled: Callable[..., Any] = numba.jit(**kernel.targetoptions)(kernel.py_func)
    return compiled


def _by_record(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that calls the implementation for the type of its first argument, or for any
    object, compiled or not.
    """
    forms = _FORMS.setdefault(function.__name__, {})

    @wraps(function)
    def chosen(*args: Any) -> Any:
        return (forms.get(type(args[0])) or forms[object])(*args)

    @wraps(function)
    def typed(*args: Any) -> Callable[..., Any] | None:
        return forms.get(getattr(args[0], "instance_class", type(None))) or forms.get(object)

    overload(chosen, jit_options=_COMPILE)(typed)
    return chosen


@_by_record
def normals(model: Number) -> Number:
    """The number of standard normal numbers that `move` needs, 4 or 8."""


@_by_record
def survives(model: Number, s: Real, i: int) -> Number:
    """p_S of particle i, before it is moved."""


@_by_record
def move(model: Number, s: Real, i: int) -> Number:
    """Replace the state of particle i by a draw from f(·|x), with the normal numbers in rows N0,
    N1, …
    """


@_by_record
def sees_velocity(model: Number) -> Number:
    """True if `prepare` and `distance` read rows 2 and 3 of the state; only then are these
    loaded.
    """


@_by_record
def prepare(model: Number, s: Real, i: int) -> Number:
    """Write terms of `distance` that are the same for all measurements into rows N0, N1, … of
    particle i.
    """


@_by_record
def seen(model: Number, table: Real, j: int) -> Number:
    """A tuple of the numbers of measurement j that `distance` reads; ``table`` has a column for
    each measurement.
    """


@_by_record
def distance(model: Number, z: Number, s: Real, i: int) -> Number:
    """d² and c of particle i and the measurement ``z`` from `seen`: g(z|x) = c·exp(−d²/2)."""


@_by_record
def neighbourhood(model: Number, s: Real, i: int) -> Number:
    """Width and height of the neighbourhood of particle i that belongs into one block."""


def _word_single(x: Number) -> Number:
    """The 32 bits that `number` stored in a number of the scratch array."""
    return F(x).view(np.uint32)


def _word_double(x: Number) -> Number:
    return np.uint32(x)


def _number_single(bits: Number, like: Number) -> Number:
    """A number of the type of ``like`` that holds these 32 bits."""
    return np.uint32(bits).view(np.float32)


def _number_double(bits: Number, like: Number) -> Number:
    return np.float64(bits)


word = by_type(_word_single, _word_double)
number = by_type(_number_single, _number_double)


class SensorNumbers(NamedTuple):
    """The numbers of a sensor for one frame.

    ``model``: its record; ``table`` (k, N): the measurements' columns for `seen`; ``detection``:
    p_D (1,), or (0,) if it depends on the state: then `Sensor.p_detect` gives it.
    """

    model: Number
    table: Real
    detection: Real


def precision(model: Number) -> np.dtype[np.floating[Any]]:
    """The type of numbers in which particles of a model are kept: single precision for boxes."""
    single = isinstance(model, BoxWalk | OwnSize | GivenSize)
    return np.dtype(np.float32 if single else np.float64)


class BoxWalk(NamedTuple):
    """`models.BoxMotion` over one interval [M09 (11)].

    ``dt``, ``kick`` (deviation of the velocity's change), ``resize`` (of the sizes), ``rest`` (of
    the position beside what the velocity explains, for dt > 1), ``min_size``, ``scaled`` (1: noises
    are multiples of the size), ``survival``, and the frame's ``width`` and ``height`` (0: no
    border).
    """

    dt: np.float32
    kick: np.float32
    resize: np.float32
    rest: np.float32
    min_size: np.float32
    scaled: np.float32
    survival: np.float32
    width: np.float32
    height: np.float32


class Walk(NamedTuple):
    """Constant velocity with white noise, of points in an image or on a plane [D14, E13 §4].

    The velocity of an axis changes by ``kick``·n, the position by ``dt``·v + ``coupled``·n +
    ``rest``·n'. ``survival`` inside the borders ``left``, ``low``, ``right``, ``high``, outside 0.
    """

    dt: float
    kick: float
    coupled: float
    rest: float
    survival: float
    left: float
    low: float
    right: float
    high: float


class OwnSize(NamedTuple):
    """`models.BoxSensor` whose deviations follow the particle's size."""

    noise: np.float32
    min_noise: np.float32


class GivenSize(NamedTuple):
    """`models.BoxSensor` whose deviations are the measurement's: rows 4 to 7 of the table are one
    over them.
    """

    norm: np.float32


class PlanePoint(NamedTuple):
    """A measured position; rows 2 to 4 of the table are R⁻¹ as xx, xy, yy, row 5 the factor of the
    density.

    ``reach`` is the extent of a block.
    """

    reach: float


def walk(
    dt: float,
    noise: tuple[float, float, float],
    survival: float,
    borders: tuple[float, float, float, float],
) -> Walk:
    """Constant velocity with variances ``noise`` of position, of both, and of velocity along an
    axis; borders of all 0 are none.
    """
    place, both, speed = noise
    kick = math.sqrt(speed)
    coupled = both / kick if kick > 0 else 0.0
    edges = (-math.inf, -math.inf, math.inf, math.inf) if borders == (0, 0, 0, 0) else borders
    left, low, right, high = (float(edge) for edge in edges)
    return Walk(
        float(dt),
        kick,
        coupled,
        math.sqrt(max(place - coupled**2, 0.0)),
        float(survival),
        left,
        low,
        right,
        high,
    )


def position_numbers(z: F8, covariance: F8) -> tuple[PlanePoint, F8]:
    """Measured positions (2, N) with their covariances (N, 2, 2), as `PlanePoint` reads them."""
    inverse = np.linalg.inv(covariance)
    factor = np.sqrt(np.linalg.det(inverse)) / (2 * math.pi)
    # Ten deviations contain the particles of one target, and few others.
    reach = 1.0
    if z.shape[1]:
        reach = 10 * math.sqrt(float(np.trace(covariance, axis1=1, axis2=2).mean()) / 2)
    return PlanePoint(reach), np.stack(
        [z[0], z[1], inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 1], factor]
    )


@implements(normals, BoxWalk)
def _normals_box(model: Number) -> int:
    return 8 if model.rest > ZERO else 4


@implements(normals, Walk)
def _four(model: Number) -> int:
    return 4


@implements(survives, BoxWalk)
def _survives_box(model: Number, s: Real, i: int) -> Number:
    x = s[X + i]
    y = s[Y + i]
    w = HALF * s[W + i]
    h = HALF * s[H + i]
    inside = (x > -w) & (x < model.width + w) & (y > -h) & (y < model.height + h)
    if inside | (model.width <= ZERO):
        return model.survival
    return ZERO


@implements(move, BoxWalk)
def _move_box(model: Number, s: Real, i: int) -> None:
    smallest = model.min_size
    w = s[W + i]
    h = s[H + i]
    unit_x = ONE + model.scaled * (max(smallest, w) - ONE)
    unit_y = ONE + model.scaled * (max(smallest, h) - ONE)
    push_x = model.kick * unit_x * s[N0 + i]
    push_y = model.kick * unit_y * s[N1 + i]
    vx = s[VX + i]
    vy = s[VY + i]
    s[X + i] += model.dt * (vx + HALF * push_x) + model.rest * unit_x * s[N4 + i]
    s[Y + i] += model.dt * (vy + HALF * push_y) + model.rest * unit_y * s[N5 + i]
    s[VX + i] = vx + push_x
    s[VY + i] = vy + push_y
    s[W + i] = smallest + abs(w + model.resize * unit_x * s[N2 + i] - smallest)
    s[H + i] = smallest + abs(h + model.resize * unit_y * s[N3 + i] - smallest)


@implements(survives, Walk)
def _survives_plane(model: Number, s: Real, i: int) -> Number:
    x = s[X + i]
    y = s[Y + i]
    inside = (x >= model.left) & (x <= model.right) & (y >= model.low) & (y <= model.high)
    return model.survival if inside else 0.0


@implements(move, Walk)
def _move_plane(model: Number, s: Real, i: int) -> None:
    nx = s[N0 + i]
    ny = s[N1 + i]
    vx = s[VX + i]
    vy = s[VY + i]
    s[X + i] += model.dt * vx + model.coupled * nx + model.rest * s[N2 + i]
    s[Y + i] += model.dt * vy + model.coupled * ny + model.rest * s[N3 + i]
    s[VX + i] = vx + model.kick * nx
    s[VY + i] = vy + model.kick * ny


@implements(seen, OwnSize)
def _seen_box(model: Number, table: Real, j: int) -> Number:
    return table[0, j], table[1, j], table[2, j], table[3, j]


@implements(prepare, OwnSize)
def _prepare_own(model: Number, s: Real, i: int) -> None:
    # One over the deviations of a box of this size, and the density's factor.
    sw = model.noise * s[W + i]
    sh = model.noise * s[H + i]
    iw = ONE / max(model.min_noise, sw)
    ih = ONE / max(model.min_noise, sh)
    s[N0 + i] = iw
    s[N1 + i] = ih
    s[N2 + i] = NORM * (iw * ih) * (iw * ih)


@implements(distance, OwnSize)
def _distance_box(model: Number, z: Number, s: Real, i: int) -> Number:
    iw = s[N0 + i]
    ih = s[N1 + i]
    dx = (z[0] - s[X + i]) * iw
    dy = (z[1] - s[Y + i]) * ih
    dw = (z[2] - s[W + i]) * iw
    dh = (z[3] - s[H + i]) * ih
    return FOUR * (dx * dx + dy * dy) + (dw * dw + dh * dh), s[N2 + i]


@implements(sees_velocity, object)
def _always(model: Number) -> bool:
    return True


@implements(sees_velocity, OwnSize, GivenSize, PlanePoint)
def _never(model: Number) -> bool:
    return False


@implements(prepare, object)
def _prepare_nothing(model: Number, s: Real, i: int) -> None:
    pass


# (2π)⁻² times 4, because σ_px σ_py = σ_w σ_h / 4.
NORM = F(4.0 / (2.0 * np.pi) ** 2)


@implements(seen, GivenSize)
def _seen_given(model: Number, table: Real, j: int) -> Number:
    ix = table[4, j]
    iy = table[5, j]
    iw = table[6, j]
    ih = table[7, j]
    return (
        table[0, j],
        table[1, j],
        table[2, j],
        table[3, j],
        ix,
        iy,
        iw,
        ih,
        model.norm * (ix * iy) * (iw * ih),
    )


@implements(distance, GivenSize)
def _distance_given(model: Number, z: Number, s: Real, i: int) -> Number:
    dx = (z[0] - s[X + i]) * z[4]
    dy = (z[1] - s[Y + i]) * z[5]
    dw = (z[2] - s[W + i]) * z[6]
    dh = (z[3] - s[H + i]) * z[7]
    return (dx * dx + dy * dy) + (dw * dw + dh * dh), z[8]


@implements(neighbourhood, OwnSize, GivenSize)
def _neighbourhood_box(model: Number, s: Real, i: int) -> Number:
    return s[W + i], s[H + i]


@implements(seen, PlanePoint)
def _seen_point(model: Number, table: Real, j: int) -> Number:
    return table[0, j], table[1, j], table[2, j], table[3, j], table[4, j], table[5, j]


@implements(distance, PlanePoint)
def _distance_point(model: Number, z: Number, s: Real, i: int) -> Number:
    dx = z[0] - s[X + i]
    dy = z[1] - s[Y + i]
    return z[2] * dx * dx + 2.0 * z[3] * dx * dy + z[4] * dy * dy, z[5]


@implements(neighbourhood, PlanePoint)
def _neighbourhood_plane(model: Number, s: Real, i: int) -> Number:
    return model.reach, model.reach
