"""What is handed from detections to the filter where blobs are explained (`protocols.Explainer`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.types import I8, Detections


@dataclass(frozen=True, slots=True, eq=False)
class Explanation:
    """What the filter is given in the place of a frame's N detections: one of each target.

    Attributes
    ----------
    detections : those N′ that the filter is given.
    source : (N′,) the detection that each rests on; several rest on one that they share.
    part : (N,) the first of the N′ that each detection went into.
    who : (N′,) the expected target that each belongs to, −1 for none.
    changed : False where these are the frame's detections as they were.
    """

    detections: Detections
    source: I8
    part: I8
    who: I8
    changed: bool = False

    @classmethod
    def unchanged(cls, detections: Detections) -> Explanation:
        """The detections as they were, of nobody known."""
        own = np.arange(len(detections))
        return cls(detections, own, own, np.full(len(own), -1))
