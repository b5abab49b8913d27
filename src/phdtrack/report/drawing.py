"""Boxes drawn on frames: the annotated video, and the mistakes of several methods side by side.

An annotated frame shows detections as thin white outlines, red and crossed where the filter takes them for false alarms
(posterior clutter probability above one half); fading trails at the feet of tracks; tracks in the colour of their identity
with its number, dashed where no detection supports the box; tracks not yet confirmed faintly and without a number; and a
header: frame number, number of tracks, the filter's expected count.

The twelve colours of identities are light enough for dark pictures and strong enough for white paper. Consecutive ones
differ by at least 40 units of CIE L*a*b*, for normal sight and in the simulation of protanopia and deuteranopia by
Machado, Oliveira and Fernandes (2009). They repeat, so that wherever an identity is drawn its number stands there too.
Colours are RGB here, BGR in the picture. `plate` writes into the picture that it is given.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np

from phdtrack.errors import InputError
from phdtrack.types import F8, I8, Bool, Detections, Image, SequenceInfo, Tracks

Rgb = tuple[int, int, int]
_HEX = "ff9f1c 1fb5ad ffe14d a78bfa 2ec27e 4d7cfe ff4d4d e8d5ff c98b5b 4cc9f0 b5e853 ff7ac6"
COLOURS: tuple[Rgb, ...] = tuple((each[0], each[1], each[2]) for each in map(bytes.fromhex, _HEX.split()))
BLACK: Rgb = (0, 0, 0)
WHITE: Rgb = (255, 255, 255)
_FALSE_ALARM: Rgb = (200, 45, 45)
MISSED, FALSE, SWITCHED, RIGHT = (255, 77, 77), (255, 159, 28), (255, 64, 255), (46, 194, 126)
_LEGEND = {"right": RIGHT, "missed (truth)": MISSED, "false": FALSE, "identity switched": SWITCHED, "detection": WHITE}
# Widths of a panel of mistakes, height of the bars above and below, and what lies between panels, pixels.
_WIDTHS, _BAR, _GAP, _DARK = (480, 720), 28, 6, (20, 20, 20)
_EDGES = (0, _GAP, 0, _GAP, cv2.BORDER_CONSTANT)
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_UNKNOWN: F8 = np.zeros(0)


def identity_colour(identity: int) -> Rgb:
    """Red, green, blue (0–255) of the target with this identity (from 1)."""
    return COLOURS[(identity - 1) % len(COLOURS)]


def feet(xyxy: F8) -> F8:
    """(n, 2) the middle of the lower edge of each box (n, 4)."""
    return np.stack([(xyxy[:, 0] + xyxy[:, 2]) / 2, xyxy[:, 3]], axis=1)


class Annotator:
    """Draws frame after frame and remembers the trails.

    Parameters
    ----------
    info : the sequence; its rate turns ``trail_seconds`` into frames.
    trail_seconds : how far back trails reach.
    """

    def __init__(self, info: SequenceInfo, *, trail_seconds: float = 1.5) -> None:
        self._length = max(2, round(trail_seconds * (info.fps if info.fps > 0 else 25.0)))
        self._past = Tracks.empty()

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
        where, known, count = f"frame {number}", len(clutter_probability), len(detections)
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
            raise InputError(f"expected a BGR picture (H, W, 3) of uint8, got {image.shape} of {image.dtype}", where=where)
        if known not in (0, count):
            raise InputError(f"expected a clutter probability for each of {count} detections, got {known}", where=where)
        pen, glaze, rows = Pen.of(image), _Glaze(image), tracks.take(tracks.frame == number)
        false_alarm = clutter_probability > 0.5 if known else np.zeros(count, np.bool_)
        for false, colour in ((False, WHITE), (True, _FALSE_ALARM)):
            for _, box in _corners(detections.xyxy[false_alarm == false], image):
                glaze.box(box, colour, pen.thin, 0.75, crossed=false)
        self._trails(glaze, number, rows.take(rows.confirmed), pen)
        # From the top of the frame downwards, because what stands lower is usually nearer.
        rows = rows.take(np.argsort(rows.xyxy[:, 3], kind="stable"))
        boxes = [(k, box, identity_colour(int(rows.identity[k]))) for k, box in _corners(rows.xyxy, image)]
        for k, box, colour in boxes:
            if not rows.confirmed[k]:
                glaze.box(box, colour, pen.line, 0.4)
        out, confirmed = glaze.mixed(), [each for each in boxes if rows.confirmed[each[0]]]
        for k, box, colour in confirmed:
            _outline(out, box, colour, pen, dashed=bool(rows.predicted[k]))
        for k, box, colour in confirmed:
            plate(out, str(rows.identity[k]), box[:2], colour, pen)
        count = int(rows.confirmed.sum())
        header = f"frame {number}   {count} track{'' if count == 1 else 's'}"
        header += f"   expected count {mass:.1f}" if math.isfinite(mass) else ""
        plate(out, header, (0, 0), BLACK, pen, opacity=0.65)
        return out

    def _trails(self, glaze: _Glaze, number: int, rows: Tracks, pen: Pen) -> None:
        """A line through the earlier and present feet of each identity, which fades towards the oldest."""
        past = Tracks.concatenate([self._past, rows])
        self._past = past = past.take(past.frame > number - self._length)
        for identity in np.unique(past.identity).tolist():
            points = feet(past.xyxy[past.identity == identity])
            points = np.clip(points[np.isfinite(points).all(axis=1)], -1e4, 1e4).round().astype(int)
            for k, (a, b) in enumerate(pairwise(points.tolist()), start=1):
                strength = (30 + 200 * k / (len(points) - 1)) / 255
                glaze.line(a, b, identity_colour(identity), pen.line, strength)


class Pen(NamedTuple):
    """Widths of a line, a thin line and of letters, length of a dash, in pixels, and a font scale, to suit a frame."""

    line: int
    thin: int
    font: float
    bold: int
    dash: int

    @classmethod
    def of(cls, image: Image) -> Pen:
        """480 lines are the unit; very small frames keep text that can still be read."""
        unit = min(image.shape[0], 0.75 * image.shape[1]) / 480
        line, thin, bold, dash = (max(least, round(part * unit)) for part, least in ((1.6, 1), (0.7, 1), (1, 1), (8, 5)))
        return cls(line, thin, max(0.34, 0.39 * unit), bold, dash)


class _Glaze:
    """What lets the picture through: drawn on a copy, which is mixed with the picture by the opacity of each pixel."""

    def __init__(self, image: Image) -> None:
        self._image, self._over = image, image.copy()
        self._opacity: Image = np.zeros(image.shape[:2], np.uint8)

    def box(self, box: Sequence[int], colour: Rgb, width: int, opacity: float, *, crossed: bool = False) -> None:
        """The outline of a box, with its diagonals where it is ``crossed``."""
        cv2.rectangle(self._over, box[:2], box[2:], colour[::-1], width)
        cv2.rectangle(self._opacity, box[:2], box[2:], round(255 * opacity), width)
        if crossed:
            self.line(box[:2], box[2:], colour, width, opacity)
            self.line((box[0], box[3]), (box[2], box[1]), colour, width, opacity)

    def line(self, start: Sequence[int], end: Sequence[int], colour: Rgb, width: int, opacity: float) -> None:
        """A line; the margin of the opacity holds its smoothed edge."""
        cv2.line(self._over, start, end, colour[::-1], width, cv2.LINE_AA)
        cv2.line(self._opacity, start, end, round(255 * opacity), width + 2)

    def mixed(self) -> Image:
        """A new picture with everything drawn so far."""
        out, place = self._image.copy(), np.nonzero(self._opacity)
        alpha = self._opacity[place][:, None].astype(np.uint16)
        out[place] = ((out[place] * (255 - alpha) + self._over[place] * alpha + 127) // 255).astype(np.uint8)
        return out


def _corners(boxes: F8, image: Image) -> list[tuple[int, list[int]]]:
    """The index and the whole-pixel left, top, right, bottom of those boxes (n, 4) of which something can be drawn.

    Boxes reaching far out are cut one frame beyond the edges: OpenCV's coordinates overflow otherwise.
    """
    size = np.array(image.shape[1::-1], np.float64)
    low, high = np.minimum(boxes[:, :2], boxes[:, 2:]), np.maximum(boxes[:, :2], boxes[:, 2:])
    seen = np.flatnonzero(np.isfinite(boxes).all(axis=1) & (high >= 0).all(axis=1) & (low <= size).all(axis=1))
    cut = np.hstack([np.clip(each[seen], -size, 2 * size) for each in (low, high)]).round().astype(int)
    return list(zip(seen.tolist(), cut.tolist(), strict=True))


def _outline(image: Image, box: Sequence[int], colour: Rgb, pen: Pen, *, dashed: bool = False) -> None:
    """A closed rectangle, or one of dashes whose corners are always drawn, so that the shape stays clear."""
    if not dashed:
        cv2.rectangle(image, box[:2], box[2:], colour[::-1], pen.line)
        return
    left, top, right, bottom = box
    for a, b in pairwise(np.array([[left, top], [right, top], [right, bottom], [left, bottom], [left, top]])):
        # An odd number of equal pieces, every other one drawn, the first and last among them.
        pieces = max(3, 2 * round(float(np.abs(b - a).max()) / pen.dash / 2) + 1)
        edges = np.linspace(a, b, pieces + 1).round().astype(int).tolist()
        for start, end in zip(edges[0::2], edges[1::2], strict=True):
            cv2.line(image, start, end, colour[::-1], pen.line)


def plate(image: Image, text: str, corner: Sequence[int], fill: Rgb, pen: Pen, *, opacity: float = 1.0) -> int:
    """Draw text on a coloured plate, moved and shrunk to stay in the frame.

    Parameters
    ----------
    image : is drawn on.
    text : what OpenCV's fonts cannot write, all but ASCII, becomes ``?``.
    corner : x and y of the plate's lower left corner.
    fill : its colour.
    pen : the size of the letters.
    opacity : of the plate, from 0 to 1.

    Returns
    -------
    The plate's width in pixels.
    """
    text, font, room = text.encode("ascii", "replace").decode("ascii"), pen.font, image.shape[1]
    (wide, high), below = cv2.getTextSize(text, _FONT, font, pen.bold)
    pad = max(2, high // 4)
    if wide + 2 * pad > room:
        font *= max(0.1, (room - 2 * pad) / wide)
        (wide, high), below = cv2.getTextSize(text, _FONT, font, pen.bold)
    under = pad + (0 if text.isdigit() else below // 2)
    wide, high = wide + 2 * pad, high + pad + under
    left = min(max(corner[0], 0), max(room - wide, 0))
    bottom = min(max(corner[1], high), max(image.shape[0], high))
    ground = image[bottom - high : bottom, left : left + wide]
    ground[:] = (ground * (1 - opacity) + np.array(fill[::-1]) * opacity + 0.5).astype(np.uint8)
    # Black or white, whichever is easier to read by relative luminance.
    light = np.array([0.2126, 0.7152, 0.0722]) @ (np.array(fill) / 255) ** 2.2 > 0.2
    cv2.putText(image, text, (left + pad, bottom - under), _FONT, font, BLACK if light else WHITE, pen.bold, cv2.LINE_AA)
    return int(wide)


@dataclass(frozen=True, slots=True, eq=False)
class Mistakes:
    """What a method made of a frame; boxes xyxy in pixels of the video.

    Attributes
    ----------
    method : its name.
    found : (k, 4) boxes on an annotated object.
    identity, switched : (k,) their identities, and whether the object had another one before.
    missed, false : (n, 4) annotated boxes, (m, 4) boxes of tracks, without a partner.
    """

    method: str
    found: F8
    identity: I8
    switched: Bool
    missed: F8
    false: F8

    @property
    def count(self) -> int:
        """Number of mistakes."""
        return len(self.missed) + len(self.false) + int(self.switched.sum())

    @property
    def title(self) -> str:
        """The method and its mistakes in words."""
        return f"{self.method}: {len(self.missed)} missed, {len(self.false)} false, {int(self.switched.sum())} switched"

    def _drawn(self, ground: Image, scale: float, detections: F8) -> Image:
        """A copy of ``ground`` with the boxes, whose pixels are ``scale`` times as large there as in the video."""
        pen, glaze = Pen.of(ground), _Glaze(ground)
        for _, box in _corners(detections * scale, ground):
            glaze.box(box, WHITE, pen.thin, 0.6)
        for _, box in _corners(self.false * scale, ground):
            glaze.box(box, FALSE, pen.line, 1.0, crossed=True)
        out = glaze.mixed()
        for k, box in _corners(self.found * scale, ground):
            colour = SWITCHED if self.switched[k] else RIGHT
            _outline(out, box, colour, pen)
            plate(out, str(self.identity[k]), box[:2], colour, pen)
        # On top: where a box is wrong, the one that it should have been is what one wants to see.
        for _, box in _corners(self.missed * scale, ground):
            _outline(out, box, MISSED, pen, dashed=True)
        plate(out, self.title, (0, 0), BLACK, pen, opacity=0.75)
        return out


def side_by_side(
    image: Image | None, size: tuple[int, int], heading: str, detections: F8, methods: Sequence[Mistakes]
) -> Image:
    """A picture with a panel for each method, on the frame where there is one, on a plain ground otherwise.

    Parameters
    ----------
    image : (H, W, 3) BGR, or None.
    size : width and height that the boxes are in.
    heading : what stands above everything.
    detections : (N, 4) what all methods were given.
    methods : what each made of it.

    Returns
    -------
    (h, w, 3) BGR.
    """
    wide = int(np.clip(size[0], *_WIDTHS))
    high = max(1, round(size[1] * wide / size[0]))
    ground = np.full((high, wide, 3), 46, np.uint8)
    if image is not None and image.size:
        ground = cv2.resize(image, (wide, high), interpolation=cv2.INTER_AREA).astype(np.uint8)
    # The shape of the whole is the one nearest to a page's (2 : 1). Up to four panels fill their rows.
    panels = [cv2.copyMakeBorder(one._drawn(ground, wide / size[0], detections), *_EDGES, value=_DARK) for one in methods]
    count = len(panels)
    shapes = [columns for columns in range(1, count + 1) if count > 4 or count % columns == 0]
    columns = min(shapes, key=lambda n: abs(math.log(wide / high * n / -(-count // n) / 2)))
    panels += [np.full_like(panels[0], _DARK[0])] * (-count % columns)
    rows = [np.hstack(panels[k : k + columns]) for k in range(0, len(panels), columns)]
    out: Image = cv2.copyMakeBorder(np.vstack(rows), _BAR + _GAP, _BAR, _GAP, 0, cv2.BORDER_CONSTANT, value=_DARK)
    pen, x = Pen.of(np.zeros((480, 640, 3), np.uint8)), _GAP
    plate(out, heading, (_GAP, _BAR - 4), BLACK, pen)
    for label, colour in _LEGEND.items():
        x += plate(out, label, (x, len(out) - 6), colour, pen) + 12
    return out
