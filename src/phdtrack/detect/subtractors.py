"""OpenCV's adaptive background subtractors, MOG2 and KNN, with the clean-up of `blobs`. Their shadow pixels are removed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import cv2

from phdtrack.checks import NonNegative, Positive, check
from phdtrack.detect import components as blobs
from phdtrack.detect.checks import check_same_size
from phdtrack.detect.components import BlobSettings
from phdtrack.errors import InputError
from phdtrack.types import Detections, Frame

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
            raise InputError(
                f"method must be one of {', '.join(_FACTORIES)}, not {self.method!r}", where="SubtractorSettings"
            )
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


def _mog2(threshold: float) -> Any:
    return cv2.createBackgroundSubtractorMOG2(varThreshold=threshold or 16.0, detectShadows=True)


def _knn(threshold: float) -> Any:
    return cv2.createBackgroundSubtractorKNN(dist2Threshold=threshold or 400.0, detectShadows=True)


_FACTORIES: dict[str, Callable[[float], Any]] = {"mog2": _mog2, "knn": _knn}
