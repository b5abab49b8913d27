"""Many videos, each a run of its own, as tasks for other processes.

``DIR/runs/NAME`` is the run of a video, as ``phdtrack track`` writes it, and
``DIR/tracks/NAME.parquet`` its corrected tracks: together they are one data set. In the folder of a
run, ``batch.json`` holds a digest of what decided it, and the result when it is complete; so the
same call again does what is missing. Of a long video that is cut into segments each has a run in
``DIR/segments/NAME``, and whoever finds all of them complete joins them (`segments.join`).
"""

from __future__ import annotations

import glob
import json
import logging
import os
import re
import shlex
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

from phdtrack.addresses import shown
from phdtrack.clock import Clock
from phdtrack.errors import InputError, absent
from phdtrack.files import load, read_json, readable_name
from phdtrack.report import write_run
from phdtrack.run import directory as rundir
from phdtrack.run.detection_log import source_of
from phdtrack.run.directory import RunDirectory
from phdtrack.run.inputs import TABLES, open_inputs, readable_again
from phdtrack.run.parquet_rows import write_rows
from phdtrack.run.preparation import claim_directory, is_complete, prepare
from phdtrack.run.requests import RunRequest, SourceRequest, for_name
from phdtrack.run.segments import Segment, cut, join
from phdtrack.video import open_source
from phdtrack.video.image_folder import SUFFIXES
from phdtrack.video.opening import holds_sequence, is_image, is_video

# In a folder of a run what decided it, and in that of the batch the summary.
DOCUMENT = "batch.json"
RUNS = "runs"
ROWS = "tracks"
SEGMENTS = "segments"
# Bytes of a name, which ".parquet.part" follows: file systems allow 255.
_LONGEST_NAME = 242
# Seconds in which another process that joins the same segments is done.
_PATIENCE = 60.0
# Suffixes of files beside videos that are not tried as videos.
_OTHERS = frozenset(
    f".{suffix}"
    for suffix in (
        *("aac", "ass", "bmp", "cfg", "db", "doc", "docx", "flac", "gz", "htm", "html", "ini"),
        *("ipynb", "log", "m4a", "md", "mp3", "npy", "npz", "onnx", "opus", "part", "pdf", "pt"),
        *("pth", "py", "rar", "sh", "sqlite", "srt", "svg", "tar", "toml", "vtt", "wav", "yaml"),
        *("yml", "zip"),
    )
)
# Names of files that a sentence lists.
_LISTED = 3


