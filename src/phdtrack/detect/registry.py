"""Detectors by name: the one list of what there is, and how options of that name become settings."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from phdtrack.detect.background import MeanBackgroundDetector, MeanBackgroundSettings, SubtractorDetector, SubtractorSettings
from phdtrack.detect.change import ChangeDetector, ChangeSettings
from phdtrack.detect.components import BlobSettings
from phdtrack.detect.person import FaceDetector, FaceSettings, PersonDetector, PersonSettings
from phdtrack.detect.wrappers import CallableDetector, Masked, Rescaled, TableDetector
from phdtrack.errors import InputError
from phdtrack.protocols import Detector
from phdtrack.types import Bool, Image

_WORDS = {float: "a number", int: "a whole number", bool: "true or false", str: "text"}


def typed(name: str, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """``parameters`` of detector ``name`` in the types of its defaults; unknown ones are left for `make_detector` to refuse.

    Raises
    ------
    InputError : a value of another type.
    """
    kinds = {field.name: type(field.default) for field in detector_parameters(name)}
    values = dict(parameters)
    for key, value in values.items():
        kind = kinds.get(key, type(value))
        if kind is float and type(value) is int:
            values[key] = float(value)
        elif kind in _WORDS and type(value) is not kind:
            raise InputError(f"expected {_WORDS[kind]}, got {value!r}", where=f"detector.{key}")
    return values


@dataclass(frozen=True, slots=True)
class _Entry:
    """A detector's class, its settings' class, and what the name itself settles."""

    build: Callable[[Any], Detector]
    settings: type[Any]
    summary: str
    fixed: tuple[tuple[str, Any], ...] = ()


_ENTRIES = {
    "change": _Entry(ChangeDetector, ChangeSettings, "what differs from the scene as learned, shadows and flicker aside"),
    "mean-background": _Entry(MeanBackgroundDetector, MeanBackgroundSettings, "what differs from the first frames' mean"),
    "mog2": _Entry(SubtractorDetector, SubtractorSettings, "OpenCV's mixture of Gaussians", (("method", "mog2"),)),
    "knn": _Entry(SubtractorDetector, SubtractorSettings, "OpenCV's nearest neighbours", (("method", "knn"),)),
    "face": _Entry(FaceDetector, FaceSettings, "faces, by a Viola-Jones cascade"),
    "person": _Entry(PersonDetector, PersonSettings, "pedestrians, by gradient histograms"),
}
_GIVEN: dict[str, Callable[..., Detector]] = {"file": TableDetector, "callable": CallableDetector}

DETECTORS = (*_ENTRIES, *_GIVEN)
# Those whose detections are blobs of what differs from the background, one or several objects, or a piece of one.
BACKGROUND = ("change", "mean-background", "mog2", "knn")


def detector_names() -> tuple[tuple[str, str], ...]:
    """Pairs (name, what it finds) of the detectors that need nothing but the video."""
    return tuple((name, entry.summary) for name, entry in _ENTRIES.items())


def detector_parameters(name: str) -> tuple[dataclasses.Field[Any], ...]:
    """The parameters of detector ``name`` with their defaults, those of the clean-up included."""
    if name not in _ENTRIES:
        raise InputError(f"there is no detector {name!r}", cure=_suggest(name, DETECTORS))
    flat: list[dataclasses.Field[Any]] = []
    for field in dataclasses.fields(_ENTRIES[name].settings):
        flat.extend(dataclasses.fields(BlobSettings) if field.name == "blobs" else (field,))
    return tuple(field for field in flat if field.name not in dict(_ENTRIES[name].fixed))


def make_detector(
    name: str, *, max_width: int = 0, mask: Image | Bool | str | Path | None = None, **parameters: Any
) -> Detector:
    """The detector called ``name``.

    Parameters
    ----------
    name : one of `DETECTORS`. "file" takes ``table`` (a `DetectionTable`), "callable" takes ``function``.
    max_width : above 0, wider frames are shrunk to this many pixels for the search; boxes stay in original coordinates.
    mask : (H, W) array or image file; only boxes at least half inside its region are reported.
    parameters : fields of the detector's settings, and of `BlobSettings` for those that clean a mask.

    Raises
    ------
    InputError : an unknown name or parameter (the nearest one is suggested), or a value out of range.
    """
    detector = _given(name, parameters) if name in _GIVEN else _learning(name, parameters)
    if max_width:
        detector = Rescaled(detector, max_width)
    return detector if mask is None else Masked(detector, mask)


def _given(name: str, parameters: dict[str, Any]) -> Detector:
    try:
        return _GIVEN[name](**parameters)
    except TypeError:
        needed = "table, a DetectionTable" if name == "file" else "function, of a picture"
        raise InputError(f"detector {name!r} takes {needed}; got {', '.join(parameters) or 'nothing'}") from None


def _learning(name: str, parameters: dict[str, Any]) -> Detector:
    known = tuple(field.name for field in detector_parameters(name))
    for key in parameters:
        if key not in known:
            raise InputError(f"detector {name!r} has no parameter {key!r}", cure=_suggest(key, known))
    entry = _ENTRIES[name]
    names = {field.name for field in dataclasses.fields(entry.settings)}
    values = {key: value for key, value in parameters.items() if key in names} | dict(entry.fixed)
    if "blobs" in names:
        values["blobs"] = BlobSettings(**{key: value for key, value in parameters.items() if key not in names})
    return entry.build(entry.settings(**values))


def _suggest(name: str, known: tuple[str, ...]) -> str:
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    meant = f"Did you mean {close[0]!r}? " if close else ""
    return f"{meant}There are {', '.join(known)}."
