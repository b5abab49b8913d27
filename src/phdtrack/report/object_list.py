"""The objects of a run: when each was seen, how far and how fast it went, and how many there were
in each minute.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from phdtrack.files import csv_text
from phdtrack.report.drawing import feet
from phdtrack.types import F8, I8, SequenceInfo, Tracks

# Seconds over which a path is averaged before its length and speed are measured: boxes tremble.
_SMOOTHED = 0.5
# Seconds.
MINUTE = 60.0
HOUR = 3600.0
DAY = 24 * HOUR
BAR_UNITS = {
    1.0: "second",
    10.0: "10 seconds",
    MINUTE: "minute",
    HOUR: "hour",
    DAY: "day",
    30 * DAY: "30 days",
}
"""The names of what a bar of a chart may stand for, by its seconds."""
MAP_CELLS = 80
"""Cells of the map of where objects were, along the longer side of the frame."""


def bar_seconds(total: float) -> float:
    """Seconds of a bar in a chart over so many seconds: a key of `BAR_UNITS`, for 3 to 180 bars up
    to fifteen years.
    """
    return max((one for one in BAR_UNITS if total >= 3 * one), default=1.0)


class Seen(NamedTuple):
    """One object.

    Attributes
    ----------
    identity, name : its number, and its class; empty without classes.
    first, last : seconds of its first and its last box.
    boxes, predicted : rows, and those without a detection.
    distance : pixels that its foot point went.
    speed : median of its speed, pixels per second; NaN if it was seen too briefly.
    speed_in_heights : the same in heights of its own box per second, which mean about the same near
        the camera and far away.
    """

    identity: int
    name: str
    first: float
    last: float
    boxes: int
    predicted: int
    distance: float
    speed: float
    speed_in_heights: float

    @property
    def seconds(self) -> float:
        """Seconds from its first to its last box."""
        return self.last - self.first


class Minute(NamedTuple):
    """One minute.

    Attributes
    ----------
    start : seconds at which it begins.
    objects : objects that were there at some time in it.
    arrived : objects whose first box is in it.
    mean : mean number of objects in a frame.
    """

    start: float
    objects: int
    arrived: int
    mean: float


def objects(
    tracks: Tracks, numbers: I8, times: F8, names: Mapping[int, str] | None = None
) -> list[Seen]:
    """The objects of corrected tracks, by the time at which they came.

    Parameters
    ----------
    tracks : rows, boxes in pixels.
    numbers, times : (F,) frames, ascending, and their seconds.
    names : the names of the classes; None without classes.
    """
    found = []
    seconds = np.interp(tracks.frame, numbers, times) if len(numbers) else np.zeros(len(tracks))
    order = np.lexsort((tracks.frame, tracks.identity))
    begins = np.flatnonzero(np.diff(tracks.identity[order])) + 1
    for rows in np.split(order, begins) if len(order) else ():
        time = seconds[rows]
        boxes = tracks.xyxy[rows]
        step, path = _path(time, feet(boxes))
        speed = path / step if len(step) else np.full(1, np.nan)
        height = max(float(np.median(boxes[:, 3] - boxes[:, 1])), 1e-9)
        median = float(np.median(speed))
        name = ""
        if names is not None:
            number = int(tracks.class_id[rows[0]])
            name = names.get(number, str(number))
        found.append(
            Seen(
                int(tracks.identity[rows[0]]),
                name,
                float(time[0]),
                float(time[-1]),
                len(rows),
                int(tracks.predicted[rows].sum()),
                float(path.sum()),
                median,
                median / height,
            )
        )
    return sorted(found, key=lambda one: (one.first, one.identity))


def minutes(found: Sequence[Seen], times: F8, track_count: I8, width: float) -> list[Minute]:
    """How many objects there were in each stretch of ``width`` seconds that has a frame.

    Parameters
    ----------
    found : the objects.
    times : (F,) seconds of the frames, ascending.
    track_count : (F,) objects in each frame.
    width : seconds of a row.
    """
    if not len(times):
        return []
    # A recording with a row years away has millions of stretches without a frame. By rounding a
    # frame may lie in a stretch beside its own.
    near = np.unique(np.floor((times - times[0]) / width).astype(np.int64))
    stretch = np.unique(np.concatenate([near - 1, near, near + 1]))
    begin, end = (times[0] + number * width for number in (stretch, stretch + 1))
    frames, frames_end = (times.searchsorted(edge) for edge in (begin, end))
    some = frames_end > frames
    begin, end, frames, frames_end = (one[some] for one in (begin, end, frames, frames_end))
    first = np.sort([one.first for one in found])
    last = np.sort([one.last for one in found])
    total = np.concatenate([[0], np.cumsum(track_count)])
    mean = (total[frames_end] - total[frames]) / (frames_end - frames)
    come = first.searchsorted(end)
    columns = (begin, come - last.searchsorted(begin), come - first.searchsorted(begin), mean)
    return [Minute(*row) for row in zip(*(one.tolist() for one in columns), strict=True)]


def objects_csv(found: Sequence[Seen]) -> str:
    """The objects as CSV: seconds with three decimals, pixels with one.

    Parameters
    ----------
    found : the objects.
    """
    head = ("identity", "class", "first", "last", "seconds", "boxes", "predicted", "distance")
    rows = [
        (
            one.identity,
            one.name,
            *(f"{value:.3f}" for value in (one.first, one.last, one.seconds)),
            one.boxes,
            one.predicted,
            f"{one.distance:.1f}",
            _known(one.speed, 1),
            _known(one.speed_in_heights, 3),
        )
        for one in found
    ]
    return csv_text([(*head, "speed", "speed_in_heights"), *rows])


def minutes_csv(rows: Sequence[Minute]) -> str:
    """The minutes as CSV; ``start`` in seconds.

    Parameters
    ----------
    rows : the minutes.
    """
    lines = [(f"{row.start:.3f}", row.objects, row.arrived, _known(row.mean, 2)) for row in rows]
    return csv_text([Minute._fields, *lines])


def visited(tracks: Tracks, info: SequenceInfo, cells: int = MAP_CELLS) -> I8:
    """(h, w) number of boxes whose foot point is in each cell of the frame.

    Parameters
    ----------
    tracks : rows, boxes in pixels.
    info : size of the frame.
    cells : along its longer side.
    """
    step = max(info.width, info.height) / cells
    shape = max(1, math.ceil(info.height / step)), max(1, math.ceil(info.width / step))
    x, y = feet(tracks.xyxy).T
    extent = ((0, shape[0] * step), (0, shape[1] * step))
    counts, _, _ = np.histogram2d(y, x, shape, extent)
    return np.asarray(counts, np.int64)


def heatmap_csv(tracks: Tracks, info: SequenceInfo) -> str:
    """The map of where objects were as CSV: a row for each cell with a box, from the top; its sides
    in pixels, the boxes with their foot point in it, and their share of all boxes.

    Parameters
    ----------
    tracks : rows, boxes in pixels.
    info : size of the frame.
    """
    counts = visited(tracks, info)
    step = max(info.width, info.height) / MAP_CELLS
    rows = []
    for row, column in np.argwhere(counts).tolist():
        sides = (column * step, row * step, (column + 1) * step, (row + 1) * step)
        boxes = int(counts[row, column])
        rows.append((*(f"{side:.2f}" for side in sides), boxes, f"{boxes / len(tracks):.6f}"))
    return csv_text([("left", "top", "right", "bottom", "boxes", "share"), *rows])


def _known(value: float, decimals: int) -> str:
    """A number with so many decimals; empty if it is not known."""
    return f"{value:.{decimals}f}" if math.isfinite(value) else ""


def _path(time: F8, points: F8) -> tuple[F8, F8]:
    """Seconds and pixels of each step of a path (n, 2), averaged over `_SMOOTHED` seconds."""
    bins = np.floor((time - time[0]) / _SMOOTHED).astype(np.int64)
    _, row, count = np.unique(bins, return_inverse=True, return_counts=True)
    mean = np.stack(
        [np.bincount(row, column) / count for column in (time, points[:, 0], points[:, 1])], axis=1
    )
    step = np.diff(mean, axis=0)
    return step[:, 0], np.hypot(step[:, 1], step[:, 2])
