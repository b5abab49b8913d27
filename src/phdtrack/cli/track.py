"""``phdtrack track``: the main job, from a video or from detections to tracks; ``phdtrack detect``: only the detections."""

from __future__ import annotations

import shlex
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from phdtrack.cli import run_directory as rundir
from phdtrack.cli.options import (
    DEFAULT_DETECTOR,
    CameraMotion,
    Config,
    DetectionsFile,
    Detector,
    Fps,
    FrameSize,
    Json,
    Mask,
    MaxWidth,
    Out,
    Overwrite,
    Preset,
    SceneFile,
    Seed,
    Sets,
    Threads,
    TruthFile,
    Wanted,
)
from phdtrack.cli.output import Output, counted
from phdtrack.errors import InputError

if TYPE_CHECKING:
    from phdtrack.cli.job import Job
    from phdtrack.cli.settings import Choice
    from phdtrack.config import Settings


def track(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE", help="Video, folder or pattern of images, camera number; not needed with --detections."
        ),
    ] = "",
    detections: DetectionsFile = None,
    detector: Detector = "",
    filter_name: Annotated[
        str,
        typer.Option(
            "--filter",
            metavar="NAME",
            help="pmb (default), gm-phd, particle-phd, gm-cphd, particle-cphd, mht, mcmc, or none: association of raw "
            "detections.",
        ),
    ] = "",
    out: Out = None,
    overwrite: Overwrite = False,
    threads: Threads = None,
    seed: Seed = 0,
    preset: Preset = "",
    config: Config = None,
    sets: Sets = None,
    frame_size: FrameSize = "",
    fps: Fps = 0.0,
    max_width: MaxWidth = 0,
    mask: Mask = None,
    video: Annotated[bool, typer.Option("--video/--no-video", help="Write annotated.mp4.")] = True,
    scene: SceneFile = None,
    learn_online: Annotated[
        bool,
        typer.Option(
            "--learn-online", help="Learn where false alarms and entrances are while tracking, from nothing or from --scene."
        ),
    ] = False,
    camera_motion: CameraMotion = "",
    truth: TruthFile = None,
    json: Json = False,
) -> None:
    """Track the objects in a video, or in a file of detections.

    The run's directory holds tracks.csv (MOTChallenge), detections.csv, states.csv, annotated.mp4, report.html and
    run.json. A video that is cut short is tracked as far as it goes, with a warning. Ctrl-C finishes what was done so far.
    """
    from phdtrack.cli.settings import Choice, chosen

    result = Output(json)
    if out is not None:
        rundir.check(out, overwrite)
    wanted = Wanted(source, detections, detector, frame_size, fps, max_width, mask)
    choice = Choice(filter_name, preset, config, tuple(sets or ()), seed, truth, threads, scene, learn_online, camera_motion)
    job = prepare(wanted, choice, chosen(choice), video=video)
    directory = rundir.claim(out or Path("runs") / job.inputs.info.name, overwrite)
    finish(result, job, directory)


def detect(
    source: Annotated[str, typer.Argument(metavar="SOURCE", help="Video, folder or pattern of images, camera number.")],
    detector: Detector = DEFAULT_DETECTOR,
    out: Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Where to write; default: runs/SOURCE.")] = None,
    overwrite: Overwrite = False,
    config: Config = None,
    sets: Sets = None,
    fps: Fps = 0.0,
    max_width: MaxWidth = 0,
    mask: Mask = None,
    json: Json = False,
) -> None:
    """Detect objects in a video and write detections.csv, a MOTChallenge file.

    What was detected is written frame by frame, so that Ctrl-C loses nothing.
    """
    from phdtrack.cli.inputs import open_inputs, write_detected
    from phdtrack.config import load

    wanted = Wanted(source, detector=detector, fps=fps, max_width=max_width, mask=mask)
    inputs = open_inputs(wanted, load(config, tuple(sets or ())).detector)
    target, result = rundir.claim(out or Path("runs") / inputs.info.name, overwrite, (rundir.DETECTIONS,)), Output(json)
    frames = boxes = 0
    clock = time.perf_counter()
    try:
        for count in write_detected(inputs, target.file(rundir.DETECTIONS)):
            frames, boxes = frames + 1, boxes + count
    except InputError:
        if not frames:
            # Nothing was looked at: an empty file would be taken for "nothing was detected".
            target.clear()
        raise
    seconds = time.perf_counter() - clock
    warnings = [sentence for sentence in (inputs.source.note, inputs.source.problem) if sentence]
    for sentence in warnings:
        result.warn(sentence)
    rate = frames / seconds if seconds > 0 else 0.0
    done = f"{counted(boxes, 'box')} in {counted(frames, 'frame')} by {inputs.described}"
    result.say(f"{done}, {rate:.0f} frames per second: {target.file(rundir.DETECTIONS)}")
    about = {"source": source, "detector": inputs.described, "frames": frames, "detections": boxes}
    result.document(about | {"frames_per_second": rate, "file": str(target.file(rundir.DETECTIONS)), "warnings": warnings})