@dataclass(frozen=True, slots=True)
class BatchVideo:
    """A video of a batch, or a segment of one.

    Attributes
    ----------
    name : of the video.
    request : its run; relative paths in it are of the folder ``home``.
    command : the command line that does the same, for run.json.
    folder, rows : of the run, and the file with its rows; None for a segment.
    digest : of what decides the rows.
    anew : begin an incomplete run anew.
    parts : segments that it is joined from; empty for a video that is tracked whole.
    segment : which part of the video it is; None for all.
    """

    name: str
    request: RunRequest
    command: str
    home: Path
    folder: Path
    rows: Path | None
    digest: str
    anew: bool = False
    parts: tuple[BatchVideo, ...] = ()
    segment: Segment | None = None

    @property
    def source(self) -> str:
        """The absolute path of the video, or of its detections."""
        return self.request.source.source or str(self.request.source.detections)

    @property
    def mark(self) -> dict[str, Any]:
        """The mark in the folder: the ``digest`` of what decided the run, and its result if it is
        complete.
        """
        with suppress(OSError, ValueError, TypeError):
            return dict(json.loads((self.folder / DOCUMENT).read_bytes()))
        return {}

    @property
    def result(self) -> dict[str, Any] | None:
        """The result if the run is complete and was decided by the same."""
        mark = self.mark
        if mark.get("digest") == self.digest and (self.rows is None or self.rows.exists()):
            return mark.get("result")
        return None

    def __call__(self) -> dict[str, object]:
        """Run it, or what is missing of it, and write its rows; or join its segments. Raises
        `InputError` if it fails.
        """
        os.chdir(self.home)
        if self.parts:
            return self._joined()
        resume = self.mark.get("digest") == self.digest and not self.anew
        # Locked up to the end. Files of other options go before the new mark is written.
        directory = rundir.claim(self.folder, True, resume=resume)
        if self.rows is not None:
            self.rows.unlink(missing_ok=True)
        write_run(directory.file(DOCUMENT), {"digest": self.digest})
        with _kernel_messages_only():
            self._run()
        run = directory.file(rundir.RUN)
        return self._complete(read_json(run, load(run)))

    def _run(self) -> None:
        """Run it. Raises `InputError` if it fails."""
        try:
            prepared = prepare(self.request, self.command)
            directory = claim_directory(prepared, self.request)
            if is_complete(prepared, directory):
                return
            stop = prepared.run(directory, resume=True).stop
            if stop is not None:
                raise stop
        except ModuleNotFoundError as error:
            raise absent(error) from error
        except OSError as error:
            raise InputError(error.strerror or str(error), where=error.filename or "") from error

    def _joined(self) -> dict[str, Any]:
        """Join the segments. Raises `InputError` if that is impossible, or another process that
        does so does not end.
        """
        began = time.monotonic()
        while (result := self.result) is None:
            try:
                directory = rundir.claim(self.folder, True)
            except InputError:
                if time.monotonic() > began + _PATIENCE:
                    raise
                time.sleep(0.2)
                continue
            self._complete(self._join(directory))
        return result

    def _join(self, directory: RunDirectory) -> dict[str, Any]:
        """Join the segments, and give run.json."""
        write_run(directory.file(DOCUMENT), {"digest": self.digest})
        return join([(part.segment, part.folder) for part in self.parts if part.segment], directory)

    def _video_clock(self) -> Clock | None:
        """The times of the video; None without one, or if it cannot be read any more."""
        source = self.request.source
        with suppress(InputError, OSError):
            if source.source:
                return open_source(source.source, fps=source.fps).clock()
        return None

    def _complete(self, document: dict[str, Any]) -> dict[str, object]:
        """Write the rows and the result, from run.json."""
        if self.rows is not None:
            fps = document["source"]["fps"]
            write_rows(self.name, self.folder, self.rows, fps, self._video_clock())
        names = ("frames", "tracks", "track_rows", "seconds", "warnings", "doubtful_boxes")
        result = {name: document[name] for name in names}
        write_run(self.folder / DOCUMENT, {"digest": self.digest, "result": result})
        return result


@contextmanager
def _kernel_messages_only() -> Iterator[None]:
    """Keep warnings of a run, which are in its run.json, from stderr; but not that kernels are
    compiled, which keeps a first run waiting.
    """
    levels = {"phdtrack": logging.ERROR, "phdtrack.kernels": logging.WARNING}
    before = {name: logging.getLogger(name).level for name in levels}
    try:
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)
        yield
    finally:
        for name, level in before.items():
            logging.getLogger(name).setLevel(level)


