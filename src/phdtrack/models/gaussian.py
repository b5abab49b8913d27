"""The model's records of one frame for the Gaussian filters (`kernels.gaussian`).

Gaussians are transformed by Jacobians, or by sigma points if f or h is nonlinear within a
Gaussian's width.

``linear``: f's Jacobian F at the mean, and H as a selection of rows, `Sensor.observed`, which only
a linear sensor has; the filters select them from mean and covariance [V06 (24)–(29), (35)–(38)].

``unscented`` [V06 §IV-B]: 2d + 1 points are transformed and weighed, by the scaled transform with c
= α²(d + κ)

    χ_0 = m,  χ_i = m ± (√(cP))_i,   W_i = 1/2c,  W_0 = 1 − d/c,   in covariances W_0 + 1 − α² + β

at κ = 3 − d, α² = β = 2/3, so that c = 2. With this κ and β = 2 − 2α², mean and variance of a
quadratic function of any one component are exact; with β ≥ α² no covariance is negative; α is the
largest that has both. The sums with W_i about the mean are then the same as sums about the centre,
e_i = f(χ_i) − f(m):

    predict   m' = f(m) + Σ e_i/4,   P' = Σ e_i e_iᵀ/4 + Q(m)
    update    ẑ = h(m) + Σ e_i/4,   H P Hᵀ → Σ e_i e_iᵀ/4,   P Hᵀ → Σ (χ_i − m) e_iᵀ/4

For linear functions both are the same except for rounding. Differences of measurements are the
sensor's (`Sensor.innovation`), so that angles are compared the short way round.

The prediction of boxes, the usual case, is compiled (`kernels.box`); other motions are called by
the methods of their protocol.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Literal

import numpy as np

from phdtrack.errors import InputError
from phdtrack.kernels import rts
from phdtrack.kernels.box import predicted_boxes
from phdtrack.kernels.gaussian import (
    Births,
    Expected,
    Measurements,
    NewTargets,
    Predicted,
    first_states,
)
from phdtrack.models.box import BoxMotion
from phdtrack.protocols import Model, Sensor
from phdtrack.types import F8, I8

Transform = Literal["linear", "unscented"]
# c, and the weight of each point beside the centre.
SCALE = 2.0
WEIGHT = 0.25
# No factors for the variances of acceleration.
SAME = np.zeros(0)


def predicted(
    model: Model, mean: F8, covariance: F8, dt: float, transform: Transform, factor: F8 = SAME
) -> Predicted:
    """Gaussians after an interval [V06 (24)–(29), §IV-B].

    Parameters
    ----------
    model : of the world.
    mean, covariance : arrays (J, d) and (J, d, d).
    dt : interval in the model's time unit.
    transform : ``linear`` or ``unscented``, see above.
    factor : array (J,), multiplies the variances with which position and velocity change; (0,):
        none.
    """
    motion = model.motion
    if type(motion) is BoxMotion and transform == "linear":
        boxes: Predicted = predicted_boxes(
            mean, covariance, tuple(motion.dynamics(dt, dt / model.rate)), factor
        )
        return boxes
    columns = np.ascontiguousarray(mean.T)
    p_survive = motion.p_survive(columns, dt / model.rate)
    centre, f, q = motion.transition(columns, dt)
    if len(factor):
        q = q.copy()
        q[:, :4, :4] *= factor[:, None, None]
    if transform == "linear":
        return Predicted(np.ascontiguousarray(centre.T), rts.predicted(covariance, f, q), p_survive)
    points = sigma_points(columns, covariance)
    d, many, count = points.shape
    through = motion.transition(points.reshape(d, many * count), dt)[0].reshape(d, many, count)
    step = through - through[:, :1]
    later = np.ascontiguousarray((through[:, 0] + WEIGHT * step.sum(axis=1)).T)
    return Predicted(later, _product(step, step) + q, p_survive)


def moved(
    model: Model, mean: F8, covariance: F8, dt: float, transform: Transform, factor: F8 = SAME
) -> tuple[F8, F8, Predicted]:
    """Gaussians of the frame before in the pixels of this one, and predicted for it.

    Parameters
    ----------
    model, mean, covariance, dt, transform, factor : as in `predicted`.
    """
    mean, covariance = carried(model, mean, covariance)
    return mean, covariance, predicted(model, mean, covariance, dt, transform, factor)


def carried(model: Model, mean: F8, covariance: F8) -> tuple[F8, F8]:
    """Gaussians (J, d), (J, d, d) of the frame before in the pixels of this one.

    Parameters
    ----------
    model, mean, covariance : as in `predicted`.
    """
    if not len(model.warp):
        return mean, covariance
    columns, covariance = model.warp_gaussians(np.ascontiguousarray(mean.T), covariance)
    return np.ascontiguousarray(columns.T), covariance


def predicted_measurements(
    sensor: Sensor, mean: F8, covariance: F8, transform: Transform
) -> Expected:
    """The measurements that Gaussians predict [V06 (36), §IV-B].

    Raises `InputError` if the transform is ``linear`` and the sensor is not.

    Parameters
    ----------
    sensor : the model's sensor.
    mean, covariance, transform : as in `predicted`.
    """
    columns = np.ascontiguousarray(mean.T)
    noise = sensor.target_noise(columns)
    p_detect = sensor.p_detect(columns)
    if transform == "linear":
        if not sensor.linear:
            raise InputError(
                "expected a linear sensor, got one whose measurements are no rows of the state",
                where="filter.transform",
                cure="Use filter.transform=unscented, or particles",
            )
        return Expected(row_numbers(sensor.observed), mean, covariance, covariance, noise, p_detect)
    points = sigma_points(columns, covariance)
    d, many, count = points.shape
    through = sensor.predicted_measurements(points.reshape(d, many * count)).reshape(
        len(sensor.angles), many, count
    )
    step = sensor.innovation(through, through[:, :1])
    z = np.ascontiguousarray((through[:, 0] + WEIGHT * step.sum(axis=1)).T)
    rows = row_numbers(tuple(range(z.shape[1])))
    cross = _product(points - points[:, :1], step)
    return Expected(rows, z, _product(step, step), cross, noise, p_detect)


def measurements(sensor: Sensor, z: F8, clutter: F8) -> Measurements:
    """The measurements of a frame with their noise and κ(z).

    Parameters
    ----------
    sensor, z, clutter : the sensor, its (m, N) measurements, and (N,) κ(z).
    """
    period = _periods(sensor.angles)
    rows = np.ascontiguousarray(z[: len(period)].T)
    return Measurements(rows, sensor.measurement_noise(z), clutter, period)


@lru_cache(maxsize=8)
def _periods(angles: tuple[bool, ...]) -> tuple[float, ...]:
    """The period of each component of a measurement: 2π for an angle, else 0."""
    return tuple(2 * math.pi if angle else 0.0 for angle in angles)


@lru_cache(maxsize=8)
def row_numbers(observed: tuple[int, ...]) -> I8:
    """(r,) rows of the state, as an array."""
    return np.array(observed, np.int64)


def sigma_points(mean: F8, cov: F8) -> F8:
    """(d, 2d + 1, J) points of Gaussians (d, J), (J, d, d), the means first."""
    # The symmetric root exists even if a variance is 0.
    value, vector = np.linalg.eigh(cov)
    root = (vector * np.sqrt(np.maximum(SCALE * value, 0.0))[:, None, :]) @ vector.transpose(
        0, 2, 1
    )
    columns = root.transpose(1, 2, 0)
    return (
        np.concatenate([np.zeros((len(mean), 1, len(cov))), columns, -columns], axis=1)
        + mean[:, None, :]
    )


def _product(a: F8, b: F8) -> F8:
    """(J, r, s) Σ a_i b_iᵀ/4 over differences from the centre, (r, 2d + 1, J) and (s, 2d + 1,
    J).
    """
    return np.ascontiguousarray(WEIGHT * np.einsum("akj,bkj->jab", a, b))


def new_targets(
    model: Model, births: Births, m: Measurements, gate: float, transform: Transform
) -> NewTargets:
    """Targets whose first detections are the measurements, with the density λ̂ of these [PMB (5)].

    Parameters
    ----------
    model, transform : as in `predicted`.
    births : intensity of targets that have not been detected before.
    m, gate : the measurements; the gate in deviations of the innovation.
    """
    around = births.around
    p_detect = model.sensor.p_detect(np.ascontiguousarray(around.mean.T))
    if len(births.weight) == 0:
        return NewTargets(p_detect * around.density, around.mean, around.covariance)
    fixed = predicted_measurements(model.sensor, births.mean, births.covariance, transform)
    out: NewTargets = first_states(births, p_detect, fixed, m, gate)
    return out
