"""What a run reads: a video, a video with detections, or detections alone.

Every source becomes frames and a detector. Without a video the frames have empty pictures, and the
detector looks its boxes up by frame number.
"""

from __future__ import annotations

import math
import queue
import re
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from phdtrack.arrays import share_inside
from phdtrack.cli.options import SourceOptions
from phdtrack.cli.output import counted, progress
from phdtrack.detect import TableDetector, make_detector
from phdtrack.detect.base import Detector, class_names, detect_all, pose_of, prepared
from phdtrack.detect.convert import within_frame
from phdtrack.detect.detectors import working_width
from phdtrack.detect.scene_knowledge import study
from phdtrack.detect.table_detector import frames_up_to, frames_walked
from phdtrack.errors import InputError, shown
from phdtrack.files import return_memory
from phdtrack.formats import DetectionsWriter, find_seqinfo, read_detections
from phdtrack.formats.checks import WrongRows
from phdtrack.formats.stream import stream_detections
from phdtrack.types import F8, STILL, Detections, DetectionTable, Frame, Image, SequenceInfo
from phdtrack.video import VideoSource, open_source
from phdtrack.video.decoding import endless
from phdtrack.video.live_sources import LiveSource, check_address, named

NO_PICTURE: Image = np.zeros((0, 0, 3), np.uint8)
TABLES = (".txt", ".csv", ".tsv", ".json", ".jsonl", ".xml", ".parquet")
# Items under way: one being made, one ready, one to even out stages whose pace varies.
DEPTH = 3
# Seconds without a picture after which a run that reads a camera ends.
GIVE_UP = 60.0
# Seconds that a stage which was stopped may take to end what it does.
_PATIENCE = 0.7
# Share of a file after which is estimated how many frames there will be; from _CERTAIN on, fewer
# than _CUT of those that its header announces are the sign of a file that was cut short.
_ENOUGH = 0.03
_CERTAIN = 0.25
_CUT = 0.6
T = TypeVar("T")
Part = tuple[int, int]
"""The first and the last frame that are tracked; 0: the end."""
WHOLE: Part = (1, 0)
Mover = Callable[[Frame, Detections, F8], F8]
"""(3, 3) from the pixels of the last frame to those of this one, or `types.STILL`; it is given
`Detected.pose`, too.
"""


@dataclass(frozen=True, slots=True)
class Inputs:
    """What a run reads. ``pictures``: the frames have any. ``again``: they can be read a second
    time (a camera's cannot). ``name`` is for people; ``described`` says where the detections come
    from. ``classes`` are those of a file of detections or of a network, and ``names`` what it calls
    them; None without. ``left_out``: wrong rows, for run.json. ``max_width``: of the pictures that
    the detector sees, 0 for their own. ``last_detected``: frame of which a file has detections.
    ``files``: what is read, None for what was not given."""

    info: SequenceInfo
    source: VideoSource
    detector: Detector
    name: str
    described: str
    pictures: bool
    again: bool
    warnings: tuple[str, ...] = ()
    names: Mapping[int, str] | None = None
    classes: frozenset[int] | None = None
    left_out: Mapping[str, object] = field(default_factory=dict)
    max_width: int = 0
    last_detected: int = 0
    files: tuple[object, ...] = ()


class Detected(NamedTuple):
    """A frame, what the detector sees in it, how the camera moved, how many seconds the detector
    looked, and its pose.
    """

    frame: Frame
    found: Detections
    warp: F8
    seconds: float
    pose: F8


def detected(
    detector: Detector, frames: Iterable[Frame], mover: Mover | None = None
) -> Iterator[Detected]:
    """Each frame with what ``detector`` sees in it."""
    for frame, found, seconds in detect_all(detector, frames):
        pose = pose_of(detector, frame)
        yield Detected(
            frame, found, STILL if mover is None else mover(frame, found, pose), seconds, pose
        )


def learn_scene(inputs: Inputs) -> None:
    """Let a detector that learns the scene look through a file before its first frame: all of it,
    whatever is tracked.
    """
    if inputs.pictures and inputs.again:
        study(inputs.detector, replace(inputs.source, first=1, last=0), inputs.source.sample)
        return_memory()


def expected(source: VideoSource, done: int, title: str) -> dict[str, Any]:
    """The number of frames, for a bar with this title. What the header of a file announces holds,
    unless there are more already, or what was read of the file tells of far fewer, as in one that
    is cut short. Without it, it is estimated."""
    before = source.first - 1
    done = done + source.first - 1
    if source.share > _ENOUGH:
        estimate = round(done / source.share)
    else:
        estimate = 0
    cut = source.share > _CERTAIN and done < _CUT * source.share * source.announced
    total = source.info.frames or (0 if cut or done > source.announced else source.announced)
    end = min(filter(None, (total or estimate, source.last)), default=before)
    return {
        "total": end - before or None,
        "description": title if total or not estimate else f"{title} (end estimated)",
    }


