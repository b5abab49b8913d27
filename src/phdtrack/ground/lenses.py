"""Lenses: a pixel to the ray (xu/f, yu/f, 1) in the camera's axes (x to the right, y down, z along
the viewing direction), and back.

Tsai's lens, as the calibration files of PETS describe it [E13 §3.2]:

    xd = dx (xf − Cx)/sx        xu = xd (1 + κ r²)
    yd = dy (yf − Cy)           yu = yd (1 + κ r²)          r² = xd² + yd²

The inverse is the root of κ r_d³ + r_d = r_u, in closed form. For κ < 0 the formula folds the plane
at r_d = (−3κ)^(−1/2): points beyond it are outside of the lens. OpenCV's lens has radial,
tangential and thin-prism distortion (`cv2.projectPoints`); its radial part has a fold, too.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from phdtrack.errors import Checked, InputError, Positive
from phdtrack.opencv_package import cv2
from phdtrack.types import F8

# Newton's method in OpenCV's lens: the number of steps, the error in pixels that counts as solved,
# and the largest radii of the starts, as shares of the fold.
_STEPS = 12
_SOLVED = 1e-9
_STARTS = (0.5, 0.8, 0.95)
_TINY = float(np.finfo(np.float64).tiny)
# No lens has larger distortion coefficients, and smaller ones have no effect.
_MAX_DISTORTION = 1e6
_MIN_DISTORTION = 1e-30


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
        """(2, N) slopes (xu/f, yu/f) of the pixels (2, N); NaN beyond the fold [E13 §3.2].

        Parameters
        ----------
        pixel : (2, N) pixels.
        """
        distorted, r2 = self._sensor(pixel)
        return np.asarray(distorted * (1 + self.kappa * r2) / self.focal)

    def project(self, ray: F8) -> F8:
        """(2, N) pixels of rays with slopes (2, N), by the root of the cubic; NaN for rays outside
        of the lens.

        Parameters
        ----------
        ray : (2, N) slopes x/z, y/z in the camera's axes.
        """
        plane = self.focal * np.asarray(ray, dtype=np.float64)
        distorted = plane * self._shrink(np.hypot(plane[0], plane[1]))
        return np.stack(
            [distorted[0] * self.sx / self.dx + self.cx, distorted[1] / self.dy + self.cy]
        )

    def slope(self, pixel: F8) -> F8:
        """(N, 2, 2) derivatives of `rays` at the pixels (2, N).

        Parameters
        ----------
        pixel : (2, N) pixels.
        """
        distorted, r2 = self._sensor(pixel)
        bend = 2 * self.kappa * distorted.T[:, :, None] * distorted.T[:, None, :]
        widened = (1 + self.kappa * r2)[:, None, None] * np.eye(2) + bend
        return np.asarray(widened * np.array([self.dx / self.sx, self.dy]) / self.focal)

    def _sensor(self, pixel: F8) -> tuple[F8, F8]:
        """(2, N) positions on the distorted sensor plane, NaN beyond the fold, and their squared
        radii (N,).
        """
        position = np.stack(
            [self.dx * (pixel[0] - self.cx) / self.sx, self.dy * (pixel[1] - self.cy)]
        )
        r2 = (position**2).sum(axis=0)
        return np.where(-3 * self.kappa * r2 >= 1, np.nan, position), r2

    def _shrink(self, radius: F8) -> F8:
        """(N,) r_d/r_u for the undistorted radii r_u (N,); NaN if the cubic has no root before the
        fold.
        """
        if self.kappa == 0:
            return np.ones_like(radius)
        unit = 2 / np.sqrt(3 * abs(self.kappa))
        scaled = 3 * radius / unit
        if self.kappa > 0:
            root = unit * np.sinh(np.arcsinh(scaled) / 3)
        else:
            root = unit * np.sin(np.arcsin(np.where(scaled < 1, scaled, np.nan)) / 3)
        # One Newton step removes the rounding error of the closed form, except at the fold, where
        # the slope is 0.
        slope = 1 + 3 * self.kappa * root**2
        step = (self.kappa * root**3 + root - radius) / np.maximum(slope, 1e-6)
        polished = root - np.where(slope > 1e-6, step, 0)
        return np.asarray(np.divide(polished, radius, out=np.ones_like(radius), where=radius != 0))


@dataclass(frozen=True, slots=True, eq=False)
class OpenCVLens:
    """A lens with the parameters of `cv2.calibrateCamera`.

    Attributes
    ----------
    matrix : (3, 3) the camera matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], pixels.
    distortion : none, or 4, 5, 8 or 12 coefficients in OpenCV's order (k1, k2, p1, p2, k3, k4, k5,
        k6, s1, s2, s3, s4).
    fold : slope of the rays at which the radial part of the distortion stops growing; infinite if
        it never does.
    """

    matrix: F8
    distortion: F8 = field(default_factory=lambda: np.zeros(0))
    fold: float = field(init=False)

    def __post_init__(self) -> None:
        k = np.asarray(self.matrix)
        d = np.asarray(self.distortion)
        where = "lens of the camera"
        if k.shape != (3, 3) or not np.isfinite(k).all() or min(k[0, 0], k[1, 1]) <= 0:
            raise InputError(
                "expected a camera matrix (3, 3) with focal lengths above 0", where=where
            )
        if np.any(k[[0, 1, 2, 2], [1, 0, 0, 1]] != 0) or k[2, 2] != 1:
            raise InputError(
                "expected a camera matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], got other entries"
                " than 0 and 1",
                where=where,
            )
        size_allowed = d.ndim == 1 and len(d) in (0, 4, 5, 8, 12)
        if not (size_allowed and (np.abs(d) <= _MAX_DISTORTION).all()):
            raise InputError(
                "expected 0, 4, 5, 8 or 12 finite distortion coefficients of at most"
                f" {_MAX_DISTORTION:g}, got {d.size}",
                where=where,
                cure=(
                    "The two of a tilted sensor (14 coefficients) are not supported; omit them if"
                    " they are 0."
                ),
            )
        object.__setattr__(self, "fold", _fold(np.concatenate([d, np.zeros(12 - len(d))])))

    def rays(self, pixel: F8) -> F8:
        """(2, N) slopes of the rays of the pixels (2, N); NaN for pixels that no ray reaches.

        Parameters
        ----------
        pixel : (2, N) pixels.
        """
        pixel = np.asarray(pixel, dtype=np.float64)
        target = (pixel - self.matrix[:2, 2:]) / np.diag(self.matrix)[:2, None]
        if not self.distortion.any():
            return target
        # Newton's method with OpenCV's derivatives: OpenCV's own inverse is a fixed-point iteration
        # that fails near the edge. Later starts lie nearer to the fold, for strong lenses in which
        # the first ones run beyond it.
        rays = np.full_like(target, np.nan)
        for share in _STARTS:
            unsolved = np.flatnonzero(np.isnan(rays[0]) & np.isfinite(target).all(axis=0))
            ray = target[:, unsolved]
            wanted = pixel[:, unsolved]
            ray = ray * np.minimum(1.0, share * self.fold / np.maximum(np.hypot(*ray), _TINY))
            for _ in range(_STEPS):
                projected, slope = self._project(ray)
                ray = ray - np.einsum("nij,jn->in", _inverse(slope), projected - wanted)
            error = np.abs(self._project(ray)[0] - wanted).max(axis=0)
            solved = (error < _SOLVED) & (np.hypot(*ray) < self.fold)
            rays[:, unsolved[solved]] = ray[:, solved]
        return rays

    def project(self, ray: F8) -> F8:
        """(2, N) pixels of rays with slopes (2, N); NaN for rays outside of the lens.

        Parameters
        ----------
        ray : (2, N) slopes x/z, y/z in the camera's axes.
        """
        ray = np.asarray(ray, dtype=np.float64)
        return self._project(np.where(np.hypot(ray[0], ray[1]) < self.fold, ray, np.nan))[0]

    def slope(self, pixel: F8) -> F8:
        """(N, 2, 2) derivatives of `rays` at the pixels (2, N).

        Parameters
        ----------
        pixel : (2, N) pixels.
        """
        return _inverse(self._project(self.rays(pixel))[1])

    def _project(self, ray: F8) -> tuple[F8, F8]:
        """(2, N) pixels and (N, 2, 2) their derivatives by the slopes (2, N) of the rays; NaN for
        rays that are NaN.
        """
        known = np.isfinite(ray).all(axis=0)
        pixel = np.full(ray.shape, np.nan)
        slope = np.full((ray.shape[1], 2, 2), np.nan)
        if known.any():
            points = np.vstack([ray[:, known], np.ones(np.count_nonzero(known))]).T
            projected, derivatives = cv2.projectPoints(
                points, np.zeros(3), np.zeros(3), self.matrix, self.distortion
            )
            pixel[:, known] = projected[:, 0].T
            # Columns 3 and 4 are the derivatives by a shift along x and y; at depth 1 these are
            # those by the slopes.
            slope[known] = derivatives[:, 3:5].reshape(-1, 2, 2)
        return pixel, slope


def _fold(coefficients: F8) -> float:
    """The smallest slope at which r q(r²) stops growing or has a pole; infinite without one."""
    # Nearly vanishing coefficients would put roots beyond the range of numbers.
    k1, k2, _, _, k3, k4, k5, k6, *_ = np.where(
        np.abs(coefficients) < _MIN_DISTORTION, 0.0, coefficients
    )
    above = np.polynomial.Polynomial([1, k1, k2, k3])
    below = np.polynomial.Polynomial([1, k4, k5, k6])
    squared = np.polynomial.Polynomial([0, 2])
    # d(r q)/dr is this over the square of the denominator, in t = r².
    growth = (above + squared * above.deriv()) * below - squared * above * below.deriv()
    roots = np.concatenate([growth.trim().roots(), below.trim().roots()])
    real = roots[np.abs(roots.imag) <= 1e-12 * np.abs(roots)].real
    return float(np.sqrt(np.min(real[real > 0], initial=np.inf)))


def _inverse(matrix: F8) -> F8:
    """(N, 2, 2) inverses; NaN for singular matrices."""
    (a, b), (c, d) = matrix.transpose(1, 2, 0)
    determinant = a * d - b * c
    adjugate = np.array([[d, -b], [-c, a]])
    inverse = adjugate / np.where(determinant != 0, determinant, np.nan)
    return np.asarray(inverse.transpose(2, 0, 1))


Lens = TsaiLens | OpenCVLens
