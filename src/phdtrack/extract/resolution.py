"""States that the sensor cannot tell apart are one.

A detector that suppresses overlapping boxes never reports two objects whose boxes overlap by much; where two states do,
it has fired twice on one object, at two scales or on two parts of it, and the filter, for which every detection is another
target, believes in both. Joining them gives up the second of two objects in line while they cover each other; the
association bridges that gap.
"""

from __future__ import annotations

import numpy as np

from phdtrack.boxes import iou
from phdtrack.protocols import Sensor
from phdtrack.types import F8


def join_unresolved(mass: F8, mean: F8, cov: F8, sensor: Sensor, overlap: float) -> tuple[F8, F8, F8]:
    """Clusters (k,), (d, k), (k, d, d) with those joined whose boxes overlap by more than ``overlap`` (IoU), most first.

    A union keeps mass, mean and covariance of its parts (moment matching).
    """
    mass, mean, cov = mass.copy(), mean.copy(), cov.copy()
    alive = np.ones(len(mass), np.bool_)
    while alive.sum() > 1:
        index = np.flatnonzero(alive)
        boxes = sensor.boxes(np.ascontiguousarray(mean[:, index]))
        shared = np.triu(iou(boxes, boxes), 1)
        a, b = divmod(int(np.argmax(shared)), len(index))
        if shared[a, b] <= overlap:
            break
        i, j = index[a], index[b]
        total = mass[i] + mass[j]
        share = mass[j] / total
        step = mean[:, j] - mean[:, i]
        cov[i] = (1 - share) * cov[i] + share * cov[j] + share * (1 - share) * np.outer(step, step)
        mean[:, i] += share * step
        mass[i] = total
        alive[j] = False
    return mass[alive], np.ascontiguousarray(mean[:, alive]), cov[alive]
