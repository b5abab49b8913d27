"""What goes along with a run: observers that take in every step and report it at the end, and how
the camera moves.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import ClassVar, NamedTuple

import numpy as np

from phdtrack.config import Settings
from phdtrack.errors import InputError
from phdtrack.formats.warp_files import WarpsWriter, read_warps
from phdtrack.models import PlaneSensor
from phdtrack.models.scene import refuse_standing
from phdtrack.pipeline import TrackingState
from phdtrack.protocols import Model
from phdtrack.report.pages import render
from phdtrack.run import directory as rundir
from phdtrack.run.directory import RunDirectory
from phdtrack.run.inputs import Inputs, Mover
from phdtrack.types import F8, STILL, Detections, Frame, Image, Step, Tracks
from phdtrack.video.ego_motion import CameraMotion

Draw = Callable[[int, Image], None]
"""Draws a frame, by its number and its annotated picture, which is empty where the run has none."""


class Report(NamedTuple):
    """What came of an observer: for run.json, for the terminal, and as markup for the report."""

    document: dict[str, object]
    sentences: tuple[str, ...] = ()
    section: str = ""


class RunObserver:
    """An observer without files and videos; others override what they need.

    ``all_tracks``: `finish` needs the corrected tracks of the whole run; where the source has no
    end, they are kept for it.
    """

    all_tracks: ClassVar[bool] = False

    def open(self, directory: RunDirectory, files: ExitStack) -> None:
        """Open its files until ``files`` are closed."""

    def take(self, found: Detections, step: Step, state: TrackingState) -> None:
        """Take in a frame: all its detections, as rows count them, its step, and the tracker's
        state after it.
        """

    def finish(self, directory: RunDirectory, tracks: Tracks) -> None:
        """Take in the corrected tracks of the whole run, before anything is drawn or reported."""

    def drawing(self, directory: RunDirectory, files: ExitStack, *, pictures: bool) -> Draw | None:
        """What draws its video until ``files`` are closed; ``pictures``: there are annotated
        ones.
        """
        return None

    def report(self) -> Report:
        """What came of it; nothing."""
        return Report({})


class CameraObserver(RunObserver):
    """Writes the camera's motion for another run to read, and reports how often it is not known."""

    def __init__(self, kind: str) -> None:
        self._kind = kind
        self._known = list[bool]()

    def open(self, directory: RunDirectory, files: ExitStack) -> None:
        """Open the file of the motion."""
        self._file = files.enter_context(WarpsWriter(directory.file(rundir.CAMERA_MOTION)))

    def take(self, found: Detections, step: Step, state: TrackingState) -> None:
        """Write one motion; before the first frame there is none."""
        if self._known and len(step.warp):
            self._file.append(step.number, step.warp)
        self._known.append(len(step.warp) > 0)

    def report(self) -> Report:
        """How often the camera's motion is not known."""
        frames = len(self._known[1:])
        unknown = self._known[1:].count(False)
        said = (
            f"in {unknown} of {frames} frames the camera's motion could not be measured and was"
            " taken for none"
        )
        document = {"kind": self._kind, "frames": frames, "frames_unmeasured": unknown}
        return Report(
            {"camera_motion": document}, (said,), render("camera_motion.html", sentences=(said,))
        )


def mover_of(settings: Settings, inputs: Inputs, model: Model) -> Mover | None:
    """How the camera moves: as the detector finds it to shake, as measured in the pictures, or as a
    file has it.

    Raises `InputError` where there are no pictures, and for settings that hold only while the
    camera stands still.
    """
    kind = settings.kind("camera_motion")
    chosen = settings.build("camera_motion")
    if kind == "none":
        # A model that lies at pixels, or on the ground, is taken to hold: it is not moved for some
        # pixels.
        with suppress(InputError):
            refuse_standing(model)
            if isinstance(model.sensor, PlaneSensor):
                return None
            return _shaking()
        return None
    refuse_standing(model)
    if kind == "flow":
        if not inputs.pictures:
            problem = "the camera's motion is measured in pictures, and there are detections only"
            cure = "Name the video beside --detections, or give the motion as a file."
            raise InputError(problem, where="camera_motion.kind=flow", cure=cure)
        motion = CameraMotion(chosen)

        def measured(frame: Frame, found: Detections, pose: F8) -> F8:
            warp = motion(frame.image, found.xyxy)
            return warp if motion.measured else STILL

        return measured
    warps = read_warps(chosen.file)
    last = 0

    def read(frame: Frame, found: Detections, pose: F8) -> F8:
        """The motions of the frames since the last one, dropped frames among them."""
        nonlocal last
        before = last or frame.number - 1
        last = frame.number
        return warps.between(before, frame.number)

    return read


def _shaking() -> Mover:
    """The motion of a camera that stands and shakes."""
    before = STILL

    def moved(frame: Frame, found: Detections, pose: F8) -> F8:
        nonlocal before
        last = before
        before = pose if len(pose) else before
        if len(pose) and len(last):
            return pose @ np.linalg.inv(last)
        return STILL

    return moved
