"""Wrappers that run a detector on smaller frames, or keep only boxes in a region of interest."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from phdtrack.detect.base import Detector, ReadsPlanes, WrapsDetector
from phdtrack.devices import Planar, bgr_of, planes_of, size_of
from phdtrack.errors import InputError
from phdtrack.files import load
from phdtrack.opencv_package import cv2
from phdtrack.types import Bool, Detections, Frame, Image

# Share of a box's area that must lie inside the region of interest.
_MIN_SHARE_INSIDE = 0.5
# Shorter sides of a frame, in pixels, are too small for any detector.
_MIN_SIDE = 16


@dataclass(frozen=True)
class Rescaled:
    """Runs ``detector`` on frames shrunk to ``max_width`` pixels; boxes are in pixels of the
    original frame. Narrower frames keep their size.
    """

    detector: Detector
    max_width: int

    def __post_init__(self) -> None:
        if self.max_width < 1:
            raise InputError(
                f"the width must be at least 1 pixel, got {self.max_width}", where="max_width"
            )

    def reset(self) -> None:
        """Reset the wrapped detector."""
        self.detector.reset()

    def input_size(self, frame: Frame) -> tuple[int, int]:
        """Width and height in pixels at which the wrapped detector gets this frame."""
        width, height = size_of(frame)
        if width <= self.max_width:
            return (width, height)
        return (self.max_width, round(height * self.max_width / width))

    def input_frame(self, frame: Frame) -> Frame:
        """The shrunk frame. Raises `InputError` if it would be smaller than 16 pixels."""
        width, height = size_of(frame)
        if width <= self.max_width:
            return frame
        small = self.input_size(frame)
        if min(small) < _MIN_SIDE:
            problem = f"frames of {width}x{height} pixels would be shrunk to {small[0]}x{small[1]}"
            cure = f"Both sides need at least {_MIN_SIDE} pixels; 320 is a usual width."
            raise InputError(problem, where="max_width", cure=cure)
        picture = frame.picture
        if isinstance(self.detector, ReadsPlanes) and not isinstance(picture, np.ndarray):
            picture = Planar(small, planes_of(picture, small))
        else:
            picture = bgr_of(picture, small)
        return Frame(frame.number, frame.time, picture)

    def __call__(self, frame: Frame) -> Detections:
        """The boxes found in the shrunk frame, (N, 4) in pixels of ``frame``."""
        width, height = size_of(frame)
        if width <= self.max_width:
            return self.detector(frame)
        smaller = self.input_frame(frame)
        found = self.detector(smaller)
        small = size_of(smaller)
        factor = np.tile([width / small[0], height / small[1]], 2)
        covariance = found.covariance
        if covariance is not None:
            covariance = covariance * np.outer(factor, factor)
        return replace(found, xyxy=found.xyxy * factor, covariance=covariance)


class Masked:
    """Runs ``detector`` on the whole frame and keeps boxes at least half inside a region of
    interest.

    ``mask``, an (H, W) array or image file of the frame's size, is not 0 in the region.
    """

    def __init__(self, detector: Detector, mask: Image | Bool | str | Path) -> None:
        self.detector = detector
        if isinstance(mask, str | Path):
            self._where = str(mask)
            region = _read_mask(Path(mask))
        else:
            self._where = "mask"
            region = np.asarray(mask)
        if region.ndim != 2:
            raise InputError(
                f"a mask has the shape (height, width), got {region.shape}", where=self._where
            )
        if not region.any():
            raise InputError(
                "the whole mask is black, so no detection would be kept",
                where=self._where,
                cure="Paint the region of interest white; black is ignored.",
            )
        self.region: Bool = region != 0

    def reset(self) -> None:
        """Reset the wrapped detector."""
        self.detector.reset()

    def input_size(self, frame: Frame) -> tuple[int, int]:
        """The size of the frame, which the wrapped detector gets as it is."""
        return size_of(frame)

    def input_frame(self, frame: Frame) -> Frame:
        """The frame itself."""
        return frame

    def __call__(self, frame: Frame) -> Detections:
        """The boxes found in the region of interest."""
        rows, columns = self.region.shape
        width, height = size_of(frame)
        if (width, height) != (columns, rows):
            raise InputError(
                f"the mask is {columns}x{rows} pixels, frame {frame.number} is {width}x{height}",
                where=self._where,
                cure="Draw the mask on a frame of this video, at its full size.",
            )
        found = self.detector(frame)
        corners = np.clip(np.rint(found.xyxy), 0, [columns, rows, columns, rows]).astype(np.int64)
        kept = list[bool]()
        for left, top, right, bottom in corners.tolist():
            part = self.region[top:bottom, left:right]
            kept.append(bool(part.sum() >= _MIN_SHARE_INSIDE * max(part.size, 1)))
        return found.select(np.array(kept, np.bool_))


def _read_mask(path: Path) -> Image:
    """The grey levels (H, W) of an image file. Raises `InputError` if it cannot be read."""
    data = np.frombuffer(load(path), np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE) if data.size else None
    if image is None:
        raise InputError(
            "this is not a readable image",
            where=path,
            cure="Save the mask as a PNG file, for instance.",
        )
    return np.asarray(image, np.uint8)


def reported_region(detector: Detector) -> Bool | None:
    """(H, W) True where a detector with a mask reports boxes; None for one that does everywhere."""
    while isinstance(detector, WrapsDetector):
        if isinstance(detector, Masked):
            return detector.region
        detector = detector.detector
    return None
