"""A homography fitted to clicked points of the ground.

The direct linear transform in normalised coordinates gives a first matrix; least squares on the
distances in the image, where the clicks err, gives the final one. Layouts that do not determine the
matrix are refused.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.errors import InputError
from phdtrack.ground.homography import HomographyCamera
from phdtrack.types import F8

# Points with this ratio of their spread across to that along lie on a line, as far as clicks show.
_LINE = 0.01
# Ratio of the second smallest to the largest singular value below which several homographies fit.
_AMBIGUOUS = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """A fitted camera, and the residuals of its N points: ``pixel_error`` (N,) in the image,
    pixels, and ``ground_error`` (N,) on the ground, metres.

    Attributes
    ----------
    camera : between pixels and metres.
    """

    camera: HomographyCamera
    pixel_error: F8
    ground_error: F8


def fit_homography(pixel: F8, world: F8) -> Calibration:
    """Fit the homography with the least sum of squared distances in the image to four or more
    pairs of points.

    ``pixel`` (2, N) are clicked pixels, ``world`` (2, N) their positions on the ground, metres.
    Raises `InputError` for fewer than four pairs, a layout that does not determine the matrix, or
    pairs that no camera in front of a plane can show.

    Parameters
    ----------
    pixel : (2, N) clicked points, pixels.
    world : (2, N) their positions on the ground, metres.

    Returns
    -------
    The camera, and how well it fits.
    """
    pixel = np.asarray(pixel, dtype=np.float64)
    world = np.asarray(world, dtype=np.float64)
    _check(pixel, world)
    to_image = _normaliser(pixel)
    to_ground = _normaliser(world)
    forward = _homography(_apply(to_ground, world), _apply(to_image, pixel))
    matrix = np.linalg.inv(to_ground) @ np.linalg.inv(forward) @ to_image
    matrix /= np.abs(matrix).max()
    camera = HomographyCamera(matrix, inside=(float(pixel[0].mean()), float(pixel[1].mean())))
    pixel_error = np.hypot(*(camera.pixels(world) - pixel))
    return Calibration(camera, pixel_error, np.hypot(*(camera.ground(pixel) - world)))


def calibration_text(fitted: Calibration, frame_size: tuple[int, int] | None = None) -> str:
    """A description of a calibrated camera in TOML, from which `read_camera` restores it
    exactly.
    """
    rows = ",\n".join(
        f"  [{', '.join(repr(float(value)) for value in row)}]" for row in fitted.camera.matrix
    )
    frame = f" of a frame of {frame_size[0]}x{frame_size[1]}" if frame_size else ""
    return (
        f"# Fitted to {len(fitted.pixel_error)} points{frame}; the largest residuals are"
        f" {np.max(fitted.pixel_error):.2f} pixels and {np.max(fitted.ground_error):.3f} m.\n"
        f"homography = [\n{rows},\n]\n"
        'maps = "pixel-to-ground"\n'
        'vectors = "column"\n'
        'pixel = "xy"\n'
        'unit = "m"\n'
        f"inside = [{', '.join(map(repr, fitted.camera.inside or ()))}]  # a pixel of the ground\n"
    )


def _check(pixel: F8, world: F8) -> None:
    """Raise `InputError` if the points cannot be those of a plane seen by a camera."""
    if pixel.ndim != 2 or len(pixel) != 2 or pixel.shape != world.shape:
        raise InputError(
            f"expected two arrays (2, N), got {pixel.shape} and {world.shape}", where="points"
        )
    if not (np.isfinite(pixel).all() and np.isfinite(world).all()):
        raise InputError("expected finite numbers", where="points")
    if pixel.shape[1] < 4:
        raise InputError(
            f"expected four points or more, got {pixel.shape[1]}",
            where="points",
            cure="Click more points of the ground.",
        )
    for name, points in (("in the image", pixel), ("on the ground", world)):
        spread = np.linalg.svd(points - points.mean(axis=1, keepdims=True), compute_uv=False)
        if spread[1] <= _LINE * spread[0]:
            raise InputError(
                f"expected points that cover an area, got points on one line {name}",
                where="points",
                cure="Add points on both sides of the line, far from it.",
            )


def _normaliser(points: F8) -> F8:
    """(3, 3) the shift and scale that centre the points (2, N), at a mean distance of √2."""
    middle = points.mean(axis=1)
    scale = np.sqrt(2) / np.hypot(*(points - middle[:, None])).mean()
    return np.array([[scale, 0, -scale * middle[0]], [0, scale, -scale * middle[1]], [0, 0, 1]])


def _apply(h: F8, point: F8) -> F8:
    """(2, N) images of the points (2, N) under the homography."""
    x = h @ np.vstack([point, np.ones(point.shape[1])])
    return np.asarray(x[:2] / x[2])


def _homography(source: F8, target: F8) -> F8:
    """(3, 3) the homography of the points (2, N), which are centred, with the least squared
    distances to the target points.
    """
    from scipy.optimize import least_squares  # takes long to import

    x = np.vstack([source, np.ones(source.shape[1])]).T
    zero = np.zeros_like(x)
    rows = np.vstack(
        [
            np.hstack([x, zero, -target[0][:, None] * x]),
            np.hstack([zero, x, -target[1][:, None] * x]),
        ]
    )
    _, values, axes = np.linalg.svd(rows)
    h = axes[-1].reshape(3, 3)
    if values[7] <= _AMBIGUOUS * values[0] or np.linalg.cond(h) > 1 / _AMBIGUOUS:
        raise InputError(
            "expected four points of which no three lie on a line, got a layout that does not"
            " determine the camera",
            where="points",
            cure="Add points away from the line that most of them lie on.",
        )
    w = h[2] @ x.T
    if (w > 0).any() and (w <= 0).any():
        raise InputError(
            "expected points in front of one camera, got points on both sides of the horizon",
            where="points",
            cure="Are two pairs mixed up, or x and y, or the signs of X and Y?",
        )

    def residuals(free: F8) -> F8:
        return np.asarray((_apply(np.append(free, 1.0).reshape(3, 3), source) - target).ravel())

    # The last entry is w at the centre of the points, which the camera sees: it is not 0.
    start = h.ravel()[:8] / h[2, 2]
    solution = least_squares(residuals, start, method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    return np.append(solution.x, 1.0).reshape(3, 3)
