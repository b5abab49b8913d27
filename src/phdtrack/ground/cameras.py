"""Lenses and cameras: from pixels to the ground and back [E13 §3.2, §3.3].

A camera known by the homography between its image and flat ground, w [X, Y, 1]ᵀ = H [u, v, 1]ᵀ: the
horizon is the line w =
0. The sign of H is arbitrary, so one pixel must be known to show ground. Along the ground 1/w grows
  in proportion to the
distance from the line below the camera, which is as much depth as there is without a lens.

A camera with a lens and a pose, over flat ground or terrain: a lens turns a pixel into a ray (xu/f,
yu/f, 1) in the camera's axes (x to the right, y down, z along the viewing direction), which meets
the ground where

    z_c (xu/f, yu/f, 1)ᵀ = R [x, y, z(x, y)]ᵀ + T
    [E13 §3.3]

In the world this is [x, y, z]ᵀ = −RᵀT + z_c d with d = Rᵀ(xu/f, yu/f, 1)ᵀ; the one unknown is the
depth z_c. With the ground's normal n at the point, it moves with the ray in the tangent plane: ∂[x,
y, z]ᵀ = z_c (I − d nᵀ/(nᵀd)) ∂d.

Tsai's lens, as the calibration files of PETS describe it [E13 §3.2]:

    xd = dx (xf − Cx)/sx     yd = dy (yf − Cy)     r² = xd² + yd²     xu = xd (1 + κ r²)     yu = yd
    (1 + κ r²)

The way back is the root of κ r_d³ + r_d = r_u, in closed form. For κ < 0 the formula folds the
plane at r_d = (−3κ)^(−1/2): what lies beyond is outside of the lens. OpenCV's lens has radial,
tangential and thin-prism distortion (`cv2.projectPoints`). Its radial part grows up to a fold, too.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from phdtrack.devices import Camera
from phdtrack.errors import Checked, InputError, Positive
from phdtrack.ground.terrain import Flat, Surface
from phdtrack.types import F8, Bool

# A point whose w is this small beside the terms of its sum lies on the horizon, as far as float64
# can tell.
_HORIZON = 1e-12
# A camera whose own plane meets the ground farther away than this many metres looks straight down.
_FAR = 1e6
# Newton's steps in OpenCV's lens, the error in pixels that counts as solved, and its starts: shares
# of the fold at most.
_STEPS = 12
_SOLVED = 1e-9
_STARTS = (0.5, 0.8, 0.95)
_TINY = float(np.finfo(np.float64).tiny)
# Distortion coefficients: larger ones are none of a lens, and smaller ones bend nothing.
_MOST_DISTORTION = 1e6
_TINY_DISTORTION = 1e-30
# Points along an edge of the frame, points of the grid that a visible centre is looked for on,
# halvings of a pixel's way.
_EDGE = 64
_GRID = 33
_HALVINGS = 50


@dataclass(frozen=True, slots=True, eq=False)
class HomographyCamera:
    """Flat ground seen through a homography; keeps the protocol `Camera`.

    Attributes
    ----------
    matrix : (3, 3) H, from pixels to metres, for columns [u, v, 1]ᵀ; any scale and sign.
    inside : (u, v) of one pixel that shows ground; None: the camera stands upright, and the lower
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
        # Any scale will do; that of the largest keeps squares in range.
        h = h / (np.abs(h).max() or 1.0)
        rows = np.linalg.norm(h, axis=1)
        columns = np.linalg.norm(h, axis=0)
        if (
            min(rows.min(), columns.min()) == 0
            or np.linalg.cond(h / rows[:, None] / columns) > 1e12
        ):
            raise InputError(
                "expected a matrix that can be inverted, came one that cannot",
                where="homography",
                cure=(
                    "A homography maps the image to the ground one to one: are all nine numbers"
                    " there?"
                ),
            )
        object.__setattr__(self, "_forward", h * (_side(h, self.inside) / np.abs(h).max()))
        object.__setattr__(self, "_back", np.linalg.inv(self._forward))

    def ground(self, pixel: F8) -> F8:
        """(2, N) points of the ground, metres, that the pixels (2, N) show; NaN on the horizon and
        above.
        """
        return _through(self._forward, _columns(pixel, 2))

    def pixels(self, world: F8) -> F8:
        """(2, N) pixels of points (2, N) or (3, N) of the ground, metres; NaN behind the camera and
        off the ground.
        """
        world = _columns(world, 3)
        return _through(
            self._back, world if len(world) == 2 else np.where(world[2] == 0, world[:2], np.nan)
        )

    def depth(self, world: F8) -> F8:
        """(N,) distance along the ground from the line below the camera, metres; 1 where the camera
        looks straight down.
        """
        a, b, c = self._back[2]
        world = _columns(world, 3)
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


