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
    predicted_boxes,
)
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.gaussian import Expected, Measurements, NewTargets
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
    m: Measurements,
    new: NewTargets,
    scores: Scores,
    settings: Settings,
    turns: Turns,
    fresh: int,
    appearance: tuple[Pasts, Looks] | None,
) -> tuple[
    tuple[Any, ...],
    tuple[float, float, float, F8, F8, int, float],
    I8,
    tuple[float, float, float],
    I8,
    tuple[Records, F4] | None,
]:
    """The targets one frame later, with new ones, and what was learned: `predicted_layer` and
    `updated_layer`, which describe the rest.

    Parameters
    ----------
    layer : the targets of the frame before, in the pixels of this one.
    world, chances, turns : records of this module, as plain tuples.
    m, new, scores, settings, fresh, appearance : see `updated_layer`.
    """
    dynamics, factors, noise, speed, p_detect, of_target = world
    occlude, reappear, stand, freedom, genuine = chances
    turns = Turns(*turns)
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
        learned,
        gone,
        counted,
        sure,
        pasts,
    )
