"""``phdtrack label`` and ``phdtrack learn``: a person, or the tracker itself, teaches where people
enter a scene and where the detector is wrong in it.

`label` is a page on which false detections, and births, are marked on frames drawn at random.
`learn` makes a scene of the marks, or of the tracker's own tracks and of what would be suggested to
a person, for `phdtrack track --scene`.
"""

from __future__ import annotations

import hashlib
import json
import shlex
import webbrowser
from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Annotated, Any

import cv2
import typer

from phdtrack import __version__
from phdtrack.arrays import pixelated
from phdtrack.cli import options as given
from phdtrack.cli.options import PageOptions, SourceOptions, TrackingOptions, option
from phdtrack.cli.output import Output, counted, progress
from phdtrack.cli.show_settings import chosen
from phdtrack.config import Settings, build, load
from phdtrack.devices import size_of
from phdtrack.errors import InputError
from phdtrack.files import write_text
from phdtrack.formats import read_detections
from phdtrack.formats.annotations import AnnotationFile, read_annotated
from phdtrack.formats.checks import WrongRows
from phdtrack.label import LabelStore
from phdtrack.label.exchange import Exchange, frames_of
from phdtrack.label.learn_scene import SceneTraining
from phdtrack.label.samples import LONGEST, Marks, clip, shuffled
from phdtrack.label.suggestions import Background, Evidence, Suggestion, suggest
from phdtrack.report.pages import render
from phdtrack.run.detection_log import source_of
from phdtrack.run.inputs import NO_PICTURE, Inputs, ahead, comes_again, open_inputs, write_detected
from phdtrack.scene import write_scene
from phdtrack.types import DetectionTable, Frame, Image, SequenceInfo
from phdtrack.video import open_source

_CLIP_WIDTH = 640
# Where marks are kept unless another file is named; a video's run is a directory in it.
_RUNS = Path("runs")


def label(
    source: SourceOptions,
    at: PageOptions,
    labels: given.Labels = None,
    frames: Annotated[int, option("N", "How many frames to draw.", min=1)] = 40,
    seed: Annotated[int, option("N", "Seed of the draw.", min=0)] = 0,
    suggest: Annotated[
        bool, typer.Option("--suggest/--no-suggest", help="Look for detections that may be false.")
    ] = True,
    labeller: Annotated[
        str, option("NAME", "Who labels: each mark says who made it. The page can change it.")
    ] = "",
    taken: Annotated[
        Path | None, option("FILE", "Take the marks of a COCO or CVAT file, and end.", "--import")
    ] = None,
    out: Annotated[
        Path | None, option("FILE", "Write COCO (.json), CVAT (.xml) or .csv, and end.", "--export")
    ] = None,
    overwrite: given.Overwrite = False,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page in a browser.")
    ] = True,
    blur: given.Blur = "",
    config: given.Config = None,
    sets: given.Sets = None,
) -> None:
    """Mark false detections, missed objects and births on frames drawn at random: the page says
    how. Every click is kept at once.

    Meanwhile a tracker looks for detections that may be false and suggests them. Ctrl-C ends.
    """
    from phdtrack.label.label_page import Session, label_app
    from phdtrack.web.serving import listen, serve

    output = Output()
    settings = load(config, sets or ())
    file = labels or labels_file(source)
    found = to_label(source, settings.values("detector"), file, output)
    if taken:
        read = read_annotated(taken)
    else:
        read = None
    if out and not read and not file.exists():
        raise InputError(
            "there is no such file of labels", where=file, cure="Make one: phdtrack label"
        )
    drawn = (frames_of(read) if read else []) or shuffled(found.info.frames, seed)[
        : 0 if out and not read else frames
    ]
    if max(drawn, default=0) > found.info.frames:
        problem = f"expected frames up to {found.info.frames}, came {max(drawn)}"
        raise InputError(problem, where=str(taken), cure="Is it of another video?")
    store = LabelStore.open(file, found.name, found.digest, drawn)
    if read or out:
        _exchange(
            Exchange(store, found.table, found.info), read, labeller, (out, overwrite), output
        )
        return
    numbers = [number for number, _ in store.frames()]
    around = {frame for number in numbers for frame in clip(number, found.info.frames)}
    pictures = _stills(source, numbers, around, partial(_shown, found.table, blur))
    address = listen(at.host, at.port, at.allow_host or (), at.certificate, at.key, store.ports)
    kept = file.with_name(file.name.removesuffix(".sqlite") + ".suggestions.json")
    if suggest:
        work = Background(partial(_suggestions, found, settings, numbers, kept))
    else:
        work = None
    command = _learn_command(source, file, {"config": config, "set": sets, "blur": blur})
    session = Session(store, found.table, pictures, found.info, work, command, labeller)
    state = store.progress()
    output.say(
        f"{counted(state.frames, 'frame')}, {state.done} of them looked at; the marks are kept in"
        f" {file}"
    )
    output.say(f"the page: {address.url}   (Ctrl-C ends)")
    if browser:
        webbrowser.open(address.url)
    serve(label_app(session), address)
    state = store.progress()
    looked = f"{state.done} of {counted(state.frames, 'frame')} looked at"
    output.say(f"{looked}, {state.false} false, {counted(state.births, 'birth')}: {file}")
    done = state.done == state.frames
    output.say(
        f"{'now run' if done else 'the same command goes on; when all are looked at, run'}:"
        f" {session.learn(state)}"
    )


