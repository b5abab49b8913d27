"""Detection of differences to a fixed mean background [D14 §II-B].

The background is the mean of the first grey frames. Its difference to a frame is smoothed by a
Gaussian low-pass and thresholded; connected components give the boxes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from phdtrack.detect.components import ConnectedComponents, check_same_size
from phdtrack.errors import NonNegative, Positive, PositiveCount, check
from phdtrack.opencv_package import cv2
from phdtrack.types import F4, Detections, Frame


@dataclass(eq=False)
class MeanBackgroundDetector:
    """Boxes around whatever differs from the mean of the first frames.

    Attributes
    ----------
    frames : number of frames whose mean is the background; nothing is detected in them.
    signed : True detects only what is darker than the background.
    smooth : standard deviation of the Gaussian low-pass in pixels; 0: no filter.
    threshold : least difference in grey levels.
    blobs : how the mask becomes boxes.
    """

    frames: PositiveCount = 50
    signed: bool = False
    smooth: NonNegative = 1.5
    threshold: Positive = 20.0
    blobs: ConnectedComponents = field(default_factory=ConnectedComponents)

    def __post_init__(self) -> None:
        check(self)
        self.reset()

    def reset(self) -> None:
        """Forget the background."""
        self._seen = 0
        self._sum: F4 = np.zeros((0, 0), np.float32)

    def knowledge(self) -> dict[str, Any]:
        """Everything learned from frames."""
        return {"seen": self._seen, "sum": self._sum}

    def restore(self, knowledge: dict[str, Any]) -> None:
        """Continue with the knowledge of a detector with the same settings."""
        self._seen = knowledge["seen"]
        self._sum = knowledge["sum"]

    def __call__(self, frame: Frame) -> Detections:
        """[D14 §II-B] The boxes of what differs from the background; none while it is learned."""
        grey = cv2.cvtColor(frame.image, cv2.COLOR_BGR2GRAY).astype(np.float32)
        if not self._seen:
            self._sum = np.zeros(grey.shape, np.float32)
        check_same_size(frame, self._sum.shape)
        if self._seen < self.frames:
            self._sum += grey
            self._seen += 1
            return Detections.empty()
        difference = self._sum / np.float32(self._seen) - grey
        if not self.signed:
            difference = np.abs(difference)
        if self.smooth > 0:
            difference = cv2.GaussianBlur(difference, (0, 0), self.smooth)
        mask = cv2.compare(difference, self.threshold, cv2.CMP_GT)
        return self.blobs.detections(np.asarray(mask, np.uint8))
