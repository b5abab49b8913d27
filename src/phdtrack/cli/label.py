"""``phdtrack label``: a page on which a person marks false detections, and births, on frames drawn at random.

`to_label` gives the detections of a whole sequence, `stills` pictures of some of its frames; `phdtrack learn` uses both.
"""

from __future__ import annotations

import hashlib
import json
import webbrowser
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import typer

from phdtrack import __version__, pipeline
from phdtrack.cli import options as given
from phdtrack.cli.inputs import Inputs, ahead, comes_again, open_inputs, write_detected
from phdtrack.cli.options import DEFAULT_DETECTOR, SourceOptions, option
from phdtrack.cli.output import Advance, Output, counted, progress
from phdtrack.config import Settings, build, load
from phdtrack.errors import InputError
from phdtrack.formats import read_detections
from phdtrack.label import LabelStore
from phdtrack.label.samples import clip, sampled
from phdtrack.label.suggestions import Background, Evidence, Suggestion, kept, suggest
from phdtrack.protocols import AnyStages
from phdtrack.types import DetectionTable, SequenceInfo
from phdtrack.video import open_source

_CLIP_WIDTH = 640


def label(
    source: SourceOptions,
    labels: given.Labels = None,
    frames: Annotated[int, option("--frames", "N", "How many frames to draw.", min=1)] = 40,
    seed: Annotated[int, option("--seed", "N", "Seed of the draw.", min=0)] = 0,
    port: Annotated[int, option("--port", "N", "Port of the page; 0: any that is free.", min=0, max=65535)] = 0,
    host: Annotated[
        str, option("--host", "NAME", "Address to listen on; other machines need the token in the printed address.")
    ] = "127.0.0.1",
    suggest: Annotated[bool, typer.Option("--suggest/--no-suggest", help="Look for detections that may be false.")] = True,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in a browser.")] = True,
    config: given.Config = None,
    sets: given.Sets = None,
) -> None:
    """Mark false detections and births on frames drawn at random: the page says how. Every click is kept at once.

    Meanwhile a tracker looks for detections that may be false and suggests them. Ctrl-C ends.
    """
    try:
        from phdtrack.label.page import Session, label_app, listen, serve
    except ModuleNotFoundError as error:
        problem = f"the page needs the package {error.name}"
        raise InputError(problem, where="phdtrack label", cure="pip install 'phdtrack[web]'") from error
    output, settings = Output(), load(config, sets or ())
    file = labels or labels_file(source)
    found = to_label(source, settings.detector, file, output)
    store = LabelStore.open(file, found.name, found.digest, sampled(found.info.frames, frames, seed))
    numbers = [number for number, _ in store.frames()]
    around = {frame for number in numbers for frame in clip(number, found.info.frames)}
    pictures = stills(source, set(numbers), around)
    address = listen(host, port)
    kept = file.with_name(file.name.removesuffix(".sqlite") + ".suggestions.json")
    work = Background(partial(suggestions, found, settings, numbers, kept)) if suggest else None
    session = Session(store, found.table, pictures, found.info, work)
    state = store.progress()
    output.say(
        f"{counted(state.frames, 'frame')}, {state.done} of them looked at; the marks are kept in {file}",
        f"the page: {address.url}   (Ctrl-C ends)",
    )
    if browser:
        webbrowser.open(address.url)
    serve(label_app(session), address)
    state = store.progress()
    looked = f"{state.done} of {counted(state.frames, 'frame')} looked at"
    output.say(f"{looked}, {state.false} false, {counted(state.births, 'birth')}: {file}")


@dataclass(frozen=True, slots=True)
class Labelled:
    """A sequence to label: the ``name`` of the video or of the detections, and a ``digest`` of the detections."""

    name: str
    info: SequenceInfo
    table: DetectionTable
    digest: str


