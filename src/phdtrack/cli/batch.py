"""``phdtrack batch``: many videos, each a run of its own, shared out to processes, to the jobs of
an array, or by Ray.

``DIR/runs/NAME`` is the run of a video, as ``phdtrack track`` writes it, and
``DIR/tracks/NAME.parquet`` its corrected tracks: together they are one data set. In the folder of a
run, ``batch.json`` has a digest of what decided it, and when all is done what came of it; so the
same command again does what is missing. Of a long video that is cut into segments each has a run in
``DIR/segments/NAME``, and whoever finds all of them done joins them (`segments.join`).
"""

from __future__ import annotations

import glob
import json
import logging
import os
import re
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass, replace
from hashlib import sha256
from io import StringIO
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from phdtrack.cli.app import Misuse, application
from phdtrack.cli.options import SourceOptions, one_of, option, seconds
from phdtrack.cli.output import PACE, Output, counted, progress
from phdtrack.errors import InputError, needed
from phdtrack.files import load, read_json, whole
from phdtrack.parallel import Failed, on_ray, outcomes
from phdtrack.report import write_run
from phdtrack.run import directory as rundir
from phdtrack.run.detection_log import source_of
from phdtrack.run.inputs import TABLES, comes_again, open_inputs
from phdtrack.run.segments import Segment, cut, join
from phdtrack.video import open_source
from phdtrack.video.image_folder import SUFFIXES

# In a folder of a run what decided it, and in that of the batch what came of it.
DOCUMENT = "batch.json"
RUNS = "runs"
ROWS = "tracks"
SEGMENTS = "segments"
# Seconds in which another process that joins the same segments is done.
_PATIENCE = 60.0
VIDEOS = (
    ".avi",
    ".flv",
    ".m4v",
    ".mkv",
    ".mov",
    ".mp4",
    ".mpeg",
    ".mpg",
    ".mts",
    ".ts",
    ".webm",
    ".wmv",
)
_SOURCES = "Videos, folders and patterns of them, files of detections, @FILE for a list of these."
_ENGINE = "Processes of this machine, or a Ray cluster, which has the same files."
_SEGMENT = (
    "Cut longer videos into segments of about so long, as 10m or 90s, each a task; the tracks are"
    " joined."
)
_OVERLAP = "What two segments have in common: who is who is decided there."
_AGAIN = (
    "Run again what had other options, or files that have changed, and begin anew what was cut off."
)
# The columns of tracks.csv; where the place is not known x and y are null. `class` is null without
# classes.
_BOX = ("left", "top", "width", "height", "confidence", "x", "y")
_COLUMNS = ("frame", "identity", *_BOX, "z", "detection", "confirmed", "class")


@dataclass(frozen=True, slots=True)
class Cutting:
    """How long videos are cut: seconds of a segment, 0 for none, and of what two have in common."""

    segment: Annotated[float, option("TIME", _SEGMENT, parser=seconds)] = 0.0
    overlap: Annotated[float, option("TIME", _OVERLAP, parser=seconds)] = 20.0