@dataclass(frozen=True, slots=True)
class BatchPlan:
    """How videos are run.

    Attributes
    ----------
    request : options of all videos; ``{}`` in them stands for the name of the video.
    words : the same as words of a command line, which digests are made of.
    out : the folder of the batch.
    segment, overlap : seconds of a segment, 0 for whole videos, and of what two have in common.
    anew : begin incomplete runs anew.
    """

    request: RunRequest
    words: tuple[str, ...]
    out: Path
    segment: float = 0.0
    overlap: float = 20.0
    anew: bool = False

    def videos(self, sources: Sequence[str]) -> list[BatchVideo]:
        """The videos, with their names; those that are longer than a segment in parts. Raises
        `InputError` if there are no videos, or the options do not go together.
        """
        self._check()
        every = [source for word in sources for source in expanded(word)]
        paths = list(dict.fromkeys(map(os.path.abspath, every)))
        if not paths:
            raise InputError("there is no video in the list", where="SOURCE")
        return [self._video(*each) for each in zip(names(paths), paths, strict=True)]

    def _check(self) -> None:
        """Raise `InputError` for options that do not go together."""
        request = self.request
        if wrong := request.source.source or request.output.out:
            problem = f"expected options of phdtrack track for all videos, got {wrong}"
            raise InputError(problem, where="after --")
        if self.segment and request.frames:
            problem = "a segment is a choice of frames already"
            raise InputError(problem, where="--segment", cure="Leave out --frames.")
        if 0 < self.segment < self.overlap:
            problem = f"segments of {self.segment:g} s cannot have {self.overlap:g} s in common"
            cure = "Choose longer segments, or a shorter --overlap."
            raise InputError(problem, where="--segment", cure=cure)

    def _video(self, name: str, source: str) -> BatchVideo:
        """A video, whole or in parts."""
        root = self.out.absolute()
        words = for_name(list(self.words), name)
        # Of files among the options the contents matter.
        decided_by: list[object] = [
            source_of(source),
            [source_of(word) if os.path.isfile(word) else word for word in words],
        ]
        folder = root / RUNS / name
        request = self._request(name, source, folder)
        command = _command(source, folder, words)
        rows = root / ROWS / f"{name}.parquet"
        digest = _digest(decided_by)
        video = BatchVideo(name, request, command, Path.cwd(), folder, rows, digest, self.anew)
        segments = self._segments(request.source) if self.segment else []
        if len(segments) <= 1:
            return video
        parts = tuple(
            self._part(video, one, root / SEGMENTS / name, (decided_by, words)) for one in segments
        )
        return replace(video, parts=parts, digest=_digest([decided_by, segments]))

    def _request(self, name: str, source: str, folder: Path) -> RunRequest:
        """The run of a video, or of a file of detections."""
        request = for_name(self.request, name)
        if Path(source).suffix.lower() in TABLES:
            inputs = replace(request.source, detections=Path(source))
        else:
            inputs = replace(request.source, source=source)
        output = replace(request.output, out=folder, resume=True)
        return replace(request, source=inputs, output=output)

    def _part(
        self,
        video: BatchVideo,
        segment: Segment,
        folder: Path,
        given: tuple[list[object], list[str]],
    ) -> BatchVideo:
        """The run of a segment, from what decides the video and its words."""
        decided_by, words = given
        frames = f"{segment.first}-{segment.last or ''}"
        folder = folder / frames
        output = replace(video.request.output, out=folder)
        return replace(
            video,
            name=f"{video.name} {frames}",
            request=replace(video.request, output=output, frames=frames),
            command=_command(video.source, folder, [*words, "--frames", frames]),
            folder=folder,
            rows=None,
            digest=_digest([decided_by, frames]),
            segment=segment,
        )

    def _segments(self, request: SourceRequest) -> list[Segment]:
        """The segments of a video, by the times of its frames."""
        try:
            if request.source:
                source = open_source(request.source, fps=request.fps)
            else:
                source = open_inputs(request, {}).source
            clock = source.clock()
        except (InputError, OSError):
            # The run of the video reports why.
            return []
        frames = source.info.frames or int(clock.frame[-1])
        return cut(frames, self.segment, self.overlap, clock)


def _command(source: str, folder: Path, words: Sequence[str]) -> str:
    """The command line that runs a video alone."""
    subject = ["--detections", source] if Path(source).suffix.lower() in TABLES else [source]
    every = ["phdtrack", "track", *subject, "--out", str(folder), *words]
    return shlex.join(map(shown, every))


def _digest(decided_by: object) -> str:
    """A digest of what decides a run."""
    return sha256(json.dumps(decided_by).encode()).hexdigest()


def expanded(word: str) -> Iterator[str]:
    """The sources that a word stands for: those in a list, the videos in a folder or of a pattern,
    or the word itself; a folder or pattern of images is one source.
    """
    if word.startswith("@"):
        text = os.fsdecode(load(Path(word[1:])))
        for line in map(str.strip, text.splitlines()):
            if line and not line.startswith("#"):
                yield from expanded(line)
        return
    if not readable_again(word):
        cure = "For cameras there is `phdtrack live`."
        raise InputError("a batch is of files, which have an end", where=word, cure=cure)
    path = Path(word)
    files = [word]
    if path.is_dir():
        files = _contents(word)[0]
    elif not path.exists() and set(word) & set("*?["):
        files = glob.glob(word, recursive=True)
        if files and all(map(_is_image, files)):
            files = [word]
    if files != [word]:
        # Not the annotated videos of runs.
        files = sorted(name for name in files if os.path.basename(name) not in rundir.RUN_FILES)
    if not files:
        cure = "Check the folder and the pattern."
        raise InputError("there is no video and no image", where=word, cure=cure)
    yield from files


