"""False alarms: Poisson clutter over the whole frame, and places that fire again and again."""

from __future__ import annotations

from typing import Literal

import numpy as np

from phdtrack.arrays import to_xyxy
from phdtrack.errors import InputError
from phdtrack.types import F8, I8, Detections, DetectionTable, SequenceInfo

Sizes = Literal["truth", "log-uniform"]

HEIGHTS = (0.08, 0.5)
"""Log-uniform clutter: heights in frame heights."""
ASPECTS = (1 / 3, 1.0)
"""Log-uniform clutter: width over height."""


def poisson_boxes(info: SequenceInfo, rate: float, sizes: F8, rng: np.random.Generator) -> tuple[I8, F8]:
    """Frames (M,) ascending and boxes (M, 4) of Poisson(``rate``) false alarms in each of the frames 1 … ``info.frames``.

    Centres are uniform over the frame; widths and heights are drawn from the rows of ``sizes`` (S, 2), together, or are
    log-uniform where it has none.
    """
    number = rng.poisson(rate, info.frames)
    frame = np.repeat(np.arange(1, info.frames + 1), number)
    centre = rng.random((len(frame), 2)) * np.array([info.width, info.height])
    size = draw_sizes(info, len(frame), sizes, rng)
    return frame, to_xyxy(np.concatenate([centre, size], axis=1).T)


def draw_sizes(info: SequenceInfo, n: int, sizes: F8, rng: np.random.Generator) -> F8:
    """(n, 2) widths and heights, rows of ``sizes`` (S, 2) or, where it has none, log-uniform in height and in aspect."""
    if len(sizes):
        return sizes[rng.integers(len(sizes), size=n)]
    height = log_uniform(HEIGHTS, n, rng) * info.height
    return np.stack([height * log_uniform(ASPECTS, n, rng), height], axis=1)


def log_uniform(between: tuple[float, float], n: int, rng: np.random.Generator) -> F8:
    """(n,) numbers whose logarithm is uniform between those of the two."""
    low, high = between
    return low * (high / low) ** rng.random(n)


def place_boxes(info: SequenceInfo, n: int, sizes: F8, rng: np.random.Generator) -> F8:
    """(n, 4) boxes of persistent places, each whole inside the frame."""
    edge = np.array([info.width, info.height], dtype=np.float64)
    size = np.minimum(draw_sizes(info, n, sizes, rng), edge)
    corner = rng.random((n, 2)) * (edge - size)
    return np.concatenate([corner, corner + size], axis=1)


def add_clutter(
    table: DetectionTable, info: SequenceInfo, rate: float, rng: np.random.Generator, truth_sizes: F8
) -> DetectionTable:
    """``table`` with Poisson clutter of ``rate`` boxes per frame mixed in, in all frames 1 … ``info.frames``.

    The sizes are drawn from ``truth_sizes`` (S, 2), widths and heights in pixels (log-uniform where it has no rows). Score,
    class and covariance of each false alarm are those of a detection drawn from the table, so that none of them gives it
    away; 1 and 0 where the table is empty. Within a frame the order is random. The table's own detections keep their values.

    Raises
    ------
    InputError : the number of frames is not known, or ``rate`` is not a number of boxes.
    """
    if info.frames < 1:
        raise InputError(
            "the number of frames must be known to add clutter", where=info.name, cure="Count the frames by decoding"
        )
    if not 0 <= rate < np.inf:
        raise InputError(f"a clutter rate is a number of boxes per frame, not {rate}", cure="Give 0 or more")
    boxes_rng, donor_rng, order_rng = rng.spawn(3)
    frame, boxes = poisson_boxes(info, rate, truth_sizes, boxes_rng)
    old = table.detections
    if len(table):
        donor = old.take(donor_rng.integers(len(table), size=len(frame)))
        new = Detections(boxes, donor.confidence, donor.class_id, donor.covariance)
    else:
        new = Detections.of(boxes)
    covariance = None
    if old.covariance is not None and new.covariance is not None:
        covariance = np.concatenate([old.covariance, new.covariance])
    merged = Detections(
        np.concatenate([old.xyxy, new.xyxy]),
        np.concatenate([old.confidence, new.confidence]),
        np.concatenate([old.class_id, new.class_id]),
        covariance,
    )
    frames = np.concatenate([table.frame, frame])
    order = shuffled(frames, order_rng)
    return DetectionTable(frames[order], merged.take(order))


def shuffled(frame: I8, rng: np.random.Generator) -> I8:
    """(M,) an order that sorts by frame and is random within each frame."""
    return np.lexsort((rng.random(len(frame)), frame))
