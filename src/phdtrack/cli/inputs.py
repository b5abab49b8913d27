"""What a run reads: a video, a video with detections beside it, or detections alone.

Every source becomes the same thing, frames and a detector, so that the loop behind it knows one case only. Without a
video the frames have empty pictures, and the detector looks its boxes up by frame number.

`ahead` lets stages of the work overlap in threads, `rereadable` gives frames a second time that come only once.
"""

from __future__ import annotations

import math
import re
import tempfile
import threading
import time
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from queue import SimpleQueue
from typing import Any, TypeVar

import numpy as np

from phdtrack.cli.options import DEFAULT_DETECTOR, Wanted
from phdtrack.cli.output import progress
from phdtrack.detect import TableDetector, make_detector, typed
from phdtrack.detect.convert import within_frame
from phdtrack.errors import InputError
from phdtrack.formats import DetectionsWriter, find_seqinfo, read_detections
from phdtrack.protocols import Detector
from phdtrack.types import Detections, DetectionTable, Frame, Image, SequenceInfo
from phdtrack.video import VideoSource, VideoWriter, open_source

NO_PICTURE: Image = np.zeros((0, 0, 3), np.uint8)
TABLES = (".txt", ".csv", ".tsv", ".json", ".xml", ".parquet")


@dataclass(frozen=True, slots=True)
class Inputs:
    """What a run reads.

    ``pictures``: the frames have any. ``again``: they can be read a second time (a camera's cannot). ``name`` is for
    people and for the name of the run's directory; ``described`` says where the detections come from.
    """

    info: SequenceInfo
    source: VideoSource
    detector: Detector
    name: str
    described: str
    pictures: bool
    again: bool
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Blank:
    """Frames without pictures: ``info.frames`` of them, at the rate of ``info``. Nothing can go wrong with them."""

    info: SequenceInfo
    note: str = ""
    problem: str = ""

    def __iter__(self) -> Iterator[Frame]:
        for number in range(1, self.info.frames + 1):
            yield Frame(number, (number - 1) / self.info.fps, NO_PICTURE)


def detected(detector: Detector, frames: Iterable[Frame]) -> Iterator[tuple[Frame, Detections, float]]:
    """Each frame with what ``detector`` sees in it and how many seconds it looked."""
    for frame in frames:
        clock = time.perf_counter()
        found = detector(frame)
        yield frame, found, time.perf_counter() - clock


def write_detected(inputs: Inputs, path: Path) -> Iterator[int]:
    """Run the detector over everything; after each frame, which is in the file by then, the number of its boxes."""
    with (
        DetectionsWriter(path) as writer,
        progress("detecting", inputs.info.frames) as advance,
        ahead(inputs.source) as pictures,
        ahead(detected(inputs.detector, pictures)) as looked,
    ):
        for count, (frame, found, _) in enumerate(looked, start=1):
            writer.append(frame.number, found)
            advance(count)
            yield len(found)


def open_inputs(wanted: Wanted, parameters: dict[str, Any]) -> Inputs:
    """Open what the options name; ``parameters`` are the detector's own settings.

    Raises
    ------
    InputError : options that do not go together, or anything that cannot be read.
    """
    if not 0 <= wanted.fps < math.inf:
        raise InputError(f"expected frames per second above 0, got {wanted.fps:g}", where="--fps")
    if wanted.detections is None:
        detector = _detector(wanted, parameters)
        source = open_source(wanted.source, fps=wanted.fps)
        _check_size(wanted, source.info)
        again = comes_again(wanted.source)
        return Inputs(source.info, source, detector, wanted.source, wanted.detector or DEFAULT_DETECTOR, True, again)
    path, given = wanted.detections, {"--max-width": wanted.max_width, "--mask": wanted.mask}
    for option, used in ({"--detector": wanted.detector not in ("", "file")} | given).items():
        if used:
            problem = f"the detections come from {path}, so there is no detector that this could change"
            raise InputError(problem, where=option, cure=f"Leave out {option} or --detections.")
    table = read_detections(path)
    frames = open_source(wanted.source, fps=wanted.fps) if wanted.source else Blank(_sequence(wanted, path, table))
    if wanted.source:
        _check_size(wanted, frames.info)
    seen, left_out = within_frame(table, frames.info, path)
    name, pictures = wanted.source or str(path), bool(wanted.source)
    again = not pictures or comes_again(wanted.source)
    return Inputs(frames.info, frames, TableDetector(seen), name, str(path), pictures, again, left_out)


