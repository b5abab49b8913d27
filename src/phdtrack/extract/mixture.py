"""Peaks as a Gaussian mixture, fitted by expectation and maximisation to the weighted particles [M09 §III-B].

Started like K-means: on the frame's detections, at rest. Each component has a mass (its share of the intensity), a mean and
a covariance. A component heavier than the split mass is divided along its longest axis; components lighter than 0.5 are
dropped.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.checks import Positive, PositiveCount, Share, check
from phdtrack.extract import clusters
from phdtrack.extract.resolution import join_unresolved
from phdtrack.kernels.pairs import moments, quadratic_form, shares
from phdtrack.protocols import Model, Sensor
from phdtrack.types import F8, I8, Estimates, GaussianMixture, Particles


@dataclass(frozen=True, slots=True)
class Mixture:
    """Settings of the Gaussian mixture extraction.

    Parameters
    ----------
    lightest : components of less mass are not targets; M09's 0.5.
    split : components of more mass are several targets (see `extract.kmeans`).
    iterations : EM iterations after the start and after each split.
    region : squared Mahalanobis radius within which a state counts as resting on a detection.
    overlap : states whose boxes overlap by more (IoU) are one object that the detector saw twice; 1 for never.
    """

    lightest: Positive = 0.5
    split: Positive = 1.5
    iterations: PositiveCount = 6
    region: Positive = 13.28
    overlap: Share = 0.4

    def __post_init__(self) -> None:
        check(self)

    def extract(self, state: Particles, z: F8, model: Model) -> Estimates:
        """The means of the components heavy enough to be targets [M09 §III-B]."""
        if state.mass < self.lightest:
            return Estimates.empty(model.motion.dim)
        centres = clusters.seeds(state, z, model.sensor, self.lightest)
        mixture = self._fit(state, self._start(state, centres, model.sensor), model.sensor)
        for _ in range(int(np.ceil(2 * state.mass / self.split))):
            divided = _divide(mixture, self.split, model.sensor)
            if len(divided) == len(mixture):
                break
            mixture = self._fit(state, divided, model.sensor)
        kept = mixture.weight >= self.lightest
        found = join_unresolved(
            mixture.weight[kept], mixture.mean[:, kept], mixture.covariance[kept], model.sensor, self.overlap
        )
        return clusters.finish(*found, z, model, self.region)

    def _start(self, state: Particles, centres: F8, sensor: Sensor) -> GaussianMixture:
        """Components from the nearest-centre clusters."""
        labels, _ = clusters.label(state, centres, sensor)
        point = np.flatnonzero(labels >= 0)
        return _components(state, state.weight[point], point, labels[point], centres.shape[1], sensor)

    def _fit(self, state: Particles, mixture: GaussianMixture, sensor: Sensor) -> GaussianMixture:
        """EM iterations [M09 §III-B]."""
        for _ in range(self.iterations):
            if len(mixture) == 0:
                break
            point, which, share = _responsibilities(state, mixture, sensor)
            mixture = _components(state, share * state.weight[point], point, which, len(mixture), sensor)
        return mixture


def _responsibilities(state: Particles, mixture: GaussianMixture, sensor: Sensor) -> tuple[I8, I8, F8]:
    """E step: pairs (particle, component) in reach, and the share of the particle that belongs to the component."""
    point, which, _ = clusters.near(state, mixture.mean, sensor)
    distance2 = quadratic_form(state.state, mixture.mean, np.linalg.inv(mixture.covariance), point, which)
    _, log_det = np.linalg.slogdet(mixture.covariance)
    log_density = np.log(mixture.weight)[which] - 0.5 * log_det[which] - 0.5 * distance2
    return point, which, shares(log_density, point, len(state))


def _components(state: Particles, weight: F8, point: I8, which: I8, k: int, sensor: Sensor) -> GaussianMixture:
    """M step: mass, mean and covariance of each component; what has no mass is left out."""
    mass, mean, cov = moments(state.state, weight, point, which, k)
    # A component of next to no mass has no shape; its particles fall to its neighbours.
    alive = mass > 1e-3
    mean, cov = np.ascontiguousarray(mean[:, alive]), cov[alive]
    d = len(mean)
    cov[:, range(d), range(d)] += (0.1 * sensor.noise(mean).T) ** 2
    return GaussianMixture(mass[alive], mean, cov)


def _divide(mixture: GaussianMixture, split: float, sensor: Sensor) -> GaussianMixture:
    """Divide components heavier than ``split``: a deviation to either side on the longest axis in units of the noise."""
    heavy = mixture.weight > split
    if not heavy.any():
        return mixture
    scale = sensor.noise(np.ascontiguousarray(mixture.mean[:, heavy])).T
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
