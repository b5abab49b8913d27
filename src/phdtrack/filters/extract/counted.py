"""As many peaks as the distribution of the number of targets says, the heaviest first [V07].

A cardinalised filter knows the number of targets better than the weight of any single peak tells it: when a target was
just missed, its peak is light, and it is still one of them. So the peaks are found with a low threshold and without
division of heavy ones, and as many are reported as the most probable number of targets.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from phdtrack.protocols import Sensor
from phdtrack.types import F8, Estimates

# Lightest peak that is a candidate: a component of a mixture, and a K-means cluster.
LIGHTEST_COMPONENT, LIGHTEST_CLUSTER = 0.05, 0.1
# Heavier than any cluster: none is divided for its mass.
NEVER_SPLIT = 1e9
# Mahalanobis distance up to which a fitted component is part of a heavier one, as in the Gaussian-mixture filters.
MERGE_DISTANCE = 2.0


def heaviest(peaks: Estimates, cardinality: F8) -> Estimates:
    """The heaviest states, as many as the most probable number of targets, in the order that they had.

    ``cardinality`` (n,) : probabilities of 0, 1, 2, … targets.
    """
    count = int(cardinality.argmax())
    if len(peaks) <= count:
        return peaks
    return peaks.take(np.sort(np.argsort(-peaks.weight, kind="stable")[:count]))


def united(peaks: Estimates, sensor: Sensor) -> Estimates:
    """The states, each with the lighter ones within `MERGE_DISTANCE` of it by its covariance; heaviest first.

    Weights add up, states are averaged, the covariance stays that of the heaviest, and so does its detection, unless it had
    none.
    """
    left, heads = np.argsort(-peaks.weight, kind="stable"), []
    weight, state, detection = peaks.weight.copy(), peaks.state.copy(), peaks.detection.copy()
    while len(left):
        head = left[0]
        step = peaks.state[:, left] - peaks.state[:, [head]]
        near = (step * np.linalg.solve(peaks.covariance[head], step)).sum(axis=0) <= MERGE_DISTANCE**2
        members = left[near]
        weight[head] = peaks.weight[members].sum()
        state[:, head] = peaks.state[:, members] @ peaks.weight[members] / weight[head]
        served = peaks.detection[members]
        detection[head] = next((int(one) for one in served if one >= 0), -1)
        heads.append(head)
        left = left[~near]
    xyxy = sensor.boxes(state)
    return replace(peaks, weight=weight, state=state, xyxy=xyxy, detection=detection).take(np.array(heads, np.int64))
