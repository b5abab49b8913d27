"""Camera motion: points, velocities and sizes warped from the pixels of one frame to the next.

A homography G maps pixels p of the frame before to this frame, for points that do not move
themselves:

    q = (A p + t) / D,   D = gᵀp + 1,   G = [A t; gᵀ 1]

Translation, similarity and affine map are its special cases with g = 0. With J = ∂q/∂p = (A − q
gᵀ)/D at a target's centre, the centre transforms by q, the velocity by J, and both sides by √det J
= √(det G / D³), the scale of areas. Not by J's scales along the axes: these differ by shear and
tilt of the plane that was measured, mostly the ground or a wall, but people who walk on it stand
upright before and after; a zoom scales both sides equally.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from phdtrack.errors import InputError
from phdtrack.kernels.box import warped_slopes, warped_states
from phdtrack.types import F8, STILL, Matrix

# Limits of det A: no camera shrinks or enlarges an image more from one frame to the next.
_SCALES = (1e-4, 1e4)


def as_warp(matrix: Matrix, where: str) -> F8:
    """The homography (3, 3) with lower right element 1, from a (3, 3) or an affine (2, 3) matrix.

    Raises `InputError`, with ``where`` as the source, if it is no such matrix, is not finite,
    mirrors the image or scales it too much.
    """
    try:
        homography = np.array(matrix, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"expected a matrix of 3 x 3 numbers ({error})", where=where) from None
    if homography.shape == (2, 3):
        homography = np.vstack([homography, [0.0, 0.0, 1.0]])
    valid = homography.shape == (3, 3) and np.isfinite(homography).all() and homography[2, 2] != 0
    if not valid:
        value = f"an array of shape {homography.shape}"
        if homography.shape == (3, 3):
            value = f"{homography.tolist()}"
        raise InputError(
            "expected 3 x 3 or 2 x 3 finite numbers, the last of 3 x 3 not 0, got " + value,
            where=where,
            cure="The matrix takes pixels (x, y, 1) of the frame before to pixels of this frame",
        )
    # A matrix with overflow scales areas too much as well.
    with np.errstate(over="ignore", invalid="ignore"):
        warp: F8 = homography / homography[2, 2]
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
    """(d, n) states ``x`` after ``warp``; rows behind (px, py, vx, vy) are lengths."""
    moved: F8 = warped_states(np.ascontiguousarray(x, np.float64), np.ascontiguousarray(warp))
    return moved


def warp_jacobian(x: F8, warp: F8) -> F8:
    """(n, d, d) Jacobians of `warp_states`: J for positions and velocities, and the derivatives of
    J and of the scale by the position.
    """
    slopes: F8 = warped_slopes(np.ascontiguousarray(x, np.float64), np.ascontiguousarray(warp))
    return slopes


def back(warp: F8) -> F8:
    """The inverse homography, which maps pixels of this frame to those of the frame before."""
    inverse = np.linalg.inv(warp)
    return np.asarray(inverse / inverse[2, 2], np.float64)


def after(warps: list[F8]) -> F8:
    """The composition of camera motions, the first one first; `types.STILL` is none."""
    whole: F8 = np.eye(3)
    for warp in warps:
        if len(warp):
            whole = warp @ whole
    return np.asarray(whole / whole[2, 2])


def joined(warps: Sequence[F8]) -> F8:
    """The same; `types.STILL` if all are."""
    if any(len(warp) for warp in warps):
        return after(list(warps))
    return STILL
