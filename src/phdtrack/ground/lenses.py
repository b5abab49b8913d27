"""Lenses, from pixels to rays and back: Tsai's, and OpenCV's.

Tsai's lens, as the calibration files of PETS describe it.

From a pixel (xf, yf) to the distorted sensor plane, and from there to the undistorted one:

    xd = dx (xf − Cx)/sx     yd = dy (yf − Cy)     r² = xd² + yd²     xu = xd (1 + κ r²)     yu = yd (1 + κ r²)    [E13 §3.2]

The way back is the root of κ r_d³ + r_d = r_u, which has a closed form in hyperbolic (κ > 0) or circular functions (κ < 0).
For κ < 0 the formula folds the plane at r_d = (−3κ)^(−1/2): what lies beyond is outside of the lens.

``dx`` is the width of a pixel *of the frame*. A file tells the sensor's own, with the numbers of its elements (ncx) and of
the pixels made of a line (nfx), and their product dpx = dx·ncx/nfx, which is what has to be taken.

OpenCV's lens: a pinhole with radial, tangential and thin-prism distortion.

With the slopes (x, y) of a ray and r² = x² + y²,

    x' = x q(r²) + 2 p1 x y + p2 (r² + 2x²) + s1 r² + s2 r⁴        u = fx x' + cx
    y' = y q(r²) + p1 (r² + 2y²) + 2 p2 x y + s3 r² + s4 r⁴        v = fy y' + cy
    q(t) = (1 + k1 t + k2 t² + k3 t³)/(1 + k4 t + k5 t² + k6 t³)

OpenCV computes this and its derivatives; Newton's method finds the way back. The radial part grows with r up to a fold,
where its slope is 0, and rays from there on are outside of the lens: the formula would show them a second time.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from phdtrack.checks import Positive, check
from phdtrack.errors import InputError
from phdtrack.types import F8, Bool


@dataclass(frozen=True, slots=True)
class TsaiLens:
    """Tsai's radial lens.

    Attributes
    ----------
    focal : f, metres.
    dx, dy : width and height of a pixel on the sensor, metres.
    kappa : κ, per square metre (a value per square millimetre times 10⁶).
    cx, cy : where the optical axis meets the image, pixels.
    sx : Tsai's scale of the horizontal axis.

    Raises
    ------
    InputError : a length or a scale is not above 0, or something is not finite.
    """

    focal: Positive
    dx: Positive
    dy: Positive
    kappa: float
    cx: float
    cy: float
    sx: Positive = 1.0

    def __post_init__(self) -> None:
        check(self)

    def rays(self, pixel: F8) -> F8:
        """(2, N) slopes (xu/f, yu/f) of the pixels (2, N); NaN beyond the fold [E13 §3.2]."""
        distorted, r2 = self._sensor(pixel)
        return np.asarray(distorted * (1 + self.kappa * r2) / self.focal)

    def project(self, ray: F8) -> F8:
        """(2, N) pixels of rays with slopes (2, N), by the root of the cubic; NaN for rays outside of the lens."""
        plane = self.focal * np.asarray(ray, dtype=np.float64)
        distorted = plane * self._shrink(np.hypot(plane[0], plane[1]))
        return np.stack([distorted[0] * self.sx / self.dx + self.cx, distorted[1] / self.dy + self.cy])

    def slope(self, pixel: F8) -> F8:
        """(N, 2, 2) derivatives of `rays` at the pixels (2, N)."""
        distorted, r2 = self._sensor(pixel)
        bend = 2 * self.kappa * distorted.T[:, :, None] * distorted.T[:, None, :]
        widened = (1 + self.kappa * r2)[:, None, None] * np.eye(2) + bend
        return np.asarray(widened * np.array([self.dx / self.sx, self.dy]) / self.focal)

    def _sensor(self, pixel: F8) -> tuple[F8, F8]:
        """(2, N) places on the distorted sensor plane, and the squares (N,) of their radii; NaN beyond the fold."""
        x = self.dx * (pixel[0] - self.cx) / self.sx
        y = self.dy * (pixel[1] - self.cy)
        r2 = x**2 + y**2
        outside = -3 * self.kappa * r2 >= 1
        return np.where(outside, np.nan, np.stack([x, y])), r2

    def _shrink(self, radius: F8) -> F8:
        """(N,) r_d/r_u for the undistorted radii r_u (N,); NaN where the cubic has no root before the fold."""
        if self.kappa == 0:
            return np.ones_like(radius)
        unit = 2 / np.sqrt(3 * abs(self.kappa))
        scaled = 3 * radius / unit
        if self.kappa > 0:
            root = unit * np.sinh(np.arcsinh(scaled) / 3)
        else:
            root = unit * np.sin(np.arcsin(np.where(scaled < 1, scaled, np.nan)) / 3)
        # One step of Newton takes the rounding of the closed form away; at the fold its slope is 0.
        slope = 1 + 3 * self.kappa * root**2
        polished = root - np.where(slope > 1e-6, (self.kappa * root**3 + root - radius) / np.maximum(slope, 1e-6), 0)
        return np.asarray(np.divide(polished, radius, out=np.ones_like(radius), where=radius != 0))


def rotation_zyx(rx: float, ry: float, rz: float) -> F8:
    """(3, 3) the rotation Rz·Ry·Rx of Tsai's angles, radians.

    Parameters
    ----------
    rx, ry, rz : angles about the axes, radians.
    """
    (cx, cy, cz), (sx, sy, sz) = np.cos([rx, ry, rz]), np.sin([rx, ry, rz])
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


_SIZES = (0, 4, 5, 8, 12)
# Newton's steps, the error in pixels that counts as solved, and where it starts: shares of the fold's slope at most.
_STEPS, _REACHED, _STARTS = 12, 1e-9, (0.5, 0.8, 0.95)
_TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True, slots=True, eq=False)
class OpenCVLens:
    """A lens as `cv2.calibrateCamera` gives it.

    Attributes
    ----------
    matrix : (3, 3) the camera matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], pixels.
    distortion : none, or 4, 5, 8 or 12 coefficients in OpenCV's order (k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4).

    fold : slope r of the rays at which the radial part of the distortion stops to grow; infinite where it never does.

    Raises
    ------
    InputError : a matrix of another form, another number of coefficients, or something is not finite.
    """

    matrix: F8
    distortion: F8 = field(default_factory=lambda: np.zeros(0))
    fold: float = field(init=False)

    def __post_init__(self) -> None:
        k, d = np.asarray(self.matrix), np.asarray(self.distortion)
        if k.shape != (3, 3) or not np.isfinite(k).all() or min(k[0, 0], k[1, 1]) <= 0:
            raise InputError("expected a camera matrix (3, 3) with focal lengths above 0", where="lens of the camera")
        if np.any(k[[0, 1, 2, 2], [1, 0, 0, 1]] != 0) or k[2, 2] != 1:
            raise InputError(
                "expected a camera matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], came other entries than 0 and 1",
                where="lens of the camera",
            )
        if d.ndim != 1 or len(d) not in _SIZES or not np.isfinite(d).all():
            raise InputError(
                f"expected 0, 4, 5, 8 or 12 finite distortion coefficients, came {d.size}",
                where="lens of the camera",
                cure="The two of a tilted sensor (14 coefficients) are not understood; leave them out where they are 0.",
            )
        object.__setattr__(self, "fold", _fold(np.concatenate([d, np.zeros(12 - len(d))])))

    def rays(self, pixel: F8) -> F8:
        """(2, N) slopes of the rays of the pixels (2, N); NaN where the lens reaches no such pixel."""
        pixel = np.asarray(pixel, dtype=np.float64)
        k = self.matrix
        target = np.stack([(pixel[0] - k[0, 2]) / k[0, 0], (pixel[1] - k[1, 2]) / k[1, 1]])
        if not self.distortion.any():
            return target
        # Newton's method with OpenCV's derivatives: its own inverse is a fixed-point iteration that fails near the edge.
        # Later starts lie nearer to the fold, for strong lenses, where the first ones run beyond it.
        ray, reached = np.full_like(target, np.nan), np.zeros(target.shape[1], np.bool_)
        for share in _STARTS:
            left = np.flatnonzero(~reached & np.isfinite(target).all(axis=0))
            radius = np.hypot(*target[:, left])
            start = target[:, left] * np.minimum(1.0, share * self.fold / np.maximum(radius, _TINY))
            ray[:, left], reached[left] = self._newton(start, pixel[:, left])
        return np.where(reached, ray, np.nan)

    def project(self, ray: F8) -> F8:
        """(2, N) pixels of rays with slopes (2, N); NaN for rays outside of the lens."""
        ray = np.asarray(ray, dtype=np.float64)
        return self._project(np.where(np.hypot(ray[0], ray[1]) < self.fold, ray, np.nan))[0]

    def slope(self, pixel: F8) -> F8:
        """(N, 2, 2) derivatives of `rays` at the pixels (2, N)."""
        return _inverse(self._project(self.rays(pixel))[1])

    def _project(self, ray: F8) -> tuple[F8, F8]:
        """(2, N) pixels and (N, 2, 2) their derivatives by the slopes (2, N) of the rays; NaN where these are NaN."""
        known = np.isfinite(ray).all(axis=0)
        pixel, slope = np.full(ray.shape, np.nan), np.full((ray.shape[1], 2, 2), np.nan)
        if known.any():
            points = np.vstack([ray[:, known], np.ones(np.count_nonzero(known))]).T
            none = np.zeros(3)
            shown, derivatives = cv2.projectPoints(points, none, none, self.matrix, self.distortion)
            pixel[:, known] = shown[:, 0].T
            # Columns 3 and 4 are the derivatives by a shift along x and y: at depth 1 those by the slopes.
            slope[known] = derivatives[:, 3:5].reshape(-1, 2, 2)
        return pixel, slope

    def _newton(self, ray: F8, pixel: F8) -> tuple[F8, Bool]:
        """(2, N) rays that give the pixels (2, N), from those near by; and whether (N,) they do, inside of the lens."""
        for _ in range(_STEPS):
            shown, slope = self._project(ray)
            ray = ray - np.einsum("nij,jn->in", _inverse(slope), shown - pixel)
        missed = np.abs(self._project(ray)[0] - pixel).max(axis=0, initial=0)
        return ray, (missed < _REACHED) & (np.hypot(ray[0], ray[1]) < self.fold)


def _fold(coefficients: F8) -> float:
    """The least slope at which r q(r²) stops to grow, or has a pole; infinite where there is none."""
    k1, k2, _, _, k3, k4, k5, k6, *_ = coefficients
    above, below = np.polynomial.Polynomial([1, k1, k2, k3]), np.polynomial.Polynomial([1, k4, k5, k6])
    squared = np.polynomial.Polynomial([0, 2])
    # d(r q)/dr is this over the square of the lower polynomial, in t = r².
    growth = (above + squared * above.deriv()) * below - squared * above * below.deriv()
    roots = np.concatenate([growth.trim().roots(), below.trim().roots()])
    real = roots[np.abs(roots.imag) <= 1e-12 * np.abs(roots)].real
    return float(np.sqrt(np.min(real[real > 0], initial=np.inf)))


def _inverse(matrix: F8) -> F8:
    """(N, 2, 2) inverses; NaN where there is none."""
    (a, b), (c, d) = np.moveaxis(matrix, 0, 2)
    determinant = a * d - b * c
    adjugate = np.moveaxis(np.array([[d, -b], [-c, a]]), 2, 0)
    return np.asarray(adjugate / np.where(determinant != 0, determinant, np.nan)[:, None, None])