def write_detected(inputs: Inputs, path: Path) -> Iterator[int]:
    """Run the detector over everything; after each frame, which is in the file by then, the number
    of its boxes.
    """
    learn_scene(inputs)
    with (
        DetectionsWriter(path, inputs.names) as writer,
        progress("detecting", 0) as advance,
        ahead(prepared(inputs.detector, inputs.source)) as pictures,
        ahead(detected(inputs.detector, pictures)) as looked,
    ):
        for count, (frame, found, *_) in enumerate(looked, start=1):
            writer.append(frame.number, found)
            advance(count, **expected(inputs.source, count, "detecting"))
            yield len(found)


def open_inputs(
    given: SourceOptions, parameters: dict[str, Any], last: int = 0, part: Part = WHOLE
) -> Inputs:
    """Open what the options name; ``parameters`` are the detector's own settings.

    ``last`` is the last annotated frame: a sequence without a video is at least that long.
    ``part``: what is tracked of it. Raises `InputError` where options do not go together or
    something cannot be read.
    """
    if not 0 <= given.fps < math.inf:
        raise InputError(f"expected frames per second above 0, got {given.fps:g}", where="--fps")
    if part != WHOLE and (given.detections == Path("-") or not comes_again(given.source)):
        problem = "frames are chosen of files, and this is read as it comes"
        raise InputError(problem, where="--frames", cure="Leave it out.")
    if given.detections == Path("-"):
        return _streamed(given)
    pictures = bool(given.source)
    path = given.detections
    again = not pictures or comes_again(given.source)
    if path is None:
        # Wrong settings are found before anything is opened.
        _detector(given, parameters, given.max_width or 0)
        source = _video(given, part)
        width = working_width(given.observed_by, given.max_width, source.info)
        detector = _detector(given, parameters, width)
        name = shown(given.source)
        names = class_names(detector)
        found = Inputs(
            source.info,
            source,
            detector,
            name,
            given.observed_by,
            True,
            again,
            names=names,
            max_width=width,
        )
        return replace(found, classes=frozenset(names) if names else None)
    useless = {
        "--detector": given.detector not in ("", "file"),
        "--max-width": given.max_width is not None,
        "--mask": given.mask,
        "--detect-again": given.detect_again,
    }
    problem = f"the detections come from {path}, so there is no detector that this could change"
    refuse(useless, problem, "--detections")
    if given.on_error == "stop":
        left_out = None
    else:
        left_out = WrongRows()
    table = read_detections(path, left_out=left_out)
    if pictures:
        frames = _video(given, part)
    else:
        frames = _blank(given, path, table, last)
    frames.first, frames.last = part
    seen, warnings = within_frame(table, frames.info, path)
    warnings = (*(left_out.sentences() if left_out else ()), *warnings)
    classes = frozenset(np.unique(seen.detections.class_id).tolist())
    name = shown(given.source) or str(path)
    found = Inputs(
        frames.info, frames, TableDetector(seen), name, str(path), pictures, again, warnings
    )
    if left_out:
        found = replace(found, left_out=left_out.document())
    else:
        found = found
    latest = int(seen.frame.max(initial=0))
    found = replace(found, last_detected=min(latest, part[1] or latest))
    if seen.names or classes - {0}:
        return replace(found, names=seen.names, classes=classes)
    return found


def _streamed(given: SourceOptions) -> Inputs:
    """Detections from standard input, which may have no end; size and rate by options."""
    pictures = {
        "SOURCE": given.source,
        "--detector": given.detector,
        "--max-width": given.max_width is not None,
    }
    pictures |= {"--mask": given.mask, "--detect-again": given.detect_again}
    refuse(pictures, "detections from standard input have no pictures", "--detections -")
    refuse(
        {"--on-error": given.on_error == "skip"},
        "a wrong row of a stream ends it",
        "--detections -",
    )
    for what, option in ((given.frame_size, "--frame-size WxH"), (given.fps, "--fps F")):
        if not what:
            raise InputError(
                "size and rate of the frames are not known",
                where="--detections -",
                cure=f"Say {option}.",
            )
    width, height, fps = *frame_size(given.frame_size), given.fps
    waiting = dict[int, Detections]()

    def read(source: VideoSource) -> Iterator[tuple[int, float, Image, str]]:
        last = empty = 0
        for table in stream_detections(sys.stdin.buffer, "standard input"):
            inside = share_inside(table.detections.xyxy, width, height) > 0
            empty += int((~inside).sum()) + table.empty
            if empty:
                source.problem = (
                    f"{counted(empty, 'box')} without area or outside of the frame left out"
                )
            else:
                source.problem = ""
            for number in np.unique(table.frame).tolist():
                waiting[number] = table.detections.select(
                    np.flatnonzero(inside & (table.frame == number))
                )
                for frame in frames_up_to(number, last, fps):
                    yield frame, (frame - 1) / fps, NO_PICTURE, ""
                last = number

    info = SequenceInfo(width, height, fps, 0, "stdin")
    return Inputs(
        info,
        VideoSource(info, read),
        _Waiting(waiting),
        "standard input",
        "standard input",
        False,
        False,
    )


