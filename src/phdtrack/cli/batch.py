"""``phdtrack batch``: many videos, each a run of its own, shared out to processes, to the jobs of an array, or by Ray.

``DIR/runs/NAME`` is the run of a video, as ``phdtrack track`` writes it, and ``DIR/tracks/NAME.parquet`` its corrected
tracks: together they are one data set. In the folder of a run, ``batch.json`` has a digest of what decided it, and when all
is done what came of it; so the same command again does what is missing.
"""

from __future__ import annotations

import glob
import json
import os
import re
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from hashlib import sha256
from io import StringIO
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from phdtrack.cli import run_directory as rundir
from phdtrack.cli.app import Misuse, application
from phdtrack.cli.checkpoint import source_of
from phdtrack.cli.inputs import TABLES, comes_again
from phdtrack.cli.options import one_of, option
from phdtrack.cli.output import PACE, Output, counted, progress
from phdtrack.errors import InputError, needed
from phdtrack.files import load, read_json, whole
from phdtrack.parallel import Failed, on_ray, outcomes
from phdtrack.report import write_run
from phdtrack.video.files import SUFFIXES

# In a folder of a run what decided it, and in that of the batch what came of it.
DOCUMENT, RUNS, ROWS = "batch.json", "runs", "tracks"
VIDEOS = (".avi", ".flv", ".m4v", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".mts", ".ts", ".webm", ".wmv")
_SOURCES = "Videos, folders and patterns of them, files of detections, @FILE for a list of these."
_ENGINE = "Processes of this machine, or a Ray cluster, which has the same files."
_AGAIN = "Run again what had other options, or files that have changed, and begin anew what was cut off."
# The columns of tracks.csv; where the place is not known x and y are null. `class` is null without classes.
_BOX = ("left", "top", "width", "height", "confidence", "x", "y")
_COLUMNS = ("frame", "identity", *_BOX, "z", "detection", "confirmed", "class")


@dataclass(frozen=True, slots=True)
class Video:
    """A video of a batch: the absolute path of it, or of its detections; the options of its run, which are understood in
    ``home``; the run's folder, the file with its rows, a digest of what decides them; ``anew``: not from a checkpoint."""

    name: str
    source: str
    options: tuple[str, ...]
    home: Path
    folder: Path
    rows: Path
    digest: str
    anew: bool = False

    @property
    def mark(self) -> dict[str, Any]:
        """What the folder says of itself: the ``digest`` of what decided it, and what came of it, where it is complete."""
        with suppress(OSError, ValueError, TypeError):
            return dict(json.loads((self.folder / DOCUMENT).read_bytes()))
        return {}

    def __call__(self) -> dict[str, object]:
        """Run it, or what is left of it, and write its rows. Raises `InputError` with what the run said where it failed."""
        os.chdir(self.home)
        begun, decided = self.mark.get("digest") == self.digest and not self.anew, {"digest": self.digest}
        # Locked up to the end. Files that were decided by something else go before it is said that they were not.
        directory = rundir.claim(self.folder, True, resume=begun)
        self.rows.unlink(missing_ok=True)
        write_run(directory.file(DOCUMENT), decided)
        subject = ["--detections"] if Path(self.source).suffix.lower() in TABLES else []
        words = ["track", *subject, self.source, "--out", str(self.folder), *self.options]
        # run.json says how to do the same by hand.
        sys.argv, said = ["phdtrack", *words], StringIO()
        with redirect_stdout(said), redirect_stderr(said):
            status = application("track")([*words, "--resume"], prog_name="phdtrack", standalone_mode=False)
        if status:
            last = said.getvalue().strip().rpartition("\n")[2]
            raise InputError(last.removeprefix("phdtrack: ") or f"ended with status {status}")
        about = read_json(run := directory.file(rundir.RUN), load(run))
        write_rows(self, about["source"]["fps"])
        result = {name: about[name] for name in ("frames", "tracks", "track_rows", "seconds", "warnings")}
        write_run(directory.file(DOCUMENT), {**decided, "result": result})
        return result


