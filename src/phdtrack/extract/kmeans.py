"""Modified K-means: states are the centres of clusters of particles [M07 §3].

Clusters start on the frame's detections with zero velocity. While a cluster is heavier than the split mass, a new centre
is put on its particle farthest from the centre; clusters lighter than a threshold are dropped.

The paper splits above mass 1. But one well-seen target settles at up to 1/(1 − p_M p_S): 1.05 at p_D = 0.95 and 1.42 at
p_D = 0.7, so its halves would both fall below the threshold of 0.6 and it would vanish. The split mass here is 1.5: above
what one target can weigh down to p_D = 0.67, below what two weigh once they are believed, and half of it is still above the
threshold.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.checks import Positive, PositiveCount, Share, check
from phdtrack.extract import clusters
from phdtrack.extract.resolution import join_unresolved
from phdtrack.kernels.pairs import moments
from phdtrack.protocols import Model, Sensor
from phdtrack.types import F8, I8, Estimates, Particles


@dataclass(frozen=True, slots=True)
class KMeans:
    """Settings of the modified K-means.

    Parameters
    ----------
    lightest : T, clusters of less mass are not targets; M07's 0.6.
    split : clusters of more mass are several targets.
    iterations : bound on K-means iterations after each split.
    region : squared Mahalanobis radius within which a state counts as resting on a detection (99 % in four dimensions).
    overlap : states whose boxes overlap by more (IoU) are one object that the detector saw twice; 1 for never.
    """

    lightest: Positive = 0.6
    split: Positive = 1.5
    iterations: PositiveCount = 5
    region: Positive = 13.28
    overlap: Share = 0.4

    def __post_init__(self) -> None:
        check(self)

    def extract(self, state: Particles, z: F8, model: Model) -> Estimates:
        """The centres of the clusters heavy enough to be targets: weighted means of full states [M07 §3]."""
        if state.mass < self.lightest:
            return Estimates.empty(model.motion.dim)
        centres = clusters.seeds(state, z, model.sensor, self.lightest)
        centres, labels = self._settle(state, centres, model.sensor)
        # Each split adds a cluster, and a mass M holds at most M/split too heavy ones: the bound only guards rounding.
        for _ in range(int(np.ceil(2 * state.mass / self.split))):
            heavy = self._farthest_in_heavy(state, centres, labels, model.sensor)
            if len(heavy) == 0:
                break
            centres, labels = self._settle(state, np.hstack([centres, state.state[:, heavy]]), model.sensor)
        labels = self._join_light(state, centres, labels, model.sensor)
        mass, mean, cov = self._moments(state, labels, centres.shape[1])
        kept = mass >= self.lightest
        found = join_unresolved(mass[kept], mean[:, kept], cov[kept], model.sensor, self.overlap)
        return clusters.finish(*found, z, model, self.region)

    def _settle(self, state: Particles, centres: F8, sensor: Sensor) -> tuple[F8, I8]:
        """Iterate assignment and means until nothing moves between clusters; clusters without particles are left out."""
        labels, _ = clusters.label(state, centres, sensor)
        for _ in range(self.iterations):
            mass, mean, _ = self._moments(state, labels, centres.shape[1])
            centres = np.ascontiguousarray(mean[:, mass > 0])
            before = labels
            labels, _ = clusters.label(state, centres, sensor)
            renumber = np.append(np.cumsum(mass > 0) - 1, -1)
            if np.array_equal(labels, renumber[before]):
                break
        return centres, labels

    def _farthest_in_heavy(self, state: Particles, centres: F8, labels: I8, sensor: Sensor) -> I8:
        """For each cluster heavier than the split mass, its particle farthest from the centre [M07 §3]."""
        mass, _, _ = self._moments(state, labels, centres.shape[1])
        heavy = np.flatnonzero(mass > self.split)
        if len(heavy) == 0:
            return heavy
        _, distance2 = clusters.label(state, centres, sensor)
        chosen = [int(np.argmax(np.where(labels == j, distance2, -1.0))) for j in heavy]
        # A cluster whose particles all stand on its centre cannot be divided.
        return np.array([i for i in chosen if distance2[i] > 0], np.int64)

    def _join_light(self, state: Particles, centres: F8, labels: I8, sensor: Sensor) -> I8:
        """Join light clusters that are near each other.

        Clusters start on every detection, so one target beside a false alarm, or detected twice, may lie in two halves
        that are each too light. Two light neighbours are joined, nearest first, while the union is not too heavy.
        """
        labels = labels.copy()
        mass, mean, _ = self._moments(state, labels, centres.shape[1])
        light = np.flatnonzero((mass > 0) & (mass < self.lightest))
        if len(light) < 2:
            return labels
        scale = sensor.noise(np.ascontiguousarray(mean[:, light]))
        step = (mean[:, light, None] - mean[:, None, light]) / scale[:, :, None]
        distance2 = (step**2).sum(0)
        a, b = np.nonzero(np.triu(distance2 <= clusters.REACH**2, 1))
        root = np.arange(len(mass))
        for p in np.argsort(distance2[a, b], kind="stable"):
            i, j = root[light[a[p]]], root[light[b[p]]]
            if i != j and min(mass[i], mass[j]) < self.lightest and mass[i] + mass[j] <= self.split:
                root[root == j] = i
                mass[i] += mass[j]
                mass[j] = 0.0
        inside = labels >= 0
        labels[inside] = root[labels[inside]]
        return labels

    def _moments(self, state: Particles, labels: I8, k: int) -> tuple[F8, F8, F8]:
        """Mass, mean and covariance of each cluster."""
        point = np.flatnonzero(labels >= 0)
        result: tuple[F8, F8, F8] = moments(state.state, state.weight[point], point, labels[point], k)
        return result
