"""Contours of groups: level curves of the position intensity [E13 §5].

    v(p) = Σ_i w_i N(p; m_i, P_i)  over position alone,   contour = {p : v(p) = level}

At E13's level of 0.1 people per square metre one person has a contour as long as w/(2π√|P|) exceeds
it, and none if the position is less certain; a loose group may have several.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from phdtrack.errors import Checked, NonNegative, Positive
from phdtrack.opencv_package import cv2
from phdtrack.types import F8, Bool, GaussianMixture

# Largest number of grid points along each side: the grid of a large group with narrow components is
# coarser than asked for.
MAX_GRID = 160


@dataclass(frozen=True, slots=True)
class Contours(Checked):
    """Level and accuracy of the curves.

    Parameters
    ----------
    level : people per square metre on the curve.
    grid_density : grid points per standard deviation of the narrowest component of a group.
    tolerance : metres by which a polygon may deviate from the curve on the grid to have fewer
        corners (Douglas and Peucker).
    """

    level: Positive = 0.1
    grid_density: Positive = 4.0
    tolerance: NonNegative = 0.02

    def of(self, mixture: GaussianMixture, members: Bool) -> tuple[F8, ...]:
        """Closed polygons (2, K), metres, first point = last, around the components ``members``
        (J,).

        Outer curves run counter-clockwise (x to the right, y up), holes clockwise. There are none
        if the intensity stays below the level.
        """
        weight = mixture.weight[members]
        mean = mixture.mean[:2, members]
        cov = mixture.covariance[members][:, :2, :2]
        peak = weight / (2 * math.pi * np.sqrt(np.linalg.det(cov)))
        if peak.sum() <= self.level:
            return ()
        from contourpy import contour_generator

        x, y = self._grid(peak, mean, cov)
        offset = np.stack(np.meshgrid(x, y))[:, None] - mean[:, :, None, None]
        distance2 = np.einsum("ijyx,jik,kjyx->jyx", offset, np.linalg.inv(cov), offset)
        intensity = (peak[:, None, None] * np.exp(-0.5 * distance2)).sum(axis=0)
        polygons = []
        for line in map(np.asarray, contour_generator(x, y, intensity).lines(self.level)):
            # Single precision, which OpenCV needs, is sufficient relative to the first point.
            corners = (line[:-1] - line[0]).astype(np.float32)[:, None]
            simplified = cv2.approxPolyDP(corners, self.tolerance, True)[:, 0]
            simplified = simplified + np.asarray(line[0], np.float64)
            polygons.append(np.ascontiguousarray(np.vstack([simplified, simplified[:1]]).T))
        return tuple(polygons)

    def _grid(self, peak: F8, mean: F8, cov: F8) -> list[F8]:
        """Coordinates x and y of a grid with an intensity below the level on its border."""
        # Beyond this Mahalanobis radius each component is below its share of the level.
        radius = np.sqrt(2 * np.log(np.maximum(peak * len(peak) / self.level, 1.0)))
        half = (radius + 0.5) * np.sqrt(np.stack([cov[:, 0, 0], cov[:, 1, 1]]))
        narrowest = math.sqrt(float(np.linalg.eigvalsh(cov)[:, 0].min()))
        axes = []
        for low, high in zip((mean - half).min(1), (mean + half).max(1), strict=True):
            points = math.ceil((high - low) * self.grid_density / narrowest) + 1
            axes.append(np.linspace(low, high, int(np.clip(points, 8, MAX_GRID))))
        return axes


def polygon_area(polygon: F8) -> float:
    """Signed area of a closed polygon (2, K), square metres; negative if it runs clockwise."""
    x, y = polygon
    return 0.5 * float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))
