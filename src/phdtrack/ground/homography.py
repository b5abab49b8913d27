"""A camera known by the homography between its image and flat ground, w [X, Y, 1]ᵀ = H [u, v, 1]ᵀ.

The horizon is the line w = 0. The sign of H is arbitrary, so one pixel must be known to show
ground. Along the ground 1/w grows in proportion to the distance from the line below the camera: it
serves as the depth, which a camera without a lens does not have.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from phdtrack.errors import InputError
from phdtrack.types import F8

# A point whose w is this small relative to the terms of its sum lies on the horizon, within the
# precision of float64.
_HORIZON = 1e-12
# A camera whose own plane meets the ground beyond this distance, metres, looks straight down.
_FAR = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class HomographyCamera:
    """Flat ground seen through a homography; implements the protocol `Camera`.

    Attributes
    ----------
    matrix : (3, 3) H, from pixels to metres, for columns [u, v, 1]ᵀ; any scale and sign.
    inside : (u, v) of one pixel that shows ground; None: the camera is upright, and the lower
        pixels show ground.
    """

    matrix: F8
    inside: tuple[float, float] | None = None
    _forward: F8 = field(init=False, repr=False)
    _back: F8 = field(init=False, repr=False)

    def __post_init__(self) -> None:
        h = np.asarray(self.matrix, dtype=np.float64)
        if h.shape != (3, 3) or not np.isfinite(h).all():
            raise InputError("expected a matrix of 3 x 3 finite numbers", where="homography")
        # The scale is arbitrary; dividing by the largest entry keeps squares in range.
        h = h / (np.abs(h).max() or 1.0)
        rows = np.linalg.norm(h, axis=1)
        columns = np.linalg.norm(h, axis=0)
        singular = min(rows.min(), columns.min()) == 0
        if singular or np.linalg.cond(h / rows[:, None] / columns) > 1e12:
            raise InputError(
                "expected a matrix that can be inverted, got a singular one",
                where="homography",
                cure=(
                    "A homography maps the image to the ground one to one: are all nine numbers"
                    " there?"
                ),
            )
        object.__setattr__(self, "_forward", h * (_sign(h, self.inside) / np.abs(h).max()))
        object.__setattr__(self, "_back", np.linalg.inv(self._forward))

    def ground(self, pixel: F8) -> F8:
        """(2, N) ground points, metres, that the pixels (2, N) show; NaN on and above the
        horizon.
        """
        return _apply(self._forward, as_columns(pixel, 2))

    def pixels(self, world: F8) -> F8:
        """(2, N) pixels of ground points (2, N) or (3, N), metres; NaN behind the camera and off
        the ground.
        """
        world = as_columns(world, 3)
        if len(world) == 3:
            world = np.where(world[2] == 0, world[:2], np.nan)
        return _apply(self._back, world)

    def depth(self, world: F8) -> F8:
        """(N,) distance along the ground from the line below the camera, metres; 1 if the camera
        looks straight down.
        """
        a, b, c = self._back[2]
        world = as_columns(world, 3)
        slope = np.hypot(a, b)
        if slope * _FAR < abs(c):
            return np.ones(np.shape(world)[1])
        return np.asarray((a * world[0] + b * world[1] + c) / slope)

    def jacobian(self, pixel: F8) -> F8:
        """(N, 2, 2) derivatives of `ground` at the pixels (2, N), metres per pixel; rows X, Y."""
        pixel = np.asarray(pixel, dtype=np.float64)
        point = self.ground(pixel)
        h = self._forward
        w = h[2, 0] * pixel[0] + h[2, 1] * pixel[1] + h[2, 2]
        return np.asarray((h[:2, :2] - point.T[:, :, None] * h[2, :2]) / w[:, None, None])


def as_columns(points: F8, max_rows: int) -> F8:
    """The points as float64 (2, N), or (3, N) if ``max_rows`` is 3. Raises `InputError` for another
    shape.
    """
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or not 2 <= len(points) <= max_rows:
        shape = "(2, N)" if max_rows == 2 else "(2, N) or (3, N)"
        raise InputError(f"expected points as columns, {shape}, got {points.shape}", where="camera")
    return points


def _apply(h: F8, point: F8) -> F8:
    """(2, N) images of the points (2, N), NaN if w is not above 0."""
    terms = h[2][:, None] * np.vstack([point, np.ones(point.shape[1])])
    w = terms.sum(axis=0)
    front = np.where(w > _HORIZON * np.abs(terms).sum(axis=0), w, np.nan)
    return np.asarray((h[:2, :2] @ point + h[:2, 2:]) / front)


def _sign(h: F8, inside: tuple[float, float] | None) -> float:
    """The sign of w on the ground."""
    if inside is None:
        # The change of w with the row decides, unless w is constant over any real image.
        level = abs(h[2, 1]) * _FAR < abs(h[2, 2])
        if h[2, 1] == h[2, 2] == 0:
            raise InputError(
                "the horizon stands upright in the picture",
                where="homography",
                cure="Name a pixel that shows ground: inside = [u, v].",
            )
        return float(np.sign(h[2, 2] if level else h[2, 1]))
    terms = h[2] * np.array([*inside, 1.0])
    if not abs(terms.sum()) > _HORIZON * np.abs(terms).sum():
        raise InputError(
            f"expected a pixel that shows ground, got {inside}, on the horizon",
            where="inside of the homography",
        )
    return float(np.sign(terms.sum()))