def left_out(word: str) -> str:
    """A sentence with the files of a folder that are not tracked; empty if all are, or if the word
    is no folder.
    """
    if word.startswith("@") or not Path(word).is_dir():
        return ""
    others = [os.path.relpath(name, word) for name in _contents(word)[1]]
    if not others:
        return ""
    more = len(others) - _LISTED
    rest = f" and {more} more" if more > 0 else ""
    return f"{word}: left out {', '.join(others[:_LISTED])}{rest}"


def _contents(folder: str) -> tuple[list[str], list[str]]:
    """The sources in a folder and the folders in it, and the files beside them.

    Sources are the folder itself if it is an image sequence; else all videos; without any, folders
    that are image sequences. Hidden files and the files of runs are neither.
    """
    runs = set[str]()
    found = dict[str, list[str]]()
    for name in sorted(glob.glob(f"{glob.escape(folder)}/**", recursive=True)):
        home = os.path.dirname(name)
        if os.path.isdir(name):
            written = rundir.is_run(Path(name)) or os.path.exists(os.path.join(name, DOCUMENT))
            if written or home in runs:
                runs.add(name.rstrip("/"))
        elif home not in runs and os.path.basename(name) not in rundir.RUN_FILES:
            found.setdefault(home, []).append(name)
    videos = {home: list(filter(_is_video, names)) for home, names in found.items()}
    images = {home: sum(map(_is_image, names)) for home, names in found.items()}
    own = os.path.dirname(f"{folder}/x")
    every = [name for names in found.values() for name in names]
    sequences = [home for home in found if holds_sequence(images[home], len(videos[home]))]
    if own in sequences:
        return [folder], [one for one in every if os.path.dirname(one) != own or not _is_image(one)]
    sources = [name for names in videos.values() for name in names] or sequences
    taken = set(sources)
    return sources, [one for one in every if not taken & {one, os.path.dirname(one)}]


def _is_video(name: str) -> bool:
    """True for a file that is a video by its name; FFmpeg tries others that may be one."""
    path = Path(name)
    suffix = path.suffix.lower()
    if is_video(path):
        return True
    if suffix in SUFFIXES or suffix in TABLES or suffix in _OTHERS or not os.path.getsize(path):
        return False
    with suppress(InputError, OSError):
        return bool(open_source(path))
    return False


def _is_image(name: str | Path) -> bool:
    return is_image(Path(name))


def names(sources: Sequence[str]) -> list[str]:
    """A name for each absolute path: its last part without the suffix, or as many parts as are
    needed to distinguish all of them.
    """
    parts = [_named_parts(Path(source)) for source in sources]
    for depth in range(1, max(map(len, parts)) + 1):
        # Tools that read a folder of Parquet files skip names that begin with a dot or underscore.
        found = [
            _cut(re.sub(r"^[._]+", "", readable_name("-".join(each[-depth:])))) for each in parts
        ]
        if all(found) and len(set(found)) == len(found):
            return found
    twice = max(found, key=found.count)
    cure = "Rename one, or make two batches."
    raise InputError(f"two sources would both be called {twice}", where="SOURCE", cure=cure)


def _cut(name: str) -> str:
    """The name, with a digest in place of the end that the names of its files have no room for."""
    whole = os.fsencode(name)
    if len(whole) <= _LONGEST_NAME:
        return name
    digest = sha256(whole).hexdigest()[:8]
    return f"{os.fsdecode(whole[: _LONGEST_NAME - 9]).rstrip()}-{digest}"


def _named_parts(path: Path) -> tuple[str, ...]:
    """The parts of a path that name a source."""
    if set(path.name) & set("*?[") and not path.exists():
        path = path.parent
    if path.name == "img1":
        path = path.parent
    return (path if path.is_dir() else path.with_suffix("")).parts[1:]
