"""The motion of the camera: none, read from a file, or measured by sparse optical flow.

Corners (Shi and Tomasi) of the previous picture, outside the detected boxes, are tracked into the
current one and back with the pyramidal method of Lucas and Kanade; those that do not return to
where they started are dropped. RANSAC finds the similarity, or homography, that fits most of the
others. OpenCV restarts its random numbers in every call, so the same pictures give the same map.

Pictures are scaled down first. Moving objects that were not detected do no harm as long as most
corners belong to the background.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from phdtrack.errors import Checked, InputError, PositiveCount
from phdtrack.opencv_package import cv2
from phdtrack.types import F8, Image

# Least strength of a corner, as a share of the best; distance of corners as a share of the width.
_MIN_QUALITY = 0.01
_DISTANCE = 0.012
# Boxes are enlarged by this share of their size, to exclude shadows and limbs outside.
_MARGIN = 0.1
# Size of the search window, and levels of the pyramids.
_WINDOW = (21, 21)
_LEVELS = 4
# Bounds of a plausible motion between frames: the zoom, and the shift as a share of the width.
_MAX_ZOOM = 1.5
_MAX_SHIFT = 0.6
# Least denominator of a homography at the corners of the picture.
_MIN_DEPTH = 0.2
_MAX_ITERATIONS = 2000
_CONFIDENCE = 0.999
# Corners that are tracked at most.
MAX_POINTS = 300
# Pixels of the scaled picture by which a point may miss the map, and by which its way back may miss
# its start.
MAX_ERROR = 1.0
# Points, and share of the tracked points, that must fit the map; otherwise the camera is assumed
# still in that frame.
MIN_POINTS = 20
MIN_INLIER_SHARE = 0.4


@dataclass(frozen=True, slots=True)
class Standing:
    """The camera stands still."""


@dataclass(frozen=True, slots=True)
class GivenWarps:
    """Camera motion from a file.

    Parameters
    ----------
    file : one row per frame, ``frame,g11,g12,g13,g21,g22,g23[,g31,g32,g33]``: see
        `formats.read_warps`.
    """

    file: str


@dataclass(frozen=True, slots=True)
class SparseFlow(Checked):
    """Camera motion measured by tracking points from one picture to the next.

    Most of the picture must show the background.

    Parameters
    ----------
    width : pixels to which pictures are scaled down.
    form : ``similarity`` (shift, rotation, zoom), which few points determine well; ``homography``
        for a camera that pans with a wide lens, or a planar scene.
    """

    width: PositiveCount = 640
    form: Literal["similarity", "homography"] = "similarity"


class CameraMotion:
    """Measures how the camera moved since the previous picture.

    motion = CameraMotion()
    warp = motion(image, boxes)                 # the identity for the first picture
    rows = tracker.update(boxes, warp=warp)

    Call it once for every `Tracker.update`, with the picture in which the boxes were detected.
    ``measured`` is False if the motion in the last picture could not be measured, and is assumed to
    be none.

    Parameters
    ----------
    settings : of the optical flow; None: its defaults.
    """

    def __init__(self, settings: SparseFlow | None = None) -> None:
        self.settings = SparseFlow() if settings is None else settings
        self.reset()

    def reset(self) -> None:
        """Start a new sequence with the next picture."""
        self._previous: _View | None = None
        self.measured = True

    def __call__(self, image: Image, xyxy: F8) -> F8:
        """(3, 3) map from pixels of the previous picture to pixels of this one.

        Parameters
        ----------
        image : (H, W, 3) BGR, or (H, W) grey. Raises `InputError` for another shape.
        xyxy : (n, 4) boxes detected in it.
        """
        current = _view(image, xyxy, self.settings.width)
        previous = self._previous
        self._previous = current
        self.measured = True
        if previous is None:
            return np.eye(3)
        warp = _between(previous, current, self.settings)
        if warp is None:
            self.measured = False
            return np.eye(3)
        return warp


class _View(NamedTuple):
    """A grey picture (h, w) uint8, scaled by ``scale``, and ``boxes`` (n, 4) in its pixels."""

    gray: Image
    scale: float
    boxes: F8


def _view(image: Image, xyxy: F8, width: int) -> _View:
    """The picture (H, W, 3) BGR, or (H, W) grey, scaled down to ``width``."""
    if image.ndim not in (2, 3) or not image.size:
        raise InputError(
            f"expected a picture (H, W, 3), got an array of shape {image.shape}",
            where="camera motion",
        )
    gray = image
    if image.ndim == 3:
        gray = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
    scale = min(1.0, width / gray.shape[1])
    if scale < 1:
        size = (width, max(1, round(scale * gray.shape[0])))
        gray = np.asarray(cv2.resize(gray, size, interpolation=cv2.INTER_AREA), np.uint8)
    return _View(gray, scale, scale * np.asarray(xyxy, np.float64).reshape(-1, 4))


def _between(before: _View, after: _View, settings: SparseFlow) -> F8 | None:
    """(3, 3) map between two views, in pixels of the video; None if it cannot be measured."""
    start, end = _tracked(before, after)
    if len(start) < MIN_POINTS:
        return None
    if settings.form == "homography":
        matrix, inliers = cv2.findHomography(
            start,
            end,
            cv2.RANSAC,
            MAX_ERROR,
            maxIters=_MAX_ITERATIONS,
            confidence=_CONFIDENCE,
        )
    else:
        matrix, inliers = cv2.estimateAffinePartial2D(
            start,
            end,
            method=cv2.RANSAC,
            ransacReprojThreshold=MAX_ERROR,
            maxIters=_MAX_ITERATIONS,
            confidence=_CONFIDENCE,
        )
    if matrix is None or not np.isfinite(matrix).all():
        return None
    enough = max(MIN_POINTS, MIN_INLIER_SHARE * len(start))
    if np.count_nonzero(inliers) < enough:
        return None
    small = np.vstack([matrix, [0.0, 0.0, 1.0]])[:3]
    # Boxes count from a pixel's edge, OpenCV from its centre.
    to_small = np.array([[before.scale, 0.0, -0.5], [0.0, before.scale, -0.5], [0.0, 0.0, 1.0]])
    warp = np.linalg.inv(to_small) @ small @ to_small
    warp /= warp[2, 2]
    return warp if _plausible(warp, before) else None


def _tracked(before: _View, after: _View) -> tuple[F8, F8]:
    """(n, 2) points of the earlier view, and their places in the later one."""
    none = np.zeros((0, 2))
    if before.gray.shape != after.gray.shape:
        return none, none
    background: Image = np.full(before.gray.shape, 255, np.uint8)
    for left, top, right, bottom in before.boxes:
        margin = _MARGIN * max(right - left, bottom - top)
        x0, y0, x1, y1 = np.maximum(
            [left - margin, top - margin, right + margin, bottom + margin], 0
        ).astype(int)
        background[y0:y1, x0:x1] = 0
    distance = max(3.0, _DISTANCE * before.gray.shape[1])
    corners = cv2.goodFeaturesToTrack(
        before.gray, MAX_POINTS, _MIN_QUALITY, distance, mask=background
    )
    if corners is None:
        return none, none
    end, found, _ = cv2.calcOpticalFlowPyrLK(
        before.gray, after.gray, corners, None, winSize=_WINDOW, maxLevel=_LEVELS
    )
    back, returned, _ = cv2.calcOpticalFlowPyrLK(
        after.gray, before.gray, end, None, winSize=_WINDOW, maxLevel=_LEVELS
    )
    good = (found.ravel() == 1) & (returned.ravel() == 1)
    good &= np.linalg.norm((back - corners).reshape(-1, 2), axis=1) <= MAX_ERROR
    start = corners.reshape(-1, 2)[good]
    return start.astype(np.float64), end.reshape(-1, 2)[good].astype(np.float64)


def _plausible(warp: F8, before: _View) -> bool:
    """Return True if the corners of the picture stay in order and near where they were."""
    height, width = (side / before.scale for side in before.gray.shape)
    moved = warp @ np.array([[0, width, width, 0], [0, 0, height, height], [1, 1, 1, 1]])
    if (moved[2] <= _MIN_DEPTH).any():
        return False
    corners = moved[:2] / moved[2]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=0)
    zoom = sides / [height, width, height, width]
    if (zoom >= _MAX_ZOOM).any() or (zoom <= 1 / _MAX_ZOOM).any():
        return False
    shift = np.linalg.norm(corners.mean(axis=1) - [width / 2, height / 2])
    return bool(shift < _MAX_SHIFT * width)
