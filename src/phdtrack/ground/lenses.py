"""Tsai's lens, as the calibration files of PETS describe it.

From a pixel (xf, yf) to the distorted sensor plane, and from there to the undistorted one:

    xd = dx (xf − Cx)/sx     yd = dy (yf − Cy)     r² = xd² + yd²     xu = xd (1 + κ r²)     yu = yd (1 + κ r²)    [E13 §2]

The way back is the root of κ r_d³ + r_d = r_u, which has a closed form in hyperbolic (κ > 0) or circular functions (κ < 0).
For κ < 0 the formula folds the plane at r_d = (−3κ)^(−1/2): what lies beyond is outside of the lens.

``dx`` is the width of a pixel *of the frame*. A file tells the sensor's own, with the numbers of its elements (ncx) and of
the pixels made of a line (nfx), and their product dpx = dx·ncx/nfx, which is what has to be taken.

OpenCV's lens: a pinhole with radial, tangential and thin-prism distortion.

With the slopes (x, y) of a ray and r² = x² + y²,

    x' = x q(r²) + 2 p1 x y + p2 (r² + 2x²) + s1 r² + s2 r⁴        u = fx x' + cx
    y' = y q(r²) + p1 (r² + 2y²) + 2 p2 x y + s3 r² + s4 r⁴        v = fy y' + cy
    q(t) = (1 + k1 t + k2 t² + k3 t³)/(1 + k4 t + k5 t² + k6 t³)

The way back has no closed form: Newton's method, if need be from the root of the radial part. That part grows with r up to a
fold, where its slope is 0, and rays from there on are outside of the lens: the formula would show them a second time.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from phdtrack.checks import Positive, check
from phdtrack.errors import InputError
from phdtrack.types import F8


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
        """(2, N) slopes (xu/f, yu/f) of the pixels (2, N); NaN beyond the fold [E13 §2]."""
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
    """(3, 3) the rotation Rz·Ry·Rx of Tsai's angles, radians."""
    (cx, cy, cz), (sx, sy, sz) = np.cos([rx, ry, rz]), np.sin([rx, ry, rz])
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


Mask = np.ndarray[tuple[int, ...], np.dtype[np.bool_]]

