"""Tsai's lens, as the calibration files of PETS describe it.

From a pixel (xf, yf) to the distorted sensor plane, and from there to the undistorted one:

    xd = dx (xf − Cx)/sx     yd = dy (yf − Cy)     r² = xd² + yd²     xu = xd (1 + κ r²)     yu = yd (1 + κ r²)    [E13 §2]

The way back is the root of κ r_d³ + r_d = r_u, which has a closed form in hyperbolic (κ > 0) or circular functions (κ < 0).
For κ < 0 the formula folds the plane at r_d = (−3κ)^(−1/2): what lies beyond is outside of the lens.

``dx`` is the width of a pixel *of the frame*. A file tells the sensor's own, with the numbers of its elements (ncx) and of
the pixels made of a line (nfx), and their product dpx = dx·ncx/nfx, which is what has to be taken.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.checks import Positive, check
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