def _exchange(
    labels: Exchange,
    read: AnnotationFile | None,
    labeller: str,
    to: tuple[Path | None, bool],
    output: Output,
) -> None:
    """Take the marks that were read, if any, and write all to a file, if one is named, which may be
    there if the second of ``to`` is true; say what was done."""
    if read:
        it = labels.import_file(read, labeller)
        objects = f"{counted(it.objects, 'object')} with a detection, {it.drawn} without"
        output.say(
            f"taken: {counted(it.false, 'false alarm')}, {objects}; {counted(it.done, 'frame')}"
            " done"
        )
        missing = f"{counted(it.unmatched, 'false alarm')} left out: the detector has none there"
        elsewhere = (
            f"{counted(it.elsewhere, 'box')} left out: on frames that are not drawn, see --frames"
        )
        output.warn([missing] * (it.unmatched > 0) + [elsewhere] * (it.elsewhere > 0))
    out, overwrite = to
    if out is not None:
        if (kind := out.suffix.removeprefix(".")) not in ("json", "xml", "csv"):
            raise InputError(
                f"expected a file that ends in .json, .xml or .csv, came {out.name}",
                where="--export",
            )
        if out.exists() and not overwrite:
            raise InputError(
                "the file is there already",
                where=out,
                cure="Say --overwrite, or choose another file.",
            )
        write_text(out, labels.text(kind))
        output.say(f"the marks: {out}")


def _learn_command(source: SourceOptions, labels: Path, more: dict[str, Any]) -> str:
    """The command that learns from these labels: with the options that were given here, as they
    decide what is detected.
    """
    default = SourceOptions(source.source, detect_again=source.detect_again)
    given = {field.name: getattr(source, field.name) for field in fields(source)}
    named = {name: value for name, value in given.items() if value != getattr(default, name)} | {
        "labels": labels
    }
    words = ["phdtrack", "learn", *filter(None, [source.source])]
    for name, value in (named | {name: value for name, value in more.items() if value}).items():
        for one in value if isinstance(value, list) else [value]:
            words += [f"--{name.replace('_', '-')}", str(one)]
    return shlex.join(words)


@dataclass(frozen=True, slots=True)
class Labelled:
    """A sequence to label: the ``name`` of the video or of the detections, and a ``digest`` of the
    detections.
    """

    name: str
    info: SequenceInfo
    table: DetectionTable
    digest: str


