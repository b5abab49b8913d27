"""The directory of a run: which files it holds, and that no earlier run is replaced unasked.

Only the files that a run writes are touched; other files in the directory stay.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple
from weakref import WeakValueDictionary

import numpy as np

from phdtrack.clock import Clock
from phdtrack.conventions import BY_EVIDENCE
from phdtrack.errors import InputError, needed
from phdtrack.files import load, part_of, read_json
from phdtrack.formats import Conventions, find_seqinfo, read_tracks_named
from phdtrack.types import SequenceInfo, Tracks

try:
    import fcntl
except ImportError:  # pragma: no cover
    # Windows: two runs at once are not found out there.
    fcntl = None  # type: ignore[assignment]

TRACKS = "tracks.csv"
ONLINE = "tracks_online.csv"
STATES = "states.csv"
DETECTIONS = "detections.csv"
EMBEDDINGS = "detections.npy"
GROUPS = "groups.csv"
MEMBERS = "members.csv"
EVENTS = "events.csv"
WARNINGS = "warnings.csv"
VIDEO = "annotated.mp4"
PLAN = "plan.mp4"
OBJECTS = "objects.csv"
MINUTES = "minutes.csv"
HOURS = "hours.csv"
HEATMAP = "heatmap.csv"
REPORT = "report.html"
RUN = "run.json"
CAMERA_MOTION = "camera_motion.csv"
COUNTS = "counts.csv"
COUNTS_PICTURE = "counts.png"
COUNTS_VIDEO = "counts.mp4"
COUNTS_PAGE = "counts.html"
COUNTS_MINUTES = "counts_minutes.csv"
COUNTS_HOURS = "counts_hours.csv"
FLOWS = "flows.csv"
# The checkpoint of a run that was interrupted; removed when it is complete.
LOG = "checkpoint.log"
KNOWN = "checkpoint.detector"
# The detections of a complete run, for the next one; other runs leave it where it is.
DETECTED = "detections.cache"
# Every file that a run may write, and what it is.
RUN_FILES = {
    TRACKS: "tracks, corrected, MOTChallenge",
    ONLINE: "the same online, frame by frame",
    STATES: "the filter's states before association",
    DETECTIONS: "detections",
    EMBEDDINGS: "what the detections look like, a row for each (NumPy)",
    GROUPS: "every group in every frame: count, place, contour",
    MEMBERS: "members of each group",
    EVENTS: "groups that appear, vanish, merge, split",
    WARNINGS: "groups about to meet",
    VIDEO: "the annotated video",
    PLAN: "the ground from above",
    CAMERA_MOTION: "how the camera moved, for --camera-motion",
    COUNTS: "who crossed a line, entered or left a zone, and when",
    COUNTS_PICTURE: "lines, zones and what was counted",
    COUNTS_VIDEO: "the same while it goes on",
    COUNTS_PAGE: "the figures on a page",
    COUNTS_MINUTES: "in and out of each line and zone in each minute",
    COUNTS_HOURS: "the same in each hour",
    FLOWS: "how many objects went from which zone to which",
    OBJECTS: "each object: when it came and left, how far and how fast it went",
    MINUTES: "how many objects in each minute",
    HOURS: "the same in each hour",
    HEATMAP: "where objects were: boxes in each cell of the frame",
    REPORT: "the run in pictures and numbers",
    RUN: "settings and statistics (JSON)",
}


# Seconds by which the times of states may be rounded.
_SAME_TIME = 1e-4


class RunTracks(NamedTuple):
    """The tracks of a run or of a file.

    Attributes
    ----------
    tracks, names : the tracks, and the names of their classes.
    info : the sequence, 0 and "" for what is unknown; its ``frames`` are the number of the last.
    source : the video; empty if unknown.
    first : the first frame that was tracked.
    detector : the detector of the run; empty if unknown, or if the detections are from a file.
    """

    tracks: Tracks
    names: Mapping[int, str]
    info: SequenceInfo
    source: str
    first: int = 1
    detector: str = ""


def is_run(path: Path) -> bool:
    """True if it is the directory of a run, or of counts."""
    return any((path / name).exists() for name in (TRACKS, RUN, COUNTS))


def part_of_run(path: Path) -> str:
    """The frames, as 30-50, of the run in a directory, or of a file there; empty for all, or if
    unknown.
    """
    with suppress(OSError, InputError, KeyError, TypeError, AttributeError):
        run = (path if path.is_dir() else path.parent) / RUN
        return str(read_json(run, load(run))["input"].get("frames", ""))
    return ""


def read_run_tracks(
    path: Path, conventions: Conventions = BY_EVIDENCE, notices: list[str] | None = None
) -> RunTracks:
    """The corrected tracks in the directory of a run, or those in a file. Raises `InputError` if
    they cannot be read.

    Parameters
    ----------
    path : the directory or the file.
    conventions : how the file is to be read.
    notices : receives sentences about guesses; None: they are logged.
    """
    run = (path if path.is_dir() else path.parent) / RUN
    tracks, names = read_tracks_named(
        path / TRACKS if is_run(path) else path, conventions=conventions, notices=notices
    )
    info = find_seqinfo(path) or SequenceInfo(0, 0, 0.0)
    source = ""
    first = 1
    detector = ""
    if run.is_file():
        document = read_json(run, load(run))
        try:
            known = document["source"]
            source = document["input"].get("source", "")
            detector = str(document["input"].get("detector", ""))
            first = int(document["input"].get("frames", "").partition("-")[0] or 1)
            last = first - 1 + document["frames"]
            info = SequenceInfo(known["width"], known["height"], known["fps"], last, known["name"])
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise InputError(
                f"expected the run.json of a run, and it has no {error}", where=run
            ) from None
    return RunTracks(tracks, names, info, source, first, detector)


def run_clock(folder: Path, fps: float, video: Clock | None = None) -> Clock:
    """The times of a run's frames: those of its states, and of the video between them.

    Parameters
    ----------
    folder : of the run.
    fps : frames per second where the states say nothing, or if there are none.
    video : the times of the video. If it has other times than the states, as after ``--fps``, or if
        it is None, times between states are interpolated.

    Raises
    ------
    InputError : the states cannot be read.
    """
    file = folder / STATES
    # The first frame may be without states; its time is 0, whatever part of a video was tracked.
    known = {1: 0.0}
    row = 1
    try:
        with file.open(encoding="utf-8") as lines:
            for row, line in enumerate(lines, start=1):
                if row > 1:
                    number, time, _ = line.split(",", 2)
                    known[int(number)] = float(time)
    except FileNotFoundError:
        return video or Clock.constant(fps)
    except (OSError, ValueError) as error:
        raise InputError(
            f"expected the states of a run, and line {row} cannot be read ({error})", where=file
        ) from None
    clock = Clock.of([*known], [*known.values()], fps)
    if video is not None and np.abs(video.times(clock.frame) - clock.seconds).max() < _SAME_TIME:
        return video
    return clock


class _Lock:
    """Keeps other processes from writing into a directory as long as it lives. Raises
    ``BlockingIOError`` if one does.
    """

    __slots__ = ("__weakref__", "_directory")

    def __init__(self, path: Path) -> None:
        # The directory itself is locked: no file is left behind, and the system lets go when the
        # process ends.
        self._directory = os.open(path, os.O_RDONLY)
        try:
            fcntl.flock(self._directory, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise
        except OSError:
            # A file system without locks.
            pass

    def __del__(self) -> None:
        os.close(self._directory)


_HELD = WeakValueDictionary[Path, _Lock]()


@dataclass(frozen=True, slots=True)
class RunDirectory:
    """A directory that is ready to be written into; none of its ``files``, by name with what they
    are, exists yet, unless an earlier run is resumed.

    Attributes
    ----------
    path : the directory.
    files : what may be written, by name.
    lock : keeps other processes out; None without.
    made : whether there was no such directory before.
    """

    path: Path
    files: Mapping[str, str]
    lock: _Lock | None = None
    made: bool = False

    def file(self, name: str) -> Path:
        """The path of the file ``name``."""
        return self.path / name

    def written(self) -> list[Path]:
        """The files that exist by now."""
        return [self.file(name) for name in self.files if self.file(name).exists()]

    def listing(self) -> list[str]:
        """A line for each of these that says what it is."""
        return [
            f"  {file}  {self.files[file.name]}"
            for file in self.written()
            if self.files.get(file.name)
        ]

    def clear(self) -> None:
        """Remove the files again: a run without frames has no results."""
        for file in self.written():
            file.unlink()
        self.sweep()

    def discard(self) -> None:
        """Remove the files again, and the directory if this run made it and nothing else is in
        it.
        """
        self.clear()
        if self.made:
            with suppress(OSError):
                self.path.rmdir()

    def sweep(self) -> None:
        """Remove incomplete files of a run that was killed, and its checkpoint."""
        for name in self.files:
            part_of(self.file(name)).unlink(missing_ok=True)
        for name in (LOG, KNOWN):
            self.file(name).unlink(missing_ok=True)


def check(path: Path | None, overwrite: bool, files: Mapping[str, str] = RUN_FILES) -> None:
    """Raise `InputError` if `claim` would refuse what exists already: a file, or files of a run.

    Parameters
    ----------
    path : the directory; None is not checked.
    overwrite : files of a run may exist.
    files : the files of a run, by name.
    """
    if path is None:
        return
    where = f"--out {path}"
    if path.exists() and not path.is_dir():
        raise InputError(
            "expected a directory, and this is a file",
            where=where,
            cure="Choose another --out.",
        )
    held = [name for name in files if (path / name).exists()]
    if folders := [name for name in held if (path / name).is_dir()]:
        raise InputError(f"{folders[0]} is a directory, and a file is to be written", where=where)
    if not overwrite and (
        (path / LOG).exists() or any(part_of(path / name).exists() for name in files)
    ):
        cure = "Say --resume to continue it, --overwrite to begin anew, or choose another --out."
        raise InputError(
            "the directory holds a run that is incomplete or still going on",
            where=where,
            cure=cure,
        )
    if held and not overwrite:
        if (path / RUN).exists():
            what = "an earlier run"
        else:
            what = "files of these names"
        problem = f"the directory holds {what} ({', '.join(held)})"
        raise InputError(
            problem,
            where=where,
            cure="Say --overwrite to replace these files, or choose another --out.",
        )


def document_of(directory: RunDirectory) -> dict[str, Any]:
    """The content of run.json; empty if there is none that can be read."""
    try:
        document = json.loads(directory.file(RUN).read_bytes())
    except (OSError, ValueError, RecursionError):
        return {}
    if isinstance(document, dict):
        return document
    return {}


def completed(directory: RunDirectory) -> bool:
    """True if it holds a complete run, and nothing of a later one."""
    under_way = directory.file(LOG).exists() or any(
        part_of(directory.file(name)).exists() for name in directory.files
    )
    return document_of(directory).get("complete") is True and not under_way


def claim(
    out: Path | None,
    overwrite: bool,
    files: Mapping[str, str] = RUN_FILES,
    *,
    name: str = "",
    resume: bool = False,
    inputs: Iterable[object] = (),
) -> RunDirectory:
    """The directory of a run, ready and locked, without files of an earlier run.

    Parameters
    ----------
    out, name : the directory; None for ``runs/NAME``.
    overwrite : replace files that exist already.
    files : the files that may be written, by name with what they are.
    resume : remove nothing.
    inputs : paths or addresses that are read; None or empty for none.

    Returns
    -------
    The directory; nobody else can claim it until it is released.

    Raises
    ------
    InputError : as `check`, or an input would be replaced, the directory cannot be made or written
        into, another process writes there, or a package is missing for the report.
    """
    path = out or Path("runs") / name
    written = {(path / one).resolve(): one for one in files}
    for one in filter(None, inputs):
        if (file := Path(str(one)).resolve()) in written:
            problem = f"{written[file]} is read for this run, and would be replaced by it"
            raise InputError(problem, where=f"--out {path}", cure="Choose another --out.")
    check(path, overwrite or resume, files)
    if REPORT in files:
        # Not at the end, perhaps after hours; to import them now takes memory while videos are
        # made.
        for package in ("matplotlib", "cv2"):
            if find_spec(package) is None:
                needed(package)
    made = not path.exists()
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
        lock = _HELD.get(path.resolve())
        if lock is None and fcntl is not None:
            lock = _HELD[path.resolve()] = _Lock(path)
        directory = RunDirectory(path, files, lock, made)
        if not resume:
            directory.clear()
    except BlockingIOError:
        cure = "Wait for it, or choose another --out."
        raise InputError(
            "another run is writing into this directory now", where=f"--out {path}", cure=cure
        ) from None
    except OSError as error:
        problem = f"cannot be written into ({error.strerror or error})"
        raise InputError(problem, where=f"--out {path}", cure="Choose another --out.") from error
    return directory
