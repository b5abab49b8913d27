"""Drawing on pictures with OpenCV, in the colours of identities.

The twelve colours are light enough for dark pictures and strong enough for white paper. Consecutive
ones differ by at least 40 units of CIE L*a*b*, for normal sight and in the simulation of protanopia
and deuteranopia by Machado, Oliveira and Fernandes (2009). They repeat, so an identity is always
drawn with its number. Colours are RGB here, BGR in the picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.planes import blend
from phdtrack.opencv_package import cv2
from phdtrack.types import F8, Bool, Image

Rgb = tuple[int, int, int]
_HEX = "ff9f1c 1fb5ad ffe14d a78bfa 2ec27e 4d7cfe ff4d4d e8d5ff c98b5b 4cc9f0 b5e853 ff7ac6"
COLOURS: tuple[Rgb, ...] = tuple(
    (each[0], each[1], each[2]) for each in map(bytes.fromhex, _HEX.split())
)
BLACK: Rgb = (0, 0, 0)
WHITE: Rgb = (255, 255, 255)
INK: Rgb = (58, 66, 80)
GREY: Rgb = (140, 140, 140)
# Fractions of a pixel in which lines are drawn: sixteenths.
FRACTION_BITS = 4
# Lines of a picture for which the sizes of strokes and letters are defined.
_USUAL_LINES = 480
_MIN_FONT = 0.34

# Relative luminance of a plate above which its text is black.
_LIGHT = 0.2


def identity_colour(identity: int) -> Rgb:
    """Red, green, blue (0–255) of the target with this identity (from 1); grey for none (0)."""
    if identity:
        return COLOURS[(identity - 1) % len(COLOURS)]
    return GREY


def feet(xyxy: F8) -> F8:
    """(n, 2) the middle of the lower edge of each box (n, 4)."""
    return np.stack([(xyxy[:, 0] + xyxy[:, 2]) / 2, xyxy[:, 3]], axis=1)


class Canvas:
    """A copy of a picture to draw on, or a transparent sheet that `onto` blends into a picture.

    Line widths, dashes and letters are defined for 480 lines, and grow with the picture.
    """

    def __init__(self, image: Image) -> None:
        unit = min(image.shape[0], 0.75 * image.shape[1]) / _USUAL_LINES
        self.line = max(1, round(1.6 * unit))
        self.thin = max(1, round(0.7 * unit))
        self._bold = max(1, round(unit))
        self._dash = max(5, round(8 * unit))
        # The text of very small frames stays legible.
        self._font = max(_MIN_FONT, 0.39 * unit)
        self.image = image.copy()
        self._opacity: Image = np.zeros(image.shape[:2], np.uint8)
        # Left, top, right and bottom of the labels, which do not overlap.
        self.labels: list[tuple[int, int, int, int]] = []

    def boxes(
        self, boxes: F8, colour: Rgb, width: int, opacity: float, *, crossed: bool = False
    ) -> None:
        """Draw translucent outlines of boxes.

        Parameters
        ----------
        boxes : (n, 4) xyxy, pixels.
        colour, width, opacity : of the lines; opacity from 0 to 1.
        crossed : draw the diagonals too.
        """
        for _, (left, top, right, bottom) in self._corners(boxes):
            cv2.rectangle(self.image, (left, top), (right, bottom), colour[::-1], width)
            cv2.rectangle(self._opacity, (left, top), (right, bottom), round(255 * opacity), width)
            if crossed:
                diagonals = [
                    np.array([[left, top], [right, bottom]], np.int32),
                    np.array([[left, bottom], [right, top]], np.int32),
                ]
                self.line_colour(diagonals, colour, width)
                self.line_opacity(diagonals, width, opacity)

    def line_colour(self, lines: Sequence[NDArray[np.int32]], colour: Rgb, width: int) -> None:
        """Draw the colour of lines, wider because of their smoothed edges.

        Parameters
        ----------
        lines : (n, 2) points of each.
        colour, width : of the lines.
        """
        cv2.polylines(self.image, lines, False, colour[::-1], width + 2)

    def line_opacity(self, lines: Sequence[NDArray[np.int32]], width: int, opacity: float) -> None:
        """Draw the opacity of lines.

        Parameters
        ----------
        lines : (n, 2) points of each.
        width, opacity : of the lines; opacity from 0 to 1.
        """
        cv2.polylines(self._opacity, lines, False, round(255 * opacity), width, cv2.LINE_AA)

    def onto(self, picture: Image) -> Image:
        """Blend this sheet into a picture, (H, W, 3) BGR or its planes (3H/2, W), and clear it."""
        if picture.ndim == 2:
            flat = picture.reshape(-1)
            height, width = self._opacity.shape
            brightness = flat[: height * width].reshape(height, width)
            blue, red = flat[height * width :].reshape(2, height // 2, width // 2)
            blend(brightness, blue, red, self.image, self._opacity)
            return picture
        drawn = np.nonzero(self._opacity)
        alpha = self._opacity[drawn][:, None].astype(np.uint16)
        mixed = (picture[drawn] * (255 - alpha) + self.image[drawn] * alpha + 127) // 255
        picture[drawn] = mixed.astype(np.uint8)
        self._opacity[drawn] = 0
        return picture

    def targets(
        self, boxes: F8, colours: Sequence[Rgb], dashed: Bool, labels: Sequence[str]
    ) -> None:
        """Draw the outlines of boxes, and above all of them their labels.

        Parameters
        ----------
        boxes : (n, 4) xyxy, pixels.
        colours, dashed, labels : (n,) of each box.
        """
        visible = self._corners(boxes)
        for k, (left, top, right, bottom) in visible:
            if dashed[k]:
                self._dashed_box((left, top, right, bottom), colours[k])
                continue
            cv2.rectangle(self.image, (left, top), (right, bottom), colours[k][::-1], self.line)
            cv2.rectangle(self._opacity, (left, top), (right, bottom), 255, self.line)
        for k, box in visible:
            self.plate(labels[k], box[:2], colours[k])

    def _dashed_box(self, box: tuple[int, int, int, int], colour: Rgb) -> None:
        """Draw the dashed outline of a box."""
        left, top, right, bottom = box
        corners = np.array(
            [[left, top], [right, top], [right, bottom], [left, bottom], [left, top]]
        )
        for a, b in pairwise(corners):
            # An odd number of equal pieces, every other one drawn: the corners always are.
            pieces = max(3, 2 * round(float(np.abs(b - a).max()) / self._dash / 2) + 1)
            ends = np.linspace(a, b, pieces + 1).round().astype(int).tolist()
            for start, end in zip(ends[0::2], ends[1::2], strict=True):
                cv2.line(self.image, start, end, colour[::-1], self.line)
                cv2.line(self._opacity, start, end, 255, self.line)

    def plate(
        self,
        text: str,
        corner: Sequence[int],
        fill: Rgb,
        opacity: float = 1.0,
        *,
        cached: bool = True,
    ) -> int:
        """Draw text on a coloured plate, moved and shrunk to stay in the picture; its height in
        pixels.

        Parameters
        ----------
        text : letters of ASCII; others become question marks.
        corner : left and bottom, pixels.
        fill, opacity : of the plate; opacity from 0 to 1.
        cached : True for texts that recur in later frames.
        """
        style = (text, fill, round(255 * opacity), self._font, self._bold, self.image.shape[1])
        plate, alpha = cached_plate(*style) if cached else _plate(*style)
        height, width = alpha.shape
        lines, columns = self.image.shape[:2]
        left = min(max(corner[0], 0), max(columns - width, 0))
        bottom = min(max(corner[1], height), max(lines, height))
        area = slice(bottom - height, bottom), slice(left, left + width)
        visible = self.image[area].shape[:2]
        self.image[area] = plate[: visible[0], : visible[1]]
        self._opacity[area] = alpha[: visible[0], : visible[1]]
        return int(height)

    def legend(self, entries: Sequence[tuple[str, Rgb]], opacity: float) -> None:
        """Draw plates above each other in the lower left corner.

        Parameters
        ----------
        entries : texts, and the colours of their plates, from top to bottom.
        opacity : of the plates; from 0 to 1.
        """
        bottom = len(self.image)
        for text, fill in reversed(entries):
            bottom -= self.plate(text, (0, bottom), fill, opacity)

    def text(self, text: str, corner: Sequence[int], colour: Rgb) -> None:
        """Draw small letters without a plate.

        Parameters
        ----------
        text : letters of ASCII.
        corner : left and bottom, pixels.
        colour : of the letters.
        """
        scale = 0.8 * self._font
        cv2.putText(
            self.image, text, corner, cv2.FONT_HERSHEY_SIMPLEX, scale, colour[::-1], 1, cv2.LINE_AA
        )

    def path(self, points: F8, colour: Rgb, width: int) -> None:
        """Draw a line.

        Parameters
        ----------
        points : (2, K) pixels.
        colour, width : of the line.
        """
        line = fixed_point(points)
        cv2.polylines(self.image, [line], False, colour[::-1], width, cv2.LINE_AA, FRACTION_BITS)

    def contours(self, contours: Sequence[F8]) -> None:
        """Draw a group's outline, dark on light, because colours are for people. Rings (2, K)
        inside others are holes.
        """
        rings = [fixed_point(ring) for ring in contours]
        for colour, width in ((WHITE, self.line + 2), (INK, self.line)):
            cv2.polylines(self.image, rings, True, colour[::-1], width, cv2.LINE_AA, FRACTION_BITS)

    def label(self, text: str, corner: Sequence[int], fill: Rgb) -> None:
        """Draw a `plate`, moved up if it would cover an earlier label.

        Parameters
        ----------
        text : letters of ASCII.
        corner : left and bottom, pixels.
        fill : colour of the plate.
        """
        (width, height), descent = cv2.getTextSize(
            text, cv2.FONT_HERSHEY_SIMPLEX, self._font, self._bold
        )
        padding = max(2, height // 4)
        width = width + 2 * padding
        height = height + 2 * padding + descent // 2
        left = min(max(corner[0], 0), max(self.image.shape[1] - width, 0))
        bottom = max(corner[1], height)
        beside = [box for box in self.labels if box[0] < left + width and left < box[2]]
        for _ in beside:
            covered = [top for _, top, _, low in beside if top < bottom and bottom - height < low]
            if not covered or min(covered) < height:
                break
            bottom = min(covered) - 1
        self.labels.append((left, bottom - height, left + width, bottom))
        self.plate(text, (left, bottom), fill)

    def _corners(self, boxes: F8) -> list[tuple[int, list[int]]]:
        """The index, and left, top, right, bottom in whole pixels, of the visible boxes (n, 4).

        Boxes are cut one frame beyond the edges, because OpenCV's coordinates would overflow.
        """
        size = np.array(self.image.shape[1::-1], np.float64)
        low = np.minimum(boxes[:, :2], boxes[:, 2:])
        high = np.maximum(boxes[:, :2], boxes[:, 2:])
        inside = (high >= 0).all(axis=1) & (low <= size).all(axis=1)
        visible = np.flatnonzero(np.isfinite(boxes).all(axis=1) & inside)
        corners = np.hstack([low[visible], high[visible]])
        cut = np.clip(corners, -np.tile(size, 2), 2 * np.tile(size, 2)).round().astype(int)
        return list(zip(visible.tolist(), cut.tolist(), strict=True))


def _plate(
    text: str, fill: Rgb, opacity: int, font: float, bold: int, available: int
) -> tuple[Image, Image]:
    """(h, w, 3) BGR of text on a coloured plate, and its opacity (h, w).

    Letters are smaller if the plate would be wider than the pixels ``available``.
    """
    # OpenCV's fonts only have the letters of ASCII.
    text = text.encode("ascii", "replace").decode("ascii")
    (width, height), descent = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, font, bold)
    padding = max(2, height // 4)
    if width + 2 * padding > available:
        font *= max(0.1, (available - 2 * padding) / width)
        (width, height), descent = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, font, bold)
    below = padding + (0 if text.isdigit() else descent // 2)
    plate = np.full((height + padding + below, width + 2 * padding, 3), fill[::-1], np.uint8)
    alpha = np.full(plate.shape[:2], opacity, np.uint8)
    corner = (padding, len(alpha) - below)
    # Black or white, whichever has the better contrast.
    luminance = np.array([0.2126, 0.7152, 0.0722]) @ (np.array(fill) / 255) ** 2.2
    colour = BLACK if luminance > _LIGHT else WHITE
    cv2.putText(plate, text, corner, cv2.FONT_HERSHEY_SIMPLEX, font, colour, bold, cv2.LINE_AA)
    if opacity < 255:
        cv2.putText(alpha, text, corner, cv2.FONT_HERSHEY_SIMPLEX, font, (255,), bold, cv2.LINE_AA)
    return plate, alpha


cached_plate = lru_cache(maxsize=500)(_plate)


def draw_contours(image: Image, contours: Sequence[Sequence[F8]]) -> Image:
    """A copy of a picture (H, W, 3) BGR with the outlines of groups, each a list of rings (2, K) in
    pixels.
    """
    canvas = Canvas(image)
    for rings in contours:
        canvas.contours(rings)
    return canvas.image


def draw_plates(image: Image, plates: Sequence[tuple[str, Sequence[int]]]) -> Image:
    """A copy of a picture (H, W, 3) BGR with sentences on dark plates that do not overlap, each
    given by its text and lower left corner in pixels.
    """
    canvas = Canvas(image)
    for text, corner in plates:
        canvas.label(text, corner, INK)
    return canvas.image


def fixed_point(points: F8) -> NDArray[np.int32]:
    """(K, 1, 2) points (2, K) in sixteenths of a pixel, as OpenCV takes them."""
    scaled = np.clip(points.T, -1e5, 1e5) * 2**FRACTION_BITS
    return np.ascontiguousarray(scaled.round().astype(np.int32))[:, None]
