"""Mistakes in a frame, drawn: what was missed, what is false, whose identity changed, for several methods side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from phdtrack.report import strokes
from phdtrack.report.palette import BLACK, WHITE, Rgb
from phdtrack.report.strokes import Pen
from phdtrack.types import F8, I8, Bool, Image

MISSED: Rgb = (255, 77, 77)
FALSE: Rgb = (255, 159, 28)
SWITCHED: Rgb = (255, 64, 255)
RIGHT: Rgb = (46, 194, 126)
LEGEND = (
    ("right", RIGHT),
    ("missed (truth)", MISSED),
    ("false", FALSE),
    ("identity switched", SWITCHED),
    ("detection", WHITE),
)
_BOUNDS = 480, 720
_GROUND = 46
_GAP = 6
_SHAPE = 2.0
_FULL = 4


@dataclass(frozen=True, slots=True, eq=False)
class Mistakes:
    """What a method made of a frame; boxes xyxy in pixels of the video.

    Attributes
    ----------
    method : its name.
    found : (k, 4) boxes on an annotated object, ``identity`` (k,) theirs, ``switched`` (k,) where the object had another.
    missed, false : (n, 4) annotated boxes, (m, 4) boxes of tracks, without a partner.
    """

    method: str
    found: F8
    identity: I8
    switched: Bool
    missed: F8
    false: F8

    @property
    def title(self) -> str:
        """The method and its mistakes in words."""
        return f"{self.method}: {len(self.missed)} missed, {len(self.false)} false, {int(self.switched.sum())} switched"


def side_by_side(
    image: Image | None, size: tuple[int, int], heading: str, detections: F8, methods: Sequence[Mistakes]
) -> Image:
    """A picture with a panel for each method, on the frame where there is one, on a plain ground otherwise.

    Parameters
    ----------
    image : (H, W, 3) BGR, or None.
    size : width and height that the boxes are in.
    heading : ASCII, above everything.
    detections : (N, 4) what all methods were given.
    """
    width = int(np.clip(size[0], *_BOUNDS))
    scale = np.array([width, width]) / size[0]
    high = max(1, round(size[1] * width / size[0]))
    ground = np.full((high, width, 3), _GROUND, np.uint8)
    if image is not None and image.size:
        ground = cv2.resize(image, (width, high), interpolation=cv2.INTER_AREA).astype(np.uint8)
    panels = [_panel(ground, np.tile(scale, 2), detections, one) for one in methods]
    return _framed(panels, _columns(len(panels), width / high), heading)


def _columns(count: int, aspect: float) -> int:
    """How many panels of this width over height stand side by side, so that the whole is nearest to the shape of a page.

    Up to four panels fill their rows.
    """
    columns = [each for each in range(1, count + 1) if count > _FULL or count % each == 0]
    shapes = np.array([aspect * each / -(-count // each) for each in columns])
    return columns[int(np.argmin(np.abs(np.log(shapes / _SHAPE))))]


def _panel(ground: Image, scale: F8, detections: F8, one: Mistakes) -> Image:
    out = ground.copy()
    pen = Pen.for_frame(*out.shape[:2])
    for box in _corners(detections * scale, out):
        strokes.faint_rectangle(out, box, WHITE, pen.thin, 0.6)
    for box in _corners(one.false * scale, out):
        strokes.faint_rectangle(out, box, FALSE, pen.line, 1.0, crossed=True)
    for raw, identity, switched in zip(one.found * scale, one.identity, one.switched, strict=True):
        placed = strokes.corners(raw, out)
        if placed is not None:
            colour = SWITCHED if switched else RIGHT
            strokes.rectangle(out, placed, colour, pen.line)
            strokes.plate(out, str(identity), placed[0], placed[1], colour, pen)
    # On top: where a box is wrong, the one that it should have been is what one wants to see.
    for box in _corners(one.missed * scale, out):
        strokes.dashed_rectangle(out, box, MISSED, pen.line, pen.dash)
    strokes.plate(out, _ascii(one.title), 0, 0, BLACK, pen, opacity=0.75)
    return out


def _framed(panels: Sequence[Image], columns: int, heading: str) -> Image:
    """The panels in rows of ``columns``, the heading above and the legend below."""
    high, wide = panels[0].shape[:2]
    pen = Pen.for_frame(480, 640)
    bar, rows = 28, -(-len(panels) // columns)
    out = np.full((2 * bar + rows * (high + _GAP) + _GAP, columns * (wide + _GAP) + _GAP, 3), 20, np.uint8)
    for i, panel in enumerate(panels):
        top = bar + _GAP + (i // columns) * (high + _GAP)
        left = _GAP + (i % columns) * (wide + _GAP)
        out[top : top + high, left : left + wide] = panel
    strokes.plate(out, _ascii(heading), _GAP, bar - 4, BLACK, pen)
    x = _GAP
    for label, colour in LEGEND:
        strokes.plate(out, label, x, len(out) - 6, colour, pen)
        x += cv2.getTextSize(label, cv2.FONT_HERSHEY_SIMPLEX, pen.font, pen.bold)[0][0] + 18
    return out


def _corners(boxes: F8, image: Image) -> list[strokes.Corners]:
    placed = [strokes.corners(box, image) for box in boxes]
    return [one for one in placed if one is not None]


def _ascii(text: str) -> str:
    """What OpenCV's fonts can write."""
    return text.encode("ascii", "replace").decode("ascii")
