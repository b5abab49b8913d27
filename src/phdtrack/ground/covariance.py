"""How well a pixel's place on the ground is known: far away a pixel is metres.

The Jacobian carries the covariance along the tangent, P_W = J P Jᵀ. The unscented transform sends five sigma points through
the camera and takes their mean and covariance: where the ground curves within the noise it is the better of the two, and it
tells how far the mean lies beyond the point. Where one of its points does not meet the ground, there is no covariance.
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

    ``cov`` (N, 2, 2) are the pixels' own. NaN for a point that shows no ground [E13 §2].

    Raises
    ------
    InputError : there is no such method, or ``cov`` has another shape.
    """
    return ground_gaussian(camera, pixel, cov, method)[1]


def ground_gaussian(camera: Camera, pixel: F8, cov: F8, method: Method = "jacobian") -> tuple[F8, F8]:
    """Means (2, N), metres, and covariances (N, 2, 2) of the ground points: what `ground_covariance` is one half of.

    The mean is the pixel's own ground point by the Jacobian, that of the sigma points by the unscented transform.

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
