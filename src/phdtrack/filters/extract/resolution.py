"""States that the sensor cannot tell apart are one.

A detector that suppresses overlapping boxes never reports two objects whose boxes overlap by much; where two states do,
it has fired twice on one object, at two scales or on two parts of it, and the filter, for which every detection is another
target, believes in both. Joining them gives up the second of two objects in line while they cover each other; the
association bridges that gap.
"""

from __future__ import annotations

import numpy as np

from phdtrack.kernels.joining import likeness
from phdtrack.kernels.unresolved import join_alike
from phdtrack.protocols import Sensor
from phdtrack.types import F8, I8


def join_unresolved(mass: F8, mean: F8, cov: F8, sensor: Sensor, overlap: float) -> tuple[F8, F8, F8]:
    """Clusters (k,), (d, k), (k, d, d) with those joined whose boxes overlap by more than ``overlap`` (IoU), most first.

    A union keeps mass, mean and covariance of its parts (moment matching); its box is taken for the mean of theirs by mass,
    which for states that hold the box it is.
    """
    return joined(mass, mean, cov, sensor, overlap)[:3]


def joined(mass: F8, mean: F8, cov: F8, sensor: Sensor, overlap: float) -> tuple[F8, F8, F8, I8]:
    """The same, and (k,) which of the clusters is the heaviest part of each."""
    part = np.arange(len(mass))
    if len(mass) < 2 or overlap >= 1:
        return mass, mean, cov, part
    boxes = sensor.boxes(mean)
    first, second, shared = likeness(boxes, overlap)
    if len(first) == 0:
        return mass, mean, cov, part
    found: tuple[F8, F8, F8, I8] = join_alike(first, second, shared, boxes, overlap, mass, mean, cov)
    return found