_SIZES = (0, 4, 5, 8, 12)
# Halvings that bring an interval down to the spacing of float64, steps of Newton that are plenty after them.
_HALVINGS, _STEPS = 40, 12


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
        object.__setattr__(self, "fold", _fold(self._coefficients))

    def rays(self, pixel: F8) -> F8:
        """(2, N) slopes of the rays of the pixels (2, N); NaN where the lens reaches no such pixel."""
        target = self._scaled(pixel)
        if not self.distortion.any():
            return target
        # From the pixel itself a few steps do, mostly; where they lead nowhere, the radial root is a better start.
        ray, kept = self._newton(target, target)
        lost = ~kept & np.isfinite(target).all(axis=0)
        if lost.any():
            ray[:, lost], kept[lost] = self._newton(self._radial_root(target[:, lost]), target[:, lost])
        return np.where(kept, ray, np.nan)

    def project(self, ray: F8) -> F8:
        """(2, N) pixels of rays with slopes (2, N); NaN for rays outside of the lens."""
        ray = np.asarray(ray, dtype=np.float64)
        bent = self._distort(np.where(self._inside(ray), ray, np.nan))
        return np.stack([self.matrix[0, 0] * bent[0] + self.matrix[0, 2], self.matrix[1, 1] * bent[1] + self.matrix[1, 2]])

    def slope(self, pixel: F8) -> F8:
        """(N, 2, 2) derivatives of `rays` at the pixels (2, N)."""
        scale = np.array([1 / self.matrix[0, 0], 1 / self.matrix[1, 1]])
        return np.asarray(_inverse(self._derivative(self.rays(pixel))) * scale)

    @property
    def _coefficients(self) -> F8:
        return np.concatenate([self.distortion, np.zeros(12 - len(self.distortion))])

    def _scaled(self, pixel: F8) -> F8:
        k = self.matrix
        return np.stack([(pixel[0] - k[0, 2]) / k[0, 0], (pixel[1] - k[1, 2]) / k[1, 1]])

    def _inside(self, ray: F8) -> Mask:
        return np.asarray(np.hypot(ray[0], ray[1]) < self.fold)

    def _radial(self, t: F8) -> tuple[F8, F8]:
        """q and dq/dt at the squared radii t."""
        k1, k2, _, _, k3, k4, k5, k6, *_ = self._coefficients
        above, below = 1 + t * (k1 + t * (k2 + t * k3)), 1 + t * (k4 + t * (k5 + t * k6))
        rise, fall = k1 + t * (2 * k2 + t * 3 * k3), k4 + t * (2 * k5 + t * 3 * k6)
        return above / below, (rise - above / below * fall) / below

    def _distort(self, ray: F8) -> F8:
        """(2, N) the slopes as the pinhole behind the lens sees them."""
        _, _, p1, p2, _, _, _, _, s1, s2, s3, s4 = self._coefficients
        x, y = ray
        t = x**2 + y**2
        q, _ = self._radial(t)
        return np.stack(
            [
                x * q + 2 * p1 * x * y + p2 * (t + 2 * x**2) + t * (s1 + t * s2),
                y * q + p1 * (t + 2 * y**2) + 2 * p2 * x * y + t * (s3 + t * s4),
            ]
        )

    def _derivative(self, ray: F8) -> F8:
        """(N, 2, 2) derivatives of `_distort`."""
        _, _, p1, p2, _, _, _, _, s1, s2, s3, s4 = self._coefficients
        x, y = ray
        t = x**2 + y**2
        q, grows = self._radial(t)
        prism_x, prism_y = 2 * (s1 + 2 * t * s2), 2 * (s3 + 2 * t * s4)
        xx = q + 2 * x**2 * grows + 2 * p1 * y + 6 * p2 * x + prism_x * x
        xy = 2 * x * y * grows + 2 * p1 * x + 2 * p2 * y
        yy = q + 2 * y**2 * grows + 6 * p1 * y + 2 * p2 * x + prism_y * y
        return np.moveaxis(np.array([[xx, xy + prism_x * y], [xy + prism_y * x, yy]]), 2, 0)

    def _newton(self, ray: F8, target: F8) -> tuple[F8, Mask]:
        """(2, N) rays that bend into ``target`` (2, N), from those near by; and whether (N,) they do, inside of the lens."""
        enough = 1e-14 * (1 + np.abs(target).max(axis=0, initial=0))
        for _ in range(_STEPS):
            step = self._distort(ray) - target
            # Each stops on its own, so that none depends on its neighbours; NaN is never far.
            far = np.abs(step).max(axis=0, initial=0) > enough
            if not far.any():
                break
            ray = np.where(far, ray - np.einsum("nij,jn->in", _inverse(self._derivative(ray)), step), ray)
        missed = np.abs(self._distort(ray) - target).max(axis=0, initial=0)
        return np.array(ray), (missed <= 100 * enough) & self._inside(ray)

    def _radial_root(self, target: F8) -> F8:
        """(2, N) the rays that the radial part alone would bend into ``target`` (2, N), by halving."""
        radius = np.hypot(target[0], target[1])
        low, high = np.zeros_like(radius), np.minimum(2 * radius, self.fold)
        for _ in range(_HALVINGS):  # grows until the root lies below, or the fold is reached
            short = (high * self._radial(high**2)[0] < radius) & (high < self.fold)
            if not short.any():
                break
            high = np.where(short, np.minimum(2 * high, self.fold), high)
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            short = middle * self._radial(middle**2)[0] < radius
            low, high = np.where(short, middle, low), np.where(short, high, middle)
        return np.asarray(target * np.divide(low + high, 2 * radius, out=np.ones_like(radius), where=radius != 0))


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
