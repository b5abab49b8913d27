"""A simulated detector for `experiments.synthetic_cameras`: what it misses, how it boxes, what it
finds where nothing is, and its scores.

Imports nothing of phdtrack: the environment of the peers has neither its dependencies nor itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.special import expit, ndtr

from experiments.synthetic_worlds import (
    F8,
    I8,
    Bool,
    Figures,
    Rng,
    World,
    clipped,
    wandering,
)

# Mean and deviation of the log odds of the scores of objects and of false alarms. The area under
# the curve of one against the other is 0.999, 0.81 and 0.5.
SCORE_LAWS = {
    "sharp": ((2.2, 0.8), (-1.2, 0.8)),
    "weak": ((1.0, 0.9), (-0.1, 0.9)),
    "uninformative": ((0.8, 0.8), (0.8, 0.8)),
    "none": ((0.0, 0.0), (0.0, 0.0)),
}
# Those of low detections of objects, and of low false alarms.
LOW_OBJECTS = (-1.2, 0.4)
LOW_CLUTTER = (-1.8, 0.5)
# An object of which nothing is visible has log odds lower by this.
_HIDDEN_ODDS = 1.5
# Scores of objects change slowly, with this time constant in seconds.
_SCORE_MEMORY = 0.3
# False alarms that last look more like objects: their log odds are higher by up to this.
_LASTING_ODDS = 1.2
# Two objects whose boxes overlap as much may get one box.
_MERGING = 0.35
# Deviation of the logarithm of a false alarm's size around that of an object.
_CLUTTER_SIZE = 0.25
# Deviation of the boxes of low detections, doubles and lasting false alarms, in box sizes.
_LOOSE = 0.06
_DOUBLE = 0.18
_PLACE = 0.04
# Seconds that an object keeps one kind of box: a part, a double, a merged one.
_EPISODE = 0.5
_SMALLEST = 3.0
# Where a detection comes from.
ORIGINS = ("object", "low", "part", "merged", "double", "clutter", "low clutter", "place")


@dataclass(frozen=True, slots=True)
class DetectorLaw:
    """How a detector errs.

    Attributes
    ----------
    p_detect, occlusion : an object is detected with probability p_D v^s, where v is its visible
        share.
    miss_memory : time constant of misses, seconds; 0: each is independent.
    low_share : share of the misses of which there is a detection with a low score.
    merging : share of the objects that get one box with one that they hide.
    scores : law of the scores, one of `SCORE_LAWS`.
    score_power : power of the scores: above 1 a detector whose scores are all low.
    centre_noise, size_noise : deviations of a box, in box sizes.
    noise_memory : their time constant, seconds; 0: independent.
    parts, parts_hidden : share of the boxes that show the upper part only; of those of half hidden
        objects it is larger by the second.
    doubles : share of the detected objects that have a second box.
    overlap : of two boxes that overlap more (IoU) one is left out.
    clutter, low_clutter : false alarms a frame, uniform over the frame, and those with low scores.
    places : number of lasting places of false alarms.
    place_on, place_off : seconds for which a place is on and off, on average.
    place_fires : probability of a false alarm in a frame in which it is on.
    """

    p_detect: float
    occlusion: float
    miss_memory: float
    low_share: float
    merging: float
    scores: str
    score_power: float
    centre_noise: float
    size_noise: float
    noise_memory: float
    parts: float
    parts_hidden: float
    doubles: float
    overlap: float
    clutter: float
    low_clutter: float
    places: int
    place_on: float
    place_off: float
    place_fires: float


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedDetections:
    """M detections, ascending in frame.

    Attributes
    ----------
    frame : (M,) from 1.
    xyxy : (M, 4) pixels.
    score : (M,) in (0, 1); 1 if the detector has none.
    origin : (M,) index into `ORIGINS`.
    source : (M,) identity of the object; 0 for clutter, −1, −2, … for places.
    """

    frame: I8
    xyxy: F8
    score: F8
    origin: I8
    source: I8


def detect(world: World, shown: Figures, law: DetectorLaw, rng: Rng) -> SimulatedDetections:
    """Detections of objects and false alarms in all frames, in random order within a frame."""
    objects_rng, clutter_rng, order_rng = rng.spawn(3)
    found = [
        _objects(world, shown, law, objects_rng),
        *_false_alarms(world, shown, law, clutter_rng),
    ]
    frame, xyxy, odds, origin, source = (np.concatenate(part) for part in zip(*found, strict=True))
    xyxy = clipped(xyxy, world)
    size = xyxy[:, 2:] - xyxy[:, :2]
    order = order_rng.permutation(len(frame))
    order = order[(size[order] >= _SMALLEST).all(axis=1)]
    order = order[np.argsort(frame[order], kind="stable")]
    order = order[_suppressed(frame[order], xyxy[order], odds[order], law.overlap)]
    score = expit(odds[order]) ** law.score_power
    if law.scores == "none":
        score = np.ones(len(order))
    return SimulatedDetections(
        frame[order] + 1,
        np.round(xyxy[order], 2),
        np.round(np.clip(score, 0.001, 1.0), 4),
        origin[order],
        source[order],
    )


# Frame from 0, box, log odds of the score, origin, source.
_Found = tuple[I8, F8, F8, I8, I8]


def detected(world: World, shown: Figures, law: DetectorLaw, rng: Rng) -> Bool:
    """(T, N) which objects are detected: with probability p_D v^s each, misses in runs."""
    frames, n = shown.visible.shape
    chance = law.p_detect * shown.visible**law.occlusion
    luck = ndtr(wandering(frames, n, law.miss_memory, 1 / world.fps, rng))
    return shown.shown & (luck < chance)


def _objects(world: World, shown: Figures, law: DetectorLaw, rng: Rng) -> _Found:
    """Detections of objects: whole, low, part, merged and double boxes."""
    streams = rng.spawn(7)
    frames, n = shown.visible.shape
    dt = 1 / world.fps
    hits = detected(world, shown, law, streams[0])
    low = shown.shown & ~hits & (streams[1].random((frames, n)) < law.low_share)
    low &= shown.visible > 0.2
    (mean, deviation), _ = SCORE_LAWS[law.scores]
    odds = mean + deviation * wandering(frames, n, _SCORE_MEMORY, dt, streams[2])
    if law.scores in ("sharp", "weak"):
        odds -= _HIDDEN_ODDS * (1 - shown.visible)
    slow = np.where(low, _drawn(LOW_OBJECTS, odds.shape, streams[3]), odds)
    boxes = _noisy(shown.xyxy, law, dt, streams[4])
    loose = low[..., None] * _LOOSE * streams[3].normal(size=boxes.shape)
    boxes = boxes + loose * _sizes(boxes)
    # Kinds of boxes last for a while.
    luck = ndtr(np.stack([wandering(frames, n, _EPISODE, dt, one) for one in streams[5].spawn(3)]))
    origin = np.where(low, 1, 0)
    part = hits & (luck[0] < law.parts + law.parts_hidden * (shown.visible < 0.5))
    cut = part * (boxes[..., 3] - boxes[..., 1]) * streams[6].uniform(0.25, 0.5, n)
    boxes[..., 3] -= cut
    origin[part] = 2
    gone = _merge(boxes, shown, hits & ~part & (luck[1] < law.merging), origin)
    kept = (hits | low) & ~gone
    twice = kept & (luck[2] < law.doubles)
    second = boxes + _DOUBLE * streams[6].normal(size=boxes.shape) * _sizes(boxes)
    k, i = np.nonzero(kept)
    k2, i2 = np.nonzero(twice)
    return (
        np.concatenate([k, k2]),
        np.concatenate([boxes[k, i], second[k2, i2]]),
        np.concatenate([slow[k, i], slow[k2, i2] - 0.8]),
        np.concatenate([origin[k, i], np.full(len(k2), 4)]),
        np.concatenate([shown.identity[k, i], shown.identity[k2, i2]]),
    )


def _drawn(law: tuple[float, float], shape: tuple[int, ...], rng: Rng) -> F8:
    mean, deviation = law
    return mean + deviation * rng.normal(size=shape)


def _sizes(xyxy: F8) -> F8:
    """Width and height of boxes, twice: (…, 4)."""
    size = xyxy[..., 2:] - xyxy[..., :2]
    return np.concatenate([size, size], axis=-1)


def _noisy(xyxy: F8, law: DetectorLaw, dt: float, rng: Rng) -> F8:
    """Boxes with errors of centre and size that have a memory, each object's its own."""
    frames, n = xyxy.shape[:2]
    noise = wandering(frames, 4 * n, law.noise_memory, dt, rng).reshape(frames, n, 4)
    size = xyxy[..., 2:] - xyxy[..., :2]
    centre = (xyxy[..., :2] + xyxy[..., 2:]) / 2 + law.centre_noise * noise[..., :2] * size
    half = size / 2 * np.maximum(1 + law.size_noise * noise[..., 2:], 0.2)
    return np.concatenate([centre - half, centre + half], axis=-1)


