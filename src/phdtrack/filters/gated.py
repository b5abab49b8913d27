"""Which Gaussians and measurements are near each other."""

from __future__ import annotations

import math

import numpy as np

from phdtrack.filters.transforms import Transform, expected
from phdtrack.kernels.gaussian import gaussian_parts
from phdtrack.kernels.grid import points_in_rectangles
from phdtrack.protocols import Sensor
from phdtrack.types import F8, I8, GaussianMixture


def gated_gaussians(
    state: GaussianMixture, z: F8, sensor: Sensor, gate: float, transform: Transform
) -> tuple[I8, I8, F8, F8]:
    """Pairs (Gaussian, measurement) within ``gate`` deviations of the innovation, their d², and log 1/√det(2πS).

    The grid is asked for what lies within as many deviations of position, in the state's plane; the sensor's noise is
    bounded there by the larger of what it is for the Gaussian's own state and for any of the measurements.
    """
    if len(state) == 0 or z.shape[1] == 0:
        none = np.zeros(0, np.int64)
        return none, none, np.zeros(0), np.zeros(0)
    at, noise = sensor.states(z)
    seen = expected(state, sensor, transform)
    position, r = state.mean[:2], len(seen.mean)
    variance = state.covariance[:, (0, 1), (0, 1)].T
    widest = np.maximum(sensor.noise(state.mean)[:2] ** 2, noise[:, (0, 1), (0, 1)].max(0)[:, None])
    half = gate * np.sqrt(variance + widest)
    z_of, point = points_in_rectangles(at[0], at[1], position - half, position + half)
    innovation = seen.spread[point] + sensor.covariance(z[:, z_of], state.mean[:, point])
    step = sensor.innovation(z[:, z_of], seen.mean[:, point])
    distance2, log_det = gaussian_parts(step, innovation)
    inside = distance2 <= gate**2
    log_norm = -0.5 * (log_det + r * math.log(2 * math.pi))
    return point[inside], z_of[inside], distance2[inside], log_norm[inside]
