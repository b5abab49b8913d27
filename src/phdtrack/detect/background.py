"""Background subtraction with a fixed mean background [D14 §II-B], and OpenCV's adaptive subtractors MOG2 and KNN.

The fixed background is the mean of the first n grey frames, or of frames given beforehand. Its difference to a frame is
smoothed by a Gaussian low-pass and thresholded; connected components give the boxes. Shadow pixels of MOG2 and KNN are
removed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from phdtrack.checks import NonNegative, Positive, PositiveCount, check
from phdtrack.detect import components as blobs
from phdtrack.detect.change import F4
from phdtrack.detect.components import BlobSettings, check_same_size
from phdtrack.errors import InputError
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
        self._wanted = self._seen or self.settings.frames
        self._sum: F4 | None = np.sum([_grey(i) for i in self._given], axis=0, dtype=np.float32) if self._given else None

    def __call__(self, frame: Frame) -> Detections:
        """[D14 §II-B] The boxes of what differs from the background; none while it is learned."""
        grey = _grey(frame.image)
        if self._sum is None:
            self._sum = np.zeros(grey.shape, np.float32)
        check_same_size(frame, self._sum.shape)
        if self._seen < self._wanted:
            self._sum += grey
            self._seen += 1
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


_SURELY_FOREGROUND = 200
_FALLBACK_INTERVAL = 1.0 / 25.0


@dataclass(frozen=True, slots=True)
class SubtractorSettings:
    """How a `SubtractorDetector` decides.

    Attributes
    ----------
    method : "mog2" (a mixture of Gaussians per pixel) or "knn" (nearest neighbours among a pixel's samples).
    adapt : seconds over which the background is learned and forgotten.
    threshold : squared distance from the background; MOG2 in variances (0: 16), KNN in grey levels² (0: 400).
    warmup : seconds before the first detections are given.
    blobs : how the mask becomes boxes.
    """

    method: str = "mog2"
    adapt: Positive = 20.0
    threshold: NonNegative = 0.0
    warmup: NonNegative = 0.5
    blobs: BlobSettings = field(default_factory=BlobSettings)

    def __post_init__(self) -> None:
        if self.method not in _FACTORIES:
            problem = f"method must be one of {', '.join(_FACTORIES)}, not {self.method!r}"
            raise InputError(problem, where="SubtractorSettings")
        check(self)


class SubtractorDetector:
    """Boxes around the foreground of an OpenCV subtractor."""

    def __init__(self, settings: SubtractorSettings | None = None) -> None:
        self.settings = settings or SubtractorSettings()
        self.reset()

    def reset(self) -> None:
        """Forget the scene."""
        self._subtractor: Any = None
        self._began = 0.0

    def __call__(self, frame: Frame) -> Detections:
        """The boxes of the foreground in ``frame``; none during the warm-up."""
        settings = self.settings
        if self._subtractor is None:
            self._subtractor = _FACTORIES[settings.method](settings.threshold)
            self._shape = frame.image.shape
            self._seen, self._began, self._time = 0, frame.time, frame.time
        check_same_size(frame, self._shape)
        self._seen += 1
        passed = frame.time - self._time
        self._time = frame.time
        interval = passed if passed > 0 else _FALLBACK_INTERVAL
        # OpenCV's own rule for early frames (half of what a plain mean would give them), the time constant later.
        rate = max(0.5 / self._seen, min(1.0, interval / settings.adapt))
        # KNN draws the samples that it replaces from OpenCV's generator, which is global: seeded, a run can be repeated.
        cv2.setRNGSeed(self._seen)
        mask = self._subtractor.apply(frame.image, learningRate=rate)
        if frame.time - self._began < settings.warmup:
            return Detections.empty()
        return blobs.detections(cv2.compare(mask, _SURELY_FOREGROUND, cv2.CMP_GT), settings.blobs)


_FACTORIES: dict[str, Callable[[float], Any]] = {
    "mog2": lambda threshold: cv2.createBackgroundSubtractorMOG2(varThreshold=threshold or 16.0, detectShadows=True),
    "knn": lambda threshold: cv2.createBackgroundSubtractorKNN(dist2Threshold=threshold or 400.0, detectShadows=True),
}
