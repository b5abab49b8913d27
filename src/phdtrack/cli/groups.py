"""``phdtrack groups``: groups of people on the ground, from a video or detections, or among known positions."""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from phdtrack import config
from phdtrack.cli import options as given
from phdtrack.cli import run_directory as rundir
from phdtrack.cli.group_observer import NOWHERE, GroupObserver, GroupStory, Surroundings
from phdtrack.cli.inputs import NO_PICTURE, refuse
from phdtrack.cli.job import Job, about, finish_document
from phdtrack.cli.options import SourceOptions, TrackingOptions, option
from phdtrack.cli.output import Output, progress
from phdtrack.cli.settings import chosen
from phdtrack.cli.track import finish, prepare
from phdtrack.config import Settings, build_groups
from phdtrack.errors import InputError
from phdtrack.files import load
from phdtrack.formats.positions import Positions, read_positions
from phdtrack.ground import footprint
from phdtrack.groups import LifeCycleState
from phdtrack.groups.pipeline import known_people
from phdtrack.models import PlaneSensor
from phdtrack.report.pages import render
from phdtrack.report.words import flattened, write_text
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


def groups(
    source: SourceOptions,
    options: TrackingOptions,
    output: Output,
    camera: Annotated[
        Path | None, option("--camera", "FILE", "Between pixels and the ground: Tsai XML, OpenCV, homography, TOML.")
    ] = None,
    positions: Annotated[
        Path | None,
        option(
            "--positions",
            "FILE",
            "People on the ground with identities and velocities (obsmat.txt): only their groups are estimated.",
        ),
    ] = None,
    edges: Annotated[
        Path | None, option("--edges", "FILE", "Lines to draw on the plan, as road edges: x y in metres a line.")
    ] = None,
    out: given.Out = None,
    overwrite: given.Overwrite = False,
    video: Annotated[bool, typer.Option("--video/--no-video", help="Write plan.mp4 and annotated.mp4.")] = True,
) -> None:
    """Find groups of people on the ground, in a video, in a file of detections, or among known positions.

    The run's directory holds what that of `phdtrack track` does, and groups.csv (counts, places, contours), members.csv,
    events.csv, warnings.csv and plan.mp4: the ground from above beside the annotated video.
    """
    if out is not None:
        rundir.check(out, overwrite, rundir.GROUP_FILES)
    if positions is None:
        settings = ground_settings(options, camera)
        job = prepare(source, options, settings, video=video)
        job = with_groups(job, settings, read_edges(edges))
        finish(output, job, rundir.claim(out or Path("runs") / job.inputs.info.name, overwrite, rundir.GROUP_FILES))
        return
    _check_unused(source, options, camera)
    lines, known = read_edges(edges), read_positions(positions)
    if not len(known):
        raise InputError("expected people, came a file without any", where=positions)
    fps, settings = source.fps or rate_of(known, positions), chosen(options)
    name = positions.resolve().parent.name
    directory = rundir.claim(out or Path("runs") / (name or positions.stem), overwrite, rundir.GROUP_FILES)
    group_known(output, known, fps, settings, lines, directory, positions, video=video)


def ground_settings(options: TrackingOptions, camera: Path | None) -> Settings:
    """The settings on the ground plane with this camera; a filter of Gaussians where none was named.

    Raises `InputError` where there is no camera, or the settings are for another world or without a filter.
    """
    said = config.load(options.config, options.sets or (), options.preset)
    usual = [] if said.kind("motion") != "box" or "kind" in said.given.get("motion", {}) else ["motion.kind=plane"]
    if not options.filter_name and said.kind("filter") == "pmb" and "kind" not in said.given.get("filter", {}):
        usual.append(f"filter.kind={USUAL_FILTER}")
    settings = chosen(options, usual)
    if camera is not None:
        settings = config.overlay(settings, {"camera": {"file": str(camera)}}, "--camera")
    if settings.kind("motion") != "plane":
        cure = "Use motion.kind=plane, or leave it out."
        raise InputError("groups are found on the ground", where="motion.kind", cure=cure)
    if settings.kind("filter") == "none":
        problem = "groups need velocities, which detections alone do not have"
        raise InputError(problem, where="--filter none", cure=f"Use --filter {USUAL_FILTER}.")
    if not settings.build("camera").file:
        cure = "Name a file of the camera; phdtrack calibrate makes one of four points or more."
        raise InputError("where pixels are on the ground is not known", where="--camera", cure=cure)
    return settings


def with_groups(job: Job, settings: Settings, edges: tuple[F8, ...]) -> Job:
    """The job with an observer of groups."""
    stages, size = job.stages, (job.inputs.info.width, job.inputs.info.height)
    sensor, around = stages.model.sensor, Surroundings(edges=edges)
    if isinstance(sensor, PlaneSensor) and sensor.camera is not None:
        around = Surroundings(sensor.camera, footprint(sensor.camera, size, settings.build("camera").max_distance), edges)
    delay, story = settings.build("associate").output_delay, GroupStory(around, job.inputs.info.fps, size)
    observer = GroupObserver(build_groups(settings, stages), stages, delay, story)
    return replace(job, observers=(*job.observers, observer, story))


