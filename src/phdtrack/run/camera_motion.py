"""How the camera moves: measured in the pictures, read from a file, or as the detector finds it to
shake.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np

from phdtrack.config import Settings
from phdtrack.errors import InputError
from phdtrack.formats.warp_files import read_warps
from phdtrack.models import PlaneSensor
from phdtrack.models.scene import refuse_standing
from phdtrack.protocols import Model
from phdtrack.types import F8, STILL, Detections, Frame
from phdtrack.video.ego_motion import CameraMotion

Mover = Callable[[Frame, Detections, F8], F8]
"""(3, 3) from the pixels of the last frame to those of this one, or `types.STILL`, from a frame,
its detections, and the pose that the detector reports.
"""


def mover_of(settings: Settings, model: Model, *, pictures: bool) -> Mover | None:
    """The camera's motion as the settings choose it; None for a camera that stands still.

    Parameters
    ----------
    settings : their ``camera_motion`` is used.
    model : a model that lies at pixels, or on the ground, holds only while the camera stands still.
    pictures : whether the frames have pictures.

    Raises
    ------
    InputError : motion is to be measured without pictures, the model does not allow it, or its file
        cannot be read.
    """
    kind = settings.kind("camera_motion")
    if kind == "none":
        # A model at fixed pixels, or on the ground, is taken to hold: it is not moved for some
        # pixels.
        with suppress(InputError):
            refuse_standing(model)
            if isinstance(model.sensor, PlaneSensor):
                return None
            return shaking_camera()
        return None
    refuse_standing(model)
    chosen = settings.build("camera_motion")
    if kind == "file":
        return _from_file(chosen.file)
    if not pictures:
        problem = "the camera's motion is measured in pictures, and there are detections only"
        cure = "Name the video beside --detections, or give the motion as a file."
        raise InputError(problem, where="camera_motion.kind=flow", cure=cure)
    motion = CameraMotion(chosen)

    def measured(frame: Frame, detections: Detections, pose: F8) -> F8:
        warp = motion(frame.image, detections.xyxy)
        return warp if motion.measured else STILL

    return measured


def _from_file(file: str) -> Mover:
    """The motions in a file; those of dropped frames are composed."""
    warps = read_warps(file)
    last = 0

    def read(frame: Frame, detections: Detections, pose: F8) -> F8:
        nonlocal last
        before = last or frame.number - 1
        last = frame.number
        return warps.between(before, frame.number)

    return read


def shaking_camera() -> Mover:
    """The motion of a camera that stands and shakes, from the poses that the detector reports."""
    before = STILL

    def moved(frame: Frame, detections: Detections, pose: F8) -> F8:
        nonlocal before
        last = before
        if len(pose):
            before = pose
        if len(pose) and len(last):
            return pose @ np.linalg.inv(last)
        return STILL

    return moved
