"""Peaks as a Gaussian mixture, fitted by expectation and maximisation to the weighted particles [M09 §III-B].

Started like K-means: on the frame's detections, at rest. Each component has a mass (its share of the intensity), a mean and
a covariance. A component heavier than the split mass is divided along its longest axis; components lighter than 0.5 are
dropped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from phdtrack.errors import Positive, PositiveCount, Share, check
from phdtrack.filters.extract import clusters
from phdtrack.filters.extract.cloud import Cloud
from phdtrack.filters.extract.counted import LIGHTEST_COMPONENT, NEVER_SPLIT, heaviest, united
from phdtrack.filters.extract.resolution import join_unresolved
from phdtrack.filters.extract.settling import REACH, Start, cluster
from phdtrack.filters.intensities import Cardinalised
from phdtrack.kernels.block_em import em_step
from phdtrack.protocols import Model, Sensor
from phdtrack.types import F8, Estimates, GaussianMixture, ParticleBlocks, Particles

Intensity = Particles | ParticleBlocks


@dataclass(frozen=True, slots=True)
class Mixture:
    """Settings of the Gaussian mixture extraction.

    Parameters
    ----------
    min_weight : components of less mass are not targets; M09's 0.5.
    split_weight : components of more mass are several targets (see `extract.kmeans`).
    iterations : EM iterations after the start and after each split.
    merge_iou : states whose boxes overlap by more (IoU) are one object that the detector saw twice; 1 for never.
    counted : of a cardinalised filter, report as many states as its number of targets says; of others it changes nothing.
    """

    min_weight: Positive = 0.5
    split_weight: Positive = 1.5
    iterations: PositiveCount = 6
    merge_iou: Share = 0.4
    counted: bool = True

    def __post_init__(self) -> None:
        check(self)

    def extract(self, state: Intensity | Cardinalised[Particles], z: F8, model: Model) -> Estimates:
        """The means of the components heavy enough to be targets [M09 §III-B]."""
        if not isinstance(state, Cardinalised):
            return self._peaks(state, self.min_weight, self.split_weight, z, model)
        if not self.counted:
            return self._peaks(state.intensity, self.min_weight, self.split_weight, z, model)
        peaks = self._peaks(state.intensity, LIGHTEST_COMPONENT, NEVER_SPLIT, z, model)
        return heaviest(united(peaks, model.sensor), state.cardinality)

    def _peaks(self, state: Intensity, lightest: float, split: float, z: F8, model: Model) -> Estimates:
        """The components of at least the mass ``lightest``; those above ``split`` are divided."""
        if state.mass < lightest:
            return Estimates.empty(model.motion.dim)
        sensor, cloud = model.sensor, Cloud.of(state)
        start = clusters.seeds(cloud, z, sensor, lightest)
        parts = _parts(cloud)
        mixture, scale = self._fit(cloud, parts, *_start(cloud, start, sensor), sensor)
        for _ in range(math.ceil(2 * state.mass / split)):
            if not (mixture.weight > split).any():
                break
            divided = _divide(mixture, scale, split)
            mixture, scale = self._fit(cloud, parts, divided, sensor.noise(divided.mean), sensor)
        kept = mixture.weight >= lightest
        found = join_unresolved(
            mixture.weight[kept], mixture.mean.compress(kept, axis=1), mixture.covariance[kept], sensor, self.merge_iou
        )
        return clusters.finish(*found, z, model)

    def _fit(
        self, cloud: Cloud, parts: tuple[F8, F8], mixture: GaussianMixture, scale: F8, sensor: Sensor
    ) -> tuple[GaussianMixture, F8]:
        """EM iterations [M09 §III-B]: the mixture, and the noise (d, k) at its means as in ``scale``."""
        for _ in range(self.iterations):
            if len(mixture) == 0:
                break
            mass, mean, cov = em_step(
                cloud.state, cloud.weight, cloud.start, cloud.known, cloud.most, *parts,
                mixture.weight, mixture.mean, mixture.covariance, scale, REACH,
            )  # fmt: skip
            mixture, scale = _floored(mass, mean, cov, sensor)
        return mixture, scale


def _parts(cloud: Cloud) -> tuple[F8, F8]:
    """(B, d) Σw·s of each block, where s is x less the point in the block's middle; and the sums of their products."""
    d = len(cloud.state)
    return cloud.known[:, 1 + 3 * d :] - cloud.known[:, :1] * cloud.known[:, 1 + 2 * d : 1 + 3 * d], cloud.second


def _start(cloud: Cloud, start: Start, sensor: Sensor) -> tuple[GaussianMixture, F8]:
    """Components from the nearest-centre clusters, and the noise at their means."""
    found = cluster(cloud, start, math.inf, 0)
    return _floored(found.mass, found.mean, found.covariance, sensor)


def _floored(mass: F8, mean: F8, cov: F8, sensor: Sensor) -> tuple[GaussianMixture, F8]:
    """Components with a floor under their covariances, and the noise (d, k) at their means; what has no mass is left out."""
    # A component of next to no mass has no shape; its particles fall to its neighbours.
    alive = mass > 1e-3
    if not alive.all():
        mass, mean, cov = mass[alive], mean.compress(alive, axis=1), cov[alive]
    scale = sensor.noise(mean)
    floored = cov.copy()
    np.einsum("jrr->jr", floored)[...] += np.square(0.1 * scale).T
    return GaussianMixture(mass, mean, floored), scale


def _divide(mixture: GaussianMixture, noise: F8, split: float) -> GaussianMixture:
    """Divide components heavier than ``split``: a deviation to either side on the longest axis in units of the noise."""
    heavy = mixture.weight > split
    scale = noise.compress(heavy, axis=1).T
    length2, axes = np.linalg.eigh(mixture.covariance[heavy] / (scale[:, :, None] * scale[:, None, :]))
    step = (scale * axes[:, :, -1] * np.sqrt(length2[:, -1:])).T
    weight = np.where(heavy, mixture.weight / 2, mixture.weight)
    mean = mixture.mean.copy()
    mean[:, heavy] -= step
    return GaussianMixture(
        np.concatenate([weight, weight[heavy]]),
        np.hstack([mean, mixture.mean[:, heavy] + step]),
        np.concatenate([mixture.covariance, mixture.covariance[heavy]]),
    )
