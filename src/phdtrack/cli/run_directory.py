"""The directory of a run: which files it holds, and that no earlier run is replaced unasked.

Only the files that a run writes are touched: whatever else lies in the directory stays.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from phdtrack.errors import InputError

TRACKS, ONLINE, STATES, DETECTIONS = "tracks.csv", "tracks_online.csv", "states.csv", "detections.csv"
GROUPS, MEMBERS, EVENTS, WARNINGS = "groups.csv", "members.csv", "events.csv", "warnings.csv"
VIDEO, PLAN, REPORT, RUN, CAMERA_MOTION = "annotated.mp4", "plan.mp4", "report.html", "run.json", "camera_motion.csv"
# What a run that learns leaves of its scene, a file for each mode.
SCENES = ("scene.json", *(f"scene-{k}.json" for k in range(2, 9)))
# Every file that a run may write, and what it is; without words it is not listed for people.
RUN_FILES = {
    TRACKS: "tracks, corrected, MOTChallenge",
    ONLINE: "the same as they came, frame by frame",
    STATES: "the filter's states before they had identities",
    DETECTIONS: "what the detector saw",
    GROUPS: "every group in every frame: count, place, contour",
    MEMBERS: "members of each group",
    EVENTS: "groups that appear, vanish, merge, split",
    WARNINGS: "groups about to meet",
    VIDEO: "to look at",
    PLAN: "the ground from above",
    CAMERA_MOTION: "how the camera moved, for --camera-motion",
    **dict.fromkeys(SCENES, ""),
    SCENES[0]: "what was learned of the scene, for --scene",
    REPORT: "the run in pictures and numbers",
    RUN: "everything that decided it, for programs",
}


@dataclass(frozen=True, slots=True)
class RunDirectory:
    """A directory that is ready to be written into; none of its ``files``, by name with what they are, is there yet."""

    path: Path
    files: Mapping[str, str]

    def file(self, name: str) -> Path:
        """Where the file ``name`` lies."""
        return self.path / name

    def written(self) -> list[Path]:
        """Those of the files that exist by now."""
        return [self.file(name) for name in self.files if self.file(name).exists()]

    def listing(self) -> list[str]:
        """A line for each of these that says what it is."""
        return [f"  {file}  {self.files[file.name]}" for file in self.written() if self.files.get(file.name)]

    def clear(self) -> None:
        """Remove the files again: nothing came of the run, and what is there would be taken for a result."""
        for file in self.written():
            file.unlink()


def check(path: Path | None, overwrite: bool, files: Mapping[str, str] = RUN_FILES) -> None:
    """Raise `InputError` where `claim` would because of what is there already: ``path`` is a file, or holds one of ``files``
    and ``overwrite`` is False."""
    if path is None:
        return
    where = f"--out {path}"
    if path.exists() and not path.is_dir():
        raise InputError("a directory was expected, and this is a file", where=where, cure="Choose another --out.")
    held = [name for name in files if (path / name).exists()]
    if folders := [name for name in held if (path / name).is_dir()]:
        raise InputError(f"{folders[0]} is a directory, where a file is to be written", where=where)
    if held and not overwrite:
        problem = f"the directory holds an earlier run ({', '.join(held)})"
        raise InputError(problem, where=where, cure="Say --overwrite to replace these files, or choose another --out.")


def claim(out: Path | None, overwrite: bool, files: Mapping[str, str] = RUN_FILES, *, name: str = "") -> RunDirectory:
    """``out``, or ``runs/NAME``, made ready: files of an earlier run are removed, so that none is taken for one of this run.

    Raises `InputError` as `check`, or where the directory cannot be made or written into.
    """
    path = out or Path("runs") / name
    check(path, overwrite, files)
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
        for name in files:
            (path / name).unlink(missing_ok=True)
    except OSError as error:
        problem = f"cannot be written into ({error.strerror or error})"
        raise InputError(problem, where=f"--out {path}", cure="Choose another --out.") from error
    return RunDirectory(path, files)
