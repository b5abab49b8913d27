"""Observers of a run: they take in every frame, and report at the end."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from typing import ClassVar, NamedTuple

from phdtrack.formats.warp_files import WarpsWriter
from phdtrack.report.pages import render
from phdtrack.run import directory as rundir
from phdtrack.run.directory import RunDirectory
from phdtrack.run.loop import TrackedFrame
from phdtrack.types import Image, Tracks

Draw = Callable[[int, float, Image], None]
"""Draws a frame, by its number, its time in seconds, and its annotated picture, which is empty if
the run has none.
"""


class Report(NamedTuple):
    """The results of an observer: for run.json, for the terminal, and as markup for the report.

    Attributes
    ----------
    document : values for run.json, by name.
    sentences : for the terminal.
    section : markup for report.html; empty for none.
    """

    document: dict[str, object]
    sentences: tuple[str, ...] = ()
    section: str = ""


class RunObserver:
    """An observer without files and videos; others override what they need.

    ``all_tracks``: `finish` needs the corrected tracks of the whole run, which are kept for it if
    the source has no end.
    """

    all_tracks: ClassVar[bool] = False

    def open(self, directory: RunDirectory, files: ExitStack) -> None:
        """Open its files until ``files`` are closed.

        Parameters
        ----------
        directory : of the run.
        files : closes them at the end.
        """

    def take(self, tracked: TrackedFrame) -> None:
        """Take in a frame.

        Parameters
        ----------
        tracked : a frame behind the tracker.
        """

    def finish(self, directory: RunDirectory, tracks: Tracks) -> None:
        """Take in the corrected tracks of the whole run, before anything is drawn or reported.

        Parameters
        ----------
        directory : of the run.
        tracks : corrected rows, boxes in pixels.
        """

    def drawing(self, directory: RunDirectory, files: ExitStack, *, pictures: bool) -> Draw | None:
        """A function that draws its video until ``files`` are closed, if it has one.

        Parameters
        ----------
        directory : of the run.
        files : closes the video.
        pictures : whether there are annotated pictures.
        """
        return None

    def report(self) -> Report:
        """Its results; none."""
        return Report({})


class CameraObserver(RunObserver):
    """Writes the camera's motion for another run to read, and reports how often it is unknown."""

    def __init__(self, kind: str) -> None:
        self._kind = kind
        self._known = list[bool]()

    def open(self, directory: RunDirectory, files: ExitStack) -> None:
        """Open the file of the motion."""
        self._file = files.enter_context(WarpsWriter(directory.file(rundir.CAMERA_MOTION)))

    def take(self, tracked: TrackedFrame) -> None:
        """Write one motion; there is none before the first frame."""
        step = tracked.step
        if self._known and len(step.warp):
            self._file.append(step.number, step.warp)
        self._known.append(len(step.warp) > 0)

    def report(self) -> Report:
        """How often the camera's motion is unknown."""
        frames = len(self._known[1:])
        unknown = self._known[1:].count(False)
        sentence = (
            f"in {unknown} of {frames} frames the camera's motion could not be measured and was"
            " taken for none"
        )
        document = {"kind": self._kind, "frames": frames, "frames_unmeasured": unknown}
        section = render("camera_motion.html", sentences=(sentence,))
        return Report({"camera_motion": document}, (sentence,), section)
