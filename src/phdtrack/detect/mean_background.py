"""Background subtraction with a fixed mean background [D14 §II-B].

The background is the mean of the first n grey frames, or of frames given beforehand. The difference of background and frame
is smoothed by a Gaussian low-pass and thresholded; connected components give the boxes. The signed form, background −
frame, sees only what is darker than the background; the absolute one sees both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from phdtrack.checks import NonNegative, Positive, PositiveCount, check
from phdtrack.detect import components as blobs
from phdtrack.detect.checks import check_same_size
from phdtrack.detect.components import BlobSettings
from phdtrack.detect.reference import F4
from phdtrack.types import Detections, Frame, Image


@dataclass(frozen=True, slots=True)
class MeanBackgroundSettings:
    """How the `MeanBackgroundDetector` decides.

    Attributes
    ----------
    frames : number of frames whose mean is the background; nothing is detected in them.
    signed : True sees only what is darker than the background.
    smooth : standard deviation of the Gaussian low-pass in pixels; 0: none.
    threshold : least difference in grey levels.
    blobs : how the mask becomes boxes.
    """

    frames: PositiveCount = 50
    signed: bool = False
    smooth: NonNegative = 1.5
    threshold: Positive = 20.0
    blobs: BlobSettings = field(default_factory=BlobSettings)

    def __post_init__(self) -> None:
        check(self)


class MeanBackgroundDetector:
    """Boxes around what differs from the mean of the first frames.

    ``background`` are frames (H, W, 3) to learn from beforehand; with them detection starts with the first frame.
    """

    def __init__(self, settings: MeanBackgroundSettings | None = None, background: Sequence[Image] = ()) -> None:
        self.settings = settings or MeanBackgroundSettings()
        self._given = tuple(background)
        self.reset()

    def reset(self) -> None:
        """Forget the background, except frames given beforehand."""
        self._seen = len(self._given)
        self._complete = bool(self._given)
        self._sum: F4 | None = None
        if self._given:
            self._sum = np.sum([_grey(image) for image in self._given], axis=0, dtype=np.float32)

    def __call__(self, frame: Frame) -> Detections:
        """[D14 §II-B] The boxes of what differs from the background; none while it is learned."""
        grey = _grey(frame.image)
        if self._sum is None:
            self._sum = np.zeros(grey.shape, np.float32)
        check_same_size(frame, self._sum.shape)
        if not self._complete:
            self._sum += grey
            self._seen += 1
            self._complete = self._seen >= self.settings.frames
            return Detections.empty()
        difference = self._sum / np.float32(self._seen) - grey
        if not self.settings.signed:
            difference = np.abs(difference)
        if self.settings.smooth > 0:
            difference = cv2.GaussianBlur(difference, (0, 0), self.settings.smooth)
        return blobs.detections(cv2.compare(difference, self.settings.threshold, cv2.CMP_GT), self.settings.blobs)


def _grey(image: Image) -> F4:
    grey: F4 = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32)
    return grey
