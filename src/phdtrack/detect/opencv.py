"""OpenCV's own detectors: the background subtractors MOG2 and KNN, faces by a cascade [M07], pedestrians by gradients.

Shadow pixels of MOG2 and KNN are removed. The pedestrians' support vector machine was trained on windows of 64×128 pixels in
which the person is 96 high, so the frame is enlarged for smaller people. Its hits have a margin, which is cut off; of
overlapping ones the strongest stays. Confidence is the margin of the support vector machine, which is not bounded. OpenCV 5
dropped cascades and pedestrians: `from_opencv` says so.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
from annotated_types import Gt

from phdtrack.arrays import iou
from phdtrack.detect import components as blobs
from phdtrack.detect.components import BlobSettings, check_same_size
from phdtrack.errors import InputError, NonNegative, Positive, PositiveCount, Probability, check
from phdtrack.types import F8, I8, Detections, Frame, Image

MEND = "python -m pip uninstall -y opencv-python opencv-contrib-python; python -m pip install --force-reinstall "
MEND += '"opencv-python-headless>=4.8,<5"'
SearchStep = Annotated[float, Gt(1)]
_SURELY_FOREGROUND = 200
_FALLBACK_INTERVAL = 1.0 / 25.0
_WINDOW = (64, 128)
_BODY = (0.55, 0.8)
# Of each subtractor: its function, the name of its threshold and the usual value of that.
_METHODS = {
    "mog2": ("createBackgroundSubtractorMOG2", "varThreshold", 16.0),
    "knn": ("createBackgroundSubtractorKNN", "dist2Threshold", 400.0),
}


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
        if self.method not in _METHODS:
            problem = f"method must be one of {', '.join(_METHODS)}, not {self.method!r}"
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

    def __call__(self, frame: Frame) -> Detections:
        """The boxes of the foreground in ``frame``; none during the warm-up."""
        settings = self.settings
        if self._subtractor is None:
            function, name, usual = _METHODS[settings.method]
            self._subtractor = getattr(cv2, function)(**{name: settings.threshold or usual, "detectShadows": True})
            self._shape = frame.image.shape
            self._seen, self._began, self._time = 0, frame.time, frame.time
        check_same_size(frame, self._shape)
        self._seen += 1
        passed, self._time = frame.time - self._time, frame.time
        interval = passed if passed > 0 else _FALLBACK_INTERVAL
        # OpenCV's own rule for early frames (half of what a plain mean would give them), the time constant later.
        rate = max(0.5 / self._seen, min(1.0, interval / settings.adapt))
        # KNN draws the samples that it replaces from OpenCV's generator, which is global: seeded, a run can be repeated.
        cv2.setRNGSeed(self._seen)
        mask = self._subtractor.apply(frame.image, learningRate=rate)
        if frame.time - self._began < settings.warmup:
            return Detections.empty()
        return blobs.detections(np.asarray(cv2.compare(mask, _SURELY_FOREGROUND, cv2.CMP_GT), np.uint8), settings.blobs)


def from_opencv(name: str) -> Any:
    """``cv2.<name>``; InputError with the pip line where this OpenCV has none."""
    found = getattr(cv2, name, None)
    if found is None:
        raise InputError(
            f"OpenCV {cv2.__version__} has no {name}, which this detector needs; OpenCV 4 has it",
            cure=f"Another package may have replaced it. Mend it by: {MEND}",
        )
    return found


def cascade_file(name: str) -> Path:
    """The path of a cascade that OpenCV ships, or of the user's own; InputError where there is none."""
    own = Path(name)
    if own.suffix == ".xml" and own.is_file():
        return own
    folder = Path(from_opencv("data").haarcascades)
    path = folder / f"haarcascade_{name}.xml"
    if not path.is_file():
        names = sorted(file.stem.removeprefix("haarcascade_") for file in folder.glob("haarcascade_*.xml"))
        known = f"Shipped are {', '.join(names)}." if names else f"This OpenCV ships none. Mend it by: {MEND}"
        cure = f"{known} An .xml file of your own works too."
        raise InputError(f"there is no cascade {name!r}", where="cascade", cure=cure)
    return path


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
        self._classifier: Any = from_opencv("CascadeClassifier")(str(path))
        if self._classifier.empty():
            raise InputError("this is not a cascade that OpenCV can read", where=path)

    def reset(self) -> None:
        """Nothing to forget."""

    def __call__(self, frame: Frame) -> Detections:
        """[M07] The faces in ``frame``."""
        settings = self.settings
        grey = _enlarged(cv2.equalizeHist(cv2.cvtColor(frame.image, cv2.COLOR_BGR2GRAY)), settings.scale)
        least = max(1, round(settings.min_size * grey.shape[0]))
        found = self._classifier.detectMultiScale(
            grey, scaleFactor=settings.step, minNeighbors=settings.neighbours, minSize=(least, least)
        )
        boxes = np.array(found, np.float64).reshape(-1, 4) / settings.scale
        boxes[:, 2:] += boxes[:, :2]
        return Detections.of(boxes[np.lexsort((boxes[:, 0], boxes[:, 1]))])


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
        self._hog: Any = from_opencv("HOGDescriptor")()
        self._hog.setSVMDetector(from_opencv("HOGDescriptor_getDefaultPeopleDetector")())

    def reset(self) -> None:
        """Nothing to forget."""

    def __call__(self, frame: Frame) -> Detections:
        """The pedestrians in ``frame``, the strongest first."""
        settings = self.settings
        image = _enlarged(frame.image, settings.scale)
        if image.shape[1] < _WINDOW[0] or image.shape[0] < _WINDOW[1]:
            return Detections.empty()
        stride = (settings.stride, settings.stride)
        windows, margins = self._hog.detectMultiScale(
            image, hitThreshold=settings.threshold, winStride=stride, scale=settings.step, groupThreshold=0
        )
        left, top, width, height = np.array(windows, np.float64).reshape(-1, 4).T / settings.scale
        score: F8 = np.array(margins, np.float64).reshape(-1)
        dx, dy, cx, cy = width * _BODY[0] / 2, height * _BODY[1] / 2, left + width / 2, top + height / 2
        boxes = np.stack([cx - dx, cy - dy, cx + dx, cy + dy], axis=1)
        kept = strongest(boxes, score, settings.overlap)
        return Detections.of(boxes[kept], score[kept])


def strongest(boxes: F8, score: F8, overlap: float) -> I8:
    """Indices of the boxes (N, 4), by falling ``score`` (N,), whose IoU with every stronger kept one is ≤ ``overlap``.

    `cv2.dnn.NMSBoxes` leaves out scores below 0, and margins may be.
    """
    order = np.argsort(-score, kind="stable")
    shared, kept = iou(boxes[order], boxes[order]), np.ones(len(order), np.bool_)
    for i in range(len(order)):
        if kept[i]:
            kept[i + 1 :] &= shared[i, i + 1 :] <= overlap
    return order[kept]


def _enlarged(image: Image, scale: float) -> Image:
    """The picture, enlarged."""
    if scale == 1:
        return image
    return np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_LINEAR), np.uint8)
