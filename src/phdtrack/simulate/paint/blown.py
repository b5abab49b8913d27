"""Leaves that the wind blows past the camera: clutter that is somewhere else in every frame.

They are close and fast: each is in one frame only, smeared along its way. To a background detector they are what Poisson
clutter is to a filter, detections of any size anywhere, and nothing before or after.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from phdtrack.simulate.paint.sprite import premultiplied, put
from phdtrack.types import F8, I8, Image, SequenceInfo

LENGTHS = (0.05, 0.18)
"""Of the smeared leaf, in frame heights."""
COLOURS = ((30, 90, 150), (40, 130, 170), (40, 110, 60), (25, 60, 95))


@dataclass(frozen=True, slots=True, eq=False)
class Blown:
    """All leaves of a sequence: ``frame`` (M,) ascending from 1, ``centre`` (M, 2) pixels, ``sprite`` (M,) its index.

    ``sprites`` are the few different leaves there are, ready to be put on a canvas.
    """

    frame: I8
    centre: F8
    sprite: I8
    sprites: tuple[Image, ...]

    def fly(self, canvas: Image, number: int) -> None:
        """Draw the leaves of frame ``number`` on the canvas, in place."""
        for row in range(*np.searchsorted(self.frame, [number, number + 1])):
            leaf = self.sprites[self.sprite[row]]
            left, top = self.centre[row] - np.array([leaf.shape[1], leaf.shape[0]]) / 2
            put(canvas, leaf, round(float(left)), round(float(top)))


def blown(info: SequenceInfo, rate: float, rng: np.random.Generator) -> Blown:
    """Poisson(``rate``) leaves in each frame, uniform over it."""
    frame = np.repeat(np.arange(1, info.frames + 1), rng.poisson(rate, info.frames))
    centre = rng.random((len(frame), 2)) * np.array([info.width, info.height])
    sprites = tuple(_leaf(info.height, rng) for _ in range(40)) if len(frame) else ()
    return Blown(frame, centre, rng.integers(max(len(sprites), 1), size=len(frame)), sprites)


def _leaf(height: int, rng: np.random.Generator) -> Image:
    """One leaf, smeared along its way; mostly it falls."""
    low, high = LENGTHS
    length = max(8.0, height * low * (high / low) ** rng.random())
    thick = max(4.0, length * float(rng.uniform(0.3, 0.6)))
    side = int(np.ceil(length)) + 8
    opacity = np.zeros((side, side), np.uint8)
    axes = (max(2, round(length / 2)), max(2, round(thick / 2)))
    cv2.ellipse(opacity, (side // 2, side // 2), axes, float(rng.normal(90, 30)), 0, 360, 235, -1, cv2.LINE_AA)
    opacity = cv2.GaussianBlur(opacity, (0, 0), max(0.6, 0.04 * length))
    tone = np.array(COLOURS[rng.integers(len(COLOURS))]) * rng.uniform(0.7, 1.3)
    colour = np.full((side, side, 3), np.clip(tone, 0, 255), np.uint8)
    return premultiplied(colour, opacity)
