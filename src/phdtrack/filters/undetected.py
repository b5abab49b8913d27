"""Targets that have never been detected: a Poisson process whose intensity has a recursion of its
own [W15 §III].

Equations: docs/methods.md, Poisson multi-Bernoulli. Detected targets whose existence has become
improbable are given back to it: their density, times that probability, is added to λ (recycling). A
Bernoulli target of small probability and a Poisson process of that mass differ in the second order
of it.

λ is a mixture where γ is one. Where γ is stated as a density at the measurements (uniform, or
around the detections) it is the intensity of undetected targets itself: a constant γ makes λ⁺ = γ /
(1 − p_S (1 − p_D)), the same but for a factor.
"""

from __future__ import annotations

import numpy as np

from phdtrack.kernels.gaussian import Births
from phdtrack.models.gaussian import Transform, moved
from phdtrack.protocols import Model
from phdtrack.types import F8, GaussianMixture

# Gaussians that weigh less are dropped; of those nearer than so many deviations one is made; so
# many are kept.
LEAST = 1e-6
NEAR = 0.5
MOST = 200


def survived(
    unseen: GaussianMixture, model: Model, dt: float, transform: Transform
) -> GaussianMixture:
    """∫ p_S f λ, the intensity ``unseen`` after an interval, without the targets born in it: the
    first part of λ⁺ [PMB (2)].

    Parameters
    ----------
    unseen : λ of the frame before.
    model, dt, transform : as in `models.gaussian.predicted`.
    """
    if len(unseen) == 0:
        return unseen
    _, _, after = moved(
        model, np.ascontiguousarray(unseen.mean.T), unseen.covariance, dt, transform
    )
    return GaussianMixture(
        unseen.weight * after.p_survive, np.ascontiguousarray(after.mean.T), after.covariance
    )


def with_births(unseen: GaussianMixture, model: Model, z: F8, dt: float) -> Births:
    """λ⁺, the intensity of targets that may be detected for the first time [PMB (2)].

    Parameters
    ----------
    unseen : what has survived of λ.
    model, z, dt : of the frame, its (m, N) measurements, and the interval in the model's time unit.
    """
    births = model.birth.gaussians(z, model.sensor, model.birth_seconds(dt))
    if len(unseen) == 0:
        return births
    return births._replace(
        weight=np.concatenate([births.weight, unseen.weight]),
        mean=np.concatenate([births.mean, unseen.mean.T]),
        covariance=np.concatenate([births.covariance, unseen.covariance]),
    )


def still_undetected(births: Births, model: Model) -> GaussianMixture:
    """λ: the part of λ⁺ that has not been detected in this frame [PMB (6)]."""
    if len(births.weight) == 0:
        return GaussianMixture.empty(births.mean.shape[1])
    mean = np.ascontiguousarray(births.mean.T)
    return _reduced(
        births.weight * (1 - model.sensor.p_detect(mean)), births.mean, births.covariance
    )


def recycled(unseen: GaussianMixture, weight: F8, mean: F8, covariance: F8) -> GaussianMixture:
    """λ with targets given back to it.

    Parameters
    ----------
    unseen : λ.
    weight, mean, covariance : (n,), (n, d), (n, d, d) of the targets; weights are the probabilities
        that they exist.
    """
    if len(weight) == 0:
        return unseen
    return _reduced(
        np.concatenate([unseen.weight, weight]),
        np.concatenate([unseen.mean.T, mean]),
        np.concatenate([unseen.covariance, covariance]),
    )


def _reduced(weight: F8, mean: F8, covariance: F8) -> GaussianMixture:
    """The mixture of these Gaussians (n,), (n, d), (n, d, d), pruned, merged and capped."""
    # Imported here: most users' births are no mixture, and a tracker starts without it.
    from phdtrack.kernels.gm_merge import Merging, Rows, merged_rows

    axes = tuple(range(mean.shape[1]))
    rows = Rows(weight, mean, covariance)
    return GaussianMixture(*merged_rows(rows, axes, Merging(LEAST, NEAR, MOST, False), -1.0))
