"""States carried from the pixels of one frame to those of the next by a homography: the formulas stand in `models.warp`."""

from __future__ import annotations

import numpy as np

from phdtrack.kernels.box import F8
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER

# Where D is less, a point is about to pass the horizon of the map: it is taken this far, out of any image, and no further.
LEAST = 0.05


@njit(**ENTRY)
def warped_states(x: F8, warp: F8) -> F8:
    """(d, n) the states (d, n) after the homography (3, 3); rows behind (px, py, vx, vy) are lengths."""
    out, areas = np.empty(x.shape), _determinant(warp)
    for i in range(x.shape[1]):
        px, py, depth, a, b, c, d = _local(warp, x[0, i], x[1, i])
        out[0, i], out[1, i] = px, py
        out[2, i], out[3, i] = a * x[2, i] + b * x[3, i], c * x[2, i] + d * x[3, i]
        scale = np.sqrt(areas / (depth * depth * depth))
        for row in range(4, len(x)):
            out[row, i] = scale * x[row, i]
    return out


@njit(**ENTRY)
def warped_slopes(x: F8, warp: F8) -> F8:
    """(n, d, d) the Jacobians of `warped_states`."""
    rows, n = x.shape
    out, areas, g, h = np.zeros((n, rows, rows)), _determinant(warp), warp[2, 0], warp[2, 1]
    for i in range(n):
        _, _, depth, a, b, c, d = _local(warp, x[0, i], x[1, i])
        vx, vy = x[2, i], x[3, i]
        for place in range(0, 4, 2):
            out[i, place, place], out[i, place, place + 1] = a, b
            out[i, place + 1, place], out[i, place + 1, place + 1] = c, d
        # ∂(J v)/∂p = −(J gᵀv + (J v) gᵀ)/D
        along, wx, wy = g * vx + h * vy, a * vx + b * vy, c * vx + d * vy
        out[i, 2, 0], out[i, 2, 1] = -(a * along + wx * g) / depth, -(b * along + wx * h) / depth
        out[i, 3, 0], out[i, 3, 1] = -(c * along + wy * g) / depth, -(d * along + wy * h) / depth
        scale = np.sqrt(areas / (depth * depth * depth))
        for row in range(4, rows):
            out[i, row, row] = scale
            tilt = -1.5 * scale * x[row, i] / depth
            out[i, row, 0], out[i, row, 1] = tilt * g, tilt * h
    return out


@njit(**INNER)
def _local(warp: F8, x: float, y: float) -> tuple[float, float, float, float, float, float, float]:
    """The place where the pixel goes, D there, and the Jacobian row by row."""
    depth = max(warp[2, 0] * x + warp[2, 1] * y + 1.0, LEAST)
    px = (warp[0, 0] * x + warp[0, 1] * y + warp[0, 2]) / depth
    py = (warp[1, 0] * x + warp[1, 1] * y + warp[1, 2]) / depth
    a, b = (warp[0, 0] - px * warp[2, 0]) / depth, (warp[0, 1] - px * warp[2, 1]) / depth
    c, d = (warp[1, 0] - py * warp[2, 0]) / depth, (warp[1, 1] - py * warp[2, 1]) / depth
    return px, py, depth, a, b, c, d


@njit(**INNER)
def _determinant(m: F8) -> float:
    """The determinant of a matrix (3, 3)."""
    out: float = (
        m[0, 0] * (m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1])
        - m[0, 1] * (m[1, 0] * m[2, 2] - m[1, 2] * m[2, 0])
        + m[0, 2] * (m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0])
    )
    return out
