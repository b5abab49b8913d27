"""The annotated frame, and the drawing over OpenCV that it shares with the plan and the pictures of mistakes.

Drawn from the back to the front:

* detections: thin white outlines; thin red ones with a cross where the filter takes them for false alarms (posterior
  clutter probability above one half);
* trails of the last seconds of each track, at the foot of its box, fading;
* tracks not yet confirmed: a faint outline, no label;
* tracks: an outline in the colour of the identity and its number; dashed where no detection supports the box in this frame;
* a header: frame number, number of tracks, the filter's expected count.

The twelve colours of identities are light enough for dark pictures and strong enough for white paper. Consecutive ones
differ by at least 40 units of CIE L*a*b*, for normal sight and in the simulation of protanopia and deuteranopia by
Machado, Oliveira and Fernandes (2009). They repeat, so that wherever an identity is drawn its number stands there too.
Colours are RGB here, BGR in the picture. The functions from `outline` on write into the picture that they are given.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from phdtrack.errors import InputError
from phdtrack.types import F8, Detections, Image, SequenceInfo, Tracks

Rgb = tuple[int, int, int]
Corners = tuple[int, int, int, int]
_HEX = "ff9f1c 1fb5ad ffe14d a78bfa 2ec27e 4d7cfe ff4d4d e8d5ff c98b5b 4cc9f0 b5e853 ff7ac6"
COLOURS: tuple[Rgb, ...] = tuple((each[0], each[1], each[2]) for each in map(bytes.fromhex, _HEX.split()))
BLACK: Rgb = (0, 0, 0)
WHITE: Rgb = (255, 255, 255)
_FALSE_ALARM: Rgb = (200, 45, 45)
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_UNKNOWN: F8 = np.zeros(0)


def identity_colour(identity: int) -> Rgb:
    """Red, green, blue (0–255) of the target with this identity (from 1)."""
    return COLOURS[(identity - 1) % len(COLOURS)]


def ink_on(colour: Rgb) -> Rgb:
    """Black or white, whichever is easier to read on ``colour`` (by relative luminance)."""
    red, green, blue = ((c / 255) ** 2.2 for c in colour)
    return BLACK if 0.2126 * red + 0.7152 * green + 0.0722 * blue > 0.2 else WHITE


class Annotator:
    """Draws frame after frame and remembers the trails.

    Parameters
    ----------
    info : the sequence; its rate turns ``trail_seconds`` into frames.
    trail_seconds : how far back trails reach.
    """

    def __init__(self, info: SequenceInfo, *, trail_seconds: float = 1.5) -> None:
        rate = info.fps if info.fps > 0 else 25.0
        self._length = max(2, round(trail_seconds * rate))
        self._trails: dict[int, deque[tuple[int, float, float]]] = {}

    def __call__(
        self,
        image: Image,
        number: int,
        tracks: Tracks,
        detections: Detections,
        *,
        mass: float = math.nan,
        clutter_probability: F8 = _UNKNOWN,
    ) -> Image:
        """A new picture: the frame with everything drawn on it.

        Parameters
        ----------
        image : (H, W, 3) BGR uint8.
        number : of the frame, from 1.
        tracks : rows of any frames; those of frame ``number`` are drawn.
        detections : the boxes of this frame.
        mass : the filter's expected count; left out of the header where not finite.
        clutter_probability : (N,) for the detections, or (0,) where unknown.

        Returns
        -------
        (H, W, 3) BGR uint8.

        Raises
        ------
        InputError : the picture is not (H, W, 3) uint8, or the probabilities do not fit the detections.
        """
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
            raise InputError(
                f"expected a BGR picture (H, W, 3) of uint8, got {image.shape} of {image.dtype}", where=f"frame {number}"
            )
        if len(clutter_probability) not in (0, len(detections)):
            problem = (
                f"expected a clutter probability for each of {len(detections)} detections, got {len(clutter_probability)}"
            )
            raise InputError(problem, where=f"frame {number}")
        out, pen = image.copy(), Pen.for_frame(*image.shape[:2])
        false_alarm = clutter_probability > 0.5 if len(clutter_probability) else np.zeros(len(detections), np.bool_)
        for false, colour in ((False, WHITE), (True, _FALSE_ALARM)):
            for found in visible(detections.xyxy[false_alarm == false], out):
                faint_rectangle(out, found, colour, pen.thin, opacity=0.75, crossed=false)
        rows = tracks.take(tracks.frame == number)
        for identity, points in self._trails_with(rows, number).items():
            _fading_line(out, points, identity_colour(identity), pen.line)
        _draw_tracks(out, rows, pen)
        count = int(rows.confirmed.sum())
        header = f"frame {number}   {count} track{'' if count == 1 else 's'}"
        header += f"   expected count {mass:.1f}" if math.isfinite(mass) else ""
        plate(out, header, (0, 0), BLACK, pen, opacity=0.65)
        return out

    def _trails_with(self, rows: Tracks, number: int) -> dict[int, F8]:
        """(n, 2) earlier and present feet of each identity, oldest first; those too old are forgotten."""
        for identity, box in rows.take(rows.confirmed):
            trail = self._trails.setdefault(identity, deque(maxlen=self._length))
            trail.append((number, float(box[0] + box[2]) / 2, float(box[3])))
        for trail in self._trails.values():
            while trail and trail[0][0] <= number - self._length:
                trail.popleft()
        self._trails = {identity: trail for identity, trail in self._trails.items() if trail}
        return {identity: np.array(trail)[:, 1:] for identity, trail in self._trails.items()}


def _draw_tracks(out: Image, rows: Tracks, pen: Pen) -> None:
    """Outlines from the top of the frame downwards, because what stands lower is usually nearer; then all labels."""
    labels: list[tuple[Corners, int]] = []
    for i in np.lexsort((rows.xyxy[:, 3], rows.confirmed)):
        corners, identity = placed(rows.xyxy[i], out), int(rows.identity[i])
        if corners is None:
            continue
        if rows.confirmed[i]:
            outline(out, corners, identity_colour(identity), pen, dashed=bool(rows.predicted[i]))
            labels.append((corners, identity))
        else:
            faint_rectangle(out, corners, identity_colour(identity), pen.line, opacity=0.4)
    for corners, identity in labels:
        plate(out, str(identity), corners[:2], identity_colour(identity), pen)


class Pen(NamedTuple):
    """Widths of a line, a thin line and of letters, length of a dash, in pixels, and a font scale, to suit a frame."""

    line: int
    thin: int
    font: float
    bold: int
    dash: int

    @classmethod
    def for_frame(cls, height: int, width: int) -> Pen:
        """480 lines are the unit; very small frames keep text that can still be read."""
        unit = min(height, 0.75 * width) / 480
        line, thin, bold, dash = (max(least, round(part * unit)) for part, least in ((1.6, 1), (0.7, 1), (1, 1), (8, 5)))
        return cls(line, thin, max(0.34, 0.39 * unit), bold, dash)


def placed(box: F8, image: Image) -> Corners | None:
    """Whole-pixel left, top, right, bottom; None where nothing of the box could be drawn (not finite, or outside).

    Boxes reaching far out are cut one frame beyond the edges: OpenCV's coordinates overflow otherwise.
    """
    high, wide = image.shape[:2]
    left, right = sorted((float(box[0]), float(box[2])))
    top, bottom = sorted((float(box[1]), float(box[3])))
    if not np.isfinite(box).all() or right < 0 or bottom < 0 or left > wide or top > high:
        return None
    x0, y0, x1, y1 = np.clip((left, top, right, bottom), (-wide, -high) * 2, (2 * wide, 2 * high) * 2).round().astype(int)
    return int(x0), int(y0), int(x1), int(y1)


def visible(boxes: Iterable[F8], image: Image) -> list[Corners]:
    """The corners of those boxes (4,) of which something can be drawn."""
    return [corners for box in boxes if (corners := placed(box, image)) is not None]


def outline(image: Image, box: Corners, colour: Rgb, pen: Pen, *, dashed: bool = False) -> None:
    """Draw a closed rectangle, or one of dashes whose corners are always drawn, so that the shape stays clear.

    Parameters
    ----------
    image : is drawn on.
    box, colour, pen : where, and how.
    dashed : whether there are gaps.
    """
    if not dashed:
        cv2.rectangle(image, box[:2], box[2:], colour[::-1], pen.line)
        return
    x0, y0, x1, y1 = box
    lines = [((a, y), (b, y)) for a, b in _dashes(x0, x1, pen.dash) for y in (y0, y1)]
    lines += [((x, a), (x, b)) for a, b in _dashes(y0, y1, pen.dash) for x in (x0, x1)]
    for start, end in lines:
        cv2.line(image, start, end, colour[::-1], pen.line)


def _dashes(start: int, end: int, dash: int) -> list[tuple[int, int]]:
    """An odd number of equal pieces from ``start`` to ``end``, every other one drawn, the first and last among them."""
    pieces = max(3, 2 * round((end - start) / dash / 2) + 1)
    edges = np.linspace(start, end, pieces + 1).round().astype(int).tolist()
    return list(zip(edges[0::2], edges[1::2], strict=True))


def faint_rectangle(image: Image, box: Corners, colour: Rgb, width: int, *, opacity: float, crossed: bool = False) -> None:
    """An outline that lets the picture through.

    Parameters
    ----------
    image : is drawn on.
    box, colour : where, and how.
    width : of the line, pixels.
    opacity : from 0 to 1.
    crossed : whether to draw the diagonals too.
    """
    x0, y0, x1, y1 = box
    near, far = (width, width), (width + x1 - x0, width + y1 - y0)
    mask = np.zeros((far[1] + width + 1, far[0] + width + 1), np.uint8)
    level = round(255 * opacity)
    cv2.rectangle(mask, near, far, level, width)
    if crossed:
        cv2.line(mask, near, far, level, width, cv2.LINE_AA)
        cv2.line(mask, (near[0], far[1]), (far[0], near[1]), level, width, cv2.LINE_AA)
    _blend(image, (x0 - width, y0 - width), mask, colour)


def _fading_line(image: Image, points: F8, colour: Rgb, width: int) -> None:
    """A line through ``points`` (n, 2), oldest first, that fades towards the oldest."""
    high, wide = image.shape[:2]
    inside = points[np.isfinite(points).all(axis=1)]
    inside = np.clip(inside, (-wide, -high), (2 * wide, 2 * high)).round().astype(int)
    if len(inside) < 2:
        return
    margin = width + 1
    low = inside.min(axis=0) - margin
    size = inside.max(axis=0) - low + margin + 1
    mask = np.zeros((int(size[1]), int(size[0])), np.uint8)
    for k, (a, b) in enumerate(pairwise((inside - low).tolist()), start=1):
        cv2.line(mask, a, b, round(30 + 200 * k / (len(inside) - 1)), width, cv2.LINE_AA)
    _blend(image, (int(low[0]), int(low[1])), mask, colour)


def plate(image: Image, text: str, corner: tuple[int, int], fill: Rgb, pen: Pen, *, opacity: float = 1.0) -> None:
    """Text on a coloured plate, moved and shrunk to stay in the frame.

    Parameters
    ----------
    image : is drawn on.
    text : what OpenCV's fonts cannot write, all but ASCII, becomes ``?``.
    corner : x and y of the plate's lower left corner.
    fill : its colour.
    pen : the size of the letters.
    opacity : of the plate, from 0 to 1.
    """
    high, wide = image.shape[:2]
    text, font = text.encode("ascii", "replace").decode("ascii"), pen.font
    (text_wide, text_high), below = cv2.getTextSize(text, _FONT, font, pen.bold)
    pad = max(2, text_high // 4)
    if text_wide + 2 * pad > wide:
        font *= max(0.1, (wide - 2 * pad) / text_wide)
        (text_wide, text_high), below = cv2.getTextSize(text, _FONT, font, pen.bold)
    under = pad + (0 if text.isdigit() else below // 2)
    plate_wide, plate_high = text_wide + 2 * pad, text_high + pad + under
    x = min(max(corner[0], 0), max(wide - plate_wide, 0))
    bottom = min(max(corner[1], plate_high), max(high, plate_high))
    ground = np.full((plate_high, plate_wide), round(255 * opacity), np.uint8)
    _blend(image, (x, bottom - plate_high), ground, fill)
    cv2.putText(image, text, (x + pad, bottom - under), _FONT, font, ink_on(fill)[::-1], pen.bold, cv2.LINE_AA)


def _blend(image: Image, corner: tuple[int, int], opacity: NDArray[np.uint8], colour: Rgb) -> None:
    """Blend ``colour`` into the picture at (left, top) with ``opacity`` (h, w), 0–255; parts outside are cut off."""
    (left, top), (high, wide) = corner, image.shape[:2]
    x0, y0 = max(left, 0), max(top, 0)
    x1, y1 = min(left + opacity.shape[1], wide), min(top + opacity.shape[0], high)
    if x0 >= x1 or y0 >= y1:
        return
    part = image[y0:y1, x0:x1]
    alpha = opacity[y0 - top : y1 - top, x0 - left : x1 - left, None].astype(np.uint16)
    part[:] = ((part * (255 - alpha) + np.array(colour[::-1], np.uint16) * alpha + 127) // 255).astype(np.uint8)
