"""Scene training: a density of births, false alarms or objects from samples of a training video
[M09 §IV, §V].

Births are learned from the first states of tracks, false alarms from detections that a person
marked. The goodness of fit is the log-likelihood of held-out samples minus that of the uniform
density, by cross-validation: every fifth sample is held out; if there are few samples, each is held
out once. The final density learns from all samples. Three measures against overfitting:

* Its uniform part has at least the share α_u that maximises the likelihood of held-out samples.
* Each Gaussian has the covariance of the next sample, not of those it was fitted to [G13 §3.6].
* A shrinkage prior: α_u is at least 10/(n + 10) for n samples (Laplace's rule), over the range of
  detected sizes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from phdtrack.arrays import to_cxcywh
from phdtrack.clock import Clock, as_clock
from phdtrack.errors import InputError
from phdtrack.scene.em import best_uniform, grid, learn, parameters
from phdtrack.scene.mixture import SceneDensity
from phdtrack.scene.scene_file import LearnedDensity
from phdtrack.types import F8, I8, Tracks

# M09's grids.
BIRTH_GRID = (12, 10)
CLUTTER_GRID = (16, 14)
MIN_SAMPLES = 10
# τ of births: a component needs as many.
MIN_BIRTHS = math.ceil(parameters(6) / 2)
# Names of the samples in messages.
FALSE_BOXES = "detections marked as false"
OBJECT_BOXES = "objects on the frames that were looked at"
# One of so many samples is held out; up to so many samples, all folds are used.
FOLDS = 5
MAX_ALL_FOLDS = 400
# Seconds of a track from which its first velocity is estimated.
LEAD = 0.4
# Births are learned from tracks of at least this duration, seconds, and distance, in own sizes.
MIN_DURATION = 1.0
MIN_DISTANCE = 1.0
# Number of samples that the shrinkage prior is worth; factor by which the range of detected sizes,
# between two quantiles, is widened.
PRIOR = 10
WIDENING = 1.5
SIZE_QUANTILES = (0.01, 0.99)


@dataclass(frozen=True, slots=True, eq=False)
class Training:
    """A learned density and its ``gain``: nats per held-out sample over the uniform density, NaN
    with too few samples.
    """

    learned: LearnedDensity
    gain: float


def learn_births(states: F8, time_units: float, frame_size: tuple[float, float]) -> Training:
    """Learn births p(x|b) with s̄, their number per time unit. The volume extends to twice the
    largest observed velocity.

    Raises `InputError` for fewer births than a component needs (τ: 14), no time, or no known
    velocity.

    Parameters
    ----------
    states : (6, n) first states of targets that entered; unknown velocities are NaN.
    time_units : length of the training video.
    frame_size : width and height of the image, pixels.
    """
    cure = "Learn from a longer video, or mark more of them"
    _check_number(states.shape[1], "births while the scene was watched", cure, MIN_BIRTHS)
    if not time_units > 0:
        raise InputError(
            f"expected a duration above 0, got {time_units:g} time units",
            where="learning births",
        )
    speeds = np.abs(states[2:4][np.isfinite(states[2:4])])
    if len(speeds) == 0:
        raise InputError(
            "no birth has a known velocity",
            where="learning births",
            cure="Mark births that detections follow",
        )
    volume = state_volume(frame_size, 2 * float(speeds.max()) + 1e-6)
    return _trained(_start(states, *volume, BIRTH_GRID), states, states.shape[1] / time_units)


def learn_boxes(boxes: F8, frames: int, frame_size: tuple[float, float], name: str) -> Training:
    """Learn a density of boxes and their number per frame: false alarms p(z|c), r̄, or detections
    of objects p(z|o).

    Raises `InputError` for fewer than ten boxes, or no frames.

    Parameters
    ----------
    boxes : array (4, n), centre and size of the boxes.
    frames : number of frames on which detections were checked.
    frame_size : width and height, pixels.
    name : what messages call the boxes.
    """
    _check_number(boxes.shape[1], name, "Check more frames, or mark more of them")
    if frames < 1:
        raise InputError(
            f"expected frames on which detections were checked, got {frames}",
            where="learning from boxes",
        )
    start = _start(boxes, *measurement_volume(*frame_size), CLUTTER_GRID)
    return _trained(start, boxes, boxes.shape[1] / frames)


def box_density(boxes: F8, frame_size: tuple[float, float]) -> SceneDensity:
    """The density of boxes (4, n) for a picture, without cross-validation, which takes most of the
    time.
    """
    return learn(_start(boxes, *measurement_volume(*frame_size), CLUTTER_GRID), boxes)


def predictive(p: SceneDensity, samples: float) -> SceneDensity:
    """The predictive density of the next sample after ``p`` was fitted to so many samples [G13
    §3.6].

    The next sample of an unknown Gaussian in d dimensions has Student's density with n − d degrees
    of freedom. The Gaussian nearest to that has (n + 1)/(n − d − 2) times the covariance of the n
    samples.
    """
    n = np.maximum(samples * (1 - p.uniform) * p.weight, parameters(p.dim) / 2)
    return replace(p, covariance=p.covariance * ((n + 1) / (n - p.dim - 2))[:, None, None])


def with_prior(learned: LearnedDensity, size: F8) -> LearnedDensity:
    """The density with the shrinkage prior over the range of detected sizes (2, n), its last two
    components.

    Raises `InputError` without detections.
    """
    if size.shape[1] == 0:
        raise InputError("there are no detections, so their sizes are unknown", where="sizes")
    smallest, largest = np.quantile(size, SIZE_QUANTILES, axis=1)
    density = learned.density
    n = learned.samples
    low = density.low.copy()
    high = density.high.copy()
    low[-2:] = smallest / WIDENING
    high[-2:] = largest * WIDENING
    uniform = max(density.uniform, PRIOR / (n + PRIOR))
    return replace(learned, density=replace(density, low=low, high=high, uniform=uniform))


def births_in(tracks: Tracks, fps: float | Clock, rate: float, everything: bool = False) -> F8:
    """(6, n) first states (px, py, vx, vy, w, h) of the tracks that last and move; those of
    flickering lights do not.

    Tracks in the first frame are omitted: they began earlier [M09 §IV].

    Parameters
    ----------
    tracks : M rows of corrected tracks.
    fps : frames per second, or the times of the frames.
    rate : time units per second of the velocities.
    everything : include all tracks of at least three rows, which have a velocity, as in M09.
    """
    box = to_cxcywh(tracks.xyxy)
    order = np.lexsort((tracks.frame, tracks.identity))
    start = np.flatnonzero(np.diff(tracks.identity[order], prepend=-1))
    first_frame = int(tracks.frame.min(initial=np.iinfo(np.int64).max))
    clock = as_clock(fps)
    states = []
    for rows in np.split(order, start[1:]) if len(order) else []:
        frame = tracks.frame[rows]
        time = clock.times(frame)
        min_rows = 3
        if not everything:
            # As many as there are in that time.
            min_rows = max(5, round(clock.number_at(time[0] + MIN_DURATION) - float(frame[0])))
        lasting = len(rows) >= min_rows and frame[0] > first_frame
        if lasting and (everything or _distance(box[:, rows]) >= MIN_DISTANCE):
            states.append(first_state(box[:, rows], (time - time[0]).round(9)))
    out = np.array(states).reshape(-1, 6).T.copy()
    out[2:4] /= rate
    return out


def _distance(box: F8) -> float:
    """Distance between the median positions in the first and the last fifth of a track's boxes
    (4, n), in units of its size √(wh).
    """
    fifth = max(1, box.shape[1] // 5)
    step = np.median(box[:2, -fifth:], axis=1) - np.median(box[:2, :fifth], axis=1)
    return float(np.linalg.norm(step) / np.sqrt(np.median(box[2] * box[3])))


def first_state(box: F8, seconds: F8) -> F8:
    """(r + 2,) the first position, the velocity per second, and the other components of a track
    with the measurements ``box`` (r, n).

    The velocity is the slope of the regression line over the first `LEAD` seconds; ``seconds``
    (n,) start at 0.
    """
    lead = max(3, int((seconds <= LEAD).sum()))
    centred = seconds[:lead] - seconds[:lead].mean()
    velocity = (box[:2, :lead] * centred).sum(axis=1) / (centred**2).sum()
    return np.concatenate([box[:2, 0], velocity, box[2:, 0]])


def state_volume(size: tuple[float, float], max_speed: float) -> tuple[F8, F8]:
    """Bounds (6,) of the states of births: centre in the frame, speed along each axis, any size in
    the frame.
    """
    low = np.array([0.0, 0.0, -max_speed, -max_speed, 0.0, 0.0])
    return low, np.array([*size, max_speed, max_speed, *size], np.float64)


def measurement_volume(width: float, height: float) -> tuple[F8, F8]:
    """Bounds (4,) of boxes: centre in the frame, any size in it."""
    return np.zeros(4), np.array([width, height, width, height], np.float64)


def _start(samples: F8, low: F8, high: F8, counts: tuple[int, int]) -> SceneDensity:
    """The density from which learning starts: mean and deviation of the samples, at rest."""
    mean = np.nanmean(samples, axis=1)
    if counts == BIRTH_GRID:
        mean[2:4] = 0
    return grid(
        low, high, counts, mean, np.maximum(np.nanstd(samples, axis=1), 0.01 * (high - low))
    )


def _trained(start: SceneDensity, samples: F8, rate: float) -> Training:
    """The density learned from the samples in the volume, with the uniform share of held-out
    samples.
    """
    used = start.contains(np.where(np.isnan(samples), start.low[:, None], samples))
    inside = np.ascontiguousarray(samples[:, used])
    density = predictive(learn(start, inside), inside.shape[1])
    log_ratio = _held_out(start, inside)
    gain = math.nan
    if len(log_ratio) >= 2:
        uniform = best_uniform(log_ratio)
        gain = float(np.logaddexp(math.log(uniform), math.log(1 - uniform) + log_ratio).mean())
        density = replace(density, uniform=max(density.uniform, uniform))
    return Training(LearnedDensity(rate, density, inside.shape[1]), gain)


def _held_out(start: SceneDensity, samples: F8) -> F8:
    """(n,) `SceneDensity.log_ratio` at each held-out sample, for the density learned from the
    others.
    """
    complete: I8 = np.flatnonzero(np.isfinite(samples).all(axis=0))
    folds = range(FOLDS) if len(complete) <= MAX_ALL_FOLDS else [FOLDS - 1]
    log_ratio = [np.zeros(0)]
    for fold in folds:
        held_out = complete[fold::FOLDS]
        others = np.delete(samples, held_out, axis=1)
        if len(held_out) and others.shape[1]:
            density = predictive(learn(start, others), others.shape[1])
            log_ratio.append(density.log_ratio(samples[:, held_out]))
    return np.concatenate(log_ratio)


def _check_number(count: int, name: str, cure: str, minimum: int = MIN_SAMPLES) -> None:
    """Raise `InputError` if there are too few samples."""
    if count < minimum:
        raise InputError(
            f"expected at least {minimum} {name}, got {count}", where="learning", cure=cure
        )
