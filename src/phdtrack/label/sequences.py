"""The sequence that is labelled or learned from: its detections, its pictures, and suggestions."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

from phdtrack import __version__
from phdtrack.arrays import pixelated
from phdtrack.clock import Clock
from phdtrack.config import Settings, build_classes
from phdtrack.detect import BACKGROUND
from phdtrack.devices import size_of
from phdtrack.errors import InputError
from phdtrack.files import write_text
from phdtrack.formats import read_detections
from phdtrack.formats.checks import MalformedRows
from phdtrack.label.samples import LONGEST
from phdtrack.label.suggestions import Evidence, Suggestion, suggest
from phdtrack.multiclass import ClassSettings
from phdtrack.opencv_package import cv2
from phdtrack.run.detection_log import source_of
from phdtrack.run.inputs import (
    Inputs,
    open_inputs,
    read_request_detections,
    readable_again,
    write_detected,
)
from phdtrack.run.loop import NO_PICTURE
from phdtrack.run.pipeline_threads import ahead
from phdtrack.run.reporter import SILENT, Reporter
from phdtrack.run.requests import SourceRequest
from phdtrack.types import DetectionTable, Frame, Image, SequenceInfo
from phdtrack.video import open_source

_CLIP_WIDTH = 640
# Where marks are kept unless another file is named; a video's run is a directory in it.
_RUNS = Path("runs")


@dataclass(frozen=True, slots=True)
class LabelledSequence:
    """A sequence to label.

    Attributes
    ----------
    name : of the video or of the detections.
    info, table : the sequence and its detections.
    digest : of the detections.
    classes : that there may be; None if unknown.
    clock : the times of the frames; None for a constant rate.
    background : whether a background detector finds the detections.
    """

    name: str
    info: SequenceInfo
    table: DetectionTable
    digest: str
    names: Mapping[int, str] | None = None
    classes: frozenset[int] | None = None
    clock: Clock | None = None
    background: bool = False

    def stages(self, settings: Settings) -> ClassSettings:
        """The stages of its classes."""
        return build_classes(settings, self.info, self.names, self.classes)


def open_sequence(
    source: SourceRequest,
    parameters: Mapping[str, Any],
    labels: Path,
    reporter: Reporter = SILENT,
) -> LabelledSequence:
    """All detections of a source; a detector's are kept in a file beside ``labels``.

    So a detector runs once, and the marked boxes are the same when a person continues on another
    day. Raises `InputError` as `open_inputs`, and if there is nothing to label.

    Parameters
    ----------
    source, parameters : what to read, and the detector's own settings.
    labels : the file of labels.
    reporter : receives progress and sentences.
    """
    if source.source and not readable_again(source.source):
        problem = "frames of a camera cannot be read again"
        raise InputError(problem, where=source.source, cure="Record a video and label that")
    inputs = open_inputs(source, parameters)
    reporter.warn([*inputs.warnings, *filter(None, [inputs.source.note])])
    if labels.parent == _RUNS:
        _RUNS.mkdir(exist_ok=True)
    wrong = None
    if source.on_error != "stop":
        wrong = MalformedRows()
    if source.detections is None:
        path = _kept_detections(source, parameters, labels, inputs, reporter)
        table = read_detections(path, left_out=wrong)
    else:
        # What was guessed is among the warnings of the inputs.
        table = read_request_detections(source, wrong, [])
    if len(table) == 0:
        raise InputError("there are no detections to label", where=inputs.name)
    # The number of frames is not known of detections alone, and of some videos.
    last = inputs.info.frames or table.last
    if last > LONGEST:
        problem = (
            f"expected a sequence of at most {LONGEST:,} frames to draw from, got one that ends"
            f" with frame {last}"
        )
        cure = "Is a frame number wrong? Otherwise cut the sequence."
        raise InputError(problem, where=inputs.name, cure=cure)
    content = table.frame.tobytes() + table.detections.xyxy.round(3).tobytes()
    digest = hashlib.sha256(content).hexdigest()[:32]
    info = replace(inputs.info, frames=last)
    clock = inputs.source.clock()
    background = inputs.described in BACKGROUND
    return LabelledSequence(
        inputs.name, info, table, digest, inputs.names, inputs.classes, clock, background
    )


def _kept_detections(
    source: SourceRequest,
    parameters: Mapping[str, Any],
    labels: Path,
    inputs: Inputs,
    reporter: Reporter,
) -> Path:
    """The file of a detector's detections, by video, detector and settings; it appears when it is
    complete.
    """
    decided_by = [
        source_of(str(Path(source.source).resolve())),
        parameters,
        inputs.max_width,
        str(source.mask or ""),
        source.fps,
    ]
    name, _, network = source.detector_name.partition(":")
    if network:
        decided_by.append(source_of(network))
    text = json.dumps(decided_by, sort_keys=True, default=str)
    digest = hashlib.sha256(text.encode()).hexdigest()[:8]
    path = labels.with_name(f"{labels.stem}.{name}-{digest}.detections.csv")
    if path.exists() and not source.detect_again:
        reporter.note(f"the detections are those of {path}")
        return path
    part = path.with_name(path.name + ".part")
    try:
        for _ in write_detected(inputs, part, reporter):
            pass
        return part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def still_pictures(
    source: SourceRequest,
    numbers: Collection[int],
    around: Collection[int],
    hide: Callable[[Frame], Image],
    reporter: Reporter = SILENT,
) -> dict[int, bytes]:
    """Frames of a video as JPEG, by number; it is read up to the last.

    Parameters
    ----------
    source : the video; without one there are no pictures.
    numbers, around : frames of full size, and small ones.
    hide : gives the picture of a frame.
    reporter : shows progress.
    """
    kept = dict[int, bytes]()
    if not source.source or not numbers:
        return kept
    last = max(around)
    frames = islice(open_source(source.source, fps=source.fps), last)
    with reporter.progress("reading frames", last) as advance, ahead(frames) as pictures:
        for frame in pictures:
            number = frame.number
            if number in numbers:
                kept[number] = _jpeg(hide(frame), 92)
            elif number in around:
                width, height = size_of(frame)
                image = hide(frame)
                if width > _CLIP_WIDTH:
                    image = cv2.resize(image, (_CLIP_WIDTH, round(height * _CLIP_WIDTH / width)))
                kept[number] = _jpeg(image, 80)
            advance(number)
    return kept


def _jpeg(image: Any, quality: int) -> bytes:
    """The picture as JPEG."""
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    content: bytes = data.tobytes()
    return content


def hidden_picture(table: DetectionTable, blur: str, frame: Frame) -> Image:
    """The picture of a frame, with its detections pixelated.

    Parameters
    ----------
    table : the detections.
    blur : ``boxes``, ``faces`` or nothing.
    frame : the frame.
    """
    return pixelated(frame.image, table.at(frame.number).xyxy, blur)


def first_picture(sequence: LabelledSequence, source: SourceRequest, blur: str) -> Image:
    """The first picture of the video, (H, W, 3) BGR; an empty one if there is none.

    Parameters
    ----------
    sequence, source : the detections and the video.
    blur : as for `hidden_picture`.
    """
    if source.source:
        for frame in open_source(source.source, fps=source.fps):
            return hidden_picture(sequence.table, blur, frame)
    return NO_PICTURE


def suggestions(
    sequence: LabelledSequence,
    settings: Settings,
    frames: list[int],
    file: Path,
    advance: Callable[[float], None],
) -> list[Suggestion]:
    """Detections that may be false, by a tracker's run over the whole sequence.

    Parameters
    ----------
    sequence, settings : what to track, and how.
    frames : the frames of which suggestions are made.
    file : keeps the suggestions for the next time.
    advance : is called with the share that is done.
    """
    clock = sequence.clock or Clock.constant(sequence.info.fps)
    times = hashlib.sha256(clock.seconds.round(6).tobytes()).hexdigest()
    last = sequence.info.frames
    decided_by = [
        __version__,
        sequence.digest,
        clock.rate,
        times,
        last,
        sorted(frames),
        settings.as_dict(),
    ]
    key = hashlib.sha256(json.dumps(decided_by, default=str).encode()).hexdigest()
    # There may be no such file, or another program's: they are made anew.
    with suppress(OSError, ValueError, KeyError, TypeError):
        kept = json.loads(file.read_text(encoding="utf-8"))
        if kept["key"] == key:
            return [Suggestion(*row) for row in kept["rows"]]
    evidence = Evidence.of(
        sequence.table,
        clock,
        range(1, last + 1),
        sequence.stages(settings),
        advance=lambda count: advance(count / last),
    )
    size = (float(sequence.info.width), float(sequence.info.height))
    evidence = replace(evidence, frame_size=size, background=sequence.background)
    made = suggest(evidence, frames)
    write_text(file, json.dumps({"key": key, "rows": made}) + "\n")
    return made


def labels_file(source: SourceRequest) -> Path:
    """The file of labels for a source: among the runs, so that nothing is written into an archive
    of videos.
    """
    path = Path(source.source) if source.source else source.detections
    if path is None:
        cure = "Name a video, or say --detections FILE"
        raise InputError("nothing to label", where="SOURCE", cure=cure)
    name = path.stem if path.is_file() else path.name
    return _RUNS / f"{name}.labels.sqlite"
