"""A camera known by the homography between its image and flat ground.

    w [X, Y, 1]ᵀ = H [u, v, 1]ᵀ

The horizon is the line w = 0; what lies on the other side of it is no ground. The matrix's sign is arbitrary, so one pixel
must be known to show ground. Along the ground, 1/w grows in proportion to the distance from the line below the camera, and
how fast it grows is told by the homography itself. That is as much depth as can be had without the lens.

A camera with a lens and a pose, over flat ground or terrain.

A lens turns a pixel into a ray (xu/f, yu/f, 1) in the camera's axes: x to the right, y down, z along the viewing direction.
The pose turns the world into these axes, and the ray meets the ground where

    z_c (xu/f, yu/f, 1)ᵀ = R [x, y, z(x, y)]ᵀ + T                                                         [E13 §3.3]

Written along the ray, [x, y, z]ᵀ = −RᵀT + z_c Rᵀ(xu/f, yu/f, 1)ᵀ: the one unknown is z_c, the depth. The pixel moves the
ray, and the point with it in the tangent plane of the ground. With n the normal there and d = Rᵀ(xu/f, yu/f, 1)ᵀ,

    ∂[x, y, z]ᵀ = z_c (I − d nᵀ/(nᵀd)) ∂d.

A camera for pixels that are counted from another number than 0, as MOTChallenge's files count them from 1.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from phdtrack.errors import InputError
from phdtrack.ground.terrain import Flat, Surface
from phdtrack.protocols import Camera
from phdtrack.types import F8

# A point whose w is this small beside what it is summed of lies on the horizon, for all that float64 can say.
_HORIZON = 1e-12
# A camera whose own plane meets the ground farther away than this many metres looks straight down.
_FAR = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class HomographyCamera:
    """Flat ground seen through a homography; keeps the protocol `Camera`.

    Attributes
    ----------
    matrix : (3, 3) H, from pixels to metres, for columns [u, v, 1]ᵀ; any scale and sign.
    inside : (u, v) of one pixel that shows ground. Where nothing is said, the camera is taken to stand upright: the lower
        pixels show ground.

    Raises
    ------
    InputError : the matrix is no homography (not finite, not invertible), or ``inside`` lies on its horizon.
    """

    matrix: F8
    inside: tuple[float, float] | None = None
    _forward: F8 = field(init=False, repr=False)
    _back: F8 = field(init=False, repr=False)

    def __post_init__(self) -> None:
        h = np.asarray(self.matrix, dtype=np.float64)
        if h.shape != (3, 3) or not np.isfinite(h).all():
            raise InputError("expected a matrix of 3 x 3 finite numbers", where="homography")
        rows = np.linalg.norm(h, axis=1)
        columns = np.linalg.norm(h, axis=0)
        if min(rows.min(), columns.min()) == 0 or np.linalg.cond(h / rows[:, None] / columns) > 1e12:
            raise InputError(
                "expected a matrix that can be inverted, came one that cannot",
                where="homography",
                cure="A homography maps the image to the ground one to one: are all nine numbers there?",
            )
        object.__setattr__(self, "_forward", h * (_side(h, self.inside) / np.abs(h).max()))
        object.__setattr__(self, "_back", np.linalg.inv(self._forward))

    def ground(self, pixel: F8) -> F8:
        """(2, N) points of the ground, metres, that the pixels (2, N) show; NaN on the horizon and above."""
        return _apply(self._forward, np.asarray(pixel, dtype=np.float64))

    def pixels(self, world: F8) -> F8:
        """(2, N) pixels of points (2, N) or (3, N) of the ground, metres; NaN behind the camera and off the ground."""
        world = np.asarray(world, dtype=np.float64)
        plane = world if len(world) == 2 else np.where(world[2] == 0, world[:2], np.nan)
        return _apply(self._back, plane)

    def depth(self, world: F8) -> F8:
        """(N,) distance along the ground from the line below the camera, metres; negative behind.

        A camera that looks straight down has no such line: all points of the ground are equally far from it, 1.
        """
        a, b, c = self._back[2]
        slope = np.hypot(a, b)
        if slope * _FAR < abs(c):
            return np.ones(np.shape(world)[1])
        return np.asarray((a * world[0] + b * world[1] + c) / slope)

    def jacobian(self, pixel: F8) -> F8:
        """(N, 2, 2) derivatives of `ground` at the pixels (2, N), metres per pixel; rows X, Y."""
        pixel = np.asarray(pixel, dtype=np.float64)
        point, h = self.ground(pixel), self._forward
        w = h[2, 0] * pixel[0] + h[2, 1] * pixel[1] + h[2, 2]
        return np.asarray((h[:2, :2] - point.T[:, :, None] * h[2, :2]) / w[:, None, None])


def _apply(h: F8, point: F8) -> F8:
    """(2, N) images of the points (2, N), NaN where w is not above 0."""
    terms = h[2][:, None] * np.vstack([point, np.ones(point.shape[1])])
    w = terms.sum(axis=0)
    front = np.where(w > _HORIZON * np.abs(terms).sum(axis=0), w, np.nan)
    return np.asarray((h[:2, :2] @ point + h[:2, 2:]) / front)


def _side(h: F8, inside: tuple[float, float] | None) -> float:
    """The sign of w where the ground is."""
    if inside is None:
        # How w changes with the row decides, unless it does not change over any image there is.
        level = abs(h[2, 1]) * _FAR < abs(h[2, 2])
        return float(np.sign(h[2, 2] if level else h[2, 1]))
    w = h[2] @ np.array([*inside, 1.0])
    if not abs(w) > _HORIZON * np.abs(h[2] * np.array([*inside, 1.0])).sum():
        raise InputError(
            f"expected a pixel that shows ground, came {inside}, on the horizon", where="inside of the homography"
        )
    return float(np.sign(w))


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
        """(2, N) points of the ground, metres, that the pixels (2, N) show; NaN where there are none [E13 (7)]."""
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


@dataclass(frozen=True, slots=True)
class CountedFrom:
    """``camera``, whose pixels count from 0, for pixels whose first is ``first`` along both axes."""

    camera: Camera
    first: float = 1.0

    def ground(self, pixel: F8) -> F8:
        """(2, N) points of the ground, metres, that the pixels (2, N) show."""
        return self.camera.ground(pixel - self.first)

    def pixels(self, world: F8) -> F8:
        """(2, N) pixels that show the world points (3, N), or (2, N) of the ground, metres."""
        return self.camera.pixels(world) + self.first

    def jacobian(self, pixel: F8) -> F8:
        """(N, 2, 2) derivatives of `ground` at the pixels (2, N), metres per pixel."""
        return self.camera.jacobian(pixel - self.first)

    def depth(self, world: F8) -> F8:
        """(N,) distance along the viewing direction, metres."""
        return self.camera.depth(world)
