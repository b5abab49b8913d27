"""A detector's behaviour, simulated: it misses, it is not exact, and it reports what is not there.

Each object in the truth is detected with probability p_D (1 − c)^s, c its part hidden by nearer ones; the reported centre
and size have Gaussian errors in proportion to the box. On top come Poisson clutter, uniform over the frame, and persistent
places, each of which fires by chance in every frame. The parts draw from random streams of their own, so that the
detections of the targets are the same whatever the clutter, and a higher p_D only adds to those of a lower one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from phdtrack.arrays import to_cxcywh, to_xyxy
from phdtrack.errors import InputError
from phdtrack.simulate.clutter import Sizes, place_boxes, poisson_boxes, shuffled
from phdtrack.simulate.cover import covered
from phdtrack.simulate.records import Detected
from phdtrack.types import F8, I8, Detections, DetectionTable, SequenceInfo, Truth

SMALLEST = 0.2
"""A jittered width or height stays above this part of the true one."""


@dataclass(frozen=True, slots=True)
class DetectorModel:
    """Settings of a simulated detector. The defaults are those of the clutter cases: p_D 0.9, jitter 5 %.

    Attributes
    ----------
    p_detect : p_D of an object that nothing hides.
    occlusion : exponent s of the visible part: p_D (1 − c)^s. 0: hidden objects are detected as well as others.
    jitter : standard deviation of the centre's error, in box widths and heights.
    jitter_size : standard deviation of the relative error of width and height.
    clutter_rate : λ, expected Poisson false alarms per frame.
    clutter_sizes : ``truth`` draws their sizes from the truth's boxes, ``log-uniform`` from a range of sizes and shapes.
    places, place_fire, place_jitter : number of persistent places, their probability to fire in a frame, their jitter.
    scores : ``constant`` 1; ``informative``: Beta(6, 2) for objects and Beta(2, 4) for false alarms.
    """

    p_detect: float = 0.9
    occlusion: float = 0.0
    jitter: float = 0.05
    jitter_size: float = 0.05
    clutter_rate: float = 2.0
    clutter_sizes: Sizes = "truth"
    places: int = 0
    place_fire: float = 0.5
    place_jitter: float = 0.1
    scores: Literal["constant", "informative"] = "constant"

    def __post_init__(self) -> None:
        for name, value in (("p_detect", self.p_detect), ("place_fire", self.place_fire)):
            if not 0 <= value <= 1:
                raise InputError(
                    f"{name} is a probability, not {value}", where="detector model", cure="Give a number from 0 to 1"
                )
        amounts = (self.occlusion, self.jitter, self.jitter_size, self.clutter_rate, self.places, self.place_jitter)
        if not all(0 <= amount < np.inf for amount in amounts):
            raise InputError(
                f"occlusion, jitter, jitter_size, clutter_rate, places and place_jitter must not be negative, not {amounts}",
                where="detector model",
                cure="Give 0 or more",
            )
        if self.clutter_sizes not in ("truth", "log-uniform") or self.scores not in ("constant", "informative"):
            raise InputError(
                f"clutter_sizes {self.clutter_sizes!r} and scores {self.scores!r} are not both known",
                where="detector model",
                cure="clutter_sizes is 'truth' or 'log-uniform', scores 'constant' or 'informative'",
            )


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """Detections of one origin: ``frame`` (M,), ``xyxy`` (M, 4), ``score`` (M,), ``source`` (M,)."""

    frame: I8
    xyxy: F8
    score: F8
    source: I8


def detect(
    truth: Truth,
    info: SequenceInfo,
    rng: np.random.Generator,
    settings: DetectorModel,
    *,
    obstacles: F8 | None = None,
) -> Detected:
    """Simulate a detector on the truth in the frames 1 … ``info.frames``.

    Rows of ``truth`` marked as distractors are not detected. ``obstacles`` (K, 4) hide what is behind them, for
    ``settings.occlusion``. Draws from streams spawned from ``rng``: give a fresh generator of the same seed to get the same.

    Raises
    ------
    InputError : the number of frames is not known, or the truth has rows outside of it.
    """
    if info.frames < 1 or (len(truth) and not 1 <= truth.frame.min() <= truth.frame.max() <= info.frames):
        raise InputError(
            f"the truth must lie within the frames 1 … {info.frames}",
            where=info.name,
            cure="Give the number of frames of the sequence in SequenceInfo.frames",
        )
    targets_rng, poisson_rng, places_rng, order_rng = rng.spawn(4)
    real = np.flatnonzero(~truth.distractor)
    sizes = to_cxcywh(truth.xyxy[real])[2:].T if settings.clutter_sizes == "truth" else np.zeros((0, 2))
    persistent, places = _places(info, sizes, places_rng, settings)
    parts = (
        _targets(truth, np.zeros((0, 4)) if obstacles is None else obstacles, targets_rng, settings),
        _poisson(info, sizes, poisson_rng, settings),
        persistent,
    )
    frame, source = np.concatenate([p.frame for p in parts]), np.concatenate([p.source for p in parts])
    order = shuffled(frame, order_rng)
    boxes = Detections.of(np.concatenate([p.xyxy for p in parts]), np.concatenate([p.score for p in parts]))
    return Detected(DetectionTable(frame[order], boxes.take(order)), source[order], places)


def jittered(xyxy: F8, centre: float, size: float, rng: np.random.Generator) -> F8:
    """(n, 4) the boxes with Gaussian errors: ``centre`` and ``size`` are standard deviations in widths and heights."""
    box = to_cxcywh(xyxy)
    extent = box[2:]
    moved = box[:2] + rng.normal(size=extent.shape) * centre * extent
    scaled = np.maximum(1 + rng.normal(size=extent.shape) * size, SMALLEST) * extent
    return to_xyxy(np.concatenate([moved, scaled]))


def _targets(truth: Truth, obstacles: F8, rng: np.random.Generator, settings: DetectorModel) -> _Part:
    """The detections of the objects."""
    lot = rng.random(len(truth))
    boxes = jittered(truth.xyxy, settings.jitter, settings.jitter_size, rng)
    score = _score(len(truth), (6, 2), rng, settings)
    p_detect = np.full(len(truth), settings.p_detect)
    if settings.occlusion:
        p_detect *= (1 - covered(truth, obstacles)) ** settings.occlusion
    kept = np.flatnonzero((lot < p_detect) & ~truth.distractor)
    return _Part(truth.frame[kept], boxes[kept], score[kept], truth.identity[kept])


def _poisson(info: SequenceInfo, sizes: F8, rng: np.random.Generator, settings: DetectorModel) -> _Part:
    """The false alarms that may be anywhere."""
    frame, boxes = poisson_boxes(info, settings.clutter_rate, sizes, rng)
    return _Part(frame, boxes, _score(len(frame), (2, 4), rng, settings), np.zeros(len(frame), np.int64))


def _places(info: SequenceInfo, sizes: F8, rng: np.random.Generator, settings: DetectorModel) -> tuple[_Part, F8]:
    """The false alarms of the persistent places, and the places (P, 4)."""
    places = place_boxes(info, settings.places, sizes, rng)
    frame, place = np.nonzero(rng.random((info.frames, settings.places)) < settings.place_fire)
    boxes = jittered(places[place], settings.place_jitter, settings.place_jitter, rng)
    return _Part(frame + 1, boxes, _score(len(frame), (2, 4), rng, settings), -(place + 1)), places


def _score(n: int, beta: tuple[float, float], rng: np.random.Generator, settings: DetectorModel) -> F8:
    """(n,) scores."""
    return rng.beta(*beta, size=n) if settings.scores == "informative" else np.ones(n)