def finish(result: Output, job: Job, directory: rundir.RunDirectory) -> None:
    """Run the job and say what came of it. Raises what ended it before its time: that decides the exit status."""
    from phdtrack.cli.evaluate import score_table
    from phdtrack.cli.job import announced, run

    with announced(result):
        outcome = run(job, directory)
    for warning in outcome.warnings:
        result.warn(warning)
    for sentence in (*outcome.summary, ""):
        result.say(sentence)
    for file, meaning in MEANING.items():
        if directory.file(file).exists():
            result.say(f"  {directory.file(file)}  {meaning}")
    if outcome.scores is not None:
        result.say()
        score_table(result, [("", outcome.scores)])
    result.document(outcome.document)
    if outcome.stop is not None:
        raise outcome.stop


def command_line() -> str:
    """What was typed, so that it can be typed again."""
    return shlex.join(["phdtrack", *sys.argv[1:]])


def prepare(wanted: Wanted, choice: Choice, settings: Settings, *, video: bool) -> Job:
    """Everything that a run needs; ``settings`` are those `chosen`, or made of them.

    Raises
    ------
    InputError : an input that cannot be read, options that do not go together.
    """
    import numpy as np

    from phdtrack import config
    from phdtrack.cli.doctor import installed_versions
    from phdtrack.cli.inputs import open_inputs
    from phdtrack.cli.job import Job, Steps
    from phdtrack.cli.observers import mover_of, observers_of
    from phdtrack.formats import read_truth
    from phdtrack.report import About

    truth = None if choice.truth is None else read_truth(choice.truth)
    if wanted.detections is None:
        settings = config.for_detector(settings, wanted.detector or DEFAULT_DETECTOR)
    if truth is not None and len(truth):
        # The sequence is at least as long as its truth.
        wanted = replace(wanted, last=int(truth.frame.max()))
    inputs = open_inputs(wanted, settings.detector)
    stages = config.build(settings, inputs.info, moving=True)
    read: dict[str, object] = {"source": wanted.source}
    if wanted.detections is not None:
        read["detections"] = str(wanted.detections)
    else:
        read |= {"detector": inputs.described, "max_width": wanted.max_width}
        read |= {"mask": str(wanted.mask or ""), "fps": inputs.info.fps}
    return Job(
        inputs=inputs,
        stages=stages,
        steps=Steps(stages, np.random.default_rng(choice.seed)),
        configuration=settings.as_dict(),
        read=read,
        about=About(inputs.name, command_line(), choice.seed, versions=installed_versions()),
        truth=truth,
        video=video,
        observers=observers_of(settings, inputs, stages.learning),
        mover=mover_of(settings, inputs, stages.model),
    )


MEANING = {
    rundir.TRACKS: "tracks, corrected, MOTChallenge",
    rundir.ONLINE: "the same as they came, frame by frame",
    rundir.STATES: "the filter's states before they had identities",
    rundir.DETECTIONS: "what the detector saw",
    rundir.GROUPS: "every group in every frame: count, place, contour",
    rundir.MEMBERS: "members of each group",
    rundir.EVENTS: "groups that appear, vanish, merge, split",
    rundir.WARNINGS: "groups about to meet",
    rundir.VIDEO: "to look at",
    rundir.PLAN: "the ground from above",
    rundir.CAMERA_MOTION: "how the camera moved, for --camera-motion",
    rundir.SCENES[0]: "what was learned of the scene, for --scene",
    rundir.REPORT: "the run in pictures and numbers",
    rundir.RUN: "everything that decided it, for programs",
}
