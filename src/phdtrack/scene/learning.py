"""From samples to a learned part of a scene: where to begin, what to learn from, and what it is worth [M09 §IV, §V].

What a density is worth is the log-likelihood of samples that it has not seen, against that of the uniform one: every fifth
sample is left out, a density learned from the others, and asked; where there are few samples each is left out once. The
density that is kept learns from all. Its uniform part has at least the share α_u that makes the unseen samples likeliest: by
the samples that Gaussians were fitted to they explain everything, also where the next one will lie elsewhere, and a
dozen samples would leave less than nothing for it. For the same reason every Gaussian is made wider than the samples that it
was fitted to lie: as wide as the next one is uncertain. Of samples that do not show everything (births by hand of unknown
velocity) something is learned, but they are not asked.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from phdtrack.errors import InputError
from phdtrack.scene.batch_em import parameters
from phdtrack.scene.density import ContextDensity
from phdtrack.scene.learner import LEAST_UNIFORM, RecursiveEM, grid
from phdtrack.scene.prior import of_the_next
from phdtrack.scene.samples import measurement_volume, state_volume
from phdtrack.scene.scene_file import Learned
from phdtrack.types import F8, I8

# M09's grids.
BIRTH_GRID, CLUTTER_GRID = (12, 10), (16, 14)
_FEWEST = 10
_FOLD = 5
# Up to so many samples all are left out in turn: one in five of fewer than a hundred would tell little.
_FEW = 400


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
    or fewer than a component needs to exist (τ: 14 with a size), no time, or no velocity at all.
    """
    what, cure = "births while the scene was watched", "Learn from a longer stretch, or mark more of them"
    _enough(states.shape[1], what, cure, math.ceil(parameters(len(states)) / 2))
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
    return _of_boxes(boxes, worth, frames, frame_size, learner)


def learn_objects(boxes: F8, frames: int, frame_size: tuple[float, float], learner: RecursiveEM) -> Lesson:
    """Where objects are detected, from the boxes (4, n) on ``frames`` frames that nobody marked as false; how many a frame.

    Raises `InputError` where there are fewer than ten boxes, or no frames.
    """
    _enough(boxes.shape[1], "detections of objects on the frames that were looked at", "Look at more frames")
    return _of_boxes(boxes, np.ones(boxes.shape[1]), frames, frame_size, learner)


def box_density(boxes: F8, frame_size: tuple[float, float], learner: RecursiveEM) -> ContextDensity:
    """The density of boxes (4, n) alone, for a picture of it: what it is worth is not asked, which takes the most time."""
    return learner.learn(_before(boxes, np.ones(boxes.shape[1]), frame_size), boxes)


def _of_boxes(boxes: F8, worth: F8, frames: int, frame_size: tuple[float, float], learner: RecursiveEM) -> Lesson:
    """From boxes (4, n) of worth (n,) on so many frames. Raises `InputError` where there are no frames."""
    if frames < 1:
        raise InputError(f"expected frames on which detections were looked at, got {frames}", where="learning from boxes")
    return _lesson(_before(boxes, worth, frame_size), boxes, worth, float(worth.sum()) / frames, learner)


def _before(boxes: F8, worth: F8, frame_size: tuple[float, float]) -> ContextDensity:
    """Where learning from boxes begins."""
    low, high = measurement_volume(*frame_size)
    return grid(low, high, CLUTTER_GRID, *_usual(boxes, worth, high - low))


def _lesson(start: ContextDensity, samples: F8, worth: F8, rate: float, learner: RecursiveEM) -> Lesson:
    shown = np.where(np.isnan(samples), start.low[:, None], samples)
    counts = start.contains(shown)
    inside, worth = np.ascontiguousarray(samples[:, counts]), worth[counts]
    density = of_the_next(learner.learn(start, inside, worth), float(worth.sum()))
    unseen, log_ratio = _unseen(start, inside, worth, learner)
    gain = math.nan
    if len(unseen) >= 2 and worth[unseen].sum() > 0:
        uniform = _share(log_ratio, worth[unseen])
        gain = float(np.average(_gains(log_ratio, uniform), weights=worth[unseen]))
        density = replace(density, uniform=max(density.uniform, uniform))
    return Lesson(Learned(rate, density, inside.shape[1]), gain)


def _unseen(start: ContextDensity, samples: F8, worth: F8, learner: RecursiveEM) -> tuple[I8, F8]:
    """Which samples were left out (n,), and by how much the others' Gaussians make each likelier than 1/V, a logarithm."""
    complete = np.flatnonzero(np.isfinite(samples).all(axis=0))
    folds = range(_FOLD) if len(complete) <= _FEW else [_FOLD - 1]
    left_out, log_ratio = [complete[:0]], [np.zeros(0)]
    for fold in folds:
        out = complete[fold::_FOLD]
        others = np.delete(np.arange(samples.shape[1]), out)
        if len(out) and worth[others].sum() > 0:
            left = learner.learn(start, np.ascontiguousarray(samples[:, others]), worth[others])
            tried = of_the_next(left, float(worth[others].sum()))
            parts = tried.parts(np.ascontiguousarray(samples[:, out]))[1:]
            log_ratio.append(np.logaddexp.reduce(parts, axis=0) - math.log((1 - tried.uniform) / start.volume))
            left_out.append(out)
    return np.concatenate(left_out), np.concatenate(log_ratio)


def _share(log_ratio: F8, worth: F8) -> float:
    """α_u of the greatest likelihood, from those of the Gaussians over the uniform part."""
    uniform = 0.5
    for _ in range(200):
        uniform = float(np.average(np.exp(math.log(uniform) - _gains(log_ratio, uniform)), weights=worth))
        uniform = min(max(uniform, LEAST_UNIFORM), 1 - LEAST_UNIFORM)
    return uniform


def _gains(log_ratio: F8, uniform: float) -> F8:
    """(n,) log p/(1/V) at samples of which the Gaussians alone would have ``log_ratio``."""
    out: F8 = np.logaddexp(math.log(uniform), math.log(1 - uniform) + log_ratio)
    return out


def _usual(samples: F8, worth: F8, extent: F8) -> tuple[F8, F8]:
    """Mean and standard deviation of each component where it is known, the latter at least a hundredth of the extent."""
    counts = np.where(np.isnan(samples), 0.0, worth)
    values, total = np.where(np.isnan(samples), 0.0, samples), counts.sum(axis=1)
    mean = (counts * values).sum(axis=1) / total
    variance = (counts * (values - mean[:, None]) ** 2).sum(axis=1) / total
    return mean, np.maximum(np.sqrt(variance), 0.01 * extent)


def _enough(count: int, what: str, cure: str, least: int = _FEWEST) -> None:
    if count < max(least, _FEWEST):
        raise InputError(f"expected at least {max(least, _FEWEST)} {what}, got {count}", where="learning", cure=cure)
