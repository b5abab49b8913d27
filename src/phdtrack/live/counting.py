"""Counts at lines and in zones as an observer of a run.

Lines and zones are those of `phdtrack live`, and so is what counts as crossing.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from phdtrack.arrays import pixelated
from phdtrack.files import whole
from phdtrack.formats.write import Lines
from phdtrack.live.events import Event, Tally, Watch, place_events, tallies
from phdtrack.live.zones import Place
from phdtrack.report import Annotator
from phdtrack.report.drawing import draw_plates
from phdtrack.report.pages import render
from phdtrack.run import directory as rundir
from phdtrack.run.directory import RunDirectory
from phdtrack.run.loop import NO_PICTURE, TrackedFrame
from phdtrack.run.observers import Report, RunObserver
from phdtrack.run.reporter import SILENT, Reporter
from phdtrack.types import Detections, Image, SequenceInfo, Tracks
from phdtrack.video import VideoSource, VideoWriter

HEAD = ("place", "class", "in", "out", "inside", "most", "mean", "seconds", "longest")
_HEADER = "time,frame,kind,place,direction,identity,class,seconds,occupancy,x,y"
_ROW = "%.3f,%d,%s,%s,%s,%d,%s,%s,%s,%.1f,%.1f"
# BGR of lines, zones, dots of objects that went in and out, and what is around and under them.
_LINE_COLOUR = (77, 225, 255)
_ZONE_COLOUR = (255, 160, 77)
_IN = (126, 194, 46)
_OUT = (28, 159, 255)
_DARK = (30, 30, 30)


class CountObserver(RunObserver):
    """Counts the corrected tracks of a run.

    Parameters
    ----------
    watch : lines and zones.
    info : the sequence.
    video : pictures to draw on; None if there are none.
    blur : ``boxes`` or ``faces`` to pixelate them in pictures.
    first : the first frame.
    """

    all_tracks = True

    def __init__(
        self, watch: Watch, info: SequenceInfo, video: VideoSource | None, blur: str, first: int = 1
    ) -> None:
        self._watch = watch
        self._info = info
        self._video = video
        self._blur = blur
        self._first = first
        self._last = info.frames
        self._tracks = Tracks.empty()
        self._events = list[Event]()
        self._tallies = list[Tally]()
        self._picture = NO_PICTURE
        self.finished = False

    def take(self, tracked: TrackedFrame) -> None:
        """Remember how far it got."""
        self._last = tracked.step.number

    def finish(self, directory: RunDirectory, tracks: Tracks) -> None:
        """Count, and write the events and the picture."""
        self._tracks = tracks
        self.finished = True
        fps = self._info.fps
        self._events = place_events(self._watch, tracks, self._last, fps)
        self._tallies = tallies(
            self._watch, self._events, (self._first - 1) / fps, max(self._last - 1, 0) / fps
        )
        with Lines(directory.file(rundir.COUNTS)) as file:
            file.write(_HEADER)
            file.write(
                "%s", np.array([_ROW % self._cells(event) for event in self._events], np.str_)
            )
        self._picture = self._still()
        if self._picture.size:
            with whole(directory.file(rundir.COUNTS_PICTURE)) as part:
                part.write_bytes(cv2.imencode(".png", self._picture)[1].tobytes())

    def report(self) -> Report:
        """The figures."""
        section = render("counts.html", head=HEAD, rows=self.rows(), image=self._picture)
        counts = [dict(zip(HEAD, one, strict=True)) for one in self._tallies]
        return Report({"counts": counts}, (), section)

    def rows(self) -> list[list[str]]:
        """The figures as people read them, in the columns of `HEAD`."""
        return [[*one[:2], *(_number(value) for value in one[2:])] for one in self._tallies]

    def doubts(self) -> Iterator[str]:
        """Sentences about likely mistakes in the lines and zones."""
        width = self._info.width
        height = self._info.height
        names = self._watch.names
        labels = np.unique(self._tracks.class_id).tolist()
        known = {names.get(one, str(one)) for one in labels}
        for place in self._watch.places:
            low = np.min(place.points, axis=0)
            high = np.max(place.points, axis=0)
            if width and ((high < 0).any() or (low > [width, height]).any()):
                yield f"{place.name} lies outside of the frame of {width}x{height} pixels"
            if place.classes and not known & set(place.classes):
                classes = ", ".join(sorted(known)) or "none"
                yield (
                    f"{place.name} counts {', '.join(place.classes)}, and the tracks have the"
                    f" classes {classes}"
                )

    @property
    def pictures(self) -> bool:
        """True if there are pictures to draw on."""
        return self._video is not None

    def write_video(self, directory: RunDirectory, reporter: Reporter = SILENT) -> None:
        """Write the video with running counts. There must be `pictures`."""
        assert self._video is not None
        info = self._info
        done = 0
        annotate = Annotator(info, names=self._watch.names or None, blur=self._blur)
        path = directory.file(rundir.COUNTS_VIDEO)
        with (
            VideoWriter(path, info.width, info.height, info.fps, fast=True) as video,
            reporter.progress("drawing", self._last) as advance,
        ):
            for frame in replace(self._video, first=self._first):
                number = frame.number
                if number > self._last:
                    break
                begin, end = np.searchsorted(self._tracks.frame, [number, number + 1])
                rows = self._tracks.select(np.arange(begin, end))
                while done < len(self._events) and self._events[done].number <= number:
                    done += 1
                image = annotate(frame.image, number, rows, Detections.empty())
                video.write(drawn(image, self._watch.places, self._events[:done]))
                advance(number)

    def _cells(self, event: Event) -> tuple[Any, ...]:
        """The columns of an event."""
        stay = "" if math.isnan(event.seconds) else f"{event.seconds:.2f}"
        occupancy = event.occupancy if event.occupancy >= 0 else ""
        label = self._watch.names.get(event.class_id, str(event.class_id))
        return (
            event.time,
            event.number,
            event.kind,
            _word(event.place),
            _word(event.direction),
            event.identity,
            _word(label),
            stay,
            occupancy,
            event.x,
            event.y,
        )

    def _still(self) -> Image:
        """A picture from the middle of the video, or dark ground, with all places and figures."""
        width = self._info.width
        height = self._info.height
        image = NO_PICTURE
        near = self._tracks
        if self._video is not None:
            middle = None
            if self._first == 1:
                middle = next(iter(self._video.sample(1)), None)
            middle = middle or next(iter(replace(self._video, first=self._first)))
            image = middle.image
            at = round(middle.time * self._info.fps) + 1
            near = near.select(np.abs(near.frame - at) <= 2)
        elif width and height:
            image = np.full((height, width, 3), 46, np.uint8)
        if image.size:
            return drawn(pixelated(image, near.xyxy, self._blur), self._watch.places, self._events)
        return image


def drawn(image: Image, places: Sequence[Place], events: Sequence[Event]) -> Image:
    """A copy of a picture with places and their counts.

    Parameters
    ----------
    image : (H, W, 3) BGR.
    places : lines and zones.
    events : everything that counts so far.
    """
    unit = max(1.0, min(image.shape[0], 0.75 * image.shape[1]) / 480)
    wide = max(2, round(2 * unit))
    corners = [np.array(place.points).round().astype(np.int32) for place in places]
    sheet = image.copy()
    for place, points in zip(places, corners, strict=True):
        if place.closed:
            # One by one: together they would have holes where they overlap.
            cv2.fillPoly(sheet, [points], _ZONE_COLOUR)
    out = np.asarray(cv2.addWeighted(sheet, 0.25, image, 0.75, 0), np.uint8)
    counts = Counter((event.place, event.direction or event.kind) for event in events)
    for place, points in zip(places, corners, strict=True):
        colour = _ZONE_COLOUR if place.closed else _LINE_COLOUR
        for width, paint in ((wide + 2, _DARK), (wide, colour)):
            cv2.polylines(out, [points], place.closed, paint, width, cv2.LINE_AA)
            if not place.closed:
                a, b = np.array(place.edges[len(place.edges) // 2])
                middle = (a + b) / 2
                right = np.array([a[1] - b[1], b[0] - a[0]]) / max(np.hypot(*(b - a)), 1e-9)
                start, end = (
                    p.round().astype(int).tolist() for p in (middle, middle + 26 * unit * right)
                )
                cv2.arrowedLine(out, start, end, paint, width, cv2.LINE_AA, tipLength=0.4)
    for event in events:
        if event.kind == "cross":
            spot = round(event.x), round(event.y)
            cv2.circle(out, spot, wide + 2, _DARK, -1, cv2.LINE_AA)
            cv2.circle(
                out, spot, wide + 1, _IN if event.direction == "in" else _OUT, -1, cv2.LINE_AA
            )
    plates = list[tuple[str, list[int]]]()
    for place, points in zip(places, corners, strict=True):
        if place.closed:
            visits = counts[place.name, "enter"]
            text = (
                f"{place.name}: {visits - counts[place.name, 'exit']} inside,"
                f" {visits} visit{'' if visits == 1 else 's'}"
            )
        else:
            text = f"{place.name}: {counts[place.name, 'in']} in, {counts[place.name, 'out']} out"
        plates.append((text, points.min(axis=0).tolist() if place.closed else points[0].tolist()))
    return draw_plates(out, plates)


def _number(value: float | None) -> str:
    """A number as people read it: whole ones without decimals, a dash for none."""
    if value is None or not math.isfinite(value):
        return "–"
    if isinstance(value, int):
        return str(value)
    return f"{value:.1f}"


def _word(text: str) -> str:
    """The text as one word of a CSV file."""
    return re.sub(r'[,;"\s]', "_", text)
