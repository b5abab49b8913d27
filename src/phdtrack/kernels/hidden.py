"""How much of a box nearer boxes cover: what the detection probability of a target behind others is made of."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.overlaps import overlapping

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
Real = TypeVar("Real", np.float32, np.float64)


@njit(**INNER)
def covered_part(
    left: Real, top: Real, right: Real, bottom: Real, by_left: Real, by_top: Real, by_right: Real, by_bottom: Real
) -> Real:
    """The part of the box's area, 0 to 1, that the other box covers; 0 where the box has none. In the type it is given."""
    width = min(right, by_right) - max(left, by_left)
    height = min(bottom, by_bottom) - max(top, by_top)
    nothing = width - width
    if not (width > nothing and height > nothing):
        return nothing
    return width / (right - left) * (height / (bottom - top))


@njit(**ENTRY)
def hiding(
    low: F8,
    high: F8,
    depth: F8,
    lower: F8,
    upper: F8,
    other_depth: F8,
    frame: F8,
    cells: I8,
    item: I8,
    corner: I8,
    found: I8,
    pairs: I8,
    part: F8,
) -> int:
    """Write into ``pairs`` (2, P) and ``part`` (P,) which boxes are covered by which nearer ones, and how much; how many.

    Boxes with corners ``low`` and ``high`` (2, M) at ``depth`` (M,), ordered as they come, against those with ``lower`` and
    ``upper`` (2, N) at ``other_depth`` (N,), of which the rest is the grid (`overlaps.rectangle_grid`); ``found`` (N,) is
    working memory. A depth of NaN hides nothing. What has no room is counted but not written.
    """
    count = 0
    for i in range(low.shape[1]):
        some = overlapping(low[0, i], low[1, i], high[0, i], high[1, i], lower, upper, frame, cells, item, corner, found)
        for c in range(some):
            j = found[c]
            if not other_depth[j] < depth[i]:
                continue
            share = covered_part(
                low[0, i], low[1, i], high[0, i], high[1, i], lower[0, j], lower[1, j], upper[0, j], upper[1, j]
            )
            if not share > 0.0:
                continue
            if count < part.size:
                pairs[0, count], pairs[1, count], part[count] = i, j, share
            count += 1
    return count


@njit(**ENTRY)
def parts_inside(xyxy: F8, width: float, height: float) -> F8:
    """(n,) the part of each box (n, 4) that lies in the image of this size, pixels."""
    out = np.empty(xyxy.shape[0])
    for i in range(xyxy.shape[0]):
        out[i] = covered_part(xyxy[i, 0], xyxy[i, 1], xyxy[i, 2], xyxy[i, 3], 0.0, 0.0, width, height)
    return out
