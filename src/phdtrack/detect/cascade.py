"""Faces by a Viola–Jones cascade of boosted classifiers [M07], trained files as OpenCV ships them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import cv2
import numpy as np
from annotated_types import Gt

from phdtrack.checks import Positive, PositiveCount, Probability, check
from phdtrack.detect.opencv import cascade_file, shipped
from phdtrack.errors import InputError
from phdtrack.types import Detections, Frame

SearchStep = Annotated[float, Gt(1)]


@dataclass(frozen=True, slots=True)
class FaceSettings:
    """How the `FaceDetector` searches.

    Attributes
    ----------
    cascade : name of a cascade that OpenCV ships ("frontalface_alt2", "profileface", "fullbody", …) or an .xml file.
    scale : the frame is enlarged by this factor before the search, so that small faces are found.
    step : ratio of successive sizes in the search, above 1; smaller is slower and finds more.
    neighbours : how many overlapping hits make a face.
    min_size : smallest face, fraction of the frame's height.
    """

    cascade: str = "frontalface_alt2"
    scale: Positive = 1.0
    step: SearchStep = 1.1
    neighbours: PositiveCount = 3
    min_size: Probability = 0.04

    def __post_init__(self) -> None:
        check(self)


class FaceDetector:
    """Boxes around what the cascade accepts, face by face; it remembers nothing."""

    def __init__(self, settings: FaceSettings | None = None) -> None:
        self.settings = settings or FaceSettings()
        path = cascade_file(self.settings.cascade)
        self._classifier: Any = shipped("CascadeClassifier")(str(path))
        if self._classifier.empty():
            raise InputError("this is not a cascade that OpenCV can read", where=path)

    def reset(self) -> None:
        """Nothing to forget."""

    def __call__(self, frame: Frame) -> Detections:
        """[M07] The faces in ``frame``."""
        settings = self.settings
        grey = cv2.equalizeHist(cv2.cvtColor(frame.image, cv2.COLOR_BGR2GRAY))
        if settings.scale != 1:
            grey = cv2.resize(grey, None, fx=settings.scale, fy=settings.scale, interpolation=cv2.INTER_LINEAR)
        least = max(1, round(settings.min_size * grey.shape[0]))
        found = self._classifier.detectMultiScale(
            grey, scaleFactor=settings.step, minNeighbors=settings.neighbours, minSize=(least, least)
        )
        boxes = np.array(found, np.float64).reshape(-1, 4) / settings.scale
        boxes[:, 2:] += boxes[:, :2]
        return Detections.of(boxes[np.lexsort((boxes[:, 0], boxes[:, 1]))])
