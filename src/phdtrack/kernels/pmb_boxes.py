"""A step of the Poisson multi-Bernoulli filter over boxes in one call: the kernels that
`filters.pmb.PMB` otherwise calls one by one, for boxes at constant velocity around whose detections
targets are born.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from phdtrack.kernels import F4, F8, I8, Records
from phdtrack.kernels.appearance import Looks, Pasts
from phdtrack.kernels.box import (
    OBSERVED,
    Noise,
    box_covariances,
    box_deviations,
    local_densities,
    predicted_boxes,
    states_of_boxes,
)
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER, MERGED
from phdtrack.kernels.gaussian import FOUR_LENGTHS, Expected, Measurements, NewTargets
from phdtrack.kernels.jumps import Jumps
from phdtrack.kernels.pmb import Layer, Scores, Settings, predicted_layer, updated_layer
from phdtrack.kernels.small_arrays import floats


class BoxWorld(NamedTuple):
    """Motion and sensor of boxes over one interval.

    ``dynamics``: `kernels.box.BoxDynamics`; ``factors``: what multiplies the variances of
    acceleration of each motion of a hypothesis, (0,) for nothing. ``noise``, ``speed``: as in
    `kernels.box.states_of_boxes`. ``p_detect``: p_D. ``of_target``: whether the noise of a
    measurement scales with the target, or is the same for all.
    """

    dynamics: tuple[Any, ...]
    factors: F8
    noise: Noise
    speed: float
    p_detect: float
    of_target: bool


class Chances(NamedTuple):
    """The numbers of `kernels.pmb.predicted_layer`, as there."""

    occlude: float
    reappear: float
    stand: float
    freedom: tuple[float, float]
    genuine: tuple[float, float]


class Turns(NamedTuple):
    """The numbers of `kernels.jumps.Jumps`; ``possible``: whether velocities may be new."""

    interval: float
    fast: float
    turn: float
    wide: float
    possible: bool


class Seen(NamedTuple):
    """The measurements of a frame.

    ``z`` (m, N), m ≥ 4. ``noise``: see `kernels.gaussian.Measurements`. ``clutter`` (N,): κ(z);
    (0,): that at which ``local`` false alarms, times two factors, are expected in the
    neighbourhood of each box, whose volume is the last number times w²h² (`models.volumes`).
    """

    z: F8
    noise: F8
    clutter: F8
    local: tuple[float, float, float, float]


class FirstSeen(NamedTuple):
    """Targets whose first detection is measurement j.

    ``given``: the columns of `kernels.gaussian.NewTargets`; of 0 targets: those around each box,
    with the density of ``local``, which is as that of `Seen`.
    """

    given: tuple[F8, F8, F8]
    local: tuple[float, float, float, float]


@njit(**INNER)
def _local(z: F8, local: tuple[float, float, float, float]) -> F8:
    """(N,) the density of ``local`` at boxes ``z`` (m, N), as of `Seen`."""
    rate, first, second, volume = local
    out: F8 = local_densities(z, rate, volume)
    for j in range(out.size):
        out[j] = out[j] * first * second
    return out


@njit(**MERGED)
def _measurements(seen: Seen) -> Measurements:
    """The measurements with κ(z)."""
    n = seen.z.shape[1]
    z = np.empty((n, len(OBSERVED)))
    for j in range(n):
        for a in range(len(OBSERVED)):
            z[j, a] = seen.z[a, j]
    clutter = seen.clutter if seen.clutter.size == n else _local(seen.z, seen.local)
    return Measurements(z, seen.noise, clutter, FOUR_LENGTHS)


@njit(**MERGED)
def _first_seen(z: F8, first: FirstSeen, noise: Noise, speed: float, p_detect: float) -> NewTargets:
    """The targets whose first detections are the boxes ``z`` (m, N) [PMB (5)]."""
    density, mean, covariance = first.given
    if density.size < z.shape[1]:
        states, covariance = states_of_boxes(z, noise, speed)
        density = _local(z, first.local)
        mean = np.empty((z.shape[1], len(states)))
        for j in range(z.shape[1]):
            density[j] = p_detect * density[j]
            for a in range(len(states)):
                mean[j, a] = states[a, j]
    return NewTargets(density, mean, covariance)


@njit(**INNER)
def _columns(mean: F8) -> F8:
    """(d, n) the states (n, d) as columns."""
    out = np.empty((mean.shape[1], len(mean)))
    for i in range(len(mean)):
        for a in range(mean.shape[1]):
            out[a, i] = mean[i, a]
    return out


@njit(**ENTRY)
def stepped_boxes(
    layer: Layer,
    world: BoxWorld,
    chances: Chances,
    seen: Seen,
    first: FirstSeen,
    scores: Scores,
    settings: Settings,
    turns: Turns,
    fresh: int,
    appearance: tuple[Pasts, Looks] | None,
) -> tuple[
    tuple[Any, ...],
    F8,
    tuple[float, float, float, F8, F8, int, float],
    I8,
    tuple[float, float, float],
    I8,
    tuple[Records, F4] | None,
]:
    """The targets one frame later, with new ones, κ(z), and what was learned: `predicted_layer` and
    `updated_layer`, which describe the rest.

    Parameters
    ----------
    layer : the targets of the frame before, in the pixels of this one.
    world, chances, seen, first, turns : records of this module, as plain tuples.
    scores, settings, fresh, appearance : see `updated_layer`.
    """
    dynamics, factors, noise, speed, p_detect, of_target = world
    occlude, reappear, stand, freedom, genuine = chances
    turns = Turns(*turns)
    seen = Seen(*seen)
    m = _measurements(seen)
    new = _first_seen(seen.z, FirstSeen(*first), noise, speed, p_detect)
    targets, hypotheses, mean, covariance = layer
    many = len(hypotheses)
    factor = np.empty(many if len(factors) > 0 else 0)
    for c in range(factor.size):
        factor[c] = factors[hypotheses[c].motion]
    moved = predicted_boxes(mean, covariance, dynamics, factor)
    resolved = box_deviations(_columns(mean), noise, speed)
    ahead = predicted_layer(
        Layer(targets, hypotheses, mean, covariance),
        moved,
        resolved,
        occlude,
        reappear,
        stand,
        freedom,
        genuine,
    )
    columns = _columns(ahead.mean)
    own = np.empty((0, 4, 4))
    if of_target:
        own = box_covariances(columns[4:6], noise)
    rows = np.empty(4, np.int64)
    for a in range(4):
        rows[a] = OBSERVED[a]
    expected = Expected(
        rows, ahead.mean, ahead.covariance, ahead.covariance, own, floats(many, p_detect)
    )
    usual = np.empty((many if turns.possible else 0, 2))
    if len(usual) > 0:
        deviations = box_deviations(columns, noise, speed)
        for c in range(many):
            usual[c, 0] = deviations[2, c]
            usual[c, 1] = deviations[3, c]
    jumps = Jumps(turns.interval, turns.fast, turns.turn, usual, turns.wide)
    after, learned, gone, _, counted, sure, pasts = updated_layer(
        ahead, expected, m, new, scores, settings, fresh, jumps, appearance
    )
    return (
        (after.targets, after.hypotheses, after.mean, after.covariance),
        m.clutter,
        learned,
        gone,
        counted,
        sure,
        pasts,
    )
