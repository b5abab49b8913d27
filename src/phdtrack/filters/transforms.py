"""Gaussians through f and h: by Jacobians, or by sigma points where f or h bends within a Gaussian's width.

``linear``: f's Jacobian F at the mean, and H as a choice of rows, `Sensor.observed`, which only a linear sensor has
[V06 (24)–(29), (35)–(38)].

``unscented`` [V06 §IV-B]: 2d + 1 points go through the function and are weighed, by the scaled transform with c = α²(d + κ)

    χ_0 = m,  χ_i = m ± (√(cP))_i,   W_i = 1/2c,  W_0 = 1 − d/c,   in covariances W_0 + 1 − α² + β

at κ = 3 − d, α² = β = 2/3, so that c = 2. With this κ and β = 2 − 2α², mean and variance of a quadratic function of any one
component are exact; with β ≥ α² no covariance is negative; α is the largest that has both. The sums with W_i about the mean
are then the same as sums about the centre, e_i = f(χ_i) − f(m):

    predict   m' = f(m) + Σ e_i/4,   P' = Σ e_i e_iᵀ/4 + Q(m)
    update    ẑ = h(m) + Σ e_i/4,   S = Σ e_i e_iᵀ/4 + R,   C = Σ (χ_i − m) e_iᵀ/4,   m + C S⁻¹ (z − ẑ),   P − C S⁻¹ Cᵀ

For linear functions both are the same but for rounding. Differences of measurements are the sensor's (`Sensor.innovation`),
so that the angles among them are taken the short way round.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from phdtrack.errors import InputError
from phdtrack.kernels.kalman import predicted_covariance, updated
from phdtrack.protocols import Motion, Sensor
from phdtrack.types import F8, I8, GaussianMixture

Transform = Literal["linear", "unscented"]
# c, and the weight of each point beside the centre.
SCALE, WEIGHT = 2.0, 0.25


@dataclass(frozen=True, slots=True, eq=False)
class Expected:
    """What Gaussians say about measurements: ``mean`` (r, J), ``spread`` (J, r, r) without noise, ``cross`` (J, d, r)."""

    mean: F8
    spread: F8
    cross: F8


def sigma_points(mean: F8, cov: F8) -> F8:
    """(d, 2d + 1, J) points of Gaussians (d, J), (J, d, d), the means first."""
    # The symmetric root exists where a variance is 0, too.
    value, vector = np.linalg.eigh(cov)
    root = (vector * np.sqrt(np.maximum(SCALE * value, 0.0))[:, None, :]) @ vector.transpose(0, 2, 1)
    columns = root.transpose(1, 2, 0)
    return np.concatenate([np.zeros((len(mean), 1, len(cov))), columns, -columns], axis=1) + mean[:, None, :]


def _product(a: F8, b: F8) -> F8:
    """(J, r, s) Σ a_i b_iᵀ/4 over differences from the centre, (r, 2d + 1, J) and (s, 2d + 1, J)."""
    out: F8 = WEIGHT * np.einsum("akj,bkj->jab", a, b)
    return out


def _mean(centre: F8, step: F8) -> F8:
    """(r, J) f(m) + Σ e_i/4."""
    out: F8 = centre + WEIGHT * step.sum(axis=1)
    return out


def moved(mean: F8, cov: F8, motion: Motion, dt: float, transform: Transform) -> tuple[F8, F8]:
    """Gaussians (d, J), (J, d, d) through f [V06 (24)–(29), §IV-B]."""
    centre, f, q = motion.transition(mean, dt)
    if transform == "linear":
        return centre, predicted_covariance(cov, f, q)
    points = sigma_points(mean, cov)
    d, many, count = points.shape
    through = motion.transition(points.reshape(d, -1), dt)[0].reshape(-1, many, count)
    step = through - through[:, :1]
    return _mean(through[:, 0], step), _product(step, step) + q


def expected(state: GaussianMixture, sensor: Sensor, transform: Transform) -> Expected:
    """What the Gaussians of a mixture say about measurements [V06 (36), §IV-B].

    Raises `InputError` where ``transform`` is ``linear`` and the sensor is not.
    """
    rows = list(sensor.observed)
    if transform == "linear":
        if not sensor.linear:
            raise InputError(
                "expected a linear sensor, got one whose measurements are no rows of the state",
                where="filter.transform",
                cure="Use filter.transform=unscented, or particles",
            )
        cross = state.covariance[:, :, rows]
        return Expected(state.mean[rows], cross[:, rows], cross)
    points = sigma_points(state.mean, state.covariance)
    d, many, count = points.shape
    through = sensor.expected(points.reshape(d, -1)).reshape(-1, many, count)
    step = sensor.innovation(through, through[:, :1])
    return Expected(_mean(through[:, 0], step), _product(step, step), _product(points - points[:, :1], step))


def posteriors(state: GaussianMixture, z: F8, point: I8, which: I8, sensor: Sensor, transform: Transform) -> tuple[F8, F8]:
    """Means (d, P) and covariances (P, d, d) of the pairs (Gaussian, measurement) [V06 (37)–(38), §IV-B]."""
    noise = sensor.covariance(z[:, which], state.mean[:, point])
    if transform == "linear":
        rows = np.array(sensor.observed)
        mean, cov = updated(state.mean, state.covariance, z, noise, rows, point, which)
        return mean, cov
    seen = expected(state, sensor, transform)
    cross = seen.cross[point]
    gain = np.linalg.solve(seen.spread[point] + noise, cross.transpose(0, 2, 1)).transpose(0, 2, 1)
    step = sensor.innovation(z[:, which], seen.mean[:, point])
    cov = state.covariance[point] - gain @ cross.transpose(0, 2, 1)
    return state.mean[:, point] + np.einsum("pdr,rp->dp", gain, step), 0.5 * (cov + cov.transpose(0, 2, 1))
