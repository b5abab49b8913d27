"""Mistakes in a frame, drawn: what was missed, what is false, whose identity changed, for several methods side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from phdtrack.report.drawing import BLACK, WHITE, Pen, Rgb, faint_rectangle, outline, placed, plate, visible
from phdtrack.types import F8, I8, Bool, Image

MISSED: Rgb = (255, 77, 77)
FALSE: Rgb = (255, 159, 28)
SWITCHED: Rgb = (255, 64, 255)
RIGHT: Rgb = (46, 194, 126)
_LEGEND = {"right": RIGHT, "missed (truth)": MISSED, "false": FALSE, "identity switched": SWITCHED, "detection": WHITE}
_NARROWEST, _WIDEST = 480, 720
_BAR, _GAP = 28, 6


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
    heading : what stands above everything.
    detections : (N, 4) what all methods were given.
    methods : what each made of it.

    Returns
    -------
    (h, w, 3) BGR.
    """
    wide = int(np.clip(size[0], _NARROWEST, _WIDEST))
    high = max(1, round(size[1] * wide / size[0]))
    ground = np.full((high, wide, 3), 46, np.uint8)
    if image is not None and image.size:
        ground = cv2.resize(image, (wide, high), interpolation=cv2.INTER_AREA).astype(np.uint8)
    columns = _columns(len(methods), wide / high)
    pen, rows = Pen.for_frame(480, 640), -(-len(methods) // columns)
    out = np.full((2 * _BAR + rows * (high + _GAP) + _GAP, columns * (wide + _GAP) + _GAP, 3), 20, np.uint8)
    for i, one in enumerate(methods):
        top, left = _BAR + _GAP + (i // columns) * (high + _GAP), _GAP + (i % columns) * (wide + _GAP)
        out[top : top + high, left : left + wide] = _panel(ground, wide / size[0], detections, one)
    plate(out, heading, (_GAP, _BAR - 4), BLACK, pen)
    x = _GAP
    for label, colour in _LEGEND.items():
        plate(out, label, (x, len(out) - 6), colour, pen)
        x += cv2.getTextSize(label, cv2.FONT_HERSHEY_SIMPLEX, pen.font, pen.bold)[0][0] + 18
    return out


def _columns(count: int, aspect: float) -> int:
    """How many panels of this width over height stand side by side, so that the whole is nearest to a page's shape (2 : 1).
    Up to four panels fill their rows."""
    columns = [each for each in range(1, count + 1) if count > 4 or count % each == 0]
    shapes = np.array([aspect * each / -(-count // each) for each in columns])
    return columns[int(np.argmin(np.abs(np.log(shapes / 2))))]


def _panel(ground: Image, scale: float, detections: F8, one: Mistakes) -> Image:
    out, pen = ground.copy(), Pen.for_frame(*ground.shape[:2])
    for box in visible(detections * scale, out):
        faint_rectangle(out, box, WHITE, pen.thin, opacity=0.6)
    for box in visible(one.false * scale, out):
        faint_rectangle(out, box, FALSE, pen.line, opacity=1.0, crossed=True)
    for raw, identity, switched in zip(one.found * scale, one.identity, one.switched, strict=True):
        corners = placed(raw, out)
        if corners is not None:
            colour = SWITCHED if switched else RIGHT
            outline(out, corners, colour, pen)
            plate(out, str(identity), corners[:2], colour, pen)
    # On top: where a box is wrong, the one that it should have been is what one wants to see.
    for box in visible(one.missed * scale, out):
        outline(out, box, MISSED, pen, dashed=True)
    plate(out, one.title, (0, 0), BLACK, pen, opacity=0.75)
    return out
