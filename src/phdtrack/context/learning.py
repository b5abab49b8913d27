"""From samples to a learned part of a scene: where to begin, what to learn from, and what it is worth [M09 §IV, §V].

What a density is worth is the log-likelihood of samples that it has not seen, against that of the uniform one: every fifth
sample is left out, a density learned from the others, and asked. The density that is kept learns from all.
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


def learn_births(states: F8, time_units: float, frame_size: tuple[float, float], learner: RecursiveEM) -> Lesson:
    """Births from first states (6, n) of tracks that began within ``time_units``; s̄ is their number over that time.

    The volume holds every velocity seen, doubled. Raises `InputError` where there are fewer than ten tracks or no time.
    """
    _enough(states, "tracks that began while the scene was watched", "Learn from a longer stretch")
    if not time_units > 0:
        raise InputError(f"expected a stretch of some length, got {time_units:g} time units", where="learning births")
    fastest = 2 * float(np.abs(states[2:4]).max()) + 1e-6
    low, high = state_volume(*frame_size, fastest)
    centre, spread = _usual(states, high - low)
    centre[2:4] = 0
    start = grid(low, high, BIRTH_GRID, centre, spread)
    return _lesson(start, states, states.shape[1] / time_units, learner)


def learn_clutter(boxes: F8, frames: int, frame_size: tuple[float, float], learner: RecursiveEM) -> Lesson:
    """False alarms from boxes (4, n) marked as false on ``frames`` frames; r̄ is their number a frame.

    Raises `InputError` where there are fewer than ten boxes or no frames.
    """
    _enough(boxes, "detections marked as false", "Mark more of them")
    if frames < 1:
        raise InputError(f"expected frames on which detections were marked, got {frames}", where="learning clutter")
    low, high = measurement_volume(*frame_size)
    centre, spread = _usual(boxes, high - low)
    return _lesson(grid(low, high, CLUTTER_GRID, centre, spread), boxes, boxes.shape[1] / frames, learner)


def _lesson(start: ContextDensity, samples: F8, rate: float, learner: RecursiveEM) -> Lesson:
    inside = samples[:, start.contains(samples)]
    unseen = np.arange(inside.shape[1]) % _FOLD == _FOLD - 1
    gain = math.nan
    if unseen.sum() >= 2:
        tried = learner.learn(start, np.ascontiguousarray(inside[:, ~unseen]))
        gain = float(tried.log(inside[:, unseen]).mean()) + math.log(start.volume)
    return Lesson(Learned(rate, learner.learn(start, inside), inside.shape[1]), gain)


def _usual(samples: F8, extent: F8) -> tuple[F8, F8]:
    """Mean and standard deviation of each component, the latter at least a hundredth of the volume's extent."""
    return samples.mean(axis=1), np.maximum(samples.std(axis=1), 0.01 * extent)


def _enough(samples: F8, what: str, cure: str) -> None:
    if samples.shape[1] < _FEWEST:
        raise InputError(f"expected at least {_FEWEST} {what}, got {samples.shape[1]}", where="learning", cure=cure)
