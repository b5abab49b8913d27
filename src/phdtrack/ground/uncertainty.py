"""How well a pixel's place on the ground is known: far away a pixel is metres; and what ground the frame shows."""

from __future__ import annotations

import numpy as np

from phdtrack.errors import InputError
from phdtrack.protocols import Camera
from phdtrack.types import F8, Bool

# Points along an edge of the frame, points of the grid that a visible centre is looked for on, halvings of a pixel's way.
_EDGE, _GRID, _HALVINGS = 64, 33, 50


def ground_covariance(camera: Camera, pixel: F8, cov: F8) -> F8:
    """Covariances of the ground points that pixels show, P_W = J P Jᵀ along the tangent of the ground [E13 §3.3].

    Parameters
    ----------
    camera : between pixels and ground.
    pixel : (2, N) pixels.
    cov : (N, 2, 2) covariances of the pixels, square pixels.

    Returns
    -------
    (N, 2, 2) square metres; NaN where there is no ground.

    Raises
    ------
    InputError : ``cov`` has another shape.
    """
    pixel, cov = np.asarray(pixel, np.float64), np.asarray(cov, np.float64)
    if cov.shape != (pixel.shape[1], 2, 2):
        raise InputError(
            f"expected one 2 x 2 covariance for each of {pixel.shape[1]} pixels, came shape {cov.shape}",
            where="covariance of ground points",
        )
    slope = camera.jacobian(pixel)
    return slope @ cov @ slope.transpose(0, 2, 1)


def footprint(camera: Camera, frame_size: tuple[float, float], limit: float = 100.0) -> F8:
    """(2, K) corners of the ground that the frame shows, metres; K = 0 where it shows none.

    They go around the frame from its upper left corner. Where its edge shows no ground, or ground deeper than ``limit``,
    the way to it from a visible pixel is cut where the ground ends. On terrain, which may hide ground in between, that is
    the outline as far as it can be seen from the middle.

    Parameters
    ----------
    camera : between pixels and ground.
    frame_size : width and height, pixels.
    limit : greatest depth (`Camera.depth`), metres.

    Returns
    -------
    (2, K) metres.

    Raises
    ------
    InputError : the size or the limit is not above 0.
    """
    width, height = frame_size
    if not (width > 0 and height > 0 and limit > 0):
        raise InputError(f"expected a frame size and a limit above 0, came {width:g} x {height:g} and {limit:g} m")

    def visible(pixel: F8) -> Bool:
        return np.asarray(camera.depth(camera.ground(pixel)) <= limit)

    t, none = np.arange(_EDGE) / _EDGE, np.zeros(_EDGE)
    edge = np.array([[width], [height]]) * np.array([[*t, *none + 1, *1 - t, *none], [*none, *t, *none + 1, *1 - t]])
    grid = np.stack(np.meshgrid(np.linspace(0, width, _GRID), np.linspace(0, height, _GRID))).reshape(2, -1)
    shown = grid[:, visible(grid)]
    if not shown.shape[1]:
        return np.zeros((2, 0))
    # Of the visible pixels the one nearest to their middle: the middle itself need not be visible.
    middle = shown[:, np.argmin(((shown - shown.mean(axis=1, keepdims=True)) ** 2).sum(axis=0))][:, None]
    seen, unseen = np.zeros(edge.shape[1]), np.ones(edge.shape[1])
    for _ in range(_HALVINGS):
        share = (seen + unseen) / 2
        good = visible(middle + share * (edge - middle))
        seen, unseen = np.where(good, share, seen), np.where(good, unseen, share)
    return camera.ground(middle + seen * (edge - middle))
