"""Scene training: a density of births, false alarms or objects from the samples of a stretch [M09 §IV, §V].

Births are learned from the first states of tracks, false alarms from detections that a person marked. How well a density
fits is the log-likelihood of samples that it has not seen, less that of the uniform density: every fifth sample is left out,
a density is learned from the others, and asked; where samples are few each is left out once. The density that is kept learns
from all. Three things keep it from trusting few samples too much:

* Its uniform part has at least the share α_u that makes the unseen samples likeliest.
* Each Gaussian has the covariance of the next sample, not of those it was fitted to [G13 §3.6].
* A shrinkage prior: α_u is at least 10/(n + 10) for n samples (Laplace's rule), over the sizes that are detected.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from phdtrack.arrays import to_cxcywh
from phdtrack.errors import InputError
from phdtrack.scene.em import MIN_UNIFORM, RecursiveEM, grid, known_moments, parameters
from phdtrack.scene.files import LearnedDensity
from phdtrack.scene.mixture import SceneDensity
from phdtrack.types import F8, I8, Tracks

# M09's grids.
BIRTH_GRID, CLUTTER_GRID = (12, 10), (16, 14)
MIN_SAMPLES = 10
# Every so many samples one is left out; up to so many samples each of them is left out in turn.
FOLDS, MAX_ALL_FOLDS = 5, 400
# Seconds of a track from which its first velocity is taken.
LEAD = 0.4
# Seconds for which a track must last, and its own sizes that it must go, to teach a birth.
MIN_DURATION, MIN_DISTANCE = 1.0, 1.0
# Samples that the shrinkage prior counts for; how much the range of detected sizes, between two quantiles, is widened.
PRIOR, WIDENING, SIZE_QUANTILES = 10, 1.5, (0.01, 0.99)

Sizes = tuple[F8, F8]
"""Smallest and largest width and height, (2,) each, pixels."""


@dataclass(frozen=True, slots=True, eq=False)
class Training:
    """What was learned, and its ``gain``: nats per unseen sample above the uniform density, NaN with too few samples."""

    learned: LearnedDensity
    gain: float


def learn_births(
    states: F8,
    time_units: float,
    frame_size: tuple[float, float],
    learner: RecursiveEM,
    corner: tuple[float, float] = (0.0, 0.0),
) -> Training:
    """Births p(x|b) with s̄, their number per time unit. The volume holds every velocity seen, doubled.

    Parameters
    ----------
    states : (6, n) first states of targets that entered, or (4, n) without a size; velocities may be NaN, unknown.
    time_units : length of the stretch.
    frame_size : width and height of the image, pixels, or of the region of the ground, metres.
    learner : settings of EM.
    corner : left and lower end of the region.

    Raises
    ------
    InputError : fewer than ten births or than a component needs (τ: 14 with a size), no time, or no known velocity.
    """
    cure, least = "Learn from a longer stretch, or mark more of them", math.ceil(parameters(len(states)) / 2)
    _check_number(states.shape[1], "births while the scene was watched", cure, least)
    if not time_units > 0:
        raise InputError(f"expected a stretch of some length, got {time_units:g} time units", where="learning births")
    speeds = np.abs(states[2:4][np.isfinite(states[2:4])])
    if len(speeds) == 0:
        raise InputError("no birth's velocity is known", where="learning births", cure="Mark where detections follow")
    low, high = state_volume(*frame_size, 2 * float(speeds.max()) + 1e-6, corner, sized=len(states) == 6)
    weight = np.ones(states.shape[1])
    centre, spread = _typical(states, weight, high - low)
    centre[2:4] = 0
    start = grid(low, high, BIRTH_GRID, centre, spread)
    return _trained(start, states, weight, states.shape[1] / time_units, learner)


def learn_clutter(
    boxes: F8, frames: int, frame_size: tuple[float, float], learner: RecursiveEM, weight: F8 | None = None
) -> Training:
    """False alarms p(z|c) with r̄, their number per frame.

    Parameters
    ----------
    boxes : (4, n) centre and size of the boxes marked as false.
    frames : number of frames on which detections were looked at.
    frame_size : width and height, pixels.
    learner : settings of EM.
    weight : (n,) probability that each is false, 1 where it is None.

    Raises
    ------
    InputError : fewer than ten boxes by their weights, or no frames.
    """
    weights = np.ones(boxes.shape[1]) if weight is None else weight
    _check_number(round(float(weights.sum())), "detections marked as false", "Mark more of them")
    return _trained_boxes(boxes, weights, frames, frame_size, learner)


def learn_objects(boxes: F8, frames: int, frame_size: tuple[float, float], learner: RecursiveEM) -> Training:
    """Where objects are detected, p(z|o), with their number per frame.

    Parameters
    ----------
    boxes : (4, n) centre and size of the boxes that were not marked as false.
    frames : number of frames on which detections were looked at.
    frame_size : width and height, pixels.
    learner : settings of EM.

    Raises
    ------
    InputError : fewer than ten boxes, or no frames.
    """
    _check_number(boxes.shape[1], "detections of objects on the frames that were looked at", "Look at more frames")
    return _trained_boxes(boxes, np.ones(boxes.shape[1]), frames, frame_size, learner)


def box_density(boxes: F8, frame_size: tuple[float, float], learner: RecursiveEM) -> SceneDensity:
    """The density of boxes (4, n) for a picture: how well it fits is not asked, which takes the most time."""
    return learner.learn(_box_grid(boxes, np.ones(boxes.shape[1]), frame_size), boxes)


def predictive(p: SceneDensity, samples: float) -> SceneDensity:
    """The density of the next sample after ``p`` was fitted to so many samples [G13 §3.6].

    The next sample of an unknown Gaussian in d dimensions has Student's density with n − d degrees of freedom. The Gaussian
    nearest to that has (n + 1)/(n − d − 2) times the covariance of the n samples.
    """
    n = np.maximum(samples * (1 - p.uniform) * p.weight, parameters(p.dim) / 2)
    return replace(p, covariance=p.covariance * ((n + 1) / (n - p.dim - 2))[:, None, None])


def detected_sizes(size: F8) -> Sizes:
    """The range of sizes that may appear where sizes (2, n) were detected. Raises `InputError` without detections."""
    if size.shape[1] == 0:
        raise InputError("there are no detections whose sizes could be known", where="sizes")
    smallest, largest = np.quantile(size, SIZE_QUANTILES, axis=1)
    return smallest / WIDENING, largest * WIDENING


def with_prior(learned: LearnedDensity, sizes: Sizes) -> LearnedDensity:
    """The density with the shrinkage prior; the last two components of its states are sizes."""
    density, n = learned.density, learned.samples
    low, high = density.low.copy(), density.high.copy()
    low[-2:], high[-2:] = sizes
    uniform = max(density.uniform, PRIOR / (n + PRIOR))
    return replace(learned, density=replace(density, low=low, high=high, uniform=uniform))


def births_in(tracks: Tracks, fps: float, rate: float, shown: F8 | None = None) -> F8:
    """The first states of the tracks that last and go somewhere; flicker does neither. Arguments as of `first_states`."""
    return first_states(tracks, fps, rate, max(5, round(MIN_DURATION * fps)), shown, MIN_DISTANCE)


def first_states(
    tracks: Tracks, fps: float, rate: float, min_rows: int = 5, shown: F8 | None = None, min_distance: float = 0.0
) -> F8:
    """(6, n) states (px, py, vx, vy, w, h) in which tracks began [M09 §IV]; tracks of the first frame began before it.

    Parameters
    ----------
    tracks : M rows of corrected tracks.
    fps : frames per second.
    rate : time units per second of the velocities.
    min_rows : rows that a track must have.
    shown : (r, M) what the rows show, position first, if it is not centre and size of the boxes; states are then (r + 2, n).
    min_distance : distance that a track must go, in its sizes.
    """
    boxes = to_cxcywh(tracks.xyxy)
    box = boxes if shown is None else shown
    order = np.lexsort((tracks.frame, tracks.identity))
    start = np.flatnonzero(np.diff(tracks.identity[order], prepend=-1))
    opening = int(tracks.frame.min(initial=np.iinfo(np.int64).max))
    states = []
    for rows in np.split(order, start[1:]) if len(order) else []:
        known = len(rows) >= min_rows and tracks.frame[rows[0]] > opening
        if known and (min_distance == 0 or distance_gone(boxes[:, rows]) >= min_distance):
            states.append(first_state(box[:, rows], (tracks.frame[rows] - tracks.frame[rows[0]]) / fps, rate))
    return np.array(states).reshape(-1, len(box) + 2).T.copy()


def distance_gone(box: F8) -> float:
    """Distance between the medians of the first and last fifth of boxes (4, n) of a track, in its sizes √(wh)."""
    fifth = max(1, box.shape[1] // 5)
    step = np.median(box[:2, -fifth:], axis=1) - np.median(box[:2, :fifth], axis=1)
    return float(np.linalg.norm(step) / np.sqrt(np.median(box[2] * box[3])))


def first_state(box: F8, seconds: F8, rate: float) -> F8:
    """(r + 2,) the first state of one track; its velocity is the slope of a line through the first `LEAD` seconds.

    Parameters
    ----------
    box : (r, n) what the track shows, position first.
    seconds : (n,) after the first.
    rate : time units per second of the velocity.
    """
    lead = max(3, int((seconds <= LEAD).sum()))
    time = seconds[:lead] * rate
    centred = time - time.mean()
    velocity = (box[:2, :lead] * centred).sum(axis=1) / (centred**2).sum()
    return np.concatenate([box[:2, 0], velocity, box[2:, 0]])


def state_volume(
    width: float, height: float, max_speed: float, corner: tuple[float, float] = (0.0, 0.0), *, sized: bool = True
) -> tuple[F8, F8]:
    """Bounds (6,) of the states of births: centre in the frame, any size in it; (4,) where states have no size.

    Parameters
    ----------
    width, height : of the image, pixels, or of the region of the ground, metres.
    max_speed : largest velocity along an axis.
    corner : left and lower end of the region.
    sized : whether states have a size.
    """
    left, top = corner
    low, high = [left, top, -max_speed, -max_speed], [left + width, top + height, max_speed, max_speed]
    return np.array([*low, *([0.0, 0.0] if sized else [])]), np.array([*high, *([width, height] if sized else [])])


def measurement_volume(width: float, height: float) -> tuple[F8, F8]:
    """Bounds (4,) of boxes: centre in the frame, any size in it."""
    return np.zeros(4), np.array([width, height, width, height], np.float64)


def _trained_boxes(boxes: F8, weight: F8, frames: int, frame_size: tuple[float, float], learner: RecursiveEM) -> Training:
    if frames < 1:
        raise InputError(f"expected frames on which detections were looked at, got {frames}", where="learning from boxes")
    return _trained(_box_grid(boxes, weight, frame_size), boxes, weight, float(weight.sum()) / frames, learner)


def _box_grid(boxes: F8, weight: F8, frame_size: tuple[float, float]) -> SceneDensity:
    """Where learning from boxes begins."""
    low, high = measurement_volume(*frame_size)
    return grid(low, high, CLUTTER_GRID, *_typical(boxes, weight, high - low))


def _trained(start: SceneDensity, samples: F8, weight: F8, rate: float, learner: RecursiveEM) -> Training:
    shown = np.where(np.isnan(samples), start.low[:, None], samples)
    used = start.contains(shown)
    inside, weight = np.ascontiguousarray(samples[:, used]), weight[used]
    density = predictive(learner.learn(start, inside, weight), float(weight.sum()))
    unseen, log_ratio = _left_out(start, inside, weight, learner)
    gain = math.nan
    if len(unseen) >= 2 and weight[unseen].sum() > 0:
        uniform = _best_uniform(log_ratio, weight[unseen])
        gain = float(np.average(_gains(log_ratio, uniform), weights=weight[unseen]))
        density = replace(density, uniform=max(density.uniform, uniform))
    return Training(LearnedDensity(rate, density, inside.shape[1]), gain)


def _left_out(start: SceneDensity, samples: F8, weight: F8, learner: RecursiveEM) -> tuple[I8, F8]:
    """Which samples were left out (n,), and log of the Gaussians learned from the others over 1/V at each (n,)."""
    complete = np.flatnonzero(np.isfinite(samples).all(axis=0))
    folds = range(FOLDS) if len(complete) <= MAX_ALL_FOLDS else [FOLDS - 1]
    left_out, log_ratio = [complete[:0]], [np.zeros(0)]
    for fold in folds:
        out = complete[fold::FOLDS]
        others = np.delete(np.arange(samples.shape[1]), out)
        if len(out) and weight[others].sum() > 0:
            left = learner.learn(start, np.ascontiguousarray(samples[:, others]), weight[others])
            tried = predictive(left, float(weight[others].sum()))
            parts = tried.log_parts(np.ascontiguousarray(samples[:, out]))[1:]
            log_ratio.append(np.logaddexp.reduce(parts, axis=0) - math.log((1 - tried.uniform) / start.volume))
            left_out.append(out)
    return np.concatenate(left_out), np.concatenate(log_ratio)


def _best_uniform(log_ratio: F8, weight: F8) -> float:
    """α_u of the greatest likelihood where the Gaussians are exp(log_ratio) times the uniform part."""
    uniform = 0.5
    for _ in range(200):
        uniform = float(np.average(np.exp(math.log(uniform) - _gains(log_ratio, uniform)), weights=weight))
        uniform = min(max(uniform, MIN_UNIFORM), 1 - MIN_UNIFORM)
    return uniform


def _gains(log_ratio: F8, uniform: float) -> F8:
    """(n,) log of p over 1/V at samples where the Gaussians are exp(log_ratio) times 1/V."""
    out: F8 = np.logaddexp(math.log(uniform), math.log(1 - uniform) + log_ratio)
    return out


def _typical(samples: F8, weight: F8, extent: F8) -> tuple[F8, F8]:
    """Mean and standard deviation of each component where it is known, the latter at least a hundredth of the extent."""
    mean, variance = known_moments(samples, weight)
    return mean, np.maximum(np.sqrt(variance), 0.01 * extent)


def _check_number(count: int, what: str, cure: str, least: int = MIN_SAMPLES) -> None:
    if count < max(least, MIN_SAMPLES):
        raise InputError(f"expected at least {max(least, MIN_SAMPLES)} {what}, got {count}", where="learning", cure=cure)
