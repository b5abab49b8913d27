"""Components of a mask, measured: where they are and how large, where one falls into two, how much of an edge it has.

A frame has many of them, and they are small: several calls of OpenCV for each take longer than the work that these do.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER, F

U1 = NDArray[np.uint8]
F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
I4 = NDArray[np.int32]
I8 = NDArray[np.int64]
_2 = F(2)


@njit(**ENTRY)
def measured(points: I4, ends: I8) -> tuple[I8, F8]:
    """(n, 4) left, top, right and bottom, one beyond the last, of n closed contours, and (n,) the areas that they enclose.

    ``points`` (m, 2) are all their corners, those of a contour up to its of the ``ends`` (n,).
    """
    boxes, areas, start = np.empty((len(ends), 4), np.int64), np.zeros(len(ends)), 0
    for i, end in enumerate(ends):
        x, y = np.int64(points[end - 1, 0]), np.int64(points[end - 1, 1])
        boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3] = x, y, x + 1, y + 1
        for k in range(start, end):
            a, b = np.int64(points[k, 0]), np.int64(points[k, 1])
            areas[i] += x * b - a * y
            x, y = a, b
            boxes[i, 0], boxes[i, 1] = min(boxes[i, 0], x), min(boxes[i, 1], y)
            boxes[i, 2], boxes[i, 3] = max(boxes[i, 2], x + 1), max(boxes[i, 3], y + 1)
        areas[i], start = abs(areas[i]) / 2, end
    return boxes, areas


@njit(**ENTRY)
def valley(filled: U1, depth: float, smooth: int, margin: int, least: float) -> int:
    """The column at which ``filled`` (h, w), not 0 in a component, is lowest between two higher parts; −1: none is so deep.

    Parameters
    ----------
    filled : the component.
    depth : the column has at most this share of the lower of the highest columns on its two sides.
    smooth : columns over whose windows the mean is taken, odd.
    margin, least : columns, and the share of the area, that there are on either side at the least.
    """
    height, width = filled.shape
    counts, profile = np.zeros(width), np.zeros(width)
    for i in range(height):
        for j in range(width):
            counts[j] += filled[i, j] != 0
    for j in range(width):
        for k in range(j - smooth // 2, j + smooth // 2 + 1):
            profile[j] += counts[mirrored(k, width)]
    profile /= smooth
    right, total, before, left = profile.copy(), profile.sum(), 0.0, 0.0
    for j in range(width - 2, -1, -1):
        right[j] = max(right[j], right[j + 1])
    found, lowest = -1, depth
    for j in range(width):
        before, left = before + profile[j], max(left, profile[j])
        inside = margin <= j < width - margin and least * total < before < (1 - least) * total
        ratio = profile[j] / max(min(left, right[j]), 1.0)
        if inside and (ratio < lowest or (found < 0 and ratio == lowest)):
            found, lowest = j, ratio
    return found


@njit(**ENTRY)
def edges(now: U1, reference: F4, outline: U1, boxes: I8) -> F8:
    """(n, 2) mean gradient (Sobel) of ``now`` and of the ``reference`` (H, W) where the ``outline`` (H, W) in each box is
    not 0, in every other row; n ``boxes`` of left, top, right and bottom."""
    height, width = outline.shape
    out = np.zeros((len(boxes), 2))
    for k, (left, top, right, bottom) in enumerate(boxes):
        count = 0
        for i in range(top, bottom, 2):
            for j in range(left, right):
                if outline[i, j]:
                    rows = mirrored(i - 1, height), i, mirrored(i + 1, height)
                    columns = mirrored(j - 1, width), j, mirrored(j + 1, width)
                    out[k, 0] += _gradient(now, rows, columns)
                    out[k, 1] += _gradient(reference, rows, columns)
                    count += 1
        out[k] /= max(count, 1)
    return out


@njit(**INNER)
def _gradient(picture: NDArray[Any], rows: tuple[int, int, int], columns: tuple[int, int, int]) -> Any:
    """Of the pixel in the middle of three rows and three columns."""
    (above, row, below), (left, column, right) = rows, columns
    a, b = F(picture[above, left]), F(picture[above, right])
    c, d = F(picture[below, left]), F(picture[below, right])
    x = b - a + _2 * (F(picture[row, right]) - F(picture[row, left])) + d - c
    y = c - a + _2 * (F(picture[below, column]) - F(picture[above, column])) + d - b
    return np.sqrt(x * x + y * y)


@njit(**INNER)
def mirrored(k: int, size: int) -> int:
    """The index within 0 … size − 1 that k is when the picture is mirrored at its outermost pixels."""
    while k < 0 or k >= size:
        k = 0 if size == 1 else (-k if k < 0 else 2 * size - 2 - k)
    return k
