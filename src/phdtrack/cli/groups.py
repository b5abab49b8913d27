"""``phdtrack groups``: who walks with whom, how many they are, and what becomes of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from phdtrack.cli import run_directory as rundir
from phdtrack.cli.options import (
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
    Seed,
    Sets,
    Threads,
    TruthFile,
)
from phdtrack.cli.output import Output
from phdtrack.cli.track import MEANING, command_line, tell
from phdtrack.cli.wanted import Wanted
from phdtrack.errors import InputError

if TYPE_CHECKING:
    from phdtrack.cli.configured import Choice
    from phdtrack.cli.job import Job
    from phdtrack.config import Settings
    from phdtrack.types import F8

USUAL_FILTER = "gm-phd"
NAMES = (*rundir.FILES, *rundir.GROUP_FILES)


def groups(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="Video, folder or pattern of images, camera number; not needed with --detections or --positions.",
        ),
    ] = "",
    detections: DetectionsFile = None,
    camera: Annotated[
        Path | None,
        typer.Option("--camera", metavar="FILE", help="Between pixels and the ground: Tsai XML, OpenCV, homography, TOML."),
    ] = None,
    positions: Annotated[
        Path | None,
        typer.Option(
            "--positions",
            metavar="FILE",
            help="People on the ground with identities and velocities (obsmat.txt): only their groups are estimated.",
        ),
    ] = None,
    edges: Annotated[
        Path | None,
        typer.Option("--edges", metavar="FILE", help="Lines to draw on the plan, as road edges: x y in metres a line."),
    ] = None,
    detector: Detector = "",
    filter_name: Annotated[
        str, typer.Option("--filter", metavar="NAME", help="gm-phd (default), gm-cphd, particle-phd or particle-cphd.")
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
    video: Annotated[bool, typer.Option("--video/--no-video", help="Write plan.mp4 and annotated.mp4.")] = True,
    truth: TruthFile = None,
    json: Json = False,
) -> None:
    """Find groups of people on the ground, in a video, in anybody's detections, or among known positions.

    The run's directory holds what that of `phdtrack track` does, and groups.csv (counts, places, contours), members.csv,
    events.csv, warnings.csv and plan.mp4: the ground from above beside the annotated video.
    """
    from phdtrack.cli.configured import Choice

    result = Output(json)
    if out is not None:
        rundir.check(out, overwrite, NAMES)
    wanted = Wanted(source, detections, detector, frame_size, fps, max_width, mask)
    choice = Choice(filter_name, preset, config, tuple(sets or ()), seed, truth, threads)
    if positions is not None:
        _alone(wanted, choice, camera)
        _known(result, positions, choice, edges, fps, out, overwrite, video=video)
    else:
        _tracked(result, wanted, choice, camera, edges, out, overwrite, video=video)


def _tracked(
    result: Output, wanted: Wanted, choice: Choice, camera: Path | None, edges: Path | None, out: Path | None,
    overwrite: bool, *, video: bool,
) -> None:  # fmt: skip
    """Through detector and filter."""
    from phdtrack.cli.configured import prepare
    from phdtrack.cli.first_use import announced
    from phdtrack.cli.job import run

    settings = ground_settings(choice, camera)
    job = accompanied(prepare(wanted, choice, settings, command_line(), video=video), settings, _lines(edges))
    directory = rundir.claim(out or Path("runs") / job.inputs.info.name, overwrite, NAMES)
    with announced(result, job.filter_name):
        outcome = run(job, directory)
    tell(result, outcome, directory)
    if outcome.stop is not None:
        raise outcome.stop


def _known(
    result: Output, path: Path, choice: Choice, edges: Path | None, fps: float, out: Path | None, overwrite: bool, *,
    video: bool,
) -> None:  # fmt: skip
    """Without detector and filter."""
    from phdtrack.cli.configured import chosen
    from phdtrack.cli.group_positions import prepare_positions, run_positions

    job = prepare_positions(path, fps, chosen(choice), _lines(edges), command_line(), video=video)
    directory = rundir.claim(out or Path("runs") / (path.resolve().parent.name or path.stem), overwrite, NAMES)
    document, said = run_positions(job, directory)
    for sentence in said:
        result.say(sentence)
    result.say()
    for file in directory.written():
        result.say(f"  {file}  {MEANING[file.name]}")
    result.document(document)


def ground_settings(choice: Choice, camera: Path | None) -> Settings:
    """The settings on the ground plane with this camera; a filter of Gaussians where none was named.

    Raises
    ------
    InputError : there is no camera, or the settings are for another world or without a filter.
    """
    from phdtrack import config
    from phdtrack.cli.configured import chosen

    said = config.load(choice.config, choice.sets, choice.preset)
    usual = [] if said.kind("motion") != "box" or "kind" in said.given.get("motion", {}) else ["motion.kind=plane"]
    if not choice.filter_name and said.kind("filter") == "pmb" and "kind" not in said.given.get("filter", {}):
        usual.append(f"filter.kind={USUAL_FILTER}")
    settings = chosen(replace(choice, sets=(*usual, *choice.sets)))
    if camera is not None:
        settings = config.overlay(settings, {"camera": {"file": str(camera)}}, "--camera")
    if settings.kind("motion") != "plane":
        raise InputError(
            "groups are found on the ground", where="motion.kind", cure="Use motion.kind=plane, or leave it out."
        )
    if settings.kind("filter") == "none":
        raise InputError(
            "groups need velocities, which detections alone do not have",
            where="--filter none",
            cure=f"Use --filter {USUAL_FILTER}.",
        )
    if not settings.build("camera").file:
        raise InputError(
            "where pixels are on the ground is not known",
            where="--camera",
            cure="Name a file of the camera; phdtrack calibrate makes one of four points or more.",
        )
    return settings


def accompanied(job: Job, settings: Settings, edges: tuple[F8, ...]) -> Job:
    """The job with the groups beside it."""
    from phdtrack.cli.companions import together
    from phdtrack.cli.group_companion import GroupCompanion
    from phdtrack.cli.group_story import Around
    from phdtrack.config import build_groups
    from phdtrack.ground.uncertainty import footprint
    from phdtrack.models import PlaneSensor

    stages, info = job.stages, job.inputs.info
    sensor, delay = stages.model.sensor, int(str(job.configured("associate", "output_delay")))
    around = Around(edges=edges)
    if isinstance(sensor, PlaneSensor) and sensor.camera is not None:
        far = float(str(job.configured("camera", "far")))
        around = Around(sensor.camera, footprint(sensor.camera, (info.width, info.height), far), edges)
    groups = GroupCompanion(build_groups(settings, stages), stages, info, around, delay)
    return replace(job, companion=together([*([job.companion] if job.companion else []), groups]))


def _lines(edges: Path | None) -> tuple[F8, ...]:
    from phdtrack.cli.group_inputs import read_edges

    return () if edges is None else read_edges(edges)


def _alone(wanted: Wanted, choice: Choice, camera: Path | None) -> None:
    """Raise `InputError` where an option has nothing to do, because positions are known."""
    given = {
        "SOURCE": wanted.source,
        "--detections": wanted.detections,
        "--detector": wanted.detector,
        "--camera": camera,
        "--filter": choice.filter_name,
        "--frame-size": wanted.frame_size,
        "--max-width": wanted.max_width,
        "--mask": wanted.mask,
        "--truth": choice.truth,
        "--threads": choice.threads is not None,
    }
    for option, used in given.items():
        if used:
            raise InputError(
                "the positions are known, so there is nothing that this could change",
                where=option,
                cure=f"Leave out {option} or --positions.",
            )
