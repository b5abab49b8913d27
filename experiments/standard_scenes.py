"""The standard scenarios of the random-finite-set literature: points with clutter, at constant
velocity and turning.

Both are after Vo and Ma, *The Gaussian mixture probability hypothesis density filter*, IEEE Trans.
Signal Processing 54 (2006). *Linear*, in the form with twelve targets: 100 scans of 1 s over
[−1000, 1000]² m, targets at constant velocity (the truth has no process noise), position
measurements with 10 m of noise, Poisson clutter uniform over the region. State x = (px, py, vx, vy)
in m and m/s, measurement z = (px, py).

*Turning*, in the form with ten targets that came into use with later filters of its authors: 100
scans of 1 s, a sensor at the origin that observes the half disc y ≥ 0 of radius 2000 m, Poisson
clutter uniform in bearing and range. State x = (px, py, vx, vy, ω) in m, m/s and rad/s,
anticlockwise; measurement z = (θ, r), θ from the y axis towards the x axis. Targets turn at
constant rate and speed: the truth has no process noise, the filters' model has. The literature has
several noises for this scene. The defaults are those of the version with ten targets (σ_w = 5 m/s²,
σ_θ = 2°, σ_r = 10 m, λ = 20); Vo and Ma's are σ_w = 15 m/s² and σ_r = 20 m, others have σ_θ = 1°,
σ_r = 5 m and λ = 10. p_D is 0.98 everywhere; some let it fall with the range, over 2000 m
(`Turning.fade`). A target is at its start in its first scan; published scripts move it by one step
before. One target is up to 82 m outside the half disc for a while, and is detected there too.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from phdtrack.errors import InputError
from phdtrack.types import F8, I8

M = TypeVar("M")
DEGREE = math.pi / 180

LINEAR_START = np.array(
    [
        *([0, 0, 0, -10], [400, -600, -10, 5], [-800, -200, 20, -5], [400, -600, -7, -4]),
        *([400, -600, -2.5, 10], [0, 0, 7.5, -5], [-800, -200, 12, 7], [-200, 800, 15, -10]),
        *([-800, -200, 3, 15], [-200, 800, -3, -15], [0, 0, -20, -15], [-200, 800, 15, -5]),
    ],
    dtype=np.float64,
)
"""(12, 4) the state of each target at its first scan."""
LINEAR_FIRST = np.array([1, 1, 1, 20, 20, 20, 40, 40, 60, 60, 80, 80])
"""(12,) the first scan of each target."""
LINEAR_LAST = np.array([70, 100, 70, 100, 100, 100, 100, 100, 100, 100, 100, 100])
"""(12,) the last scan of each target."""
TURNING_START = np.array(
    [
        [1003.8676, 1488.2543, -10, -10, 0.25 * DEGREE],
        [-255.8857, 1011.4102, 20, 3, -2 / 3 * DEGREE],
        [-1507.3806, 256.7993, 11, 10, -1 * DEGREE],
        [-1500, 250, 43, 0, 0],
        [246.1324, 738.9253, 11, 5, 0.5 * DEGREE],
        [-242.6194, 993.2007, -12, -12, 1 * DEGREE],
        [1000, 1500, 0, -10, 0.5 * DEGREE],
        [250, 750, -50, 0, -0.5 * DEGREE],
        [1000, 1500, -50, 0, -0.5 * DEGREE],
        [250, 750, -40, 25, 0.5 * DEGREE],
    ]
)
"""(10, 5) the state of each target at its first scan."""
TURNING_FIRST = np.array([1, 10, 10, 10, 20, 40, 40, 40, 60, 60])
"""(10,) the first scan of each target."""
TURNING_LAST = np.array([100, 100, 100, 66, 80, 100, 100, 80, 100, 100])
"""(10,) the last scan of each target."""


@dataclass(frozen=True, slots=True)
class LinearGaussian:
    """The model of the filters for this scenario, and its evaluation.

    Attributes
    ----------
    scans, interval : number of scans and seconds between them.
    half_width : the region is [−half_width, half_width]², metres.
    sd_acceleration : σ_v in m/s²: Q = σ_v² B Bᵀ with B = (T²/2, T) per axis.
    sd_position : σ_ε of the measurements, metres.
    p_survive, p_detect, clutter_rate : p_S, p_D and expected clutter points per scan.
    birth_weight, birth_sd : weight of each birth Gaussian, standard deviation of each of its
        components.
    ospa_cutoff, ospa_order : c in metres and p of the OSPA distance.
    """

    scans: int = 100
    interval: float = 1.0
    half_width: float = 1000.0
    sd_acceleration: float = 5.0
    sd_position: float = 10.0
    p_survive: float = 0.99
    p_detect: float = 0.98
    clutter_rate: float = 30.0
    birth_weight: float = 0.03
    birth_sd: float = 10.0
    ospa_cutoff: float = 100.0
    ospa_order: float = 1.0

    @property
    def birth_mean(self) -> F8:
        """(4, 4) means of the birth Gaussians, one a column."""
        return np.array(
            [[0.1, 400, -800, -200], [0.1, -600, -200, 800], [0, 0, 0, 0], [0, 0, 0, 0]]
        )


@dataclass(frozen=True, slots=True, eq=False)
class PointScene(Generic[M]):
    """One realisation; the entries of the tuples are the scans, starting with scan 1.

    Attributes
    ----------
    model : its settings.
    state : per scan (d, n) the true states.
    identity : per scan (n,) identities from 1, in the order of the table.
    measurement : per scan (2, N) in random order.
    source : per scan (N,) the identity of each measurement's target, 0 for clutter.
    """

    model: M
    state: tuple[F8, ...]
    identity: tuple[I8, ...]
    measurement: tuple[F8, ...]
    source: tuple[I8, ...]


def linear_gaussian(
    rng: np.random.Generator, clutter_rate: float = 30.0, p_d: float = 0.98
) -> PointScene[LinearGaussian]:
    """One realisation of the scenario; the truth is the same in all.

    Detections, clutter and order have separate random streams, spawned from ``rng``: the targets'
    measurements do not depend on ``clutter_rate``.

    Raises
    ------
    InputError : ``p_d`` is not a probability, or ``clutter_rate`` is negative.
    """
    model = LinearGaussian(p_detect=p_d, clutter_rate=clutter_rate)
    half = model.half_width
    return realised(
        model,
        [linear_states(scan, model.interval) for scan in range(1, model.scans + 1)],
        lambda state, draws: state[:2] + draws * model.sd_position,
        lambda state: np.full(state.shape[1], p_d),
        lambda count, clutter: clutter.uniform(-half, half, (2, count)),
        clutter_rate,
        rng,
    )


def realised(
    model: M,
    truth: list[tuple[F8, I8]],
    measure: Callable[[F8, F8], F8],
    p_detect: Callable[[F8], F8],
    clutter: Callable[[int, np.random.Generator], F8],
    rate: float,
    rng: np.random.Generator,
) -> PointScene[M]:
    """Scans of targets with (d, n) states and (n,) identities: their measurements among clutter.

    Parameters
    ----------
    model : the settings, kept with the scene.
    truth : per scan (d, n) states and (n,) identities.
    measure : of states (d, n) and independent standard normal draws (2, n), the measurements (2,
        n).
    p_detect : (n,) detection probabilities.
    clutter : draws a number of false measurements (2, count); ``rate`` is the expected number per
        scan.
    rng : streams for targets, clutter and order are spawned from it.

    Raises
    ------
    InputError : ``rate`` is not a rate, or a probability is invalid.
    """
    if not 0 <= rate < np.inf or not all(
        ((p := p_detect(state)) >= 0).all() and (p <= 1).all() for state, _ in truth
    ):
        raise InputError(
            "expected a probability of detection and a clutter rate of 0 or more",
            where="simulated scans",
        )
    targets_rng, clutter_rng, order_rng = rng.spawn(3)
    measurements = []
    sources = []
    for state, identity in truth:
        seen = targets_rng.random(len(identity)) < p_detect(state)
        noisy = measure(state, targets_rng.normal(size=(2, len(identity))))
        false = clutter(clutter_rng.poisson(rate), clutter_rng)
        z = np.concatenate([noisy[:, seen], false], axis=1)
        source = np.concatenate([identity[seen], np.zeros(false.shape[1], np.int64)])
        order = order_rng.permutation(len(source))
        measurements.append(np.ascontiguousarray(z[:, order]))
        sources.append(source[order])
    states, identities = zip(*truth, strict=True)
    return PointScene(model, states, identities, tuple(measurements), tuple(sources))


def linear_states(scan: int, interval: float = 1.0) -> tuple[F8, I8]:
    """States (4, n) and identities (n,) of the targets present in ``scan``, from 1."""
    there = present(scan, LINEAR_FIRST, LINEAR_LAST)
    state = LINEAR_START[there].T.copy()
    state[:2] += state[2:] * (scan - LINEAR_FIRST[there]) * interval
    return state, there + 1


def present(scan: int, first: I8, last: I8) -> I8:
    """(n,) which targets are present in ``scan``."""
    return np.flatnonzero((scan >= first) & (scan <= last))


@dataclass(frozen=True, slots=True)
class Turning:
    """The model of the filters for this scenario, and its evaluation.

    Attributes
    ----------
    scans, interval : number of scans and seconds between them.
    radius : of the half disc, metres.
    sd_acceleration : σ_w in m/s²: Q = σ_w² B Bᵀ with B = (T²/2, T) per axis.
    sd_turn : σ_u in rad/s, of the change of the turn rate over a second.
    sd_bearing, sd_range : σ_θ in radians and σ_r in metres of the measurements.
    p_survive, p_detect, clutter_rate : p_S, p_D at the sensor, and expected clutter points per
        scan.
    fade : metres over which p_D falls, as exp(−r²/2 fade²); 0: it does not.
    birth_weight : of each birth Gaussian, at `birth_mean`.
    birth_sd : standard deviations of the components of each of them.
    ospa_cutoff, ospa_order : c in metres and p of the OSPA distance.
    """

    scans: int = 100
    interval: float = 1.0
    radius: float = 2000.0
    sd_acceleration: float = 5.0
    sd_turn: float = DEGREE
    sd_bearing: float = 2 * DEGREE
    sd_range: float = 10.0
    p_survive: float = 0.99
    p_detect: float = 0.98
    clutter_rate: float = 20.0
    fade: float = 0.0
    birth_weight: tuple[float, ...] = (0.02, 0.02, 0.03, 0.03)
    birth_sd: tuple[float, ...] = (50.0, 50.0, 50.0, 50.0, 6 * DEGREE)
    ospa_cutoff: float = 100.0
    ospa_order: float = 1.0

    @property
    def birth_mean(self) -> F8:
        """(5, 4) means of the birth Gaussians, one a column."""
        place = np.array([[-1500.0, -250, 250, 1000], [250, 1000, 750, 1500]])
        return np.vstack([place, np.zeros((3, 4))])

    @property
    def clutter_volume(self) -> float:
        """The volume of the uniform clutter, radians times metres."""
        return math.pi * self.radius


def turning(rng: np.random.Generator, model: Turning | None = None) -> PointScene[Turning]:
    """One realisation of the scenario, by its defaults or the ``model``; the truth is the same in
    all.

    Detections, clutter and order have separate random streams, spawned from ``rng``: the targets'
    measurements do not depend on the clutter.

    Raises
    ------
    InputError : p_D is not a probability, or the clutter rate is negative.
    """
    model = model or Turning()
    spread = np.array([[model.sd_bearing], [model.sd_range]])
    corner = np.array([[-math.pi / 2], [0.0]])
    extent = np.array([[math.pi], [model.radius]])
    return realised(
        model,
        [turning_states(scan, model.interval) for scan in range(1, model.scans + 1)],
        lambda state, draws: (
            np.stack([np.arctan2(state[0], state[1]), np.hypot(state[0], state[1])])
            + draws * spread
        ),
        lambda state: _seen(state, model),
        lambda count, clutter: corner + extent * clutter.random((2, count)),
        model.clutter_rate,
        rng,
    )


def _seen(state: F8, model: Turning) -> F8:
    """(n,) probabilities that targets are detected."""
    weaker = (
        0.5 * (np.hypot(state[0], state[1]) / model.fade) ** 2
        if model.fade
        else np.zeros(state.shape[1])
    )
    out: F8 = model.p_detect * np.exp(-weaker)
    return out


def turning_states(scan: int, interval: float = 1.0) -> tuple[F8, I8]:
    """States (5, n) and identities (n,) of the targets present in ``scan``, from 1, on their
    circles and lines.
    """
    there = present(scan, TURNING_FIRST, TURNING_LAST)
    start = TURNING_START[there].T
    time = (scan - TURNING_FIRST[there]) * interval
    place = start[0] + 1j * start[1]
    velocity = start[2] + 1j * start[3]
    rate = start[4]
    round_ = rate != 0
    # With points of the plane as complex numbers, the velocity turns by exp(iωt), and the path is
    # its integral.
    turn = np.exp(1j * rate * time)
    way = np.where(round_, (turn - 1) / np.where(round_, 1j * rate, 1), time)
    place = place + way * velocity
    velocity = velocity * turn
    return np.stack([place.real, place.imag, velocity.real, velocity.imag, rate]), there + 1
