"""A rectangle of the ground: where targets live, are born and false alarms are spread."""

from __future__ import annotations

import math

from phdtrack.errors import InputError
from phdtrack.types import F8, Bool

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
