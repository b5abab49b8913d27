"""A camera that moves: points, velocities and sizes carried from the pixels of one frame to those
of the next.

A homography G takes pixels p of the frame before to this one's, of what does not move itself:

    q = (A p + t) / D,   D = gᵀp + 1,   G = [A t; gᵀ 1]

Translation, similarity and affine map are its special cases with g = 0. With J = ∂q/∂p = (A − q
gᵀ)/D at a target's centre, its centre goes by q, its velocity by J, and both its sides by √det J =
√(det G / D³), the scale of areas. Not by J's scales along the axes: they differ by what shears or
tilts the plane that was measured, mostly the ground or a wall, and those who walk on it stand
upright before as after; a zoom, which does change them, scales both alike.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from phdtrack.errors import InputError
from phdtrack.kernels.box import warped_slopes, warped_states
from phdtrack.types import F8

# Of det A: no camera makes an image so much smaller or larger from one frame to the next.
_SCALES = (1e-4, 1e4)


def as_warp(matrix: ArrayLike, where: str) -> F8:
    """The homography (3, 3) with lower right element 1, from a (3, 3) or an affine (2, 3) matrix.

    Raises `InputError` where it is none, not finite, mirrors the image or scales it beyond belief;
    ``where`` says whose.
    """
    try:
        given = np.array(matrix, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"expected a matrix of 3 x 3 numbers ({error})", where=where) from None
    if given.shape == (2, 3):
        given = np.vstack([given, [0.0, 0.0, 1.0]])
    if given.shape != (3, 3) or not np.isfinite(given).all() or given[2, 2] == 0:
        raise InputError(
            "expected 3 x 3 or 2 x 3 finite numbers, the last of 3 x 3 not 0, got "
            f"{given.tolist() if given.shape == (3, 3) else f'an array of shape {given.shape}'}",
            where=where,
            cure="The matrix takes pixels (x, y, 1) of the frame before to pixels of this frame",
        )
    # What is too large for a float scales areas beyond belief, too.
    with np.errstate(over="ignore", invalid="ignore"):
        warp: F8 = given / given[2, 2]
        areas = np.linalg.det(warp)
    if not _SCALES[0] <= areas <= _SCALES[1]:
        raise InputError(
            "expected how a camera moves from one frame to the next, got a map that scales areas"
            f" by {areas:.3g}",
            where=where,
            cure="Give the matrix from the frame before to this one, both in pixels",
        )
    return warp


def warp_states(x: F8, warp: F8) -> F8:
    """(d, n) states ``x`` in the pixels that ``warp`` leads to; rows behind (px, py, vx, vy) are
    lengths.
    """
    return np.asarray(
        warped_states(
            np.ascontiguousarray(x, np.float64), np.ascontiguousarray(warp), np.linalg.det(warp)
        )
    )


def warp_jacobian(x: F8, warp: F8) -> F8:
    """(n, d, d) Jacobians of `warp_states`: J for places and velocities, and how J and the scale
    change with the place.
    """
    return np.asarray(
        warped_slopes(
            np.ascontiguousarray(x, np.float64), np.ascontiguousarray(warp), np.linalg.det(warp)
        )
    )


def back(warp: F8) -> F8:
    """What takes pixels of this frame to those of the frame before."""
    inverse = np.linalg.inv(warp)
    return np.asarray(inverse / inverse[2, 2], np.float64)


def after(warps: list[F8]) -> F8:
    """What takes the pixels before the first of these motions to those after the last;
    `types.STILL` counts as none.
    """
    whole: F8 = np.eye(3)
    for warp in warps:
        if len(warp):
            whole = warp @ whole
    return np.asarray(whole / whole[2, 2])
