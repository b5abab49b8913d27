"""Random textures: the irregularity of real surfaces."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from phdtrack.types import Image

F4 = NDArray[np.float32]


def grain(height: int, width: int, rng: np.random.Generator, coarsest: int = 64) -> F4:
    """(height, width) noise of about unit variance with structure at all scales from 1 to ``coarsest`` pixels."""
    total = np.zeros((height, width), np.float32)
    step = coarsest
    while step >= 1:
        small = rng.normal(size=(height // step + 2, width // step + 2)).astype(np.float32)
        total += cv2.resize(small, (width, height), interpolation=cv2.INTER_CUBIC)
        step //= 2
    return total / np.float32(total.std() + 1e-6)


def tinted(colour: tuple[float, float, float], light: F4) -> Image:
    """(h, w, 3) a surface of ``colour`` (blue, green, red) under the brightness factors ``light`` (h, w)."""
    surface: Image = np.clip(np.array(colour, np.float32) * light[:, :, None], 0, 255).astype(np.uint8)
    return surface
