"""``phdtrack label``: a page on which a person marks false detections, and births, on frames drawn
at random.
"""

from __future__ import annotations

import shlex
import webbrowser
from dataclasses import asdict, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from phdtrack.cli import options as given
from phdtrack.cli.options import PageOptions, option
from phdtrack.cli.output import Output, counted
from phdtrack.errors import InputError
from phdtrack.files import write_text
from phdtrack.formats.annotations import AnnotationFile, read_annotated
from phdtrack.label import LabelStore
from phdtrack.label.exchange import Exchange, frames_of
from phdtrack.label.samples import clip, shuffled
from phdtrack.label.sequences import (
    hidden_picture,
    labels_file,
    open_sequence,
    still_pictures,
    suggestions,
)
from phdtrack.label.store import last_labeller
from phdtrack.label.suggestions import Background
from phdtrack.run.choices import chosen_settings
from phdtrack.run.requests import SourceRequest, TrackingRequest

if TYPE_CHECKING:
    from phdtrack.label.label_page import Session


def label(
    source: SourceRequest,
    at: PageOptions,
    labels: given.Labels = None,
    frames: Annotated[int, option("N", "How many frames to draw", min=1)] = 40,
    seed: Annotated[int, option("N", "Seed of the draw.", min=0)] = 0,
    suggest: Annotated[
        bool,
        typer.Option(
            "--suggest/--no-suggest", help="Look for detections that may be false, or not."
        ),
    ] = True,
    labeller: Annotated[
        str,
        option(
            "NAME",
            "Who labels: kept with each mark. Default: as the last time. The page can change it.",
        ),
    ] = "",
    imported: Annotated[
        Path | None, option("FILE", "Import the marks of a COCO or CVAT file, and end.", "--import")
    ] = None,
    out: Annotated[
        Path | None,
        option(
            "FILE", "Write the marks as COCO (.json), CVAT (.xml) or .csv, and end.", "--export"
        ),
    ] = None,
    overwrite: given.Overwrite = False,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page in a browser, or not.")
    ] = True,
    blur: given.Blur = "",
    config: given.Config = None,
    sets: given.Sets = None,
    max_file_size: given.MaxFileSize = "",
) -> None:
    """Mark false detections, missed objects and births on frames drawn at random: the page says
    how. Every click is kept at once.

    Meanwhile a tracker looks for detections that may be false and suggests them. Ctrl-C ends.
    """
    from phdtrack.label.label_page import Session, label_app
    from phdtrack.web.serving import listen, serve

    output = Output()
    settings = chosen_settings(
        TrackingRequest(config=config, sets=sets), detector=source.detector_name
    )
    file = labels or labels_file(source)
    tracked = _without_video_name(source, imported)
    sequence = open_sequence(tracked, settings.values("detector"), file, output)
    read = _imported(imported, source)
    if not imported and out and not file.exists():
        cure = "Make one: phdtrack label"
        raise InputError("there is no such file of labels", where=file, cure=cure)
    drawn = _drawn(read, sequence.info.frames, seed, 0 if out and not read else frames)
    _check_frames(drawn, sequence.info.frames, imported)
    store = LabelStore.open(file, sequence.name, sequence.digest, drawn)
    if read or out:
        exchange = Exchange(store, sequence.table, sequence.info)
        if read:
            _import(exchange, read, labeller, output)
        if out:
            _export(exchange, out, output, overwrite=overwrite)
        return
    numbers = [number for number, _ in store.frames()]
    around = {frame for number in numbers for frame in clip(number, sequence.info.frames)}
    hide = partial(hidden_picture, sequence.table, blur)
    pictures = still_pictures(source, numbers, around, hide, output)
    # Before anything is suggested: a port may be taken.
    address = listen(at.host, at.port, at.allow_host or (), at.certificate, at.key, store.ports)
    # On this machine alone it is who labelled last, whatever the video.
    labeller = labeller or _known_labeller(file, output, alone=not address.token)
    work = None
    if suggest:
        kept = file.with_name(file.name.removesuffix(".sqlite") + ".suggestions.json")
        work = Background(partial(suggestions, sequence, settings, numbers, kept))
    command = _learn_command(tracked, file, {"config": config, "set": sets, "blur": blur})
    session = Session(
        store, sequence.table, pictures, sequence.info, work, command, labeller, sequence.clock
    )
    state = store.progress()
    output.say(
        f"{counted(state.frames, 'frame')}, {state.done} of them done; the marks are kept in {file}"
    )
    output.say(f"the page: {address.url}   (Ctrl-C ends)")
    if browser:
        webbrowser.open(address.url)
    serve(label_app(session), address)
    _print_progress(session, file, output)


