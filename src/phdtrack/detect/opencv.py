"""OpenCV's own detectors: the background subtractor MOG2, faces by a cascade [M07], pedestrians by
histograms of gradients.

Shadow pixels of MOG2 are removed. The support vector machine for pedestrians was trained on
windows of 64×128 pixels with people 96 pixels high, so the frame is enlarged to find smaller
people. The border around the person is cut from its windows, and of overlapping boxes the strongest
stays. Confidence is the margin of the support vector machine, which is unbounded. OpenCV 5 dropped
cascades and pedestrians; `from_opencv` reports this.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from phdtrack.detect.components import ConnectedComponents, check_same_size
from phdtrack.errors import InputError, NonNegative, Positive, PositiveCount, Probability, check
from phdtrack.opencv_package import cv2
from phdtrack.types import Detections, Frame, Image

_REPAIR = (
    "python -m pip uninstall -y opencv-python opencv-contrib-python; python -m pip install"
    " --force-reinstall "
)
_REPAIR += '"opencv-python-headless>=4.8,<5"'
_SURELY_FOREGROUND = 200
_FALLBACK_INTERVAL = 1.0 / 25.0
_CASCADE = "haarcascade_frontalface_alt2.xml"
# Ratio of successive sizes in the search for faces and for people.
_FACE_STEP = 1.1
_PERSON_STEP = 1.05
# Pixels between windows in which people are searched.
_STRIDE = (8, 8)
_WINDOW = (64, 128)
# Width and height of a person as shares of a window of the support vector machine.
_BODY = np.array([0.55, 0.8])


@dataclass(eq=False)
class Mog2Detector:
    """Boxes around the foreground of OpenCV's MOG2, a mixture of Gaussians per pixel.

    Attributes
    ----------
    adapt : seconds over which the background is learned and forgotten (time constant).
    threshold : squared distance from the background, in variances.
    warmup : seconds without detections at the beginning.
    blobs : turns the mask into boxes.
    """

    adapt: Positive = 20.0
    threshold: Positive = 16.0
    warmup: NonNegative = 0.5
    blobs: ConnectedComponents = field(default_factory=ConnectedComponents)

    def __post_init__(self) -> None:
        check(self)
        self.reset()

    def reset(self) -> None:
        """Forget the scene."""
        self._seen = 0
        self._subtractor: Any = cv2.createBackgroundSubtractorMOG2(varThreshold=self.threshold)

    def knowledge(self) -> None:
        """Return None: OpenCV does not hand out its background model."""

    def restore(self, knowledge: dict[str, Any]) -> None:
        """Raise `InputError`: OpenCV does not accept a background model."""
        raise InputError("the background model of mog2 cannot be restored")

    def __call__(self, frame: Frame) -> Detections:
        """The boxes of the foreground in ``frame``; none during the warm-up."""
        if not self._seen:
            self._shape = frame.image.shape
            self._began = frame.time
            self._time = frame.time
        check_same_size(frame, self._shape)
        self._seen += 1
        passed = frame.time - self._time
        self._time = frame.time
        interval = passed if passed > 0 else _FALLBACK_INTERVAL
        # Early frames follow OpenCV's own rule, half of the weight in a plain mean, and later ones
        # the time constant.
        rate = max(0.5 / self._seen, min(1.0, interval / self.adapt))
        mask = self._subtractor.apply(frame.image, learningRate=rate)
        if frame.time - self._began < self.warmup:
            return Detections.empty()
        return self.blobs.detections(
            np.asarray(cv2.compare(mask, _SURELY_FOREGROUND, cv2.CMP_GT), np.uint8)
        )


def from_opencv(name: str) -> Any:
    """``cv2.<name>``. Raises `InputError` with the pip command if this OpenCV lacks it."""
    found = getattr(cv2, name, None)
    if found is None:
        raise InputError(
            f"OpenCV {cv2.__version__} has no {name}, which this detector needs; OpenCV 4 has it",
            cure=f"Another package may have replaced it. Repair it with: {_REPAIR}",
        )
    return found


@dataclass(eq=False)
class FaceDetector:
    """Faces, found by a Viola-Jones cascade. It learns nothing from frames.

    Attributes
    ----------
    scale : factor by which the frame is enlarged first, to find small faces.
    neighbours : overlapping hits that make a face.
    min_size : smallest face, fraction of the frame's height.
    """

    scale: Positive = 1.0
    neighbours: PositiveCount = 3
    min_size: Probability = 0.04

    def __post_init__(self) -> None:
        check(self)
        path = Path(from_opencv("data").haarcascades) / _CASCADE
        self._classifier: Any = from_opencv("CascadeClassifier")(str(path))
        if self._classifier.empty():
            raise InputError(
                "this OpenCV cannot read its own cascade", where=path, cure=f"Repair: {_REPAIR}"
            )

    def reset(self) -> None:
        """Do nothing: there is nothing to forget."""

    def __call__(self, frame: Frame) -> Detections:
        """[M07] The faces in ``frame``."""
        grey = cv2.equalizeHist(cv2.cvtColor(frame.image, cv2.COLOR_BGR2GRAY))
        grey = _enlarged(np.asarray(grey, np.uint8), self.scale)
        least = max(1, round(self.min_size * grey.shape[0]))
        found = self._classifier.detectMultiScale(
            grey, scaleFactor=_FACE_STEP, minNeighbors=self.neighbours, minSize=(least, least)
        )
        boxes = np.array(found, np.float64).reshape(-1, 4) / self.scale
        boxes[:, 2:] += boxes[:, :2]
        return Detections.of(boxes[np.lexsort((boxes[:, 0], boxes[:, 1]))])


@dataclass(eq=False)
class PersonDetector:
    """Pedestrians. It learns nothing from frames. A frame of 768x576 takes a third of a second:
    for stills and short clips.

    Attributes
    ----------
    scale : factor by which the frame is enlarged first; people below 96 pixels in the enlarged
        frame are not found.
    threshold : least margin of the support vector machine.
    overlap : of two boxes with a larger intersection over union only the stronger one is kept.
    """

    scale: Positive = 1.5
    threshold: float = 0.5
    overlap: Probability = 0.4

    def __post_init__(self) -> None:
        check(self)
        self._hog: Any = from_opencv("HOGDescriptor")()
        self._hog.setSVMDetector(from_opencv("HOGDescriptor_getDefaultPeopleDetector")())

    def reset(self) -> None:
        """Do nothing: there is nothing to forget."""

    def __call__(self, frame: Frame) -> Detections:
        """The pedestrians in ``frame``, the strongest first."""
        image = _enlarged(frame.image, self.scale)
        if image.shape[1] < _WINDOW[0] or image.shape[0] < _WINDOW[1]:
            return Detections.empty()
        windows, margins = self._hog.detectMultiScale(
            image,
            hitThreshold=self.threshold,
            winStride=_STRIDE,
            scale=_PERSON_STEP,
            groupThreshold=0,
        )
        corner, size = np.hsplit(np.array(windows, np.float64).reshape(-1, 4) / self.scale, 2)
        score = np.array(margins, np.float64).reshape(-1)
        middle = corner + size / 2
        reach = size * _BODY / 2
        # OpenCV drops scores of 0 and below, which margins may well be.
        above = score - score.min(initial=0.0) + 1.0
        kept = cv2.dnn.NMSBoxes(
            np.hstack([middle - reach, 2 * reach]).tolist(), above.tolist(), 0.0, self.overlap
        )
        return Detections.of(np.hstack([middle - reach, middle + reach]), score).select(
            np.array(kept, np.int64)
        )


def _enlarged(image: Image, scale: float) -> Image:
    """The picture, enlarged by a factor."""
    return np.asarray(
        cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_LINEAR), np.uint8
    )
