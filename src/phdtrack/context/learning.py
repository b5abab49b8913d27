"""From samples to a learned part of a scene: where to begin, what to learn from, and what it is worth [M09 §IV, §V].

What a density is worth is the log-likelihood of samples that it has not seen, against that of the uniform one: every fifth
sample is left out, a density learned from the others, and asked. The density that is kept learns from all. Of samples that
do not show everything (births by hand of unknown velocity) something is learned, but they are not asked.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from phdtrack.context.density import ContextDensity
from phdtrack.context.learner import RecursiveEM, grid
from phdtrack.context.samples import measurement_volume, state_volume
from phdtrack.context.scene_file import Learned
from phdtrack.errors import InputError
from phdtrack.types import F8

# M09's grids.
BIRTH_GRID, CLUTTER_GRID = (12, 10), (16, 14)
_FEWEST = 10
_FOLD = 5


@dataclass(frozen=True, slots=True, eq=False)
class Lesson:
    """What was learned, and what it is worth.

    ``gain``: nats per unseen sample above the uniform density, NaN where there were too few samples to leave any out.
    """

    learned: Learned
    gain: float


def learn_births(
    states: F8,
    time_units: float,
    frame_size: tuple[float, float],
    learner: RecursiveEM,
    corner: tuple[float, float] = (0.0, 0.0),
) -> Lesson:
    """Births from first states (6, n) of those who entered within ``time_units``; s̄ is their number over that time.

    States without a size are (4, n); on the ground ``frame_size`` and ``corner`` are the region's, metres. Velocities may be
    NaN, unknown. The volume holds every velocity seen, doubled. Raises `InputError` where there are fewer than ten births,
    no time, or no velocity at all.
    """
    _enough(states.shape[1], "births while the scene was watched", "Learn from a longer stretch, or mark more of them")
    if not time_units > 0:
        raise InputError(f"expected a stretch of some length, got {time_units:g} time units", where="learning births")
    speeds = np.abs(states[2:4][np.isfinite(states[2:4])])
    if len(speeds) == 0:
        raise InputError("no birth's velocity is known", where="learning births", cure="Mark where detections follow")
    low, high = state_volume(*frame_size, 2 * float(speeds.max()) + 1e-6, corner, sized=len(states) == 6)
    one = np.ones(states.shape[1])
    centre, spread = _usual(states, one, high - low)
    centre[2:4] = 0
    start = grid(low, high, BIRTH_GRID, centre, spread)
    return _lesson(start, states, one, states.shape[1] / time_units, learner)


def learn_clutter(
    boxes: F8, frames: int, frame_size: tuple[float, float], learner: RecursiveEM, weight: F8 | None = None
) -> Lesson:
    """False alarms from boxes (4, n) marked as false on ``frames`` frames; r̄ is their number a frame.

    ``weight`` (n,) is how certain each is, 1 where it is not given. Raises `InputError` where there are, by their weights,
    fewer than ten boxes, or no frames.
    """
    worth = np.ones(boxes.shape[1]) if weight is None else weight
    _enough(round(float(worth.sum())), "detections marked as false", "Mark more of them")
    if frames < 1:
        raise InputError(f"expected frames on which detections were marked, got {frames}", where="learning clutter")
    low, high = measurement_volume(*frame_size)
    start = grid(low, high, CLUTTER_GRID, *_usual(boxes, worth, high - low))
    return _lesson(start, boxes, worth, float(worth.sum()) / frames, learner)


def _lesson(start: ContextDensity, samples: F8, worth: F8, rate: float, learner: RecursiveEM) -> Lesson:
    shown = np.where(np.isnan(samples), start.low[:, None], samples)
    counts = start.contains(shown)
    inside, worth = samples[:, counts], worth[counts]
    complete = np.flatnonzero(np.isfinite(inside).all(axis=0))
    unseen = np.zeros(inside.shape[1], np.bool_)
    unseen[complete[_FOLD - 1 :: _FOLD]] = True
    gain = math.nan
    if unseen.sum() >= 2 and worth[unseen].sum() > 0:
        tried = learner.learn(start, np.ascontiguousarray(inside[:, ~unseen]), worth[~unseen])
        gain = float(np.average(tried.log(inside[:, unseen]), weights=worth[unseen])) + math.log(start.volume)
    return Lesson(Learned(rate, learner.learn(start, inside, worth), inside.shape[1]), gain)


def _usual(samples: F8, worth: F8, extent: F8) -> tuple[F8, F8]:
    """Mean and standard deviation of each component where it is known, the latter at least a hundredth of the extent."""
    counts = np.where(np.isnan(samples), 0.0, worth)
    values, total = np.where(np.isnan(samples), 0.0, samples), counts.sum(axis=1)
    mean = (counts * values).sum(axis=1) / total
    variance = (counts * (values - mean[:, None]) ** 2).sum(axis=1) / total
    return mean, np.maximum(np.sqrt(variance), 0.01 * extent)


def _enough(count: int, what: str, cure: str) -> None:
    if count < _FEWEST:
        raise InputError(f"expected at least {_FEWEST} {what}, got {count}", where="learning", cure=cure)
