"""``phdtrack groups``: groups of people on the ground, from a video or detections, or among known positions."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from datetime import UTC, datetime
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
    Wanted,
)
from phdtrack.cli.output import Output, progress
from phdtrack.cli.track import MEANING, command_line, finish
from phdtrack.errors import InputError

if TYPE_CHECKING:
    from phdtrack.cli.group_observer import Story
    from phdtrack.cli.job import Job
    from phdtrack.cli.settings import Choice
    from phdtrack.config import Settings
    from phdtrack.formats.positions import Positions
    from phdtrack.groups.pipeline import GroupStages
    from phdtrack.types import F8

USUAL_FILTER = "gm-phd"
GROUP_SECTIONS = ("groups", "contours", "life_cycle", "encounters")
_NOTE = (
    "The people, their velocities and identities were given; only the groups are estimated. Frame numbers are those of the "
    "file."
)
# People who move less, metres and metres per second, do not show the rate of the frames.
_MIN_DISTANCE, _MIN_SPEED = 0.05, 0.1
# Half-width of the middle half of the estimated rates, as a share of the median, above which no rate is given.
_MAX_SPREAD = 0.3
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
    """Find groups of people on the ground, in a video, in a file of detections, or among known positions.

    The run's directory holds what that of `phdtrack track` does, and groups.csv (counts, places, contours), members.csv,
    events.csv, warnings.csv and plan.mp4: the ground from above beside the annotated video.
    """
    from phdtrack.cli.settings import Choice, chosen
    from phdtrack.cli.track import prepare
    from phdtrack.formats.positions import read_positions

    result = Output(json)
    if out is not None:
        rundir.check(out, overwrite, NAMES)
    wanted = Wanted(source, detections, detector, frame_size, fps, max_width, mask)
    choice = Choice(filter_name, preset, config, tuple(sets or ()), seed, truth, threads)
    if positions is not None:
        _check_unused(wanted, choice, camera)
        lines = () if edges is None else read_edges(edges)
        known = read_positions(positions)
        if not len(known):
            raise InputError("expected people, came a file without any", where=positions)
        given = KnownPositions(positions, known, fps or rate_of(known, positions), chosen(choice), lines, video)
        name = positions.resolve().parent.name or positions.stem
        group_known(result, given, rundir.claim(out or Path("runs") / name, overwrite, NAMES))
        return
    settings = ground_settings(choice, camera)
    job = prepare(wanted, choice, settings, video=video)
    job = with_groups(job, settings, () if edges is None else read_edges(edges))
    finish(result, job, rundir.claim(out or Path("runs") / job.inputs.info.name, overwrite, NAMES))


def ground_settings(choice: Choice, camera: Path | None) -> Settings:
    """The settings on the ground plane with this camera; a filter of Gaussians where none was named.

    Raises
    ------
    InputError : there is no camera, or the settings are for another world or without a filter.
    """
    from phdtrack import config
    from phdtrack.cli.settings import chosen

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


def with_groups(job: Job, settings: Settings, edges: tuple[F8, ...]) -> Job:
    """The job with an observer of groups."""
    from phdtrack.cli.group_observer import GroupObserver, Story, Surroundings
    from phdtrack.config import build_groups
    from phdtrack.ground.uncertainty import footprint
    from phdtrack.models import PlaneSensor

    stages, size = job.stages, (job.inputs.info.width, job.inputs.info.height)
    sensor, around = stages.model.sensor, Surroundings(edges=edges)
    if isinstance(sensor, PlaneSensor) and sensor.camera is not None:
        around = Surroundings(sensor.camera, footprint(sensor.camera, size, settings.build("camera").max_distance), edges)
    delay, story = settings.build("associate").output_delay, Story(around, job.inputs.info.fps, size)
    observer = GroupObserver(build_groups(settings, stages), stages, around.camera, delay, story)
    return replace(job, observers=(*job.observers, observer, story))


def _check_unused(wanted: Wanted, choice: Choice, camera: Path | None) -> None:
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


@dataclass(frozen=True, slots=True)
class KnownPositions:
    """People with known positions, read from ``path``, and how their groups are found; ``fps`` is of the frames' numbers."""

    path: Path
    positions: Positions
    fps: float
    settings: Settings
    edges: tuple[F8, ...]
    video: bool