def _columns(points: F8, most: int) -> F8:
    """The points as (2, N) numbers, or at ``most`` (3, N); `InputError` for another shape."""
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or not 2 <= len(points) <= most:
        if most == 2:
            expected = "(2, N)"
        else:
            expected = "(2, N) or (3, N)"
        raise InputError(
            f"expected points as columns, {expected}, got {points.shape}", where="camera"
        )
    return points


def _through(h: F8, point: F8) -> F8:
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
        if h[2, 1] == h[2, 2] == 0:
            problem = "the horizon stands upright in the picture"
            cure = "Name a pixel that shows ground: inside = [u, v]."
            raise InputError(problem, where="homography", cure=cure)
        return float(np.sign(h[2, 2] if level else h[2, 1]))
    terms = h[2] * np.array([*inside, 1.0])
    if not abs(terms.sum()) > _HORIZON * np.abs(terms).sum():
        problem = f"expected a pixel that shows ground, came {inside}, on the horizon"
        raise InputError(problem, where="inside of the homography")
    return float(np.sign(terms.sum()))


@dataclass(frozen=True, slots=True)
class TsaiLens(Checked):
    """Tsai's radial lens.

    Attributes
    ----------
    focal : f, metres.
    dx, dy : width and height of a pixel of the frame on the sensor, metres.
    kappa : κ, per square metre (a value per square millimetre times 10⁶).
    cx, cy : where the optical axis meets the image, pixels.
    sx : Tsai's scale of the horizontal axis.
    """

    focal: Positive
    dx: Positive
    dy: Positive
    kappa: float
    cx: float
    cy: float
    sx: Positive = 1.0

    def rays(self, pixel: F8) -> F8:
        """(2, N) slopes (xu/f, yu/f) of the pixels (2, N); NaN beyond the fold [E13 §3.2]."""
        distorted, r2 = self._sensor(pixel)
        return np.asarray(distorted * (1 + self.kappa * r2) / self.focal)

    def project(self, ray: F8) -> F8:
        """(2, N) pixels of rays with slopes (2, N), by the root of the cubic; NaN for rays outside
        of the lens.
        """
        plane = self.focal * np.asarray(ray, dtype=np.float64)
        distorted = plane * self._shrink(np.hypot(plane[0], plane[1]))
        return np.stack(
            [distorted[0] * self.sx / self.dx + self.cx, distorted[1] / self.dy + self.cy]
        )

    def slope(self, pixel: F8) -> F8:
        """(N, 2, 2) derivatives of `rays` at the pixels (2, N)."""
        distorted, r2 = self._sensor(pixel)
        bend = 2 * self.kappa * distorted.T[:, :, None] * distorted.T[:, None, :]
        widened = (1 + self.kappa * r2)[:, None, None] * np.eye(2) + bend
        return np.asarray(widened * np.array([self.dx / self.sx, self.dy]) / self.focal)

    def _sensor(self, pixel: F8) -> tuple[F8, F8]:
        """(2, N) places on the distorted sensor plane, and the squares (N,) of their radii; NaN
        beyond the fold.
        """
        place = np.stack([self.dx * (pixel[0] - self.cx) / self.sx, self.dy * (pixel[1] - self.cy)])
        r2 = (place**2).sum(axis=0)
        return np.where(-3 * self.kappa * r2 >= 1, np.nan, place), r2

    def _shrink(self, radius: F8) -> F8:
        """(N,) r_d/r_u for the undistorted radii r_u (N,); NaN where the cubic has no root before
        the fold.
        """
        if self.kappa == 0:
            return np.ones_like(radius)
        unit = 2 / np.sqrt(3 * abs(self.kappa))
        scaled = 3 * radius / unit
        if self.kappa > 0:
            root = unit * np.sinh(np.arcsinh(scaled) / 3)
        else:
            root = unit * np.sin(np.arcsin(np.where(scaled < 1, scaled, np.nan)) / 3)
        # One step of Newton removes the rounding of the closed form; at the fold its slope is 0.
        slope = 1 + 3 * self.kappa * root**2
        polished = root - np.where(
            slope > 1e-6, (self.kappa * root**3 + root - radius) / np.maximum(slope, 1e-6), 0
        )
        return np.asarray(np.divide(polished, radius, out=np.ones_like(radius), where=radius != 0))


