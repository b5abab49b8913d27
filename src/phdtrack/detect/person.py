"""Pedestrians on single images: histograms of oriented gradients with the support vector machine that OpenCV ships.

It was trained on windows of 64×128 pixels in which the person is 96 high, so the frame is enlarged for smaller people. Its
hits are windows with a margin, which is cut off; overlapping ones are reduced to the strongest. Confidence is the margin
of the support vector machine, which is not bounded.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from phdtrack.arrays import iou
from phdtrack.checks import Positive, PositiveCount, Probability, check
from phdtrack.detect.cascade import SearchStep
from phdtrack.detect.opencv import shipped
from phdtrack.errors import InputError
from phdtrack.types import F8, I8, Detections, Frame

_WINDOW = (64, 128)
_BODY = (0.55, 0.8)


@dataclass(frozen=True, slots=True)
class PersonSettings:
    """How the `PersonDetector` searches.

    Attributes
    ----------
    scale : the frame is enlarged by this factor; people below 96 pixels in the enlarged frame are not found.
    step : ratio of successive sizes in the search, above 1.
    stride : pixels between windows in the enlarged frame, a multiple of 8.
    threshold : least margin of the support vector machine.
    overlap : of two boxes with a larger intersection over union only the stronger is kept.
    """

    scale: Positive = 1.5
    step: SearchStep = 1.05
    stride: PositiveCount = 8
    threshold: float = 0.5
    overlap: Probability = 0.4

    def __post_init__(self) -> None:
        check(self)
        if self.stride % 8:
            raise InputError(f"expected a multiple of 8, got {self.stride}", where="PersonSettings.stride")


class PersonDetector:
    """Boxes around pedestrians; it remembers nothing."""

    def __init__(self, settings: PersonSettings | None = None) -> None:
        self.settings = settings or PersonSettings()
        self._hog: Any = shipped("HOGDescriptor")()
        self._hog.setSVMDetector(shipped("HOGDescriptor_getDefaultPeopleDetector")())

    def reset(self) -> None:
        """Nothing to forget."""

    def __call__(self, frame: Frame) -> Detections:
        """The pedestrians in ``frame``, the strongest first."""
        settings, image = self.settings, frame.image
        if settings.scale != 1:
            image = cv2.resize(image, None, fx=settings.scale, fy=settings.scale, interpolation=cv2.INTER_LINEAR)
        if image.shape[1] < _WINDOW[0] or image.shape[0] < _WINDOW[1]:
            return Detections.empty()
        windows, margins = self._hog.detectMultiScale(
            image,
            hitThreshold=settings.threshold,
            winStride=(settings.stride, settings.stride),
            scale=settings.step,
            groupThreshold=0,
        )
        x, y, width, height = np.array(windows, np.float64).reshape(-1, 4).T / settings.scale
        score: F8 = np.array(margins, np.float64).reshape(-1)
        dx, dy = width * _BODY[0] / 2, height * _BODY[1] / 2
        cx, cy = x + width / 2, y + height / 2
        boxes = np.stack([cx - dx, cy - dy, cx + dx, cy + dy], axis=1)
        kept = strongest(boxes, score, settings.overlap)
        return Detections.of(boxes[kept], score[kept])


def strongest(boxes: F8, score: F8, overlap: float) -> I8:
    """Indices of the (N, 4) boxes, by falling ``score`` (N,), that overlap no stronger kept one by more than ``overlap``."""
    order = np.argsort(-score, kind="stable")
    shared = iou(boxes[order], boxes[order])
    kept = np.ones(len(order), np.bool_)
    for i in range(len(order)):
        if kept[i]:
            kept[i + 1 :] &= shared[i, i + 1 :] <= overlap
    indices: I8 = order[kept]
    return indices
