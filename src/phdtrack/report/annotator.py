"""Annotated frames.

A frame shows detections as thin white outlines, red and crossed if the filter rejects them as false
alarms (posterior clutter probability above one half) and no track lies over them; fading trails at
the feet of tracks; tracks in the colour of their identity with its number, dashed if no detection
supports the box; tracks not yet confirmed faintly and without a number; and a header with the
frame's number, the number of tracks, and the filter's expected count. A legend in the first second
says what the boxes mean.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from phdtrack.arrays import iou, pixelated
from phdtrack.errors import InputError
from phdtrack.report.drawing import BLACK, WHITE, Canvas, Rgb, feet, identity_colour
from phdtrack.types import F8, Bool, Detections, Image, SequenceInfo, Tracks

_UNKNOWN: F8 = np.zeros(0)
_FALSE_ALARM: Rgb = (200, 45, 45)
# Opacity of detections, tracks not yet confirmed, and the header.
_DETECTION_OPACITY = 0.75
_TENTATIVE_OPACITY = 0.4
_HEADER_OPACITY = 0.65
# IoU above which a track lies over a detection.
_TRACKED_IOU = 0.5
# Steps of opacity, and points, of a trail.
_FADING = 8
_POINTS = 19
_DEFAULT_FPS = 25.0
# The legend: its seconds, what it says, and the least height of a frame for it, in pixels.
_LEGEND_SECONDS = 1.0
_LEGEND = (
    ("coloured box: a track, with its number", identity_colour(1)),
    ("dashed: the track, not detected here", identity_colour(1)),
    ("thin white: a detection", WHITE),
    ("crossed out: a detection taken for a false alarm", _FALSE_ALARM),
)
_LEAST_HEIGHT = 240
_ROUNDING = 1e-6


class Annotator:
    """Draws frame after frame, and keeps the trails, which reach ``trail_seconds`` back.

    Labels include the class if there are ``names``. ``blur`` (`arrays.pixelated`) hides the content
    of all boxes first. With a ``legend``, the frames of the first second have one.

    Parameters
    ----------
    info : size of the frames in pixels, and their rate.
    """

    def __init__(
        self,
        info: SequenceInfo,
        *,
        trail_seconds: float = 1.5,
        names: Mapping[int, str] | None = None,
        blur: str = "",
        legend: bool = False,
    ) -> None:
        # Frames that have one.
        self._legend = 0
        self._fps = info.fps if info.fps > 0 else _DEFAULT_FPS
        # At least from one frame to the next.
        self._seconds = max(trail_seconds, 1.5 / self._fps)
        # Number and time of the frames that trails reach back to.
        self._times = deque[tuple[int, float]]()
        self._blur = blur
        if legend and info.height >= _LEAST_HEIGHT:
            self._legend = math.ceil(_LEGEND_SECONDS * self._fps)
        self._past = Tracks.empty()
        self._names = names
        self._canvas = Canvas(np.zeros((max(1, info.height), max(1, info.width), 3), np.uint8))

    def __call__(
        self,
        image: Image,
        number: int,
        tracks: Tracks,
        detections: Detections,
        *,
        mass: float = math.nan,
        clutter_probability: F8 = _UNKNOWN,
        time: float = math.nan,
    ) -> Image:
        """The frame with everything drawn on it, a new picture; planes are drawn on in place.

        Parameters
        ----------
        image : (H, W, 3) BGR uint8, or `Picture.planes` as (3H/2, W).
        number : of the frame, from 1.
        tracks : rows of any frames; those of frame ``number`` are drawn.
        detections : the boxes of this frame.
        mass : the filter's expected count; not in the header unless finite.
        clutter_probability : (N,) for the detections, or (0,) if unknown.
        time : of the frame in seconds; NaN: by its number and the rate of ``info``.

        Raises
        ------
        InputError : the picture is not (H, W, 3) uint8, or the probabilities do not match the
            detections.
        """
        where = f"frame {number}"
        planes = image.shape == (len(self._canvas.image) * 3 // 2, self._canvas.image.shape[1])
        if not (planes or image.shape[2:] == (3,)) or image.dtype != np.uint8:
            raise InputError(
                f"expected a BGR picture (H, W, 3) of uint8, got {image.shape} of {image.dtype}",
                where=where,
            )
        if len(clutter_probability) not in (0, len(detections)):
            raise InputError(
                f"expected a clutter probability for each of {len(detections)} detections, got"
                f" {len(clutter_probability)}",
                where=where,
            )
        rows = tracks.select(tracks.frame == number)
        if not planes:
            image = pixelated(image, np.vstack([rows.xyxy, detections.xyxy]), self._blur).copy()
            if image.shape != self._canvas.image.shape:
                self._canvas = Canvas(np.zeros_like(image))
        canvas = self._canvas
        false = _false_alarms(detections, rows.select(rows.confirmed), clutter_probability)
        boxes = detections.xyxy
        canvas.boxes(boxes[~false], WHITE, canvas.thin, _DETECTION_OPACITY)
        canvas.boxes(boxes[false], _FALSE_ALARM, canvas.thin, _DETECTION_OPACITY, crossed=True)
        # From the top of the frame downwards, because lower objects are usually nearer.
        rows = rows.select(np.argsort(rows.xyxy[:, 3], kind="stable"))
        confirmed = rows.select(rows.confirmed)
        self._trails(self._oldest(number, time), confirmed)
        for k in np.flatnonzero(~rows.confirmed):
            colour = identity_colour(int(rows.identity[k]))
            canvas.boxes(rows.xyxy[k : k + 1], colour, canvas.line, _TENTATIVE_OPACITY)
        colours = [identity_colour(identity) for identity in confirmed.identity.tolist()]
        canvas.targets(confirmed.xyxy, colours, confirmed.predicted, self._labels(confirmed))
        plural = "" if len(confirmed) == 1 else "s"
        header = f"frame {number}   {len(confirmed)} track{plural}"
        if math.isfinite(mass):
            header += f"   expected count {mass:.1f}"
        canvas.plate(header, (0, 0), BLACK, _HEADER_OPACITY, cached=False)
        if self._legend > 0:
            self._legend -= 1
            canvas.legend(_LEGEND, _HEADER_OPACITY)
        return canvas.onto(image)

    def _labels(self, rows: Tracks) -> list[str]:
        """The labels of rows: identities, after the names of classes if there are any."""
        labels = [str(identity) for identity in rows.identity.tolist()]
        if self._names is None:
            return labels
        words = [self._names.get(label, str(label)) for label in rows.class_id.tolist()]
        return [f"{word} {label}" for word, label in zip(words, labels, strict=True)]

    def _oldest(self, number: int, time: float) -> int:
        """The first frame to which the trails of a frame reach back."""
        if math.isnan(time):
            time = number / self._fps
        times = self._times
        times.append((number, time))
        # Rounding of times must not make trails longer in some frames.
        while len(times) > 1 and times[0][1] <= time - self._seconds + _ROUNDING:
            times.popleft()
        return times[0][0]

    def _trails(self, oldest: int, rows: Tracks) -> None:
        """Draw a line through the past and present feet of each identity since the frame
        ``oldest``, fading towards that.
        """
        past = Tracks.concatenate([self._past, rows])
        past = past.select(past.frame >= oldest)
        self._past = past
        order = np.argsort(past.identity, kind="stable")
        identities, starts = np.unique(past.identity[order], return_index=True)
        places = feet(past.xyxy[order])
        frames = past.frame[order]
        ends = [*starts[1:].tolist(), len(order)]
        # OpenCV draws many lines of one opacity at once in the time of a few.
        by_opacity = dict[float, list[NDArray[np.int32]]]()
        for identity, start, end in zip(identities.tolist(), starts.tolist(), ends, strict=False):
            # A subset of the points suffices; it is the same in each frame, plus the newest one.
            kept = frames[start:end] % max(1, len(self._times) // _POINTS) == 0
            kept[-1] = True
            trail = places[start:end][kept]
            trail = trail[np.isfinite(trail).all(axis=1)]
            points = np.clip(trail, -1e4, 1e4).round().astype(np.int32)
            pieces = min(_FADING, len(points) - 1)
            bounds = list[int]()
            if pieces > 0:
                bounds = [round(k * (len(points) - 1) / pieces) for k in range(pieces + 1)]
            lines = [points[first : last + 1] for first, last in pairwise(bounds)]
            self._canvas.line_colour(lines, identity_colour(identity), self._canvas.line)
            for k, line in enumerate(lines, start=1):
                by_opacity.setdefault((30 + 200 * k / pieces) / 255, []).append(line)
        for opacity, lines in by_opacity.items():
            self._canvas.line_opacity(lines, self._canvas.line, opacity)


def _false_alarms(detections: Detections, tracks: Tracks, clutter_probability: F8) -> Bool:
    """(N,) True for detections that are probably clutter and that no track lies over: a track may
    rest on later frames.
    """
    if not len(clutter_probability):
        return np.zeros(len(detections), np.bool_)
    with np.errstate(all="ignore"):
        overlap = iou(detections.xyxy, tracks.xyxy).max(axis=1, initial=0.0)
    return np.asarray(~(overlap > _TRACKED_IOU) & (clutter_probability > 0.5))