@dataclass(frozen=True, slots=True)
class Video:
    """A video of a batch: the absolute path of it, or of its detections; the options of its run,
    which are understood in ``home``; the run's folder, the file with its rows, a digest of what
    decides them; ``anew``: not from a checkpoint. It is joined from its ``parts``, where there are
    any; each is a ``segment``, and has no file with rows."""

    name: str
    source: str
    options: tuple[str, ...]
    home: Path
    folder: Path
    rows: Path | None
    digest: str
    anew: bool = False
    parts: tuple[Video, ...] = ()
    segment: Segment | None = None

    @property
    def mark(self) -> dict[str, Any]:
        """What the folder says of itself: the ``digest`` of what decided it, and what came of it,
        where it is complete.
        """
        with suppress(OSError, ValueError, TypeError):
            return dict(json.loads((self.folder / DOCUMENT).read_bytes()))
        return {}

    @property
    def result(self) -> dict[str, Any] | None:
        """What came of it, if it is complete and was decided by the same."""
        mark = self.mark
        there = mark.get("digest") == self.digest and (self.rows is None or self.rows.exists())
        return mark.get("result") if there else None

    def joined(self) -> dict[str, Any]:
        """Join the segments. Raises `InputError` where that cannot be, or another process that does
        so does not end.
        """
        begun = time.monotonic()
        while (result := self.result) is None:
            try:
                directory = rundir.claim(self.folder, True)
            except InputError:
                if time.monotonic() > begun + _PATIENCE:
                    raise
                time.sleep(0.2)
                continue
            write_run(directory.file(DOCUMENT), {"digest": self.digest})
            about = join(
                [(part.segment, part.folder) for part in self.parts if part.segment], directory
            )
            self._complete(about)
        return result

    def _complete(self, about: dict[str, Any]) -> dict[str, object]:
        """Write the rows, and that it is complete."""
        if self.rows is not None:
            write_rows(self, about["source"]["fps"])
        result = {
            name: about[name] for name in ("frames", "tracks", "track_rows", "seconds", "warnings")
        }
        write_run(self.folder / DOCUMENT, {"digest": self.digest, "result": result})
        return result

    def __call__(self) -> dict[str, object]:
        """Run it, or what is left of it, and write its rows; or join its segments. Raises
        `InputError` with what the run said where it failed."""
        os.chdir(self.home)
        if self.parts:
            return self.joined()
        begun = self.mark.get("digest") == self.digest and not self.anew
        decided = {"digest": self.digest}
        # Locked up to the end. Files that were decided by something else go before it is said that
        # they were not.
        directory = rundir.claim(self.folder, True, resume=begun)
        if self.rows is not None:
            self.rows.unlink(missing_ok=True)
        write_run(directory.file(DOCUMENT), decided)
        if Path(self.source).suffix.lower() in TABLES:
            subject = ["--detections"]
        else:
            subject = []
        words = ["track", *subject, self.source, "--out", str(self.folder), *self.options]
        # run.json says how to do the same by hand.
        sys.argv = ["phdtrack", *words]
        said = StringIO()
        # What keeps a first run waiting is said at once.
        kernels = logging.getLogger("phdtrack.kernels")
        heard = logging.StreamHandler(sys.stderr)
        kernels.addHandler(heard)
        try:
            with redirect_stdout(said), redirect_stderr(said):
                status = application("track")(
                    [*words, "--resume"], prog_name="phdtrack", standalone_mode=False
                )
        finally:
            kernels.removeHandler(heard)
        if status:
            last = said.getvalue().strip().rpartition("\n")[2]
            raise InputError(last.removeprefix("phdtrack: ") or f"ended with status {status}")
        return self._complete(read_json(run := directory.file(rundir.RUN), load(run)))


def write_rows(video: Video, fps: float) -> None:
    """The tracks of a run as its file of the data set: ``video``, ``frame`` from 1, ``time`` in
    seconds since the first frame, and what tracks.csv has. The time is that of the frame's states;
    of a frame without any it lies in between."""
    arrow, csv, parquet = (needed(f"pyarrow{name}") for name in ("", ".csv", ".parquet"))
    known = {name: arrow.float64() for name in _BOX} | {
        "class": arrow.string(),
        "confirmed": arrow.int8(),
    }
    types = {name: known.get(name, arrow.int64()) for name in _COLUMNS}
    table = arrow.table({name: arrow.array([], kind) for name, kind in types.items()})
    file = video.folder / rundir.TRACKS
    if file.stat().st_size:
        with file.open("rb") as lines:
            width = lines.readline().count(b",") + 1
        reading = csv.ReadOptions(column_names=list(_COLUMNS[:width]))
        converting = csv.ConvertOptions(column_types=types)
        table = csv.read_csv(file, read_options=reading, convert_options=converting)
    only = csv.ConvertOptions(
        include_columns=["frame", "time"], column_types=types | {"time": arrow.float64()}
    )
    states = csv.read_csv(video.folder / rundir.STATES, convert_options=only)
    frames, index = np.unique(np.append(states["frame"].to_numpy(), 1), return_index=True)
    number = table["frame"].to_numpy()
    nowhere = table["z"].to_numpy() != 0
    time = np.interp(number, frames, np.append(states["time"].to_numpy(), 0.0)[index])
    columns = {
        "video": arrow.array([video.name] * len(number), arrow.string()),
        "frame": table["frame"],
    }
    columns["time"] = time + np.maximum(number - frames[-1], 0) / fps
    columns |= {name: table[name] for name in table.column_names}
    columns |= {name: arrow.array(table[name].to_numpy(), mask=nowhere) for name in ("x", "y")}
    columns.setdefault("class", arrow.nulls(len(number), arrow.string()))
    del columns["z"]
    assert video.rows is not None
    with whole(video.rows) as part:
        parquet.write_table(arrow.table(columns), part, compression="zstd")


