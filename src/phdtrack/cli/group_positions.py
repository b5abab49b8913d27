"""Groups among people whose positions, velocities and identities are known: no filter, only the grouping."""

from __future__ import annotations

import time
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from phdtrack import config
from phdtrack.cli import run_directory as rundir
from phdtrack.cli.configured import versions
from phdtrack.cli.group_files import GroupFiles
from phdtrack.cli.group_inputs import rate_of
from phdtrack.cli.group_story import Around, Story
from phdtrack.cli.inputs import NO_PICTURE
from phdtrack.cli.output import progress
from phdtrack.cli.run_directory import RunDirectory
from phdtrack.errors import InputError
from phdtrack.formats.positions import Positions, read_positions
from phdtrack.groups import LifeCycleState
from phdtrack.groups.pipeline import GroupStages, known_people
from phdtrack.report import About, write_run
from phdtrack.report.pages import positions_page
from phdtrack.report.run_json import json_value, write_text
from phdtrack.types import F8

_NOTE = (
    "The people, their velocities and identities were given; only the groups are estimated. Frame numbers are those of the "
    "file."
)


@dataclass(frozen=True, slots=True)
class KnownPeople:
    """What is to be done: people read from ``path``, at ``fps`` frames per second, and the settings."""

    path: Path
    positions: Positions
    fps: float
    settings: config.Settings
    edges: tuple[F8, ...]
    command: str
    video: bool


def prepare_positions(
    path: Path, fps: float, settings: config.Settings, edges: tuple[F8, ...], command: str, *, video: bool
) -> KnownPeople:
    """Everything that it needs; ``fps`` 0: as people's ways and velocities say.

    Raises
    ------
    InputError : the file cannot be read, holds nobody, or does not tell the rate.
    """
    positions = read_positions(path)
    if not len(positions):
        raise InputError("expected people, came a file without any", where=path)
    return KnownPeople(path, positions, fps or rate_of(positions, path), settings, edges, command, video)


def run_positions(job: KnownPeople, directory: RunDirectory) -> tuple[dict[str, object], tuple[str, ...]]:
    """Write everything; the content of run.json, and sentences."""
    started, clock = datetime.now(UTC), time.perf_counter()
    story = Story(Around(edges=job.edges), raw=False)
    frames = np.unique(job.positions.frame)
    _grouped(job, config.build_groups(job.settings), story, frames, directory)
    if job.video:
        _drawn(job, story, frames, directory)
    people = len(np.unique(job.positions.identity))
    first = f"{people} people in {len(frames)} frames at {job.fps:.4g} frames per second."
    said = (first, *story.sentences())
    about = About(title=job.path.parent.name or job.path.name, command=job.command, versions=versions(), notes=(_NOTE,))
    chosen = {name: value for name, value in job.settings.as_dict().items() if name in GROUP_SECTIONS}
    page = positions_page(about, str(job.path), " ".join(said), story.section(), chosen)
    write_text(directory.file(rundir.REPORT), page)
    files = {file.name: str(file) for file in directory.written()} | {rundir.RUN: str(directory.file(rundir.RUN))}
    document: dict[str, object] = {
        "command": job.command,
        "title": about.title,
        "summary": list(said),
        "versions": dict(about.versions),
        "started": started.isoformat(timespec="seconds"),
        "seconds": time.perf_counter() - clock,
        "frames": len(frames),
        "people": people,
        "configuration": chosen,
        "complete": True,
        "input": {"positions": str(job.path), "fps": job.fps},
        "directory": str(directory.path),
        "files": files,
        **story.document(),
    }
    document = {key: json_value(value) for key, value in document.items()}
    write_run(directory.file(rundir.RUN), document)
    return document, said


GROUP_SECTIONS = ("groups", "contours", "life_cycle", "encounters")


def _grouped(
    job: KnownPeople, stages: GroupStages, story: Story, frames: np.ndarray[tuple[int, ...], np.dtype[np.int64]],
    directory: RunDirectory,
) -> None:  # fmt: skip
    """Every frame through the stages, into files and story."""
    state, nothing = LifeCycleState(), np.zeros((2, 0))
    with GroupFiles(directory, None) as files, progress("grouping", len(frames)) as advance:
        for done, number in enumerate(frames.tolist(), start=1):
            here = job.positions.at(number)
            everybody = np.arange(len(here))
            at = (number - int(frames[0])) / job.fps
            state, frame = stages.advance(state, known_people(here.state), here.identity, everybody, number, at)
            files.write(frame)
            story.take(frame, here.state[:2], nothing)
            advance(done)


def _drawn(
    job: KnownPeople, story: Story, frames: np.ndarray[tuple[int, ...], np.dtype[np.int64]], directory: RunDirectory
) -> None:
    """plan.mp4, one picture for each frame with people, as fast as these usually follow each other."""
    step = float(np.median(np.diff(frames))) if len(frames) > 1 else 1.0
    with (
        story.video(directory, job.fps / step, picture=None) as draw,
        progress("drawing", len(frames)) as advance,
    ):
        for done, number in enumerate(frames.tolist(), start=1):
            draw(number, NO_PICTURE)
            advance(done)
