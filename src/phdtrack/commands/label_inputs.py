"""What a person labels: the detections of a whole sequence, and stills of some of its frames."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from phdtrack.commands.inputs import Inputs, comes_again, detected, open_inputs
from phdtrack.commands.output import Output, progress
from phdtrack.commands.wanted import DEFAULT_DETECTOR, Wanted
from phdtrack.errors import InputError
from phdtrack.formats import DetectionsWriter, read_detections
from phdtrack.overlap import ahead
from phdtrack.types import DetectionTable, Frame, SequenceInfo


@dataclass(frozen=True, slots=True)
class Labelled:
    """A sequence to label: ``source`` is empty where there are detections only; ``last`` is its last frame."""

    source: str
    info: SequenceInfo
    table: DetectionTable
    last: int
    digest: str


def to_label(wanted: Wanted, parameters: dict[str, Any], labels: Path, result: Output) -> Labelled:
    """The detections of everything that the options name; a detector's are kept in a file beside ``labels``.

    Without either the default detector looks. So a detector runs once, and the boxes that somebody marked are the same
    when he goes on tomorrow. Raises `InputError` as `open_inputs`, and where there is nothing to label.
    """
    if wanted.source and not comes_again(wanted.source):
        raise InputError("frames of a camera come once only", where=wanted.source, cure="Record a video and label that")
    if wanted.detections is None and not wanted.detector:
        wanted = replace(wanted, detector=DEFAULT_DETECTOR)
    inputs = open_inputs(wanted, parameters)
    for sentence in inputs.warnings:
        result.warn(sentence)
    if wanted.detections is not None:
        table, last = read_detections(wanted.detections), max(inputs.info.frames, 1)
        last = max(last, table.last) if not wanted.source or not inputs.info.frames else last
    else:
        path = _kept_at(labels, wanted, parameters)
        if path.exists():
            result.note(f"the detections are those of {path}")
        else:
            _detect(inputs, path)
        table = read_detections(path)
        last = max(inputs.info.frames, table.last)
    if len(table) == 0:
        raise InputError("there are no detections to label", where=wanted.source or wanted.detections or "")
    return Labelled(wanted.source, inputs.info, table, last, _digest(table))


def stills(source: str, fps: float, numbers: Collection[int]) -> dict[int, bytes]:
    """The frames ``numbers`` of a video as JPEG; the video is read up to the last of them."""
    import cv2

    from phdtrack.video import open_source

    kept: dict[int, bytes] = {}
    if not source or not numbers:
        return kept
    last = max(numbers)
    with progress("reading frames", last) as advance, ahead(_until(iter(open_source(source, fps=fps)), last)) as frames:
        for frame in frames:
            if frame.number in numbers:
                done, data = cv2.imencode(".jpg", frame.image, [cv2.IMWRITE_JPEG_QUALITY, 92])
                if done:
                    kept[frame.number] = data.tobytes()
            advance(frame.number)
    return kept


def beside(source: str, detections: Path | None) -> Path:
    """The file of labels that goes with a video, or with detections."""
    path = Path(source) if source else detections
    if path is None:
        raise InputError("nothing to label", where="SOURCE", cure="Name a video, or say --detections FILE")
    return path.with_name(f"{path.stem if path.is_file() else path.name}.labels.sqlite")


def _until(frames: Iterator[Frame], last: int) -> Iterator[Frame]:
    for frame in frames:
        yield frame
        if frame.number >= last:
            return


def _detect(inputs: Inputs, path: Path) -> None:
    """Run the detector over everything; the file appears when it is whole."""
    part = path.with_name(path.name + ".part")
    try:
        with (
            DetectionsWriter(part) as writer,
            progress("detecting", inputs.info.frames) as advance,
            ahead(inputs.source) as pictures,
            ahead(detected(inputs.detector, pictures)) as looked,
        ):
            for frame, found, _ in looked:
                writer.append(frame.number, found)
                advance(frame.number)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def _kept_at(labels: Path, wanted: Wanted, parameters: dict[str, Any]) -> Path:
    """Where the detections of this detector with these parameters are kept."""
    more = [parameters, wanted.max_width, str(wanted.mask or ""), wanted.fps]
    told = hashlib.sha256(json.dumps(more, sort_keys=True, default=str).encode()).hexdigest()[:8]
    return labels.with_name(f"{labels.stem}.{wanted.detector}-{told}.detections.csv")


def _digest(table: DetectionTable) -> str:
    return hashlib.sha256(table.frame.tobytes() + table.detections.xyxy.round(3).tobytes()).hexdigest()[:32]
