"""Boxes at constant velocity: the noise of one interval for many states at once."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

F8 = NDArray[np.float64]


@njit(cache=True)
def box_motion_noise(
    size: F8, dt: float, acceleration: float, resize: float, smallest: float, scaled: bool, out: F8
) -> None:
    """Noise covariances of boxes of ``size`` (2, n), written into planes of zeros ``out`` (d, d, n) [M09 (11)].

    States' first rows are centre, velocity and size. Noises are multiples of the size, at least ``smallest``, where
    ``scaled``; else of one pixel.
    """
    position = dt * dt * dt / 3.0 - (dt if dt > 1.0 else dt * dt * dt) / 12.0
    for axis in range(2):
        for i in range(size.shape[1]):
            unit = size[axis, i] if scaled else 1.0
            unit = smallest if scaled and unit < smallest else unit
            pushed, resized = (acceleration * unit) ** 2, (resize * unit) ** 2
            out[axis, axis, i] = pushed * position
            out[axis, axis + 2, i] = pushed * dt * dt / 2.0
            out[axis + 2, axis, i] = pushed * dt * dt / 2.0
            out[axis + 2, axis + 2, i] = pushed * dt
            out[axis + 4, axis + 4, i] = resized * dt
