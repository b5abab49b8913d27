"""The standard nonlinear scenario of the random-finite-set literature: turning targets seen by bearing and range.

After the example with nearly constant turns in Vo and Ma, *The Gaussian mixture probability hypothesis density filter*,
IEEE Trans. Signal Processing 54 (2006), in the form with ten targets that came into use with later filters of its authors:
100 scans of 1 s, a sensor at the origin that looks at the half disc y ≥ 0 of radius 2000 m, Poisson clutter uniform in
bearing and range. State x = (px, py, vx, vy, ω) in m, m/s and rad/s, anticlockwise; measurement z = (θ, r), θ from the y
axis towards the x axis. Targets turn at constant rate and speed: the truth has no process noise, the filters' model has.

The literature runs this scene with several noises. The defaults are those that go with the ten targets (σ_w = 5 m/s²,
σ_θ = 2°, σ_r = 10 m, λ = 20); Vo and Ma's are σ_w = 15 m/s² and σ_r = 20 m, others have σ_θ = 1°, σ_r = 5 m and λ = 10. p_D
is 0.98 everywhere; some let it fall with the range, over 2000 m (`Turning.fade`). A target is at its start in its first
scan; published scripts move it by one step before. One target is up to 82 m out of the half disc for a while, and seen there
all the same.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from phdtrack.simulate.points import PointScene, check_rates, present, realised
from phdtrack.types import F8, I8

DEGREE = math.pi / 180
START = np.array(
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
FIRST = np.array([1, 10, 10, 10, 20, 40, 40, 40, 60, 60])
"""(10,) the first scan of each target."""
LAST = np.array([100, 100, 100, 66, 80, 100, 100, 80, 100, 100])
"""(10,) the last scan of each target."""


@dataclass(frozen=True, slots=True)
class Turning:
    """The model that filters are given for this scenario, and its evaluation.

    Attributes
    ----------
    scans, interval : number of scans and seconds between them.
    radius : of the half disc, metres.
    sd_acceleration : σ_w in m/s²: Q = σ_w² B Bᵀ with B = (T²/2, T) per axis.
    sd_turn : σ_u in rad/s, of the change of the turn rate over a second.
    sd_bearing, sd_range : σ_θ in radians and σ_r in metres of the measurements.
    p_survive, p_detect, clutter_rate : p_S, p_D at the sensor's place, and expected clutter points per scan.
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
        """What clutter is uniform over, radians times metres."""
        return math.pi * self.radius


def turning(rng: np.random.Generator, model: Turning | None = None) -> PointScene[Turning]:
    """One realisation of the scenario, by its defaults or the ``model``; the truth is the same in all.

    Detections, clutter and order draw from streams of their own, spawned from ``rng``: the targets' measurements do not
    depend on the clutter.

    Raises
    ------
    InputError : p_D is no probability or the clutter's rate is negative.
    """
    model = model or Turning()
    check_rates(model.p_detect, model.clutter_rate)
    spread = np.array([[model.sd_bearing], [model.sd_range]])
    corner = np.array([[-math.pi / 2], [0.0]])
    extent = np.array([[math.pi], [model.radius]])
    return realised(
        model,
        [turning_states(scan, model.interval) for scan in range(1, model.scans + 1)],
        lambda state, draws: np.stack([np.arctan2(state[0], state[1]), np.hypot(state[0], state[1])]) + draws * spread,
        lambda state: _seen(state, model),
        lambda count, clutter: corner + extent * clutter.random((2, count)),
        model.clutter_rate,
        rng,
    )


def _seen(state: F8, model: Turning) -> F8:
    """(n,) probabilities that targets are detected."""
    weaker = 0.5 * (np.hypot(state[0], state[1]) / model.fade) ** 2 if model.fade else np.zeros(state.shape[1])
    out: F8 = model.p_detect * np.exp(-weaker)
    return out


def turning_states(scan: int, interval: float = 1.0) -> tuple[F8, I8]:
    """States (5, n) and identities (n,) of the targets that are there in ``scan``, from 1: on their circles and lines."""
    there = present(scan, FIRST, LAST)
    start = START[there].T
    time = (scan - FIRST[there]) * interval
    place, velocity, rate = start[0] + 1j * start[1], start[2] + 1j * start[3], start[4]
    round_ = rate != 0
    # With the plane's points as complex numbers the velocity turns by exp(iωt), and the way is its integral.
    turn = np.exp(1j * rate * time)
    way = np.where(round_, (turn - 1) / np.where(round_, 1j * rate, 1), time)
    place, velocity = place + way * velocity, velocity * turn
    return np.stack([place.real, place.imag, velocity.real, velocity.imag, rate]), there + 1
