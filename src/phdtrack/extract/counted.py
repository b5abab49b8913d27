"""As many peaks as the distribution of the number of targets says, the heaviest first [V07].

A cardinalised filter knows how many targets there are better than the weight of any single peak tells: when a target was
just missed, its peak is light, and it is still one of them. So the peaks are those of the intensity's own extractor with a
low threshold, and the number is that of the filter: the most probable one (MAP), or the nearest to the mean (EAP).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from phdtrack.checks import Positive, PositiveCount, Share, check
from phdtrack.extract.components import Components
from phdtrack.extract.kmeans import KMeans
from phdtrack.protocols import Model
from phdtrack.types import F8, Cardinalised, Estimates, GaussianMixture, Particles

Count = Literal["map", "eap"]


@dataclass(frozen=True, slots=True)
class CountedComponents:
    """Settings of the extraction from a mixture and the number of its targets.

    Parameters
    ----------
    count : ``map``, the most probable number of targets, or ``eap``, the mean, rounded.
    candidate : components of less weight are no candidates.
    repeat : a component is a candidate as often as its weight says, rounded (see `Components`). Joining is off then.
    region : squared Mahalanobis radius within which a state counts as resting on a detection.
    overlap : states whose boxes overlap by more (IoU) are one object that the detector saw twice; 1 for never.
    """

    count: Count = "map"
    candidate: Positive = 0.05
    repeat: bool = False
    region: Positive = 13.28
    overlap: Share = 0.4

    def __post_init__(self) -> None:
        check(self)

    def extract(self, state: Cardinalised[GaussianMixture], z: F8, model: Model) -> Estimates:
        """The means of the heaviest components, as many as there are targets [V07]."""
        peaks = Components(self.candidate, self.repeat, self.region, self.overlap)
        return heaviest(peaks.extract(state.intensity, z, model), expected(state.cardinality, self.count))


@dataclass(frozen=True, slots=True)
class CountedKMeans:
    """Settings of the extraction from particles and the number of their targets.

    Parameters
    ----------
    count : ``map``, the most probable number of targets, or ``eap``, the mean, rounded.
    candidate : clusters of less mass are no candidates.
    split, iterations, region, overlap : as in `KMeans`.
    """

    count: Count = "map"
    candidate: Positive = 0.1
    split: Positive = 1.5
    iterations: PositiveCount = 5
    region: Positive = 13.28
    overlap: Share = 0.4

    def __post_init__(self) -> None:
        check(self)

    def extract(self, state: Cardinalised[Particles], z: F8, model: Model) -> Estimates:
        """The centres of the heaviest clusters, as many as there are targets [V07]."""
        peaks = KMeans(self.candidate, self.split, self.iterations, self.region, self.overlap)
        return heaviest(peaks.extract(state.intensity, z, model), expected(state.cardinality, self.count))


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
