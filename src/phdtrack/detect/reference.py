"""The reference image of a scene: learned quickly at the start, adapted slowly ever after.

At the start the reference is the per-pixel median of samples spread over the first seconds: it shows the background
wherever that was seen more than half of the time, though objects move about from the first frame on. It is there from the
second frame on and gets better with every second sample. Then it adapts exponentially, on background with one time
constant and on foreground with a much longer one, so that an object that stops stays an object for a while.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from phdtrack.types import Image

F4 = NDArray[np.float32]


def median_image(images: Sequence[Image]) -> Image:
    """Per-pixel median of an odd number of images of one shape, uint8.

    By exchanges of neighbours until the upper half has sunk: minimum and maximum of whole images are vectorised, which
    makes this several times faster than sorting each pixel's values.
    """
    ranked = list(images)
    middle = len(ranked) // 2
    for last in range(len(ranked) - 1, middle - 1, -1):
        for i in range(last):
            ranked[i], ranked[i + 1] = cv2.min(ranked[i], ranked[i + 1]), cv2.max(ranked[i], ranked[i + 1])
    return ranked[middle]


class Reference:
    """The learned background of one camera.

    Parameters
    ----------
    first : (H, W, 3) uint8, the frame seen at ``time`` seconds.
    learn : seconds over which samples for the median are taken.
    samples : how many; odd.
    """

    def __init__(self, first: Image, time: float, learn: float, samples: int) -> None:
        self._samples = [first]
        self._missing = samples - 1
        self._spacing = learn / samples
        self._due = time + self._spacing
        self._mean: F4 = first.astype(np.float32)

    @property
    def image(self) -> Image:
        """(H, W, 3) uint8."""
        rounded: Image = cv2.convertScaleAbs(self._mean)
        return rounded

    @property
    def learning(self) -> bool:
        """Whether samples for the median are still to be taken."""
        return self._missing > 0

    @property
    def samples(self) -> tuple[Image, ...]:
        """The samples of the latest median."""
        return tuple(self._samples)

    def sample(self, image: Image, time: float) -> bool:
        """Take ``image`` as a sample if one is due at ``time`` seconds; True where that gave a new median."""
        if not self.learning:
            self._samples.clear()
            return False
        if time < self._due:
            return False
        self._due += self._spacing
        self._missing -= 1
        self._samples.append(image)
        if len(self._samples) % 2 == 0:
            return False
        self._mean = median_image(self._samples).astype(np.float32)
        return True

    def blend(self, image: Image, share: float, where: Image) -> None:
        """Move ``share`` (0 to 1) of the way to ``image`` where the mask ``where`` (H, W) is not 0."""
        cv2.accumulateWeighted(image, self._mean, min(1.0, share), where)