def _merge(boxes: F8, shown: Figures, merging: Bool, origin: I8) -> Bool:
    """Give an object that merges the box around it and the one that it hides most, in place; return
    (T, N) the hidden ones, which get no box.
    """
    gone = np.zeros(merging.shape, bool)
    for k, i in zip(*np.nonzero(merging), strict=True):
        overlap = iou(shown.xyxy[k, i][None], shown.xyxy[k])[0]
        behind = shown.shown[k] & (shown.depth[k] > shown.depth[k, i]) & ~gone[k]
        overlap = np.where(behind, overlap, 0.0)
        j = int(overlap.argmax())
        if overlap[j] < _MERGING or gone[k, i]:
            continue
        boxes[k, i, :2] = np.minimum(boxes[k, i, :2], boxes[k, j, :2])
        boxes[k, i, 2:] = np.maximum(boxes[k, i, 2:], boxes[k, j, 2:])
        origin[k, i] = 3
        gone[k, j] = True
    return gone


def _false_alarms(world: World, shown: Figures, law: DetectorLaw, rng: Rng) -> list[_Found]:
    """Uniform clutter, that with low scores, and lasting places."""
    streams = rng.spawn(3)
    sizes = (shown.xyxy[..., 2:] - shown.xyxy[..., :2])[shown.shown]
    if not len(sizes):
        sizes = np.array([[world.size / 2, world.size]])
    _, false = SCORE_LAWS[law.scores]
    return [
        _uniform(world, sizes, law.clutter, (false, 5), streams[0]),
        _uniform(world, sizes, law.low_clutter, (LOW_CLUTTER, 6), streams[1]),
        _lasting(world, shown, sizes, law, streams[2]),
    ]