@dataclass(frozen=True, slots=True, eq=False)
class OpenCVLens:
    """A lens as `cv2.calibrateCamera` gives it.

    Attributes
    ----------
    matrix : (3, 3) the camera matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], pixels.
    distortion : none, or 4, 5, 8 or 12 coefficients in OpenCV's order (k1, k2, p1, p2, k3, k4, k5,
        k6, s1, s2, s3, s4).
    fold : slope of the rays at which the radial part of the distortion stops to grow; infinite
        where it never does.
    """

    matrix: F8
    distortion: F8 = field(default_factory=lambda: np.zeros(0))
    fold: float = field(init=False)

    def __post_init__(self) -> None:
        k = np.asarray(self.matrix)
        d = np.asarray(self.distortion)
        if k.shape != (3, 3) or not np.isfinite(k).all() or min(k[0, 0], k[1, 1]) <= 0:
            raise InputError(
                "expected a camera matrix (3, 3) with focal lengths above 0",
                where="lens of the camera",
            )
        if np.any(k[[0, 1, 2, 2], [1, 0, 0, 1]] != 0) or k[2, 2] != 1:
            problem = (
                "expected a camera matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], came other entries"
                " than 0 and 1"
            )
            raise InputError(problem, where="lens of the camera")
        if (
            d.ndim != 1
            or len(d) not in (0, 4, 5, 8, 12)
            or not (np.abs(d) <= _MOST_DISTORTION).all()
        ):
            raise InputError(
                "expected 0, 4, 5, 8 or 12 finite distortion coefficients of at most"
                f" {_MOST_DISTORTION:g}, came {d.size}",
                where="lens of the camera",
                cure=(
                    "The two of a tilted sensor (14 coefficients) are not understood; leave them"
                    " out where they are 0."
                ),
            )
        object.__setattr__(self, "fold", _fold(np.concatenate([d, np.zeros(12 - len(d))])))

    def rays(self, pixel: F8) -> F8:
        """(2, N) slopes of the rays of the pixels (2, N); NaN where the lens reaches no such
        pixel.
        """
        pixel = np.asarray(pixel, dtype=np.float64)
        target = (pixel - self.matrix[:2, 2:]) / np.diag(self.matrix)[:2, None]
        if not self.distortion.any():
            return target
        # Newton's method with OpenCV's derivatives: its own inverse is a fixed-point iteration that
        # fails near the edge. Later starts lie nearer to the fold, for strong lenses, where the
        # first ones run beyond it.
        found = np.full_like(target, np.nan)
        for share in _STARTS:
            left = np.flatnonzero(np.isnan(found[0]) & np.isfinite(target).all(axis=0))
            ray = target[:, left]
            wanted = pixel[:, left]
            ray = ray * np.minimum(1.0, share * self.fold / np.maximum(np.hypot(*ray), _TINY))
            for _ in range(_STEPS):
                shown, slope = self._project(ray)
                ray = ray - np.einsum("nij,jn->in", _inverse(slope), shown - wanted)
            missed = np.abs(self._project(ray)[0] - wanted).max(axis=0)
            solved = (missed < _SOLVED) & (np.hypot(*ray) < self.fold)
            found[:, left[solved]] = ray[:, solved]
        return found

    def project(self, ray: F8) -> F8:
        """(2, N) pixels of rays with slopes (2, N); NaN for rays outside of the lens."""
        ray = np.asarray(ray, dtype=np.float64)
        return self._project(np.where(np.hypot(ray[0], ray[1]) < self.fold, ray, np.nan))[0]

    def slope(self, pixel: F8) -> F8:
        """(N, 2, 2) derivatives of `rays` at the pixels (2, N)."""
        return _inverse(self._project(self.rays(pixel))[1])

    def _project(self, ray: F8) -> tuple[F8, F8]:
        """(2, N) pixels and (N, 2, 2) their derivatives by the slopes (2, N) of the rays; NaN where
        these are NaN.
        """
        known = np.isfinite(ray).all(axis=0)
        pixel = np.full(ray.shape, np.nan)
        slope = np.full((ray.shape[1], 2, 2), np.nan)
        if known.any():
            points = np.vstack([ray[:, known], np.ones(np.count_nonzero(known))]).T
            shown, derivatives = cv2.projectPoints(
                points, np.zeros(3), np.zeros(3), self.matrix, self.distortion
            )
            pixel[:, known] = shown[:, 0].T
            # Columns 3 and 4 are the derivatives by a shift along x and y: at depth 1 those by the
            # slopes.
            slope[known] = derivatives[:, 3:5].reshape(-1, 2, 2)
        return pixel, slope


