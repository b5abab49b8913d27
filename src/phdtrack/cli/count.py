"""``phdtrack count``: who crosses lines, and who is in zones, in a video that is tracked first, or
among known tracks.

Lines and zones are those of `phdtrack live`, and so is what counts as crossing.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import typer

from phdtrack.arrays import pixelated
from phdtrack.cli import options as given
from phdtrack.cli.options import RunOptions, SourceOptions, TrackingOptions, option
from phdtrack.cli.output import Output, counted, number, progress
from phdtrack.cli.show_settings import chosen, scene_settings
from phdtrack.cli.track import finish, prepare
from phdtrack.errors import InputError, shown
from phdtrack.files import read_toml, whole, write_text
from phdtrack.formats.write import Lines
from phdtrack.live.events import Event, Tally, Watch, place_events, tallies
from phdtrack.live.zones import Place, places_of
from phdtrack.pipeline import TrackingState
from phdtrack.report import Annotator
from phdtrack.report.drawing import draw_plates
from phdtrack.report.pages import render
from phdtrack.run import directory as rundir
from phdtrack.run.detection_log import EVERY
from phdtrack.run.directory import RunDirectory
from phdtrack.run.inputs import NO_PICTURE, TABLES, comes_again, frame_size, refuse
from phdtrack.run.observers import Report, RunObserver
from phdtrack.types import Detections, Image, SequenceInfo, Step, Tracks
from phdtrack.video import VideoSource, VideoWriter, open_source

_NAMES = rundir.COUNTS, rundir.COUNTS_PICTURE, rundir.COUNTS_VIDEO, rundir.COUNTS_PAGE
_FILES = {name: rundir.RUN_FILES[name] for name in _NAMES}
_HEAD = ("place", "class", "in", "out", "inside", "most", "mean", "seconds", "longest")
_HEADER = "time,frame,kind,place,direction,identity,class,seconds,occupancy,x,y"
_ROW = "%.3f,%d,%s,%s,%s,%d,%s,%s,%s,%.1f,%.1f"
_LINE = "A line: NAME=x1,y1,x2,y2 in pixels; in is from its left to its right. Repeatable."
_ZONE = "A zone: NAME=x1,y1,x2,y2,x3,y3,… around it. Repeatable."
# BGR of lines, zones, dots where somebody went in and out, and what is around and under them.
_LINE_COLOUR = (77, 225, 255)
_ZONE_COLOUR = (255, 160, 77)
_IN = (126, 194, 46)
_OUT = (28, 159, 255)
_DARK = (30, 30, 30)


@dataclass(frozen=True, slots=True)
class CountOptions:
    """What is counted, and what is drawn of it."""

    line: Annotated[list[str] | None, option("NAME=X,Y,...", _LINE)] = None
    zone: Annotated[list[str] | None, option("NAME=X,Y,...", _ZONE)] = None
    places: Annotated[
        Path | None, option("FILE", "Lines and zones in a file, as of `phdtrack live`.")
    ] = None
    tracks: Annotated[
        Path | None, option("FILE", "Tracks of the video in a file: it is not tracked again.")
    ] = None
    dwell: given.Dwell = 60.0
    leave_after: given.LeaveAfter = 3.0
    video: Annotated[
        bool, typer.Option("--video", help="Write the video with running counts, too.")
    ] = False


def count(
    source: SourceOptions,
    options: TrackingOptions,
    asked: CountOptions,
    output: Output,
    to: RunOptions,
) -> None:
    """Count who crosses lines and who is in zones, in and out, how many at once and for how long.

    A video is tracked first, and the directory is that of `phdtrack track`; of a run, or of tracks
    in a file, the tracks are taken as they are. counts.csv holds each event, counts.png the places
    and figures, counts.mp4 (--video) the same while it goes on.
    """
    watch = Watch(_places(asked), dwell=asked.dwell, leave_after=asked.leave_after)
    path = Path(source.source)
    if asked.tracks is not None and source.source and rundir.is_run(path):
        cure = "Name the video in its place, or leave --tracks out."
        raise InputError(f"the run in {path} has tracks of its own", where="--tracks", cure=cure)
    if (
        asked.tracks is None
        and source.source
        and (rundir.is_run(path) or path.suffix.lower() in TABLES)
    ):
        asked = replace(asked, tracks=path)
        source = replace(source, source="")
    if asked.tracks is not None:
        _count_known(source, options, asked, watch, output, to)
        return
    if source.source and not comes_again(source.source):
        raise InputError(
            "a camera has no end",
            where=shown(source.source),
            cure="Say phdtrack live, which counts, too.",
        )
    settings = chosen(options, scene_settings(to.scene), detector=source.observed_by)
    job = prepare(source, options, settings, to, video=False)
    if job.inputs.pictures:
        video = replace(job.inputs.source)
    else:
        video = None
    observer = CountObserver(
        replace(watch, names=job.names or {}),
        job.inputs.info,
        video,
        to.blur,
        job.inputs.source.first,
    )
    finish(output, replace(job, observers=(*job.observers, observer), every=EVERY), to)
    if observer.directory is not None:
        observer.tell(output)
        if observer.film(output, asked.video):
            output.say(
                f"  {observer.directory.file(rundir.COUNTS_VIDEO)}  {_FILES[rundir.COUNTS_VIDEO]}"
            )


def _count_known(
    source: SourceOptions,
    options: TrackingOptions,
    asked: CountOptions,
    watch: Watch,
    output: Output,
    to: RunOptions,
) -> None:
    """Count among tracks that are known."""
    path = asked.tracks or Path()
    used = asdict(
        replace(source, source="", fps=0.0, frame_size="", max_file_size="", on_error="")
    ) | asdict(options)
    words = {"filter_name": "filter", "sets": "set"}
    problem = f"the tracks come from {path}: nothing is tracked"
    refuse(
        {f"--{words.get(name, name).replace('_', '-')}": value for name, value in used.items()},
        problem,
        str(path),
    )
    found = rundir.given_tracks(path)
    address = source.source or found.source
    info = found.info
    there = (
        bool(address) and comes_again(address) and (bool(source.source) or Path(address).exists())
    )
    if there:
        video = open_source(address, fps=source.fps)
    else:
        video = None
    if video is not None:
        info = replace(video.info, frames=info.frames)
    elif source.frame_size:
        width, height = frame_size(source.frame_size)
        info = replace(info, width=width, height=height)
    fps = source.fps or info.fps
    if not fps > 0:
        cure = "Say --fps F, or name the video: phdtrack count VIDEO --tracks FILE."
        raise InputError("the rate of the frames is not known", where=path, cure=cure)
    info = replace(info, fps=fps, frames=max(info.frames, int(found.tracks.frame.max(initial=0))))
    at = to.out or (path if path.is_dir() else Path("runs") / path.stem)
    if not to.overwrite and (held := [name for name in _FILES if (at / name).exists()]):
        cure = "Say --overwrite to replace them, or choose another --out."
        raise InputError(f"the directory holds {', '.join(held)}", where=f"--out {at}", cure=cure)
    # The rest of a run that is there stays as it is.
    directory = rundir.claim(at, True, _FILES, resume=True, inputs=(source.source, path))
    for file in directory.written():
        file.unlink()
    observer = CountObserver(replace(watch, names=found.names), info, video, to.blur, found.first)
    observer.finish(directory, found.tracks)
    report = observer.report()
    frames = info.frames - found.first + 1
    lead = (
        f"{counted(len(np.unique(found.tracks.identity)), 'track')} in {counted(frames, 'frame')}"
    )
    page = render(
        "counts_page.html",
        title="Counts",
        source=str(path),
        lead=f"{lead}.",
        section=report.section,
    )
    write_text(directory.file(rundir.COUNTS_PAGE), page)
    output.say(f"{lead}: {path}", "")
    observer.tell(output)
    observer.film(output, asked.video)
    output.say("", *directory.listing())
    files = {file.name: str(file) for file in directory.written()}
    about = {
        "tracks": str(path),
        "source": shown(address),
        "frames": frames,
        "fps": fps,
        "directory": str(at),
    }
    output.document({**about, "files": files, **report.document})


class CountObserver(RunObserver):
    """Counts the corrected tracks of a run.

    Parameters
    ----------
    watch : lines and zones.
    info : the sequence.
    video : what is drawn on; None for no pictures.
    blur : what is made unrecognisable in pictures.
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
        self.directory: RunDirectory | None = None

    def take(self, found: Detections, step: Step, state: TrackingState) -> None:
        """Remember how far it got."""
        self._last = step.number

    def finish(self, directory: RunDirectory, tracks: Tracks) -> None:
        """Count, and write the events and the picture."""
        self._tracks = tracks
        self.directory = directory
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
        section = render("counts.html", head=_HEAD, rows=self._rows(), image=self._picture)
        return Report(
            {"counts": [dict(zip(_HEAD, one, strict=True)) for one in self._tallies]}, (), section
        )

    def tell(self, output: Output) -> None:
        """The figures in a table, and what looks like a mistake."""
        output.table(_HEAD, self._rows(), words=(0, 1))
        width = self._info.width
        height = self._info.height
        known = {
            self._watch.names.get(one, str(one))
            for one in np.unique(self._tracks.class_id).tolist()
        }
        for place in self._watch.places:
            low = np.min(place.points, axis=0)
            high = np.max(place.points, axis=0)
            if width and ((high < 0).any() or (low > [width, height]).any()):
                output.warn([f"{place.name} lies outside of the frame of {width}x{height} pixels"])
            if place.classes and not known & set(place.classes):
                classes = ", ".join(sorted(known)) or "none"
                output.warn(
                    [
                        f"{place.name} counts {', '.join(place.classes)}, and the tracks have the"
                        f" classes {classes}"
                    ]
                )

    def _rows(self) -> list[list[str]]:
        """The figures as people read them."""
        return [[*one[:2], *(number(value, 1) for value in one[2:])] for one in self._tallies]

    def film(self, output: Output, wanted: bool) -> bool:
        """Write the video with running counts, where it is wanted and there are pictures; whether
        it was.
        """
        if not wanted or self.directory is None:
            return False
        if self._video is None:
            output.warn(
                [
                    "there are no pictures, and so no video: name it, as phdtrack count VIDEO"
                    " --tracks FILE"
                ]
            )
            return False
        info = self._info
        done = 0
        names = self._watch.names or None
        annotate = Annotator(info, names=names, blur=self._blur)
        path = self.directory.file(rundir.COUNTS_VIDEO)
        with (
            VideoWriter(path, info.width, info.height, info.fps, fast=True) as video,
            progress("drawing", self._last) as go,
        ):
            for frame in replace(self._video, first=self._first):
                if frame.number > self._last:
                    break
                rows = self._tracks.select(
                    np.arange(
                        *np.searchsorted(self._tracks.frame, [frame.number, frame.number + 1])
                    )
                )
                while done < len(self._events) and self._events[done].number <= frame.number:
                    done += 1
                image = annotate(frame.image, frame.number, rows, Detections.empty())
                video.write(drawn(image, self._watch.places, self._events[:done]))
                go(frame.number)
        return True

    def _cells(self, event: Event) -> tuple[Any, ...]:
        """The columns of an event."""
        if math.isnan(event.seconds):
            stay = ""
        else:
            stay = f"{event.seconds:.2f}"
        inside = event.occupancy
        words = (
            event.place,
            event.direction,
            self._watch.names.get(event.class_id, str(event.class_id)),
        )
        place, direction, label = (re.sub(r'[,;"\s]', "_", word) for word in words)
        who = event.identity, label, stay, inside if inside >= 0 else ""
        return event.time, event.number, event.kind, place, direction, *who, event.x, event.y

    def _still(self) -> Image:
        """A picture from the middle of the video, or dark ground, with all places and figures."""
        width = self._info.width
        height = self._info.height
        image = NO_PICTURE
        near = self._tracks
        if self._video is not None:
            if self._first > 1:
                middle = None
            else:
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
    """A copy of a picture (H, W, 3) BGR with the places, and what the events so far count there."""
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
        if place.closed:
            colour = _ZONE_COLOUR
        else:
            colour = _LINE_COLOUR
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
                f" {counted(visits, 'visit')}"
            )
        else:
            text = f"{place.name}: {counts[place.name, 'in']} in, {counts[place.name, 'out']} out"
        plates.append((text, points.min(axis=0).tolist() if place.closed else points[0].tolist()))
    return draw_plates(out, plates)


