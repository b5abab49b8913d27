"""States that the sensor cannot tell apart are one.

A detector that suppresses overlapping boxes never reports two objects whose boxes overlap by much; where two states do,
it has fired twice on one object, at two scales or on two parts of it, and the filter, for which every detection is another
target, believes in both. Joining them gives up the second of two objects in line while they cover each other; the
association bridges that gap.
"""

from __future__ import annotations

import heapq

import numpy as np

from phdtrack.kernels.joining import likeness
from phdtrack.protocols import Sensor
from phdtrack.types import F8, I8


def join_unresolved(mass: F8, mean: F8, cov: F8, sensor: Sensor, overlap: float) -> tuple[F8, F8, F8]:
    """Clusters (k,), (d, k), (k, d, d) with those joined whose boxes overlap by more than ``overlap`` (IoU), most first.

    A union keeps mass, mean and covariance of its parts (moment matching).
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
    single = mass
    mass, mean, cov, boxes = mass.copy(), mean.copy(), cov.copy(), boxes.copy()
    # The pair that overlaps most comes first; ``version`` tells the boxes that have been joined since.
    version = np.zeros(len(mass), np.int64)
    alive = np.ones(len(mass), np.bool_)
    waiting = [(-s, i, j, 0, 0) for s, i, j in zip(shared.tolist(), first.tolist(), second.tolist(), strict=True)]
    heapq.heapify(waiting)
    while waiting:
        _, i, j, known_i, known_j = heapq.heappop(waiting)
        if version[i] != known_i or version[j] != known_j:
            continue
        _merge(mass, mean, cov, i, j)
        part[i] = max(part[i], part[j], key=single.__getitem__)
        alive[j] = False
        version[i] += 1
        version[j] = -1
        boxes[i] = sensor.boxes(mean.take([i], axis=1))[0]
        shared = _iou(boxes, boxes[i])
        alive[i] = False
        others = (alive & (shared > overlap)).nonzero()[0]
        alive[i] = True
        for other, s in zip(others.tolist(), shared[others].tolist(), strict=True):
            a, b = min(i, other), max(i, other)
            heapq.heappush(waiting, (-s, a, b, int(version[a]), int(version[b])))
    return mass[alive], mean.compress(alive, axis=1), cov[alive], part[alive]


def resolved(boxes: F8, overlap: float) -> I8:
    """Which of the (n, 4) boxes are left if each goes that overlaps one before it by more than ``overlap`` (IoU)."""
    left = np.ones(len(boxes), np.bool_)
    if overlap < 1 and len(boxes) > 1:
        first, second, _ = likeness(boxes, overlap)
        order = np.lexsort((second, first))
        for i, j in zip(first[order].tolist(), second[order].tolist(), strict=True):
            left[j] &= not left[i]
    return np.flatnonzero(left)


def _iou(a: F8, b: F8) -> F8:
    """(n,) intersection over union of boxes (n, 4), row by row; 0 where both have no area."""
    side = np.minimum(a[:, 2:], b[..., 2:]) - np.maximum(a[:, :2], b[..., :2])
    shared = side.clip(0.0).prod(axis=-1)
    union = (a[:, 2:] - a[:, :2]).prod(axis=-1) + (b[..., 2:] - b[..., :2]).prod(axis=-1) - shared
    out: F8 = np.divide(shared, union, out=np.zeros_like(shared), where=union > 0.0)
    return out


def _merge(mass: F8, mean: F8, cov: F8, i: int, j: int) -> None:
    """Put the union of clusters i and j in the place of i, in the arrays given, which the caller owns."""
    total = mass[i] + mass[j]
    share = mass[j] / total
    step = mean[:, j] - mean[:, i]
    cov[i] = (1 - share) * cov[i] + share * cov[j] + share * (1 - share) * np.outer(step, step)
    mean[:, i] += share * step
    mass[i] = total
