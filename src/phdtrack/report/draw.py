"""The annotated frame: who is where, where he came from, and what of it is seen and what is predicted.

What is drawn, from the back to the front:

* detections: thin white outlines; thin red ones with a cross where the filter takes them for false alarms (posterior
  clutter probability above one half);
* trails of the last seconds of each track, at the foot of its box, fading;
* tracks not yet confirmed: a faint outline, no label;
* tracks: an outline in the colour of the identity and its number; dashed where no detection supports the box in this frame;
* a header: frame number, number of tracks, the filter's expected count.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping

import numpy as np

from phdtrack.errors import InputError
from phdtrack.report import strokes
from phdtrack.report.palette import BLACK, WHITE, Rgb, identity_colour
from phdtrack.report.strokes import Pen
from phdtrack.types import F8, Detections, Image, SequenceInfo, Tracks

_FALSE_ALARM: Rgb = (200, 45, 45)
_UNJUDGED: F8 = np.zeros(0)


def annotate(
    image: Image,
    number: int,
    tracks: Tracks,
    detections: Detections,
    *,
    trails: Mapping[int, F8] | None = None,
    mass: float = math.nan,
    clutter_probability: F8 = _UNJUDGED,
) -> Image:
    """A new picture: ``image`` (H, W, 3) BGR uint8 of frame ``number`` (from 1) with everything drawn on it.

    Parameters
    ----------
    tracks : rows of any frames; those of frame ``number`` are drawn.
    detections : the boxes of this frame.
    trails : identity → (n, 2) earlier points, oldest first.
    mass : the filter's expected count; left out of the header where not finite.
    clutter_probability : (N,) for the detections, or (0,) where unknown.

    Raises `InputError` where the picture is not (H, W, 3) uint8 or the probabilities do not fit the detections.
    """
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise InputError(
            f"expected a BGR picture (H, W, 3) of uint8, got {image.shape} of {image.dtype}", where=f"frame {number}"
        )
    if len(clutter_probability) not in (0, len(detections)):
        problem = f"expected a clutter probability for each of {len(detections)} detections, got {len(clutter_probability)}"
        raise InputError(problem, where=f"frame {number}")
    out = image.copy()
    pen = Pen.for_frame(*image.shape[:2])
    rows = tracks.take(tracks.frame == number)
    _draw_detections(out, detections.xyxy, clutter_probability, pen)
    for identity, points in (trails or {}).items():
        strokes.fading_line(out, points, identity_colour(identity), max(1, pen.line))
    _draw_tracks(out, rows, pen)
    counted = int(rows.confirmed.sum())
    strokes.plate(out, _header(number, counted, mass), 0, 0, BLACK, pen, opacity=0.65)
    return out


def _header(number: int, count: int, mass: float) -> str:
    """Frame, tracks and expected count in ASCII, which is what OpenCV's fonts know."""
    text = f"frame {number}   {count} track{'' if count == 1 else 's'}"
    return f"{text}   expected count {mass:.1f}" if math.isfinite(mass) else text


def _draw_detections(out: Image, xyxy: F8, clutter_probability: F8, pen: Pen) -> None:
    """Thin outlines; crossed out where the filter takes the detection for a false alarm."""
    false_alarm = clutter_probability > 0.5 if len(clutter_probability) else np.zeros(len(xyxy), np.bool_)
    for box, false in zip(xyxy, false_alarm, strict=True):
        corners = strokes.corners(box, out)
        if corners is None:
            continue
        strokes.faint_rectangle(out, corners, _FALSE_ALARM if false else WHITE, pen.thin, 0.75, crossed=bool(false))


def _draw_tracks(out: Image, rows: Tracks, pen: Pen) -> None:
    """Outlines from the top of the frame downwards, because what stands lower is usually nearer; then all labels."""
    order = np.lexsort((rows.xyxy[:, 3], rows.confirmed))
    labels: list[tuple[strokes.Corners, int]] = []
    for i in order:
        corners, identity = strokes.corners(rows.xyxy[i], out), int(rows.identity[i])
        if corners is None:
            continue
        colour = identity_colour(identity)
        if not rows.confirmed[i]:
            strokes.faint_rectangle(out, corners, colour, pen.line, 0.4)
            continue
        if rows.predicted[i]:
            strokes.dashed_rectangle(out, corners, colour, pen.line, pen.dash)
        else:
            strokes.rectangle(out, corners, colour, pen.line)
        labels.append((corners, identity))
    for corners, identity in labels:
        strokes.plate(out, str(identity), corners[0], corners[1], identity_colour(identity), pen)


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
        clutter_probability: F8 = _UNJUDGED,
    ) -> Image:
        """`annotate` with trails. ``tracks`` may hold rows of other frames too, such as the whole corrected sequence."""
        rows = tracks.take(tracks.frame == number)
        self._extend(number, rows)
        trails = {i: np.array([point[1:] for point in trail]) for i, trail in self._trails.items()}
        return annotate(image, number, rows, detections, trails=trails, mass=mass, clutter_probability=clutter_probability)

    def reset(self) -> None:
        """Forget all trails: another sequence begins."""
        self._trails.clear()

    def _extend(self, number: int, rows: Tracks) -> None:
        """Add the feet of this frame's confirmed rows; drop points older than the trail and identities without points."""
        for identity, box in rows.take(rows.confirmed):
            trail = self._trails.setdefault(identity, deque(maxlen=self._length))
            trail.append((number, float(box[0] + box[2]) / 2, float(box[3])))
        for trail in self._trails.values():
            while trail and trail[0][0] <= number - self._length:
                trail.popleft()
        self._trails = {identity: trail for identity, trail in self._trails.items() if trail}
