"""The ground from above, frame by frame [E13 Fig. 1]: detections as crosses, people, contours of groups with their counts,
the camera's field of view and the edges of roads.

Drawn with OpenCV on white, x to the right and y upwards, with a grid in metres. What stays the same in all frames is drawn
once, when a `Plan` is made.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np

from phdtrack.report import strokes
from phdtrack.report.palette import Rgb, identity_colour
from phdtrack.report.strokes import Pen
from phdtrack.types import F8, I8, Bool, Image

_PAPER, _GRID, _INK = (255, 255, 255), (228, 231, 236), (58, 66, 80)
_FIELD, _EDGE, _WARNING = (216, 228, 246), (150, 120, 80), (208, 60, 60)
_UNNAMED: Rgb = (140, 140, 140)
# Lines of the grid across the picture at most; seconds of way that an arrow shows.
_MOST_LINES, _AHEAD = 12, 1.0
# Pictures are drawn in sixteenths of a pixel.
_FINE = 4


@dataclass(frozen=True, slots=True, eq=False)
class PlanGroup:
    """A group: identity (0: none yet), head count and its deviation, centre (2,), velocity (2,), contours (2, K) metres."""

    identity: int
    count: float
    deviation: float
    centre: F8
    velocity: F8
    contours: tuple[F8, ...]


@dataclass(frozen=True, slots=True, eq=False)
class PlanScene:
    """One frame: detections (2, N) and people (2, n) on the ground, metres, NaN where they have no place there; the
    people's ``identity`` (n,), 0 for none; groups; who is warned of: pairs of group identities and seconds until they
    meet."""

    number: int
    time: float
    detections: F8
    people: F8
    identity: I8
    groups: tuple[PlanGroup, ...]
    meetings: tuple[tuple[int, int, float], ...] = ()

    @property
    def heads(self) -> float:
        """Expected number of people in all groups."""
        return sum(group.count for group in self.groups)


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
        left, low, right, high = self.extent
        middle = np.array([[(left + right) / 2], [(low + high) / 2]])
        turned = (place - middle) * np.array([[self.scale], [-self.scale]])
        out: F8 = turned + np.array([[self.width / 2], [self.height / 2]])
        return out

    def draw(self, scene: PlanScene) -> Image:
        """A picture (height, width, 3) BGR of one frame."""
        out = self._ground.copy()
        pen = Pen.for_frame(self.height, self.width)
        for group in scene.groups:
            self._contours(out, group, pen)
        self._crosses(out, scene.detections, pen)
        self._people(out, scene, pen)
        for group in scene.groups:
            self._arrow(out, group, pen)
        self._meetings(out, scene, pen)
        for group in scene.groups:
            self._label(out, group, pen)
        strokes.plate(out, _header(scene), 0, 0, _INK, pen, opacity=0.85)
        return out

    @cached_property
    def _ground(self) -> Image:
        """Grid, field of view and edges."""
        out: Image = np.full((self.height, self.width, 3), 255, np.uint8)
        pen = Pen.for_frame(self.height, self.width)
        if self.field.shape[1] > 2:
            cv2.fillPoly(out, [_fixed(self.pixels(self.field))], _FIELD[::-1], cv2.LINE_AA, _FINE)
        self._grid(out, pen)
        for edge in self.edges:
            self._line(out, edge, _EDGE, pen.line + 1, closed=False)
        return out

    def _grid(self, out: Image, pen: Pen) -> None:
        step = _round_step(max(self.width, self.height) / self.scale / _MOST_LINES)
        corners = np.array([[0.0, self.width], [self.height, 0.0]])
        middle = np.array([[self.width / 2], [self.height / 2]])
        ground = (corners - middle) / np.array([[self.scale], [-self.scale]])
        ground = ground + np.array([[self.extent[0] + self.extent[2]], [self.extent[1] + self.extent[3]]]) / 2
        for axis in (0, 1):
            low, high = ground[axis]
            # Adding 0 makes 0 of −0.
            for value in np.arange(np.ceil(low / step), high / step) * step + 0.0:
                ends = np.array([[value, value], ground[1]]) if axis == 0 else np.array([ground[0], [value, value]])
                self._line(out, ends, _GRID, pen.thin, closed=False)
                x, y = self.pixels(ends)[:, 0]
                spot = (int(x) + 3, self.height - 5) if axis == 0 else (3, int(y) - 3)
                _text(out, f"{value:g}{' m' if value == 0 else ''}", spot, _UNNAMED, 0.8 * pen.font)

    def _contours(self, out: Image, group: PlanGroup, pen: Pen) -> None:
        """The area in the group's colour, its outline stronger."""
        if not group.contours:
            return
        colour, rings = _colour(group), [_fixed(self.pixels(ring)) for ring in group.contours]
        over = out.copy()
        # Rings that lie in others are holes: filled by the even-odd rule.
        cv2.fillPoly(over, rings, colour[::-1], cv2.LINE_AA, _FINE)
        cv2.addWeighted(over, 0.3, out, 0.7, 0, dst=out)
        cv2.polylines(out, rings, True, colour[::-1], pen.line + 1, cv2.LINE_AA, _FINE)

    def _crosses(self, out: Image, place: F8, pen: Pen) -> None:
        arm = max(3, 2 * pen.line + 1)
        for x, y in _shown(self.pixels(place), self.width, self.height):
            cv2.line(out, (x - arm, y - arm), (x + arm, y + arm), _INK[::-1], pen.thin, cv2.LINE_AA)
            cv2.line(out, (x - arm, y + arm), (x + arm, y - arm), _INK[::-1], pen.thin, cv2.LINE_AA)

    def _people(self, out: Image, scene: PlanScene, pen: Pen) -> None:
        place = self.pixels(scene.people)
        for k in range(place.shape[1]):
            for spot in _shown(place[:, k : k + 1], self.width, self.height):
                cv2.circle(out, spot, max(2, pen.line + 1), _INK[::-1], -1, cv2.LINE_AA)
                if scene.identity[k]:
                    _text(out, str(scene.identity[k]), (spot[0] + 4, spot[1] - 4), _INK, 0.8 * pen.font)

    def _arrow(self, out: Image, group: PlanGroup, pen: Pen) -> None:
        """The way of the next second."""
        ends = self.pixels(np.stack([group.centre, group.centre + _AHEAD * group.velocity], axis=1))
        if np.isfinite(ends).all() and np.hypot(*(ends[:, 1] - ends[:, 0])) > 3:
            (x0, y0), (x1, y1) = np.clip(ends.T, -1e4, 1e4).round().astype(int).tolist()
            cv2.arrowedLine(out, (x0, y0), (x1, y1), _INK[::-1], pen.thin, cv2.LINE_AA, tipLength=0.25)

    def _meetings(self, out: Image, scene: PlanScene, pen: Pen) -> None:
        centre = {group.identity: group.centre for group in scene.groups}
        for first, second, seconds in scene.meetings:
            if first in centre and second in centre:
                ends = np.stack([centre[first], centre[second]], axis=1)
                self._line(out, ends, _WARNING, pen.line, closed=False)
                x, y = np.clip(self.pixels(ends).mean(axis=1), 0, 1e4)
                strokes.plate(out, f"meet in {seconds:.1f} s", int(x), int(y), _WARNING, pen, opacity=0.9)

    def _label(self, out: Image, group: PlanGroup, pen: Pen) -> None:
        """Identity and head count beside the group; nothing beside one that is likelier not there."""
        if not group.identity and group.count < 0.5:
            return
        name = f"{group.identity}: " if group.identity else ""
        band = f" +-{group.deviation:.1f}" if group.deviation >= 0.05 else ""
        for x, y in _shown(self.pixels(group.centre[:, None]), self.width, self.height):
            gap = round(min(1.2 * self.scale, 40))
            strokes.plate(out, f"{name}{group.count:.1f}{band}", x + gap // 2, y - gap // 2, _colour(group), pen)

    def _line(self, out: Image, points: F8, colour: Rgb, width: int, *, closed: bool) -> None:
        """A line through points (2, K); those without a place part it."""
        known: Bool = np.isfinite(points[0]) & np.isfinite(points[1])
        for part in np.split(np.arange(points.shape[1]), np.flatnonzero(~known)):
            part = part[known[part]]
            if len(part) > 1:
                cv2.polylines(out, [_fixed(self.pixels(points[:, part]))], closed, colour[::-1], width, cv2.LINE_AA, _FINE)


def extent_of(places: F8, least: float = 8.0, margin: float = 1.5) -> tuple[float, float, float, float]:
    """Left, low, right, high in metres around the places (2, N): all but the outermost hundredth on each side (false alarms
    may lie anywhere), at least ``least`` wide and high."""
    known = places[:, np.isfinite(places).all(axis=0)]
    if known.shape[1] == 0:
        return -least / 2, -least / 2, least / 2, least / 2
    low, high = np.quantile(known, [0.01, 0.99], axis=1)
    middle, half = (low + high) / 2, np.maximum((high - low) / 2 + margin, least / 2)
    (left, below), (right, above) = (middle - half).tolist(), (middle + half).tolist()
    return left, below, right, above


def plan_size(extent: tuple[float, float, float, float], height: int) -> tuple[int, int]:
    """Width and height in even pixels of a picture of the extent, ``height`` high, neither very narrow nor very wide."""
    left, low, right, high = extent
    width = height * float(np.clip((right - left) / (high - low), 0.6, 1.8))
    return 2 * round(width / 2), 2 * round(height / 2)


def draw_contours(image: Image, groups: tuple[PlanGroup, ...]) -> Image:
    """A copy of an annotated frame with the groups' contours, given in its pixels."""
    out = image.copy()
    pen = Pen.for_frame(*image.shape[:2])
    for group in groups:
        rings = [_fixed(np.clip(ring, -1e4, 1e4)) for ring in group.contours]
        if rings:
            cv2.polylines(out, rings, True, _colour(group)[::-1], pen.line, cv2.LINE_AA, _FINE)
    return out


def _colour(group: PlanGroup) -> Rgb:
    return identity_colour(group.identity) if group.identity else _UNNAMED


def _header(scene: PlanScene) -> str:
    named = sum(group.identity > 0 for group in scene.groups)
    detected = int(np.isfinite(scene.detections).all(axis=0).sum())
    crosses = f"   {detected} detections" if detected else ""
    return f"frame {scene.number}   {scene.time:.1f} s   {scene.heads:.1f} people in {named} groups{crosses}"


def _round_step(least: float) -> float:
    """The smallest of 1, 2, 5, 10, 20, … (times a power of ten) that is not below ``least``."""
    power = 10.0 ** np.floor(np.log10(least))
    return float(next(power * step for step in (1, 2, 5, 10) if power * step >= least * (1 - 1e-9)))


def _fixed(points: F8) -> np.ndarray[tuple[int, ...], np.dtype[np.int32]]:
    """(K, 1, 2) points (2, K) in sixteenths of a pixel, as OpenCV takes them."""
    return np.ascontiguousarray((np.clip(points.T, -1e5, 1e5) * 2**_FINE).round().astype(np.int32))[:, None]


def _shown(pixel: F8, width: int, height: int) -> list[tuple[int, int]]:
    """Those of the pixels (2, N) that are in the picture, in whole numbers."""
    spots = np.nan_to_num(pixel, nan=-1.0).T.tolist()
    return [(int(x), int(y)) for x, y in spots if 0 <= x < width and 0 <= y < height]


def _text(image: Image, text: str, spot: tuple[int, int], colour: Rgb, font: float) -> None:
    cv2.putText(image, text, spot, cv2.FONT_HERSHEY_SIMPLEX, font, colour[::-1], 1, cv2.LINE_AA)
