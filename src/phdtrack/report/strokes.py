"""Drawing primitives over OpenCV: clipped, dashed and translucent strokes, and small text plates.

All functions write into the picture they are given: they are for `draw`, which hands them its own copy. Sizes follow the
frame, so that a line has the same weight on a postage stamp and on a 4K picture. Colours are RGB here (see `palette`),
BGR in the picture.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from phdtrack.report.palette import Rgb, ink_on
from phdtrack.types import F8, Image

Corners = tuple[int, int, int, int]
_FONT = cv2.FONT_HERSHEY_SIMPLEX


@dataclass(frozen=True, slots=True)
class Pen:
    """Sizes in pixels (and a font scale) that suit a frame."""

    line: int
    thin: int
    font: float
    bold: int
    dash: int

    @classmethod
    def for_frame(cls, height: int, width: int) -> Pen:
        """480 lines are the unit; very small frames keep text that can still be read."""
        unit = min(height, 0.75 * width) / 480
        return cls(
            line=max(1, round(1.6 * unit)),
            thin=max(1, round(0.7 * unit)),
            font=max(0.34, 0.39 * unit),
            bold=max(1, round(unit)),
            dash=max(5, round(8 * unit)),
        )


def corners(box: F8, image: Image) -> Corners | None:
    """Whole-pixel left, top, right, bottom; None where nothing of the box could be drawn (not finite, or outside).

    Boxes reaching far out are cut one frame beyond the edges: OpenCV's coordinates overflow otherwise.
    """
    high, wide = image.shape[:2]
    left, right = sorted((float(box[0]), float(box[2])))
    top, bottom = sorted((float(box[1]), float(box[3])))
    if not np.isfinite(box).all() or right < 0 or bottom < 0 or left > wide or top > high:
        return None
    x0, x1 = (round(min(max(v, -wide), 2 * wide)) for v in (left, right))
    y0, y1 = (round(min(max(v, -high), 2 * high)) for v in (top, bottom))
    return x0, y0, x1, y1


def rectangle(image: Image, box: Corners, colour: Rgb, width: int) -> None:
    """A closed outline."""
    cv2.rectangle(image, box[:2], box[2:], colour[::-1], width)


def dashed_rectangle(image: Image, box: Corners, colour: Rgb, width: int, dash: int) -> None:
    """An outline of dashes with corners always drawn, so that the shape stays clear."""
    x0, y0, x1, y1 = box
    for a, b in _dashes(x0, x1, dash):
        cv2.line(image, (a, y0), (b, y0), colour[::-1], width)
        cv2.line(image, (a, y1), (b, y1), colour[::-1], width)
    for a, b in _dashes(y0, y1, dash):
        cv2.line(image, (x0, a), (x0, b), colour[::-1], width)
        cv2.line(image, (x1, a), (x1, b), colour[::-1], width)


def _dashes(start: int, end: int, dash: int) -> list[tuple[int, int]]:
    """An odd number of equal pieces from ``start`` to ``end``, every other one drawn, the first and last among them."""
    pieces = max(3, 2 * round((end - start) / dash / 2) + 1)
    edges = np.linspace(start, end, pieces + 1).round().astype(int)
    return [(int(a), int(b)) for a, b in zip(edges[0::2], edges[1::2], strict=True)]


def stain(image: Image, left: int, top: int, opacity: NDArray[np.uint8], colour: Rgb) -> None:
    """Blend ``colour`` into the picture at (left, top) with ``opacity`` (h, w), 0–255; parts outside are cut off."""
    high, wide = image.shape[:2]
    x0, y0 = max(left, 0), max(top, 0)
    x1, y1 = min(left + opacity.shape[1], wide), min(top + opacity.shape[0], high)
    if x0 >= x1 or y0 >= y1:
        return
    part = image[y0:y1, x0:x1]
    alpha = opacity[y0 - top : y1 - top, x0 - left : x1 - left, None].astype(np.uint16)
    ink = np.array(colour[::-1], dtype=np.uint16)
    part[:] = ((part * (255 - alpha) + ink * alpha + 127) // 255).astype(np.uint8)


def faint_rectangle(image: Image, box: Corners, colour: Rgb, width: int, opacity: float, *, crossed: bool = False) -> None:
    """An outline that lets the picture through, with its diagonals where it is ``crossed``."""
    x0, y0, x1, y1 = box
    near, far = (width, width), (width + x1 - x0, width + y1 - y0)
    mask = np.zeros((far[1] + width + 1, far[0] + width + 1), np.uint8)
    level = round(255 * opacity)
    cv2.rectangle(mask, near, far, level, width)
    if crossed:
        cv2.line(mask, near, far, level, width, cv2.LINE_AA)
        cv2.line(mask, (near[0], far[1]), (far[0], near[1]), level, width, cv2.LINE_AA)
    stain(image, x0 - width, y0 - width, mask, colour)


def fading_line(image: Image, points: F8, colour: Rgb, width: int) -> None:
    """A line through ``points`` (n, 2), oldest first, that fades towards the oldest."""
    high, wide = image.shape[:2]
    inside = points[np.isfinite(points).all(axis=1)]
    inside = np.clip(inside, (-wide, -high), (2 * wide, 2 * high)).round().astype(int)
    if len(inside) < 2:
        return
    margin = width + 1
    low = inside.min(axis=0) - margin
    size = inside.max(axis=0) - low + margin + 1
    mask = np.zeros((int(size[1]), int(size[0])), np.uint8)
    local = [(int(x), int(y)) for x, y in inside - low]
    for k, (a, b) in enumerate(pairwise(local), start=1):
        cv2.line(mask, a, b, round(30 + 200 * k / (len(local) - 1)), width, cv2.LINE_AA)
    stain(image, int(low[0]), int(low[1]), mask, colour)


def plate(image: Image, text: str, x: int, bottom: int, fill: Rgb, pen: Pen, *, opacity: float = 1.0) -> None:
    """Text (ASCII) on a coloured plate whose lower left corner is (x, bottom), moved and shrunk to stay in the frame."""
    high, wide = image.shape[:2]
    font = pen.font
    (text_wide, text_high), below = cv2.getTextSize(text, _FONT, font, pen.bold)
    pad = max(2, text_high // 4)
    if text_wide + 2 * pad > wide:
        font *= max(0.1, (wide - 2 * pad) / text_wide)
        (text_wide, text_high), below = cv2.getTextSize(text, _FONT, font, pen.bold)
    under = pad + (0 if text.isdigit() else below // 2)
    plate_wide, plate_high = text_wide + 2 * pad, text_high + pad + under
    x = min(max(x, 0), max(wide - plate_wide, 0))
    bottom = min(max(bottom, plate_high), max(high, plate_high))
    stain(image, x, bottom - plate_high, np.full((plate_high, plate_wide), round(255 * opacity), np.uint8), fill)
    cv2.putText(image, text, (x + pad, bottom - under), _FONT, font, ink_on(fill)[::-1], pen.bold, cv2.LINE_AA)