def _uniform(
    world: World, sizes: F8, rate: float, kind: tuple[tuple[float, float], int], rng: Rng
) -> _Found:
    """Poisson clutter with sizes like those of objects."""
    number = rng.poisson(rate, world.frames)
    frame = np.repeat(np.arange(world.frames), number)
    n = len(frame)
    half = sizes[rng.integers(0, len(sizes), n)] / 2
    half = half * np.exp(_CLUTTER_SIZE * rng.normal(size=(n, 1)))
    centre = rng.uniform(0, 1, (n, 2)) * [world.width, world.height]
    odds, origin = kind
    xyxy = np.concatenate([centre - half, centre + half], axis=1)
    return frame, xyxy, _drawn(odds, (n,), rng), np.full(n, origin), np.zeros(n, np.int64)


def _lasting(world: World, shown: Figures, sizes: F8, law: DetectorLaw, rng: Rng) -> _Found:
    """False alarms of lasting places, which flicker: on for a while, off for a while."""
    k, dt = law.places, 1 / world.fps
    on = np.zeros((world.frames, k), bool)
    state = rng.random(k) < law.place_on / (law.place_on + law.place_off)
    ends = np.array([1 - np.exp(-dt / law.place_off), 1 - np.exp(-dt / law.place_on)])
    for frame in range(world.frames):
        on[frame] = state
        state = state ^ (rng.random(k) < ends[state.astype(int)])
    fires = on & (rng.random((world.frames, k)) < law.place_fires)
    half = sizes[rng.integers(0, len(sizes), k)] / 2
    centre = rng.uniform(0.05, 0.95, (k, 2)) * [world.width, world.height]
    higher = rng.uniform(0, _LASTING_ODDS, k)
    frame, place = np.nonzero(fires)
    n = len(frame)
    # They are things in the scene, so they move with the picture.
    middle = centre[place] + shown.shift[frame] + _PLACE * rng.normal(size=(n, 2)) * half[place] * 2
    xyxy = np.concatenate([middle - half[place], middle + half[place]], axis=1)
    _, false = SCORE_LAWS[law.scores]
    more = 0.0 if law.scores == "uninformative" else higher[place]
    odds = _drawn(false, (n,), rng) + more
    return frame, xyxy, odds, np.full(n, 7), -(place + 1)


def _suppressed(frame: I8, xyxy: F8, odds: F8, overlap: float) -> Bool:
    """Which boxes stay if of two that overlap more the lower score is left out."""
    keep = np.ones(len(frame), bool)
    ends = np.r_[np.flatnonzero(np.diff(frame, prepend=-1)), len(frame)]
    for begin, end in pairwise(ends):
        order = begin + np.argsort(-odds[begin:end], kind="stable")
        over = iou(xyxy[order], xyxy[order]) > overlap
        for k in range(len(order)):
            if keep[order[k]]:
                keep[order[k + 1 :][over[k, k + 1 :]]] = False
    return keep


def iou(one: F8, other: F8) -> F8:
    """(n, m) intersection over union of boxes."""
    low = np.maximum(one[:, None, :2], other[None, :, :2])
    high = np.minimum(one[:, None, 2:], other[None, :, 2:])
    both = np.prod(np.clip(high - low, 0, None), axis=-1)
    area = [np.prod(those[:, 2:] - those[:, :2], axis=1) for those in (one, other)]
    return both / np.maximum(area[0][:, None] + area[1][None] - both, 1e-9)