def group_known(result: Output, job: KnownPositions, directory: rundir.RunDirectory) -> None:
    """Find groups among known positions, write everything, and say what was found."""
    import numpy as np

    from phdtrack import config
    from phdtrack.cli.doctor import installed_versions
    from phdtrack.cli.group_observer import Story, Surroundings
    from phdtrack.cli.inputs import NO_PICTURE
    from phdtrack.report import About, write_run
    from phdtrack.report.pages import positions_page
    from phdtrack.report.run_json import json_value, write_text

    started, clock = datetime.now(UTC), time.perf_counter()
    frames = np.unique(job.positions.frame).tolist()
    # One picture for each frame with people, as fast as these usually follow each other.
    step = float(np.median(np.diff(frames))) if len(frames) > 1 else 1.0
    story = Story(Surroundings(edges=job.edges), job.fps / step)
    _group_frames(job, config.build_groups(job.settings), story, frames, directory)
    if job.video:
        with story.drawing(directory, pictures=False) as draw, progress("drawing", len(frames)) as advance:
            for done, number in enumerate(frames, start=1):
                draw(number, NO_PICTURE)
                advance(done)
    people = len(np.unique(job.positions.identity))
    first = f"{people} people in {len(frames)} frames at {job.fps:.4g} frames per second."
    summary = (first, *story.sentences())
    about = About(
        title=job.path.parent.name or job.path.name, command=command_line(), versions=installed_versions(), notes=(_NOTE,)
    )
    used = {name: value for name, value in job.settings.as_dict().items() if name in GROUP_SECTIONS}
    page = positions_page(about, str(job.path), " ".join(summary), story.section(), used)
    write_text(directory.file(rundir.REPORT), page)
    files = {file.name: str(file) for file in directory.written()} | {rundir.RUN: str(directory.file(rundir.RUN))}
    document: dict[str, object] = {
        "command": about.command,
        "title": about.title,
        "summary": list(summary),
        "versions": dict(about.versions),
        "started": started.isoformat(timespec="seconds"),
        "seconds": time.perf_counter() - clock,
        "frames": len(frames),
        "people": people,
        "configuration": used,
        "complete": True,
        "input": {"positions": str(job.path), "fps": job.fps},
        "directory": str(directory.path),
        "files": files,
        **story.document(),
    }
    document = {key: json_value(value) for key, value in document.items()}
    write_run(directory.file(rundir.RUN), document)
    result.say("\n".join([*summary, "", *(f"  {file}  {MEANING[file.name]}" for file in directory.written())]))
    result.document(document)


def _group_frames(
    job: KnownPositions, stages: GroupStages, story: Story, frames: list[int], directory: rundir.RunDirectory
) -> None:
    """Every frame through the stages, into files and story."""
    import numpy as np

    from phdtrack.cli.group_observer import GroupFiles
    from phdtrack.groups import LifeCycleState
    from phdtrack.groups.pipeline import known_people

    state, nothing = LifeCycleState(), np.zeros((2, 0))
    with GroupFiles(directory, None) as files, progress("grouping", len(frames)) as advance:
        for done, number in enumerate(frames, start=1):
            here = job.positions.at(number)
            at = (number - frames[0]) / job.fps
            carriers = np.arange(len(here))
            state, frame = stages.advance(state, known_people(here.state), here.identity, carriers, number, at)
            files.write(frame)
            story.add(frame, here.state[:2], nothing)
            advance(done)


def read_edges(path: Path) -> tuple[F8, ...]:
    """Lines (2, K) in metres: a point ``x y`` or ``x,y`` on each line of text, an empty line between one edge and the next.

    Raises
    ------
    InputError : the file is missing, or a line is not two finite numbers.
    """
    import numpy as np

    from phdtrack.files import load

    text = load(path).decode("utf-8-sig", errors="replace")
    edges: list[list[tuple[float, float]]] = [[]]
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.partition("#")[0].replace(",", " ").split()
        if not words:
            edges.append([])
            continue
        try:
            x, y = (float(word) for word in words)
        except ValueError:
            x = y = np.nan
        if not np.isfinite(x + y):
            raise InputError(
                f"expected a point of an edge, x and y in metres, came '{line.strip()[:40]}'", where=f"{path}, line {number}"
            )
        edges[-1].append((x, y))
    return tuple(np.array(edge).T for edge in edges if len(edge) > 1)


def rate_of(positions: Positions, path: Path) -> float:
    """Frames per second, from the displacements of people between two frames and their velocities.

    Raises
    ------
    InputError : no person moves, or displacements and velocities do not fit each other.
    """
    import numpy as np

    order = np.lexsort((positions.frame, positions.identity))
    identity, frame, state = positions.identity[order], positions.frame[order], positions.state[:, order]
    same = identity[1:] == identity[:-1]
    frames = np.diff(frame)[same].astype(np.float64)
    way = np.hypot(*np.diff(state[:2])[:, same])
    speed = np.hypot(*((state[2:, 1:] + state[2:, :-1]) / 2)[:, same])
    moving = (way > _MIN_DISTANCE) & (speed > _MIN_SPEED)
    cure, unknown = (
        "Say --fps F, the rate of the video that the frames are numbered in.",
        "the rate of the frames is not known",
    )
    if not moving.any():
        raise InputError(f"{unknown}, and no person moves, so that it cannot be estimated", where=path, cure=cure)
    low, rate, high = np.quantile(frames[moving] * speed[moving] / way[moving], [0.25, 0.5, 0.75]).tolist()
    if high - low > _MAX_SPREAD * rate:
        found = f"from displacements and velocities it is anything from {low:.3g} to {high:.3g} per second"
        raise InputError(f"{unknown}; {found}", where=path, cure=cure)
    return float(rate)
