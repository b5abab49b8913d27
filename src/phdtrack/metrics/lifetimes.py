"""Scores of whole objects and whole tracks under the tracking mapping: how late, how long, and how many are false.

* Delay of an object: frames from its first in the truth to its first mapped one.
* Delay from the first detection: the same, but from the first frame in which some detection overlaps it at IoU ≥ threshold:
  the figure by which M09 compares birth models.
* A false track: an output identity that is never mapped to any object.
* Mostly tracked: mapped in more than 80 % of its frames; mostly lost: in less than 20 % (as in TrackEval).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.arrays import iou as overlaps
from phdtrack.errors import InputError
from phdtrack.metrics.matching import ROUNDING, Matches, Scene, build, tracking_mapping
from phdtrack.types import F8, I8, DetectionTable, Tracks, Truth


@dataclass(frozen=True, slots=True)
class LifetimeCounts:
    """Numbers of objects and of output identities, and Σ delay over the objects that were ever ``found``."""

    objects: int
    found: int
    delay: int
    mostly_tracked: int
    mostly_lost: int
    identities: int
    false_tracks: int


@dataclass(frozen=True, slots=True, eq=False)
class Delays:
    """Per object: ``identity`` (G,) ascending, ``detected`` and ``mapped`` (G,) first frames, 0 where never, ``delay`` (G,).

    ``delay`` is mapped − detected in frames, negative where the output came first, NaN where either never came.
    """

    identity: I8
    detected: I8
    mapped: I8
    delay: F8


def count_lifetimes(scene: Scene, mapping: Matches) -> LifetimeCounts:
    """The sums of ``scene`` under its tracking ``mapping``."""
    appeared, boxes = (np.zeros(len(scene.truth_identity), np.int64) for _ in range(2))
    for pair in reversed(scene.pairs):
        appeared[pair.truth] = pair.number
        boxes[pair.truth] += 1
    mapped = first_mapped(scene, mapping)
    share = np.bincount(mapping.truth, minlength=len(boxes)) / np.maximum(1, boxes)
    found = mapped > 0
    return LifetimeCounts(
        objects=len(boxes),
        found=int(found.sum()),
        delay=int((mapped - appeared)[found].sum()),
        mostly_tracked=int((share > 0.8).sum()),
        mostly_lost=int((share < 0.2).sum()),
        identities=len(scene.output_identity),
        false_tracks=len(scene.output_identity) - len(np.unique(mapping.output)),
    )


def first_mapped(scene: Scene, mapping: Matches) -> I8:
    """(G,) the first frame in which each object is mapped, 0 where it never is."""
    numbers = np.array([pair.number for pair in scene.pairs], np.int64)
    first = np.zeros(len(scene.truth_identity), np.int64)
    # Backwards, so that the earliest frame is written last.
    first[mapping.truth[::-1]] = numbers[mapping.position[::-1]]
    return first


def first_output_delays(truth: Truth, tracks: Tracks, detections: DetectionTable, iou: float = 0.5) -> Delays:
    """How many frames after its first detection each annotated object is first mapped to an output row.

    Parameters
    ----------
    truth, tracks : as for `evaluate`; distractors do not count.
    detections : the detections that the tracks were made from.
    iou : the overlap at which a detection or an output row is the object's.

    Raises
    ------
    InputError : for rows that `evaluate` would refuse, or a threshold outside (0, 1].
    """
    check_threshold(iou)
    scene = build(truth, tracks)
    mapped = first_mapped(scene, tracking_mapping(scene, iou))
    detected = _first_detected(truth, scene.truth_identity, detections, iou)
    delay = np.where((mapped > 0) & (detected > 0), (mapped - detected).astype(np.float64), np.nan)
    return Delays(scene.truth_identity, detected, mapped, delay)


def check_threshold(iou: float) -> None:
    """Raise `InputError` unless 0 < ``iou`` ≤ 1."""
    if not 0 < iou <= 1:
        raise InputError(f"expected an overlap threshold in (0, 1], got {iou}", where="iou")


def _first_detected(truth: Truth, identity: I8, detections: DetectionTable, threshold: float) -> I8:
    """(G,) the first frame in which a detection overlaps each object at IoU ≥ ``threshold``, 0 where none ever does."""
    first = np.zeros(len(identity), np.int64)
    rows = np.flatnonzero(~truth.distractor)
    rows = rows[np.argsort(truth.frame[rows], kind="stable")]
    starts = np.flatnonzero(np.diff(truth.frame[rows], prepend=0))
    for group in reversed(np.split(rows, starts[1:])):
        if not len(group):
            continue
        number = int(truth.frame[group[0]])
        overlap = overlaps(truth.xyxy[group], detections.at(number).xyxy)
        seen = group[overlap.max(axis=1, initial=0.0) >= threshold - ROUNDING]
        first[np.searchsorted(identity, truth.identity[seen])] = number
    return first
