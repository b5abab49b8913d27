"""The inputs of a run: a video, a video with detections, or detections alone.

Every source becomes frames and a detector. Without a video the frames have empty pictures, and the
detector looks its boxes up by frame number.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from phdtrack.addresses import shown
from phdtrack.conventions import Conventions
from phdtrack.detect import TableDetector, make_detector
from phdtrack.detect.base import (
    Describer,
    Detector,
    StudiesScene,
    class_names,
    prepared,
    unwrapped,
)
from phdtrack.detect.convert import within_frame
from phdtrack.detect.detectors import working_width
from phdtrack.detect.scene_knowledge import study
from phdtrack.detect.table_detector import frames_walked
from phdtrack.errors import InputError
from phdtrack.files import return_memory
from phdtrack.formats import DetectionsWriter, find_seqinfo, read_detections
from phdtrack.formats.checks import MalformedRows
from phdtrack.kernels.cache import are_kept
from phdtrack.kernels.planes import smooth
from phdtrack.run.camera_input import open_camera
from phdtrack.run.camera_motion import Mover
from phdtrack.run.loop import NO_PICTURE, DetectedFrame, detect_frames
from phdtrack.run.pipeline_threads import ahead, beside
from phdtrack.run.reporter import SILENT, Reporter
from phdtrack.run.requests import (
    WHOLE,
    FrameRange,
    ReadingRequest,
    SourceRequest,
    frame_size,
    refuse,
)
from phdtrack.run.standard_input import open_standard_input
from phdtrack.types import DetectionTable, Frame, SequenceInfo
from phdtrack.video import VideoSource, open_source

TABLES = (".txt", ".csv", ".tsv", ".json", ".jsonl", ".xml", ".parquet")
SOUNDS = (".aac", ".aiff", ".flac", ".m4a", ".mp3", ".oga", ".ogg", ".opus", ".wav", ".wma")
# Share of a file from which on the number of frames is estimated; from _CERTAIN on, fewer than
# _CUT of those that its header announces are the sign of a file that was cut short.
_ENOUGH = 0.03
_CERTAIN = 0.25
_CUT = 0.6


class Descriptors(NamedTuple):
    """The source of embeddings.

    Attributes
    ----------
    name : for run.json: ``colours``, ``onnx:FILE`` or the file with a row for each detection; empty
        for none.
    describer : makes them of the pictures; None if they are in a file, or for none.
    dtype : type of the numbers that the run keeps.
    """

    name: str = ""
    describer: Describer | None = None
    dtype: str = "float16"


NO_DESCRIPTORS = Descriptors()


@dataclass(frozen=True, slots=True)
class Inputs:
    """The frames and the detector of a run.

    Attributes
    ----------
    info, source, detector : the sequence, its frames, and what detects objects in them.
    name : for people.
    described : where the detections come from: name of a detector, or a file.
    pictures : whether the frames have pictures.
    again : whether the frames can be read a second time (a camera's cannot).
    warnings : sentences about the files.
    names : what the detector or the file calls its classes; None without classes.
    classes : classes that there may be; None if unknown.
    dropped_rows : malformed rows, for run.json.
    max_width : of the pictures that the detector gets; 0 for their own.
    last_detected : last frame of which a file has detections.
    files : paths that are read; None or empty for none.
    descriptors : the source of embeddings.
    """

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
    dropped_rows: Mapping[str, object] = field(default_factory=dict)
    max_width: int = 0
    last_detected: int = 0
    files: tuple[object, ...] = ()
    descriptors: Descriptors = NO_DESCRIPTORS


Watch = Callable[[int, int], None]
"""Takes the number of frames that were read of so many, 0 if that is unknown."""


def unwatched(done: int, total: int) -> None:
    """Watch nothing."""


def study_scene(inputs: Inputs, watch: Watch = unwatched) -> None:
    """Let a detector that learns the scene study a file before its first frame: all of it,
    whatever part is tracked.

    Parameters
    ----------
    inputs : frames and detector.
    watch : called for each frame that is read, if any are.
    """
    studies = isinstance(unwrapped(inputs.detector), StudiesScene)
    if not (studies and inputs.pictures and inputs.again):
        return
    loading: AbstractContextManager[None] = nullcontext()
    if are_kept():
        # Numba itself takes a third of a second to start; the samples are decoded meanwhile.
        loading = beside(_load_first_kernel)
    whole = replace(inputs.source, first=1, last=0)

    def watched(frames: Iterable[Frame], total: int) -> Iterator[Frame]:
        for frame in frames:
            watch(frame.number, total)
            yield frame

    def sample(count: int) -> Iterator[Frame]:
        return watched(inputs.source.sample(count), count)

    watch(0, 0)
    # At most two pictures at a time: the samples take memory, too.
    with loading, ahead(whole, 1) as frames:
        study(inputs.detector, watched(frames, inputs.source.announced), sample)
    return_memory()


def _load_first_kernel() -> None:
    """Start Numba with the first kernel that a detector needs to study the scene."""
    smooth(np.zeros(6, np.uint8), (2, 2))


@contextmanager
def detected_frames(
    inputs: Inputs, mover: Mover | None = None, watch: Watch = unwatched
) -> Iterator[Iterator[DetectedFrame]]:
    """Every frame with its detections; decoding and detecting overlap with what follows.

    Parameters
    ----------
    inputs : frames and detector.
    mover : the camera's motion; None for a camera that stands still.
    watch : as `study_scene` takes it.
    """
    study_scene(inputs, watch)
    with (
        ahead(prepared(inputs.detector, inputs.source)) as pictures,
        ahead(
            detect_frames(inputs.detector, pictures, mover, inputs.descriptors.describer)
        ) as detected,
    ):
        yield detected


def write_detected(
    inputs: Inputs, path: Path, reporter: Reporter = SILENT
) -> Iterator[DetectedFrame]:
    """Detect objects in all frames; gives each frame when its detections are in the file.

    Parameters
    ----------
    inputs : frames and detector.
    path : the file.
    reporter : shows progress.
    """
    with (
        DetectionsWriter(path, inputs.names) as writer,
        reporter.progress("detecting") as advance,
        detected_frames(inputs) as detected,
    ):
        for count, one in enumerate(detected, start=1):
            writer.append(one.frame.number, one.detections)
            advance(count, **expected_end(inputs.source, count, "detecting"))
            yield one


def expected_end(source: VideoSource, done: int, title: str) -> dict[str, Any]:
    """The arguments of a progress bar: the number of frames, and its description.

    The header of a file is believed unless there are more frames already, or the part read so far
    tells of far fewer, as in a file that is cut short. Without a header it is estimated.

    Parameters
    ----------
    source : the frames.
    done : how many were read.
    title : of the bar.
    """
    before = source.first - 1
    done = done + before
    estimate = 0
    if source.share > _ENOUGH:
        estimate = round(done / source.share)
    cut = source.share > _CERTAIN and done < _CUT * source.share * source.announced
    total = source.info.frames
    if not total and not cut and done <= source.announced:
        total = source.announced
    end = min(filter(None, (total or estimate, source.last)), default=before)
    estimated = not total and estimate
    return {
        "total": end - before or None,
        "description": f"{title} (end estimated)" if estimated else title,
    }


def open_inputs(
    request: SourceRequest,
    parameters: Mapping[str, Any],
    last: int = 0,
    part: FrameRange = WHOLE,
) -> Inputs:
    """Open what a request names.

    Parameters
    ----------
    request : what to read.
    parameters : the detector's own settings.
    last : the last annotated frame: a sequence without a video is at least that long.
    part : the frames to track.

    Returns
    -------
    Frames, detector, and what is known of both.

    Raises
    ------
    InputError : options do not go together, or something cannot be read.
    """
    if not 0 <= request.fps < math.inf:
        raise InputError(f"expected frames per second above 0, got {request.fps:g}", where="--fps")
    streamed = request.detections == Path("-")
    if part != WHOLE and (streamed or not readable_again(request.source)):
        problem = "frames can be chosen of files only, and this is a stream"
        raise InputError(problem, where="--frames", cure="Leave it out.")
    if streamed:
        return _open_stream(request)
    if request.detections is None:
        return _open_video(request, parameters, part)
    return _open_table(request, request.detections, last, part)


def _open_stream(request: SourceRequest) -> Inputs:
    """Detections from standard input; size and rate from the options."""
    unused = {
        "SOURCE": request.source,
        "--detector": request.detector,
        "--max-width": request.max_width is not None,
        "--mask": request.mask,
        "--detect-again": request.detect_again,
    }
    refuse(unused, "detections from standard input have no pictures", "--detections -")
    stated = request.reading.options()
    refuse(stated, "standard input is MOTChallenge or CSV in pixels", "--detections -")
    skipping = {"--on-error": request.on_error == "skip"}
    refuse(skipping, "a malformed row of a stream ends it", "--detections -")
    needed = {"--frame-size WxH": request.frame_size, "--fps F": request.fps}
    for option, value in needed.items():
        if not value:
            problem = "size and rate of the frames are not known"
            raise InputError(problem, where="--detections -", cure=f"Say {option}.")
    source, detector = open_standard_input(frame_size(request.frame_size), request.fps)
    name = "standard input"
    return Inputs(source.info, source, detector, name, name, pictures=False, again=False)


def _open_video(request: SourceRequest, parameters: Mapping[str, Any], part: FrameRange) -> Inputs:
    """A video or a camera, and a detector."""
    refuse(request.reading.options(), "there is no file of detections", "say --detections")
    # Wrong settings are found before anything is opened.
    _detector(request, parameters, request.max_width or 0)
    source = _frames(request, part)
    width = working_width(request.detector_name, request.max_width, source.info)
    detector = _detector(request, parameters, width)
    names = class_names(detector)
    return Inputs(
        source.info,
        source,
        detector,
        shown(request.source),
        request.detector_name,
        pictures=True,
        again=readable_again(request.source),
        names=names,
        classes=frozenset(names) if names else None,
        max_width=width,
    )


def _open_table(request: SourceRequest, path: Path, last: int, part: FrameRange) -> Inputs:
    """A file of detections, with a video or without."""
    unused = {
        "--detector": request.detector not in ("", "file"),
        "--max-width": request.max_width is not None,
        "--mask": request.mask,
        "--detect-again": request.detect_again,
    }
    problem = f"the detections come from {path}, so there is no detector that this could change"
    refuse(unused, problem, "--detections")
    wrong = None
    if request.on_error != "stop":
        wrong = MalformedRows()
    notices = list[str]()
    table = read_request_detections(request, wrong, notices)
    if request.source:
        frames = _frames(request, part)
    else:
        frames = _blank_frames(request, path, table, last)
        known = find_seqinfo(path)
        if known is not None and 0 < known.frames < table.last:
            notices.append(
                f"{path}: detections up to frame {table.last}, and seqinfo.ini has {known.frames}"
                " frames"
            )
    frames.first, frames.last = part
    stated = request.reading
    usable, sentences = within_frame(table, frames.info, path, units=stated.units, box=stated.box)
    warnings = (*notices, *sentences)
    latest = int(usable.frame.max(initial=0))
    classes = frozenset(np.unique(usable.detections.class_id).tolist())
    inputs = Inputs(
        frames.info,
        frames,
        TableDetector(usable),
        shown(request.source) or str(path),
        str(path),
        pictures=bool(request.source),
        again=not request.source or readable_again(request.source),
        warnings=warnings,
        last_detected=min(latest, part[1] or latest),
    )
    if wrong:
        inputs = replace(
            inputs, warnings=(*wrong.sentences(), *warnings), dropped_rows=wrong.document()
        )
    if usable.names or classes - {0}:
        inputs = replace(inputs, names=usable.names, classes=classes)
    return inputs


def read_request_detections(
    request: SourceRequest, left_out: MalformedRows | None, notices: list[str]
) -> DetectionTable:
    """The detections in the file that a request names. Raises `InputError` if it is malformed.

    Parameters
    ----------
    request : the file, and how it is to be read.
    left_out : counts malformed rows, which are then skipped; None: they are errors.
    notices : receives sentences about guesses.
    """
    assert request.detections is not None
    return read_detections(
        request.detections,
        left_out=left_out,
        conventions=request_conventions(request, request.reading),
        notices=notices,
    )


def request_conventions(request: SourceRequest, reading: ReadingRequest) -> Conventions:
    """How a file of boxes of a source is to be read. Raises `InputError` for unknown words, and for
    a source that is needed and cannot be opened.

    Parameters
    ----------
    request : the source, whose size is that of boxes in shares, and whose name is that of the video
        to read of a file with several.
    reading : the words of the user for this file.
    """
    size = frame_size(request.frame_size) if request.frame_size else (0, 0)
    if request.source and reading.units == "shares":
        info = _frames(request, WHOLE).info
        size = (info.width, info.height)
    if request.source and not reading.sequence:
        reading = replace(reading, sequence=Path(request.source).stem)
    return reading.conventions(size)


def _frames(request: SourceRequest, part: FrameRange) -> VideoSource:
    """The video. Raises `InputError` if the request names another frame size than its own, or a
    sound file.
    """
    if Path(request.source).suffix.lower() in SOUNDS and readable_again(request.source):
        problem = "expected a video, and by its name this is a sound file"
        raise InputError(problem, where=request.source, cure="It has no pictures: name a video.")
    if readable_again(request.source):
        source = open_source(request.source, fps=request.fps, first=part[0], last=part[1])
        if source.times is None and not request.fps:
            source = _at_stated_rate(source, request.source)
    else:
        source = open_camera(request.source)
    size = (source.info.width, source.info.height)
    if request.frame_size and frame_size(request.frame_size) != size:
        own = f"{size[0]}x{size[1]}"
        problem = f"{request.source} has frames of {own} pixels, not {request.frame_size}"
        cure = "Leave it out: it is for detections without a video."
        raise InputError(problem, where="--frame-size", cure=cure)
    return source


def _at_stated_rate(images: VideoSource, path: str) -> VideoSource:
    """Images at the rate that a seqinfo.ini beside them states, if there is one."""
    with suppress(InputError):
        info = find_seqinfo(path)
        if info is not None:
            return open_source(path, fps=info.fps, first=images.first, last=images.last)
    return images


def _detector(request: SourceRequest, parameters: Mapping[str, Any], max_width: int) -> Detector:
    """The detector that a request names. Raises `InputError` if there is none, or no pictures."""
    if request.detector == "file":
        problem = "the detector file reads a file of detections"
        raise InputError(problem, where="--detector", cure="Say --detections FILE.")
    if not request.source:
        cure = "Name a video, a folder of images or a camera's number; or say --detections FILE."
        raise InputError("nothing to work on", where="SOURCE", cure=cure)
    if Path(request.source).suffix.lower() in TABLES:
        problem = "expected a video, and by its name this is a table"
        cure = f"For detections say --detections {request.source}."
        raise InputError(problem, where=request.source, cure=cure)
    try:
        return make_detector(
            request.detector_name, max_width=max_width, mask=request.mask, **parameters
        )
    except InputError as error:
        # In the user's own words: detector.min_area, not the record of settings that refused the
        # value.
        setting = error.where.rpartition(".")[2]
        where = error.where or "--detector"
        if setting in parameters:
            where = f"detector.{setting}"
        raise InputError(error.problem, where=where, cure=error.cure) from error


def _blank_frames(
    request: SourceRequest, path: Path, table: DetectionTable, last: int
) -> VideoSource:
    """Frames without pictures for a file of detections; size and rate from the options, or from
    seqinfo.ini.
    """
    info = find_seqinfo(path) or SequenceInfo(0, 0, 0.0, 0, path.stem)
    width = info.width
    height = info.height
    if request.frame_size:
        width, height = frame_size(request.frame_size)
    fps = request.fps or info.fps
    where_else = "or put a seqinfo.ini beside the file or one folder up, or name the video."
    if not fps and not (width and height):
        cure = f"Say --frame-size WxH and --fps F, {where_else}"
        raise InputError("the size and the rate of the frames are not known", where=path, cure=cure)
    if not width or not height:
        cure = f"Say --frame-size WxH, {where_else}"
        raise InputError("the size of the frames is not known", where=path, cure=cure)
    if not fps:
        cure = f"Say --fps F, {where_else}"
        raise InputError("the rate of the frames is not known", where=path, cure=cure)
    frames = max(info.frames, table.last, last)
    info = replace(info, width=width, height=height, fps=fps, frames=frames)
    numbers = partial(frames_walked, table, info.frames, fps)
    return VideoSource(
        info,
        lambda _: ((number, (number - 1) / fps, NO_PICTURE, "") for number in numbers()),
        zero=0.0,
    )


def readable_again(source: str) -> bool:
    """True if the frames can be read a second time: not those of a camera or a network stream."""
    return "://" not in source and not (source.isdecimal() and not Path(source).exists())
