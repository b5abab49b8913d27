"""A homography from clicked points: pixels and their places on the ground.

The direct linear transform in normalised coordinates gives a first matrix; least squares on the distances in the image,
where the clicks err, gives the final one. Layouts that leave the matrix open (all points, or all but one, near a line) are
refused.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.errors import InputError
from phdtrack.ground.cameras import HomographyCamera
from phdtrack.types import F8

# Points whose spread across is this small beside that along lie on a line, as far as clicks can tell.
_LINE = 0.01
# The second smallest singular value beside the largest, below which more than one homography fits.
_OPEN = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """A fitted camera and how well it fits.

    ``pixel_error`` (N,) distances in the image, pixels; ``ground_error`` (N,) distances on the ground, metres.
    """

    camera: HomographyCamera
    pixel_error: F8
    ground_error: F8


def fit_homography(pixel: F8, world: F8) -> Calibration:
    """The homography with the least sum of squared distances in the image from four or more pairs, and how well it fits.

    ``pixel`` (2, N) are clicked pixels, ``world`` (2, N) their places on the ground, metres.

    Raises
    ------
    InputError : fewer than four pairs, shapes that differ, a layout that leaves the matrix open, or pairs that no camera
        in front of a plane can show.
    """
    pixel, world = np.asarray(pixel, dtype=np.float64), np.asarray(world, dtype=np.float64)
    _check(pixel, world)
    to_image, to_ground = _normaliser(pixel), _normaliser(world)
    forward = _homography(_through(to_ground, world), _through(to_image, pixel))
    matrix = np.linalg.inv(to_ground) @ np.linalg.inv(forward) @ to_image
    matrix /= np.abs(matrix).max()
    camera = HomographyCamera(matrix, inside=(float(pixel[0].mean()), float(pixel[1].mean())))
    missed, off = camera.pixels(world) - pixel, camera.ground(pixel) - world
    return Calibration(camera, np.hypot(*missed), np.hypot(*off))


def _check(pixel: F8, world: F8) -> None:
    """Raise `InputError` where the points cannot be those of a plane seen by a camera."""
    if pixel.ndim != 2 or len(pixel) != 2 or pixel.shape != world.shape:
        raise InputError(f"expected two arrays (2, N), came {pixel.shape} and {world.shape}", where="points")
    if not (np.isfinite(pixel).all() and np.isfinite(world).all()):
        raise InputError("expected finite numbers", where="points")
    if pixel.shape[1] < 4:
        problem = f"expected four points or more, came {pixel.shape[1]}"
        raise InputError(problem, where="points", cure="Click more points of the ground.")
    for name, points in (("in the image", pixel), ("on the ground", world)):
        spread = np.linalg.svd(points - points.mean(axis=1, keepdims=True), compute_uv=False)
        if spread[1] <= _LINE * spread[0]:
            problem = f"expected points that spread over an area, came points on one line {name}"
            raise InputError(problem, where="points", cure="Add points to both sides of the line, far from it.")


def _normaliser(points: F8) -> F8:
    """(3, 3) the shift and scale that bring the points (2, N) about 0, at a mean distance of √2."""
    middle = points.mean(axis=1)
    scale = np.sqrt(2) / np.hypot(*(points - middle[:, None])).mean()
    return np.array([[scale, 0, -scale * middle[0]], [0, scale, -scale * middle[1]], [0, 0, 1]])


def _through(h: F8, point: F8) -> F8:
    """(2, N) the points (2, N) through the homography."""
    x = h @ np.vstack([point, np.ones(point.shape[1])])
    return np.asarray(x[:2] / x[2])


def _homography(source: F8, target: F8) -> F8:
    """(3, 3) the homography of the points (2, N), about 0, with the least squared distances to the target points."""
    from scipy.optimize import least_squares  # takes long to import

    x = np.vstack([source, np.ones(source.shape[1])]).T
    none = np.zeros_like(x)
    rows = np.vstack([np.hstack([x, none, -target[0][:, None] * x]), np.hstack([none, x, -target[1][:, None] * x])])
    _, values, axes = np.linalg.svd(rows)
    h = axes[-1].reshape(3, 3)
    if values[7] <= _OPEN * values[0] or np.linalg.cond(h) > 1 / _OPEN:
        raise InputError(
            "expected four points of which no three lie on a line, came a layout that leaves the camera open",
            where="points",
            cure="Add points away from the line that most of them lie on.",
        )
    w = h[2] @ x.T
    if (w > 0).any() and (w <= 0).any():
        raise InputError(
            "expected points that one camera sees in front of it, came points on both sides of the horizon",
            where="points",
            cure="Are two pairs mixed up, or x and y, or the signs of X and Y?",
        )

    def distance(free: F8) -> F8:
        return np.asarray((_through(np.append(free, 1.0).reshape(3, 3), source) - target).ravel())

    # The last entry is w at the middle of the points, which the camera sees: not 0.
    start = h.ravel()[:8] / h[2, 2]
    found = least_squares(distance, start, method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    return np.append(found.x, 1.0).reshape(3, 3)
