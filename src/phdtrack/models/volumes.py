"""Spatial densities of births and false alarms over the image or the ground; none depends on other
detections.

The ratio of the birth density to the clutter density at a measurement matters. Over the same volume
one detection alone brings a mass of about rate_birth/rate_clutter; how fast further ones raise it
depends on the size of the volume relative to the noise.

``image``: uniform over all positions and all sizes of the frame, W²H² pixel⁴; on the ground
``region``: a rectangle. One more consistent detection suffices.

``local``: scale-invariant. A box (w, h) has the density rate/(4w²h²), so that ``rate`` boxes are
expected within ±1 box in position and with 0.5 to 1.5 of its size: small boxes come as close
together as their size allows, as distant objects do. On the ground the rate is that of the ellipse
of `PLANE_REACH` deviations of a detection's own noise, so that the ratio to the noise is the same
near the camera and far away. About two more detections are needed. M07's "around the detections"
suggests this. It has no total over the frame: boxes can be arbitrarily small.
"""

from __future__ import annotations

import math

import numpy as np

from phdtrack.errors import InputError
from phdtrack.kernels.box import local_densities
from phdtrack.types import F8, Bool

# Half the extent of a local volume in position, in boxes; its range of sizes, in boxes.
REACH = 1.0
SIZES = (0.5, 1.5)
# The volume of the neighbourhood of a box, in w²h².
LOCAL_FACTOR = (2 * REACH) ** 2 * (SIZES[1] - SIZES[0]) ** 2


def image_area(frame_size: tuple[float, float]) -> float:
    """All positions in the frame, WH pixel²; `InputError` if the frame has no size."""
    width, height = frame_size
    if width <= 0 or height <= 0:
        raise InputError(
            f"a uniform density over the image needs the frame's size, not {width:g}x{height:g}",
            cure="Give --frame-size WxH, or use the local volume",
        )
    return float(width * height)


def image_volume(frame_size: tuple[float, float]) -> float:
    """All positions and sizes of boxes in the frame, W²H² pixel⁴."""
    return image_area(frame_size) ** 2


def local_volume(z: F8) -> F8:
    """(N,) volume of the neighbourhood of each measurement z = (px, py, w, h), pixel⁴."""
    area: F8 = z[2] * z[3]
    return (2 * REACH) ** 2 * (SIZES[1] - SIZES[0]) ** 2 * area**2


def local_density(z: F8, rate: float) -> F8:
    """(N,) the density at each measurement z = (px, py, w, h) of boxes of which ``rate`` are
    expected in its neighbourhood, pixel⁻⁴.
    """
    return np.asarray(local_densities(np.ascontiguousarray(z), float(rate), LOCAL_FACTOR))


PLANE_REACH = 6.0
"""Extent of a local volume on the ground in deviations of the detection's noise."""
Region = tuple[float, float, float, float]
"""Left, low, right and high border in metres."""
EVERYWHERE: Region = (0.0, 0.0, 0.0, 0.0)
"""No border."""


def check_region(region: Region, where: str) -> None:
    """Raise `InputError` if this is no region."""
    left, low, right, high = region
    if not all(math.isfinite(border) for border in region) or (
        region != EVERYWHERE and not (left < right and low < high)
    ):
        raise InputError(
            "expected a region of the ground as left, low, right, high in metres, got"
            f" {list(region)}",
            where=where,
            cure="For example [-20, -25, 15, 10]; leave it out for no border",
        )


def area(region: Region, where: str) -> float:
    """The area of a region in m²; `InputError` if it has no border."""
    check_region(region, where)
    if region == EVERYWHERE:
        raise InputError(
            "a uniform density over the ground needs the region's borders",
            where=where,
            cure="Give its region",
        )
    return (region[2] - region[0]) * (region[3] - region[1])


def inside(x: F8, region: Region) -> Bool:
    """True for positions, the first two rows of ``x``, in the closed region; elementwise over
    columns.
    """
    if region == EVERYWHERE:
        everywhere: Bool = x[0] == x[0]
        return everywhere
    left, low, right, high = region
    held: Bool = (x[0] >= left) & (x[0] <= right) & (x[1] >= low) & (x[1] <= high)
    return held


def local_area(z: F8) -> F8:
    """(N,) area of the ellipse of `PLANE_REACH` deviations of measurements (5, N) on the ground,
    m².
    """
    out: F8 = math.pi * PLANE_REACH**2 * np.sqrt(z[2] * z[4] - z[3] ** 2)
    return out
