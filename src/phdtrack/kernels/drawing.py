"""What was drawn on a sheet of its own, put into a picture that is kept as brightness and colours (YUV 4:2:0)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER, VECTOR, D

U1 = NDArray[np.uint8]
# Pixels of a row that are passed over together where nothing was drawn on them.
_STRETCH = 32


@njit(**ENTRY)
def blend(y: U1, u: U1, v: U1, sheet: U1, opacity: U1) -> None:
    """Mix ``sheet`` (H, W, 3), BGR, into ``y`` (H, W), ``u`` and ``v`` (H/2, W/2) by ``opacity`` (H, W), which is then 0.

    H and W are even. Colours are those of BT.601 with the range 16 … 235.
    """
    height, width = opacity.shape
    for i in range(0, height, 2):
        for start in range(0, width, _STRETCH):
            end = min(start + _STRETCH, width)
            if _drawn(opacity[i, start:end]) | _drawn(opacity[i + 1, start:end]):
                for j in range(start, end, 2):
                    _mix(y, u, v, sheet, opacity, i, j)


@njit(**VECTOR)
def _drawn(row: U1) -> np.uint8:
    """Not 0 where any of them is not."""
    found = np.uint8(0)
    for j in range(D(row.size)):
        found = np.uint8(found | row[j])
    return found


@njit(**INNER)
def _mix(y: U1, u: U1, v: U1, sheet: U1, opacity: U1, i: int, j: int) -> None:
    """Mix the four pixels from (i, j) on, which share their colours."""
    whole, blue, red = np.int64(0), np.int64(0), np.int64(0)
    for row in range(i, i + 2):
        for column in range(j, j + 2):
            a = np.int64(opacity[row, column])
            if a:
                b, g, r = np.int64(sheet[row, column, 0]), np.int64(sheet[row, column, 1]), np.int64(sheet[row, column, 2])
                light = 16 + ((66 * r + 129 * g + 25 * b + 128) >> 8)
                mixed = np.int64(y[row, column]) * (255 - a) + light * a + 128
                # Over 255, rounded, without a division.
                y[row, column] = (mixed + (mixed >> 8)) >> 8
                whole += a
                blue += a * (128 + ((112 * b - 74 * g - 38 * r + 128) >> 8))
                red += a * (128 + ((112 * r - 94 * g - 18 * b + 128) >> 8))
                opacity[row, column] = 0
    if whole:
        # 1028 / 2²⁰ is 1/1020.
        rest = 1020 - whole
        u[i // 2, j // 2] = (np.int64(u[i // 2, j // 2]) * rest + blue + 510) * 1028 >> 20
        v[i // 2, j // 2] = (np.int64(v[i // 2, j // 2]) * rest + red + 510) * 1028 >> 20
