"""One step of EM for a Gaussian mixture beside a background density, as its definition reads."""

from __future__ import annotations

import numpy as np

from phdtrack.kernels.mixtures import Gaussians, Moments
from phdtrack.types import F8


def em_step(x: F8, weight: F8, log_background: F8, mixture: Gaussians) -> Moments:
    """Expectation and moments of weighted samples ``x`` (d, n), all of which may belong to every
    component.
    """
    parts = [log_background]
    for share, mean, cov in zip(mixture.weight, mixture.mean.T, mixture.covariance, strict=True):
        step = x - mean[:, None]
        distance2 = np.einsum("rn,rs,sn->n", step, np.linalg.inv(cov), step)
        parts.append(np.log(share) - 0.5 * (distance2 + np.linalg.slogdet(2 * np.pi * cov)[1]))
    log_density = np.logaddexp.reduce(parts, axis=0)
    responsibility = np.exp(np.array(parts) - log_density) * weight
    mass = responsibility[1:].sum(axis=1)
    mean = x @ responsibility[1:].T / mass
    cov = [np.cov(x, aweights=each, ddof=0) for each in responsibility[1:]]
    return Moments(
        mass, mean, np.array(cov), float(responsibility[0].sum()), float(weight @ log_density)
    )
