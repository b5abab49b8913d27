"""What a simulation gives: a scene, and what a world must offer to become one.

A *world* (`Scenario`, `Counting`) says which figures are where in which frame. The part of them that an annotator would
mark is the truth; a `DetectorModel` turns the truth into detections; the renderer turns the figures into pictures.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from phdtrack.types import F8, I8, DetectionTable, SequenceInfo, Truth


@dataclass(frozen=True, slots=True, eq=False)
class Detected:
    """Simulated detections and where each came from.

    Attributes
    ----------
    table : M detections, ascending in frame, in random order within a frame.
    source : (M,) int64: the identity it came from, 0 for Poisson clutter, −1, −2, … for the persistent places.
    places : (P, 4) xyxy of the persistent places, pixels: place p is ``source`` −(p + 1).
    """

    table: DetectionTable
    source: I8
    places: F8


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A simulated sequence.

    Attributes
    ----------
    info : size, rate, number of frames and name.
    truth : what an annotator would mark, boxes clipped to the frame (not clipped in `constant`).
    figures : what the renderer draws: all figures of which any part is in the frame, boxes not clipped.
    detections : M simulated detections of the truth, with clutter.
    source : (M,) int64 where each came from, as in `Detected`.
    places : (P, 4) xyxy of the places with persistent clutter, where the renderer lets leaves wave.
    obstacles : (K, 4) xyxy of standing things that hide who is behind them, pixels.
    doors : (D, 4) xyxy of the doors in which figures appear or vanish, pixels.
    """

    info: SequenceInfo
    truth: Truth
    figures: Truth
    detections: DetectionTable
    source: I8
    places: F8
    obstacles: F8
    doors: F8


class World(Protocol):
    """Figures that come, move and go."""

    @property
    def info(self) -> SequenceInfo:
        """Size, rate, number of frames and name of the sequence."""

    @property
    def obstacles_px(self) -> F8:
        """(K, 4) xyxy of standing things that hide who is behind them, pixels."""

    @property
    def doors_px(self) -> F8:
        """(D, 4) xyxy of the doors in which figures appear or vanish, pixels."""

    def figures(self, rng: np.random.Generator) -> Truth:
        """All figures with any part in the frame, sorted by frame, then identity; boxes not clipped."""

    def truth(self, figures: Truth) -> Truth:
        """What an annotator would mark of them."""


def rows(frame: I8, identity: I8, xyxy: F8) -> Truth:
    """A `Truth` of these rows, sorted by frame, then identity, in which every row counts."""
    order = np.lexsort((identity, frame))
    return Truth(frame[order], identity[order], xyxy[order], np.zeros(len(frame), np.bool_))
