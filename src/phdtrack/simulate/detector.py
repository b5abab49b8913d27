"""A simulated detector with missed detections, box noise and false alarms.

Each object in the truth is detected with probability p_D (1 − c)^s, where c is the share of it that
nearer objects hide. False alarms are Poisson clutter, uniform over the frame, and persistent
places, each of which fires by chance in every frame. Each part draws from its own random stream:
the detections of the targets do not depend on the clutter, and a higher p_D only adds detections to
those of a lower one.
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
# A noisy width or height stays above this share of the true one.
_MIN_SIZE = 0.2
_MAX_FRAMES = 10_000_000
# Points along each side of the grid on which the hidden share of a box is estimated.
_GRID = 9


@dataclass(frozen=True, slots=True)
class DetectorModel(Checked):
    """Settings of a simulated detector, whose scores are all 1. The defaults are those of the
    clutter cases: p_D 0.9, jitter 5 %.

    Attributes
    ----------
    p_detect : p_D of an object that is not hidden.
    occlusion : exponent s of the visible share: p_D (1 − c)^s. 0: occlusion has no effect.
    jitter, jitter_size : standard deviations of the centre's error, in box widths and heights, and
        of the relative error of width and height.
    clutter_rate : λ, expected Poisson false alarms per frame.
    clutter_of_all_sizes : True for log-uniform sizes of these, False for sizes of the truth.
    places, place_fire, place_jitter : number of persistent places, their probability of firing in
        a frame, their jitter.
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
    """Simulated detections and the origin of each.

    Attributes
    ----------
    table : M detections, ascending in frame, in random order within a frame.
    source : (M,) int64: the identity of the object, 0 for Poisson clutter, −1, −2, … for the
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
    """Simulate detections of the truth in the frames 1 … ``info.frames``. Raises `InputError` if
    that number is unknown, or the truth has rows in other frames.

    Parameters
    ----------
    truth : the objects; rows marked as distractors are not detected.
    info : size and number of frames of the sequence.
    rng : random streams are spawned from it: a new generator with the same seed gives the same
        detections.
    model : settings of the detector.
    obstacles : (K, 4) xyxy of obstacles that hide objects behind them, pixels; for
        ``model.occlusion``.

    Returns
    -------
    The detections, boxes in pixels, and the places of steady false alarms.
    """
    if info.frames < 1 or (
        len(truth) and not 1 <= truth.frame.min() <= truth.frame.max() <= info.frames
    ):
        raise InputError(
            f"expected a truth within the frames 1 … {info.frames}",
            where=info.name,
            cure="Give the number of frames of the sequence in SequenceInfo.frames",
        )
    targets_rng, clutter_rng, places_rng, order_rng = rng.spawn(4)
    sizes = np.zeros((0, 2))
    if not model.clutter_of_all_sizes:
        sizes = to_cxcywh(truth.xyxy[~truth.distractor])[2:].T
    places = place_boxes(info, model.places, sizes, places_rng)

    # Objects. The draw does not depend on p_D.
    draw = targets_rng.random(len(truth))
    boxes = _jittered(truth.xyxy, model.jitter, model.jitter_size, targets_rng)
    p_detect = np.full(len(truth), model.p_detect)
    if model.occlusion:
        hidden = covered(truth, np.zeros((0, 4)) if obstacles is None else obstacles)
        p_detect *= (1 - hidden) ** model.occlusion
    detected = np.flatnonzero((draw < p_detect) & ~truth.distractor)

    # Poisson clutter, and persistent places.
    clutter_frame, clutter_box = _poisson_boxes(info, model.clutter_rate, sizes, clutter_rng)
    fired, place = np.nonzero(places_rng.random((info.frames, model.places)) < model.place_fire)
    place_box = _jittered(places[place], model.place_jitter, model.place_jitter, places_rng)

    frame = np.concatenate([truth.frame[detected], clutter_frame, fired + 1])
    no_source = np.zeros(len(clutter_frame), np.int64)
    source = np.concatenate([truth.identity[detected], no_source, -(place + 1)])
    xyxy = np.concatenate([boxes[detected], clutter_box, place_box])
    order = _shuffled(frame, order_rng)
    table = DetectionTable(frame[order], Detections.of(xyxy[order]))
    return Detected(table, source[order], places)


def add_clutter(
    table: DetectionTable,
    info: SequenceInfo,
    rate: float,
    rng: np.random.Generator,
    truth_sizes: F8,
) -> DetectionTable:
    """Mix Poisson clutter into the ``table``, in all frames 1 … ``info.frames``. Raises
    `InputError` if that number is unknown, or ``rate`` is not a number of boxes.

    Each false alarm gets the score, class and covariance of a detection drawn from the table, so
    that they do not reveal it; score 1 and class 0 if the table is empty. Within a frame the order
    is random.

    Parameters
    ----------
    table : detections, which may come from a real detector.
    info : size and number of frames of the sequence.
    rate : expected false alarms per frame.
    rng : the random generator.
    truth_sizes : (S, 2) widths and heights to draw from, pixels; log-uniform if it has no rows.

    Returns
    -------
    The detections with the false alarms.
    """
    if not 1 <= info.frames <= _MAX_FRAMES:
        raise InputError(
            f"expected a number of frames to add clutter to, at most {_MAX_FRAMES:,}, got"
            f" {info.frames}",
            where=info.name,
            cure="Count the frames. Is a frame number wrong?",
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
    """(M,) share of each box that nearer boxes of its frame or ``obstacles`` (K, 4) hide, to within
    about 1/9 of its area.

    A box with a lower bottom edge is nearer to the camera. The share is estimated on a grid of
    points, so that points that several boxes hide count once.
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
    """(n, 4) xyxy boxes of persistent places, pixels, each entirely inside the frame.

    Parameters
    ----------
    info : size of the frame.
    n : number of places.
    sizes : (S, 2) widths and heights to draw from, pixels; log-uniform if it has no rows.
    rng : the random generator.
    """
    edge = np.array([info.width, info.height], dtype=np.float64)
    size = np.minimum(_draw_sizes(info, n, sizes, rng), edge)
    corner = rng.random((n, 2)) * (edge - size)
    return np.concatenate([corner, corner + size], axis=1)


def _draw_sizes(info: SequenceInfo, n: int, sizes: F8, rng: np.random.Generator) -> F8:
    """(n, 2) widths and heights: rows of ``sizes`` (S, 2), or log-uniform in height and aspect if
    it has none.
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
    """(M,) indices that sort by frame, in random order within each frame."""
    return np.lexsort((rng.random(len(frame)), frame))
