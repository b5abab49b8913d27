"""Global illumination: how the light of a frame differs from the light in which the reference was learned.

Clouds, mains flicker and the camera's automatic exposure change all pixels of a channel alike, to good approximation by a
gain and an offset. They are fitted robustly (median ratio, then least squares on what lies near the line) on a sparse grid
of background pixels, and the reference is brought into the frame's light; what differs then is a change in the scene.
"""

from __future__ import annotations

import cv2
import numpy as np

from phdtrack.types import F8, Bool, Image

_GRID_POINTS = 4000
_DARKEST, _BRIGHTEST = 8, 245
_FEWEST = 50
_NEAR = 2.5
_ROUNDS = 3


def relit(reference: Image, frame: Image, foreground: Image) -> Image:
    """``reference`` (H, W, 3) in the light of ``frame`` (H, W, 3); ``foreground`` (H, W) is left out where it is not 0."""
    table = np.empty((1, 256, 3), np.uint8)
    level = np.arange(256, dtype=np.float64)
    step = max(1, round((foreground.size / _GRID_POINTS) ** 0.5))
    grid = slice(step // 2, None, step)
    background = foreground[grid, grid].ravel() == 0
    for channel in range(3):
        x = reference[grid, grid, channel].ravel().astype(np.float64)
        y = frame[grid, grid, channel].ravel().astype(np.float64)
        gain, offset = _line(x, y, background)
        table[0, :, channel] = np.rint(np.clip(gain * level + offset, 0, 255))
    adapted: Image = cv2.LUT(reference, table)
    return adapted


def _line(x: F8, y: F8, background: Bool) -> tuple[float, float]:
    """Gain and offset of y ≈ gain·x + offset over unsaturated background; 1 and 0 where there is too little of it."""
    exposed = background & (x > _DARKEST) & (y > _DARKEST) & (x < _BRIGHTEST) & (y < _BRIGHTEST)
    if exposed.sum() < _FEWEST:
        return 1.0, 0.0
    x, y = x[exposed], y[exposed]
    gain, offset = float(np.median(y / x)), 0.0
    for _ in range(_ROUNDS):
        residual = y - gain * x - offset
        scale = 1.4826 * float(np.median(np.abs(residual))) + 0.5
        near = np.abs(residual) < _NEAR * scale
        spread = float(x[near].var()) if near.any() else 0.0
        # A scene of one brightness does not tell gain from offset: keep the gain and move the offset alone.
        if spread > 100.0:
            gain = float(((x[near] - x[near].mean()) * (y[near] - y[near].mean())).mean() / spread)
        offset = float(np.median(y[near] - gain * x[near])) if near.any() else 0.0
    return gain, offset