def to_label(
    source: SourceOptions, parameters: dict[str, Any], labels: Path, output: Output
) -> Labelled:
    """The detections of everything that the options name; a detector's are kept in a file beside
    ``labels``.

    Without either the default detector looks. So a detector runs once, and the marked boxes are the
    same when a person goes on another day. Raises `InputError` as `open_inputs`, and where there is
    nothing to label.
    """
    if source.source and not comes_again(source.source):
        raise InputError(
            "frames of a camera come once only",
            where=source.source,
            cure="Record a video and label that",
        )
    inputs = open_inputs(source, parameters)
    output.warn(inputs.warnings)
    if labels.parent == _RUNS:
        _RUNS.mkdir(exist_ok=True)
    if source.on_error == "stop":
        left_out = None
    else:
        left_out = WrongRows()
    table = read_detections(
        source.detections or _kept_detections(source, parameters, labels, inputs, output),
        left_out=left_out,
    )
    if len(table) == 0:
        raise InputError("there are no detections to label", where=inputs.name)
    # Of detections alone, and of some videos, it is not known how many frames there are.
    if (last := inputs.info.frames or table.last) > LONGEST:
        problem = (
            f"expected a sequence of at most {LONGEST:,} frames to draw from, came one that ends"
            f" with frame {last}"
        )
        raise InputError(
            problem, where=inputs.name, cure="Is a frame number wrong? Otherwise cut the sequence."
        )
    digest = hashlib.sha256(
        table.frame.tobytes() + table.detections.xyxy.round(3).tobytes()
    ).hexdigest()[:32]
    return Labelled(inputs.name, replace(inputs.info, frames=last), table, digest)


def _kept_detections(
    source: SourceOptions, parameters: dict[str, Any], labels: Path, inputs: Inputs, output: Output
) -> Path:
    """The file of what the detector sees, by video, detector and settings; it appears when it is
    whole.
    """
    more = [
        source_of(str(Path(source.source).resolve())),
        parameters,
        inputs.max_width,
        str(source.mask or ""),
        source.fps,
    ]
    name, _, network = source.observed_by.partition(":")
    more += [source_of(network)] if network else []
    digest = hashlib.sha256(json.dumps(more, sort_keys=True, default=str).encode()).hexdigest()[:8]
    path = labels.with_name(f"{labels.stem}.{name}-{digest}.detections.csv")
    if path.exists() and not source.detect_again:
        output.note(f"the detections are those of {path}")
        return path
    part = path.with_name(path.name + ".part")
    try:
        for _ in write_detected(inputs, part):
            pass
        return part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def _stills(
    source: SourceOptions,
    numbers: Collection[int],
    around: Collection[int],
    shown: Callable[[Frame], Image],
) -> dict[int, bytes]:
    """The frames ``numbers`` of a video as JPEG, as they are to be ``shown``, and those ``around``
    them as small ones; it is read up to the last."""
    kept = dict[int, bytes]()
    if not source.source or not numbers:
        return kept
    last = max(around)
    frames = islice(open_source(source.source, fps=source.fps), last)
    with progress("reading frames", last) as advance, ahead(frames) as pictures:
        for frame in pictures:
            whole = frame.number in numbers
            width, height = size_of(frame)
            if whole or frame.number in around:
                small = not whole and width > _CLIP_WIDTH
                image = shown(frame)
                if small:
                    image = cv2.resize(image, (_CLIP_WIDTH, round(height * _CLIP_WIDTH / width)))
                else:
                    image = image
                _, data = cv2.imencode(
                    ".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 92 if whole else 80]
                )
                kept[frame.number] = data.tobytes()
            advance(frame.number)
    return kept


def _shown(table: DetectionTable, blur: str, frame: Frame) -> Image:
    """A frame with its detections hidden, if need be."""
    return pixelated(frame.image, table.at(frame.number).xyxy, blur)


def _suggestions(
    found: Labelled,
    settings: Settings,
    frames: list[int],
    file: Path,
    advance: Callable[[float], None],
) -> list[Suggestion]:
    """What may be false on these frames, by a tracker's run over everything; kept in ``file`` for
    the next time.
    """
    fps = found.info.fps
    last = found.info.frames
    decides = [__version__, found.digest, fps, last, sorted(frames), settings.as_dict()]
    key = hashlib.sha256(json.dumps(decides, default=str).encode()).hexdigest()
    # There may be no such file, or another program's: they are made anew.
    with suppress(OSError, ValueError, KeyError, TypeError):
        kept = json.loads(file.read_text(encoding="utf-8"))
        if kept["key"] == key:
            return [Suggestion(*row) for row in kept["rows"]]
    stages = build(settings, found.info)
    whole = range(1, last + 1)
    evidence = Evidence.of(
        found.table, fps, whole, stages, advance=lambda count: advance(count / last)
    )
    made = suggest(evidence, frames)
    write_text(file, json.dumps({"key": key, "rows": made}) + "\n")
    return made