def frame_size(text: str) -> tuple[int, int]:
    """Width and height in pixels from ``WxH``.

    Raises
    ------
    InputError : the text is no size.
    """
    match = re.fullmatch(r"\s*(\d+)\s*[x×X*]\s*(\d+)\s*", text)
    if not match or not int(match[1]) or not int(match[2]):
        raise InputError(f"expected a size as 1920x1080, got {text!r}", where="--frame-size")
    return int(match[1]), int(match[2])


def _detector(wanted: Wanted, parameters: dict[str, Any]) -> Detector:
    """The detector that the options name. Raises `InputError` where there is none, or nothing to look at."""
    if wanted.detector == "file":
        raise InputError("the detector file reads a file of detections", where="--detector", cure="Say --detections FILE.")
    if wanted.detector == "callable":
        raise InputError(
            "a callable is a function of your own program", where="--detector", cure="Use phdtrack.Tracker there."
        )
    if not wanted.source:
        raise InputError(
            "nothing to work on",
            where="SOURCE",
            cure="Name a video, a folder of images or a camera's number; or say --detections FILE.",
        )
    if Path(wanted.source).suffix.lower() in TABLES:
        raise InputError(
            "expected a video, and by its name this is a table",
            where=wanted.source,
            cure=f"For detections say --detections {wanted.source}.",
        )
    name = wanted.detector or DEFAULT_DETECTOR
    try:
        return make_detector(name, max_width=wanted.max_width, mask=wanted.mask, **typed(name, parameters))
    except InputError as error:
        # In the user's own words: detector.min_area, not the record of settings that refused the value.
        setting = error.where.rpartition(".")[2]
        where = f"detector.{setting}" if setting in parameters else error.where or "--detector"
        raise InputError(error.problem, where=where, cure=error.cure) from error


def _sequence(wanted: Wanted, path: Path, table: DetectionTable) -> SequenceInfo:
    """Size, rate and length of a sequence of which there are detections only: options first, then seqinfo.ini."""
    found = find_seqinfo(path) or SequenceInfo(0, 0, 0.0, 0, path.stem)
    if wanted.frame_size:
        width, height = frame_size(wanted.frame_size)
        found = replace(found, width=width, height=height)
    found = replace(found, fps=wanted.fps or found.fps, frames=max(found.frames, table.last, wanted.last))
    beside = "or put a seqinfo.ini beside the file or one folder up, or name the video."
    if not found.width or not found.height:
        raise InputError("the size of the frames is not known", where=path, cure=f"Say --frame-size WxH, {beside}")
    if not found.fps:
        raise InputError("the rate of the frames is not known", where=path, cure=f"Say --fps F, {beside}")
    return found


def _check_size(wanted: Wanted, info: SequenceInfo) -> None:
    """With a video its own size holds, and another one in the options is a mistake."""
    if wanted.frame_size and frame_size(wanted.frame_size) != (info.width, info.height):
        raise InputError(
            f"{wanted.source} has frames of {info.width}x{info.height} pixels, not {wanted.frame_size}",
            where="--frame-size",
            cure="Leave it out: it is for detections without a video.",
        )


def comes_again(source: str) -> bool:
    """Whether the frames can be read a second time: not those of a camera or of a stream on the network."""
    return "://" not in source and not (source.isdecimal() and not Path(source).exists())