def _places(asked: CountOptions) -> tuple[Place, ...]:
    """The lines and zones of the options. Raises `InputError` where there are none, or one cannot
    be used.
    """
    if asked.places is None:
        tables = {}
    else:
        tables = read_toml(asked.places)
    found = list(places_of(tables, str(asked.places)))
    for option_, texts, closed in (("--line", asked.line, False), ("--zone", asked.zone, True)):
        for text in texts or ():
            name, _, rest = text.rpartition("=")
            try:
                values = [float(word) for word in rest.split(",")]
            except ValueError:
                values = []
            if not name or not values or len(values) % 2:
                if closed:
                    form = "NAME=x1,y1,x2,y2,x3,y3,…"
                else:
                    form = "NAME=x1,y1,x2,y2"
                raise InputError(f"expected {form} in pixels, got {text!r}", where=option_)
            found.append(Place(name, tuple(zip(values[::2], values[1::2], strict=True)), closed))
    names = Counter(place.name for place in found)
    if twice := [name for name, times in names.items() if times > 1]:
        raise InputError(
            f"two places are called {twice[0]!r}",
            where="--line, --zone",
            cure="Give each a name of its own.",
        )
    if not found:
        cure = "Say --line NAME=x1,y1,x2,y2, --zone NAME=x1,y1,x2,y2,x3,y3,… or --places FILE."
        raise InputError("there is nothing to count at", where="phdtrack count", cure=cure)
    return tuple(found)