@dataclass(frozen=True, slots=True)
class _Waiting:
    """A detector that gives each frame's detections once, where there are any."""

    found: dict[int, Detections]

    def reset(self) -> None:
        """Nothing to forget."""

    def __call__(self, frame: Frame) -> Detections:
        """The detections of frame ``frame.number``."""
        return self.found.pop(frame.number, Detections.empty())


def refuse(useless: Mapping[str, object], problem: str, instead: str) -> None:
    """Raise `InputError` for the first option that was given although ``instead`` leaves it nothing
    to do.
    """
    for option, used in useless.items():
        if used:
            raise InputError(problem, where=option, cure=f"Leave out {option} or {instead}.")


def _video(given: SourceOptions, part: Part) -> VideoSource:
    """The video; its own size holds, and another one in the options is a mistake."""
    first, last = part
    again = comes_again(given.source)
    if again:
        source = open_source(given.source, fps=given.fps, first=first, last=last)
    else:
        source = _camera(given.source)
    if given.frame_size and frame_size(given.frame_size) != (source.info.width, source.info.height):
        size = f"{source.info.width}x{source.info.height}"
        problem = f"{given.source} has frames of {size} pixels, not {given.frame_size}"
        raise InputError(
            problem,
            where="--frame-size",
            cure="Leave it out: it is for detections without a video.",
        )
    return source


def _camera(address: str) -> VideoSource:
    """The newest pictures of a camera, at their true times; those that come while the tracker is
    busy are left out.

    A file on a server has an end and comes in order, with time-outs. Raises `InputError` where
    nothing comes.
    """
    check_address(address)
    if "://" in address and not address.startswith("rtsp"):
        # In a thread: an address that does not answer must not keep Ctrl-C waiting.
        with ahead(map(_with_an_end, [address])) as found:
            if (source := next(found)[0]) is not None:
                return source
    live = LiveSource(address)
    began = list[tuple[int, float, Image, str]]()
    live.start()
    for frame in _pictures(live, live.connect):
        # The rate is measured in the first second.
        began.append(frame)
        if frame[1] - began[0][1] >= 1.0:
            break
    if not began:
        live.stop()
        problem = live.status().problem or "nothing came"
        cure = "Check the address, and that the camera is on."
        raise InputError(
            f"no picture came in {live.connect:g} s: {problem}", where=address, cure=cure
        )
    status = live.status()
    zero = began[0][1]

    def read(source: VideoSource) -> Iterator[tuple[int, float, Image, str]]:
        try:
            for number, at, image, where in chain(began, _pictures(live, GIVE_UP)):
                yield number, at - zero, image, where
            said = live.status().problem or "it is silent"
            raise ConnectionError(f"{shown(address)}: no picture in {GIVE_UP:g} s ({said})")
        finally:
            live.stop()
            if dropped := live.status().dropped:
                said = (
                    f"{counted(dropped, 'picture')} left out, which came while earlier ones were"
                    " worked on"
                )
                source.problem = f"{shown(address)}: {said}"

    info = SequenceInfo(
        status.width, status.height, max(1.0, round(status.fps, 1)), 0, named(address)
    )
    note = (
        f"{shown(address)}: about {info.fps:g} pictures a second, each taken at the time at which"
        " it arrived"
    )
    return VideoSource(info, read, note)


def _with_an_end(address: str) -> tuple[VideoSource | None]:
    """The frames of a file on a server; None where it is a stream that never ends."""
    return (None if endless(address) else open_source(address),)


def _pictures(live: LiveSource, patience: float) -> Iterator[tuple[int, float, Image, str]]:
    """Number, time and picture, and where it is from, until none has come for so many seconds."""
    last = time.monotonic()
    while time.monotonic() - last < patience:
        frame = live.next(0.2)
        if frame is not None:
            yield frame.number, frame.time, frame.image, f"frame {frame.number}"
            last = time.monotonic()


def frame_size(text: str) -> tuple[int, int]:
    """Width and height in pixels from ``WxH``. Raises `InputError` where the text is no size."""
    match = re.fullmatch(r"\s*(\d+)\s*[x×X*]\s*(\d+)\s*", text)
    if not match or not int(match[1]) or not int(match[2]):
        raise InputError(f"expected a size as 1920x1080, got {text!r}", where="--frame-size")
    return int(match[1]), int(match[2])


