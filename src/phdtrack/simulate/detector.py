"""A simulated detector: it misses objects, its boxes are not exact, and it reports what is not
there.

Each object in the truth is detected with probability p_D (1 − c)^s, c its part hidden by nearer
ones. On top come Poisson clutter, uniform over the frame, and places that fire by chance in every
frame. The parts draw from separate random streams: the detections of the targets are the same
whatever the clutter, and a higher p_D only adds to those of a lower one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from phdtrack.arrays import to_cxcywh, to_xyxy
from phdtrack.errors import Checked, Count, InputError, NonNegative, Probability
from phdtrack.types import F8, I8, Detections, DetectionTable, SequenceInfo, Truth

HEIGHTS = (0.08, 0.5)
ASPECTS = (1 / 3, 1.0)
"""Log-uniform clutter: heights in frame heights, and width over height."""
# A jittered width or height stays above this part of the true one.
_MIN_SIZE = 0.2
_MOST_FRAMES = 10_000_000
# Points a side at which it is seen how much of a box is hidden.
_GRID = 9


@dataclass(frozen=True, slots=True)
class DetectorModel(Checked):
    """Settings of a simulated detector, whose scores are all 1. Defaults are of the clutter cases:
    p_D 0.9, jitter 5 %.

    Attributes
    ----------
    p_detect : p_D of an object that nothing hides.
    occlusion : exponent s of the visible part: p_D (1 − c)^s. 0: hidden objects are detected as
        well as others.
    jitter, jitter_size : standard deviations of the centre's error, in box widths and heights, and
        of the relative error of width and height.
    clutter_rate : λ, expected Poisson false alarms per frame.
    clutter_of_all_sizes : whether their sizes are log-uniform, and not drawn from the truth's
        boxes.
    places, place_fire, place_jitter : number of persistent places, their probability to fire in a
        frame, their jitter.
    """

    p_detect: Probability = 0.9
    occlusion: NonNegative = 0.0
    jitter: NonNegative = 0.05
    jitter_size: NonNegative = 0.05
    clutter_rate: NonNegative = 2.0
    clutter_of_all_sizes: bool = False
    places: Count = 0
    place_fire: Probability = 0.5
    place_jitter: NonNegative = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Detected:
    """Simulated detections and where each came from.

    Attributes
    ----------
    table : M detections, ascending in frame, in random order within a frame.
    source : (M,) int64: the identity it came from, 0 for Poisson clutter, −1, −2, … for the
        persistent places.
    places : (P, 4) xyxy of the persistent places, pixels: place p is ``source`` −(p + 1).
    """

    table: DetectionTable
    source: I8
    places: F8


def detect(
    truth: Truth,
    info: SequenceInfo,
    rng: np.random.Generator,
    model: DetectorModel,
    *,
    obstacles: F8 | None = None,
) -> Detected:
    """Simulated detections of the truth in the frames 1 … ``info.frames``, and where each came
    from. Raises `InputError` where that number is not known, or the truth has rows outside of it.

    Parameters
    ----------
    truth : the objects; rows marked as distractors are not detected.
    info : size and number of frames of the sequence.
    rng : streams are spawned from it: a fresh generator of the same seed gives the same detections.
    model : settings of the detector.
    obstacles : (K, 4) xyxy of things that hide what is behind them, pixels; for
        ``model.occlusion``.
    """
    if info.frames < 1 or (
        len(truth) and not 1 <= truth.frame.min() <= truth.frame.max() <= info.frames
    ):
        problem = f"expected a truth within the frames 1 … {info.frames}"
        raise InputError(
            problem,
            where=info.name,
            cure="Give the number of frames of the sequence in SequenceInfo.frames",
        )
    targets_rng, clutter_rng, places_rng, order_rng = rng.spawn(4)
    sizes = to_cxcywh(truth.xyxy[~truth.distractor])[2:].T[
        : 0 if model.clutter_of_all_sizes else None
    ]
    places = place_boxes(info, model.places, sizes, places_rng)

    # Objects: a number drawn for each decides whether it is detected.
    lot = targets_rng.random(len(truth))
    boxes = _jittered(truth.xyxy, model.jitter, model.jitter_size, targets_rng)
    p_detect = np.full(len(truth), model.p_detect)
    if model.occlusion:
        p_detect *= (
            1 - covered(truth, np.zeros((0, 4)) if obstacles is None else obstacles)
        ) ** model.occlusion
    kept = np.flatnonzero((lot < p_detect) & ~truth.distractor)

    # Poisson clutter, and persistent places.
    at, false = _poisson_boxes(info, model.clutter_rate, sizes, clutter_rng)
    fired, place = np.nonzero(places_rng.random((info.frames, model.places)) < model.place_fire)
    place_box = _jittered(places[place], model.place_jitter, model.place_jitter, places_rng)

    frame = np.concatenate([truth.frame[kept], at, fired + 1])
    source = np.concatenate([truth.identity[kept], np.zeros(len(at), np.int64), -(place + 1)])
    found = np.concatenate([boxes[kept], false, place_box])
    order = _shuffled(frame, order_rng)
    return Detected(
        DetectionTable(frame[order], Detections.of(found[order])), source[order], places
    )


def add_clutter(
    table: DetectionTable,
    info: SequenceInfo,
    rate: float,
    rng: np.random.Generator,
    truth_sizes: F8,
) -> DetectionTable:
    """``table`` with Poisson clutter mixed in, in all frames 1 … ``info.frames``. Raises
    `InputError` where that number is not known, or ``rate`` is not a number of boxes.

    Score, class and covariance of each false alarm are those of a detection drawn from the table,
    so that they do not give it away; 1 and 0 where the table is empty. Within a frame the order is
    random.

    Parameters
    ----------
    table : detections, which may come from a real detector.
    info : size and number of frames of the sequence.
    rate : expected false alarms per frame.
    rng : draws them.
    truth_sizes : (S, 2) widths and heights to draw from, pixels; log-uniform where it has no rows.
    """
    if not 1 <= info.frames <= _MOST_FRAMES:
        problem = (
            f"expected a known number of frames to add clutter to, at most {_MOST_FRAMES:,}, came"
            f" {info.frames}"
        )
        raise InputError(
            problem, where=info.name, cure="Count the frames. Is a frame number wrong?"
        )
    if not 0 <= rate < np.inf:
        raise InputError(
            f"expected a clutter rate in boxes per frame, got {rate}", cure="Give 0 or more"
        )
    boxes_rng, donor_rng, order_rng = rng.spawn(3)
    frame, boxes = _poisson_boxes(info, rate, truth_sizes, boxes_rng)
    merged = Detections.of(boxes)
    frames = np.concatenate([table.frame, frame])
    if len(table):
        rows = np.append(np.arange(len(table)), donor_rng.integers(len(table), size=len(frame)))
        merged = replace(
            table.detections.select(rows), xyxy=np.concatenate([table.detections.xyxy, boxes])
        )
    order = _shuffled(frames, order_rng)
    return DetectionTable(frames[order], merged.select(order), table.empty, table.names)


def covered(truth: Truth, obstacles: F8) -> F8:
    """(M,) part of each box that nearer boxes of its frame or ``obstacles`` (K, 4) hide, to within
    about 1/9 of its area.

    A box with a lower edge is nearer to the camera. Estimated on a grid of points, so that what
    several boxes hide together counts once.
    """
    hidden = np.zeros(len(truth))
    steps = (np.arange(_GRID) + 0.5) / _GRID
    for number in np.unique(truth.frame):
        rows = np.arange(*np.searchsorted(truth.frame, [number, number + 1]))
        boxes = truth.xyxy[rows]
        hiders = np.concatenate([boxes, obstacles])
        x = boxes[:, :1] + steps * (boxes[:, 2:3] - boxes[:, :1])
        y = boxes[:, 1:2] + steps * (boxes[:, 3:4] - boxes[:, 1:2])
        in_x = (x[:, :, None] > hiders[:, 0]) & (x[:, :, None] < hiders[:, 2])
        in_y = (y[:, :, None] > hiders[:, 1]) & (y[:, :, None] < hiders[:, 3])
        nearer = hiders[None, :, 3] > boxes[:, None, 3]
        hidden[rows] = (
            (in_x[:, :, None] & in_y[:, None] & nearer[:, None, None]).any(axis=3).mean(axis=(1, 2))
        )
    return hidden


def _poisson_boxes(
    info: SequenceInfo, rate: float, sizes: F8, rng: np.random.Generator
) -> tuple[I8, F8]:
    """Frames (M,), ascending, and boxes (M, 4) of false alarms uniform over the frame."""
    frame = np.repeat(np.arange(1, info.frames + 1), rng.poisson(rate, info.frames))
    centre = rng.random((len(frame), 2)) * np.array([info.width, info.height])
    size = _draw_sizes(info, len(frame), sizes, rng)
    return frame, to_xyxy(np.concatenate([centre, size], axis=1).T)


def place_boxes(info: SequenceInfo, n: int, sizes: F8, rng: np.random.Generator) -> F8:
    """(n, 4) xyxy boxes of persistent places, pixels, each whole inside the frame.

    Parameters
    ----------
    info : size of the frame.
    n : number of places.
    sizes : (S, 2) widths and heights to draw from, pixels; log-uniform where it has no rows.
    rng : draws them.
    """
    edge = np.array([info.width, info.height], dtype=np.float64)
    size = np.minimum(_draw_sizes(info, n, sizes, rng), edge)
    corner = rng.random((n, 2)) * (edge - size)
    return np.concatenate([corner, corner + size], axis=1)


def _draw_sizes(info: SequenceInfo, n: int, sizes: F8, rng: np.random.Generator) -> F8:
    """(n, 2) widths and heights, rows of ``sizes`` (S, 2) or, where it has none, log-uniform in
    height and in aspect.
    """
    if len(sizes):
        return sizes[rng.integers(len(sizes), size=n)]
    height, aspect = (low * (high / low) ** rng.random(n) for low, high in (HEIGHTS, ASPECTS))
    return np.stack([info.height * height * aspect, info.height * height], axis=1)


def _jittered(xyxy: F8, centre: float, size: float, rng: np.random.Generator) -> F8:
    """(n, 4) the boxes with Gaussian errors: ``centre`` and ``size`` are standard deviations in
    widths and heights.
    """
    box = to_cxcywh(xyxy)
    extent = box[2:]
    moved = box[:2] + rng.normal(size=extent.shape) * centre * extent
    scaled = np.maximum(1 + rng.normal(size=extent.shape) * size, _MIN_SIZE) * extent
    return to_xyxy(np.concatenate([moved, scaled]))


def _shuffled(frame: I8, rng: np.random.Generator) -> I8:
    """(M,) an order that sorts by frame and is random within each frame."""
    return np.lexsort((rng.random(len(frame)), frame))