# Quality of the copy of a camera's frames: hardly distinguishable, because it is encoded once more when it is drawn on.
_FINE = 16


@contextmanager
def rereadable(inputs: Inputs, wanted: bool) -> Iterator[VideoSource]:
    """The frames of ``inputs``, to be gone through twice where that is ``wanted``.

    Frames that come only once, those of a camera or of a stream on the network, are copied into a temporary file on the
    way; it lives as long as this does.
    """
    if inputs.again or not wanted:
        yield inputs.source
        return
    with tempfile.TemporaryDirectory(prefix="phdtrack-") as folder:
        yield _Copied(inputs.source, Path(folder) / "frames.mp4")


class _Copied:
    """The first time the frames of ``source``, copied into ``path`` on the way; from then on those of the copy."""

    def __init__(self, source: VideoSource, path: Path) -> None:
        self._source, self._path = source, path
        self.info = source.info
        self._seen: list[tuple[int, float]] = []
        self._first: Generator[Frame, None, None] | None = None

    @property
    def note(self) -> str:
        """What the source did to be read."""
        return self._source.note

    @property
    def problem(self) -> str:
        """What the source lost, known at its end."""
        return self._source.problem

    def __iter__(self) -> Iterator[Frame]:
        if self._first is None:
            self._first = self._copying()
            return self._first
        # The first pass may have stopped half-way: only closing completes the copy.
        self._first.close()
        return self._again()

    def _copying(self) -> Generator[Frame, None, None]:
        info = self.info
        with VideoWriter(self._path, info.width, info.height, info.fps, quality=_FINE) as copy:
            for frame in self._source:
                copy.write(frame.image)
                self._seen.append((frame.number, frame.time))
                yield frame

    def _again(self) -> Iterator[Frame]:
        for (number, at), frame in zip(self._seen, open_source(self._path), strict=False):
            # The copy of an odd size is padded by a row or a column.
            yield Frame(number, at, frame.image[: self.info.height, : self.info.width])


T = TypeVar("T")
DEPTH = 3
"""Items under way: one being made, one ready, and one to even out stages whose pace varies."""


@contextmanager
def ahead(items: Iterable[T], depth: int = DEPTH) -> Iterator[Iterator[T]]:
    """The same items in the same order, made by a thread of their own while earlier ones are used.

        with ahead(source) as frames, ahead(detected(detector, frames)) as found:
            for frame, detections, seconds in found:
                ...

    Decoding, detecting, drawing and encoding let other threads run, so that the slowest stage decides how fast the whole
    is. An error of a stage is raised in the loop after the items before it. When the block is left, by an error or Ctrl-C
    too, the stage is stopped and waited for: nothing still runs or holds a file afterwards.

    Parameters
    ----------
    items : run through once, in that thread, and closed there where it is a generator.
    depth : how many items at most are being made or wait to be taken, at least 1.
    """
    free, stop = threading.Semaphore(depth), threading.Event()
    ready: SimpleQueue[tuple[T] | BaseException] = SimpleQueue()

    def make() -> None:
        try:
            iterator = iter(items)
            try:
                # A place is taken before an item is made: that bounds how many live.
                while free.acquire() and not stop.is_set():
                    ready.put((next(iterator),))
            finally:
                # Here and not by the garbage collector: files are closed by the thread that used them.
                if isinstance(iterator, Generator):
                    iterator.close()
        except BaseException as error:  # StopIteration among them: all belong to the loop that takes the items
            ready.put(error)

    def taken() -> Iterator[T]:
        while isinstance(message := ready.get(), tuple):
            free.release()
            yield message[0]
        if not isinstance(message, StopIteration):
            raise message

    stage = threading.Thread(target=make, name="phdtrack stage", daemon=True)
    stage.start()
    try:
        yield taken()
    finally:
        stop.set()
        free.release()
        stage.join()
