"""From whatever a detector hands over to `Detections`, with every value checked.

Accepted: a `Detections`; anything with ``.xyxy`` and, where it has them, ``.confidence`` (or
``.conf``) and ``.class_id`` (or ``.cls``), as supervision and ultralytics write them; a whole
result of ultralytics, whose ``.boxes`` are such, also as the only one of a list; an array-like of
shape (N, 4) xyxy, (N, 5) with confidence, (N, 6) with confidence and class. Tensors are copied to
the CPU. No boxes: an empty array of any shape.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from phdtrack.arrays import share_inside
from phdtrack.errors import Checked, InputError, PositiveCount
from phdtrack.types import F8, I8, Detections, DetectionTable, SequenceInfo

_COLUMNS = (
    "boxes as (N, 4) left, top, right, bottom; (N, 5) with confidence; (N, 6) with confidence and"
    " class"
)
_LARGEST_CLASS = 2.0**53
# The shortest side of a box, pixels; the longest, and how far its centre may be outside, in frames.
# Where the size of the frame is not known, a side of it that no camera has.
SHORTEST = 1e-3
LONGEST = 10.0
UNKNOWN = 1e6
# Classes that are tracked apart, the first.
MAX_CLASSES = 100
# Pixels that boxes in shares of the image's size do not exceed.
_SMALL = 1.5
# Boxes that are enough to tell corners from sizes; the shares of them that reach beyond the frame,
# and look like corners.
_SOME = 20
_MOST = 0.5
_ALMOST_ALL = 0.95


def as_detections(obj: object, *, where: str = "") -> Detections:
    """``obj``, in one of the forms above, as `Detections`, checked; ``where`` begins the message of
    an error ("frame 12").

    Raises `InputError` where it has another shape, or values that are not finite numbers: then it
    names the row.
    """
    if isinstance(obj, Detections):
        return _checked(obj, where)
    if obj is None:
        cure = "Where nothing was detected give an empty array: numpy.empty((0, 4))."
        raise InputError("expected boxes, got None", where=where, cure=cure)
    if isinstance(obj, list | tuple) and len(obj) == 1:
        whole = obj[0]
    else:
        whole = obj
    if getattr(whole, "obb", None) is not None:
        raise InputError(
            "expected upright boxes, got oriented ones",
            where=where,
            cure="Give result.obb, which has .xyxy.",
        )
    inner = getattr(whole, "boxes", None)
    obj = obj if inner is None else inner
    boxes = getattr(obj, "xyxy", None)
    table = _numbers(obj if boxes is None else boxes, where)
    n = len(table) if table.size else 0
    if boxes is not None:
        if n and (table.ndim != 2 or table.shape[1] != 4):
            raise InputError(f"expected .xyxy of shape (N, 4), got {table.shape}", where=where)
        score, label = (
            _attribute(obj, names, n, where)
            for names in (("confidence", "conf"), ("class_id", "cls"))
        )
    elif n and (table.ndim != 2 or table.shape[1] not in (4, 5, 6)):
        if table.ndim == 1:
            cure = "A single box is an array of one row: [[left, top, right, bottom]]."
        else:
            cure = ""
        raise InputError(
            f"expected {_COLUMNS}; got an array of shape {table.shape}", where=where, cure=cure
        )
    else:
        score, label = (table[:, k] if n and table.shape[1] > k else None for k in (4, 5))
    if label is None:
        label = np.zeros(n)
    else:
        label = label
    whole = (np.abs(label) < _LARGEST_CLASS) & (np.rint(label) == label)
    if not whole.all():
        row = int(np.argmin(whole))
        raise InputError(
            f"row {row} (from 0): the class must be a whole number, not {label[row]:g}", where=where
        )
    return _checked(Detections.of(table[:, :4] if n else [], score, label.astype(np.int64)), where)


class LeftOut(NamedTuple):
    """How many boxes are left out: of those no picture shows, that are not asked for, and that are
    too many.
    """

    empty: int = 0
    misplaced: int = 0
    unwanted: int = 0
    classes: int = 0
    crowded: int = 0
    surplus: int = 0

    def with_more(self, other: LeftOut) -> LeftOut:
        """The sums."""
        return LeftOut(*(a + b for a, b in zip(self, other, strict=True)))

    def sentences(self, known: LeftOut | None = None) -> Iterator[str]:
        """How many and why, but for reasons that are ``known``."""
        for count, reason, before in zip(self, _REASONS, known or LeftOut(), strict=True):
            if count and not before:
                yield f"{count} box{'es' * (count > 1)} left out: {reason}"


_REASONS = (
    "their width or height is not above 0",
    (
        f"a side is below {SHORTEST:g} pixels or above {LONGEST:g} frames, or their centre is so"
        " far outside"
    ),
    "their class was not asked for, or their size or score is below the least of their class",
    f"there are more than {MAX_CLASSES} classes",
    "more are in one place than limits.max_in_one_place",
    "a frame has more than limits.max_detections",
)


@dataclass(frozen=True, slots=True)
class Limits(Checked):
    """How many detections a frame may have. Of more those of the highest scores are taken, of equal
    ones the first.

    Parameters
    ----------
    max_detections : detections of a frame.
    max_in_one_place : detections that lie in each other's gates, so that each could be any other's
        target.
    frame_size : the image's width and height in pixels; (0, 0): not known.
    """

    max_detections: PositiveCount = 1000
    max_in_one_place: PositiveCount = 25
    frame_size: tuple[float, float] = (0.0, 0.0)

    def plausible(self, found: Detections) -> tuple[I8, LeftOut]:
        """(k,) rows of the boxes that a picture may show; detectors give others now and then, which
        say nothing.
        """
        low = found.xyxy[:, :2]
        high = found.xyxy[:, 2:]
        if min(self.frame_size) > 0:
            frame = np.array(self.frame_size)
        else:
            frame = np.full(2, UNKNOWN)
        with np.errstate(over="ignore"):
            sides = high - low
            away = np.abs(low / 2 + high / 2 - frame / 2)
        sized = (sides > 0).all(axis=1)
        near = (
            (sides >= SHORTEST) & (sides <= LONGEST * frame) & (away <= (LONGEST + 0.5) * frame)
        ).all(axis=1)
        return np.flatnonzero(near), LeftOut(int((~sized).sum()), int((sized & ~near).sum()))

    def best(self, confidence: F8) -> I8:
        """(k,) rows of those that are taken of boxes with these scores (N,), ascending."""
        if len(confidence) <= self.max_detections:
            return np.arange(len(confidence))
        return np.sort(np.argsort(-confidence, kind="stable")[: self.max_detections])


def doubtful(found: Detections, size: tuple[float, float]) -> str:
    """What looks like a mistake in the units of a frame's boxes, where its size is known; empty
    where nothing does.
    """
    if not len(found) or min(size) <= 0:
        return ""
    most = found.xyxy.max(axis=0)
    least = found.xyxy[:, 2:].min()
    if most[2:].max() <= _SMALL:
        return (
            f"no box reaches beyond {most.max():.3g} pixels: boxes are in pixels of the image, not"
            " shares of its size"
        )
    if least > 0 and most[0] < size[0] and most[1] < size[1]:
        return ""
    outside = ((found.xyxy[:, 2:] <= 0) | (found.xyxy[:, :2] >= size)).any(axis=1).sum()
    return (
        f"{outside} of {len(found)} boxes lie outside of the frame of {size[0]:g}x{size[1]:g}"
        " pixels"
    )


def within_frame(
    table: DetectionTable, info: SequenceInfo, path: Path
) -> tuple[DetectionTable, tuple[str, ...]]:
    """The detections of which any part is in the frame, and a sentence for each reason why some
    were left out.

    Raises `InputError` where all are outside, or look like shares of the frame's size, like corners
    in place of sizes, or like scores in place of heights.

    Parameters
    ----------
    table : detections of a sequence.
    info : its size.
    path : their file, for messages.
    """
    left, top, right, bottom = table.detections.xyxy.T
    if table.detections.xyxy.max(initial=0) <= _SMALL < min(info.width, info.height) and len(table):
        cure = "Multiply them by the frame's width and height."
        raise InputError(
            doubtful(table.detections, (info.width, info.height)), where=path, cure=cure
        )
    beyond = (right > info.width) | (bottom > info.height)
    corners = (right - left > left) & (bottom - top > top)
    if len(table) >= _SOME and beyond.mean() > _MOST and corners.mean() > _ALMOST_ALL:
        problem = (
            f"{beyond.sum()} of {len(table)} boxes reach beyond the frame of"
            f" {info.width}x{info.height} pixels"
        )
        cure = "Name the columns in a header line: frame, left, top, right, bottom, score."
        raise InputError(f"{problem}, as where corners are taken for sizes", where=path, cure=cure)
    high = bottom - top
    if (
        len(table) >= _SOME
        and high.max() <= 1
        and np.ptp(high) > 0
        and (table.detections.confidence == 1).all()
    ):
        problem = (
            f"no box is higher than {high.max():.3g} pixels and none has a score, as where a score"
            " is taken for the height"
        )
        cure = "Name the columns in a header line: frame, left, top, width, height, score."
        raise InputError(problem, where=path, cure=cure)
    kept = share_inside(table.detections.xyxy, info.width, info.height) > 0
    empty: tuple[str, ...]
    if table.empty:
        empty = (f"{path}: {table.empty} of the boxes have width or height 0 and are left out",)
    else:
        empty = ()
    if kept.all():
        return table, empty
    outside = int((~kept).sum())
    said = (
        f"{outside} of {len(table)} boxes lie outside the frame of {info.width}x{info.height}"
        " pixels"
    )
    if outside == len(table):
        raise InputError(
            said,
            where=path,
            cure="Boxes are in pixels of the original video: check them, or --frame-size.",
        )
    sentence = f"{path}: {said} and are left out, the first in frame {int(table.frame[~kept][0])}"
    inside = DetectionTable(
        table.frame[kept], table.detections.select(kept), table.empty, table.names
    )
    return inside, (*empty, sentence)


def _numbers(values: object, where: str) -> F8:
    """``values`` as float64; InputError where they are not numbers in a rectangular table."""
    try:
        # A tensor, which may be on a GPU, of a type that NumPy does not have.
        detach = getattr(values, "detach", None)
        if detach is None:
            values = values
        else:
            values = detach().cpu().double()
        return np.array(values, dtype=np.float64)
    except (TypeError, ValueError, RuntimeError) as error:
        problem = (
            f"expected {_COLUMNS}; got {type(values).__name__} that does not convert to numbers"
            f" ({error})"
        )
        raise InputError(problem, where=where) from None


def _attribute(obj: object, names: tuple[str, str], n: int, where: str) -> F8 | None:
    """The first of the attributes ``names`` that ``obj`` has, (n,); None where it has none."""
    for name in names:
        given: Any = getattr(obj, name, None)
        if given is not None:
            values = _numbers(given, where)
            if values.size != n:
                raise InputError(
                    f"expected .{name} with one value for each of {n} boxes, got {values.shape}",
                    where=where,
                )
            return values.reshape(n)
    return None


def _checked(found: Detections, where: str) -> Detections:
    """``found`` itself, where its shapes agree and its values make sense."""
    n = len(found.xyxy)
    xyxy = found.xyxy
    cov = found.covariance
    shapes = xyxy.shape, found.confidence.shape, found.class_id.shape
    if shapes != ((n, 4), (n,), (n,)):
        got = f"{shapes[0]}, {shapes[1]} and {shapes[2]}"
        raise InputError(
            f"expected xyxy (N, 4), confidence (N,) and class_id (N,), got {got}", where=where
        )
    finite = np.isfinite(xyxy).all(axis=1) & np.isfinite(found.confidence)
    if not finite.all():
        row = int(np.argmin(finite))
        box = "[" + ", ".join(f"{value:g}" for value in xyxy[row]) + "]"
        problem = (
            f"row {row} (from 0) is not finite: box {box}, confidence {found.confidence[row]:g}"
        )
        raise InputError(
            problem, where=where, cure="Leave out boxes that the detector could not compute."
        )
    if cov is not None and (cov.shape != (n, 4, 4) or not np.isfinite(cov).all()):
        raise InputError(
            f"expected a finite covariance of shape {(n, 4, 4)}, got {cov.shape}", where=where
        )
    return found
