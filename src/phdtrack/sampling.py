"""Particles from Gaussian mixtures: births, initial intensities, tests."""

from __future__ import annotations

import numpy as np

from phdtrack.types import GaussianMixture, Particles


def draw(mixture: GaussianMixture, count: int, scale: float, rng: np.random.Generator) -> Particles:
    """``count`` particles from each component, of total mass ``scale`` times its weight."""
    d, k = mixture.mean.shape
    root = np.linalg.cholesky(mixture.covariance)
    noise = rng.standard_normal((k, d, count))
    state = mixture.mean.T[:, :, None] + root @ noise
    weight = np.repeat(mixture.weight * scale / max(1, count), count)
    return Particles(np.ascontiguousarray(state.transpose(1, 0, 2).reshape(d, k * count)), weight)
