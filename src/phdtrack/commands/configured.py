"""From options to a job: inputs opened, settings checked, stages built. Nothing is written yet: a mistake costs nothing."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from phdtrack import config, doctor
from phdtrack.commands.camera_companion import CameraCompanion
from phdtrack.commands.camera_motion import check_moving, mover_of
from phdtrack.commands.companions import together
from phdtrack.commands.inputs import Inputs, open_inputs
from phdtrack.commands.job import Companion, Job
from phdtrack.commands.learning_companion import LearningCompanion
from phdtrack.commands.rates_companion import RatesCompanion
from phdtrack.commands.steps import Steps
from phdtrack.commands.wanted import DEFAULT_DETECTOR, Wanted
from phdtrack.context import read_scene
from phdtrack.errors import InputError
from phdtrack.formats import read_truth
from phdtrack.models.followed_rates import FollowRates
from phdtrack.models.followed_scene import FollowScene
from phdtrack.protocols import Learning
from phdtrack.types import Truth


@dataclass(frozen=True, slots=True)
class Choice:
    """How to track. Empty text and None stand for an option that was not given; ``truth`` is the file to score against."""

    filter_name: str = ""
    preset: str = ""
    config: Path | None = None
    sets: tuple[str, ...] = ()
    seed: int = 0
    truth: Path | None = None
    threads: int | None = None
    scene: Path | None = None
    learn_online: bool = False
    camera_motion: str = ""


def chosen(choice: Choice) -> config.Settings:
    """The settings: those of preset and file with the options over them.

    Raises
    ------
    InputError : a file that cannot be read, an unknown name, options that do not go together.
    """
    online = ("learn.kind=online",) if choice.learn_online else ()
    moving = _camera_motion(choice.camera_motion)
    taught = scene_sets(choice.scene, choice) if choice.scene is not None and not choice.learn_online else ()
    settings = config.load(choice.config, (*_filter(choice), *online, *moving, *taught, *choice.sets), choice.preset)
    if choice.scene is not None and choice.learn_online:
        settings = config.overlay(settings, {"learn": {"file": str(choice.scene)}}, "--scene")
    if choice.threads is not None:
        settings = config.overlay(settings, _sharing(settings, choice.threads), "--threads")
    return settings


def _filter(choice: Choice) -> tuple[str, ...]:
    """``--filter`` as an assignment before all others, so that these may be settings of that filter."""
    name = choice.filter_name
    if not name:
        return ()
    others = [text for text in choice.sets if text.partition("=")[0].strip() == "filter.kind"]
    if any(text.partition("=")[2].strip().strip("'\"") != name for text in others):
        raise InputError(f"--filter {name} and --set {others[0]} name two filters", where="--filter", cure="Leave one out")
    # Names are checked where they were given.
    config.overlay(config.load(preset=choice.preset), {"filter": {"kind": name}}, "--filter")
    return (f"filter.kind={name}",)


def _camera_motion(said: str) -> tuple[str, ...]:
    """``--camera-motion`` as assignments: what is neither flow nor none is a file."""
    if said in ("", "none", "flow"):
        return (f"camera_motion.kind={said}",) if said else ()
    return "camera_motion.kind=file", f"camera_motion.file={json.dumps(said)}"


def _learned(file: Path) -> dict[str, dict[str, str]]:
    """The sections that take what a scene has taught; false alarms that were not learned are spread like the births."""
    scene = read_scene(file)
    given = {"kind": "scene", "file": str(file)}
    parts = {"birth": scene.births, "clutter": scene.clutter}
    out = {name: given for name, learned in parts.items() if learned is not None}
    if scene.clutter is None and scene.births is not None and scene.births.density.dim == 6:
        out["clutter"] = {"volume": "image"}
    return out


def scene_sets(file: Path) -> tuple[str, ...]:
    """The same as assignments, as ``--set`` takes them."""
    return tuple(f"{section}.{name}={value}" for section, given in _learned(file).items() for name, value in given.items())


def _sharing(settings: config.Settings, threads: int) -> dict[str, dict[str, Any]]:
    """Settings that give filter and extraction so many threads, where they can use them."""
    values: Any = settings.as_dict()
    return {name: {"threads": threads} for name in ("filter", "extract") if "threads" in values[name]}


def prepare(wanted: Wanted, choice: Choice, settings: config.Settings, command: str, *, video: bool) -> Job:
    """Everything that a run needs; ``settings`` are those `chosen`, or made of them.

    Raises
    ------
    InputError : an input that cannot be read, options that do not go together.
    """
    truth = None if choice.truth is None else read_truth(choice.truth)
    if wanted.detections is None:
        settings = config.seen_by(settings, wanted.detector or DEFAULT_DETECTOR)
    inputs = open_inputs(_at_least(wanted, truth), settings.detector)
    stages = config.build(settings, inputs.info, moving=True)
    check_moving(settings, stages.model)
    steps = Steps(stages, np.random.default_rng(choice.seed))
    return Job(
        inputs=inputs,
        stages=stages,
        steps=steps,
        seed=choice.seed,
        configuration=settings.as_dict(),
        read=_described(wanted, inputs),
        command=command,
        title=inputs.name,
        versions=versions(),
        truth=truth,
        video=video,
        companion=together([*_moving(settings, inputs), *_learning(stages.learning, steps, inputs.name)]),
        mover=mover_of(settings, inputs),
    )


def _moving(settings: config.Settings, inputs: Inputs) -> list[Companion]:
    """What tells of the camera's motion, where there is any."""
    kind = str(settings.sections.get("camera_motion", {}).get("kind", "none"))
    return [] if kind == "none" else [CameraCompanion(kind, inputs.info)]


def _learning(learning: Learning[Any], steps: Steps, name: str) -> list[Companion]:
    """What tells of the learning: of the rates, of the scene, of both, or of neither."""
    parts = list[Companion]()
    scene = learning.beside if isinstance(learning, FollowRates) else learning
    if isinstance(learning, FollowRates):
        parts.append(RatesCompanion(learning, steps))
    if isinstance(scene, FollowScene):
        parts.append(LearningCompanion(scene, steps, name))
    return parts


def versions() -> tuple[tuple[str, str], ...]:
    """Of everything installed that may matter."""
    return tuple((name, version) for name, version in doctor.versions() if version)


def detector_parameters(file: Path | None, sets: tuple[str, ...]) -> dict[str, Any]:
    """The detector's own settings from a file and ``--set detector.name=value``."""
    return config.load(file, sets).detector


def _at_least(wanted: Wanted, truth: Truth | None) -> Wanted:
    """The same, for a sequence at least as long as its truth."""
    return wanted if truth is None or not len(truth) else replace(wanted, last=int(truth.frame.max()))


def _described(wanted: Wanted, inputs: Inputs) -> dict[str, object]:
    """What was read, for run.json."""
    if wanted.detections is not None:
        return {"source": wanted.source, "detections": str(wanted.detections)}
    detector = wanted.detector or DEFAULT_DETECTOR
    mask = "" if wanted.mask is None else str(wanted.mask)
    return {
        "source": wanted.source,
        "detector": detector,
        "max_width": wanted.max_width,
        "mask": mask,
        "fps": inputs.info.fps,
    }
