"""Views of states and densities for tests: draws, and a filter's targets as a mixture."""

from __future__ import annotations

import numpy as np

from phdtrack.filters.pmb import Bernoullis, scaled
from phdtrack.scene import SceneDensity
from phdtrack.types import F8, GaussianMixture


def drawn_of(p: SceneDensity, count: int, rng: np.random.Generator) -> F8:
    """(d, count) draws of p; those of a Gaussian that fall outside are drawn again."""
    chances = np.append(p.uniform, p.gaussians.weight * p.truncated_mass)
    part = rng.choice(len(chances), size=count, p=chances / chances.sum()) - 1
    x = rng.uniform(p.low[:, None], p.high[:, None], (p.dim, count))
    root = np.linalg.cholesky(p.covariance)
    missing = np.flatnonzero(part >= 0)
    while len(missing):
        which = part[missing]
        drawn = p.mean[:, which] + np.einsum(
            "jrs,sj->rj", root[which], rng.standard_normal((p.dim, len(missing)))
        )
        fits = p.contains(drawn)
        x[:, missing[fits]] = drawn[:, fits]
        missing = missing[~fits]
    return x


def mixture_of(state: Bernoullis) -> GaussianMixture:
    """The intensity of the targets: hypotheses with the probability that the target exists and is
    as they say.
    """
    targets, hypotheses, means, covariances = state.present
    target = hypotheses["target"]
    genuine = 1 / (1 + np.exp(-hypotheses["genuine"]))
    weight = targets["r"][target] * hypotheses["weight"] * genuine
    there = np.flatnonzero(weight > 0)
    return GaussianMixture(
        weight[there], np.ascontiguousarray(means[there].T), scaled(covariances, hypotheses, there)
    )