def write_rows(video: Video, fps: float) -> None:
    """The tracks of a run as its file of the data set: ``video``, ``frame`` from 1, ``time`` in seconds since the first
    frame, and what tracks.csv has. The time is that of the frame's states; of a frame without any it lies in between."""
    arrow, csv, parquet = (needed(f"pyarrow{name}") for name in ("", ".csv", ".parquet"))
    known = {name: arrow.float64() for name in _BOX} | {"class": arrow.string(), "confirmed": arrow.int8()}
    types = {name: known.get(name, arrow.int64()) for name in _COLUMNS}
    table, file = arrow.table({name: arrow.array([], kind) for name, kind in types.items()}), video.folder / rundir.TRACKS
    if file.stat().st_size:
        with file.open("rb") as lines:
            width = lines.readline().count(b",") + 1
        reading, converting = csv.ReadOptions(column_names=list(_COLUMNS[:width])), csv.ConvertOptions(column_types=types)
        table = csv.read_csv(file, read_options=reading, convert_options=converting)
    only = csv.ConvertOptions(include_columns=["frame", "time"], column_types=types | {"time": arrow.float64()})
    states = csv.read_csv(video.folder / rundir.STATES, convert_options=only)
    frames, index = np.unique(np.append(states["frame"].to_numpy(), 1), return_index=True)
    number, nowhere = table["frame"].to_numpy(), table["z"].to_numpy() != 0
    time = np.interp(number, frames, np.append(states["time"].to_numpy(), 0.0)[index])
    columns = {"video": arrow.array([video.name] * len(number), arrow.string()), "frame": table["frame"]}
    columns["time"] = time + np.maximum(number - frames[-1], 0) / fps
    columns |= {name: table[name] for name in table.column_names}
    columns |= {name: arrow.array(table[name].to_numpy(), mask=nowhere) for name in ("x", "y")}
    columns.setdefault("class", arrow.nulls(len(number), arrow.string()))
    del columns["z"]
    with whole(video.rows) as part:
        parquet.write_table(arrow.table(columns), part, compression="zstd")


def batch(
    context: typer.Context,
    sources: Annotated[list[str], typer.Argument(metavar="SOURCE...", help=_SOURCES)],
    output: Output,
    out: Annotated[Path, option("DIR", "Where runs, tracks and the summary are kept.")],
    jobs: Annotated[int, option("N", "Videos at once; 0: one per core, or what a cluster has.", min=0)] = 0,
    shard: Annotated[str, option("I/N", "Only the I-th of N shares of the videos, for job arrays; I from 1.")] = "",
    engine: Annotated[str, option("local|ray", _ENGINE, callback=lambda value: one_of(value, "local", "ray"))] = "local",
    address: Annotated[str, option("ADDRESS", "Of the Ray cluster: auto, HOST:PORT, ray://HOST:PORT, or local.")] = "auto",
    overwrite: Annotated[bool, typer.Option("--overwrite", help=_AGAIN)] = False,
) -> None:
    """Track many videos: phdtrack batch SOURCE... --out DIR [-- OPTIONS of phdtrack track].

    What follows -- goes to the run of each video; {} in it stands for the video's name. The same command again does what
    is missing, also after Ctrl-C. A video that fails is named in the summary, the others go on, and the exit status is 1.

    DIR/runs/NAME is the run of a video, DIR/tracks the Parquet files with the tracks of all, DIR/batch.json the summary.
    """
    needed("pyarrow.parquet")
    share, shares = _share(shard)
    videos = planned(sources, tuple(context.args), out, anew=overwrite)[share - 1 :: shares]
    whole_runs = [(video, mark) for video in videos if "result" in (mark := video.mark)]
    others = [video.name for video, mark in whole_runs if mark.get("digest") != video.digest]
    if others and not overwrite:
        problem = f"{counted(len(others), 'run')} there ({others[0]}, …) had other options, or the files have changed"
        raise InputError(problem, where=f"--out {out}", cure="Say --overwrite to run these again, or choose another --out.")
    same = ((video, mark) for video, mark in whole_runs if mark.get("digest") == video.digest and video.rows.exists())
    came = {video.name: {"state": "done", **mark["result"]} for video, mark in same}
    todo, before = [video for video in videos if video.name not in came], len(came)
    cores, clock = jobs or os.cpu_count() or 1, time.perf_counter()
    work = on_ray(todo, jobs, address) if engine == "ray" and todo else outcomes(todo, cores, apart=True)
    document, file = dict[str, object](), out / (f"batch-{share}-of-{shares}.json" if shard else DOCUMENT)
    try:
        _follow(output, len(videos), came, ((todo[number].name, result) for number, result in work))
    finally:
        failed = [name for name, one in came.items() if one["state"] == "failed"]
        document |= {"complete": len(came) - len(failed) == len(videos), "reused": before, "failed": failed, "shard": shard}
        # All have an error, if it is none, so that queries find it.
        none = {"state": "missing", "error": None}
        found = [{"video": one.name, "source": one.source, **none, **came.get(one.name, {})} for one in videos]
        document |= {"seconds": time.perf_counter() - clock, "videos": found}
        write_run(file, document)
    numbers = f"{len(todo) - len(failed)} now, {before} before, {len(failed)} failed"
    output.say(f"{counted(len(videos), 'video')}: {numbers}.", f"  {out / ROWS}  tracks of all", f"  {file}  the summary")
    output.document(document)
    if failed:
        raise typer.Exit(1)


