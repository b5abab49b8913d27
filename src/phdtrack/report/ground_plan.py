"""Plans: the ground from above, with people, groups and warnings."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from phdtrack.opencv_package import cv2
from phdtrack.report.drawing import (
    FRACTION_BITS,
    GREY,
    INK,
    WHITE,
    Canvas,
    Rgb,
    fixed_point,
    identity_colour,
)
from phdtrack.types import F8, I8, Image

if TYPE_CHECKING:
    from phdtrack.groups.group_stages import GroupFrame

_GRID: Rgb = (228, 231, 236)
_PAPER: Rgb = (235, 235, 228)
_FIELD: Rgb = (216, 228, 246)
_ROAD_EDGE: Rgb = (150, 120, 80)
_WARNING: Rgb = (208, 60, 60)
# Grid lines across a plan at most.
_MAX_LINES = 12
# Bounds of the width of a plan by its height.
_MIN_ASPECT = 0.6
_MAX_ASPECT = 1.8
# Distance in metres of a group's outline from its people.
_OUTLINE_DISTANCE = 0.5
# Arrows shorter than so many pixels are not drawn.
_MIN_ARROW = 3


@dataclass(frozen=True, slots=True, eq=False)
class PlanScene:
    """The contents of the ground in one frame.

    Attributes
    ----------
    frame : its groups, with their contours and the warnings.
    detections, people : (2, N), (2, n) metres, NaN without a place on the ground.
    identity : (n,) of the people, 0 for none.
    """

    frame: GroupFrame
    detections: F8
    people: F8
    identity: I8


@dataclass(frozen=True, slots=False, eq=False)
class Plan:
    """The ground from above, white, x to the right and y upwards, with a grid in metres [E13 Fig.
    1].

    Parameters
    ----------
    extent : left, low, right, high in metres; a very narrow or wide one is widened.
    height : of the picture in pixels, even; both axes have the same scale.
    field : (2, K) outline of the camera's field of view, metres; K = 0 for none.
    edges : lines (2, K) to draw, such as the edges of roads, metres.
    """

    extent: tuple[float, float, float, float]
    height: int
    field: F8 = field(default_factory=lambda: np.zeros((2, 0)))
    edges: tuple[F8, ...] = ()

    @property
    def width(self) -> int:
        """Width of the picture in pixels, even."""
        left, low, right, high = self.extent
        aspect = float(np.clip((right - left) / (high - low), _MIN_ASPECT, _MAX_ASPECT))
        return 2 * round(self.height * aspect / 2)

    @property
    def scale(self) -> float:
        """Pixels per metre."""
        left, low, right, high = self.extent
        return min(self.width / (right - left), self.height / (high - low))

    def pixels(self, place: F8) -> F8:
        """(2, N) pixels of places (2, N) on the ground."""
        left, low, right, high = self.extent
        offset = place - np.array([[left + right], [low + high]]) / 2
        centre = np.array([[self.width], [self.height]]) / 2
        out: F8 = offset * np.array([[self.scale], [-self.scale]]) + centre
        return out

    def draw(self, scene: PlanScene) -> Image:
        """A picture (height, width, 3) BGR of one frame: detections, people, groups with their
        counts, warnings.
        """
        canvas = Canvas(self.ground)
        frame = scene.frame
        for rings in frame.contours:
            canvas.contours([self.pixels(ring) for ring in rings])
        self._draw_detections(canvas, scene.detections)
        people = [
            (int(scene.identity[k]), place, identity_colour(int(scene.identity[k])))
            for k, place in self._visible(scene.people)
        ]
        for _, place, colour in people:
            for radius, fill in ((2 * canvas.line + 3, WHITE), (2 * canvas.line + 2, colour)):
                cv2.circle(canvas.image, place, radius, fill[::-1], -1, cv2.LINE_AA)
        for group in np.unique(frame.membership).tolist():
            members = np.isin(scene.identity, frame.member[frame.membership == group])
            self._outline(canvas, scene.people[:, members])
        self._draw_motion(canvas, frame)
        meetings = self._draw_warnings(canvas, frame)
        for identity, (x, y), colour in people:
            if identity:
                canvas.label(str(identity), (x + 8, y - 8), colour)
        for g, (x, y) in self._visible(frame.groups.mean[:2]):
            label = _label(frame, g)
            if label:
                canvas.label(label, (x + 8, y - 24), _PAPER)
        for label, corner in meetings:
            canvas.label(label, corner, _WARNING)
        header = (
            f"frame {frame.number}   {frame.time:.1f} s   {frame.people:.1f} people in"
            f" {frame.named} groups"
        )
        detected = int(np.isfinite(scene.detections).all(axis=0).sum())
        if detected:
            header += f"   {detected} detections"
        canvas.plate(header, (0, 0), INK, cached=False)
        return canvas.image

    def _draw_detections(self, canvas: Canvas, detections: F8) -> None:
        """Draw a cross at each detection."""
        size = 2 * max(3, 2 * canvas.line + 1)
        for _, place in self._visible(detections):
            cv2.drawMarker(
                canvas.image,
                place,
                INK[::-1],
                cv2.MARKER_TILTED_CROSS,
                size,
                canvas.thin,
                cv2.LINE_AA,
            )

    def _draw_motion(self, canvas: Canvas, frame: GroupFrame) -> None:
        """Draw an arrow along the path of the next second of each group."""
        centre = frame.groups.mean[:2]
        velocity = frame.groups.mean[2:]
        paths = np.stack([self.pixels(centre), self.pixels(centre + velocity)])
        for path in paths.transpose(2, 0, 1):
            if np.hypot(*(path[1] - path[0])) <= _MIN_ARROW:
                continue
            tail, tip = np.clip(path, -1e4, 1e4).round().astype(int).tolist()
            cv2.arrowedLine(
                canvas.image, tail, tip, INK[::-1], canvas.thin, cv2.LINE_AA, tipLength=0.25
            )

    def _draw_warnings(self, canvas: Canvas, frame: GroupFrame) -> list[tuple[str, list[int]]]:
        """Draw a line between groups that are about to meet. Return the labels with their
        places.
        """
        place = dict(zip(frame.identity.tolist(), frame.groups.mean[:2].T, strict=True))
        labels = list[tuple[str, list[int]]]()
        for warning in frame.warnings:
            if warning.first not in place or warning.second not in place:
                continue
            line = self.pixels(np.stack([place[warning.first], place[warning.second]], axis=1))
            canvas.path(line, _WARNING, canvas.line)
            corner = np.clip(line.mean(axis=1), 0, 1e4).astype(int).tolist()
            labels.append((f"meet in {warning.seconds:.1f} s", corner))
        return labels

    def _outline(self, canvas: Canvas, people: F8) -> None:
        """Draw a line around the places (2, n) of two or more people of a group."""
        known = people[:, np.isfinite(people).all(axis=0)]
        if known.shape[1] < 2:
            return
        angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
        circle = _OUTLINE_DISTANCE * np.stack([np.cos(angle), np.sin(angle)])
        around = known[:, :, None] + circle[:, None]
        hull = cv2.convexHull(self.pixels(around.reshape(2, -1)).T.astype(np.float32))[:, 0].T
        canvas.contours([np.asarray(hull, np.float64)])

    @cached_property
    def ground(self) -> Image:
        """The parts that are the same in all frames: field of view, grid and edges."""
        canvas = Canvas(np.full((self.height, self.width, 3), 255, np.uint8))
        if self.field.shape[1] > 2:
            outline = fixed_point(self.pixels(self.field))
            cv2.fillPoly(canvas.image, [outline], _FIELD[::-1], cv2.LINE_AA, FRACTION_BITS)
        # The smallest of 1, 2, 5, 10, … times a power of ten with few enough lines.
        size = np.array([self.width, self.height]) / self.scale
        smallest = size.max() / _MAX_LINES
        steps = 10 ** np.floor(np.log10(smallest)) * np.array([1, 2, 5, 10])
        step = steps[steps >= smallest * (1 - 1e-9)].min()
        centre = (np.array(self.extent[:2]) + np.array(self.extent[2:])) / 2
        bounds = np.stack([centre - size / 2, centre + size / 2], axis=1)
        for axis in (0, 1):
            values = np.arange(np.ceil(bounds[axis, 0] / step), bounds[axis, 1] / step) * step
            # Adding 0 turns −0 into 0.
            for value in values + 0.0:
                ends = bounds.copy()
                ends[axis] = value
                line = self.pixels(ends)
                canvas.path(line, _GRID, canvas.thin)
                corner = (int(line[0, 0]) + 3, self.height - 5)
                if axis == 1:
                    corner = (3, int(line[1, 0]) - 3)
                unit = " m" if value == 0 else ""
                canvas.text(f"{value:g}{unit}", corner, GREY)
        for edge in self.edges:
            canvas.path(self.pixels(edge), _ROAD_EDGE, canvas.line + 1)
        return canvas.image

    def _visible(self, place: F8) -> list[tuple[int, tuple[int, int]]]:
        """The index and whole pixel of those places (2, N) that are in the picture."""
        pixels = np.nan_to_num(self.pixels(place), nan=-1.0).T.tolist()
        return [
            (k, (int(x), int(y)))
            for k, (x, y) in enumerate(pixels)
            if 0 <= x < self.width and 0 <= y < self.height
        ]


def _label(frame: GroupFrame, g: int) -> str:
    """A group's name and number of people; empty for one person, who has a label, and if there is
    probably nobody.
    """
    identity = frame.identity[g]
    count = frame.groups.count[g]
    deviation = frame.groups.deviation[g]
    if (identity and count < 1.5) or count < 0.5:
        return ""
    size = f"{count:.1f}"
    if deviation >= 0.05:
        size += f" +-{deviation:.1f}"
    return f"group {identity}: {size}" if identity else size
