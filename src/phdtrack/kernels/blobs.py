"""Cleaning of masks, and measures of their components: boxes, valleys between two objects, edges.

A mask is cleaned with 64 pixels in a number, which takes a tenth of the time of OpenCV's bytes. A
frame has many small components: several calls of OpenCV for each take longer than their work.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels import F4, F8, I4, I8, U1, U8
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER, VECTOR, D, F

_2 = F(2)
# Pixels in a number. Masks: the lowest bit of each byte, all bits of each byte except the highest,
# all bits, bit k of byte k.
_BITS = 64
_FLAGS = D(0x0101010101010101)
_FULL = D(0x7F7F7F7F7F7F7F7F)
_ALL = D(2**64 - 1)
_EACH = D(0x8040201008040201)
_1 = D(1)
_2_BITS = D(2)
_4 = D(4)
_7 = D(7)
_14 = D(14)
_28 = D(28)
_BYTE = D(255)


class Cleaning(NamedTuple):
    """Structuring elements that clean a mask: ``peel``, half the side of the square of the erosion,
    and half the width of each row of the elements of opening and closing, which are symmetric and
    have an odd number of rows. All are below 64."""

    peel: int
    opening: I8
    closing: I8


@njit(**ENTRY)
def cleaned(mask: U1, cleaning: Cleaning, margin: int) -> tuple[U1, U1]:
    """(H, W) the mask (H, W) after erosion, opening and closing, 255 for foreground, and (H, W) 255
    at most ``margin`` pixels from it.

    Pixels outside of the picture never change the result, as in OpenCV.
    """
    width = mask.shape[1]
    bits = _packed(mask)
    bits = _eroded(bits, width, np.full(2 * cleaning.peel + 1, cleaning.peel))
    bits = _dilated(_eroded(bits, width, cleaning.opening), width, cleaning.opening)
    bits = _eroded(_dilated(bits, width, cleaning.closing), width, cleaning.closing)
    out: U1 = _unpacked(bits, width)
    near: U1 = _unpacked(_dilated(bits, width, np.full(2 * margin + 1, margin)), width)
    return out, near


@njit(**ENTRY)
def measured(points: I4, ends: I8) -> tuple[I8, F8]:
    """(n, 4) left, top, right and bottom, one beyond the last, of n closed contours, and (n,) the
    areas that they enclose.

    ``points`` (m, 2): all their corners, one contour after the other; ``ends`` (n,): the end of
    each.
    """
    boxes = np.empty((len(ends), 4), np.int64)
    areas = np.zeros(len(ends))
    start = 0
    for i, end in enumerate(ends):
        x = np.int64(points[end - 1, 0])
        y = np.int64(points[end - 1, 1])
        boxes[i, 0] = x
        boxes[i, 1] = y
        boxes[i, 2] = x + 1
        boxes[i, 3] = y + 1
        for k in range(start, end):
            a = np.int64(points[k, 0])
            b = np.int64(points[k, 1])
            areas[i] += x * b - a * y
            x = a
            y = b
            boxes[i, 0] = min(boxes[i, 0], x)
            boxes[i, 1] = min(boxes[i, 1], y)
            boxes[i, 2] = max(boxes[i, 2], x + 1)
            boxes[i, 3] = max(boxes[i, 3], y + 1)
        areas[i] = abs(areas[i]) / 2
        start = end
    return boxes, areas


@njit(**ENTRY)
def valley(filled: U1, depth: float, smooth: int, margin: int, least: float) -> int:
    """The column at which a component, ``filled`` (h, w) not 0, is lowest between two higher parts;
    −1: none is deep enough.

    ``depth``: the column has at most this share of the lower of the highest columns on its two
    sides. ``smooth``: columns of the moving average, odd. ``margin``, ``least``: least number of
    columns, and share of the area, on either side.
    """
    height, width = filled.shape
    counts = np.zeros(width)
    profile = np.zeros(width)
    for i in range(height):
        for j in range(width):
            counts[j] += filled[i, j] != 0
    for j in range(width):
        for k in range(j - smooth // 2, j + smooth // 2 + 1):
            profile[j] += counts[mirrored(k, width)]
    profile /= smooth
    right = profile.copy()
    total = profile.sum()
    before = 0.0
    left = 0.0
    for j in range(width - 2, -1, -1):
        right[j] = max(right[j], right[j + 1])
    best = -1
    lowest = depth
    for j in range(width):
        before = before + profile[j]
        left = max(left, profile[j])
        inside = margin <= j < width - margin and least * total < before < (1 - least) * total
        ratio = profile[j] / max(min(left, right[j]), 1.0)
        if inside and (ratio < lowest or (best < 0 and ratio == lowest)):
            best = j
            lowest = ratio
    return best


@njit(**ENTRY)
def edges(now: U1, reference: F4, mask: U1, reach: int, boxes: I8) -> F8:
    """(n, 2) mean gradient (Sobel) of ``now`` and of the ``reference`` (H, W) at most ``reach``
    pixels from both sides of the outline of a mask (H, W), in every other row of each box; n
    ``boxes`` of left, top, right and bottom."""
    height, width = mask.shape
    element = np.full(2 * reach + 1, reach)
    bits = _packed(mask)
    outside = _dilated(bits, width, element)
    inside = _eroded(bits, width, element)
    out = np.zeros((len(boxes), 2))
    for k, (left, top, right, bottom) in enumerate(boxes):
        count = 0
        for i in range(top, bottom, 2):
            for j in range(left, right):
                if ((outside[i, j // _BITS] & ~inside[i, j // _BITS]) >> D(j % _BITS)) & _1:
                    rows = mirrored(i - 1, height), i, mirrored(i + 1, height)
                    columns = mirrored(j - 1, width), j, mirrored(j + 1, width)
                    out[k, 0] += _gradient(now, rows, columns)
                    out[k, 1] += _gradient(reference, rows, columns)
                    count += 1
        out[k, 0] /= max(count, 1)
        out[k, 1] /= max(count, 1)
    return out


@njit(**INNER)
def _gradient(
    picture: NDArray[Any], rows: tuple[int, int, int], columns: tuple[int, int, int]
) -> Any:
    """The gradient (Sobel) at the pixel in the middle of three rows and three columns."""
    above, row, below = rows
    left, column, right = columns
    a = F(picture[above, left])
    b = F(picture[above, right])
    c = F(picture[below, left])
    d = F(picture[below, right])
    x = b - a + _2 * (F(picture[row, right]) - F(picture[row, left])) + d - c
    y = c - a + _2 * (F(picture[below, column]) - F(picture[above, column])) + d - b
    return np.sqrt(x * x + y * y)


@njit(**INNER)
def mirrored(k: int, size: int) -> int:
    """The index in 0 … size − 1 of pixel k of a picture mirrored at its outermost pixels."""
    while k < 0 or k >= size:
        if size == 1:
            k = 0
        elif k < 0:
            k = -k
        else:
            k = 2 * size - 2 - k
    return k


@njit(**INNER)
def _packed(mask: U1) -> U8:
    """(H, W / 64, rounded up) the mask in bits: bit j of number k is pixel 64 k + j."""
    height, width = mask.shape
    whole = width // 8
    out = np.zeros((height, (width + _BITS - 1) // _BITS), np.uint64)
    if width % 8 == 0:
        # Taking a row out of an array costs as much as working on it.
        eights = mask.reshape(-1).view(np.uint64)
        bits = out.reshape(-1).view(np.uint8)
        for y in range(height):
            _gather(eights, y * whole, bits, y * 8 * out.shape[1], whole)
        return out
    for y in range(height):
        _gather(mask[y, : 8 * whole].view(np.uint64), 0, out[y].view(np.uint8), 0, whole)
        for j in range(8 * whole, width):
            if mask[y, j]:
                out[y, j // _BITS] |= _1 << D(j % _BITS)
    return out


@njit(**INNER)
def _unpacked(bits: U8, width: int) -> U1:
    """The mask (H, W) of 0 and 255 from bits."""
    out = np.empty((len(bits), width), np.uint8)
    whole = width // 8
    if width % 8 == 0:
        packed = bits.reshape(-1).view(np.uint8)
        eights = out.reshape(-1).view(np.uint64)
        for y in range(len(bits)):
            _scatter(packed, y * 8 * bits.shape[1], eights, y * whole, whole)
        return out
    for y in range(len(bits)):
        _scatter(bits[y].view(np.uint8), 0, out[y, : 8 * whole].view(np.uint64), 0, whole)
        for j in range(8 * whole, width):
            out[y, j] = 255 if (bits[y, j // _BITS] >> D(j % _BITS)) & _1 else 0
    return out


@njit(**VECTOR)
def _gather(eights: U8, first: int, out: U1, start: int, count: int) -> None:
    """Pack the bytes of ``count`` numbers into bits, 1 for each that is not 0."""
    a = D(first)
    b = D(start)
    for k in range(D(count)):
        # All bits of a byte to its lowest one.
        x = eights[a + k] | (eights[a + k] >> _4)
        x |= x >> _2_BITS
        x = (x | (x >> _1)) & _FLAGS
        x |= x >> _7
        x |= x >> _14
        out[b + k] = np.uint8((x | (x >> _28)) & _BYTE)


@njit(**VECTOR)
def _scatter(packed: U1, first: int, out: U8, start: int, count: int) -> None:
    """Unpack the bits of ``count`` bytes into bytes of 0 or 255."""
    a = D(first)
    b = D(start)
    for k in range(D(count)):
        # Bit j to byte j, from there to its highest bit, and down to all of it.
        out[b + k] = ((((D(packed[a + k]) * _FLAGS & _EACH) + _FULL) >> _7) & _FLAGS) * _BYTE


@njit(**INNER)
def _eroded(bits: U8, width: int, element: I8) -> U8:
    """Erosion: the positions at which an element lies within the foreground."""
    out: U8 = _inverse(_dilated(_inverse(bits, width), width, element), width)
    return out


@njit(**INNER)
def _inverse(bits: U8, width: int) -> U8:
    """The background, within the picture."""
    out = np.empty(bits.shape, np.uint64)
    last = bits.shape[1] - 1
    inside = _ALL >> D(_BITS * (last + 1) - width)
    for y in range(len(bits)):
        for k in range(last + 1):
            out[y, k] = bits[y, k] ^ (_ALL if k < last else inside)
    return out


@njit(**INNER)
def _spread_row(bits: U8, ahead: np.uint64, back: np.uint64, spread: U8) -> None:
    """Add the foreground shifted by ``ahead`` pixels to both sides; ``back`` = 64 − ``ahead``."""
    last = bits.shape[1] - 1
    for y in range(len(bits)):
        for k in range(last + 1):
            x = spread[y, k] | (bits[y, k] << ahead) | (bits[y, k] >> ahead)
            if k > 0:
                x |= bits[y, k - 1] >> back
            if k < last:
                x |= bits[y, k + 1] << back
            spread[y, k] = x


@njit(**INNER)
def _dilated(bits: U8, width: int, element: I8) -> U8:
    """Dilation: the positions at which an element meets the foreground.

    ``element``: half the width of each of its rows, below 64.
    """
    height = len(bits)
    out = np.zeros(bits.shape, np.uint64)
    spread = bits.copy()
    last = bits.shape[1] - 1
    widest = 0
    for i in range(len(element)):
        widest = max(widest, element[i])
    for reach in range(widest + 1):
        ahead = D(reach)
        back = D(_BITS - reach)
        if reach > 0:
            _spread_row(bits, ahead, back, spread)
        for i in range(len(element)):
            shift = i - len(element) // 2
            if element[i] == reach:
                for y in range(max(0, -shift), min(height, height - shift)):
                    for k in range(last + 1):
                        out[y, k] |= spread[y + shift, k]
    inside = _ALL >> D(_BITS * (last + 1) - width)
    for y in range(height):
        out[y, last] &= inside
    return out
