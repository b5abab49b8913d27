"""The ground from above, frame by frame [E13 Fig. 1]: detections as crosses, people, contours of groups with their counts,
the camera's field of view and the edges of roads.

Drawn with OpenCV on white, x to the right and y upwards, with a grid in metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import cv2
import numpy as np

from phdtrack.report.drawing import Pen, Rgb, identity_colour, plate
from phdtrack.types import F8, I8, Bool, Image

if TYPE_CHECKING:
    from phdtrack.groups.pipeline import GroupFrame

_GRID, _INK, _WITHOUT_IDENTITY = (228, 231, 236), (58, 66, 80), (140, 140, 140)
_FIELD, _EDGE, _WARNING = (216, 228, 246), (150, 120, 80), (208, 60, 60)
# Lines of the grid across the picture at most; metres around what is shown.
_MAX_LINES, _MARGIN = 12, 1.5
# Pictures are drawn in sixteenths of a pixel.
_FRACTION_BITS = 4


@dataclass(frozen=True, slots=True, eq=False)
class PlanScene:
    """What there is on the ground in one frame.

    Attributes
    ----------
    frame : its groups, with their contours and the warnings.
    detections, people : (2, N), (2, n) metres, NaN where they have no place on the ground.
    identity : (n,) of the people, 0 for none.
    """

    frame: GroupFrame
    detections: F8
    people: F8
    identity: I8

    @property
    def header(self) -> str:
        """Frame, time and numbers in words."""
        frame, detected = self.frame, int(np.isfinite(self.detections).all(axis=0).sum())
        crosses = f"   {detected} detections" if detected else ""
        counts = f"{frame.people:.1f} people in {frame.named} groups{crosses}"
        return f"frame {frame.number}   {frame.time:.1f} s   {counts}"


@dataclass(frozen=True, slots=False, eq=False)
class Plan:
    """The ground that is shown and how large.

    Parameters
    ----------
    extent : left, low, right, high in metres.
    width, height : pixels of the picture; both ways have the same scale, what is left over shows more ground.
    field : (2, K) outline of what the camera sees, metres; K = 0 for none.
    edges : lines (2, K) to be shown, such as the edges of roads, metres.
    """

    extent: tuple[float, float, float, float]
    width: int
    height: int
    field: F8 = field(default_factory=lambda: np.zeros((2, 0)))
    edges: tuple[F8, ...] = ()

    @property
    def scale(self) -> float:
        """Pixels per metre."""
        left, low, right, high = self.extent
        return min(self.width / max(right - left, 1e-9), self.height / max(high - low, 1e-9))

    def pixels(self, place: F8) -> F8:
        """(2, N) pixels of places (2, N) on the ground."""
        offset = place - np.array([[self.extent[0] + self.extent[2]], [self.extent[1] + self.extent[3]]]) / 2
        out: F8 = offset * np.array([[self.scale], [-self.scale]]) + np.array([[self.width], [self.height]]) / 2
        return out

    def draw(self, scene: PlanScene) -> Image:
        """A picture (height, width, 3) BGR of one frame."""
        out, pen, frame = self.ground.copy(), Pen.of(self.ground), scene.frame
        for identity, rings in zip(frame.identity.tolist(), frame.contours, strict=True):
            _contours(out, [self.pixels(ring) for ring in rings], identity, pen.line + 1, filled=True)
        for _, spot in self._shown(scene.detections):
            size = 2 * max(3, 2 * pen.line + 1)
            cv2.drawMarker(out, spot, _INK[::-1], cv2.MARKER_TILTED_CROSS, size, pen.thin, cv2.LINE_AA)
        for k, (x, y) in self._shown(scene.people):
            cv2.circle(out, (x, y), max(2, pen.line + 1), _INK[::-1], -1, cv2.LINE_AA)
            if scene.identity[k]:
                _text(out, str(scene.identity[k]), (x + 4, y - 4), _INK, pen)
        centre, velocity = frame.groups.mean[:2], frame.groups.mean[2:]
        # The way of the next second.
        for start, end in zip(self.pixels(centre).T, self.pixels(centre + velocity).T, strict=True):
            if np.isfinite(start + end).all() and np.hypot(*(end - start)) > 3:
                tail, tip = np.clip([start, end], -1e4, 1e4).round().astype(int).tolist()
                cv2.arrowedLine(out, tail, tip, _INK[::-1], pen.thin, cv2.LINE_AA, tipLength=0.25)
        place = dict(zip(frame.identity.tolist(), centre.T, strict=True))
        for warning in frame.warnings:
            if warning.first in place and warning.second in place:
                between = np.stack([place[warning.first], place[warning.second]], axis=1)
                self._line(out, between, _WARNING, pen.line)
                x, y = np.clip(self.pixels(between).mean(axis=1), 0, 1e4).astype(int).tolist()
                plate(out, f"meet in {warning.seconds:.1f} s", (x, y), _WARNING, pen, opacity=0.9)
        gap = round(min(1.2 * self.scale, 40)) // 2
        for g, (x, y) in self._shown(centre):
            if label := _label(frame, g):
                plate(out, label, (x + gap, y - gap), _colour(int(frame.identity[g])), pen)
        plate(out, scene.header, (0, 0), _INK, pen, opacity=0.85)
        return out

    @cached_property
    def ground(self) -> Image:
        """What is the same in all frames: field of view, grid and edges."""
        out: Image = np.full((self.height, self.width, 3), 255, np.uint8)
        pen, size = Pen.of(out), np.array([self.width, self.height]) / self.scale
        if self.field.shape[1] > 2:
            cv2.fillPoly(out, [_fixed(self.pixels(self.field))], _FIELD[::-1], cv2.LINE_AA, _FRACTION_BITS)
        # The smallest of 1, 2, 5, 10, … times a power of ten with few enough lines.
        smallest = size.max() / _MAX_LINES
        steps = 10 ** np.floor(np.log10(smallest)) * np.array([1, 2, 5, 10])
        step = steps[steps >= smallest * (1 - 1e-9)].min()
        middle = (np.array(self.extent[:2]) + np.array(self.extent[2:])) / 2
        reach = np.stack([middle - size / 2, middle + size / 2], axis=1)
        for axis in (0, 1):
            # Adding 0 makes 0 of −0.
            for value in np.arange(np.ceil(reach[axis, 0] / step), reach[axis, 1] / step) * step + 0.0:
                ends = reach.copy()
                ends[axis] = value
                self._line(out, ends, _GRID, pen.thin)
                x, y = self.pixels(ends)[:, 0]
                spot = (int(x) + 3, self.height - 5) if axis == 0 else (3, int(y) - 3)
                _text(out, f"{value:g}{' m' if value == 0 else ''}", spot, _WITHOUT_IDENTITY, pen)
        for edge in self.edges:
            self._line(out, edge, _EDGE, pen.line + 1)
        return out

    def _line(self, out: Image, points: F8, colour: Rgb, width: int) -> None:
        """A line through points (2, K); it is broken at those without a place."""
        known: Bool = np.isfinite(points[0] + points[1])
        for part in np.split(np.arange(points.shape[1]), np.flatnonzero(~known)):
            line = _fixed(self.pixels(points[:, part[known[part]]]))
            if len(line) > 1:
                cv2.polylines(out, [line], False, colour[::-1], width, cv2.LINE_AA, _FRACTION_BITS)

    def _shown(self, place: F8) -> list[tuple[int, tuple[int, int]]]:
        """The index and the whole pixel of those places (2, N) that are in the picture."""
        spots = enumerate(np.nan_to_num(self.pixels(place), nan=-1.0).T.tolist())
        return [(k, (int(x), int(y))) for k, (x, y) in spots if 0 <= x < self.width and 0 <= y < self.height]


def extent_of(places: F8) -> tuple[float, float, float, float]:
    """Left, low, right, high in metres of the ground to show, at least 8 m wide and high.

    It holds all ``places`` (2, N), NaN where not known, but the outermost hundredth on each side, which may be false alarms.
    """
    known = places[:, np.isfinite(places).all(axis=0)]
    low, high = np.quantile(known, [0.01, 0.99], axis=1) if known.size else np.zeros((2, 2))
    middle, half = (low + high) / 2, np.maximum((high - low) / 2 + _MARGIN, 4.0)
    (left, below), (right, above) = (middle - half).tolist(), (middle + half).tolist()
    return left, below, right, above


def plan_size(extent: tuple[float, float, float, float], height: int) -> tuple[int, int]:
    """Width and height in even pixels of a picture of the extent, ``height`` high, neither very narrow nor very wide."""
    left, low, right, high = extent
    width = height * float(np.clip((right - left) / (high - low), 0.6, 1.8))
    return 2 * round(width / 2), 2 * round(height / 2)


def draw_contours(image: Image, identity: I8, contours: Sequence[Sequence[F8]]) -> Image:
    """A copy of an annotated frame with the groups' contours.

    Parameters
    ----------
    image : (H, W, 3) BGR.
    identity : (G,) of each group, 0 for none.
    contours : for each group its rings (2, K), pixels.

    Returns
    -------
    (H, W, 3) BGR.
    """
    out = image.copy()
    for own, rings in zip(identity.tolist(), contours, strict=True):
        _contours(out, rings, own, Pen.of(image).line)
    return out


def _colour(identity: int) -> Rgb:
    return identity_colour(identity) if identity else _WITHOUT_IDENTITY


def _label(frame: GroupFrame, g: int) -> str:
    """Identity and number of people; nothing where the group probably does not exist."""
    identity, count, deviation = frame.identity[g], frame.groups.count[g], frame.groups.deviation[g]
    if not identity and count < 0.5:
        return ""
    return (f"{identity}: " if identity else "") + f"{count:.1f}" + (f" +-{deviation:.1f}" if deviation >= 0.05 else "")


def _contours(out: Image, contours: Sequence[F8], identity: int, width: int, *, filled: bool = False) -> None:
    """The outline in the group's colour, and its area. Rings within others are holes: the even-odd rule."""
    rings, colour = [_fixed(ring) for ring in contours], _colour(identity)[::-1]
    if rings and filled:
        over = out.copy()
        cv2.fillPoly(over, rings, colour, cv2.LINE_AA, _FRACTION_BITS)
        cv2.addWeighted(over, 0.3, out, 0.7, 0, dst=out)
    cv2.polylines(out, rings, True, colour, width, cv2.LINE_AA, _FRACTION_BITS)


def _fixed(points: F8) -> np.ndarray[tuple[int, ...], np.dtype[np.int32]]:
    """(K, 1, 2) points (2, K) in sixteenths of a pixel, as OpenCV takes them."""
    return np.ascontiguousarray((np.clip(points.T, -1e5, 1e5) * 2**_FRACTION_BITS).round().astype(np.int32))[:, None]


def _text(image: Image, text: str, spot: tuple[int, int], colour: Rgb, pen: Pen) -> None:
    cv2.putText(image, text, spot, cv2.FONT_HERSHEY_SIMPLEX, 0.8 * pen.font, colour[::-1], 1, cv2.LINE_AA)
