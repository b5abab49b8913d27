"""Detections from a table or from any function of the picture; detectors around detectors, which search a smaller picture or
report only a region of interest."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from phdtrack.detect.convert import as_detections, check_inside
from phdtrack.errors import InputError
from phdtrack.protocols import Detector
from phdtrack.types import F8, Bool, Detections, DetectionTable, Frame, Image


class TableDetector:
    """The rows of ``table`` by frame number; frames without rows are empty. The picture is not looked at."""

    def __init__(self, table: DetectionTable) -> None:
        self._table = table

    def reset(self) -> None:
        """Nothing to forget."""

    def __call__(self, frame: Frame) -> Detections:
        """The detections of frame ``frame.number``."""
        return self._table.at(frame.number)


class CallableDetector:
    """Any function of a BGR picture (H, W, 3) uint8 that gives boxes in one of the forms that `as_detections` takes.

    Boxes wholly outside the frame are an error that names it, or are left out with ``drop_outside``. A function that
    remembers earlier pictures is not reset: give a new detector for a new video.
    """

    def __init__(self, function: Callable[[Image], object], *, drop_outside: bool = False) -> None:
        self._function = function
        self._drop = drop_outside

    def reset(self) -> None:
        """Nothing to forget here."""

    def __call__(self, frame: Frame) -> Detections:
        """What the function finds in ``frame``, checked."""
        where = f"frame {frame.number}"
        found = as_detections(self._function(frame.image), where=where)
        height, width = frame.image.shape[:2]
        return check_inside(found, width, height, where=where, drop=self._drop)


_INSIDE = 0.5
_SMALLEST = 16
"""Pixels on a side below which no detector sees anything, and the clean-up's windows are larger than the picture."""


class Rescaled:
    """``detector`` on frames shrunk to ``max_width`` pixels; boxes come back in the coordinates of the original.

    Narrower frames are left as they are.
    """

    def __init__(self, detector: Detector, max_width: int) -> None:
        if max_width < 1:
            raise InputError(f"the width must be at least one pixel, not {max_width}", where="max_width")
        self._detector = detector
        self._max_width = max_width

    def reset(self) -> None:
        """Reset the detector inside."""
        self._detector.reset()

    def __call__(self, frame: Frame) -> Detections:
        """The boxes found in the smaller picture, (N, 4) in pixels of ``frame``."""
        height, width = frame.image.shape[:2]
        if width <= self._max_width:
            return self._detector(frame)
        small = (self._max_width, round(height * self._max_width / width))
        if min(small) < _SMALLEST:
            raise InputError(
                f"frames of {width}x{height} pixels would be shrunk to {small[0]}x{small[1]}",
                where="max_width",
                cure=f"At least {_SMALLEST} pixels must be left on either side; 320 is a usual width.",
            )
        image: Image = cv2.resize(frame.image, small, interpolation=cv2.INTER_AREA)
        found = self._detector(Frame(frame.number, frame.time, image))
        factor = np.tile([width / small[0], height / small[1]], 2)
        covariance = None if found.covariance is None else found.covariance * np.outer(factor, factor)
        return Detections(found.xyxy * factor, found.confidence, found.class_id, covariance, found.observed)


class Masked:
    """``detector``, which sees the whole picture; boxes at least half inside a region of interest are kept.

    ``mask``, an (H, W) array or image file of the frame's size, is not 0 in the region.
    """

    def __init__(self, detector: Detector, mask: Image | Bool | str | Path) -> None:
        self._detector = detector
        self._where = str(mask) if isinstance(mask, str | Path) else "mask"
        region = _read_mask(Path(mask)) if isinstance(mask, str | Path) else np.asarray(mask)
        if region.ndim != 2:
            raise InputError(f"a mask has the shape (height, width), this one {region.shape}", where=self._where)
        if not region.any():
            cure = "White is where to look, black is left out."
            raise InputError("the mask is black all over: nothing could be reported", where=self._where, cure=cure)
        self._shape = region.shape
        self._sum: F8 = cv2.integral((region != 0).astype(np.uint8)).astype(np.float64)

    def reset(self) -> None:
        """Reset the detector inside."""
        self._detector.reset()

    def __call__(self, frame: Frame) -> Detections:
        """The boxes found in the region."""
        if frame.image.shape[:2] != self._shape:
            height, width = frame.image.shape[:2]
            raise InputError(
                f"the mask is {self._shape[1]}x{self._shape[0]} pixels, frame {frame.number} is {width}x{height}",
                where=self._where,
                cure="Draw the mask on a frame of this video, at its full size.",
            )
        found = self._detector(frame)
        corners = np.rint(found.xyxy).astype(np.int64)
        left, right = np.clip(corners[:, [0, 2]], 0, self._shape[1]).T
        top, bottom = np.clip(corners[:, [1, 3]], 0, self._shape[0]).T
        total = self._sum[bottom, right] - self._sum[top, right] - self._sum[bottom, left] + self._sum[top, left]
        return found.take(total >= _INSIDE * np.maximum((right - left) * (bottom - top), 1))


def _read_mask(path: Path) -> Image:
    try:
        data = np.fromfile(path, np.uint8)
    except OSError as error:
        raise InputError(f"the mask cannot be read ({error.strerror})", where=path) from None
    image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE) if data.size else None
    if image is None:
        raise InputError("this is not an image that can be read", where=path, cure="A mask is a PNG file, say.")
    return np.asarray(image, np.uint8)
