"""``phdtrack learn``: where people enter this scene, and where the detector is wrong in it, for `track --scene`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from phdtrack.cli import options as given
from phdtrack.cli.options import SourceOptions
from phdtrack.cli.output import Output
from phdtrack.errors import InputError


def learn(
    source: SourceOptions,
    output: Output,
    labels: given.Labels = None,
    births: Annotated[
        str, typer.Option("--births", metavar="FROM", help="tracks: the tracker's own; hand: marked with `phdtrack label`.")
    ] = "tracks",
    clutter: Annotated[
        str,
        typer.Option(
            "--clutter", metavar="FROM", help="labels: marked with `phdtrack label`; unattended: suggested, unchecked."
        ),
    ] = "labels",
    first: Annotated[int, typer.Option("--first", metavar="N", min=1, help="Learn from this frame on.")] = 1,
    last: Annotated[int, typer.Option("--last", metavar="N", min=0, help="Learn up to this frame; 0: all.")] = 0,
    out: Annotated[Path | None, typer.Option("--out", metavar="FILE", help="Default: SOURCE.scene.json.")] = None,
    overwrite: given.Overwrite = False,
    config: given.Config = None,
    sets: given.Sets = None,
    preset: given.Preset = "",
    seed: given.Seed = 0,
) -> None:
    """Learn where people enter and where the detector is wrong: births from the tracker's own tracks, or marked by hand;
    false alarms from the marks that a person made (`phdtrack label`), or unattended."""
    from phdtrack.cli.inputs import NO_PICTURE
    from phdtrack.cli.label import labels_file, to_label
    from phdtrack.cli.training import TrainingData, train
    from phdtrack.config import build, load
    from phdtrack.report.pages import render
    from phdtrack.scene import write_scene
    from phdtrack.video import open_source

    for option, value, known in (("--births", births, ("tracks", "hand")), ("--clutter", clutter, ("labels", "unattended"))):
        if value not in known:
            raise InputError(f"expected {' or '.join(known)}, got {value!r}", where=option)
    file = labels or labels_file(source)
    if labels is not None and not labels.exists() and (clutter == "labels" or births == "hand"):
        raise InputError("there is no such file of labels", where=labels, cure="Make one: phdtrack label")
    target = out or file.with_name(file.name.removesuffix(".labels.sqlite") + ".scene.json")
    if target.exists() and not overwrite:
        raise InputError("this file is there already", where=target, cure="Say --overwrite, or choose another --out")
    settings = load(config, sets or (), preset)
    found = to_label(source, settings.detector, file, output)
    stretch = range(first, min(last or found.last, found.last) + 1)
    if not stretch:
        raise InputError(f"there are no frames from {first} to {stretch.stop - 1}", where="--first", cure="Begin earlier")
    data = TrainingData(found, stretch, build(settings, found.info), seed, file)
    frames = open_source(source.source, fps=source.fps) if source.source else ()
    picture = next((frame.image for frame in frames), NO_PICTURE)
    training, lead = train(data, births, clutter, picture, output)
    write_scene(target, training.scene)
    page = target.with_name(target.name.removesuffix(".json") + ".html")
    use = f"phdtrack track {source.source or f'--detections {source.detections}'} --scene {target}"
    text = render("scene.html", title="Learned scene", training=training, lead=lead, command=use)
    page.write_text(text, encoding="utf-8")
    output.say(f"{target}, with its maps in {page}; use it: {use}")
    followed = training.scene.followed
    output.document(
        {
            "scene": str(target),
            "report": str(page),
            "gain": {"births": training.births_gain, "clutter": training.clutter_gain},
            "births": births,
            "clutter": clutter,
            "followed": None if followed is None else followed.share,
        }
    )
