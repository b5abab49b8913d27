"""A camera with a lens and a pose, over flat ground or terrain.

A lens turns a pixel into a ray (xu/f, yu/f, 1) in the camera's axes: x to the right, y down, z along the viewing direction.
The pose turns the world into these axes, and the ray meets the ground where

    z_c (xu/f, yu/f, 1)ᵀ = R [x, y, z(x, y)]ᵀ + T                                                           [E13 §2]

Written along the ray, [x, y, z]ᵀ = −RᵀT + z_c Rᵀ(xu/f, yu/f, 1)ᵀ: the one unknown is z_c, the depth. The pixel moves the
ray, and the point with it in the tangent plane of the ground. With n the normal there and d = Rᵀ(xu/f, yu/f, 1)ᵀ,

    ∂[x, y, z]ᵀ = z_c (I − d nᵀ/(nᵀd)) ∂d.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from phdtrack.errors import InputError
from phdtrack.ground.terrain import Flat, Surface
from phdtrack.types import F8


class Lens(Protocol):
    """From pixels to rays and back. Where the lens's formula has no meaning, there are columns of NaN."""

    def rays(self, pixel: F8) -> F8:
        """(2, N) slopes (xu/f, yu/f) of the rays of the pixels (2, N)."""

    def project(self, ray: F8) -> F8:
        """(2, N) pixels of the rays with the slopes (2, N)."""

    def slope(self, pixel: F8) -> F8:
        """(N, 2, 2) derivatives of `rays` at the pixels (2, N)."""


@dataclass(frozen=True, slots=True, eq=False)
class PosedCamera:
    """A lens with a pose; keeps the protocol `Camera`.

    Attributes
    ----------
    lens : pixels to rays.
    rotation : (3, 3) R, from the world's axes to the camera's.
    translation : (3,) T, metres: a world point w is R w + T in the camera's axes.
    surface : the ground; flat at height 0 where nothing is said.

    Raises
    ------
    InputError : the rotation is none, or something is not finite.
    """

    lens: Lens
    rotation: F8
    translation: F8
    surface: Surface = field(default_factory=Flat)

    def __post_init__(self) -> None:
        r, t = np.asarray(self.rotation), np.asarray(self.translation)
        if r.shape != (3, 3) or t.shape != (3,) or not (np.isfinite(r).all() and np.isfinite(t).all()):
            raise InputError("expected a finite rotation matrix (3, 3) and translation (3,)", where="pose of the camera")
        if np.abs(r @ r.T - np.eye(3)).max() > 1e-6 or np.linalg.det(r) < 0:
            raise InputError(
                "expected a rotation matrix, came one that stretches or mirrors",
                where="pose of the camera",
                cure="R is orthogonal with determinant 1; a projection matrix K[R|T] must be taken apart first.",
            )

    @property
    def position(self) -> F8:
        """(3,) where the camera stands, metres."""
        return -self.rotation.T @ self.translation

    def ground(self, pixel: F8) -> F8:
        """(2, N) points of the ground, metres, that the pixels (2, N) show; NaN where there are none [E13 (6)]."""
        direction, depth = self._meet(pixel)
        return np.asarray(self.position[:2, None] + depth * direction[:2])

    def pixels(self, world: F8) -> F8:
        """(2, N) pixels of the world points (3, N), or points (2, N) of the ground, metres; NaN where there are none."""
        point = self._in_camera(world)
        ahead = np.where(point[2] > 0, point[2], np.nan)
        return self.lens.project(point[:2] / ahead)

    def depth(self, world: F8) -> F8:
        """(N,) z_c of the world points (3, N), or points (2, N) of the ground, metres; negative behind the camera."""
        return np.asarray(self._in_camera(world)[2])

    def jacobian(self, pixel: F8) -> F8:
        """(N, 2, 2) derivatives of `ground` at the pixels (2, N), metres per pixel; rows X, Y."""
        direction, depth = self._meet(pixel)
        normal = self.surface.normal(self.position[:2, None] + depth * direction[:2])
        axes = self.rotation[:2].T  # (3, 2): how the direction moves with the slopes of the ray
        along = (normal.T @ axes) / (normal * direction).sum(axis=0)[:, None]
        moved = depth[:, None, None] * (axes[:2] - direction[:2].T[:, :, None] * along[:, None, :])
        return np.asarray(moved @ self.lens.slope(pixel))

    def _meet(self, pixel: F8) -> tuple[F8, F8]:
        """Directions (3, N) of the pixels' rays in the world, and the depths (N,) at which they meet the ground."""
        ray = self.lens.rays(np.asarray(pixel, dtype=np.float64))
        direction = self.rotation[:2].T @ ray + self.rotation[2][:, None]
        return direction, self.surface.meet(self.position, direction)

    def _in_camera(self, world: F8) -> F8:
        world = np.asarray(world, dtype=np.float64)
        height = self.surface.height(world) if len(world) == 2 else world[2]
        return np.asarray(self.rotation @ np.vstack([world[:2], height]) + self.translation[:, None])
