"""From a foreground mask to boxes: clean-up, connected components, parting of what touches, joining
of fragments.

1. *Clean*: peel the foreground's border (bridges between neighbours and specks go), then close
  gaps, higher than wide.
2. *Components*: outer contours with enough area.
3. *Split*: a component is cut where its column profile (foreground pixels per column) has a deep
  valley.
4. *Join*: fragments one above the other become one box, unless it would be much higher than wide.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import cv2
import numpy as np
from annotated_types import Ge, Lt
from numpy.typing import NDArray

from phdtrack.devices import size_of
from phdtrack.errors import Checked, InputError
from phdtrack.kernels.blobs import Cleaning, cleaned, measured, valley
from phdtrack.types import F8, I8, Bool, Detections, Frame, Image

# Corners in whole pixels: left, top, right, bottom; right and bottom are one beyond the last.
Box = tuple[int, int, int, int]
# The box of a component, and its outer contour (n, 1, 2).
Contour = NDArray[np.int32]
Component = tuple[Box, Contour]
FrameShare = Annotated[float, Ge(0), Lt(1)]
# Half the width in pixels of what masks are cleaned with, at most.
_WIDE = 63
_SMALLEST_SHARE = 0.3
_NARROWEST = 0.15
_SMOOTHING = 0.06
_ALIGNED = 0.6
_SLENDEREST = 3.5
_WIDEST = 0.8
# Heights are learned from at least `_ENOUGH` boxes and at most some `_MANY`; the slope from pairs
# with feet `_APART` of the picture's height apart; and not where the median deviation of log
# heights is above `_UNLIKE`. `_HIGHER` times the height of an object is too high for one.
_ENOUGH = 12
_MANY = 500
_APART = 0.05
_UNLIKE = 0.35
_HIGHER = 1.35


def check_same_size(frame: Frame, shape: tuple[int, ...]) -> None:
    """Raise InputError where ``frame`` is not of the (H, W) ``shape`` that the detector has
    learned.
    """
    if size_of(frame) != shape[1::-1]:
        got, learned = (f"{size[0]}x{size[1]}" for size in (size_of(frame), shape[1::-1]))
        problem = f"this frame is {got} pixels, the background was learned at {learned}"
        raise InputError(
            problem, where=f"frame {frame.number}", cure="Call reset() before another video."
        )


@dataclass(frozen=True, slots=True)
class Heights:
    """How high objects are in a picture, by the row of their feet: log height = ``offset`` +
    ``slope`` · row.

    Side by side they may be one component, which is as high; so it is heights that components
    teach, not widths.
    """

    offset: float
    slope: float

    def at(self, foot: float) -> float:
        """The height in pixels of an object with its feet in this row."""
        return math.exp(self.offset + self.slope * foot)

    @classmethod
    def learned(cls, boxes: Sequence[F8], shape: tuple[int, ...]) -> Heights | None:
        """By the median of slopes (Theil and Sen) from boxes (N, 4) of frames of (H, W, ...)
        ``shape``; None: too few.

        Those that end at the border of the picture or may be fragments, for another one is above or
        below, do not count.
        """
        rows = [box for found in boxes for box in found[_alone(found, shape)]]
        if len(rows) < _ENOUGH:
            return None
        # The slopes are of all pairs.
        rows = rows[:: 1 + len(rows) // _MANY]
        x, y = np.array([[box[3], math.log(box[3] - box[1])] for box in rows]).T
        a, b = np.triu_indices(len(x), 1)
        apart = np.abs(x[a] - x[b]) > _APART * shape[0]
        if apart.sum() >= _ENOUGH:
            slope = float(np.median((y[a] - y[b])[apart] / (x[a] - x[b])[apart]))
        else:
            slope = 0.0
        offset = float(np.median(y - slope * x))
        # Where heights differ by so much, they say nothing.
        if np.median(np.abs(y - slope * x - offset)) < _UNLIKE:
            return cls(offset, slope)
        return None


def _alone(boxes: F8, shape: tuple[int, ...]) -> Bool:
    """(N,) the boxes (N, 4) inside the picture that have no other one above or below them within
    their height.
    """
    left, top, right, bottom = boxes.T
    inside = (left > 1) & (top > 1) & (right < shape[1] - 1) & (bottom < shape[0] - 1)
    beside = (left[:, None] < right) & (left < right[:, None])
    between = np.maximum(top[:, None], top) - np.minimum(bottom[:, None], bottom)
    near = beside & (between < (bottom - top)[:, None])
    return np.asarray(inside & (near.sum(axis=1) == 1))


@dataclass(frozen=True, slots=True)
class BlobSettings(Checked):
    """How a mask becomes boxes.

    Attributes
    ----------
    peel : by how much the foreground's border is taken away, fraction of the frame's height,
        rounded to whole pixels; the boxes get it back. Specks of a pixel go in any case.
    closing : height of the gaps that are closed, fraction of the frame's height; gaps a third as
        wide are closed too.
    min_area : smallest component after peeling, fraction of the frame's area.
    split : a component is cut where its column profile falls to this fraction of the lower
        neighbouring peak; 0: never.
    join : fragments one above the other are joined over gaps up to this fraction of their common
        height; 0: never.
    """

    peel: FrameShare = 0.0015
    closing: FrameShare = 0.026
    min_area: FrameShare = 0.0006
    split: FrameShare = 0.7
    join: FrameShare = 0.15

    def cleaning(self, height: int) -> Cleaning:
        """How masks of so many rows are cleaned."""
        return _cleaning(self.peel, self.closing, height)

    def clean(self, mask: Image) -> Image:
        """(H, W) uint8, 255 where ``mask`` (H, W) still is foreground after peeling and closing."""
        return np.asarray(
            cleaned(np.ascontiguousarray(mask), self.cleaning(len(mask)), 0)[0], np.uint8
        )

    def components(self, mask: Image) -> list[Component]:
        """What is large enough in a cleaned ``mask``, objects that touch parted."""
        least = self.min_area * mask.size
        return [part for one in _components(mask, least) for part in _split(one, self.split, least)]

    def boxes(
        self, components: Sequence[Component], shape: tuple[int, ...], usual: Heights | None = None
    ) -> F8:
        """(N, 4) xyxy of the objects in the components, from top to bottom.

        Parameters
        ----------
        components : as of `components`.
        shape : (H, W, ...) of the frame.
        usual : how high objects are where; what would be much higher as one is two objects.
        """
        height, width = shape[:2]
        found: list[Box] = []
        for box, _ in components:
            while partner := next(
                (other for other in found if _belong(box, other, self.join, usual)), None
            ):
                found.remove(partner)
                box = _union(box, partner)
            found.append(box)
        rows = np.array(sorted(found, key=lambda box: (box[1], box[0])), np.float64).reshape(-1, 4)
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
    """With peel and height of gaps in fractions of the height; the same for all masks of a
    video.
    """
    radius = min(
        _WIDE, round(peel * height)
    )  # 0 in small pictures, where a pixel is a good part of an arm
    speck, across, along = (
        2 * max(1, radius) + 1,
        *(max(1, round(closing * height / k)) | 1 for k in (3, 1)),
    )
    return Cleaning(radius, _ellipse(speck, speck), _ellipse(across, along))


def _ellipse(width: int, height: int) -> I8:
    """(height,) half the width of each row of OpenCV's ellipse; both odd."""
    element = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, height))
    return np.asarray(np.minimum(element.sum(axis=1, dtype=np.int64) // 2, _WIDE))


def _components(mask: Image, least: float, left: int = 0, top: int = 0) -> list[Component]:
    """The components of a mask whose outer contours enclose at least so much, seen from (left,
    top).
    """
    found, _ = cv2.findContours(
        mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE, offset=(left, top)
    )
    if not found:
        return []
    points = np.concatenate(found)[:, 0]
    boxes, areas = measured(points, np.cumsum([len(one) for one in found]))
    rows = zip(boxes.tolist(), found, areas.tolist(), strict=True)
    return [
        ((x, y, right, bottom), np.asarray(one, np.int32))
        for (x, y, right, bottom), one, area in rows
        if area >= least
    ]


def _split(component: Component, depth: float, least: float) -> list[Component]:
    """The parts into which the component falls at the valleys of its column profile."""
    (x, y, right, bottom), contour = component
    width = right - x
    height = bottom - y
    margin = _NARROWEST * height
    if depth <= 0 or width < 2 * max(2, margin):
        return [component]
    filled = np.zeros((height, width), np.uint8)
    cv2.drawContours(filled, [contour], -1, 255, cv2.FILLED, offset=(-x, -y))
    smooth = max(3, round(_SMOOTHING * height)) | 1
    cut = valley(filled, depth, smooth, round(max(2.0, margin)), _SMALLEST_SHARE)
    parts: list[Component] = []
    for start, end in () if cut < 0 else ((0, cut), (cut, width)):
        pieces = _components(filled[:, start:end].copy(), 0.0, x + start, y)
        largest = max(pieces, key=lambda piece: cv2.contourArea(piece[1]))
        if cv2.contourArea(largest[1]) >= least:
            parts.extend(_split(largest, depth, least))
    return parts or [component]


def _union(a: Box, b: Box) -> Box:
    """The box that holds both."""
    return min(a[0], b[0]), min(a[1], b[1]), max(a[2], b[2]), max(a[3], b[3])


def _belong(a: Box, b: Box, gap: float, usual: Heights | None) -> bool:
    """Whether two boxes are fragments of one upright object."""
    left, top, right, bottom = _union(a, b)
    width = right - left
    height = bottom - top
    shared = min(a[2], b[2]) - max(a[0], b[0])
    between = max(a[1], b[1]) - min(a[3], b[3])
    if usual is not None and height > _HIGHER * usual.at(bottom):
        return False
    aligned = gap > 0 and shared > _ALIGNED * min(a[2] - a[0], b[2] - b[0])
    return (
        aligned
        and between < gap * height
        and width < _WIDEST * height
        and height < _SLENDEREST * width
    )
