"""How well a pixel's place on the ground is known: far away a pixel is metres.

The Jacobian carries the covariance along the tangent, P_W = J P Jᵀ. The unscented transform sends five sigma points through
the camera and takes their mean and covariance: where the ground curves within the noise it is the better of the two, and it
tells how far the mean lies beyond the point. Where one of its points does not meet the ground, there is no covariance.

The field of view on the ground: the polygon that the frame's edge draws there, cut at the horizon and at a distance.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from phdtrack.errors import InputError
from phdtrack.protocols import Camera
from phdtrack.types import F8

Method = Literal["jacobian", "unscented"]

# n + κ = 3 in two dimensions: the fourth moments of a Gaussian along the axes.
_SPREAD = 3.0


def ground_covariance(camera: Camera, pixel: F8, cov: F8, method: Method = "jacobian") -> F8:
    """(N, 2, 2) covariances in square metres of the ground points that the pixels (2, N) show.

    ``cov`` (N, 2, 2) are the pixels' own. NaN for a point that shows no ground [E13 §3.3].

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
    """Means (2, N), metres, and covariances (N, 2, 2) of the ground points: what `ground_covariance` is one half of.

    The mean is the pixel's own ground point by the Jacobian, that of the sigma points by the unscented transform.

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
    pixel, cov = np.asarray(pixel, dtype=np.float64), np.asarray(cov, dtype=np.float64)
    if method not in get_args(Method):
        raise InputError(
            f"expected one of {', '.join(get_args(Method))}, came {method!r}", where="covariance of ground points"
        )
    if cov.shape != (pixel.shape[1], 2, 2):
        raise InputError(
            f"expected one 2 x 2 covariance for each of {pixel.shape[1]} pixels, came shape {cov.shape}",
            where="covariance of ground points",
        )
    return _tangent(camera, pixel, cov) if method == "jacobian" else _unscented(camera, pixel, cov)


def _tangent(camera: Camera, pixel: F8, cov: F8) -> tuple[F8, F8]:
    slope = camera.jacobian(pixel)
    return camera.ground(pixel), slope @ cov @ slope.transpose(0, 2, 1)


def _unscented(camera: Camera, pixel: F8, cov: F8) -> tuple[F8, F8]:
    try:
        root = np.sqrt(_SPREAD) * np.linalg.cholesky(cov)  # its columns are the steps
    except np.linalg.LinAlgError:
        raise InputError("expected covariances that are positive definite", where="covariance of ground points") from None
    step = np.concatenate([np.zeros_like(root[:, :, :1]), root, -root], axis=2)  # (N, 2, 5)
    weight = np.array([1 - 2 / _SPREAD] + [0.5 / _SPREAD] * 4)
    sigma = pixel[:, :, None] + step.transpose(1, 0, 2)
    place = camera.ground(sigma.reshape(2, -1)).reshape(sigma.shape)
    mean = place @ weight
    off = place - mean[:, :, None]
    return mean, np.einsum("inp,jnp,p->nij", off, off, weight)


# Points along an edge of the frame, points of the grid that a visible centre is looked for on, halvings of a pixel's way.
_EDGE, _GRID, _HALVINGS = 64, 33, 50


def footprint(camera: Camera, frame_size: tuple[float, float], limit: float = 100.0) -> F8:
    """(2, K) corners of the ground that the frame shows, metres; K = 0 where it shows none.

    The points go around the frame from its upper left corner. Where the edge of the frame shows no ground, or ground deeper
    than ``limit``, the way from a visible pixel to the edge is cut where the ground ends: on terrain, where ground may be
    hidden in between, that is the outline as far as it can be seen from the middle.

    Parameters
    ----------
    frame_size : width and height, pixels.
    limit : greatest depth (`Camera.depth`), metres.

    Raises
    ------
    InputError : the size or the limit is not above 0.
    """
    width, height = frame_size
    if not (width > 0 and height > 0 and limit > 0):
        raise InputError(f"expected a frame size and a limit above 0, came {width:g} x {height:g} and {limit:g} m")
    edge = _edge(width, height)
    grid = np.stack(np.meshgrid(np.linspace(0, width, _GRID), np.linspace(0, height, _GRID))).reshape(2, -1)
    shown = grid[:, _visible(camera, grid, limit)]
    if not shown.shape[1]:
        return np.zeros((2, 0))
    # Of the visible pixels the one nearest to their middle: the middle itself need not be visible.
    middle = shown[:, np.argmin(((shown - shown.mean(axis=1, keepdims=True)) ** 2).sum(axis=0))][:, None]
    seen, unseen = np.zeros(edge.shape[1]), np.ones(edge.shape[1])
    for _ in range(_HALVINGS):
        share = (seen + unseen) / 2
        good = _visible(camera, middle + share * (edge - middle), limit)
        seen, unseen = np.where(good, share, seen), np.where(good, unseen, share)
    return camera.ground(middle + seen * (edge - middle))


def _visible(camera: Camera, pixel: F8, limit: float) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """(N,) whether the pixels (2, N) show ground that is no deeper than the limit."""
    return np.asarray(camera.depth(camera.ground(pixel)) <= limit)


def _edge(width: float, height: float) -> F8:
    """(2, 4·64) pixels around the frame, clockwise as the picture shows it."""
    t = np.arange(_EDGE) / _EDGE
    none, all_ = np.zeros(_EDGE), np.ones(_EDGE)
    x = np.concatenate([t, all_, 1 - t, none]) * width
    y = np.concatenate([none, t, all_, 1 - t]) * height
    return np.stack([x, y])
