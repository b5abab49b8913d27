"""A camera with a lens and a pose, over flat ground or terrain [E13 §3.2, §3.3].

A lens turns a pixel into a ray (xu/f, yu/f, 1) in the camera's axes, which meets the ground where

    z_c (xu/f, yu/f, 1)ᵀ = R [x, y, z(x, y)]ᵀ + T                                        [E13 §3.3]

In the world this is [x, y, z]ᵀ = −RᵀT + z_c d with d = Rᵀ(xu/f, yu/f, 1)ᵀ; the one unknown is the
depth z_c. With the ground's normal n at the point, the point moves with the ray in the tangent
plane:

    ∂[x, y, z]ᵀ = z_c (I − d nᵀ/(nᵀd)) ∂d
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from phdtrack.devices import Camera
from phdtrack.errors import InputError
from phdtrack.ground.homography import as_columns
from phdtrack.ground.lenses import Lens
from phdtrack.ground.terrain import Flat, Surface
from phdtrack.types import F8


@dataclass(frozen=True, slots=True, eq=False)
class PosedCamera:
    """A lens with a pose; implements the protocol `Camera`.

    Attributes
    ----------
    lens : pixels to rays.
    rotation : (3, 3) R, from the world's axes to the camera's.
    translation : (3,) T, metres: a world point w is R w + T in the camera's axes.
    surface : the ground; by default flat at height 0.
    """

    lens: Lens
    rotation: F8
    translation: F8
    surface: Surface = field(default_factory=Flat)

    def __post_init__(self) -> None:
        r = np.asarray(self.rotation)
        t = np.asarray(self.translation)
        where = "pose of the camera"
        shapes_fit = r.shape == (3, 3) and t.shape == (3,)
        if not (shapes_fit and np.isfinite(r).all() and np.isfinite(t).all()):
            raise InputError(
                "expected a finite rotation matrix (3, 3) and translation (3,)", where=where
            )
        if np.abs(r @ r.T - np.eye(3)).max() > 1e-6 or np.linalg.det(r) < 0:
            raise InputError(
                "expected a rotation matrix, got one that stretches or mirrors",
                where=where,
                cure="R is orthogonal with determinant 1; decompose K[R|T] into its parts first.",
            )

    @property
    def position(self) -> F8:
        """(3,) the position of the camera in the world, metres."""
        return -self.rotation.T @ self.translation

    def ground(self, pixel: F8) -> F8:
        """(2, N) ground points, metres, that the pixels (2, N) show; NaN for none [E13 (7)]."""
        direction, depth = self._meet(pixel)
        return np.asarray(self.position[:2, None] + depth * direction[:2])

    def pixels(self, world: F8) -> F8:
        """(2, N) pixels of world points (3, N), or ground points (2, N), metres; NaN for points
        that are not visible.
        """
        point = self._in_camera(world)
        return self.lens.project(point[:2] / np.where(point[2] > 0, point[2], np.nan))

    def depth(self, world: F8) -> F8:
        """(N,) z_c of world points (3, N), or ground points (2, N), metres; negative behind the
        camera.
        """
        return np.asarray(self._in_camera(world)[2])

    def jacobian(self, pixel: F8) -> F8:
        """(N, 2, 2) derivatives of `ground` at the pixels (2, N), metres per pixel; rows X, Y."""
        direction, depth = self._meet(pixel)
        normal = self.surface.normal(self.position[:2, None] + depth * direction[:2])
        # (3, 2): the derivatives of the direction by the slopes of the ray.
        axes = self.rotation[:2].T
        along = (normal.T @ axes) / (normal * direction).sum(axis=0)[:, None]
        moved = depth[:, None, None] * (axes[:2] - direction[:2].T[:, :, None] * along[:, None, :])
        return np.asarray(moved @ self.lens.slope(pixel))

    def _meet(self, pixel: F8) -> tuple[F8, F8]:
        """Directions (3, N) of the pixels' rays in the world, and the depths (N,) at which they
        meet the ground.
        """
        ray = self.lens.rays(as_columns(pixel, 2))
        direction = self.rotation[:2].T @ ray + self.rotation[2][:, None]
        return direction, self.surface.meet(self.position, direction)

    def _in_camera(self, world: F8) -> F8:
        """(3, N) world or ground points in the camera's axes, metres."""
        world = as_columns(world, 3)
        if len(world) == 2:
            world = np.vstack([world, self.surface.height(world)])
        return np.asarray(self.rotation @ world + self.translation[:, None])


@dataclass(frozen=True, slots=True)
class CountedFrom:
    """A ``camera`` whose pixels count from 0, for pixels that count from ``first``, like those of
    MOTChallenge from 1.
    """

    camera: Camera
    first: float = 1.0

    def ground(self, pixel: F8) -> F8:
        """(2, N) ground points, metres, that the pixels (2, N) show."""
        return self.camera.ground(pixel - self.first)

    def pixels(self, world: F8) -> F8:
        """(2, N) pixels of world points (3, N), or ground points (2, N), metres."""
        return self.camera.pixels(world) + self.first

    def jacobian(self, pixel: F8) -> F8:
        """(N, 2, 2) derivatives of `ground` at the pixels (2, N), metres per pixel."""
        return self.camera.jacobian(pixel - self.first)

    def depth(self, world: F8) -> F8:
        """(N,) distance along the viewing direction, metres."""
        return self.camera.depth(world)


def ground_covariance(camera: Camera, pixel: F8, cov: F8) -> F8:
    """(N, 2, 2) covariances of the ground points that pixels show, square metres, P_W = J P Jᵀ in
    the tangent plane of the ground; NaN for pixels that show no ground [E13 §3.3].

    Parameters
    ----------
    camera : between pixels and ground.
    pixel : (2, N) pixels.
    cov : (N, 2, 2) covariances of the pixels, square pixels.

    Returns
    -------
    The covariances, metres².
    """
    slope = camera.jacobian(pixel)
    return slope @ cov @ slope.transpose(0, 2, 1)
