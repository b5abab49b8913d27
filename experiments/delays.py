"""Delays from an object's first detection to its first mapped output, as M09 uses them to compare
birth models.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.arrays import iou as overlaps
from phdtrack.metrics.matching import above, pair_frames, tracking_mapping
from phdtrack.types import F8, I8, DetectionTable, Tracks, Truth


@dataclass(frozen=True, slots=True, eq=False)
class Delays:
    """Per object: ``identity`` (G,) ascending, the first frames ``detected`` and ``mapped`` (G,), 0
    for never, and ``delay`` (G,).

    ``delay`` is mapped − detected in frames, negative if the output came first, NaN if either is
    missing.
    """

    identity: I8
    detected: I8
    mapped: I8
    delay: F8


def first_output_delays(
    truth: Truth, tracks: Tracks, detections: DetectionTable, iou: float = 0.5
) -> Delays:
    """The number of frames from each annotated object's first detection to its first mapped output
    row.

    Distractors do not count. A detection or an output row belongs to an object if they overlap by
    ``iou``.
    """
    sequence = pair_frames(truth, tracks)
    mapped = tracking_mapping(sequence, iou).first_frames(sequence)
    detected = np.zeros_like(mapped)
    for number in np.unique(truth.frame)[::-1].tolist():
        rows = np.flatnonzero((truth.frame == number) & ~truth.distractor)
        overlap = above(overlaps(truth.xyxy[rows], detections.at(number).xyxy), iou)
        seen = truth.identity[rows[overlap.max(axis=1, initial=0.0) > 0]]
        detected[np.searchsorted(sequence.truth_identity, seen)] = number
    delay = np.where((mapped > 0) & (detected > 0), (mapped - detected).astype(np.float64), np.nan)
    return Delays(sequence.truth_identity, detected, mapped, delay)