def to_label(source: SourceOptions, parameters: dict[str, Any], labels: Path, output: Output) -> Labelled:
    """The detections of everything that the options name; a detector's are kept in a file beside ``labels``.

    Without either the default detector looks. So a detector runs once, and the marked boxes are the same when a
    person goes on another day. Raises `InputError` as `open_inputs`, and where there is nothing to label.
    """
    if source.source and not comes_again(source.source):
        raise InputError("frames of a camera come once only", where=source.source, cure="Record a video and label that")
    inputs = open_inputs(source, parameters)
    output.warn(inputs.warnings)
    table = read_detections(source.detections or _kept_detections(source, parameters, labels, inputs, output))
    last = max(inputs.info.frames, 1)
    if source.detections is None or not source.source or not inputs.info.frames:
        last = max(last, table.last)
    name = source.source or str(source.detections)
    if len(table) == 0:
        raise InputError("there are no detections to label", where=name)
    digest = hashlib.sha256(table.frame.tobytes() + table.detections.xyxy.round(3).tobytes()).hexdigest()[:32]
    return Labelled(name, replace(inputs.info, frames=last), table, digest)


def _kept_detections(
    source: SourceOptions, parameters: dict[str, Any], labels: Path, inputs: Inputs, output: Output
) -> Path:
    """The file of what the detector sees, by its name and settings; it appears when it is whole."""
    more = [parameters, source.max_width, str(source.mask or ""), source.fps]
    digest = hashlib.sha256(json.dumps(more, sort_keys=True, default=str).encode()).hexdigest()[:8]
    path = labels.with_name(f"{labels.stem}.{source.detector or DEFAULT_DETECTOR}-{digest}.detections.csv")
    if path.exists():
        output.note(f"the detections are those of {path}")
        return path
    part = path.with_name(path.name + ".part")
    try:
        for _ in write_detected(inputs, part):
            pass
        return part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def stills(source: SourceOptions, numbers: Collection[int], around: Collection[int]) -> dict[int, bytes]:
    """The frames ``numbers`` of a video as JPEG, and those ``around`` them as small ones; it is read up to the last."""
    kept: dict[int, bytes] = {}
    if not source.source or not numbers:
        return kept
    last = max([*numbers, *around])
    frames = islice(open_source(source.source, fps=source.fps), last)
    with progress("reading frames", last) as advance, ahead(frames) as pictures:
        for frame in pictures:
            whole, (height, width) = frame.number in numbers, frame.image.shape[:2]
            if whole or frame.number in around:
                small = not whole and width > _CLIP_WIDTH
                image = cv2.resize(frame.image, (_CLIP_WIDTH, round(height * _CLIP_WIDTH / width))) if small else frame.image
                _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 92 if whole else 80])
                kept[frame.number] = data.tobytes()
            advance(frame.number)
    return kept


def suggestions(
    found: Labelled, settings: Settings, frames: list[int], file: Path, advance: Callable[[float], None]
) -> list[Suggestion]:
    """What may be false on these frames, by a tracker's run over everything; kept in ``file`` for the next time."""

    def made() -> list[Suggestion]:
        stages, whole = build(settings, found.info), range(1, found.info.frames + 1)
        evidence = tracked(found.table, found.info.fps, stages, whole, 0, lambda count: advance(count / found.info.frames))
        return suggest(evidence, frames, found.info.fps)

    decides = [__version__, found.digest, found.info.fps, found.info.frames, sorted(frames), settings.as_dict()]
    return kept(file, hashlib.sha256(json.dumps(decides, default=str).encode()).hexdigest(), made)


def labels_file(source: SourceOptions) -> Path:
    """The file of labels that goes with a video, or with detections."""
    path = Path(source.source) if source.source else source.detections
    if path is None:
        raise InputError("nothing to label", where="SOURCE", cure="Name a video, or say --detections FILE")
    return path.with_name(f"{path.stem if path.is_file() else path.name}.labels.sqlite")


def tracked(table: DetectionTable, fps: float, stages: AnyStages, frames: range, seed: int, advance: Advance) -> Evidence:
    """What a tracker makes of the detections of ``frames``; ``advance`` is called with the number of frames done.

    A filter that says nothing of false alarms (`filters.none`) leaves all probabilities at 0.
    """
    rows = np.arange(*np.searchsorted(table.frame, [frames.start, frames.stop]))
    rng, clutter = np.random.default_rng(seed), []
    given = ((number, (number - 1) / fps, table.at(number)) for number in frames)
    for after, step in pipeline.run(stages, given, rng):
        state, found = after, step.info.clutter_probability
        clutter.append(found if len(found) else np.zeros(len(step.detections)))
        advance(len(clutter))
    stretch = DetectionTable(table.frame[rows], table.detections.take(rows))
    return Evidence(stretch, frames.start, frames.stop - 1, np.concatenate(clutter), pipeline.finish(stages, state))
