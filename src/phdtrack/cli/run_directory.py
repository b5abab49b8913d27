"""The directory of a run: which files it holds, and that no earlier files are destroyed unasked.

An earlier run is replaced only when that was asked for, and even then only the files that a run writes are touched:
whatever else lies in the directory stays.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

from phdtrack.errors import InputError

TRACKS = "tracks.csv"
ONLINE = "tracks_online.csv"
STATES = "states.csv"
DETECTIONS = "detections.csv"
VIDEO = "annotated.mp4"
REPORT = "report.html"
RUN = "run.json"
GROUPS = "groups.csv"
MEMBERS = "members.csv"
EVENTS = "events.csv"
WARNINGS = "warnings.csv"
PLAN = "plan.mp4"
CAMERA_MOTION = "camera_motion.csv"
FILES = (TRACKS, ONLINE, STATES, DETECTIONS, VIDEO, REPORT, RUN)
# What a run that learns leaves of its scene besides, a file for each mode.
SCENES = ("scene.json", *(f"scene-{k}.json" for k in range(2, 9)))
RUN_FILES = (*FILES, *SCENES, CAMERA_MOTION)
# What `phdtrack groups` writes besides.
GROUP_FILES = (GROUPS, MEMBERS, EVENTS, WARNINGS, PLAN)


@dataclass(frozen=True, slots=True)
class RunDirectory:
    """A directory that is ready to be written into: it exists, and none of the files ``names`` did when it was claimed."""

    path: Path
    names: tuple[str, ...] = RUN_FILES

    def file(self, name: str) -> Path:
        """Where the file ``name``, one of ``names``, lies."""
        return self.path / name

    def written(self) -> list[Path]:
        """Those of the files that exist by now, in the order of ``names``."""
        return [self.path / name for name in self.names if (self.path / name).exists()]

    def clear(self) -> None:
        """Remove the files again: nothing came of the run, and what is there would be taken for a result."""
        for file in self.written():
            file.unlink()


def check(path: Path, overwrite: bool, names: tuple[str, ...] = RUN_FILES) -> None:
    """Fail early where `claim` would fail because of what is there already; changes nothing.

    Raises
    ------
    InputError : ``path`` is a file, or holds one of ``names`` and ``overwrite`` is False.
    """
    if path.exists() and not path.is_dir():
        raise InputError("a directory was expected, and this is a file", where=f"--out {path}", cure="Choose another --out.")
    held = [name for name in names if (path / name).exists()]
    if folders := [name for name in held if (path / name).is_dir()]:
        raise InputError(f"{folders[0]} is a directory, where a file is to be written", where=f"--out {path}")
    if held and not overwrite:
        raise InputError(
            f"the directory holds an earlier run ({', '.join(held)})",
            where=f"--out {path}",
            cure="Say --overwrite to replace these files, or choose another --out.",
        )


def claim(path: Path, overwrite: bool, names: tuple[str, ...] = RUN_FILES) -> RunDirectory:
    """The directory made ready; files of an earlier run are removed, so that none can be taken for this one's.

    Raises
    ------
    InputError : as `check`, or the directory cannot be made or written into.
    """
    check(path, overwrite, names)
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
        for name in names:
            (path / name).unlink(missing_ok=True)
    except OSError as error:
        problem = f"cannot be written into ({error.strerror or error})"
        raise InputError(problem, where=f"--out {path}", cure="Choose another --out.") from error
    return RunDirectory(path, names)
