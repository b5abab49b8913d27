"""``phdtrack learn``: where people enter this scene, and where the detector is wrong in it, for `track --scene`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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
from phdtrack.cli.output import Output, counted
from phdtrack.errors import InputError

if TYPE_CHECKING:
    from phdtrack.scene.training import Training
    from phdtrack.types import Image


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
            "--clutter",
            metavar="FROM",
            help="labels: marked with `phdtrack label`; unattended: suggested, unchecked.",
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
    from phdtrack.cli.label import labels_file, stills, to_label
    from phdtrack.cli.training import (
        TrainingData,
        births_by_hand,
        births_of_tracks,
        clutter_of_labels,
        clutter_unattended,
        watched_tracks,
    )
    from phdtrack.config import build, load
    from phdtrack.report.pages import SceneTraining, scene_page
    from phdtrack.scene import Scene, write_scene

    result = Output(json)
    _one_of(births, ("tracks", "hand"), "--births")
    _one_of(clutter, ("labels", "unattended"), "--clutter")
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
    stretch = _stretch(first, last, found.last)
    data = TrainingData(found, stretch, build(settings, found.info), seed, file)
    alarms = clutter_unattended(data) if clutter == "unattended" else clutter_of_labels(data)
    result.say(alarms.sentence)
    marked = clutter == "labels" and alarms.lesson is not None
    seen = watched_tracks(data, alarms.lesson, marked=marked) if marked or births == "tracks" else None
    if seen is not None and seen.sentence:
        result.say(seen.sentence)
    born = births_by_hand(data) if seen is None or births == "hand" else births_of_tracks(data, seen.tracks)
    result.say(born.sentence)
    if born.lesson is None and alarms.lesson is None:
        raise InputError(
            "nothing could be learned", where=str(source or detections), cure="Mark false detections, or learn longer"
        )
    gains = {"births": born.gain, "clutter": alarms.gain}
    notes = {f"{part} gain": value for part, value in gains.items() if math.isfinite(value)}
    scene = Scene(
        found.info.width,
        found.info.height,
        data.stages.model.rate,
        source or str(detections),
        born.lesson.learned if born.lesson else None,
        alarms.lesson.learned if alarms.lesson else None,
        notes | {"births from": births, "clutter from": clutter, "first": stretch.start, "last": stretch.stop - 1},
        seen.followed if seen is not None else None,
    )
    write_scene(target, scene)
    page = target.with_name(target.name.removesuffix(".json") + ".html")
    use = f"phdtrack track {source or f'--detections {detections}'} --scene {target}"
    named = (("Births", born.lesson), ("False alarms", alarms.lesson))
    lead = " ".join(_summary(what, lesson) for what, lesson in named if lesson is not None)
    lessons = SceneTraining(scene, _picture(stills(source, fps, [1])), born.gain, alarms.gain, born.source, alarms.source)
    page.write_text(scene_page(lessons, lead, use), encoding="utf-8")
    result.say(f"{target}, with its maps in {page}; use it: {use}")
    followed = scene.followed.share if scene.followed is not None else None
    about = {"gain": gains, "births": births, "clutter": clutter, "followed": followed}
    result.document({"scene": str(target), "report": str(page)} | about)


def _one_of(value: str, known: tuple[str, ...], option: str) -> None:
    if value not in known:
        raise InputError(f"expected {' or '.join(known)}, got {value!r}", where=option)


def _stretch(first: int, last: int, end: int) -> range:
    """The frames to learn from. Raises `InputError` where there are none."""
    stretch = range(first, min(last or end, end) + 1)
    if not stretch:
        raise InputError(f"there are no frames from {first} to {stretch.stop - 1}", where="--first", cure="Begin earlier")
    return stretch


def _summary(what: str, lesson: Training) -> str:
    return f"{what}: {counted(len(lesson.learned.density), 'place')} from {counted(lesson.learned.samples, 'sample')}."


def _picture(pictures: dict[int, bytes]) -> Image:
    """The first still, or no picture."""
    import cv2
    import numpy as np

    for data in pictures.values():
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        if image is not None:
            return np.asarray(image, np.uint8)
    return np.zeros((0, 0, 3), np.uint8)
