"""``phdtrack track``: the main job, from a video or from detections to tracks."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from phdtrack.cli import run_directory as rundir
from phdtrack.cli.options import (
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
)
from phdtrack.cli.output import Output
from phdtrack.cli.wanted import Wanted

if TYPE_CHECKING:
    from phdtrack.cli.job import Outcome


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
            "--learn-online",
            help="Learn where false alarms and entrances are while tracking, from nothing or from --scene.",
        ),
    ] = False,
    camera_motion: CameraMotion = "",
    truth: TruthFile = None,
    json: Json = False,
) -> None:
    """Track the objects in a video, or in anybody's detections.

    The run's directory holds tracks.csv (MOTChallenge), detections.csv, states.csv, annotated.mp4, report.html and
    run.json. A video that is cut short is tracked as far as it goes, with a warning. Ctrl-C finishes what was done so far.
    """
    from phdtrack.cli.configured import Choice, chosen, prepare
    from phdtrack.cli.first_use import announced
    from phdtrack.cli.job import run

    result = Output(json)
    if out is not None:
        rundir.check(out, overwrite)
    wanted = Wanted(source, detections, detector, frame_size, fps, max_width, mask)
    choice = Choice(filter_name, preset, config, tuple(sets or ()), seed, truth, threads, scene, learn_online, camera_motion)
    job = prepare(wanted, choice, chosen(choice), command_line(), video=video)
    directory = rundir.claim(out or Path("runs") / job.inputs.info.name, overwrite)
    with announced(result, job.filter_name):
        outcome = run(job, directory)
    tell(result, outcome, directory)
    if outcome.stop is not None:
        # What there is has been told; how it ended decides the exit status.
        raise outcome.stop


def command_line() -> str:
    """What was typed, so that it can be typed again."""
    return shlex.join(["phdtrack", *sys.argv[1:]])


def tell(out: Output, outcome: Outcome, directory: rundir.RunDirectory) -> None:
    """The outcome in plain words, or as JSON."""
    from phdtrack.cli.scoring import score_table

    for warning in outcome.warnings:
        out.warn(warning)
    for sentence in outcome.summary:
        out.say(sentence)
    out.say()
    for file, meaning in MEANING.items():
        if directory.file(file).exists():
            out.say(f"  {directory.file(file)}  {meaning}")
    if outcome.scores is not None:
        out.say()
        score_table(out, [("", outcome.scores)])
    out.document(outcome.document)


MEANING = {
    rundir.TRACKS: "tracks, corrected, MOTChallenge",
    rundir.ONLINE: "the same as they came, frame by frame",
    rundir.STATES: "the filter's states before they had identities",
    rundir.DETECTIONS: "what the detector saw",
    rundir.GROUPS: "every group in every frame: count, place, contour",
    rundir.MEMBERS: "who is in which group",
    rundir.EVENTS: "groups that appear, vanish, merge, split",
    rundir.WARNINGS: "groups about to meet",
    rundir.VIDEO: "to look at",
    rundir.PLAN: "the ground from above",
    rundir.CAMERA_MOTION: "how the camera moved, for --camera-motion",
    rundir.SCENES[0]: "what was learned of the scene, for --scene",
    rundir.REPORT: "the run in pictures and numbers",
    rundir.RUN: "everything that decided it, for programs",
}