def labels_file(source: SourceOptions) -> Path:
    """The file of labels that goes with a video, or with detections: among the runs, so that
    nothing is written into an archive of videos. One beside the video, where earlier versions kept
    it, is gone on with."""
    path = Path(source.source) if source.source else source.detections
    if path is None:
        raise InputError(
            "nothing to label", where="SOURCE", cure="Name a video, or say --detections FILE"
        )
    beside = path.with_name(f"{path.stem if path.is_file() else path.name}.labels.sqlite")
    if beside.exists():
        return beside
    return _RUNS / beside.name


def learn(
    source: SourceOptions,
    output: Output,
    labels: given.Labels = None,
    births: Annotated[
        str, option("FROM", "tracks: where tracks begin; hand: marked with `phdtrack label`.")
    ] = "tracks",
    clutter: Annotated[
        str, option("FROM", "labels: marked with `phdtrack label`; unattended: not checked.")
    ] = "labels",
    first: Annotated[int, option("N", "Learn from this frame on.", min=1)] = 1,
    last: Annotated[int, option("N", "Learn up to this frame; 0: all.", min=0)] = 0,
    out: Annotated[
        Path | None, option("FILE", "Where to write the scene; default: next to the labels.")
    ] = None,
    overwrite: given.Overwrite = False,
    config: given.Config = None,
    sets: given.Sets = None,
    preset: given.Preset = "",
    seed: given.Seed = 0,
    blur: given.Blur = "",
) -> None:
    """Learn where people enter and where the detector is wrong: births from the tracker's own
    tracks, or marked by hand; false alarms from the marks that a person made (`phdtrack label`), or
    unattended."""
    for name, value, known in (
        ("--births", births, ("tracks", "hand")),
        ("--clutter", clutter, ("labels", "unattended")),
    ):
        if value not in known:
            raise InputError(f"expected {' or '.join(known)}, got {value!r}", where=name)
    file = labels or labels_file(source)
    by_hand = clutter == "labels" or births == "hand"
    if labels is not None and by_hand and not labels.exists():
        raise InputError(
            "there is no such file of labels", where=labels, cure="Make one: phdtrack label"
        )
    target = out or file.with_name(file.name.removesuffix(".labels.sqlite") + ".scene.json")
    if target.exists() and not overwrite:
        raise InputError(
            "this file is there already",
            where=target,
            cure="Say --overwrite, or choose another --out",
        )
    settings = chosen(
        TrackingOptions(preset=preset, config=config, sets=sets), detector=source.observed_by
    )
    found = to_label(source, settings.values("detector"), file, output)
    stretch = range(first, min(last or found.info.frames, found.info.frames) + 1)
    if not stretch:
        raise InputError(
            f"there are no frames from {first} to {stretch.stop - 1}",
            where="--first",
            cure="Begin earlier",
        )
    marks = None
    if by_hand and file.exists():
        marks = Marks(
            LabelStore.open(file, found.name, found.digest, []), found.table, found.info, stretch
        )
    stages = build(settings, found.info)
    info = found.info
    with progress("tracking", len(stretch)) as advance:
        training = SceneTraining(
            found.name, info, found.table, stretch, stages, seed, marks, file, advance
        )
        scene, born, alarms, sentences = training.train(births, clutter)
    output.say(*sentences)
    if scene.births is None and scene.clutter is None and clutter == "unattended":
        output.warn(["nothing was learned: tracks with this scene are those without"])
    elif scene.births is None and scene.clutter is None:
        raise InputError(
            "nothing could be learned",
            where=found.name,
            cure="Mark false detections, or learn longer",
        )
    write_scene(target, scene)
    frames = open_source(source.source, fps=source.fps) if source.source else ()
    picture = next((_shown(found.table, blur, frame) for frame in frames), NO_PICTURE)
    page = target.with_name(target.name.removesuffix(".json") + ".html")
    use = f"phdtrack track {source.source or f'--detections {source.detections}'} --scene {target}"
    words = {"title": "Learned scene", "command": use}
    write_text(
        page, render("scene.html", scene=scene, births=born, alarms=alarms, image=picture, **words)
    )
    output.say(f"{target}, with its maps in {page}; use it: {use}")
    gain = {"births": born.gain, "clutter": alarms.gain}
    followed = scene.followed and scene.followed.share
    document = {
        "scene": str(target),
        "report": str(page),
        "gain": gain,
        "births": births,
        "clutter": clutter,
    }
    output.document(document | {"followed": followed})