def frame_range(text: str) -> Part:
    """First and last frame from ``A-B``, ``A-`` or ``-B``; 1 and 0 (the end) where none is said.
    `InputError` otherwise.
    """
    match = re.fullmatch(r"\s*(\d{0,9})\s*-\s*(\d{0,9})\s*", text or "-")
    first, last = (int(match[1] or 1), int(match[2] or 0)) if match else (0, 0)
    if first < 1 or (match and match[2] and last < first):
        raise InputError(f"expected frames as 1500-3000, from 1, got {text!r}", where="--frames")
    return first, last


def _detector(given: SourceOptions, parameters: dict[str, Any], max_width: int) -> Detector:
    """The detector that the options name. Raises `InputError` where there is none, or nothing to
    look at.
    """
    if given.detector == "file":
        raise InputError(
            "the detector file reads a file of detections",
            where="--detector",
            cure="Say --detections FILE.",
        )
    if not given.source:
        cure = "Name a video, a folder of images or a camera's number; or say --detections FILE."
        raise InputError("nothing to work on", where="SOURCE", cure=cure)
    if Path(given.source).suffix.lower() in TABLES:
        cure = f"For detections say --detections {given.source}."
        raise InputError(
            "expected a video, and by its name this is a table", where=given.source, cure=cure
        )
    try:
        return make_detector(given.observed_by, max_width=max_width, mask=given.mask, **parameters)
    except InputError as error:
        # In the user's own words: detector.min_area, not the record of settings that refused the
        # value.
        setting = error.where.rpartition(".")[2]
        if setting in parameters:
            where = f"detector.{setting}"
        else:
            where = error.where or "--detector"
        raise InputError(error.problem, where=where, cure=error.cure) from error


def _blank(given: SourceOptions, path: Path, table: DetectionTable, last: int) -> VideoSource:
    """Frames without pictures, where there are detections only; size and rate by options, or
    seqinfo.ini.
    """
    found = find_seqinfo(path) or SequenceInfo(0, 0, 0.0, 0, path.stem)
    width, height = (
        frame_size(given.frame_size) if given.frame_size else (found.width, found.height)
    )
    fps = given.fps or found.fps
    where_else = "or put a seqinfo.ini beside the file or one folder up, or name the video."
    if not width or not height:
        raise InputError(
            "the size of the frames is not known",
            where=path,
            cure=f"Say --frame-size WxH, {where_else}",
        )
    if not fps:
        raise InputError(
            "the rate of the frames is not known", where=path, cure=f"Say --fps F, {where_else}"
        )
    info = replace(
        found, width=width, height=height, fps=fps, frames=max(found.frames, table.last, last)
    )
    walked = partial(frames_walked, table, info.frames, fps)
    return VideoSource(
        info,
        lambda _: ((number, (number - 1) / fps, NO_PICTURE, "") for number in walked()),
        zero=0.0,
    )


def comes_again(source: str) -> bool:
    """Whether the frames can be read a second time: not those of a camera or of a stream on the
    network.
    """
    return "://" not in source and not (source.isdecimal() and not Path(source).exists())


@contextmanager
def ahead(items: Iterable[T], depth: int = DEPTH) -> Iterator[Iterator[T]]:
    """The same items in the same order, made by a thread of their own while earlier ones are used.

    It begins when the first item is asked for. An error of a stage is raised in the loop after the
    items before it. When the block is left, by an error or Ctrl-C too, the stage is stopped, and
    waited for a while: nothing still runs or holds a file afterwards, but for a read that hangs. At
    most ``depth`` items are being made or wait to be taken.
    """
    iterator = iter(items)
    ended = threading.Event()
    # Items with the error after the last of them; a place for each item that may be under way.
    made = queue.SimpleQueue[tuple[T | None, BaseException | None]]()
    places = threading.Semaphore(depth)

    def stage() -> None:
        error: BaseException | None = StopIteration()
        try:
            while places.acquire() and not ended.is_set():
                made.put((next(iterator), None))
        except BaseException as stop:
            error = stop
        finally:
            if isinstance(iterator, Generator):
                # Here and not by the garbage collector: files are closed by the thread that used
                # them.
                iterator.close()
            made.put((None, error))

    def taken() -> Iterator[T]:
        # Not before: what a detector learns of a scene and the decoder of its frames would be in
        # memory at the same time.
        thread.start()
        while True:
            item, error = made.get()
            if item is not None:
                places.release()
                yield item
                continue
            if error is not None and not isinstance(error, StopIteration):
                raise error
            return

    thread = threading.Thread(target=stage, name="phdtrack stage", daemon=True)
    try:
        yield taken()
    finally:
        ended.set()
        places.release()
        if thread.ident is not None:
            thread.join(_PATIENCE)
