"""Sprites: pictures with transparency, and how they get onto a canvas.

A sprite is (h, w, 4) uint8: blue, green, red multiplied by the opacity, and the opacity. Premultiplied, it can be scaled and
moved by parts of pixels without dark or bright seams, and put on a canvas by one multiplication and one addition.
"""

from __future__ import annotations

import cv2
import numpy as np

from phdtrack.types import F8, Image


def premultiplied(colour: Image, opacity: Image) -> Image:
    """The sprite of ``colour`` (h, w, 3) where ``opacity`` (h, w) says so."""
    bgr = cv2.multiply(colour, cv2.merge([opacity] * 3), scale=1 / 255)
    return np.dstack([bgr, opacity])


def pyramid(sprite: Image, smallest: int = 12) -> tuple[Image, ...]:
    """The sprite at full, half, quarter … size, as long as it is ``smallest`` pixels high."""
    levels = [sprite]
    while levels[-1].shape[0] // 2 >= smallest and levels[-1].shape[1] >= 4:
        height, width = levels[-1].shape[:2]
        levels.append(cv2.resize(levels[-1], (width // 2, height // 2), interpolation=cv2.INTER_AREA))
    return tuple(levels)


def put(canvas: Image, sprite: Image, left: int, top: int) -> None:
    """Put the sprite on the canvas, in place, with its corner at this pixel; what lies outside is cut."""
    height, width = sprite.shape[:2]
    x0, y0 = max(left, 0), max(top, 0)
    x1, y1 = min(left + width, canvas.shape[1]), min(top + height, canvas.shape[0])
    if x0 >= x1 or y0 >= y1:
        return
    part = sprite[y0 - top : y1 - top, x0 - left : x1 - left]
    room = canvas[y0:y1, x0:x1]
    clear = cv2.bitwise_not(part[:, :, 3])
    below = cv2.multiply(room, cv2.merge((clear, clear, clear)), scale=1 / 255)
    cv2.add(below, np.ascontiguousarray(part[:, :, :3]), dst=room)


def put_scaled(canvas: Image, levels: tuple[Image, ...], box: F8, *, mirrored: bool = False) -> None:
    """Put the sprite on the canvas, in place, so that it fills ``box`` (4,) exactly, parts of pixels included."""
    left, top, right, bottom = (float(v) for v in box)
    fitting = [level for level in levels if level.shape[0] >= bottom - top]
    sprite = fitting[-1] if fitting else levels[0]
    x0, y0 = int(np.floor(left)), int(np.floor(top))
    size = (int(np.ceil(right)) - x0, int(np.ceil(bottom)) - y0)
    across, down = (right - left) / sprite.shape[1], (bottom - top) / sprite.shape[0]
    start = (right - across / 2 if mirrored else left + across / 2) - x0 - 0.5
    move = np.array([[-across if mirrored else across, 0, start], [0, down, top + down / 2 - y0 - 0.5]])
    put(canvas, cv2.warpAffine(sprite, move, size, flags=cv2.INTER_LINEAR), x0, y0)
