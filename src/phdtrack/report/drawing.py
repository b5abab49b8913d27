"""Pictures that OpenCV draws: annotated frames, and the ground from above.

An annotated frame shows detections as thin white outlines, red and crossed where the filter takes
them for false alarms (posterior clutter probability above one half) and no track lies over them;
fading trails at the feet of tracks; tracks in the colour of their identity with its number, dashed
where no detection supports the box; tracks not yet confirmed faintly and without a number; and a
header: frame number, number of tracks, the filter's expected count.

The twelve colours of identities are light enough for dark pictures and strong enough for white
paper. Consecutive ones differ by at least 40 units of CIE L*a*b*, for normal sight and in the
simulation of protanopia and deuteranopia by Machado, Oliveira and Fernandes (2009). They repeat:
wherever an identity is drawn its number stands there too. Colours are RGB here, BGR in the picture.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from phdtrack.arrays import iou, pixelated
from phdtrack.errors import InputError
from phdtrack.kernels.planes import blend
from phdtrack.types import F8, I8, Bool, Detections, Image, SequenceInfo, Tracks

if TYPE_CHECKING:
    from phdtrack.groups.group_stages import GroupFrame

Rgb = tuple[int, int, int]
_HEX = "ff9f1c 1fb5ad ffe14d a78bfa 2ec27e 4d7cfe ff4d4d e8d5ff c98b5b 4cc9f0 b5e853 ff7ac6"
COLOURS: tuple[Rgb, ...] = tuple(
    (each[0], each[1], each[2]) for each in map(bytes.fromhex, _HEX.split())
)
_BLACK = (0, 0, 0)
_WHITE = (255, 255, 255)
_FALSE_ALARM = (200, 45, 45)
_UNKNOWN: F8 = np.zeros(0)
_GRID = (228, 231, 236)
_INK = (58, 66, 80)
_WITHOUT_IDENTITY = (140, 140, 140)
_PAPER: Rgb = (235, 235, 228)
_FIELD = (216, 228, 246)
_ROAD_EDGE = (150, 120, 80)
_WARNING = (208, 60, 60)
# Lines of the grid across a plan at most; plans are drawn in sixteenths of a pixel; strengths and
# points of a trail.
_MAX_LINES = 12
_FRACTION_BITS = 4
_FADING = 8
_POINTS = 19


def identity_colour(identity: int) -> Rgb:
    """Red, green, blue (0–255) of the target with this identity (from 1); grey for none (0)."""
    if identity:
        return COLOURS[(identity - 1) % len(COLOURS)]
    return _WITHOUT_IDENTITY


def feet(xyxy: F8) -> F8:
    """(n, 2) the middle of the lower edge of each box (n, 4)."""
    return np.stack([(xyxy[:, 0] + xyxy[:, 2]) / 2, xyxy[:, 3]], axis=1)


class _Canvas:
    """A copy of a picture to draw on, or a sheet, which `onto` puts into a picture by the opacity
    of each pixel. Widths, the length of a dash and letters suit the size: they are for 480 lines,
    and grow with it."""

    def __init__(self, image: Image) -> None:
        unit = min(image.shape[0], 0.75 * image.shape[1]) / 480
        sizes = ((1.6, 1), (0.7, 1), (1, 1), (8, 5))
        self.line, self.thin, self._bold, self._dash = (
            max(least, round(part * unit)) for part, least in sizes
        )
        # Text of very small frames can still be read.
        self._font = max(0.34, 0.39 * unit)
        self.image = image.copy()
        self._opacity: Image = np.zeros(image.shape[:2], np.uint8)
        # Left, top, right and bottom of the labels, none of which lies on another.
        self.taken: list[tuple[int, int, int, int]] = []

    def glaze_boxes(
        self, boxes: F8, colour: Rgb, width: int, opacity: float, *, crossed: bool = False
    ) -> None:
        """The outlines of boxes (n, 4), with their diagonals where they are ``crossed``."""
        for _, (left, top, right, bottom) in self._corners(boxes):
            cv2.rectangle(self.image, (left, top), (right, bottom), colour[::-1], width)
            cv2.rectangle(self._opacity, (left, top), (right, bottom), round(255 * opacity), width)
            if crossed:
                ends = np.array(
                    [[[left, top], [right, bottom]], [[left, bottom], [right, top]]], np.int32
                )
                self.coloured_lines(list(ends), colour, width)
                self.glaze_lines(list(ends), width, opacity)

    def coloured_lines(self, lines: Sequence[NDArray[np.int32]], colour: Rgb, width: int) -> None:
        """The colour of lines through points (n, 2), with the margin that their smoothed edges
        need.
        """
        cv2.polylines(self.image, lines, False, colour[::-1], width + 2)

    def glaze_lines(self, lines: Sequence[NDArray[np.int32]], width: int, opacity: float) -> None:
        """How much of their colour is seen."""
        cv2.polylines(self._opacity, lines, False, round(255 * opacity), width, cv2.LINE_AA)

    def onto(self, picture: Image) -> Image:
        """The picture, (H, W, 3) BGR or its planes (3H/2, W), with what is on this sheet, which is
        empty afterwards.
        """
        if picture.ndim == 2:
            flat = picture.reshape(-1)
            high, wide = self._opacity.shape
            light = flat[: high * wide].reshape(high, wide)
            rest = flat[high * wide :].reshape(2, high // 2, wide // 2)
            blend(light, rest[0], rest[1], self.image, self._opacity)
            return picture
        place = np.nonzero(self._opacity)
        alpha = self._opacity[place][:, None].astype(np.uint16)
        mixed = (picture[place] * (255 - alpha) + self.image[place] * alpha + 127) // 255
        picture[place] = mixed.astype(np.uint8)
        self._opacity[place] = 0
        return picture

    def targets(
        self, boxes: F8, colours: Sequence[Rgb], dashed: Bool, labels: Sequence[str]
    ) -> None:
        """The outlines of boxes (n, 4), and on top of all of them their labels."""
        shown = self._corners(boxes)
        for k, (left, top, right, bottom) in shown:
            if not dashed[k]:
                cv2.rectangle(self.image, (left, top), (right, bottom), colours[k][::-1], self.line)
                cv2.rectangle(self._opacity, (left, top), (right, bottom), 255, self.line)
                continue
            for a, b in pairwise(
                np.array([[left, top], [right, top], [right, bottom], [left, bottom], [left, top]])
            ):
                # An odd number of equal pieces, every other one drawn: the corners always are.
                pieces = max(3, 2 * round(float(np.abs(b - a).max()) / self._dash / 2) + 1)
                edges = np.linspace(a, b, pieces + 1).round().astype(int).tolist()
                for start, end in zip(edges[0::2], edges[1::2], strict=True):
                    cv2.line(self.image, start, end, colours[k][::-1], self.line)
                    cv2.line(self._opacity, start, end, 255, self.line)
        for k, box in shown:
            self.plate(labels[k], box[:2], colours[k])

    def plate(
        self,
        text: str,
        corner: Sequence[int],
        fill: Rgb,
        opacity: float = 1.0,
        *,
        once: bool = False,
    ) -> None:
        """Text on a coloured plate with this lower left corner, moved and shrunk to stay in the
        picture. What is drawn ``once`` is not kept for the next frames."""
        look = (text, fill, round(255 * opacity), self._font, self._bold, self.image.shape[1])
        plate, alpha = _plate(*look) if once else _kept_plate(*look)
        high, wide = alpha.shape
        tall, room = self.image.shape[:2]
        left = min(max(corner[0], 0), max(room - wide, 0))
        bottom = min(max(corner[1], high), max(tall, high))
        seen = slice(bottom - high, bottom), slice(left, left + wide)
        part = self.image[seen].shape[:2]
        self.image[seen] = plate[: part[0], : part[1]]
        self._opacity[seen] = alpha[: part[0], : part[1]]

    def text(self, text: str, spot: Sequence[int], colour: Rgb) -> None:
        """Small letters without a plate."""
        cv2.putText(
            self.image,
            text,
            spot,
            cv2.FONT_HERSHEY_SIMPLEX,
            0.8 * self._font,
            colour[::-1],
            1,
            cv2.LINE_AA,
        )

    def path(self, points: F8, colour: Rgb, width: int) -> None:
        """A line through points (2, K)."""
        cv2.polylines(
            self.image, [_fixed(points)], False, colour[::-1], width, cv2.LINE_AA, _FRACTION_BITS
        )

    def contours(self, contours: Sequence[F8]) -> None:
        """A group's outline, dark on light: colours are for people. Rings (2, K) within others are
        holes.
        """
        rings = [_fixed(ring) for ring in contours]
        for colour, width in ((_WHITE, self.line + 2), (_INK, self.line)):
            cv2.polylines(self.image, rings, True, colour[::-1], width, cv2.LINE_AA, _FRACTION_BITS)

    def label(self, text: str, corner: Sequence[int], fill: Rgb) -> None:
        """A plate like `plate`, moved up where it would lie on an earlier one."""
        (wide, high), below = cv2.getTextSize(
            text, cv2.FONT_HERSHEY_SIMPLEX, self._font, self._bold
        )
        pad = max(2, high // 4)
        wide = wide + 2 * pad
        high = high + 2 * pad + below // 2
        left = min(max(corner[0], 0), max(self.image.shape[1] - wide, 0))
        bottom = max(corner[1], high)
        beside = [each for each in self.taken if each[0] < left + wide and left < each[2]]
        for _ in beside:
            under = [top for _, top, _, low in beside if top < bottom and bottom - high < low]
            if not under or min(under) < high:
                break
            bottom = min(under) - 1
        self.taken.append((left, bottom - high, left + wide, bottom))
        self.plate(text, (left, bottom), fill)

    def _corners(self, boxes: F8) -> list[tuple[int, list[int]]]:
        """The index and the whole-pixel left, top, right, bottom of those boxes (n, 4) of which
        something can be drawn.

        Boxes reaching far out are cut one frame beyond the edges: OpenCV's coordinates overflow
        otherwise.
        """
        size = np.array(self.image.shape[1::-1], np.float64)
        low = np.minimum(boxes[:, :2], boxes[:, 2:])
        high = np.maximum(boxes[:, :2], boxes[:, 2:])
        seen = np.flatnonzero(
            np.isfinite(boxes).all(axis=1) & (high >= 0).all(axis=1) & (low <= size).all(axis=1)
        )
        cut = (
            np.hstack([np.clip(each[seen], -size, 2 * size) for each in (low, high)])
            .round()
            .astype(int)
        )
        return list(zip(seen.tolist(), cut.tolist(), strict=True))


def _plate(
    text: str, fill: Rgb, opacity: int, font: float, bold: int, room: int
) -> tuple[Image, Image]:
    """(h, w, 3) BGR of text on a coloured plate, and its opacity (h, w).

    Where it would be wider than the ``room`` its letters are smaller.
    """
    # OpenCV's fonts have no letters but ASCII.
    text = text.encode("ascii", "replace").decode("ascii")
    (wide, high), below = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, font, bold)
    pad = max(2, high // 4)
    if wide + 2 * pad > room:
        font *= max(0.1, (room - 2 * pad) / wide)
        (wide, high), below = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, font, bold)
    under = pad + (0 if text.isdigit() else below // 2)
    plate = np.full((high + pad + under, wide + 2 * pad, 3), fill[::-1], np.uint8)
    alpha = np.full(plate.shape[:2], opacity, np.uint8)
    # Black or white, whichever is easier to read by relative luminance.
    light = np.array([0.2126, 0.7152, 0.0722]) @ (np.array(fill) / 255) ** 2.2 > 0.2
    for sheet, colour in ((plate, _BLACK if light else _WHITE), (alpha, 255))[
        : 1 + (opacity < 255)
    ]:
        cv2.putText(
            sheet,
            text,
            (pad, len(alpha) - under),
            cv2.FONT_HERSHEY_SIMPLEX,
            font,
            colour,
            bold,
            cv2.LINE_AA,
        )
    return plate, alpha


_kept_plate = lru_cache(maxsize=500)(_plate)  # labels of tracks are drawn again in the next frame


class Annotator:
    """Draws frame after frame and remembers the trails, which reach ``trail_seconds`` back at the
    rate of ``info``.

    Labels say the class, too, where ``names`` are given. ``blur`` (`arrays.pixelated`) hides what
    is in all boxes first.
    """

    def __init__(
        self,
        info: SequenceInfo,
        *,
        trail_seconds: float = 1.5,
        names: Mapping[int, str] | None = None,
        blur: str = "",
    ) -> None:
        self._length = max(2, round(trail_seconds * (info.fps if info.fps > 0 else 25.0)))
        self._blur = blur
        self._past = Tracks.empty()
        self._names = names
        self._sheet = _Canvas(np.zeros((max(1, info.height), max(1, info.width), 3), np.uint8))

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
        """The frame with everything drawn on it, a new picture; into planes it is drawn in place.

        Raises `InputError` where the picture is not (H, W, 3) uint8, or the probabilities do not
        fit the detections.

        Parameters
        ----------
        image : (H, W, 3) BGR uint8, or `Picture.planes` as (3H/2, W).
        number : of the frame, from 1.
        tracks : rows of any frames; those of frame ``number`` are drawn.
        detections : the boxes of this frame.
        mass : the filter's expected count; left out of the header where not finite.
        clutter_probability : (N,) for the detections, or (0,) where unknown.
        """
        where = f"frame {number}"
        known = len(clutter_probability)
        count = len(detections)
        planes = image.shape == (len(self._sheet.image) * 3 // 2, self._sheet.image.shape[1])
        if not (planes or image.shape[2:] == (3,)) or image.dtype != np.uint8:
            raise InputError(
                f"expected a BGR picture (H, W, 3) of uint8, got {image.shape} of {image.dtype}",
                where=where,
            )
        if known not in (0, count):
            raise InputError(
                f"expected a clutter probability for each of {count} detections, got {known}",
                where=where,
            )
        rows = tracks.select(tracks.frame == number)
        if not planes:
            image = pixelated(image, np.vstack([rows.xyxy, detections.xyxy]), self._blur).copy()
            if image.shape != self._sheet.image.shape:
                self._sheet = _Canvas(np.zeros_like(image))
        canvas = self._sheet
        with np.errstate(
            all="ignore"
        ):  # where a track lies is no false alarm: it may rest on later frames
            tracked = iou(detections.xyxy, rows.xyxy[rows.confirmed]).max(axis=1, initial=0.0) > 0.5
        if known:
            false_alarm = ~tracked & (clutter_probability > 0.5)
        else:
            false_alarm = np.zeros(count, np.bool_)
        canvas.glaze_boxes(detections.xyxy[~false_alarm], _WHITE, canvas.thin, 0.75)
        canvas.glaze_boxes(
            detections.xyxy[false_alarm], _FALSE_ALARM, canvas.thin, 0.75, crossed=True
        )
        # From the top of the frame downwards, because what stands lower is usually nearer.
        rows = rows.select(np.argsort(rows.xyxy[:, 3], kind="stable"))
        self._trails(number, rows.select(rows.confirmed))
        for k in np.flatnonzero(~rows.confirmed):
            canvas.glaze_boxes(
                rows.xyxy[k : k + 1], identity_colour(int(rows.identity[k])), canvas.line, 0.4
            )
        rows = rows.select(rows.confirmed)
        identities = rows.identity.tolist()
        labels = [str(k) for k in rows.identity.tolist()]
        if self._names is not None:
            words = [self._names.get(one, str(one)) for one in rows.class_id.tolist()]
            labels = [f"{word} {label}" for word, label in zip(words, labels, strict=True)]
        canvas.targets(rows.xyxy, [identity_colour(k) for k in identities], rows.predicted, labels)
        if math.isfinite(mass):
            expected = f"   expected count {mass:.1f}"
        else:
            expected = ""
        header = f"frame {number}   {len(rows)} track{'s' * (len(rows) != 1)}{expected}"
        canvas.plate(header, (0, 0), _BLACK, opacity=0.65, once=True)
        return canvas.onto(image)

    def _trails(self, number: int, rows: Tracks) -> None:
        """A line through the earlier and present feet of each identity, which fades towards the
        oldest.
        """
        past = Tracks.concatenate([self._past, rows])
        self._past = past = past.select(past.frame > number - self._length)
        # By identity, and the lines by strength: OpenCV draws many at once in the time of a few.
        order = np.argsort(past.identity, kind="stable")
        identities, starts = np.unique(past.identity[order], return_index=True)
        there = feet(past.xyxy[order])
        frames = past.frame[order]
        by_strength = dict[float, list[NDArray[np.int32]]]()
        for identity, start, end in zip(
            identities.tolist(), starts, [*starts[1:], len(order)], strict=False
        ):
            mine = there[start:end]
            # So many points are enough; the same in each frame, and the last one.
            kept = frames[start:end] % max(1, self._length // _POINTS) == 0
            kept[-1] = True
            mine = mine[kept]
            points = (
                np.clip(mine[np.isfinite(mine).all(axis=1)], -1e4, 1e4).round().astype(np.int32)
            )
            pieces = min(_FADING, len(points) - 1)
            if pieces > 0:
                bounds = [round(k * (len(points) - 1) / pieces) for k in range(pieces + 1)]
            else:
                bounds = []
            lines = [points[first : last + 1] for first, last in pairwise(bounds)]
            self._sheet.coloured_lines(lines, identity_colour(identity), self._sheet.line)
            for k, line in enumerate(lines, start=1):
                by_strength.setdefault((30 + 200 * k / pieces) / 255, []).append(line)
        for strength, lines in by_strength.items():
            self._sheet.glaze_lines(lines, self._sheet.line, strength)


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


@dataclass(frozen=True, slots=False, eq=False)
class Plan:
    """The ground from above, white, x to the right and y upwards, with a grid in metres [E13 Fig.
    1].

    Parameters
    ----------
    extent : left, low, right, high in metres; where it is very narrow or wide more ground is shown.
    height : of the picture in pixels, even; both ways have the same scale.
    field : (2, K) outline of what the camera sees, metres; K = 0 for none.
    edges : lines (2, K) to be shown, such as the edges of roads, metres.
    """

    extent: tuple[float, float, float, float]
    height: int
    field: F8 = field(default_factory=lambda: np.zeros((2, 0)))
    edges: tuple[F8, ...] = ()

    @property
    def width(self) -> int:
        """Of the picture in pixels, even."""
        left, low, right, high = self.extent
        return 2 * round(self.height * float(np.clip((right - left) / (high - low), 0.6, 1.8)) / 2)

    @property
    def scale(self) -> float:
        """Pixels per metre."""
        left, low, right, high = self.extent
        return min(self.width / (right - left), self.height / (high - low))

    def pixels(self, place: F8) -> F8:
        """(2, N) pixels of places (2, N) on the ground."""
        offset = (
            place
            - np.array([[self.extent[0] + self.extent[2]], [self.extent[1] + self.extent[3]]]) / 2
        )
        out: F8 = (
            offset * np.array([[self.scale], [-self.scale]])
            + np.array([[self.width], [self.height]]) / 2
        )
        return out

    def draw(self, scene: PlanScene) -> Image:
        """A picture (height, width, 3) BGR of one frame: detections, people, groups with their
        counts, warnings.
        """
        canvas = _Canvas(self.ground)
        frame = scene.frame
        for rings in frame.contours:
            canvas.contours([self.pixels(ring) for ring in rings])
        for _, spot in self._shown(scene.detections):
            size = 2 * max(3, 2 * canvas.line + 1)
            cv2.drawMarker(
                canvas.image,
                spot,
                _INK[::-1],
                cv2.MARKER_TILTED_CROSS,
                size,
                canvas.thin,
                cv2.LINE_AA,
            )
        people = [
            (k, spot, identity_colour(int(scene.identity[k])))
            for k, spot in self._shown(scene.people)
        ]
        for _, spot, colour in people:
            for reach, filling in ((2 * canvas.line + 3, _WHITE), (2 * canvas.line + 2, colour)):
                cv2.circle(canvas.image, spot, reach, filling[::-1], -1, cv2.LINE_AA)
        for group in np.unique(frame.membership).tolist():
            inside = np.isin(scene.identity, frame.member[frame.membership == group])
            self._outline(canvas, scene.people[:, inside])
        centre = frame.groups.mean[:2]
        velocity = frame.groups.mean[2:]
        # The way of the next second.
        for way in np.stack([self.pixels(centre), self.pixels(centre + velocity)]).transpose(
            2, 0, 1
        ):
            if np.hypot(*(way[1] - way[0])) > 3:
                tail, tip = np.clip(way, -1e4, 1e4).round().astype(int).tolist()
                cv2.arrowedLine(
                    canvas.image, tail, tip, _INK[::-1], canvas.thin, cv2.LINE_AA, tipLength=0.25
                )
        place = dict(zip(frame.identity.tolist(), centre.T, strict=True))
        meetings = list[tuple[str, list[int]]]()
        for warning in frame.warnings:
            if warning.first in place and warning.second in place:
                between = self.pixels(
                    np.stack([place[warning.first], place[warning.second]], axis=1)
                )
                canvas.path(between, _WARNING, canvas.line)
                meetings.append(
                    (
                        f"meet in {warning.seconds:.1f} s",
                        np.clip(between.mean(axis=1), 0, 1e4).astype(int).tolist(),
                    )
                )
        for k, (x, y), colour in people:
            if scene.identity[k]:
                canvas.label(str(scene.identity[k]), (x + 8, y - 8), colour)
        for g, (x, y) in self._shown(centre):
            if label := _label(frame, g):
                canvas.label(label, (x + 8, y - 24), _PAPER)
        for words, corner in meetings:
            canvas.label(words, corner, _WARNING)
        detected = int(np.isfinite(scene.detections).all(axis=0).sum())
        header = (
            f"frame {frame.number}   {frame.time:.1f} s   {frame.people:.1f} people in"
            f" {frame.named} groups"
        )
        canvas.plate(
            header + (f"   {detected} detections" if detected else ""), (0, 0), _INK, once=True
        )
        return canvas.image

    def _outline(self, canvas: _Canvas, people: F8) -> None:
        """A line around the places (2, n) of a group's people, half a metre from them; none around
        one alone.
        """
        known = people[:, np.isfinite(people).all(axis=0)]
        if known.shape[1] < 2:
            return
        turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
        around = known[:, :, None] + 0.5 * np.stack([np.cos(turn), np.sin(turn)])[:, None]
        hull = cv2.convexHull(self.pixels(around.reshape(2, -1)).T.astype(np.float32))[:, 0].T
        canvas.contours([np.asarray(hull, np.float64)])

    @cached_property
    def ground(self) -> Image:
        """What is the same in all frames: field of view, grid and edges."""
        canvas = _Canvas(np.full((self.height, self.width, 3), 255, np.uint8))
        if self.field.shape[1] > 2:
            cv2.fillPoly(
                canvas.image,
                [_fixed(self.pixels(self.field))],
                _FIELD[::-1],
                cv2.LINE_AA,
                _FRACTION_BITS,
            )
        # The smallest of 1, 2, 5, 10, … times a power of ten with few enough lines.
        size = np.array([self.width, self.height]) / self.scale
        smallest = size.max() / _MAX_LINES
        steps = 10 ** np.floor(np.log10(smallest)) * np.array([1, 2, 5, 10])
        step = steps[steps >= smallest * (1 - 1e-9)].min()
        middle = (np.array(self.extent[:2]) + np.array(self.extent[2:])) / 2
        reach = np.stack([middle - size / 2, middle + size / 2], axis=1)
        for axis in (0, 1):
            # Adding 0 makes 0 of −0.
            for value in (
                np.arange(np.ceil(reach[axis, 0] / step), reach[axis, 1] / step) * step + 0.0
            ):
                ends = reach.copy()
                ends[axis] = value
                line = self.pixels(ends)
                canvas.path(line, _GRID, canvas.thin)
                if axis == 0:
                    spot = (int(line[0, 0]) + 3, self.height - 5)
                else:
                    spot = (3, int(line[1, 0]) - 3)
                canvas.text(f"{value:g}{' m' if value == 0 else ''}", spot, _WITHOUT_IDENTITY)
        for edge in self.edges:
            canvas.path(self.pixels(edge), _ROAD_EDGE, canvas.line + 1)
        return canvas.image

    def _shown(self, place: F8) -> list[tuple[int, tuple[int, int]]]:
        """The index and the whole pixel of those places (2, N) that are in the picture."""
        spots = enumerate(np.nan_to_num(self.pixels(place), nan=-1.0).T.tolist())
        return [
            (k, (int(x), int(y)))
            for k, (x, y) in spots
            if 0 <= x < self.width and 0 <= y < self.height
        ]


def draw_contours(image: Image, contours: Sequence[Sequence[F8]]) -> Image:
    """A copy of a picture (H, W, 3) BGR with the outlines of groups: of each its rings (2, K) in
    pixels.
    """
    canvas = _Canvas(image)
    for rings in contours:
        canvas.contours(rings)
    return canvas.image


def draw_plates(image: Image, plates: Sequence[tuple[str, Sequence[int]]]) -> Image:
    """A copy of a picture (H, W, 3) BGR with sentences on dark plates, none on another: of each its
    text and lower left corner in pixels."""
    canvas = _Canvas(image)
    for text, corner in plates:
        canvas.label(text, corner, _INK)
    return canvas.image


def _label(frame: GroupFrame, g: int) -> str:
    """The group and its number of people; nothing for one person alone, who has a label, or where
    there is probably none.
    """
    identity = frame.identity[g]
    count = frame.groups.count[g]
    deviation = frame.groups.deviation[g]
    if (identity and count < 1.5) or count < 0.5:
        return ""
    many = f"{count:.1f}" + (f" +-{deviation:.1f}" if deviation >= 0.05 else "")
    if identity:
        return f"group {identity}: {many}"
    return many


def _fixed(points: F8) -> np.ndarray[tuple[int, ...], np.dtype[np.int32]]:
    """(K, 1, 2) points (2, K) in sixteenths of a pixel, as OpenCV takes them."""
    return np.ascontiguousarray(
        (np.clip(points.T, -1e5, 1e5) * 2**_FRACTION_BITS).round().astype(np.int32)
    )[:, None]
