"""The motion of the camera: none, given in a file, or measured between two pictures by following
points of the background.

Corners (Shi and Tomasi) of the earlier picture, outside the boxes of what was detected there, are
followed by pyramids of Lucas and Kanade's method into the later one and back; those that do not
come back to where they began are dropped. RANSAC finds the similarity, or homography, that most of
the others agree on. Its random numbers are OpenCV's own, begun anew in every call: the same
pictures give the same map.

Pictures are scaled down first. What moves in them and was not detected is outvoted as long as it is
less than the rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from phdtrack.errors import Checked, InputError, PositiveCount
from phdtrack.types import F8, Image

# Corners weaker than this share of the best are none; they keep this share of the width apart.
_QUALITY = 0.01
_APART = 0.012
# Around a box as much of its size is left out besides: shadows, and limbs that the box has not.
_MARGIN = 0.1
# No camera zooms by more from one frame to the next, or moves the picture by more than this share
# of its width.
_ZOOM = 1.5
_JUMP = 0.6


# Corners that are followed at most.
MAX_POINTS = 300
# Pixels of the scaled picture by which a point may miss the map, and its way back its beginning.
MAX_ERROR = 1.0
# Points that must fit the map, and the share of those followed; otherwise the camera is taken to
# stand still in that frame.
MIN_POINTS = 20
MIN_INLIER_SHARE = 0.4


@dataclass(frozen=True, slots=True)
class Standing:
    """The camera stands still."""


@dataclass(frozen=True, slots=True)
class GivenWarps:
    """Motion from a file.

    Parameters
    ----------
    file : a row for each frame, ``frame,g11,g12,g13,g21,g22,g23[,g31,g32,g33]``: see
        `formats.read_warps`.
    """

    file: str


@dataclass(frozen=True, slots=True)
class SparseFlow(Checked):
    """Motion measured by points that are followed from one picture to the next.

    Most of what is seen must belong to the background.

    Parameters
    ----------
    width : pictures are scaled down to this many pixels before they are looked at.
    form : ``similarity`` (shift, turn, zoom), which few points determine well; ``homography`` for a
        camera that pans with a wide lens, or a scene that is one plane.
    """

    width: PositiveCount = 640
    form: Literal["similarity", "homography"] = "similarity"


class CameraMotion:
    """How the camera moved since the picture before; it remembers that one.

    motion = CameraMotion()
    warp = motion(image, boxes)                 # the identity for the first
    rows = tracker.update(boxes, warp=warp)

    Call it once for every `Tracker.update`, with the picture that the boxes are from. ``measured``
    is False where the motion could not be found in the last picture and is taken for none.
    """

    def __init__(self, settings: SparseFlow | None = None) -> None:
        if settings is None:
            self.settings = SparseFlow()
        else:
            self.settings = settings
        self.reset()

    def reset(self) -> None:
        """The next picture is the first of a new sequence."""
        self._before: _View | None = None
        self.measured = True

    def __call__(self, image: Image, xyxy: F8) -> F8:
        """(3, 3) map from the pixels of the picture before to this one's (H, W, 3), in which
        ``xyxy`` (n, 4) were detected.

        Raises `InputError` where ``image`` is no picture.
        """
        now = _view(image, xyxy, self.settings.width)
        warp: F8 | None
        if self._before is None:
            warp = np.eye(3)
        else:
            warp = _between(self._before, now, self.settings)
        self._before = now
        self.measured = warp is not None
        return np.eye(3) if warp is None else warp


class _View(NamedTuple):
    """One picture as the flow sees it: ``gray`` (h, w) uint8, scaled by ``scale``, with ``boxes``
    (n, 4) in its pixels.
    """

    gray: Image
    scale: float
    boxes: F8


def _view(image: Image, xyxy: F8, width: int) -> _View:
    """The picture (H, W, 3) BGR, or (H, W) gray, scaled down to ``width``."""
    import cv2

    if image.ndim not in (2, 3) or not image.size:
        raise InputError(
            f"expected a picture (H, W, 3), got an array of shape {image.shape}",
            where="camera motion",
        )
    if image.ndim == 2:
        gray = image
    else:
        gray = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    scale = min(1.0, width / gray.shape[1])
    if scale < 1:
        gray = cv2.resize(
            gray, (width, max(1, round(scale * gray.shape[0]))), interpolation=cv2.INTER_AREA
        )
    return _View(gray, scale, scale * np.asarray(xyxy, np.float64).reshape(-1, 4))


def _between(before: _View, after: _View, settings: SparseFlow) -> F8 | None:
    """(3, 3) how the camera moved between two views, in pixels of the video; None where it cannot
    be measured.
    """
    import cv2

    found, arrived = _followed(before, after, settings)
    if len(found) < MIN_POINTS:
        return None
    if settings.form == "homography":
        matrix, inside = cv2.findHomography(
            found, arrived, cv2.RANSAC, MAX_ERROR, maxIters=2000, confidence=0.999
        )
    else:
        matrix, inside = cv2.estimateAffinePartial2D(
            found,
            arrived,
            method=cv2.RANSAC,
            ransacReprojThreshold=MAX_ERROR,
            maxIters=2000,
            confidence=0.999,
        )
    if matrix is None or not np.isfinite(matrix).all():
        return None
    if np.count_nonzero(inside) < max(MIN_POINTS, MIN_INLIER_SHARE * len(found)):
        return None
    small = np.vstack([matrix, [0.0, 0.0, 1.0]])[:3]
    # Boxes count from a pixel's edge and not, as OpenCV does, from its middle.
    to_small = np.array([[before.scale, 0.0, -0.5], [0.0, before.scale, -0.5], [0.0, 0.0, 1.0]])
    warp = np.linalg.inv(to_small) @ small @ to_small
    warp /= warp[2, 2]
    return warp if _credible(warp, before) else None


def _followed(before: _View, after: _View, settings: SparseFlow) -> tuple[F8, F8]:
    """(n, 2) points of the earlier view, and where they are in the later one."""
    import cv2

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
    apart = max(3.0, _APART * before.gray.shape[1])
    corners = cv2.goodFeaturesToTrack(before.gray, MAX_POINTS, _QUALITY, apart, mask=background)
    if corners is None:
        return none, none
    there, arrived, _ = cv2.calcOpticalFlowPyrLK(
        before.gray, after.gray, corners, None, winSize=(21, 21), maxLevel=4
    )
    back, returned, _ = cv2.calcOpticalFlowPyrLK(
        after.gray, before.gray, there, None, winSize=(21, 21), maxLevel=4
    )
    good = (arrived.ravel() == 1) & (returned.ravel() == 1)
    good &= np.linalg.norm((back - corners).reshape(-1, 2), axis=1) <= MAX_ERROR
    return corners.reshape(-1, 2)[good].astype(np.float64), there.reshape(-1, 2)[good].astype(
        np.float64
    )


def _credible(warp: F8, before: _View) -> bool:
    """Whether a camera may have moved so: the corners of the picture stay in order and near where
    they were.
    """
    high, wide = (side / before.scale for side in before.gray.shape)
    moved = warp @ np.array([[0, wide, wide, 0], [0, 0, high, high], [1, 1, 1, 1]])
    if (moved[2] <= 0.2).any():
        return False
    place = moved[:2] / moved[2]
    sides = np.linalg.norm(place - np.roll(place, 1, axis=1), axis=0) / [high, wide, high, wide]
    jump = np.linalg.norm(place.mean(axis=1) - [wide / 2, high / 2])
    return bool((sides < _ZOOM).all() and (sides > 1 / _ZOOM).all() and jump < _JUMP * wide)
