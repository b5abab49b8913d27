"""From a foreground mask to boxes: clean-up, connected components, splitting and joining.

1. *Clean*: peel the foreground's border, which removes specks and bridges between neighbours, then
   close gaps, higher than wide.
2. *Components*: keep outer contours with enough area.
3. *Split*: cut a component where its column profile (foreground pixels per column) has a deep
   valley.
4. *Join*: merge fragments one above the other into one box, unless it would be much higher than
   wide.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import numpy as np
from annotated_types import Ge, Lt
from numpy.typing import NDArray

from phdtrack.devices import size_of
from phdtrack.errors import Checked, InputError
from phdtrack.kernels.blobs import Cleaning, cleaned, measured, valley
from phdtrack.opencv_package import cv2
from phdtrack.types import F8, I8, Bool, Detections, Frame, Image

# Left, top, right, bottom in whole pixels; right and bottom are one beyond the last.
Box = tuple[int, int, int, int]
# Points (n, 1, 2) of a component's outer contour.
Contour = NDArray[np.int32]
Component = tuple[Box, Contour]
FrameShare = Annotated[float, Ge(0), Lt(1)]
# Half the width in pixels of structuring elements, at most.
_MAX_RADIUS = 63
# Splitting: the smaller part's share of the component; the width of a part and of the profile's
# smoothing, as shares of the height.
_MIN_PART = 0.3
_MIN_WIDTH = 0.15
_SMOOTHING = 0.06
# Joining: overlap in width as a share of the narrower fragment; bounds of the joined box's height
# by its width, and of its width by its height.
_MIN_ALIGNED = 0.6
_MAX_SLENDERNESS = 3.5
_MAX_WIDTH = 0.8
# A joined box higher than this factor times the usual height is two objects.
_MAX_HEIGHT = 1.35
# Heights are learned from at least `_MIN_BOXES` and about `_MAX_BOXES` boxes; the slope from pairs
# with feet at least `_MIN_DISTANCE` of the picture's height apart; and not if the median deviation
# of log heights is above `_MAX_DEVIATION`.
_MIN_BOXES = 12
_MAX_BOXES = 500
_MIN_DISTANCE = 0.05
_MAX_DEVIATION = 0.35


def check_same_size(frame: Frame, shape: tuple[int, ...]) -> None:
    """Raise `InputError` if ``frame`` has not the (H, W) ``shape`` of the learned background."""
    width, height = size_of(frame)
    if (height, width) != shape[:2]:
        raise InputError(
            f"this frame is {width}x{height} pixels, the background was learned at"
            f" {shape[1]}x{shape[0]}",
            where=f"frame {frame.number}",
            cure="Call reset() before another video.",
        )


@dataclass(frozen=True, slots=True)
class Heights:
    """The usual height of objects by the row of their feet: log height = ``offset`` + ``slope`` ·
    row.

    Objects side by side may form one component, which is wider but not higher than one of them.
    Hence components teach heights, not widths.
    """

    offset: float
    slope: float

    def at(self, foot: float) -> float:
        """The height in pixels of an object with its feet in this row."""
        return math.exp(self.offset + self.slope * foot)

    @classmethod
    def learned(cls, boxes: Sequence[F8], shape: tuple[int, ...]) -> Heights | None:
        """Fit boxes (N, 4) of frames of (H, W, ...) ``shape`` by the median of slopes (Theil and
        Sen); None if there are too few, or if they differ too much.

        Boxes at the border of the picture do not count, nor do those that may be fragments because
        another box is above or below.
        """
        rows = [box for frame_boxes in boxes for box in frame_boxes[_alone(frame_boxes, shape)]]
        if len(rows) < _MIN_BOXES:
            return None
        # Work grows with the square of the number of boxes.
        rows = rows[:: 1 + len(rows) // _MAX_BOXES]
        x, y = np.array([[box[3], math.log(box[3] - box[1])] for box in rows]).T
        a, b = np.triu_indices(len(x), 1)
        slope = 0.0
        apart = np.abs(x[a] - x[b]) > _MIN_DISTANCE * shape[0]
        if apart.sum() >= _MIN_BOXES:
            slope = float(np.median((y[a] - y[b])[apart] / (x[a] - x[b])[apart]))
        offset = float(np.median(y - slope * x))
        if np.median(np.abs(y - slope * x - offset)) >= _MAX_DEVIATION:
            return None
        return cls(offset, slope)


def _alone(boxes: F8, shape: tuple[int, ...]) -> Bool:
    """(N,) True for boxes (N, 4) inside the picture with no other box above or below them within
    their height.
    """
    left, top, right, bottom = boxes.T
    inside = (left > 1) & (top > 1) & (right < shape[1] - 1) & (bottom < shape[0] - 1)
    beside = (left[:, None] < right) & (left < right[:, None])
    between = np.maximum(top[:, None], top) - np.minimum(bottom[:, None], bottom)
    near = beside & (between < (bottom - top)[:, None])
    return np.asarray(inside & (near.sum(axis=1) == 1))


@dataclass(frozen=True, slots=True)
class ConnectedComponents(Checked):
    """Turns a foreground mask into boxes.

    Attributes
    ----------
    peel : width of the border that is peeled from the foreground, fraction of the frame's height,
        rounded to whole pixels; boxes are grown by it again. Specks of one pixel always go.
    closing : height of gaps that are closed, fraction of the frame's height; gaps are closed up to
        a third of this width.
    min_area : smallest component after peeling, fraction of the frame's area.
    split : cut a component where its column profile falls to this fraction of the lower of the two
        peaks beside it; 0: never.
    join : join fragments one above the other over gaps up to this fraction of their common height;
        0: never.
    """

    peel: FrameShare = 0.0015
    closing: FrameShare = 0.026
    min_area: FrameShare = 0.0006
    split: FrameShare = 0.7
    join: FrameShare = 0.15

    def cleaning(self, height: int) -> Cleaning:
        """The structuring elements for masks of this many rows."""
        return _cleaning(self.peel, self.closing, height)

    def clean(self, mask: Image) -> Image:
        """(H, W) uint8, 255 where ``mask`` (H, W) is foreground after peeling and closing."""
        return np.asarray(
            cleaned(np.ascontiguousarray(mask), self.cleaning(len(mask)), 0)[0], np.uint8
        )

    def components(self, mask: Image) -> list[Component]:
        """The large connected components of a cleaned ``mask``, with touching objects split."""
        min_area = self.min_area * mask.size
        parts = list[Component]()
        for component in _components(mask, min_area):
            parts += _split(component, self.split, min_area)
        return parts

    def boxes(
        self, components: Sequence[Component], shape: tuple[int, ...], usual: Heights | None = None
    ) -> F8:
        """(N, 4) xyxy of the objects in the components, from top to bottom.

        Parameters
        ----------
        components : from `components`.
        shape : (H, W, ...) of the frame.
        usual : usual heights, if known; fragments that would be much higher together are not
            joined.
        """
        height, width = shape[:2]
        joined: list[Box] = []
        for box, _ in components:
            while True:
                partner = next(
                    (other for other in joined if _belong(box, other, self.join, usual)), None
                )
                if partner is None:
                    break
                joined.remove(partner)
                box = _union(box, partner)
            joined.append(box)
        rows = np.array(sorted(joined, key=lambda box: (box[1], box[0])), np.float64).reshape(-1, 4)
        grown = round(self.peel * height)
        inside: F8 = np.clip(
            rows + np.array([-grown, -grown, grown, grown]), 0, [width, height, width, height]
        )
        return inside

    def detections(self, mask: Image) -> Detections:
        """The detections in a raw foreground ``mask`` (H, W) uint8."""
        return Detections.of(self.boxes(self.components(self.clean(mask)), mask.shape))


@lru_cache(maxsize=20)
def _cleaning(peel: float, closing: float, height: int) -> Cleaning:
    """The structuring elements for peel and gaps given as fractions of the height."""
    # 0 in small pictures, where a pixel is a good part of an arm.
    radius = min(_MAX_RADIUS, round(peel * height))
    speck = 2 * max(1, radius) + 1
    across = max(1, round(closing * height / 3)) | 1
    along = max(1, round(closing * height)) | 1
    return Cleaning(radius, _ellipse(speck, speck), _ellipse(across, along))


def _ellipse(width: int, height: int) -> I8:
    """(height,) half the width of each row of OpenCV's ellipse; width and height are odd."""
    element = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, height))
    return np.asarray(np.minimum(element.sum(axis=1, dtype=np.int64) // 2, _MAX_RADIUS))


def _components(mask: Image, min_area: float, left: int = 0, top: int = 0) -> list[Component]:
    """The components of a mask with at least this area within their outer contour; (left, top) is
    the place of the mask in the picture.
    """
    contours, _ = cv2.findContours(
        mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE, offset=(left, top)
    )
    if not contours:
        return []
    points = np.concatenate(contours)[:, 0]
    boxes, areas = measured(points, np.cumsum([len(contour) for contour in contours]))
    return [
        ((x, y, right, bottom), np.asarray(contour, np.int32))
        for (x, y, right, bottom), contour, area in zip(
            boxes.tolist(), contours, areas.tolist(), strict=True
        )
        if area >= min_area
    ]


def _split(component: Component, depth: float, min_area: float) -> list[Component]:
    """The parts of a component, cut at the valleys of its column profile."""
    (x, y, right, bottom), contour = component
    width = right - x
    height = bottom - y
    margin = _MIN_WIDTH * height
    if depth <= 0 or width < 2 * max(2, margin):
        return [component]
    filled = np.zeros((height, width), np.uint8)
    cv2.drawContours(filled, [contour], -1, 255, cv2.FILLED, offset=(-x, -y))
    smooth = max(3, round(_SMOOTHING * height)) | 1
    cut = valley(filled, depth, smooth, round(max(2.0, margin)), _MIN_PART)
    if cut < 0:
        return [component]
    parts: list[Component] = []
    for start, end in ((0, cut), (cut, width)):
        pieces = _components(filled[:, start:end].copy(), 0.0, x + start, y)
        largest = max(pieces, key=lambda piece: cv2.contourArea(piece[1]))
        if cv2.contourArea(largest[1]) >= min_area:
            parts.extend(_split(largest, depth, min_area))
    return parts or [component]


def _union(a: Box, b: Box) -> Box:
    """The smallest box around both."""
    return min(a[0], b[0]), min(a[1], b[1]), max(a[2], b[2]), max(a[3], b[3])


def _belong(a: Box, b: Box, gap: float, usual: Heights | None) -> bool:
    """Return True if two boxes are fragments of one upright object."""
    left, top, right, bottom = _union(a, b)
    width = right - left
    height = bottom - top
    shared = min(a[2], b[2]) - max(a[0], b[0])
    between = max(a[1], b[1]) - min(a[3], b[3])
    if usual is not None and height > _MAX_HEIGHT * usual.at(bottom):
        return False
    aligned = gap > 0 and shared > _MIN_ALIGNED * min(a[2] - a[0], b[2] - b[0])
    return (
        aligned
        and between < gap * height
        and width < _MAX_WIDTH * height
        and height < _MAX_SLENDERNESS * width
    )
