"""``phdtrack learn``: where people enter this scene, and where the detector is wrong in it, for `track --scene`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from phdtrack.cli.options import (
    Config,
    DetectionsFile,
    Detector,
    Fps,
    FrameSize,
    Json,
    LabelsFile,
    Mask,
    MaxWidth,
    Overwrite,
    Preset,
    Recorded,
    Seed,
    Sets,
    Wanted,
)
from phdtrack.cli.output import Output
from phdtrack.errors import InputError


def learn(
    source: Recorded = "",
    detections: DetectionsFile = None,
    detector: Detector = "",
    labels: LabelsFile = None,
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
    overwrite: Overwrite = False,
    config: Config = None,
    sets: Sets = None,
    preset: Preset = "",
    seed: Seed = 0,
    frame_size: FrameSize = "",
    fps: Fps = 0.0,
    max_width: MaxWidth = 0,
    mask: Mask = None,
    json: Json = False,
) -> None:
    """Learn where people enter and where the detector is wrong: births from the tracker's own tracks, or marked by hand;
    false alarms from the marks that a person made (`phdtrack label`), or unattended."""
    from phdtrack.cli.inputs import NO_PICTURE
    from phdtrack.cli.label import labels_file, to_label
    from phdtrack.cli.training import TrainingData, train
    from phdtrack.config import build, load
    from phdtrack.report.pages import scene_page
    from phdtrack.scene import write_scene
    from phdtrack.video import open_source

    result = Output(json)
    for option, value, known in (("--births", births, ("tracks", "hand")), ("--clutter", clutter, ("labels", "unattended"))):
        if value not in known:
            raise InputError(f"expected {' or '.join(known)}, got {value!r}", where=option)
    wanted = Wanted(source, detections, detector, frame_size, fps, max_width, mask)
    file = labels or labels_file(source, detections)
    asked = clutter == "labels" or births == "hand"
    if asked and labels is not None and not labels.exists():
        raise InputError("there is no such file of labels", where=labels, cure="Make one: phdtrack label")
    target = out or file.with_name(file.name.removesuffix(".labels.sqlite") + ".scene.json")
    if target.exists() and not overwrite:
        raise InputError("this file is there already", where=target, cure="Say --overwrite, or choose another --out")
    settings = load(config, tuple(sets or ()), preset)
    found = to_label(wanted, settings.detector, file, result)
    stretch = range(first, min(last or found.last, found.last) + 1)
    if not stretch:
        raise InputError(f"there are no frames from {first} to {stretch.stop - 1}", where="--first", cure="Begin earlier")
    data = TrainingData(found, stretch, build(settings, found.info), seed, file)
    picture = next((frame.image for frame in open_source(source, fps=fps)), NO_PICTURE) if source else NO_PICTURE
    lessons, lead = train(data, births, clutter, source or str(detections), picture, result)
    scene = lessons.scene
    write_scene(target, scene)
    page = target.with_name(target.name.removesuffix(".json") + ".html")
    use = f"phdtrack track {source or f'--detections {detections}'} --scene {target}"
    page.write_text(scene_page(lessons, lead, use), encoding="utf-8")
    result.say(f"{target}, with its maps in {page}; use it: {use}")
    followed = scene.followed.share if scene.followed is not None else None
    gains = {"births": lessons.births_gain, "clutter": lessons.clutter_gain}
    about = {"gain": gains, "births": births, "clutter": clutter, "followed": followed}
    result.document({"scene": str(target), "report": str(page)} | about)
