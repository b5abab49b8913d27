"""From a request to a run: inputs opened, stages built, the directory claimed."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from phdtrack import config
from phdtrack.addresses import shown
from phdtrack.config import Settings
from phdtrack.detect.base import guesses
from phdtrack.detect.convert import check_units
from phdtrack.errors import InputError
from phdtrack.files import json_value
from phdtrack.formats import read_truth
from phdtrack.multiclass import ClassSettings
from phdtrack.report import About
from phdtrack.run import directory as rundir
from phdtrack.run.camera_motion import mover_of
from phdtrack.run.choices import chosen_settings, scene_settings, unused_options
from phdtrack.run.descriptors import with_descriptors
from phdtrack.run.detection_log import source_of
from phdtrack.run.directory import RunDirectory
from phdtrack.run.environment import HOME, detecting_packages, sources_digest, versions
from phdtrack.run.inputs import Inputs, open_inputs, request_conventions
from phdtrack.run.observers import CameraObserver, RunObserver
from phdtrack.run.reporter import SILENT, Reporter
from phdtrack.run.requests import (
    VIDEO_SIZE,
    ReadingRequest,
    RunRequest,
    SourceRequest,
    frame_range,
    refuse,
)
from phdtrack.run.running import RunOptions
from phdtrack.run.scene_pass import can_flicker
from phdtrack.run.video import RunResult, run
from phdtrack.types import Truth


@dataclass(frozen=True, slots=True)
class PreparedRun:
    """The arguments of `video.run` except the directory, and their settings.

    Attributes
    ----------
    inputs, classes, options, observers : as `video.run` takes them.
    settings : that the stages were built from.
    """

    inputs: Inputs
    classes: ClassSettings
    options: RunOptions
    settings: Settings
    observers: tuple[RunObserver, ...] = ()

    def run(
        self, directory: RunDirectory, reporter: Reporter = SILENT, *, resume: bool = False
    ) -> RunResult:
        """Run it, as `video.run`.

        Parameters
        ----------
        directory : where files are written.
        reporter : receives progress and sentences.
        resume : continue a run that was interrupted.
        """
        return run(
            self.inputs,
            self.classes,
            directory,
            self.observers,
            options=self.options,
            reporter=reporter,
            resume=resume,
        )


def begun_run(title: str, command: str = "", seed: int = 0) -> About:
    """Title, command line, seed, time and versions of a run that starts now.

    Parameters
    ----------
    title, command : heading and command line.
    seed : of everything random.
    """
    now = datetime.now(UTC).isoformat(timespec="seconds")
    return About(title, command, seed, now, versions=versions())


def request_settings(request: RunRequest) -> Settings:
    """The settings that a request names, for the boxes of its detector."""
    first = scene_settings(request.output.scene, request.camera_motion)
    return chosen_settings(request.tracking, first, detector=request.source.detector_name)


def prepare(
    request: RunRequest, command: str = "", settings: Settings | None = None
) -> PreparedRun:
    """Open the inputs and build the stages of a request.

    Parameters
    ----------
    request : what to run.
    command : the command line, for run.json.
    settings : in place of those that the request names.

    Returns
    -------
    The run, which `PreparedRun.run` starts.

    Raises
    ------
    InputError : an input cannot be read, files would be replaced unasked, or options do not go
        together.
    """
    _check(request)
    if settings is None:
        settings = request_settings(request)
    truth = None
    last = 0
    notices = list[str]()
    of_truth, reading = _readings(request)
    if request.tracking.truth is not None:
        conventions = request_conventions(request.source, of_truth)
        truth = read_truth(request.tracking.truth, conventions=conventions, notices=notices)
        last = int(truth.frame.max(initial=0))
    parameters = settings.values("detector")
    source = replace(request.source, reading=reading)
    inputs = open_inputs(source, parameters, last, frame_range(request.frames))
    if truth is not None:
        _check_truth(truth, inputs, request.tracking.truth, of_truth)
    inputs = with_descriptors(inputs, request.tracking.appearance, settings.values("embedding"))
    inputs = replace(
        inputs,
        files=(*inputs.files, *_read_files(request, settings)),
        warnings=(
            *notices,
            *_unused(request, settings, inputs),
            *guesses(inputs.detector),
            *inputs.warnings,
        ),
    )
    settings = config.for_run(settings, endless=not inputs.again)
    classes = config.build_classes(settings, inputs.info, inputs.names, inputs.classes, moving=True)
    model = classes.usual.model
    read = _read(request, inputs, settings)
    motion = settings.kind("camera_motion")
    options = RunOptions(
        about=begun_run(inputs.name, command, request.tracking.seed),
        configuration=settings.as_dict(),
        read={"source": shown(absolute(request.source.source)), **read},
        truth=_truth_of_part(truth, request, inputs),
        labelled=request.tracking.labelled,
        video=request.video,
        video_size=request.video_size,
        blur=request.output.blur,
        delay=settings.build("associate").output_delay,
        mover=mover_of(settings, model, pictures=inputs.pictures),
        detected_by=_detected_by(request.source, inputs, read, parameters),
        detect_again=request.source.detect_again,
        checkpoint_every=request.checkpoint_every,
        learn=request.output.learn and can_flicker(settings),
    )
    observers = () if motion == "none" else (CameraObserver(motion),)
    return PreparedRun(inputs, classes, options, settings, observers)


def _check(request: RunRequest) -> None:
    """Raise `InputError` for options that do not go together, and before files are replaced."""
    output = request.output
    if output.resume and output.overwrite:
        problem = "--resume continues a run, and --overwrite begins anew"
        raise InputError(problem, where="--resume", cure="Give one of them.")
    rundir.check(output.out, output.overwrite or output.resume)
    if request.tracking.truth is None:
        refuse({"--labelled": request.tracking.labelled}, "nothing is scored", "say --truth")
    elif request.tracking.labelled:
        # Loaded only if there is truth.
        from phdtrack.run.scored_files import check_listed

        check_listed(request.tracking.labelled)
    source = request.source.source
    if source and rundir.is_run(Path(source)):
        problem = "expected a video, got the directory of a run"
        cure = "Name the video, or give detections with --detections."
        raise InputError(problem, where=source, cure=cure)


def _unused(request: RunRequest, settings: Settings, inputs: Inputs) -> tuple[str, ...]:
    """Sentences about options that have no effect without another one."""
    described = bool(inputs.descriptors.name)
    found = unused_options(request.tracking, settings, described=described)
    if request.video or request.video_size == VIDEO_SIZE:
        return found
    sentence = "--video-size has no effect with --no-video: no video is written. Leave one out."
    return (*found, sentence)


def _read_files(request: RunRequest, settings: Settings) -> tuple[object, ...]:
    """The files that are read, which the run must not replace."""
    source = request.source
    tracking = request.tracking
    motion = settings.values("camera_motion").get("file")
    return (
        source.source,
        source.detections,
        source.mask,
        tracking.truth,
        tracking.config,
        motion,
    )


def _readings(request: RunRequest) -> tuple[ReadingRequest, ReadingRequest]:
    """How the truth is to be read, and the file of detections. A word that stands alone is that of
    the detections, or without a file of them that of the truth.
    """
    source = request.source
    if request.tracking.truth is None:
        return ReadingRequest(), source.reading
    if source.detections is None or source.detections == Path("-"):
        return source.reading.pair(file=False)[0], ReadingRequest()
    return source.reading.pair(truth=False)


def _check_truth(truth: Truth, inputs: Inputs, path: Path | None, reading: ReadingRequest) -> None:
    """Raise `InputError` if the boxes of the truth cannot be in pixels of the frames."""
    size = (inputs.info.width, inputs.info.height)
    if path is not None and min(size) > 0:
        check_units(
            truth.xyxy, np.ones(len(truth)), size, path, units=reading.units, box=reading.box
        )


def _truth_of_part(truth: Truth | None, request: RunRequest, inputs: Inputs) -> Truth | None:
    """The truth of the frames that are tracked."""
    if truth is None or not request.frames:
        return truth
    part = truth.frame >= inputs.source.first
    if inputs.source.last:
        part &= truth.frame <= inputs.source.last
    return replace(
        truth,
        frame=truth.frame[part],
        identity=truth.identity[part],
        distractor=truth.distractor[part],
        xyxy=truth.xyxy[part],
    )


def _read(request: RunRequest, inputs: Inputs, settings: Settings) -> dict[str, object]:
    """The inputs and how they are read, for run.json."""
    source = request.source
    read: dict[str, object]
    if source.detections is not None:
        read = {"detections": absolute(source.detections), **inputs.dropped_rows}
    else:
        read = {
            "detector": inputs.described,
            "max_width": inputs.max_width,
            "mask": absolute(source.mask or ""),
            "fps": inputs.info.fps,
        }
    stated = {name: value for name, value in asdict(source.reading).items() if value}
    if stated:
        read["reading"] = stated
    if request.frames:
        read["frames"] = request.frames
    if not request.output.learn:
        read["learn"] = False
    if inputs.descriptors.name:
        read["appearance"] = _appearance(inputs, settings)
    network = inputs.described.partition(":")[2]
    if source.detections is None and network:
        read["network"] = source_of(network)
    return read


def _appearance(inputs: Inputs, settings: Settings) -> dict[str, object]:
    """The source of what boxes look like, for run.json: its name, and the file with its time."""
    name = inputs.descriptors.name
    file = name.removeprefix("onnx:")
    if file == "colours":
        return {"name": name}
    found: dict[str, object] = {"name": name, "file": source_of(absolute(file))}
    if file != name:
        found["settings"] = settings.values("embedding")
    return found


def _detected_by(
    source: SourceRequest,
    inputs: Inputs,
    read: Mapping[str, object],
    parameters: Mapping[str, Any],
) -> dict[str, object]:
    """Everything that decides the detections; empty if they are not to be kept."""
    if source.detections is not None or not (inputs.again and Path(source.source).exists()):
        return {}
    mask = str(read["mask"])
    # Without a file of detections they are the truth's.
    others = ("reading", "learn", "appearance")
    deciding = {name: value for name, value in read.items() if name not in others}
    return {
        **deciding,
        "mask": source_of(mask) if mask else [],
        "file": source_of(str(Path(source.source).resolve())),
        "parameters": parameters,
        "sources": sources_digest(HOME),
        "packages": detecting_packages(),
    }


def absolute(name: str | Path | None) -> str:
    """The absolute path of a file that exists; an address, a pattern or - as it is."""
    if name and "://" not in str(name) and Path(name).exists():
        return os.path.realpath(name)
    return str(name)


def claim_directory(prepared: PreparedRun, request: RunRequest) -> RunDirectory:
    """The run's directory, locked, without files of an earlier run unless that is resumed."""
    output = request.output
    inputs = prepared.inputs
    if output.resume and not inputs.again:
        cure = "`phdtrack live` continues by itself after an interruption."
        problem = "the pictures of a camera cannot be read again"
        raise InputError(problem, where="--resume", cure=cure)
    return rundir.claim(
        output.out,
        output.overwrite,
        name=inputs.info.name,
        resume=output.resume,
        inputs=inputs.files,
    )


def is_complete(prepared: PreparedRun, directory: RunDirectory) -> bool:
    """True if the directory holds this run, complete. Raises `InputError` if it holds another."""
    if not rundir.completed(directory):
        return False
    options = prepared.options
    before = rundir.document_of(directory)
    now: dict[str, Any] = {"seed": options.about.seed, "configuration": options.configuration}
    # What only one of them has differs, too.
    was = before.get("input", {})
    every: dict[str, object] = dict.fromkeys((*was, *options.read))
    before["input"] = every | was
    now["input"] = every | dict(options.read)
    if names := _differing(before, json_value(now)):
        problem = f"the run is complete, and differs in {', '.join(names)}"
        cure = "Choose another --out, or say --overwrite in its place."
        raise InputError(problem, where=f"--resume, {directory.path}", cure=cure)
    return True


def _differing(before: Any, now: Any, name: str = "") -> list[str]:
    """The names, as section.name, of values that two documents both have and that differ."""
    if not (isinstance(before, dict) and isinstance(now, dict)):
        if before == now:
            return []
        return [name.removeprefix("configuration.")]
    return [
        each
        for key in now
        if key in before
        for each in _differing(before[key], now[key], f"{name}.{key}".strip("."))
    ]
