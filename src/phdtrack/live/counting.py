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

import numpy as np

from phdtrack.arrays import pixelated
from phdtrack.clock import Clock
from phdtrack.files import whole, write_text
from phdtrack.formats.write import Lines
from phdtrack.live.events import Event, Tally, Watch, place_events, tallies
from phdtrack.live.flows import Flow, Passages, flows, flows_csv, passages, passages_csv, stays
from phdtrack.live.zones import Place, place_doubts
from phdtrack.opencv_package import cv2
from phdtrack.report import Annotator
from phdtrack.report.drawing import draw_plates
from phdtrack.report.object_list import HOUR, MINUTE, bar_seconds
from phdtrack.report.pages import render
from phdtrack.run import directory as rundir
from phdtrack.run.directory import RunDirectory
from phdtrack.run.loop import NO_PICTURE, TrackedFrame
from phdtrack.run.observers import Report, RunObserver
from phdtrack.run.reporter import SILENT, Reporter
from phdtrack.types import F8, Detections, Frame, Image, SequenceInfo, Tracks
from phdtrack.video import VideoSource, VideoWriter
from phdtrack.video.writing import FAST

HEAD = ("place", "class", "in", "out", "inside", "most", "mean", "seconds", "longest")
_HEADER = "time,frame,kind,place,direction,identity,class,seconds,occupancy,x,y"
_ROW = "%.3f,%d,%s,%s,%s,%d,%s,%s,%s,%.1f,%.1f"
# BGR of lines, zones, dots of objects that went in and out, and what is around and under them.
_LINE_COLOUR = (77, 225, 255)
_ZONE_COLOUR = (255, 160, 77)
_IN = (126, 194, 46)
_OUT = (28, 159, 255)
_DARK = (30, 30, 30)
_NO_BOXES: F8 = np.zeros((0, 4))