def _fold(coefficients: F8) -> float:
    """The least slope at which r q(r²) stops to grow, or has a pole; infinite where there is
    none.
    """
    # What is next to nothing would put roots beyond all numbers.
    k1, k2, _, _, k3, k4, k5, k6, *_ = np.where(
        np.abs(coefficients) < _TINY_DISTORTION, 0.0, coefficients
    )
    above = np.polynomial.Polynomial([1, k1, k2, k3])
    below = np.polynomial.Polynomial([1, k4, k5, k6])
    squared = np.polynomial.Polynomial([0, 2])
    # d(r q)/dr is this over the square of the lower polynomial, in t = r².
    growth = (above + squared * above.deriv()) * below - squared * above * below.deriv()
    roots = np.concatenate([growth.trim().roots(), below.trim().roots()])
    real = roots[np.abs(roots.imag) <= 1e-12 * np.abs(roots)].real
    return float(np.sqrt(np.min(real[real > 0], initial=np.inf)))


def _inverse(matrix: F8) -> F8:
    """(N, 2, 2) inverses; NaN where there is none."""
    (a, b), (c, d) = matrix.transpose(1, 2, 0)
    determinant = a * d - b * c
    return np.asarray(
        (np.array([[d, -b], [-c, a]]) / np.where(determinant != 0, determinant, np.nan)).transpose(
            2, 0, 1
        )
    )


Lens = TsaiLens | OpenCVLens


@dataclass(frozen=True, slots=True, eq=False)
class PosedCamera:
    """A lens with a pose; keeps the protocol `Camera`.

    Attributes
    ----------
    lens : pixels to rays.
    rotation : (3, 3) R, from the world's axes to the camera's.
    translation : (3,) T, metres: a world point w is R w + T in the camera's axes.
    surface : the ground; flat at height 0 where nothing is said.
    """

    lens: Lens
    rotation: F8
    translation: F8
    surface: Surface = field(default_factory=Flat)

    def __post_init__(self) -> None:
        r = np.asarray(self.rotation)
        t = np.asarray(self.translation)
        if (
            r.shape != (3, 3)
            or t.shape != (3,)
            or not (np.isfinite(r).all() and np.isfinite(t).all())
        ):
            raise InputError(
                "expected a finite rotation matrix (3, 3) and translation (3,)",
                where="pose of the camera",
            )
        if np.abs(r @ r.T - np.eye(3)).max() > 1e-6 or np.linalg.det(r) < 0:
            raise InputError(
                "expected a rotation matrix, came one that stretches or mirrors",
                where="pose of the camera",
                cure=(
                    "R is orthogonal with determinant 1; a projection matrix K[R|T] must be taken"
                    " apart first."
                ),
            )

    @property
    def position(self) -> F8:
        """(3,) where the camera stands, metres."""
        return -self.rotation.T @ self.translation

    def ground(self, pixel: F8) -> F8:
        """(2, N) points of the ground, metres, that the pixels (2, N) show; NaN where there are
        none [E13 (7)].
        """
        direction, depth = self._meet(pixel)
        return np.asarray(self.position[:2, None] + depth * direction[:2])

    def pixels(self, world: F8) -> F8:
        """(2, N) pixels of the world points (3, N), or points (2, N) of the ground, metres; NaN
        where there are none.
        """
        point = self._in_camera(world)
        return self.lens.project(point[:2] / np.where(point[2] > 0, point[2], np.nan))

    def depth(self, world: F8) -> F8:
        """(N,) z_c of the world points (3, N), or points (2, N) of the ground, metres; negative
        behind the camera.
        """
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
        """Directions (3, N) of the pixels' rays in the world, and the depths (N,) at which they
        meet the ground.
        """
        ray = self.lens.rays(_columns(pixel, 2))
        direction = self.rotation[:2].T @ ray + self.rotation[2][:, None]
        return direction, self.surface.meet(self.position, direction)

    def _in_camera(self, world: F8) -> F8:
        world = _columns(world, 3)
        if len(world) == 2:
            height = self.surface.height(world)
        else:
            height = world[2]
        return np.asarray(
            self.rotation @ np.vstack([world[:2], height]) + self.translation[:, None]
        )


