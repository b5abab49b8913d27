"""Detectors by name: the one list of what there is, and how options of that name become settings; detections from a table or
from any function of the picture; detectors that search a smaller picture or report only a region of interest."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from phdtrack.detect.change import ChangeDetector, ChangeSettings, MeanBackgroundDetector, MeanBackgroundSettings
from phdtrack.detect.components import BlobSettings
from phdtrack.detect.convert import as_detections, check_inside
from phdtrack.detect.opencv import (
    FaceDetector,
    FaceSettings,
    PersonDetector,
    PersonSettings,
    SubtractorDetector,
    SubtractorSettings,
)
from phdtrack.errors import InputError
from phdtrack.protocols import Detector
from phdtrack.types import F8, Bool, Detections, DetectionTable, Frame, Image

_WORDS = {float: "a number", int: "a whole number", bool: "true or false", str: "text"}
_INSIDE = 0.5
# Pixels on a side below which no detector sees anything, and the clean-up's windows are larger than the picture.
_SMALLEST = 16


class TableDetector:
    """The rows of ``table`` by frame number; frames without rows are empty. The picture is not looked at."""

    def __init__(self, table: DetectionTable) -> None:
        self._table = table

    def reset(self) -> None:
        """Nothing to forget."""

    def __call__(self, frame: Frame) -> Detections:
        """The detections of frame ``frame.number``."""
        return self._table.at(frame.number)


class CallableDetector:
    """Any function of a BGR picture (H, W, 3) uint8 that gives boxes in one of the forms that `as_detections` takes.

    Boxes wholly outside the frame are an error that names it, or are left out with ``drop_outside``. A function that
    remembers earlier pictures is not reset: give a new detector for a new video.
    """

    def __init__(self, function: Callable[[Image], object], *, drop_outside: bool = False) -> None:
        self._function = function
        self._drop = drop_outside

    def reset(self) -> None:
        """Nothing to forget here."""

    def __call__(self, frame: Frame) -> Detections:
        """What the function finds in ``frame``, checked."""
        where = f"frame {frame.number}"
        found = as_detections(self._function(frame.image), where=where)
        height, width = frame.image.shape[:2]
        return check_inside(found, width, height, where=where, drop=self._drop)


class Rescaled:
    """``detector`` on frames shrunk to ``max_width`` pixels; boxes come back in the coordinates of the original.

    Narrower frames are left as they are.
    """

    def __init__(self, detector: Detector, max_width: int) -> None:
        if max_width < 1:
            raise InputError(f"the width must be at least one pixel, not {max_width}", where="max_width")
        self._detector = detector
        self._max_width = max_width

    def reset(self) -> None:
        """Reset the detector inside."""
        self._detector.reset()

    def __call__(self, frame: Frame) -> Detections:
        """The boxes found in the smaller picture, (N, 4) in pixels of ``frame``."""
        height, width = frame.image.shape[:2]
        if width <= self._max_width:
            return self._detector(frame)
        small = (self._max_width, round(height * self._max_width / width))
        if min(small) < _SMALLEST:
            raise InputError(
                f"frames of {width}x{height} pixels would be shrunk to {small[0]}x{small[1]}",
                where="max_width",
                cure=f"At least {_SMALLEST} pixels must be left on either side; 320 is a usual width.",
            )
        image = np.asarray(cv2.resize(frame.image, small, interpolation=cv2.INTER_AREA), np.uint8)
        found = self._detector(Frame(frame.number, frame.time, image))
        factor = np.tile([width / small[0], height / small[1]], 2)
        covariance = None if found.covariance is None else found.covariance * np.outer(factor, factor)
        return dataclasses.replace(found, xyxy=found.xyxy * factor, covariance=covariance)


class Masked:
    """``detector``, which sees the whole picture; boxes at least half inside a region of interest are kept.

    ``mask``, an (H, W) array or image file of the frame's size, is not 0 in the region.
    """

    def __init__(self, detector: Detector, mask: Image | Bool | str | Path) -> None:
        self._detector = detector
        self._where = str(mask) if isinstance(mask, str | Path) else "mask"
        region = _read_mask(Path(mask)) if isinstance(mask, str | Path) else np.asarray(mask)
        if region.ndim != 2:
            raise InputError(f"a mask has the shape (height, width), this one {region.shape}", where=self._where)
        if not region.any():
            cure = "White is where to look, black is left out."
            raise InputError("the mask is black all over: nothing could be reported", where=self._where, cure=cure)
        self._shape = region.shape
        self._sum: F8 = cv2.integral((region != 0).astype(np.uint8)).astype(np.float64)

    def reset(self) -> None:
        """Reset the detector inside."""
        self._detector.reset()

    def __call__(self, frame: Frame) -> Detections:
        """The boxes found in the region."""
        if frame.image.shape[:2] != self._shape:
            height, width = frame.image.shape[:2]
            raise InputError(
                f"the mask is {self._shape[1]}x{self._shape[0]} pixels, frame {frame.number} is {width}x{height}",
                where=self._where,
                cure="Draw the mask on a frame of this video, at its full size.",
            )
        found = self._detector(frame)
        corners = np.rint(found.xyxy).astype(np.int64)
        left, right = np.clip(corners[:, [0, 2]], 0, self._shape[1]).T
        top, bottom = np.clip(corners[:, [1, 3]], 0, self._shape[0]).T
        total = self._sum[bottom, right] - self._sum[top, right] - self._sum[bottom, left] + self._sum[top, left]
        return found.take(total >= _INSIDE * np.maximum((right - left) * (bottom - top), 1))


def _read_mask(path: Path) -> Image:
    """The picture in a file, grey."""
    try:
        data = np.fromfile(path, np.uint8)
    except OSError as error:
        raise InputError(f"the mask cannot be read ({error.strerror})", where=path) from None
    image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE) if data.size else None
    if image is None:
        raise InputError("this is not an image that can be read", where=path, cure="A mask is a PNG file, say.")
    return np.asarray(image, np.uint8)


class _Entry(NamedTuple):
    """A detector's class, its settings' class, what it finds, and the method that the name itself settles."""

    build: Callable[[Any], Detector]
    settings: type[Any]
    summary: str
    method: str = ""


_ENTRIES = {
    "change": _Entry(ChangeDetector, ChangeSettings, "what differs from the scene as learned, shadows and flicker aside"),
    "mean-background": _Entry(MeanBackgroundDetector, MeanBackgroundSettings, "what differs from the first frames' mean"),
    "mog2": _Entry(SubtractorDetector, SubtractorSettings, "OpenCV's mixture of Gaussians", "mog2"),
    "knn": _Entry(SubtractorDetector, SubtractorSettings, "OpenCV's nearest neighbours", "knn"),
    "face": _Entry(FaceDetector, FaceSettings, "faces, by a Viola-Jones cascade"),
    "person": _Entry(PersonDetector, PersonSettings, "pedestrians, by gradient histograms"),
}
_GIVEN: dict[str, tuple[Callable[..., Detector], str]] = {
    "file": (TableDetector, "table, a DetectionTable"),
    "callable": (CallableDetector, "function, of a picture"),
}

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
    own = [field for field in dataclasses.fields(_ENTRIES[name].settings) if field.name not in ("blobs", "method")]
    blobs = any(field.name == "blobs" for field in dataclasses.fields(_ENTRIES[name].settings))
    return (*own, *(dataclasses.fields(BlobSettings) if blobs else ()))


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

    Returns
    -------
    The detector.

    Raises
    ------
    InputError : an unknown name or parameter (the nearest one is suggested), or a value out of range.
    """
    if name in _GIVEN:
        build, needed = _GIVEN[name]
        try:
            detector = build(**parameters)
        except TypeError:
            got = ", ".join(parameters) or "nothing"
            raise InputError(f"detector {name!r} takes {needed}; got {got}") from None
    else:
        detector = _learning(name, parameters)
    if max_width:
        detector = Rescaled(detector, max_width)
    return detector if mask is None else Masked(detector, mask)


def _learning(name: str, parameters: dict[str, Any]) -> Detector:
    """A detector that needs nothing but the video."""
    known = tuple(field.name for field in detector_parameters(name))
    for key in parameters:
        if key not in known:
            raise InputError(f"detector {name!r} has no parameter {key!r}", cure=_suggest(key, known))
    entry, values = _ENTRIES[name], dict(parameters)
    of_blobs = {field.name for field in dataclasses.fields(BlobSettings)} & set(values)
    if of_blobs:
        values["blobs"] = BlobSettings(**{key: values.pop(key) for key in of_blobs})
    if entry.method:
        values["method"] = entry.method
    return entry.build(entry.settings(**values))


def _suggest(name: str, known: tuple[str, ...]) -> str:
    """The nearest name, and all."""
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    meant = f"Did you mean {close[0]!r}? " if close else ""
    return f"{meant}There are {', '.join(known)}."
