"""The standard linear-Gaussian scenario of the random-finite-set literature: points on a plane, with clutter.

After Vo and Ma, *The Gaussian mixture probability hypothesis density filter*, IEEE Trans. Signal Processing 54 (2006),
in the form with twelve targets: 100 scans of 1 s over [−1000, 1000]² m, targets at constant velocity (the truth has no
process noise), position measurements with 10 m of noise, Poisson clutter uniform over the region. State
x = (px, py, vx, vy) in m and m/s, measurement z = (px, py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.errors import InputError
from phdtrack.types import F8, I8

START = np.array(
    [
        [0, 0, 0, -10],
        [400, -600, -10, 5],
        [-800, -200, 20, -5],
        [400, -600, -7, -4],
        [400, -600, -2.5, 10],
        [0, 0, 7.5, -5],
        [-800, -200, 12, 7],
        [-200, 800, 15, -10],
        [-800, -200, 3, 15],
        [-200, 800, -3, -15],
        [0, 0, -20, -15],
        [-200, 800, 15, -5],
    ],
    dtype=np.float64,
)
"""(12, 4) the state of each target at its first scan."""
FIRST = np.array([1, 1, 1, 20, 20, 20, 40, 40, 60, 60, 80, 80])
"""(12,) the first scan of each target."""
LAST = np.array([70, 100, 70, 100, 100, 100, 100, 100, 100, 100, 100, 100])
"""(12,) the last scan of each target."""


@dataclass(frozen=True, slots=True)
class LinearGaussian:
    """The model that filters are given for this scenario, and its evaluation.

    Attributes
    ----------
    scans, interval : number of scans and seconds between them.
    half_width : the region is [−half_width, half_width]², metres.
    sd_acceleration : σ_v in m/s²: Q = σ_v² B Bᵀ with B = (T²/2, T) per axis.
    sd_position : σ_ε of the measurements, metres.
    p_survive, p_detect, clutter_rate : p_S, p_D and expected clutter points per scan.
    birth_weight, birth_sd : weight of each birth Gaussian, standard deviation of each of its components.
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
        return np.array([[0.1, 400, -800, -200], [0.1, -600, -200, 800], [0, 0, 0, 0], [0, 0, 0, 0]])


@dataclass(frozen=True, slots=True, eq=False)
class PointScene:
    """One realisation; the entries of the tuples are the scans, of which the first is scan 1.

    Attributes
    ----------
    model : the settings it was made with.
    state : per scan (4, n) the true states.
    identity : per scan (n,) who they are, from 1, in the order of the table.
    measurement : per scan (2, N) in random order.
    source : per scan (N,) the identity that each measurement came from, 0 for clutter.
    """

    model: LinearGaussian
    state: tuple[F8, ...]
    identity: tuple[I8, ...]
    measurement: tuple[F8, ...]
    source: tuple[I8, ...]


def linear_gaussian(rng: np.random.Generator, clutter_rate: float = 30.0, p_d: float = 0.98) -> PointScene:
    """One realisation of the scenario; the truth is the same in all.

    Detections, clutter and order draw from streams of their own, spawned from ``rng``: the targets' measurements do not
    depend on ``clutter_rate``.

    Raises
    ------
    InputError : ``p_d`` is no probability or ``clutter_rate`` is negative.
    """
    if not 0 <= p_d <= 1 or not 0 <= clutter_rate < np.inf:
        raise InputError(f"p_d = {p_d} and clutter_rate = {clutter_rate} are not a probability and a rate", cure="Mend them")
    model = LinearGaussian(p_detect=p_d, clutter_rate=clutter_rate)
    targets_rng, clutter_rng, order_rng = rng.spawn(3)
    states, identities, measurements, sources = [], [], [], []
    for scan in range(1, model.scans + 1):
        state, identity = true_states(scan, model.interval)
        seen = targets_rng.random(len(identity)) < p_d
        noisy = state[:2] + targets_rng.normal(size=(2, len(identity))) * model.sd_position
        clutter = clutter_rng.uniform(-model.half_width, model.half_width, (2, clutter_rng.poisson(clutter_rate)))
        z = np.concatenate([noisy[:, seen], clutter], axis=1)
        source = np.concatenate([identity[seen], np.zeros(clutter.shape[1], np.int64)])
        order = order_rng.permutation(len(source))
        states.append(state)
        identities.append(identity)
        measurements.append(np.ascontiguousarray(z[:, order]))
        sources.append(source[order])
    return PointScene(model, tuple(states), tuple(identities), tuple(measurements), tuple(sources))


def true_states(scan: int, interval: float = 1.0) -> tuple[F8, I8]:
    """States (4, n) and identities (n,) of the targets that are there in ``scan``, from 1."""
    there = np.flatnonzero((scan >= FIRST) & (scan <= LAST))
    state = START[there].T.copy()
    state[:2] += state[2:] * (scan - FIRST[there]) * interval
    return state, there + 1
