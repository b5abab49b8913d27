"""A small picture of each object, cut out while a run goes on."""

from __future__ import annotations

import base64
from typing import NamedTuple

import numpy as np

from phdtrack.arrays import iou, pixelated
from phdtrack.devices import bgr_of
from phdtrack.opencv_package import cv2
from phdtrack.types import F8, Frame, Image, Tracks

# Seconds between frames that are looked at: a decoder must convert each of them as a whole.
_PAUSE = 1.0
# A picture is replaced by one of an area so many times as large.
_LARGER = 1.5
# Most objects with a picture, and the pixels of its longer side.
_MOST = 300
_SIDE = 72
# The part of a box that is shown around it.
_MARGIN = 0.1
# The least overlap with the box of a corrected track for the picture to be of that object.
_SAME = 0.5


class _Cut(NamedTuple):
    """A picture: JPEG, of what was in a ``box`` (4,) of a ``frame``."""

    frame: int
    box: F8
    area: float
    data: bytes


class Thumbnails:
    """Cuts the objects of a run out of some of its frames.

    Parameters
    ----------
    blur : hides boxes as `arrays.pixelated` does; empty for nothing.
    """

    def __init__(self, blur: str = "") -> None:
        self._blur = blur
        self._cut = dict[int, _Cut]()
        self._next = -np.inf

    def see(self, frame: Frame, tracks: Tracks, boxes: F8) -> None:
        """Cut out those confirmed tracks of a frame that have no picture yet, or a small one.

        Parameters
        ----------
        frame : with its picture.
        tracks : the rows of this frame.
        boxes : (n, 4) everything that is hidden if something is.
        """
        if frame.time < self._next:
            return
        self._next = frame.time + _PAUSE
        good = tracks.confirmed & ~tracks.predicted & (tracks.frame == frame.number)
        wanted = list[tuple[int, float]]()
        for row in np.flatnonzero(good).tolist():
            x1, y1, x2, y2 = tracks.xyxy[row]
            area = float((x2 - x1) * (y2 - y1))
            before = self._cut.get(int(tracks.identity[row]))
            if before is None:
                if len(self._cut) + len(wanted) < _MOST:
                    wanted.append((row, area))
            elif area > _LARGER * before.area:
                wanted.append((row, area))
        if not wanted:
            return
        image = pixelated(bgr_of(frame.picture), boxes, self._blur)
        for row, area in wanted:
            part = _cut_out(image, tracks.xyxy[row])
            if part.size:
                _, data = cv2.imencode(".jpg", part, [cv2.IMWRITE_JPEG_QUALITY, 75])
                self._cut[int(tracks.identity[row])] = _Cut(
                    frame.number, tracks.xyxy[row].copy(), area, data.tobytes()
                )

    def of(self, tracks: Tracks) -> dict[int, str]:
        """The pictures as ``data:`` addresses, by the identities of corrected tracks, which may
        differ from those of the tracks that were cut out.
        """
        best = dict[int, _Cut]()
        for cut in self._cut.values():
            rows = np.flatnonzero(tracks.frame == cut.frame)
            if not len(rows):
                continue
            overlap = iou(cut.box[None], tracks.xyxy[rows])[0]
            row = rows[int(np.argmax(overlap))]
            identity = int(tracks.identity[row])
            known = best.get(identity)
            if overlap.max() >= _SAME and (known is None or cut.area > known.area):
                best[identity] = cut
        return {
            identity: f"data:image/jpeg;base64,{base64.b64encode(cut.data).decode('ascii')}"
            for identity, cut in best.items()
        }


def _cut_out(image: Image, box: F8) -> Image:
    """The content of a box and a little around it, at most `_SIDE` pixels high and wide."""
    x1, y1, x2, y2 = box
    margin = _MARGIN * np.array([x1 - x2, y1 - y2, x2 - x1, y2 - y1])
    edges = np.rint(box + margin).astype(np.int64)
    left, top, right, bottom = np.clip(edges, 0, [*image.shape[1::-1], *image.shape[1::-1]])
    part = image[top:bottom, left:right]
    if not part.size:
        return part
    scale = _SIDE / max(part.shape[:2])
    if scale >= 1:
        return np.ascontiguousarray(part)
    size = max(1, round(part.shape[1] * scale)), max(1, round(part.shape[0] * scale))
    return np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA), np.uint8)
