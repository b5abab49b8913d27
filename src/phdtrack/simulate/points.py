"""The standard linear-Gaussian scenario of the random-finite-set literature: points on a plane, with clutter.

After Vo and Ma, *The Gaussian mixture probability hypothesis density filter*, IEEE Trans. Signal Processing 54 (2006),
in the form with twelve targets: 100 scans of 1 s over [−1000, 1000]² m, targets at constant velocity (the truth has no
process noise), position measurements with 10 m of noise, Poisson clutter uniform over the region. State
x = (px, py, vx, vy) in m and m/s, measurement z = (px, py).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from phdtrack.errors import InputError
from phdtrack.types import F8, I8

M = TypeVar("M")

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
class PointScene(Generic[M]):
    """One realisation; the entries of the tuples are the scans, of which the first is scan 1.

    Attributes
    ----------
    model : the settings it was made with.
    state : per scan (d, n) the true states.
    identity : per scan (n,) who they are, from 1, in the order of the table.
    measurement : per scan (2, N) in random order.
    source : per scan (N,) the identity that each measurement came from, 0 for clutter.
    """

    model: M
    state: tuple[F8, ...]
    identity: tuple[I8, ...]
    measurement: tuple[F8, ...]
    source: tuple[I8, ...]


def linear_gaussian(rng: np.random.Generator, clutter_rate: float = 30.0, p_d: float = 0.98) -> PointScene[LinearGaussian]:
    """One realisation of the scenario; the truth is the same in all.

    Detections, clutter and order draw from streams of their own, spawned from ``rng``: the targets' measurements do not
    depend on ``clutter_rate``.

    Raises
    ------
    InputError : ``p_d`` is no probability or ``clutter_rate`` is negative.
    """
    check_rates(p_d, clutter_rate)
    model = LinearGaussian(p_detect=p_d, clutter_rate=clutter_rate)
    half = model.half_width
    return realised(
        model,
        [true_states(scan, model.interval) for scan in range(1, model.scans + 1)],
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
    """Scans of targets at (d, n) states with (n,) identities: what is seen of them, among what is not of them.

    Parameters
    ----------
    measure : of states (d, n) and independent standard normal draws (2, n), the measurements (2, n).
    p_detect : (n,) probabilities that they are seen.
    clutter : that many false measurements, (2, count); ``rate`` are expected in a scan.
    """
    targets_rng, clutter_rng, order_rng = rng.spawn(3)
    measurements, sources = [], []
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


def true_states(scan: int, interval: float = 1.0) -> tuple[F8, I8]:
    """States (4, n) and identities (n,) of the targets that are there in ``scan``, from 1."""
    there = present(scan, FIRST, LAST)
    state = START[there].T.copy()
    state[:2] += state[2:] * (scan - FIRST[there]) * interval
    return state, there + 1


def present(scan: int, first: I8, last: I8) -> I8:
    """(n,) which targets are there in ``scan``."""
    return np.flatnonzero((scan >= first) & (scan <= last))


def check_rates(p_d: float, clutter_rate: float) -> None:
    """Raise `InputError` where they are no probability and no rate."""
    if not 0 <= p_d <= 1 or not 0 <= clutter_rate < np.inf:
        raise InputError(f"p_d = {p_d} and clutter_rate = {clutter_rate} are not a probability and a rate", cure="Mend them")
