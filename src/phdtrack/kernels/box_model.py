"""What the box model answers to the Gaussian filters, compiled: predictions, expected measurements and births.

The formulas stand at `BoxMotion`, `BoxSensor` and `births.births_around`. States are rows (px, py, vx, vy, w, h).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.constant_velocity import motion_noises
from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.gaussian import Predicted

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
# Rows of the state that a measurement shows.
ROWS = (0, 1, 4, 5)
PARTICLE, DETECTION, FIXED, GIVEN, PREVIOUS = range(5)
TINY_VARIANCE = 1e-12


class BoxDynamics(NamedTuple):
    """Motion of boxes over one interval: settings of `BoxMotion`, ``p_survive`` inside the frame of this size (0: no
    border)."""

    dt: float
    acceleration: float
    size_noise: float
    min_size: float
    scaled: bool
    p_survive: float
    width: float
    height: float


class BoxNoise(NamedTuple):
    """Noise of measured boxes: what its deviations follow, settings of `BoxSensor`, constant variances of position and
    size."""

    scaling: int
    box_noise: float
    min_noise: float
    fixed_position: float
    fixed_size: float


@njit(**ENTRY)
def predicted_boxes(mean: F8, covariance: F8, motion: BoxDynamics) -> Predicted:
    """Boxes at constant velocity, (J, 6) and (J, 6, 6), after an interval: F P Fᵀ + Q [M09 (11)]."""
    n, d = mean.shape
    out = Predicted(np.empty((n, d)), np.empty((n, d, d)), np.empty(n))
    dt, bordered = motion.dt, motion.width > 0.0 and motion.height > 0.0
    half = np.empty((d, d))
    for i in range(n):
        for r in range(d):
            out.mean[i, r] = mean[i, r]
            for s in range(d):
                half[r, s] = covariance[i, r, s]
        for a in range(2):
            out.mean[i, a] += dt * mean[i, a + 2]
            for s in range(d):
                half[a, s] += dt * covariance[i, a + 2, s]
        for r in range(d):
            for s in range(d):
                out.covariance[i, r, s] = half[r, s]
            for a in range(2):
                out.covariance[i, r, a] += dt * half[r, a + 2]
        for a in range(2):
            place, both, speed, extent = motion_noises(
                mean[i, a + 4], dt, motion.acceleration, motion.size_noise, motion.min_size, motion.scaled
            )
            out.covariance[i, a, a] += place
            out.covariance[i, a, a + 2] += both
            out.covariance[i, a + 2, a] += both
            out.covariance[i, a + 2, a + 2] += speed
            out.covariance[i, a + 4, a + 4] += extent
        half_w, half_h = 0.5 * mean[i, 4], 0.5 * mean[i, 5]
        inside = -half_w < mean[i, 0] < motion.width + half_w and -half_h < mean[i, 1] < motion.height + half_h
        out.p_survive[i] = motion.p_survive if inside or not bordered else 0.0
    return out


@njit(**INNER)
def box_variances(noise: BoxNoise, w: float, h: float) -> tuple[float, float, float, float]:
    """Variances of (px, py, w, h) of a measured box whose noise follows the size ``w``, ``h``."""
    if noise.scaling == FIXED:
        return noise.fixed_position, noise.fixed_position, noise.fixed_size, noise.fixed_size
    sw, sh = max(noise.box_noise * w, noise.min_noise), max(noise.box_noise * h, noise.min_noise)
    # Without a floor the noise of a vanishing box would be none, and no density.
    vw, vh = max(sw * sw, TINY_VARIANCE), max(sh * sh, TINY_VARIANCE)
    return max(0.25 * vw, TINY_VARIANCE), max(0.25 * vh, TINY_VARIANCE), vw, vh


@njit(**ENTRY)
def box_covariances(size: F8, noise: BoxNoise) -> F8:
    """(L, 4, 4) noise covariances of (px, py, w, h) of measured boxes whose noise follows sizes (2, L)."""
    n = size.shape[1]
    out = np.zeros((n, len(ROWS), len(ROWS)))
    for i in range(n):
        here = box_variances(noise, size[0, i], size[1, i])
        for a in range(len(ROWS)):
            out[i, a, a] = here[a]
    return out


@njit(**ENTRY)
def states_of_boxes(z: F8, dim: int, noise: BoxNoise, speed: float) -> tuple[F8, F8]:
    """States at rest (dim, N) that boxes ``z`` (m, N) alone show, and their covariances (N, dim, dim).

    ``speed`` is the deviation of each velocity component, in √(wh), or in pixels where the noise is constant. Rows behind
    the
    sixth are sizes, too.
    """
    n = z.shape[1]
    x, cov = np.zeros((dim, n)), np.zeros((n, dim, dim))
    for j in range(n):
        here = box_variances(noise, z[2, j], z[3, j])
        if noise.scaling == GIVEN:
            here = z[4, j], z[5, j], z[6, j], z[7, j]
        size = 1.0 if noise.scaling == FIXED else np.sqrt(z[2, j] * z[3, j])
        moving = max(speed * size, 1e-6) ** 2
        for a in range(2):
            x[a, j], cov[j, a, a], cov[j, a + 2, a + 2] = z[a, j], here[a], moving
        for c in range(4, dim):
            a = 2 + c % 2
            x[c, j], cov[j, c, c] = z[a, j], here[a]
    return x, cov