class CountObserver(RunObserver):
    """Counts the corrected tracks of a run.

    Parameters
    ----------
    watch : lines and zones.
    info : the sequence.
    video : pictures to draw on; None if there are none.
    blur : ``boxes`` or ``faces`` to pixelate them in pictures.
    first : the first frame.
    clock : the times of the frames; None: those of the frames that it takes in.
    """

    all_tracks = True

    def __init__(
        self,
        watch: Watch,
        info: SequenceInfo,
        video: VideoSource | None,
        blur: str,
        first: int = 1,
        clock: Clock | None = None,
    ) -> None:
        self._watch = watch
        self._info = info
        self._video = video
        self._blur = blur
        self._first = first
        self._last = info.frames
        self._clock = clock or Clock.constant(info.fps)
        self._timed = None if clock else list[tuple[int, float]]()
        self._tracks = Tracks.empty()
        self._events = list[Event]()
        self._tallies = list[Tally]()
        self._passages = list[Passages]()
        self._flows = list[Flow]()
        self._bar = 1.0
        self._picture = NO_PICTURE
        # Boxes of detections by frame, which are to be hidden whether or not a track uses them.
        self._hidden = dict[int, F8]()
        self.finished = False

    def take(self, tracked: TrackedFrame) -> None:
        """Remember how far it got, and when."""
        self._last = tracked.step.number
        if self._timed is not None:
            self._timed.append((self._last, tracked.step.time))
        self.hide(self._last, tracked.detected.detections.xyxy)

    def hide(self, number: int, xyxy: F8) -> None:
        """Hide boxes (n, 4) of a frame in pictures, besides those of tracks, if any are hidden."""
        if self._blur and self._video is not None and len(xyxy):
            self._hidden[number] = xyxy

    def finish(self, directory: RunDirectory, tracks: Tracks) -> None:
        """Count, and write the events and the picture."""
        self._tracks = tracks
        self.finished = True
        if self._timed:
            frames = [number for number, _ in self._timed]
            self._clock = Clock.of(frames, [time for _, time in self._timed], self._info.fps)
        self._events = place_events(self._watch, tracks, self._last, self._clock)
        begin = self._clock.time(self._first)
        end = self._clock.time(max(self._first, self._last))
        self._tallies = tallies(self._watch, self._events, begin, end)
        with Lines(directory.file(rundir.COUNTS)) as file:
            file.write(_HEADER)
            file.write(
                "%s", np.array([_ROW % self._cells(event) for event in self._events], np.str_)
            )
        self._write_sums(directory, begin, end)
        self._picture = self._still()
        if self._picture.size:
            with whole(directory.file(rundir.COUNTS_PICTURE)) as part:
                part.write_bytes(cv2.imencode(".png", self._picture)[1].tobytes())

    def _write_sums(self, directory: RunDirectory, begin: float, end: float) -> None:
        """Write what the events add up to, in each minute and hour, and from zone to zone."""
        for name, width in ((rundir.COUNTS_MINUTES, MINUTE), (rundir.COUNTS_HOURS, HOUR)):
            rows = passages(self._watch, self._events, begin, end, width)
            write_text(directory.file(name), passages_csv(rows))
        self._bar = bar_seconds(end - begin)
        self._passages = passages(self._watch, self._events, begin, end, self._bar)
        if sum(place.closed for place in self._watch.places) > 1:
            self._flows = flows(self._watch, self._events)
            write_text(directory.file(rundir.FLOWS), flows_csv(self._flows))

    def report(self) -> Report:
        """The figures."""
        zones = [place.name for place in self._watch.places if place.closed]
        section = render(
            "counts.html",
            head=HEAD,
            rows=self.rows(),
            image=self._picture,
            places=[place.name for place in self._watch.places],
            zones=zones,
            flows={(one.start, one.end): one for one in self._flows},
            passages=self._passages,
            stays={place.name: stays(place, self._events) for place in self._watch.places},
            bar=self._bar,
        )
        document: dict[str, object] = {
            "counts": [dict(zip(HEAD, one, strict=True)) for one in self._tallies]
        }
        if len(zones) > 1:
            document["flows"] = [one._asdict() for one in self._flows]
        return Report(document, (), section)

    def rows(self) -> list[list[str]]:
        """The figures as people read them, in the columns of `HEAD`."""
        return [[*one[:2], *(_number(value) for value in one[2:])] for one in self._tallies]

    def doubts(self) -> Iterator[str]:
        """Sentences about likely mistakes in the lines and zones."""
        names = self._watch.names
        labels = np.unique(self._tracks.class_id).tolist()
        known = {names.get(one, str(one)) for one in labels}
        size = (self._info.width, self._info.height)
        return place_doubts(self._watch.places, sorted(known), size, "the tracks have")

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
            VideoWriter(
                *(path, info.width, info.height, info.fps),
                coding=FAST,
                pixel_aspect=info.pixel_aspect,
            ) as video,
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
                image = pixelated(frame.image, self._boxes(number), self._blur)
                image = annotate(image, number, rows, Detections.empty(), time=frame.time)
                picture = drawn(image, self._watch.places, self._events[:done])
                video.write(picture, frame.time)
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

    def _boxes(self, number: int) -> F8:
        """(n, 4) the boxes of detections that are hidden in a frame."""
        return self._hidden.get(number, _NO_BOXES)

    def _middle(self, video: VideoSource) -> Frame:
        """The frame in the middle of what was counted, or the first one if it is missing."""
        clock = self._clock
        begin = clock.time(self._first)
        end = clock.time(max(self._first, self._last))
        for number in (clock.frame_at((begin + end) / 2), self._first):
            for frame in replace(video, first=number, last=number):
                return frame
        return next(iter(replace(video, first=1, last=0)))

    def _still(self) -> Image:
        """A picture from the middle of the video, or dark ground, with all places and figures."""
        width = self._info.width
        height = self._info.height
        image = NO_PICTURE
        near = self._tracks
        if self._video is not None:
            frame = self._middle(self._video)
            image = frame.image
            near = near.select(np.abs(near.frame - frame.number) <= 2)
            image = pixelated(image, self._boxes(frame.number), self._blur)
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
