"""What a person labels: the detections of a whole sequence, and stills of some of its frames."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from phdtrack.cli.inputs import Inputs, comes_again, detected, open_inputs
from phdtrack.cli.output import Output, progress
from phdtrack.cli.pipeline_threads import ahead
from phdtrack.cli.wanted import DEFAULT_DETECTOR, Wanted
from phdtrack.errors import InputError
from phdtrack.formats import DetectionsWriter, read_detections
from phdtrack.types import DetectionTable, Frame, Image, SequenceInfo

if TYPE_CHECKING:
    from phdtrack.config import Settings
    from phdtrack.label.suggest import Suggestions

_CLIP_WIDTH = 640


@dataclass(frozen=True, slots=True)
class Labelled:
    """A sequence to label: ``source`` is empty where there are detections only; ``last``, also in ``info``, ends it."""

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
    return Labelled(wanted.source, replace(inputs.info, frames=last), table, last, _digest(table))


def stills(source: str, fps: float, numbers: Collection[int], around: Collection[int] = ()) -> dict[int, bytes]:
    """The frames ``numbers`` of a video as JPEG, and those ``around`` them as small ones; it is read up to the last."""
    from phdtrack.video import open_source

    kept: dict[int, bytes] = {}
    if not source or not numbers:
        return kept
    last = max([*numbers, *around])
    with progress("reading frames", last) as advance, ahead(_until(iter(open_source(source, fps=fps)), last)) as frames:
        for frame in frames:
            if frame.number in numbers:
                kept[frame.number] = _jpeg(frame.image, 92)
            elif frame.number in around:
                kept[frame.number] = _jpeg(_small(frame.image), 80)
            advance(frame.number)
    return kept


def suggestions(
    found: Labelled, settings: Settings, frames: list[int], file: Path, told: Callable[[float], None]
) -> Suggestions:
    """What may be false on these frames, by a tracker's run over everything; kept in ``file`` for the next time."""
    from phdtrack import __version__
    from phdtrack.cli.tracked import tracked
    from phdtrack.config import build
    from phdtrack.label.background import kept
    from phdtrack.label.suggest import suggest

    def made() -> Suggestions:
        stages, whole = build(settings, found.info), range(1, found.last + 1)
        evidence = tracked(found.table, found.info.fps, stages, whole, 0, lambda count: told(count / found.last))
        return suggest(evidence, frames, found.info.fps)

    decides = [__version__, found.digest, found.info.fps, found.last, sorted(frames), settings.as_dict()]
    return kept(file, hashlib.sha256(json.dumps(decides, default=str).encode()).hexdigest(), made)


def beside(source: str, detections: Path | None) -> Path:
    """The file of labels that goes with a video, or with detections."""
    path = Path(source) if source else detections
    if path is None:
        raise InputError("nothing to label", where="SOURCE", cure="Name a video, or say --detections FILE")
    return path.with_name(f"{path.stem if path.is_file() else path.name}.labels.sqlite")


def _small(image: Image) -> Image:
    """A frame of a clip: it is seen for a moment, and there are many."""
    import cv2

    height, width = image.shape[:2]
    scale = _CLIP_WIDTH / width
    return image if scale >= 1 else np.asarray(cv2.resize(image, (_CLIP_WIDTH, round(height * scale))), np.uint8)


def _jpeg(image: Image, quality: int) -> bytes:
    import cv2

    done, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    assert done
    return data.tobytes()


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
