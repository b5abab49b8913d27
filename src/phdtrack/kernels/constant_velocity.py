"""Boxes at constant velocity: mean, Jacobian and noise of one interval for many states at once."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

F8 = NDArray[np.float64]


@njit(cache=True)
def move_boxes(x: F8, dt: float, acceleration: float, resize: float, smallest: float, scaled: bool) -> tuple[F8, F8, F8]:
    """Mean (d, n), Jacobian (d, d) and noise covariances (n, d, d) for boxes ``x`` (d, n), d 6 or 8 [M09 (11)].

    Rows are centre, velocity, size and, where d is 8, the size before. Noises are multiples of the size, at least
    ``smallest``, where ``scaled``; else of one pixel.
    """
    d, n = x.shape
    f = np.eye(d)
    f[0, 2] = f[1, 3] = dt
    mean = x.copy()
    mean[0] += dt * x[2]
    mean[1] += dt * x[3]
    if d == 8:
        f[6, 4] = f[7, 5] = 1.0
        f[6, 6] = f[7, 7] = 0.0
        mean[6:8] = x[4:6]
    noise = np.zeros((n, d, d))
    position = dt**3 / 3 - min(dt, dt**3) / 12
    for i in range(n):
        for axis in range(2):
            unit = max(x[4 + axis, i], smallest) if scaled else 1.0
            a2, b2 = (acceleration * unit) ** 2, (resize * unit) ** 2
            noise[i, axis, axis] = a2 * position
            noise[i, axis, axis + 2] = noise[i, axis + 2, axis] = a2 * dt**2 / 2
            noise[i, axis + 2, axis + 2] = a2 * dt
            noise[i, axis + 4, axis + 4] = b2 * dt
    return mean, f, noise