def batch(
    context: typer.Context,
    sources: Annotated[list[str], typer.Argument(metavar="SOURCE...", help=_SOURCES)],
    output: Output,
    cutting: Cutting,
    out: Annotated[Path, option("DIR", "Where runs, tracks and the summary are kept.")],
    jobs: Annotated[
        int, option("N", "Videos at once; 0: one per core, or what a cluster has.", min=0)
    ] = 0,
    shard: Annotated[
        str, option("I/N", "Only the I-th of N shares of the videos, for job arrays; I from 1.")
    ] = "",
    engine: Annotated[
        str, option("local|ray", _ENGINE, callback=lambda value: one_of(value, "local", "ray"))
    ] = "local",
    address: Annotated[
        str, option("ADDRESS", "Of the Ray cluster: auto, HOST:PORT, ray://HOST:PORT, or local.")
    ] = "auto",
    overwrite: Annotated[bool, typer.Option("--overwrite", help=_AGAIN)] = False,
) -> None:
    """Track many videos: phdtrack batch SOURCE... --out DIR [-- OPTIONS of phdtrack track].

    What follows -- goes to the run of each video; {} in it stands for the video's name. The same
    command again does what is missing, also after Ctrl-C. A video that fails is named in the
    summary, the others go on, and the exit status is 1.

    DIR/runs/NAME is the run of a video, DIR/tracks the Parquet files with the tracks of all,
    DIR/batch.json the summary.
    """
    needed("pyarrow.parquet")
    share, shares = _share(shard)
    every = planned(sources, tuple(context.args), out, cutting, anew=overwrite)
    tasks = [task for video in every for task in video.parts or (video,)][share - 1 :: shares]
    own = {task.name for task in tasks}
    videos = [video for video in every if own & {task.name for task in video.parts or (video,)}]
    came = _done(videos, None if overwrite else out)
    before = sum(video.name in came for video in videos)
    joined = {part.name for video in videos if video.name in came for part in video.parts}
    cores = jobs or os.cpu_count() or 1
    clock = time.perf_counter()
    document = dict[str, object]()
    file = out / (f"batch-{share}-of-{shares}.json" if shard else DOCUMENT)

    def left() -> Iterator[list[Video]]:
        """Segments, then what they are joined to; others may have done the last ones."""
        yield [task for task in tasks if task.name not in came.keys() | joined]
        yield [
            one
            for one in videos
            if one.parts and one.name not in came and all(part.result for part in one.parts)
        ]

    try:
        for todo in filter(None, left()):
            if engine == "ray":
                work = on_ray(todo, jobs, address)
            else:
                work = outcomes(todo, cores, apart=True)
            names_of = [one.name for one in todo]
            _follow(
                output,
                len(came) + len(todo),
                came,
                ((names_of[number], result) for number, result in work),
            )
    finally:
        found = [_told(video, came) for video in videos]
        failed = [one["video"] for one in found if one["state"] == "failed"]
        complete = not failed and own <= came.keys() | joined
        document |= {"complete": complete, "reused": before, "failed": failed, "shard": shard}
        document |= {"seconds": time.perf_counter() - clock, "videos": found}
        write_run(file, document)
    now = sum(one["state"] == "done" for one in found) - before
    wait = len(videos) - now - before - len(failed)
    numbers = (
        f"{now} now, {before} before, {len(failed)}"
        f" failed{f', {wait} wait for segments of other shards' if wait else ''}"
    )
    output.say(
        f"{counted(len(videos), 'video')}: {numbers}.",
        f"  {out / ROWS}  tracks of all",
        f"  {file}  the summary",
    )
    output.document(document)
    if failed:
        raise typer.Exit(1)