def _follow(output: Output, total: int, came: dict[str, dict[str, Any]], work: Iterable[tuple[str, Any]]) -> None:
    """Add to ``came`` what comes of each video, and say so: in a bar, or where there is none, in a line."""
    with progress("videos", total, PACE) as advance:
        advance(len(came))
        for name, result in work:
            wrong = isinstance(result, Failed)
            came[name] = {"state": "failed", "error": result.reason} if wrong else {"state": "done", **result}
            advance(len(came))
            if wrong:
                output.warn([f"{len(came)} of {total}: {name} failed: {result.reason}"])
            elif not sys.stderr.isatty():
                output.note(f"{len(came)} of {total}: {name}, {counted(result['frames'], 'frame')}")


def planned(sources: Sequence[str], options: tuple[str, ...], out: Path, *, anew: bool = False) -> list[Video]:
    """The videos that are meant, with their names. Raises `InputError` where there are none, or options are wrong."""
    _check(options)
    found = list(dict.fromkeys(os.path.abspath(source) for word in sources for source in expanded(word)))
    if not found:
        raise InputError("there is no video in the list", where="SOURCE")
    videos, root = [], out.absolute()
    for name, source in zip(names(found), found, strict=True):
        words = [word.replace("{}", name) for word in options]
        # Of files among the options it matters what is in them.
        decided = json.dumps([source_of(source), [source_of(word) if os.path.isfile(word) else word for word in words]])
        places, digest = (root / RUNS / name, root / ROWS / f"{name}.parquet"), sha256(decided.encode()).hexdigest()
        videos.append(Video(name, source, tuple(words), Path.cwd(), *places, digest, anew))
    return videos


def expanded(word: str) -> Iterator[str]:
    """What a word stands for: the sources in a list, the videos in a folder or of a pattern, or the word itself; a folder or
    pattern of images is one source."""
    if word.startswith("@"):
        lines = map(str.strip, os.fsdecode(load(Path(word[1:]))).splitlines())
        yield from (source for line in lines if line and line[0] != "#" for source in expanded(line))
        return
    if not comes_again(word):
        raise InputError("a batch is of files, which have an end", where=word, cure="For cameras there is `phdtrack live`.")
    path, files, image = Path(word), [word], lambda name: Path(name).suffix.lower() in SUFFIXES
    if path.is_dir() and not any(map(image, path.iterdir())):
        files = [name for name in glob.glob(f"{glob.escape(word)}/**", recursive=True) if name.lower().endswith(VIDEOS)]
    elif not path.exists() and set(word) & set("*?["):
        files = glob.glob(word, recursive=True)
        files = [word] if files and all(map(image, files)) else files
    if files != [word]:
        # Not the annotated videos of runs.
        files = sorted(name for name in files if os.path.basename(name) not in rundir.RUN_FILES)
    if not files:
        raise InputError("there is no video and no image", where=word, cure="Check the folder and the pattern.")
    yield from files


def names(sources: Sequence[str]) -> list[str]:
    """A name for each absolute path: its last part without the suffix, or as many parts as tell all of them apart."""
    parts = []
    for source in sources:
        path = Path(source)
        path = path.parent if set(path.name) & set("*?[") and not path.exists() else path
        path = path.parent if path.name == "img1" else path  # of MOTChallenge
        parts.append((path if path.is_dir() else path.with_suffix("")).parts[1:])
    for depth in range(1, max(map(len, parts)) + 1):
        # Tools that read a folder of Parquet files pass over names that begin so.
        found = [re.sub(r"^[._]+", "", "-".join(each[-depth:])) for each in parts]
        if all(found) and len(set(found)) == len(found):
            return found
    twice = max(found, key=found.count)
    raise InputError(f"two sources would both be called {twice}", where="SOURCE", cure="Rename one, or make two batches.")


def _share(shard: str) -> tuple[int, int]:
    """Which share of how many."""
    match = re.fullmatch(r"([1-9]\d{0,8})/([1-9]\d{0,8})", shard or "1/1")
    if not match or int(match[1]) > int(match[2]):
        raise InputError(f"expected a share as 2/8, from 1 to the number of shares, got {shard!r}", where="--shard")
    return int(match[1]), int(match[2])


def _check(options: tuple[str, ...]) -> None:
    """Raise `InputError` where `phdtrack track` would not understand them, or where they name what differs by video."""
    command: Any = typer.main.get_command(application("track"))
    try:
        known = command.commands["track"].make_context("phdtrack track", list(options)).params
    except Misuse as error:
        raise InputError(error.format_message(), where="after --", cure="See phdtrack track --help.") from None
    if wrong := known["source"] or known["out"]:
        raise InputError(f"expected options of phdtrack track for all videos, got {wrong}", where="after --")
