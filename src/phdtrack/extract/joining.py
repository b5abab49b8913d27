"""Two light clusters near each other are one.

Clusters start on every detection, so one target beside a false alarm, or detected twice, may lie in two halves that are each
too light.
"""

from __future__ import annotations

import numpy as np

from phdtrack.extract.rectangles import Rectangles
from phdtrack.protocols import Sensor
from phdtrack.types import F8, I8


def join_light(mass: F8, mean: F8, sensor: Sensor, reach: float, lightest: float, split: float) -> I8:
    """(k,) the cluster that each has become part of: itself, or another.

    Pairs of clusters lighter than ``lightest`` whose means (d, k) are at most ``reach`` deviations of the noise apart are
    joined, nearest first, while one of the two, with what it was joined to, is too light and the union not above ``split``.
    """
    alone = np.arange(len(mass))
    light = ((mass > 0) & (mass < lightest)).nonzero()[0]
    if len(light) < 2:
        return alone
    first, second, distance2 = _near_pairs(mean.take(light, axis=1), sensor, reach)
    if len(first) == 0:
        return alone
    root, total = alone.tolist(), mass.tolist()
    order = np.lexsort((second, first, distance2))
    for i, j in zip(light[first[order]].tolist(), light[second[order]].tolist(), strict=True):
        a, b = _root_of(i, root), _root_of(j, root)
        if a != b and min(total[a], total[b]) < lightest and total[a] + total[b] <= split:
            root[b] = a
            total[a] += total[b]
    return np.array([_root_of(i, root) for i in root])


def _root_of(i: int, root: list[int]) -> int:
    """What i has become part of in the end."""
    while root[i] != i:
        i = root[i]
    return i


def _near_pairs(x: F8, sensor: Sensor, reach: float) -> tuple[I8, I8, F8]:
    """Pairs i < j of columns of ``x`` within ``reach`` deviations of i's noise, and their scaled distance²."""
    scale = sensor.noise(x)
    side = reach * scale[:2]
    first, second = Rectangles.of(x[:2], x[:2]).meeting(x[:2] - side, x[:2] + side)
    later = second > first
    first, second = first[later], second[later]
    distance2 = np.square((x[:, first] - x[:, second]) / scale[:, first]).sum(axis=0)
    near = distance2 <= reach * reach
    return first[near], second[near], distance2[near]