@dataclass(frozen=True, slots=True)
class CountedFrom:
    """``camera``, whose pixels count from 0, for pixels that count from ``first``, as
    MOTChallenge's files do from 1.
    """

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


def ground_covariance(camera: Camera, pixel: F8, cov: F8) -> F8:
    """(N, 2, 2) covariances of the ground points that pixels show, square metres, P_W = J P Jᵀ
    along the tangent of the ground; NaN where there is none [E13 §3.3].

    Parameters
    ----------
    camera : between pixels and ground.
    pixel : (2, N) pixels.
    cov : (N, 2, 2) covariances of the pixels, square pixels.
    """
    slope = camera.jacobian(pixel)
    return slope @ cov @ slope.transpose(0, 2, 1)


def footprint(camera: Camera, frame_size: tuple[float, float], limit: float = 100.0) -> F8:
    """(2, K) corners of the ground that the frame shows, metres, from its upper left corner on
    around the frame; K = 0 where it shows none. Raises `InputError` for a size or a limit that is
    not above 0.

    Where the edge of the frame shows no ground, or ground deeper than ``limit``, the way to it from
    a visible pixel is cut where the ground ends. On terrain, which may hide ground in between, that
    is the outline as far as it can be seen from the middle.

    Parameters
    ----------
    camera : between pixels and ground.
    frame_size : width and height, pixels.
    limit : greatest depth (`Camera.depth`), metres.
    """
    width, height = frame_size
    if not (width > 0 and height > 0 and limit > 0):
        raise InputError(
            f"expected a frame size and a limit above 0, came {width:g} x {height:g} and"
            f" {limit:g} m"
        )

    def visible(pixel: F8) -> Bool:
        return np.asarray(camera.depth(camera.ground(pixel)) <= limit)

    t = np.arange(_EDGE) / _EDGE
    none = np.zeros(_EDGE)
    edge = np.array([[width], [height]]) * np.array(
        [[*t, *none + 1, *1 - t, *none], [*none, *t, *none + 1, *1 - t]]
    )
    grid = np.stack(
        np.meshgrid(np.linspace(0, width, _GRID), np.linspace(0, height, _GRID))
    ).reshape(2, -1)
    shown = grid[:, visible(grid)]
    if not shown.shape[1]:
        return np.zeros((2, 0))
    # Of the visible pixels the one nearest to their middle: the middle itself need not be visible.
    middle = shown[:, np.argmin(((shown - shown.mean(axis=1, keepdims=True)) ** 2).sum(axis=0))][
        :, None
    ]
    seen = np.zeros(edge.shape[1])
    unseen = np.ones(edge.shape[1])
    for _ in range(_HALVINGS):
        share = (seen + unseen) / 2
        good = visible(middle + share * (edge - middle))
        seen = np.where(good, share, seen)
        unseen = np.where(good, unseen, share)
    return camera.ground(middle + seen * (edge - middle))