def _check_unused(source: SourceOptions, options: TrackingOptions, camera: Path | None) -> None:
    """Raise `InputError` where an option has nothing to do, because positions are known."""
    useless: dict[str, object] = {
        "SOURCE": source.source,
        "--detections": source.detections,
        "--detector": source.detector,
        "--camera": camera,
        "--filter": options.filter_name,
        "--frame-size": source.frame_size,
        "--max-width": source.max_width,
        "--mask": source.mask,
        "--truth": options.truth,
        "--threads": options.threads is not None,
    }
    refuse(useless, "the positions are known, so there is nothing that this could change", "--positions")


def group_known(
    output: Output,
    known: Positions,
    fps: float,
    settings: Settings,
    edges: tuple[F8, ...],
    directory: rundir.RunDirectory,
    path: Path,
    *,
    video: bool,
) -> None:
    """Find groups among known positions, read from ``path``, write everything, and say what was found."""
    clock, begun = time.perf_counter(), about(path.parent.name or path.name)
    frames, stages, state = np.unique(known.frame).tolist(), build_groups(settings), LifeCycleState()
    # One picture for each frame with people, as fast as these usually follow each other.
    step = float(np.median(np.diff(frames))) if len(frames) > 1 else 1.0
    story = GroupStory(Surroundings(edges=edges), fps / step)
    with ExitStack() as files, progress("grouping", len(frames)) as advance:
        story.open(directory, files)
        for done, number in enumerate(frames, start=1):
            here, at = known.at(number), (number - frames[0]) / fps
            state, frame = stages.advance(state, known_people(here.state), here.identity, np.arange(len(here)), number, at)
            story.add(frame, here.state[:2], NOWHERE)
            advance(done)
    if video:
        with ExitStack() as files, progress("drawing", len(frames)) as advance:
            draw = story.drawing(directory, files, pictures=False)
            for done, number in enumerate(frames, start=1):
                draw(number, NO_PICTURE)
                advance(done)
    found, people = story.report(), len(np.unique(known.identity))
    summary = (f"{people} people in {len(frames)} frames at {fps:.4g} frames per second.", *found.sentences)
    used = {name: value for name, value in settings.as_dict().items() if name in GROUP_SECTIONS}
    words = {"title": begun.title, "source": str(path), "lead": " ".join(summary), "settings": flattened(used)}
    page = render("positions.html", about=replace(begun, notes=(_NOTE,)), sections=found.section, **words)
    write_text(directory.file(rundir.REPORT), page)
    document = {
        "command": begun.command,
        "title": begun.title,
        "summary": summary,
        "versions": dict(begun.versions),
        "started": begun.started,
        "seconds": time.perf_counter() - clock,
        "frames": len(frames),
        "people": people,
        "configuration": used,
        "complete": True,
        "input": {"positions": str(path), "fps": fps},
    }
    document = finish_document(document, directory, found.document)
    output.say(*summary, "", *directory.listing())
    output.document(document)


def read_edges(path: Path | None) -> tuple[F8, ...]:
    """Lines (2, K) in metres: a point ``x y`` or ``x,y`` on each line of text, an empty line between one edge and the next.

    Raises `InputError` where the file is missing, or a line is not two finite numbers.
    """
    edges: list[list[list[float]]] = [[]]
    text = load(path).decode("utf-8-sig", errors="replace") if path is not None else ""
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.partition("#")[0].replace(",", " ").split()
        try:
            point = [float(word) for word in words]
        except ValueError:
            point = [np.nan]
        if not words:
            edges.append([])
        elif len(point) == 2 and np.isfinite(point).all():
            edges[-1].append(point)
        else:
            problem = f"expected a point of an edge, x and y in metres, came '{line.strip()[:40]}'"
            raise InputError(problem, where=f"{path}, line {number}")
    return tuple(np.array(edge).T for edge in edges if len(edge) > 1)


def rate_of(positions: Positions, path: Path) -> float:
    """Frames per second, from the displacements of people between two frames and their velocities.

    Raises `InputError` where no person moves, or displacements and velocities do not fit each other.
    """
    order = np.lexsort((positions.frame, positions.identity))
    identity, frame, state = positions.identity[order], positions.frame[order], positions.state[:, order]
    same = identity[1:] == identity[:-1]
    frames = np.diff(frame)[same].astype(np.float64)
    way = np.hypot(*np.diff(state[:2])[:, same])
    speed = np.hypot(*((state[2:, 1:] + state[2:, :-1]) / 2)[:, same])
    moving = (way > _MIN_DISTANCE) & (speed > _MIN_SPEED)
    cure = "Say --fps F, the rate of the video that the frames are numbered in."
    unknown = "the rate of the frames is not known"
    if not moving.any():
        raise InputError(f"{unknown}, and no person moves, so that it cannot be estimated", where=path, cure=cure)
    low, rate, high = np.quantile(frames[moving] * speed[moving] / way[moving], [0.25, 0.5, 0.75]).tolist()
    if high - low > _MAX_SPREAD * rate:
        found = f"from displacements and velocities it is anything from {low:.3g} to {high:.3g} per second"
        raise InputError(f"{unknown}; {found}", where=path, cure=cure)
    return float(rate)