def _done(videos: Sequence[Video], out: Path | None) -> dict[str, dict[str, Any]]:
    """What came of videos and segments in earlier calls, by name. Raises `InputError` where
    something else decided one that is in ``out``, unless that is None."""
    runs = [
        (run, mark)
        for video in videos
        for run in (video, *video.parts)
        if "result" in (mark := run.mark)
    ]
    others = [run.name for run, mark in runs if mark.get("digest") != run.digest]
    if others and out:
        problem = (
            f"{counted(len(others), 'run')} there ({others[0]}, …) had other options, or the files"
            " have changed"
        )
        raise InputError(
            problem,
            where=f"--out {out}",
            cure="Say --overwrite to run these again, or choose another --out.",
        )
    return {run.name: {"state": "done", **result} for run, _ in runs if (result := run.result)}


def _told(video: Video, came: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """What the summary says of a video. All have an error, if it is none, so that queries find
    it.
    """
    told = {
        "video": video.name,
        "source": video.source,
        "state": "missing",
        "error": None,
    } | came.get(video.name, {})
    if not video.parts:
        return told
    wrong = [
        f"{part.name}: {one['error']}"
        for part in video.parts
        if "error" in (one := came.get(part.name, {}))
    ]
    told |= {"state": "failed", "error": wrong[0]} if wrong else {}
    return told | {"segments": len(video.parts)}


def _follow(
    output: Output, total: int, came: dict[str, dict[str, Any]], work: Iterable[tuple[str, Any]]
) -> None:
    """Add to ``came`` what comes of each video, and say so: in a bar, or where there is none, in a
    line.
    """
    with progress("videos", total, PACE) as advance:
        advance(len(came))
        for name, result in work:
            wrong = isinstance(result, Failed)
            came[name] = (
                {"state": "failed", "error": result.reason}
                if wrong
                else {"state": "done", **result}
            )
            advance(len(came))
            if wrong:
                output.warn([f"{len(came)} of {total}: {name} failed: {result.reason}"])
            elif not sys.stderr.isatty():
                output.note(f"{len(came)} of {total}: {name}, {counted(result['frames'], 'frame')}")


def planned(
    sources: Sequence[str],
    options: tuple[str, ...],
    out: Path,
    cutting: Cutting,
    *,
    anew: bool = False,
) -> list[Video]:
    """The videos that are meant, with their names; those that are longer than a segment in parts.
    Raises `InputError` where there are no videos, or options are wrong."""
    known = _check(options)
    length = cutting.segment
    if length and known["frames"]:
        raise InputError(
            "a segment is a choice of frames already", where="--segment", cure="Leave out --frames."
        )
    if 0 < length < cutting.overlap:
        problem = f"segments of {length:g} s cannot have {cutting.overlap:g} s in common"
        raise InputError(
            problem, where="--segment", cure="Choose longer segments, or a shorter --overlap."
        )
    found = list(
        dict.fromkeys(os.path.abspath(source) for word in sources for source in expanded(word))
    )
    if not found:
        raise InputError("there is no video in the list", where="SOURCE")
    videos = []
    root = out.absolute()
    for name, source in zip(names(found), found, strict=True):
        words = [word.replace("{}", name) for word in options]
        # Of files among the options it matters what is in them.
        decided = [
            source_of(source),
            [source_of(word) if os.path.isfile(word) else word for word in words],
        ]
        places = root / RUNS / name, root / ROWS / f"{name}.parquet"
        video = Video(name, source, tuple(words), Path.cwd(), *places, _digest(decided), anew)
        if length:
            segments = _segments(video, known, cutting)
        else:
            segments = []
        if len(segments) > 1:
            parts = tuple(_part(video, one, root / SEGMENTS / name, decided) for one in segments)
            video = replace(video, parts=parts, digest=_digest([decided, segments]))
        videos.append(video)
    return videos


def _digest(decided: object) -> str:
    """What is another one where anything else decided it."""
    return sha256(json.dumps(decided).encode()).hexdigest()


def _part(video: Video, segment: Segment, folder: Path, decided: list[object]) -> Video:
    """The run of a segment."""
    frames = f"{segment.first}-{segment.last or ''}"
    part = replace(
        video, name=f"{video.name} {frames}", folder=folder / frames, rows=None, segment=segment
    )
    return replace(
        part, options=(*video.options, "--frames", frames), digest=_digest([decided, frames])
    )


def _segments(video: Video, known: dict[str, Any], cutting: Cutting) -> list[Segment]:
    """Where it is cut, by its rate and the number of frames that it announces."""
    try:
        if Path(video.source).suffix.lower() in TABLES:
            given = {name: known[name] for name in ("fps", "frame_size", "on_error")}
            source = open_inputs(SourceOptions(detections=Path(video.source), **given), {}).source
        else:
            source = open_source(video.source, fps=known["fps"])
    except (InputError, OSError):
        # It will say why when it is its turn.
        return []
    frames = source.info.frames or source.announced
    fps = source.info.fps
    return cut(frames, cutting.segment * fps, cutting.overlap * fps)


def expanded(word: str) -> Iterator[str]:
    """What a word stands for: the sources in a list, the videos in a folder or of a pattern, or the
    word itself; a folder or pattern of images is one source."""
    if word.startswith("@"):
        lines = map(str.strip, os.fsdecode(load(Path(word[1:]))).splitlines())
        yield from (
            source for line in lines if line and line[0] != "#" for source in expanded(line)
        )
        return
    if not comes_again(word):
        raise InputError(
            "a batch is of files, which have an end",
            where=word,
            cure="For cameras there is `phdtrack live`.",
        )
    path = Path(word)
    files = [word]

    def image(name: str | Path) -> bool:
        return Path(name).suffix.lower() in SUFFIXES

    if path.is_dir() and not any(map(image, path.iterdir())):
        files = [
            name
            for name in glob.glob(f"{glob.escape(word)}/**", recursive=True)
            if name.lower().endswith(VIDEOS)
        ]
    elif not path.exists() and set(word) & set("*?["):
        files = glob.glob(word, recursive=True)
        if files and all(map(image, files)):
            files = [word]
        else:
            files = files
    if files != [word]:
        # Not the annotated videos of runs.
        files = sorted(name for name in files if os.path.basename(name) not in rundir.RUN_FILES)
    if not files:
        raise InputError(
            "there is no video and no image", where=word, cure="Check the folder and the pattern."
        )
    yield from files


def names(sources: Sequence[str]) -> list[str]:
    """A name for each absolute path: its last part without the suffix, or as many parts as tell all
    of them apart.
    """
    parts = []
    for source in sources:
        path = Path(source)
        if set(path.name) & set("*?[") and not path.exists():
            path = path.parent
        else:
            path = path
        if path.name == "img1":
            path = path.parent
        else:
            path = path
        parts.append((path if path.is_dir() else path.with_suffix("")).parts[1:])
    for depth in range(1, max(map(len, parts)) + 1):
        # Tools that read a folder of Parquet files pass over names that begin so.
        found = [re.sub(r"^[._]+", "", "-".join(each[-depth:])) for each in parts]
        if all(found) and len(set(found)) == len(found):
            return found
    twice = max(found, key=found.count)
    raise InputError(
        f"two sources would both be called {twice}",
        where="SOURCE",
        cure="Rename one, or make two batches.",
    )


def _share(shard: str) -> tuple[int, int]:
    """Which share of how many."""
    match = re.fullmatch(r"([1-9]\d{0,8})/([1-9]\d{0,8})", shard or "1/1")
    if not match or int(match[1]) > int(match[2]):
        raise InputError(
            f"expected a share as 2/8, from 1 to the number of shares, got {shard!r}",
            where="--shard",
        )
    return int(match[1]), int(match[2])


def _check(options: tuple[str, ...]) -> dict[str, Any]:
    """What they say. `InputError` where `phdtrack track` would not understand them, or they name
    what differs by video.
    """
    command: Any = typer.main.get_command(application("track"))
    try:
        known = command.commands["track"].make_context("phdtrack track", list(options)).params
    except Misuse as error:
        raise InputError(
            error.format_message(), where="after --", cure="See phdtrack track --help."
        ) from None
    if wrong := known["source"] or known["out"]:
        raise InputError(
            f"expected options of phdtrack track for all videos, got {wrong}", where="after --"
        )
    return dict(known)
