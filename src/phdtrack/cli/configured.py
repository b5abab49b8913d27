"""From options to a job: inputs opened, settings checked, stages built. Nothing is written yet: a mistake costs nothing."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from phdtrack import config
from phdtrack.cli import doctor_checks as doctor
from phdtrack.cli.camera_companion import CameraCompanion
from phdtrack.cli.camera_motion import check_moving, mover_of
from phdtrack.cli.companions import together
from phdtrack.cli.inputs import Inputs, open_inputs
from phdtrack.cli.job import Companion, Job
from phdtrack.cli.learning_companion import LearningCompanion
from phdtrack.cli.rates_companion import RatesCompanion
from phdtrack.cli.steps import Steps
from phdtrack.cli.wanted import DEFAULT_DETECTOR, Wanted
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
    """The settings: those of preset and file with the options in their place.

    Raises
    ------
    InputError : a file that cannot be read, an unknown name, options that do not go together.
    """
    scene = (f"scene={choice.scene}",) if choice.scene is not None else ()
    online = ("learn.kind=online",) if choice.learn_online else ()
    sets = (*scene, *online, *_camera_motion(choice.camera_motion), *choice.sets)
    settings = config.load(choice.config, sets, choice.preset, choice.filter_name)
    if choice.threads is not None:
        settings = config.overlay(settings, _sharing(settings, choice.threads), "--threads")
    return settings


def _camera_motion(said: str) -> tuple[str, ...]:
    """``--camera-motion`` as assignments: what is neither flow nor none is a file."""
    if said in ("", "none", "flow"):
        return (f"camera_motion.kind={said}",) if said else ()
    return "camera_motion.kind=file", f"camera_motion.file={json.dumps(said)}"


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
        settings = config.for_detector(settings, wanted.detector or DEFAULT_DETECTOR)
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
    kind = settings.kind("camera_motion")
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
