"""``phdtrack groups``: groups of people on the ground, in a video or in a file of detections."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np

from phdtrack import config
from phdtrack.cli import options as given
from phdtrack.cli.options import option
from phdtrack.cli.output import Output
from phdtrack.cli.track import command_line, run_and_print
from phdtrack.config import Settings, build_groups, ground_model
from phdtrack.errors import InputError
from phdtrack.files import load
from phdtrack.formats.known_positions import read_positions
from phdtrack.report.pages import counted
from phdtrack.run import directory as rundir
from phdtrack.run.choices import chosen_settings, scene_settings
from phdtrack.run.grouping import TABLES, GroupObserver, World
from phdtrack.run.position_groups import group_positions
from phdtrack.run.preparation import prepare
from phdtrack.run.requests import (
    CHECKPOINT_EVERY,
    OutputRequest,
    RunRequest,
    SourceRequest,
    TrackingRequest,
)
from phdtrack.types import F8

INTENSITY_FILTER = "gm-phd"


def groups(
    source: SourceRequest,
    options: TrackingRequest,
    output: Output,
    to: OutputRequest,
    camera: Annotated[
        Path | None,
        option("FILE", "Camera file, as `phdtrack calibrate` writes it, or of Tsai or OpenCV."),
    ] = None,
    edges: Annotated[
        Path | None,
        option("FILE", "Lines to draw on the plan, as kerbs: a point x y in metres a line."),
    ] = None,
    positions: Annotated[
        Path | None,
        option("FILE", "Known positions in metres: CSV frame,id,x,y, or obsmat.txt; with --fps."),
    ] = None,
    video: given.Video = True,
    checkpoint_every: given.CheckpointEvery = CHECKPOINT_EVERY,
    max_file_size: given.MaxFileSize = "",
) -> None:
    """Find groups of people on the ground, in a video or in a file of detections.

    The run's directory holds what that of `phdtrack track` does, and groups.csv (counts, places,
    contours), members.csv, events.csv, warnings.csv and plan.mp4: the ground from above beside the
    annotated video. With --positions nothing is tracked, and the directory holds the four tables.
    """
    if positions is not None:
        _among_positions(positions, source, options, to, camera, output)
        return
    request = RunRequest(
        source, options, to, video=video, video_size=0, checkpoint_every=checkpoint_every
    )
    settings = _ground_settings(request, camera)
    prepared = prepare(request, command_line(), settings)
    settings = prepared.settings
    info = prepared.inputs.info
    stages = prepared.classes.usual
    if settings.kind("motion") == "plane":
        model = stages.model
    else:
        model = ground_model(settings, info)
    world = World(stages, model, settings.build("camera").max_distance)
    grouping = build_groups(settings, stages)
    observer = GroupObserver(grouping, info, _read_edges(edges), world, output)
    prepared = replace(
        prepared,
        # A group may have members of several classes.
        classes=replace(prepared.classes, apart=False),
        options=replace(prepared.options, ground=model.sensor),
        observers=(*prepared.observers, observer),
    )
    run_and_print(output, prepared, request)


def _among_positions(
    file: Path,
    source: SourceRequest,
    tracking: TrackingRequest,
    to: OutputRequest,
    camera: Path | None,
    output: Output,
) -> None:
    """Find groups among known positions. Raises `InputError` for a source or a camera beside them,
    no frame rate, or positions that cannot be read.
    """
    for name, value in (
        ("SOURCE", source.source),
        ("--detections", source.detections),
        ("--camera", camera),
    ):
        if value:
            problem = f"--positions has everything that groups need, and {name} is given, too"
            raise InputError(problem, where=str(value), cure="Leave one of them out.")
    if not source.fps > 0:
        cure = "Say --fps N: how many frame numbers make a second, 25 for 25 pictures a second."
        raise InputError("the rate of the frame numbers is not known", where=file, cure=cure)
    settings = config.load(tracking.config, tracking.sets or (), tracking.preset)
    people = read_positions(file)
    tables = {name: rundir.RUN_FILES[name] for name in TABLES}
    name = f"{file.stem}-groups"
    directory = rundir.claim(to.out, to.overwrite, tables, name=name, inputs=(file,))
    found = group_positions(people, source.fps, build_groups(settings), directory)
    walkers = counted(len(np.unique(people.identity)), "person", "people")
    text = f"{counted(int(str(found['identities'])), 'group')} of {walkers}"
    output.say(f"{text} in {counted(int(str(found['frames'])), 'frame')}.", "")
    output.say(*directory.listing())
    output.document({"positions": str(file), "out": str(directory.path), "groups": found})


def _ground_settings(request: RunRequest, camera: Path | None) -> Settings:
    """The settings with this camera. Groups of an intensity have that of a filter of Gaussians on
    the ground plane by default.

    Raises `InputError` if there is no camera, or groups of an intensity are chosen in another world
    or for a filter without one.
    """
    tracking = request.tracking
    scene = scene_settings(request.output.scene)
    sets = [*scene, *(tracking.sets or ())]
    plain = config.load(tracking.config, sets, tracking.preset)
    first = [*scene, *_intensity_settings(plain, tracking.filter_name)]
    settings = chosen_settings(tracking, first, detector=request.source.detector_name)
    if camera is not None:
        settings = config.overlay(settings, {"camera": {"file": str(camera)}}, "--camera")
    _check_ground(settings)
    return settings


def _intensity_settings(settings: Settings, filter_name: str) -> list[str]:
    """The defaults of groups of an intensity; none for other groups."""
    if settings.kind("groups") != "intensity":
        return []
    sets = []
    if settings.kind("motion") == "box" and "kind" not in settings.given.get("motion", {}):
        sets.append("motion.kind=plane")
    own_filter = filter_name or "kind" in settings.given.get("filter", {})
    if settings.kind("filter") == "pmb" and not own_filter:
        sets.append(f"filter.kind={INTENSITY_FILTER}")
    return sets


def _check_ground(settings: Settings) -> None:
    """Raise `InputError` for settings with which there are no groups on the ground."""
    if settings.kind("motion") not in ("box", "plane"):
        cure = "Use motion.kind=box or plane, or leave it out."
        raise InputError(
            "groups are of people in an image or on the ground", where="motion.kind", cure=cure
        )
    if settings.kind("groups") == "intensity":
        if settings.kind("motion") != "plane":
            cure = "Use motion.kind=plane, or groups.kind=pairs."
            raise InputError(
                "groups of an intensity are found on the ground", where="motion.kind", cure=cure
            )
        name = settings.kind("filter")
        if name in ("none", "pmb", "mht", "mcmc"):
            cure = f"Use --filter {INTENSITY_FILTER}, or groups.kind=pairs."
            raise InputError("this filter has no intensity", where=f"--filter {name}", cure=cure)
    if not settings.build("camera").file:
        cure = "Name a camera file; phdtrack calibrate makes one of four points or more."
        raise InputError(
            "the relation of pixels to the ground is not known", where="--camera", cure=cure
        )


def _read_edges(path: Path | None) -> tuple[F8, ...]:
    """Lines (2, K) in metres: a point ``x y`` or ``x,y`` on each line of text, an empty line
    between one edge and the next.

    Raises `InputError` if the file is missing, or a line is not two numbers.
    """
    edges: list[list[tuple[float, float]]] = [[]]
    text = ""
    if path is not None:
        text = load(path).decode("utf-8-sig", errors="replace")
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.partition("#")[0].replace(",", " ").split()
        if not words:
            edges.append([])
            continue
        try:
            x, y = map(float, words)
        except ValueError:
            problem = f"expected a point of an edge, x and y in metres, got '{line.strip()[:40]}'"
            raise InputError(problem, where=f"{path}, line {number}") from None
        edges[-1].append((x, y))
    return tuple(np.array(edge).T for edge in edges if len(edge) > 1)
