"""``phdtrack learn``: where people enter a scene, and where the detector is wrong in it.

It learns from marks that a person made with `phdtrack label`, or from the tracker's own tracks and
the detections that would be suggested to a person.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from phdtrack.cli import options as given
from phdtrack.cli.options import option
from phdtrack.cli.output import Output
from phdtrack.errors import InputError
from phdtrack.files import write_text
from phdtrack.label import LabelStore
from phdtrack.label.learn_scene import SceneTraining, Trained
from phdtrack.label.samples import Marks
from phdtrack.label.sequences import LabelledSequence, first_picture, labels_file, open_sequence
from phdtrack.report.pages import render
from phdtrack.run.choices import chosen_settings
from phdtrack.run.requests import SourceRequest, TrackingRequest
from phdtrack.scene import write_scene


def learn(
    source: SourceRequest,
    output: Output,
    labels: given.Labels = None,
    births: Annotated[
        str, option("FROM", "Where objects enter: tracks, where tracks begin; hand, as marked.")
    ] = "tracks",
    clutter: Annotated[
        str, option("FROM", "False alarms: labels, as marked; unattended, as guessed.")
    ] = "labels",
    first: Annotated[int, option("N", "Learn from this frame on", min=1)] = 1,
    last: Annotated[int, option("N", "Learn up to this frame. Default: to the end.", min=0)] = 0,
    out: Annotated[
        Path | None, option("FILE", "Scene file to write. Default: beside the labels.")
    ] = None,
    overwrite: given.Overwrite = False,
    config: given.Config = None,
    sets: given.Sets = None,
    preset: given.Preset = "",
    seed: given.Seed = 0,
    blur: given.Blur = "",
    max_file_size: given.MaxFileSize = "",
) -> None:
    """Learn where people enter and where the detector is wrong: births from the tracker's own
    tracks, or marked by hand; false alarms from the marks that a person made (`phdtrack label`), or
    unattended."""
    _check_choice("--births", births, ("tracks", "hand"))
    _check_choice("--clutter", clutter, ("labels", "unattended"))
    file = labels or labels_file(source)
    by_hand = clutter == "labels" or births == "hand"
    if labels is not None and by_hand and not labels.exists():
        cure = "Make one: phdtrack label"
        raise InputError("there is no such file of labels", where=labels, cure=cure)
    target = out or file.with_name(file.name.removesuffix(".labels.sqlite") + ".scene.json")
    if target.exists() and not overwrite:
        cure = "Say --overwrite, or choose another --out"
        raise InputError("this file exists already", where=target, cure=cure)
    tracking = TrackingRequest(preset=preset, config=config, sets=sets, seed=seed)
    settings = chosen_settings(tracking, detector=source.detector_name)
    sequence = open_sequence(source, settings.values("detector"), file, output)
    stretch = _stretch(first, last, sequence.info.frames)
    marks = None
    if by_hand and file.exists():
        store = LabelStore.open(file, sequence.name, sequence.digest, [])
        marks = Marks(store, sequence.table, sequence.info, stretch, sequence.clock)
    with output.progress("tracking", len(stretch)) as advance:
        trained = SceneTraining(
            source=sequence.name,
            info=sequence.info,
            table=sequence.table,
            stretch=stretch,
            classes=sequence.stages(settings),
            seed=seed,
            marks=marks,
            labels=file,
            advance=advance,
            clock=sequence.clock,
            background=sequence.background,
        ).train(births, clutter)
    output.say(*trained.sentences)
    nothing = trained.scene.births is None and trained.scene.clutter is None
    if nothing and clutter == "unattended":
        output.warn(["nothing was learned: tracks with this scene are those without"])
    elif nothing:
        cure = "Mark false detections with `phdtrack label`, or use a longer video."
        raise InputError("nothing could be learned", where=sequence.name, cure=cure)
    write_scene(target, trained.scene)
    page = _write_page(target, trained, sequence, source, blur, output)
    document = {
        "scene": str(target),
        "report": str(page),
        "gain": {"births": trained.births.gain, "clutter": trained.alarms.gain},
        "births": births,
        "clutter": clutter,
        "followed": trained.scene.followed and trained.scene.followed.share,
    }
    output.document(document)


def _check_choice(option: str, value: str, choices: tuple[str, ...]) -> None:
    """Raise `InputError` if the value is not one of the choices."""
    if value not in choices:
        raise InputError(f"expected {' or '.join(choices)}, got {value!r}", where=option)


def _stretch(first: int, last: int, frames: int) -> range:
    """The frames to learn from. Raises `InputError` if there are none."""
    stretch = range(first, min(last or frames, frames) + 1)
    if not stretch:
        problem = f"there are no frames from {first} to {stretch.stop - 1}"
        raise InputError(problem, where="--first", cure="Begin earlier")
    return stretch


def _write_page(
    target: Path,
    trained: Trained,
    sequence: LabelledSequence,
    source: SourceRequest,
    blur: str,
    output: Output,
) -> Path:
    """Write a page with maps of the scene beside it, and print how to use it."""
    page = target.with_name(target.name.removesuffix(".json") + ".html")
    subject = source.source or f"--detections {source.detections}"
    use = f"phdtrack track {subject} --scene {target}"
    text = render(
        "scene.html",
        title="Learned scene",
        command=use,
        scene=trained.scene,
        births=trained.births,
        alarms=trained.alarms,
        image=first_picture(sequence, source, blur),
    )
    write_text(page, text)
    output.say(f"{target}, with its maps in {page}; use it: {use}")
    return page
