"""``phdtrack count``: who crosses lines, and who is in zones, in a video that is tracked first, or
among known tracks.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from phdtrack.addresses import shown
from phdtrack.cli import options as given
from phdtrack.cli.options import option
from phdtrack.cli.output import Output, counted
from phdtrack.cli.track import prepare_with_window, run_and_print
from phdtrack.clock import Clock
from phdtrack.detect.convert import check_units
from phdtrack.detect.moving_regions import reported_kind
from phdtrack.errors import InputError
from phdtrack.files import read_toml, readable_name, write_text
from phdtrack.formats import Conventions, read_detections
from phdtrack.live.counting import HEAD, CountObserver
from phdtrack.live.events import Watch
from phdtrack.live.zones import Place, places_of, refuse_shares
from phdtrack.report.pages import render
from phdtrack.run import directory as rundir
from phdtrack.run.directory import RunDirectory, RunTracks
from phdtrack.run.inputs import TABLES, readable_again
from phdtrack.run.requests import (
    CHECKPOINT_EVERY,
    OutputRequest,
    RunRequest,
    SourceRequest,
    TrackingRequest,
    frame_size,
    refuse,
)
from phdtrack.types import SequenceInfo
from phdtrack.video import VideoSource, open_source

_FILES = {
    name: rundir.RUN_FILES[name]
    for name in (
        rundir.COUNTS,
        rundir.COUNTS_PICTURE,
        rundir.COUNTS_VIDEO,
        rundir.COUNTS_PAGE,
        rundir.COUNTS_MINUTES,
        rundir.COUNTS_HOURS,
        rundir.FLOWS,
    )
}
_LINE = (
    "A line from x1,y1 to x2,y2, in pixels: NAME=x1,y1,x2,y2. In is from its left to its right."
    " Repeatable."
)
_ZONE = "A zone with three or more corners, in pixels: NAME=x1,y1,x2,y2,x3,y3. Repeatable."


@dataclass(frozen=True, slots=True)
class CountOptions:
    """Lines and zones to count at, whether to draw the counts, and how the video is tracked."""

    line: Annotated[list[str] | None, option("NAME=PIXELS", _LINE)] = None
    zone: Annotated[list[str] | None, option("NAME=PIXELS", _ZONE)] = None
    places: Annotated[
        Path | None,
        option("FILE", "Lines and zones in a TOML file, which `phdtrack live` reads, too."),
    ] = None
    tracks: Annotated[
        Path | None, option("FILE", "Tracks of the video, in a file: it is not tracked again.")
    ] = None
    dwell: given.Dwell = 60.0
    leave_after: given.LeaveAfter = 3.0
    video: Annotated[
        bool, typer.Option("--video", help="Write counts.mp4: the video with running counts.")
    ] = False
    display: given.Display = False
    frames: given.Frames = ""
    camera_motion: given.CameraMotion = ""
    checkpoint_every: given.CheckpointEvery = CHECKPOINT_EVERY


def count(
    source: SourceRequest,
    options: TrackingRequest,
    asked: CountOptions,
    output: Output,
    to: OutputRequest,
    max_file_size: given.MaxFileSize = "",
) -> None:
    """Count who crosses lines and who is in zones, in and out, how many at once and for how long.

    A video is tracked first, with the options of `phdtrack track`, and the directory holds what
    that command writes, too. If SOURCE is a run, or a file of tracks, its tracks are counted as
    they are. counts.csv lists the events, and counts.png shows the lines, zones and counts. With
    --video, counts.mp4 shows them as they change, in place of annotated.mp4. If the camera moves,
    lines and zones stay where they are in the picture.
    """
    watch = Watch(_places(asked), dwell=asked.dwell, leave_after=asked.leave_after)
    path = Path(source.source)
    is_run = bool(source.source) and rundir.is_run(path)
    if asked.tracks is not None and is_run:
        cure = "Name the video in its place, or leave --tracks out."
        raise InputError(f"the run in {path} has tracks of its own", where="--tracks", cure=cure)
    if asked.tracks is not None:
        _refuse_tracking(source, options, asked, asked.tracks)
        _count_known(source, asked.tracks, watch, output, to, video=asked.video)
    elif is_run or path.suffix.lower() in TABLES:
        _refuse_tracking(replace(source, source=""), options, asked, path)
        _count_known(replace(source, source=""), path, watch, output, to, video=asked.video)
    else:
        request = RunRequest(
            source,
            options,
            to,
            video=False,
            video_size=0,
            camera_motion=asked.camera_motion,
            checkpoint_every=asked.checkpoint_every,
            frames=asked.frames,
        )
        _count_tracked(request, watch, output, asked)


def _count_tracked(request: RunRequest, watch: Watch, output: Output, asked: CountOptions) -> None:
    """Track a video, and count."""
    source = request.source.source
    if source and not readable_again(source):
        cure = "Use phdtrack live, which counts, too."
        raise InputError("a camera has no end", where=shown(source), cure=cure)
    prepared = prepare_with_window(request, display=asked.display)
    inputs = prepared.inputs
    video = None
    if inputs.pictures:
        video = replace(inputs.source)
    names: Mapping[int, str] = {}
    if inputs.names is not None and prepared.classes.apart:
        names = prepared.classes.names
    observer = CountObserver(
        replace(watch, names=names), inputs.info, video, request.output.blur, inputs.source.first
    )
    prepared = replace(prepared, observers=(*prepared.observers, observer))
    directory = run_and_print(output, prepared, request)
    if observer.finished:
        _print_counts(observer, output)
        if _write_video(observer, directory, output, wanted=asked.video):
            file = directory.file(rundir.COUNTS_VIDEO)
            output.say(f"  {file}  {_FILES[rundir.COUNTS_VIDEO]}")


def _count_known(
    source: SourceRequest,
    path: Path,
    watch: Watch,
    output: Output,
    to: OutputRequest,
    *,
    video: bool,
) -> None:
    """Count among the tracks of a run or of a file."""
    notices = list[str]()
    known = rundir.read_run_tracks(path, _reading(source), notices)
    address = source.source or known.source
    pictures = _pictures(address, source, known.info.fps)
    info = _sequence(known, pictures, source, path)
    if not rundir.is_run(path) and min(info.width, info.height) > 0:
        size = (info.width, info.height)
        words = {"units": source.reading.units, "box": source.reading.box}
        check_units(known.tracks.xyxy, known.tracks.confidence, size, path, **words)
    last = int(known.tracks.frame.max(initial=0))
    if 0 < known.info.frames < last:
        end = known.info.frames
        notices.append(f"{path}: rows up to frame {last}, and the sequence has {end} frames")
    if pictures is not None and pictures.note:
        notices.append(pictures.note)
    clock = _clock(path, known, info.fps, pictures, source, notices)
    output.warn(notices)
    directory = _counts_directory(path, source, to)
    observer = CountObserver(
        *(replace(watch, names=known.names), info, pictures, to.blur, known.first),
        clock=clock or Clock.constant(info.fps),
    )
    if to.blur and rundir.is_run(path):
        _hide_detections(observer, path / rundir.DETECTIONS)
    observer.finish(directory, known.tracks)
    report = observer.report()
    frames = info.frames - known.first + 1
    tracks = counted(len(np.unique(known.tracks.identity)), "track")
    lead = f"{tracks} in {counted(frames, 'frame')}"
    reports = reported_kind(known.detector)
    page = render(
        "counts_page.html",
        title="Counts",
        source=str(path),
        lead=f"{lead}. {reports}".strip(),
        section=report.section,
    )
    write_text(directory.file(rundir.COUNTS_PAGE), page)
    output.say(f"{lead}: {path}", *filter(None, [reports]), "")
    _print_counts(observer, output)
    _write_video(observer, directory, output, wanted=video)
    output.say("", *directory.listing())
    document = {
        "tracks": str(path),
        "source": shown(address),
        "frames": frames,
        "fps": info.fps,
        "directory": str(directory.path),
        "files": {file.name: str(file) for file in directory.written()},
    }
    output.document({**document, **report.document})


def _refuse_tracking(
    source: SourceRequest, options: TrackingRequest, asked: CountOptions, path: Path
) -> None:
    """Raise `InputError` for options of tracking: there is nothing to track."""
    used = asdict(replace(source, source="", fps=0.0, frame_size="", on_error=""))
    del used["reading"]
    used |= asdict(options)
    used |= {"frames": asked.frames, "camera_motion": asked.camera_motion}
    used |= {"display": asked.display}
    words = {"filter_name": "filter", "sets": "set"}
    problem = f"the tracks come from {path}: nothing is tracked"
    refuse(
        {f"--{words.get(name, name).replace('_', '-')}": value for name, value in used.items()},
        problem,
        str(path),
    )


def _reading(source: SourceRequest) -> Conventions:
    """How a file of tracks is to be read; boxes in shares get the size of the video."""
    size = frame_size(source.frame_size) if source.frame_size else (0, 0)
    if source.source and source.reading.units == "shares":
        info = open_source(source.source).info
        size = (info.width, info.height)
    return source.reading.conventions(size)


def _pictures(address: str, source: SourceRequest, fps: float) -> VideoSource | None:
    """The video that the tracks are of; None if there is none.

    Parameters
    ----------
    address, source : the video, and what was asked for.
    fps : frames per second of the tracks; 0 if unknown. Images have no other.
    """
    if not address or not readable_again(address):
        return None
    if not source.source and not Path(address).exists():
        return None
    video = open_source(address, fps=source.fps)
    if fps and not source.fps and video.times is None:
        return open_source(address, fps=fps)
    return video


def _hide_detections(observer: CountObserver, file: Path) -> None:
    """Hide the detections of a run in pictures, too, if they are there."""
    if file.exists() and file.stat().st_size:
        table = read_detections(file)
        for number in np.unique(table.frame).tolist():
            observer.hide(number, table.at(number).xyxy)


def _clock(
    path: Path,
    known: RunTracks,
    fps: float,
    video: VideoSource | None,
    source: SourceRequest,
    notices: list[str],
) -> Clock | None:
    """The times of the frames: those of the run, also for a file in its directory, or of the video;
    None for a constant rate.

    Parameters
    ----------
    path, known : the run or the file of tracks, and what is known of it.
    fps : frames per second where nothing tells the times.
    video, source : the video, and what was asked for.
    notices : receives a sentence if the times are not known.
    """
    of_video = None if video is None else video.clock()
    folder = path if path.is_dir() else path.parent
    of_run = rundir.is_run(path) or (folder / rundir.RUN).is_file()
    if source.fps or source.source or not of_run:
        return of_video
    if of_video is None and known.source and not (folder / rundir.STATES).exists():
        notices.append(
            f"{path}: the times of its frames are unknown, as {rundir.STATES} and the video"
            f" ({shown(known.source)}) are gone; {fps:g} frames/s assumed"
        )
    return rundir.run_clock(folder, fps, of_video)


def _sequence(
    known: RunTracks, video: VideoSource | None, source: SourceRequest, path: Path
) -> SequenceInfo:
    """Size, rate and number of frames. Raises `InputError` if the rate is not known."""
    info = known.info
    if video is not None:
        info = replace(video.info, frames=info.frames)
    elif source.frame_size:
        width, height = frame_size(source.frame_size)
        info = replace(info, width=width, height=height)
    fps = source.fps or info.fps
    if not fps > 0:
        cure = "Say --fps F, or name the video: phdtrack count VIDEO --tracks FILE."
        raise InputError("the rate of the frames is not known", where=path, cure=cure)
    last = int(known.tracks.frame.max(initial=0))
    return replace(info, fps=fps, frames=max(info.frames, last))


def _counts_directory(path: Path, source: SourceRequest, to: OutputRequest) -> RunDirectory:
    """The directory for the counts, in which everything else of a run stays as it is."""
    out = to.out or (path if path.is_dir() else Path("runs") / path.stem)
    held = [name for name in _FILES if (out / name).exists()]
    if held and not to.overwrite:
        cure = "Say --overwrite to replace them, or choose another --out."
        raise InputError(f"the directory holds {', '.join(held)}", where=f"--out {out}", cure=cure)
    directory = rundir.claim(out, True, _FILES, resume=True, inputs=(source.source, path))
    for file in directory.written():
        file.unlink()
    return directory


def _print_counts(observer: CountObserver, output: Output) -> None:
    """Print the figures in a table, and what looks like a mistake."""
    output.table(HEAD, observer.rows(), words=(0, 1))
    output.warn(observer.doubts())


def _write_video(
    observer: CountObserver, directory: RunDirectory, output: Output, *, wanted: bool
) -> bool:
    """Write the video with running counts, if it is wanted; whether there is one."""
    if wanted and not observer.pictures:
        sentence = "there are no pictures, and so no video: name it, as phdtrack count VIDEO"
        output.warn([f"{sentence} --tracks FILE"])
    if not wanted or not observer.pictures:
        return False
    observer.write_video(directory, output)
    return True


def _places(asked: CountOptions) -> tuple[Place, ...]:
    """The lines and zones of the options. Raises `InputError` if there are none, or one cannot be
    used.
    """
    tables = {}
    if asked.places is not None:
        tables = read_toml(asked.places)
    places = [
        *places_of(tables, str(asked.places)),
        *(_place("--line", text, closed=False) for text in asked.line or ()),
        *(_place("--zone", text, closed=True) for text in asked.zone or ()),
    ]
    names = Counter(place.name for place in places)
    if twice := [name for name, times in names.items() if times > 1]:
        cure = "Give each a name of its own."
        raise InputError(f"two places are called {twice[0]!r}", where="--line, --zone", cure=cure)
    if not places:
        cure = "Say --line NAME=x1,y1,x2,y2, --zone NAME=x1,y1,x2,y2,x3,y3,… or --places FILE."
        raise InputError("no line or zone given", where="phdtrack count", cure=cure)
    refuse_shares(places)
    return tuple(places)


def _place(where: str, text: str, *, closed: bool) -> Place:
    """A line or a zone from ``NAME=x1,y1,…``. Raises `InputError` for other text."""
    name, _, rest = text.rpartition("=")
    try:
        values = [float(word) for word in rest.split(",")]
    except ValueError:
        values = []
    if not name or not values or len(values) % 2:
        form = "NAME=x1,y1,x2,y2"
        if closed:
            form = "NAME=x1,y1,x2,y2,x3,y3,…"
        raise InputError(f"expected {form} in pixels, got {text!r}", where=where)
    return Place(readable_name(name), tuple(zip(values[::2], values[1::2], strict=True)), closed)
