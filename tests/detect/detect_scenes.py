"""Scenes that the tests of detectors draw: a textured background, squares that move, light that
changes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import cv2
import numpy as np

from phdtrack.types import F8, Frame, Image

WIDTH = 160
HEIGHT = 120
FPS = 25.0


@dataclass
class Scene:
    """``squares`` boxes of side 24 that cross the picture to the right at ``speed`` pixels a frame,
    on seeded texture.

    They stand outside until frame ``enter``.
    """

    frames: int = 100
    enter: int = 0
    squares: int = 1
    speed: float = 2.0
    flicker: float = 0.0
    truth: dict[int, F8] = field(default_factory=dict)

    def background(self) -> Image:
        rng = np.random.default_rng(4)
        coarse = rng.integers(70, 170, (HEIGHT // 10, WIDTH // 10, 3), np.uint8)
        return cv2.resize(coarse, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)

    def __iter__(self) -> Iterator[Frame]:
        rng = np.random.default_rng(5)
        background = self.background().astype(np.float64)
        for index in range(self.frames):
            image = background.copy()
            boxes = []
            for k in range(self.squares):
                left = int(-24 + (max(0, index - self.enter) * self.speed + 70 * k) % (WIDTH + 24))
                top = 20 + 45 * k
                image[top : top + 24, max(0, left) : max(0, left + 24)] = (20, 25, 60)
                if left + 24 > 0 and left < WIDTH:
                    boxes.append([max(0, left), top, min(WIDTH, left + 24), top + 24])
            image *= 1 + self.flicker * rng.uniform(-1, 1)
            image += rng.normal(0, 1.0, image.shape)
            self.truth[index + 1] = np.array(boxes, np.float64).reshape(-1, 4)
            yield Frame(index + 1, index / FPS, np.clip(np.rint(image), 0, 255).astype(np.uint8))
