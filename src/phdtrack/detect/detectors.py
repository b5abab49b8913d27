"""Detectors by name, and the settings that each of them takes."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

from phdtrack.detect.base import Detector
from phdtrack.detect.change import ChangeDetector
from phdtrack.detect.components import ConnectedComponents
from phdtrack.detect.mean_background import MeanBackgroundDetector
from phdtrack.detect.moving_regions import BACKGROUND
from phdtrack.detect.onnx import OnnxDetector, export_cure
from phdtrack.detect.opencv import FaceDetector, Mog2Detector, PersonDetector
from phdtrack.detect.wrappers import Masked, Rescaled
from phdtrack.errors import InputError, did_you_mean
from phdtrack.types import Bool, Image, SequenceInfo

_TYPE_NAMES = {float: "a number", int: "a whole number", bool: "true or false", str: "text"}
_BUILD: dict[str, Any] = {
    "change": ChangeDetector,
    "mean-background": MeanBackgroundDetector,
    "mog2": Mog2Detector,
    "face": FaceDetector,
    "person": PersonDetector,
}
DETECTORS = tuple(_BUILD)
# The prefix of a network's name; its file follows.
_NETWORK = "onnx:"
# Pixels on the longer side that background subtraction needs.
_WORKING_SIDE = 640


def working_width(name: str, given: int | None, info: SequenceInfo) -> int:
    """The width in pixels to which a detector's frames are shrunk; 0 if they are not.

    Parameters
    ----------
    name : of the detector.
    given : the width that the user chose; None: for detectors of `BACKGROUND` the largest whole
        factor that leaves 640 pixels on the longer side.
    info : the video.

    Returns
    -------
    width : as `make_detector` takes it.
    """
    if given is not None:
        return given
    factor = max(info.width, info.height) // _WORKING_SIDE
    if factor > 1 and name in BACKGROUND:
        return round(info.width / factor)
    return 0


def detector_parameters(name: str) -> dict[str, Any]:
    """The parameters of detector ``name`` and their defaults, including those of the clean-up.

    Parameters
    ----------
    name : one of `DETECTORS`, or ``onnx:`` and the file of a network.

    Returns
    -------
    Values by name.

    Raises
    ------
    InputError : there is no such detector.
    """
    if name.startswith(_NETWORK):
        return {field.name: field.default for field in fields(OnnxDetector) if field.name != "file"}
    if name not in DETECTORS:
        cure = (
            f"{did_you_mean(name, DETECTORS)} For your own network use onnx:FILE, for its boxes"
            " --detections FILE."
        )
        if name.endswith(".onnx"):
            cure = f"Use {_NETWORK}{name}"
        cure = export_cure(Path(name)) or cure
        raise InputError(f"there is no detector {name!r}", cure=cure)
    known = {field.name: field.default for one in detector_records(name) for field in fields(one)}
    known.pop("blobs", None)
    return known


def detector_records(name: str) -> tuple[type[Any], ...]:
    """The dataclasses whose fields are the parameters of one of `DETECTORS`: its own, and that of
    the clean-up if it has a mask.
    """
    own: type[Any] = _BUILD[name]
    if "blobs" in own.__dataclass_fields__:
        return own, ConnectedComponents
    return (own,)


def make_detector(
    name: str,
    *,
    max_width: int = 0,
    mask: Image | Bool | str | Path | None = None,
    **parameters: Any,
) -> Detector:
    """The detector called ``name``.

    Parameters
    ----------
    name : one of `DETECTORS`, or ``onnx:`` and the file of a network.
    max_width : above 0, wider frames are shrunk to this many pixels for detection; boxes stay in
        pixels of the original frame.
    mask : (H, W) array or image file; only boxes at least half inside its region are reported.
    parameters : fields of the detector, and of `ConnectedComponents` for those that clean a mask.

    Returns
    -------
    The detector.

    Raises
    ------
    InputError : an unknown name or parameter (the nearest one is suggested), or a value of the
        wrong type or out of range.
    """
    known = detector_parameters(name)
    own = dict[str, Any]()
    blobs = dict[str, Any]()
    for key, value in parameters.items():
        if key not in known:
            raise InputError(
                f"detector {name!r} has no parameter {key!r}", cure=did_you_mean(key, known)
            )
        target = blobs if key in ConnectedComponents.__dataclass_fields__ else own
        # A default of None means: as the network usually has it.
        expected = bool if known[key] is None else type(known[key])
        target[key] = _converted(key, value, expected)
    if blobs:
        own["blobs"] = ConnectedComponents(**blobs)
    if name.startswith(_NETWORK):
        own["file"] = name.removeprefix(_NETWORK)
    detector: Detector = _BUILD.get(name, OnnxDetector)(**own)
    if max_width:
        detector = Rescaled(detector, max_width)
    if mask is None:
        return detector
    return Masked(detector, mask)


def _converted(key: str, value: Any, expected: type) -> Any:
    """The value of a parameter, whole numbers as float if needed. Raises `InputError` for another
    type.
    """
    if expected is float and type(value) is int:
        return float(value)
    if not isinstance(value, expected) or isinstance(value, bool) > (expected is bool):
        raise InputError(
            f"expected {_TYPE_NAMES[expected]}, got {value!r}", where=f"detector.{key}"
        )
    return value
