"""Where on the ground targets live, are born and false alarms are spread: in a rectangle, or about the detections.

What decides how fast a target is believed is the ratio of the two densities at a measurement, and the volume they are spread
over. ``region``: a rectangle of the ground; one more coherent detection suffices. ``local``: the ellipse of `REACH`
deviations of each detection's own noise, so that the ratio is the same near the camera and far away; about two more.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from phdtrack.arrays import sum_by
from phdtrack.errors import InputError
from phdtrack.kernels.grid import points_in_rectangles
from phdtrack.types import F8, Bool

PlaneVolume = Literal["region", "local"]
REACH = 6.0
"""Extent of a local volume in deviations of the detection's noise."""
Region = tuple[float, float, float, float]
"""Left, low, right and high border in metres."""
EVERYWHERE: Region = (0.0, 0.0, 0.0, 0.0)
"""No border."""


def check_region(region: Region, where: str) -> None:
    """Raise `InputError` where the region is none."""
    left, low, right, high = region
    if not all(math.isfinite(border) for border in region) or (region != EVERYWHERE and not (left < right and low < high)):
        raise InputError(
            f"expected a region of the ground as left, low, right, high in metres, got {list(region)}",
            where=where,
            cure="For example [-20, -25, 15, 10]; leave it out for no border",
        )


def area(region: Region, where: str) -> float:
    """Its area in m²; `InputError` where it has no border."""
    if region == EVERYWHERE:
        raise InputError("a uniform density over the ground needs the region's borders", where=where, cure="Give its region")
    return (region[2] - region[0]) * (region[3] - region[1])


def inside(x: F8, region: Region) -> Bool:
    """Whether positions, the first two rows of ``x``, lie in the closed region; elementwise over columns."""
    if region == EVERYWHERE:
        everywhere: Bool = x[0] == x[0]
        return everywhere
    left, low, right, high = region
    held: Bool = (x[0] >= left) & (x[0] <= right) & (x[1] >= low) & (x[1] <= high)
    return held


def local_density(place: F8, z: F8, rate: float) -> F8:
    """(L,) density per m² at positions (2, L) of ``rate`` in the ellipse around each z (5, N), summed where they overlap."""
    half = REACH * np.sqrt(z[[2, 4]])
    x, y = (np.ascontiguousarray(row) for row in place[:2])
    point, which = points_in_rectangles(x, y, z[:2] - half, z[:2] + half)
    dx, dy = x[point] - z[0, which], y[point] - z[1, which]
    determinant = z[2] * z[4] - z[3] ** 2
    xx, xy, yy = z[2:5, which]
    near = yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy <= REACH**2 * determinant[which]
    density = rate / (math.pi * REACH**2 * np.sqrt(determinant))
    return sum_by(point[near], density[which[near]], len(x))