def _known_labeller(file: Path, output: Output, *, alone: bool) -> str:
    """The name of who labelled last, which is told; empty unless the page is this machine's alone,
    because others may open it elsewhere.
    """
    name = last_labeller(file) if alone else ""
    if name:
        output.say(f"marks are kept under the name {name}; --labeller, or the page, sets it")
    return name


def _print_progress(session: Session, file: Path, output: Output) -> None:
    """Print how many frames are labelled, and the command that continues."""
    state = session.store.progress()
    done = f"{state.done} of {counted(state.frames, 'frame')} done"
    output.say(f"{done}, {state.false} false, {counted(state.births, 'birth')}: {file}")
    lead = "the same command continues; when all are done, run"
    if state.done == state.frames:
        lead = "now run"
    output.say(f"{lead}: {session.learn(state)}")


def _drawn(read: AnnotationFile | None, last: int, seed: int, count: int) -> list[int]:
    """The frames of a file of annotations, or ``count`` frames drawn at random."""
    named = frames_of(read) if read else []
    return named or shuffled(last, seed)[:count]


def _check_frames(drawn: list[int], last: int, imported: Path | None) -> None:
    """Raise `InputError` if an imported frame lies behind the last one."""
    if max(drawn, default=0) > last:
        problem = f"expected frames up to {last}, got {max(drawn)}"
        raise InputError(problem, where=str(imported), cure="Is it of another video?")


def _import(exchange: Exchange, read: AnnotationFile, labeller: str, output: Output) -> None:
    """Import marks."""
    counts = exchange.import_file(read, labeller)
    objects = f"{counted(counts.objects, 'object')} with a detection, {counts.drawn} without"
    false = counted(counts.false, "false alarm")
    output.say(f"imported: {false}, {objects}; {counted(counts.done, 'frame')} done")
    if counts.unmatched:
        number = counted(counts.unmatched, "false alarm")
        output.warn([f"{number} dropped: the detector has none there"])
    if counts.elsewhere:
        number = counted(counts.elsewhere, "box")
        output.warn([f"{number} dropped: on frames that are not drawn, see --frames"])


def _export(exchange: Exchange, out: Path, output: Output, *, overwrite: bool) -> None:
    """Write all marks to a file."""
    kind = out.suffix.removeprefix(".")
    if kind not in ("json", "xml", "csv"):
        problem = f"expected a file that ends in .json, .xml or .csv, got {out.name}"
        raise InputError(problem, where="--export")
    if out.exists() and not overwrite:
        cure = "Say --overwrite, or choose another file."
        raise InputError("the file exists already", where=out, cure=cure)
    write_text(out, exchange.text(kind))
    output.say(f"the marks: {out}")


def _imported(path: Path | None, source: SourceRequest) -> AnnotationFile | None:
    """The content of the file to import; None if there is none."""
    if path is None:
        return None
    return read_annotated(path, source.reading.sequence)


def _without_video_name(source: SourceRequest, imported: Path | None) -> SourceRequest:
    """The source without --sequence, if that can be of the file to import alone."""
    if imported is None or source.detections is not None:
        return source
    return replace(source, reading=replace(source.reading, sequence=""))


def _learn_command(source: SourceRequest, labels: Path, more: dict[str, Any]) -> str:
    """The command that learns from these labels, with the options that decide the detections."""
    default = SourceRequest(source.source, detect_again=source.detect_again)
    values = {
        field.name: getattr(source, field.name)
        for field in fields(source)
        if getattr(source, field.name) != getattr(default, field.name)
    }
    values.pop("reading", None)
    values |= {name: value for name, value in asdict(source.reading).items() if value}
    values["labels"] = labels
    values |= {name: value for name, value in more.items() if value}
    words = ["phdtrack", "learn", *filter(None, [source.source])]
    for name, value in values.items():
        for one in value if isinstance(value, list) else [value]:
            words += [f"--{name.replace('_', '-')}", str(one)]
    return shlex.join(words)
