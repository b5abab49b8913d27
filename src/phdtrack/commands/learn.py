"""``phdtrack learn``: where people enter this scene, and where the detector is wrong in it, for `track --scene`."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from phdtrack.commands.options import (
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
)
from phdtrack.commands.output import Output, counted, progress
from phdtrack.commands.wanted import Wanted
from phdtrack.errors import InputError

if TYPE_CHECKING:
    from phdtrack.commands.label_inputs import Labelled
    from phdtrack.context.learning import Lesson
    from phdtrack.protocols import AnyStages
    from phdtrack.types import Image, Tracks


def learn(
    source: Recorded = "",
    detections: DetectionsFile = None,
    detector: Detector = "",
    labels: LabelsFile = None,
    last: Annotated[int, typer.Option("--last", metavar="N", min=0, help="Learn births up to this frame; 0: all.")] = 0,
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
    """Learn births from the tracker's own tracks, and false alarms from the marks that a person made (`phdtrack label`)."""
    from phdtrack.commands.configured import detector_parameters
    from phdtrack.commands.label_inputs import beside, stills, to_label
    from phdtrack.config import build, load
    from phdtrack.context import Scene, write_scene
    from phdtrack.report.scene_report import Lessons, scene_page

    result = Output(json)
    wanted = Wanted(source, detections, detector, frame_size, fps, max_width, mask)
    file = labels or beside(source, detections)
    if labels is not None and not labels.exists():
        raise InputError("there is no such file of labels", where=labels, cure="Make one: phdtrack label")
    target = out or file.with_name(file.name.removesuffix(".labels.sqlite") + ".scene.json")
    if target.exists() and not overwrite:
        raise InputError("this file is there already", where=target, cure="Say --overwrite, or choose another --out")
    settings = load(config, tuple(sets or ()), preset)
    found = to_label(wanted, detector_parameters(config, tuple(sets or ())), file, result)
    clutter, sentence = _clutter(found, file)
    result.say(sentence)
    # Behind learned false alarms: tracks that only the scene's false alarms make are no births.
    stages = build(settings, found.info)
    births, sentence = _births(found, stages, min(last or found.last, found.last), seed, clutter)
    result.say(sentence)
    if births is None and clutter is None:
        raise InputError(
            "nothing could be learned", where=str(source or detections), cure="Mark false detections, or learn longer"
        )
    gains = {"births": births.gain if births else math.nan, "clutter": clutter.gain if clutter else math.nan}
    scene = Scene(
        found.info.width,
        found.info.height,
        stages.model.rate,
        source or str(detections),
        births.learned if births else None,
        clutter.learned if clutter else None,
        {f"{part} gain": value for part, value in gains.items() if math.isfinite(value)},
    )
    write_scene(target, scene)
    page = target.with_name(target.name.removesuffix(".json") + ".html")
    use = f"phdtrack track {source or f'--detections {detections}'} --scene {target}"
    lead = " ".join(_told(part) for part in (births, clutter) if part is not None) or ""
    lessons = Lessons(scene, _picture(stills(source, fps, [1])), gains["births"], gains["clutter"])
    page.write_text(scene_page(lessons, lead, use), encoding="utf-8")
    result.say(f"{target}, with its maps in {page}; use it: {use}")
    result.document({"scene": str(target), "report": str(page), "gain": gains})


def _births(found: Labelled, stages: AnyStages, last: int, seed: int, clutter: Lesson | None) -> tuple[Lesson | None, str]:
    """Births from the tracker's own run over the first ``last`` frames [M09 §IV]; why not, where they cannot be learned."""
    from phdtrack.context import RecursiveEM
    from phdtrack.context.learning import learn_births
    from phdtrack.context.samples import first_states

    rate = stages.model.rate
    states = first_states(_tracked(found, stages, last, seed, clutter), found.info.fps, rate)
    size = (float(found.info.width), float(found.info.height))
    try:
        lesson = learn_births(states, last / found.info.fps * rate, size, RecursiveEM())
    except InputError as error:
        return None, f"births stay uniform: {error}"
    return lesson, f"births: {counted(states.shape[1], 'track')} began in {counted(last, 'frame')}; {_worth(lesson)}"


def _tracked(found: Labelled, stages: AnyStages, last: int, seed: int, clutter: Lesson | None) -> Tracks:
    """The corrected tracks of the training stretch."""
    import numpy as np

    from phdtrack import pipeline
    from phdtrack.models.learned_scene import ContextClutter

    if clutter is not None:
        alarms = ContextClutter(clutter.learned.rate, clutter.learned.density)
        stages = replace(stages, model=replace(stages.model, clutter=alarms))
    frames = ((k, (k - 1) / found.info.fps, found.table.at(k)) for k in range(1, last + 1))
    rng = np.random.default_rng(seed)
    state = pipeline.start(stages, rng)
    with progress("tracking", last) as advance:
        for number, time, seen in frames:
            state, _ = pipeline.advance(stages, state, seen, number, time, rng)
            advance(number)
    return pipeline.finish(stages, state)


def _clutter(found: Labelled, labels: Path) -> tuple[Lesson | None, str]:
    """False alarms from marks, if there are any [M09 §IV]; why not, where they cannot be learned."""
    from phdtrack.context import RecursiveEM
    from phdtrack.context.learning import learn_clutter
    from phdtrack.label import LabelStore
    from phdtrack.label.session import false_boxes

    if not labels.exists():
        return None, f"false alarms stay uniform: nobody has marked any (phdtrack label, kept in {labels})"
    store = LabelStore.open(labels, found.source, found.digest, [])
    size, done = (float(found.info.width), float(found.info.height)), store.progress().done
    try:
        lesson = learn_clutter(false_boxes(store, found.table), done, size, RecursiveEM())
    except InputError as error:
        return None, f"false alarms stay uniform: {error}"
    told = f"false alarms: {counted(lesson.learned.samples, 'box')} marked on {counted(done, 'frame')}"
    return lesson, f"{told}; {_worth(lesson)}"


def _worth(lesson: Lesson) -> str:
    if not math.isfinite(lesson.gain):
        return "too few to tell what it is worth"
    return f"samples not learned from are {lesson.gain:+.2f} nats likelier than under a uniform density"


def _told(lesson: Lesson) -> str:
    p = lesson.learned.density
    what = "Births" if p.dim == 6 else "False alarms"
    return f"{what}: {counted(len(p), 'place')} from {counted(lesson.learned.samples, 'sample')}."


def _picture(pictures: dict[int, bytes]) -> Image:
    """The first still, or no picture."""
    import cv2
    import numpy as np

    for data in pictures.values():
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        if image is not None:
            return np.asarray(image, np.uint8)
    return np.zeros((0, 0, 3), np.uint8)
