"""The looks of the measurements of a whole sequence, and how alike means of them are [APP (5)]."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from phdtrack.kernels.appearance import Looks, free_parts, likeness, plain
from phdtrack.types import F4, F8, I8, MeasurementHistory


@dataclass(frozen=True, slots=True, eq=False)
class SequenceLooks:
    """The descriptors of Z measurements, and what the stream has taught of similarity.

    Attributes
    ----------
    unit : (Z, D) of length one; zeros where nothing is known.
    weight : (Z,) the free part of each box, 0 where nothing is known.
    frame : what similarity says, with no detections.
    interval : the median of the seconds between frames.
    """

    unit: F4
    weight: F8
    frame: Looks
    interval: float

    @classmethod
    def of(
        cls, measurements: MeasurementHistory, boxes: F8, looks: Looks | None, rate: float
    ) -> SequenceLooks | None:
        """The descriptors of measurements; None where the stream has none, or has others by now.

        Parameters
        ----------
        measurements, boxes : of the sequence, and the box (Z, 4) of each.
        looks : what the stream has taught.
        rate : time units of the measurements a second.
        """
        raw = measurements.embeddings
        if looks is None or not len(raw) or raw.shape[1] != looks.raw.shape[1]:
            return None
        length = np.sqrt(np.einsum("nd,nd->n", raw, raw))
        unit = raw / np.maximum(length, 1e-9)[:, None].astype(np.float32)
        frames = zip(measurements.start[:-1], measurements.start[1:], strict=True)
        free = np.concatenate(
            [free_parts(np.ascontiguousarray(boxes[begin:end])) for begin, end in frames]
        )
        steps = np.diff(measurements.seconds(rate))
        interval = float(np.median(steps)) if len(steps) else 0.0
        return cls(unit, free * (length > 0), looks, interval)

    def independent(self, count: F8) -> F8:
        """How many independent descriptors so many of neighbouring frames are worth."""
        kept = math.exp(-self.interval / self.frame.law.independent)
        return np.maximum(count * (1 - kept) / (1 + kept), np.minimum(count, 1.0))

    def likeness(self, mean: F4, number: F8, seconds: F8, before: I8, after: I8) -> F8:
        """(P,) log-likelihood ratios that two means are of one object; 0 where one is not known.

        Parameters
        ----------
        mean, number : (M, D), (M,) means, and of how many independent descriptors each is.
        seconds : (M,) for how long an object must have looked odd if that is why means differ.
        before, after : (P,) which means are compared.
        """
        ratio: F8 = likeness(mean, number, seconds, before, after, plain(self.frame))
        return ratio
