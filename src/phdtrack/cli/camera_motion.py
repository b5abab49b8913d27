"""The camera's motion along a run: measured in the pictures or read from a file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Protocol

from phdtrack.cli.inputs import Inputs
from phdtrack.config import Settings
from phdtrack.errors import InputError
from phdtrack.formats.warps import Warps, read_warps
from phdtrack.models.standing import not_standing, refuse_standing
from phdtrack.protocols import Model
from phdtrack.types import F8, STILL, Detections, Frame
from phdtrack.video.ego_motion import CameraMotion


class Mover(Protocol):
    """Says how the camera has moved since the frame before."""

    def __call__(self, frame: Frame, found: Detections) -> F8:
        """(3, 3) from the pixels of the last frame that it was asked about to this one's, or `types.STILL`."""


def standing(frame: Frame, found: Detections) -> F8:
    """The camera does not move."""
    return STILL


class MeasurementHistory:
    """By what the pictures show."""

    def __init__(self, motion: CameraMotion) -> None:
        self._motion = motion

    def __call__(self, frame: Frame, found: Detections) -> F8:
        """MeasurementHistory between the last frame and this one."""
        warp = self._motion(frame.image, found.xyxy)
        return warp if self._motion.flow.measured else STILL


class Read:
    """As a file has it."""

    def __init__(self, warps: Warps) -> None:
        self._warps, self._last = warps, 0

    def __call__(self, frame: Frame, found: Detections) -> F8:
        """The motions of the frames since the last, those that were dropped among them."""
        last, self._last = self._last or frame.number - 1, frame.number
        return self._warps.between(last, frame.number)


def moved(mover: Mover, looked: Iterable[tuple[Frame, Detections, float]]) -> Iterator[tuple[Frame, Detections, F8, float]]:
    """Each frame with its detections, how the camera moved, and the seconds that detecting took."""
    for frame, found, seconds in looked:
        yield frame, found, mover(frame, found), seconds


def mover_of(settings: Settings, inputs: Inputs) -> Mover:
    """What the settings ask for.

    Raises
    ------
    InputError : pictures are asked for and there are none, or the file cannot be read or does not belong to this sequence.
    """
    kind = settings.kind("camera_motion")
    if kind == "none":
        return standing
    chosen = settings.build("camera_motion")
    if kind == "flow":
        if not inputs.pictures:
            raise InputError(
                "the camera's motion is measured in pictures, and there are detections only",
                where="camera_motion.kind=flow",
                cure="Name the video beside --detections, or give the motion as a file.",
            )
        return MeasurementHistory(CameraMotion(chosen))
    warps = read_warps(chosen.file)
    last = int(warps.frame[-1]) if len(warps.frame) else 0
    if inputs.info.frames and last > inputs.info.frames:
        raise InputError(
            f"the camera's motion goes on to frame {last}, and {inputs.name} has {inputs.info.frames}",
            where=chosen.file,
            cure="Is it the motion of this sequence?",
        )
    return Read(warps)


def check_moving(settings: Settings, model: Model) -> None:
    """Raise `InputError` where something of the settings holds only while the camera stands still, and it does not."""
    if settings.kind("camera_motion") == "none":
        return
    refuse_standing(model)
    if settings.kind("learn") != "none":
        raise not_standing("learning where false alarms and entrances are (learn.kind=online)")
