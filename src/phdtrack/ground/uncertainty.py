"""How well a pixel's place on the ground is known: far away a pixel is metres; and what ground the frame shows.

The Jacobian carries the covariance along the tangent, P_W = J P Jᵀ. The unscented transform sends five sigma points through
the camera and takes their mean and covariance: where the ground curves within the noise it is the better of the two, and
shows how far the mean lies beyond the point. Where one of its points does not meet the ground, there is no covariance.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from phdtrack.errors import InputError
from phdtrack.protocols import Camera
from phdtrack.types import F8, Bool

Method = Literal["jacobian", "unscented"]

# n + κ = 3 in two dimensions: the fourth moments of a Gaussian along the axes.
_SPREAD = 3.0
# Points along an edge of the frame, points of the grid that a visible centre is looked for on, halvings of a pixel's way.
_EDGE, _GRID, _HALVINGS = 64, 33, 50


def ground_covariance(camera: Camera, pixel: F8, cov: F8, method: Method = "jacobian") -> F8:
    """(N, 2, 2) covariances, square metres, of the ground points of pixels; NaN where there is no ground [E13 §3.3].

    Parameters
    ----------
    camera : between pixels and ground.
    pixel : (2, N) pixels.
    cov : (N, 2, 2) covariances of the pixels, square pixels.
    method : ``jacobian``, along the tangent, or ``unscented``, by sigma points.

    Returns
    -------
    (N, 2, 2) square metres.

    Raises
    ------
    InputError : there is no such method, or ``cov`` has another shape.
    """
    return ground_gaussian(camera, pixel, cov, method)[1]


def ground_gaussian(camera: Camera, pixel: F8, cov: F8, method: Method = "jacobian") -> tuple[F8, F8]:
    """Means and covariances of the ground points: the mean is the pixel's own ground point, or that of the sigma points.

    Parameters
    ----------
    camera : between pixels and ground.
    pixel : (2, N) pixels.
    cov : (N, 2, 2) covariances of the pixels, square pixels.
    method : ``jacobian``, along the tangent, or ``unscented``, by sigma points.

    Returns
    -------
    (2, N) means, metres, and (N, 2, 2) covariances, square metres.

    Raises
    ------
    InputError : there is no such method, ``cov`` has another shape, or a covariance is not positive definite.
    """
    pixel, cov, where = np.asarray(pixel, np.float64), np.asarray(cov, np.float64), "covariance of ground points"
    if method not in get_args(Method):
        raise InputError(f"expected one of {', '.join(get_args(Method))}, came {method!r}", where=where)
    if cov.shape != (pixel.shape[1], 2, 2):
        raise InputError(
            f"expected one 2 x 2 covariance for each of {pixel.shape[1]} pixels, came shape {cov.shape}", where=where
        )
    if method == "jacobian":
        slope = camera.jacobian(pixel)
        return camera.ground(pixel), slope @ cov @ slope.transpose(0, 2, 1)
    try:
        root = np.sqrt(_SPREAD) * np.linalg.cholesky(cov)  # its columns are the steps
    except np.linalg.LinAlgError:
        raise InputError("expected covariances that are positive definite", where=where) from None
    step = np.concatenate([np.zeros_like(root[:, :, :1]), root, -root], axis=2)  # (N, 2, 5)
    weight = np.array([1 - 2 / _SPREAD] + [0.5 / _SPREAD] * 4)
    sigma = pixel[:, :, None] + step.transpose(1, 0, 2)
    place = camera.ground(sigma.reshape(2, -1)).reshape(sigma.shape)
    mean = place @ weight
    off = place - mean[:, :, None]
    return mean, np.einsum("inp,jnp,p->nij", off, off, weight)


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
