"""As many peaks as the distribution of the number of targets says, the heaviest first [V07].

A cardinalised filter knows how many targets there are better than the weight of any single peak tells: when a target was
just missed, its peak is light, and it is still one of them. So the peaks are those of the intensity's own extractor with a
low threshold, and the number is that of the filter: the most probable one (MAP), or the nearest to the mean (EAP). A peak
counts once, however heavy: a weight above 1.5 is more often a target that was seen well than two in one place.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np

from phdtrack.checks import NonNegative, Positive, PositiveCount, Share, check
from phdtrack.filters.extract.components import Components
from phdtrack.filters.extract.kmeans import KMeans
from phdtrack.filters.extract.mixture import Mixture
from phdtrack.filters.intensities import Cardinalised
from phdtrack.protocols import Model, Sensor
from phdtrack.types import F8, Estimates, GaussianMixture, Particles

Count = Literal["map", "eap"]


@dataclass(frozen=True, slots=True)
class CountedComponents:
    """Settings of the extraction from a mixture and the number of its targets.

    Parameters
    ----------
    count : ``map``, the most probable number of targets, or ``eap``, the mean, rounded.
    candidate : components of less weight are no candidates.
    region : squared Mahalanobis radius within which a state counts as resting on a detection.
    merge_iou : states whose boxes overlap by more (IoU) are one object that the detector saw twice; 1 for never.
    """

    count: Count = "map"
    candidate: Positive = 0.05
    region: Positive = 13.28
    merge_iou: Share = 0.4

    def __post_init__(self) -> None:
        check(self)

    def extract(self, state: Cardinalised[GaussianMixture], z: F8, model: Model) -> Estimates:
        """The means of the heaviest components, as many as there are targets [V07]."""
        return heaviest(_components(self).extract(state.intensity, z, model), expected(state.cardinality, self.count))


@dataclass(frozen=True, slots=True)
class CountedMixture:
    """Settings of the extraction from particles by a Gaussian mixture, and the number of their targets.

    Parameters
    ----------
    count : ``map``, the most probable number of targets, or ``eap``, the mean, rounded.
    candidate : components of less mass are no candidates.
    merge : Mahalanobis distance up to which a component is part of a heavier one, in the covariance of that, as the
        Gaussian-mixture filters have it.
    iterations, region, merge_iou : as in `Mixture`.
    """

    count: Count = "map"
    candidate: Positive = 0.05
    merge: NonNegative = 2.0
    iterations: PositiveCount = 6
    region: Positive = 13.28
    merge_iou: Share = 0.4

    def __post_init__(self) -> None:
        check(self)

    def extract(self, state: Cardinalised[Particles], z: F8, model: Model) -> Estimates:
        """The means of the heaviest components, as many as there are targets [V07]."""
        peaks = united(_mixture(self).extract(state.intensity, z, model), self.merge, model.sensor)
        return heaviest(peaks, expected(state.cardinality, self.count))


@dataclass(frozen=True, slots=True)
class CountedKMeans:
    """Settings of the extraction from particles by modified K-means, and the number of their targets.

    Parameters
    ----------
    count : ``map``, the most probable number of targets, or ``eap``, the mean, rounded.
    candidate : clusters of less mass are no candidates.
    iterations, region, merge_iou : as in `KMeans`.
    """

    count: Count = "map"
    candidate: Positive = 0.1
    iterations: PositiveCount = 5
    region: Positive = 13.28
    merge_iou: Share = 0.4

    def __post_init__(self) -> None:
        check(self)

    def extract(self, state: Cardinalised[Particles], z: F8, model: Model) -> Estimates:
        """The centres of the heaviest clusters, as many as there are targets [V07]."""
        return heaviest(_kmeans(self).extract(state.intensity, z, model), expected(state.cardinality, self.count))


# Heavier than any cluster: nothing is divided for its mass.
_NEVER = 1e9


@lru_cache(maxsize=8)
def _components(settings: CountedComponents) -> Components:
    return Components(settings.candidate, region=settings.region, merge_iou=settings.merge_iou)


@lru_cache(maxsize=8)
def _mixture(settings: CountedMixture) -> Mixture:
    return Mixture(settings.candidate, _NEVER, settings.iterations, settings.region, settings.merge_iou)


@lru_cache(maxsize=8)
def _kmeans(settings: CountedKMeans) -> KMeans:
    return KMeans(settings.candidate, _NEVER, settings.iterations, settings.region, settings.merge_iou)


def expected(cardinality: F8, count: Count) -> int:
    """The number of targets that probabilities (n,) of 0, 1, 2, … speak for."""
    if count == "map":
        return int(cardinality.argmax())
    return round(float(cardinality @ np.arange(len(cardinality))))


def heaviest(peaks: Estimates, count: int) -> Estimates:
    """``count`` of the states, or all where there are fewer, in the order that they had."""
    if len(peaks) <= count:
        return peaks
    return peaks.take(np.sort(np.argsort(-peaks.weight, kind="stable")[:count]))


def united(peaks: Estimates, reach: float, sensor: Sensor) -> Estimates:
    """The states, each with the lighter ones that are within ``reach`` of it by its covariance; heaviest first.

    Weights add up, states are averaged, the covariance stays that of the heaviest, and so does its detection, unless it had
    none.
    """
    left, heads = np.argsort(-peaks.weight, kind="stable"), []
    weight, state, detection = peaks.weight.copy(), peaks.state.copy(), peaks.detection.copy()
    while len(left):
        head = left[0]
        step = peaks.state[:, left] - peaks.state[:, [head]]
        near = (step * np.linalg.solve(peaks.covariance[head], step)).sum(axis=0) <= reach**2
        members = left[near]
        weight[head] = peaks.weight[members].sum()
        state[:, head] = peaks.state[:, members] @ peaks.weight[members] / weight[head]
        served = peaks.detection[members]
        detection[head] = next((int(one) for one in served if one >= 0), -1)
        heads.append(head)
        left = left[~near]
    xyxy = sensor.boxes(state)
    return replace(peaks, weight=weight, state=state, xyxy=xyxy, detection=detection).take(np.array(heads, np.int64))
