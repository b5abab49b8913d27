"""Conversion of a detector's output to `Detections`, and checks of its values.

Accepted are:

* a `Detections`;
* any object with ``.xyxy`` and optionally ``.confidence`` (or ``.conf``) and ``.class_id`` (or
  ``.cls``), as supervision and ultralytics have them;
* a result of ultralytics, whose ``.boxes`` are such an object, or a list of one result;
* an array-like of shape (N, 4) xyxy, (N, 5) with confidence, or (N, 6) with confidence and class.

An object may have embeddings, (N, D), one for each box: supervision has them as
``.data["embeddings"]``, others as ``.embeddings``, a result of ultralytics beside its ``.boxes``.
Tensors are copied to the CPU. An empty array of any shape means no boxes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from phdtrack.arrays import share_inside
from phdtrack.errors import Checked, InputError, PositiveCount
from phdtrack.kernels.appearance import all_finite
from phdtrack.kernels.box import first_not_finite, outermost, plausible_boxes
from phdtrack.types import F4, F8, I8, Detections, DetectionTable, Matrix, SequenceInfo

_COLUMNS = (
    "boxes as (N, 4) left, top, right, bottom; (N, 5) with confidence; (N, 6) with confidence and"
    " class"
)
_EMBEDDINGS = "embeddings as (N, D), a row for each box"
_LARGEST_CLASS = 2.0**53
# Sides of a box: at least so many pixels, at most so many times the frame's, which is also how far
# the centre may lie outside.
_MIN_SIDE = 1e-3
_MAX_FRAMES = 10.0
_SIDES = (_MIN_SIDE, _MAX_FRAMES)
# Stands for the frame's sides if they are unknown: larger than any camera's.
_UNKNOWN_SIDE = 1e6
# Classes that are tracked separately; the first ones are kept.
MAX_CLASSES = 100
# Boxes in shares of the image's size do not exceed this number.
_MAX_SHARE = 1.5
# Sizes are in fact corners if, of at least so many boxes, these shares exceed the frame, and have a
# second corner below and right of the first. Or if, instead of exceeding the frame, widths have
# this correlation with places: so it is in 80 of 82 files of real sequences if they are misread
# this way. Read as they are meant, none of them has that share of such corners.
_MIN_BOXES = 20
_MIN_BEYOND = 0.5
_MIN_CORNERS = 0.95
_FOLLOWS = 0.9


class HasBoxes(Protocol):
    """An object with boxes, as supervision and ultralytics have them."""

    @property
    def xyxy(self) -> Any:
        """(N, 4) left, top, right, bottom in pixels."""


class HasResult(Protocol):
    """The result of a detector for one picture, as ultralytics has it."""

    @property
    def boxes(self) -> Any:
        """An object with boxes."""


DetectorOutput = HasBoxes | HasResult | Matrix | Sequence[HasBoxes | HasResult]
"""What `as_detections` converts. A `Detections` is an object with boxes."""


def as_detections(obj: object, *, where: str = "") -> Detections:
    """Convert a detector's output, in one of the forms above, to checked `Detections`.

    ``where`` begins error messages ("frame 12"). Raises `InputError` for another shape, and for
    values that are not finite numbers, with the row. Embeddings of NaN alone are unknown ones.
    """
    if isinstance(obj, Detections):
        return _checked(obj, where)
    if type(obj) is np.ndarray:
        return _checked(_of_table(obj, where), where)
    if obj is None:
        cure = "If nothing was detected pass an empty array: numpy.empty((0, 4))."
        raise InputError("expected boxes, got None", where=where, cure=cure)
    result = _of_one_frame(obj, where)
    if getattr(result, "obb", None) is not None:
        raise InputError(
            "expected upright boxes, got oriented ones",
            where=where,
            cure="Pass result.obb, which has .xyxy.",
        )
    inner = getattr(result, "boxes", None)
    if inner is not None:
        obj = inner
    boxes = getattr(obj, "xyxy", None)
    found = _of_table(obj, where) if boxes is None else _of_object(obj, boxes, where)
    own = _own_embeddings(obj, result)
    if own is not None:
        found = replace(found, embeddings=as_embeddings(own, len(found), where))
    return _checked(found, where)


def _of_one_frame(obj: object, where: str) -> object:
    """The result that a list of one holds, or any other object as it is. Raises `InputError` for
    results of several frames.
    """
    if not isinstance(obj, list | tuple) or not obj:
        return obj
    if len(obj) == 1:
        return obj[0]
    if any(getattr(obj[0], name, None) is not None for name in ("boxes", "xyxy")):
        problem = f"expected the result of one frame, got those of {len(obj)}"
        raise InputError(problem, where=where, cure="Call update for each frame in turn.")
    return obj


def _of_table(values: object, where: str) -> Detections:
    """The detections of an array-like, whose shape and classes are checked."""
    if isinstance(values, np.ndarray) and values.dtype == np.float64:
        table: F8 = values
    else:
        table = _numbers(values, where)
    return _of_columns(*_columns(table, where), where)


def _of_object(holder: object, boxes: object, where: str) -> Detections:
    """The detections of an object with boxes, whose shape and classes are checked."""
    xyxy = _numbers(boxes, where)
    n = len(xyxy) if xyxy.size else 0
    if n and (xyxy.ndim != 2 or xyxy.shape[1] != 4):
        raise InputError(f"expected .xyxy of shape (N, 4), got {xyxy.shape}", where=where)
    score = _attribute(holder, ("confidence", "conf"), n, where)
    label = _attribute(holder, ("class_id", "cls"), n, where)
    return _of_columns(xyxy, score, label, where)


def _of_columns(xyxy: F8, score: F8 | None, label: F8 | None, where: str) -> Detections:
    """The detections with these boxes, scores and classes, which are checked."""
    if label is not None:
        _check_classes(label, where)
    return Detections.of(xyxy if xyxy.size else [], score, label)


def _own_embeddings(obj: object, result: object) -> object | None:
    """The embeddings of an object with boxes, or of the result that it is a part of; None if there
    are none.
    """
    data = getattr(obj, "data", None)
    own: object | None = None
    if isinstance(data, Mapping):
        own = data.get("embeddings")
    for holder in (obj, result):
        if own is None:
            own = getattr(holder, "embeddings", None)
    return own


def as_embeddings(values: object, n: int, where: str) -> F4:
    """(n, D) embeddings of boxes as float32.

    Parameters
    ----------
    values : a row for each box; one of NaN alone is unknown.
    n : number of boxes.
    where : begins error messages.

    Raises
    ------
    InputError : another shape, values that are no numbers, or a row with an infinite value or with
        a few NaN.
    """
    table = _numbers(values, where, _EMBEDDINGS)
    if not n and not table.size:
        return np.zeros((0, table.shape[1] if table.ndim == 2 else 0), np.float32)
    if table.ndim != 2 or len(table) != n or not table.shape[1]:
        cure = "Give one row for each box, in their order; zeros if it is unknown."
        if table.ndim == 1 and n == 1:
            cure = "That of a single box is an array of one row: [[…]]."
        problem = f"expected {_EMBEDDINGS}, for {n} boxes; got an array of shape {table.shape}"
        raise InputError(problem, where=where, cure=cure)
    with np.errstate(over="ignore"):
        embeddings = table.astype(np.float32)
    _check_finite(embeddings, table, where)
    return embeddings


def _check_finite(embeddings: F4, table: F8 | F4, where: str) -> None:
    """Raise `InputError` if a row of ``embeddings``, made of the ``table``, has an infinite value
    or a few NaN.
    """
    if all_finite(np.ascontiguousarray(embeddings)):
        return
    bad = ~np.isfinite(embeddings)
    wrong = bad.any(axis=1) & ~np.isnan(embeddings).all(axis=1)
    if wrong.any():
        row = int(np.argmax(wrong))
        value = table[row, int(np.argmax(bad[row]))]
        raise InputError(
            f"row {row} (from 0) of the embeddings is not finite: {value:g}",
            where=where,
            cure="Give zeros for a box whose embedding is unknown.",
        )


def _check_classes(label: F8, where: str) -> None:
    """Raise `InputError` if a class (N,) is no whole number."""
    whole = (np.abs(label) < _LARGEST_CLASS) & (np.rint(label) == label)
    if not whole.all():
        row = int(np.argmin(whole))
        raise InputError(
            f"row {row} (from 0): the class must be a whole number, got {label[row]:g}", where=where
        )


def _columns(table: F8, where: str) -> tuple[F8, F8 | None, F8 | None]:
    """Boxes (N, 4), confidence and class of a table with 4 to 6 columns; None for columns that it
    lacks. Raises `InputError` for another shape.
    """
    if not table.size:
        return table, None, None
    if table.ndim != 2 or table.shape[1] not in (4, 5, 6):
        cure = ""
        if table.ndim == 1:
            cure = "A single box is an array of one row: [[left, top, right, bottom]]."
        raise InputError(
            f"expected {_COLUMNS}; got an array of shape {table.shape}", where=where, cure=cure
        )
    columns = table.shape[1]
    score = table[:, 4] if columns > 4 else None
    label = table[:, 5] if columns > 5 else None
    return table[:, :4], score, label


class DiscardedBoxes(NamedTuple):
    """Numbers of boxes that are left out, by reason: impossible, unwanted, or too many.

    Attributes
    ----------
    empty : the width or height is not above 0.
    misplaced : far too small, too large, or too far outside the frame.
    unwanted : of a class that was not chosen, or too small or weak for its class.
    classes : of more classes than allowed.
    crowded : too many in one place.
    surplus : too many in a frame.
    """

    empty: int = 0
    misplaced: int = 0
    unwanted: int = 0
    classes: int = 0
    crowded: int = 0
    surplus: int = 0

    def with_more(self, other: DiscardedBoxes) -> DiscardedBoxes:
        """The sum of both."""
        return DiscardedBoxes(*(a + b for a, b in zip(self, other, strict=True)))

    def sentences(self, known: DiscardedBoxes | None = None) -> Iterator[str]:
        """Yield a warning for each reason, except those that are ``known`` already. Boxes that are
        unwanted are none: `as_asked` tells of them.
        """
        known = (known or DiscardedBoxes())._replace(unwanted=1)
        for count, reason, before in zip(self, _REASONS, known, strict=True):
            if count and not before:
                yield _sentence(count, reason)

    @property
    def as_asked(self) -> str:
        """The sentence about boxes that the user's settings leave out; empty if there are none."""
        if not self.unwanted:
            return ""
        return f"{_sentence(self.unwanted, _REASONS[2])}, as asked."


_REASONS = (
    "width or height not above 0",
    (
        f"a side below {_MIN_SIDE:g} pixels or above {_MAX_FRAMES:g} frames, or the centre as far"
        " outside"
    ),
    "class not chosen, or size or score below the minimum of the class",
    f"more than {MAX_CLASSES} classes",
    "more in one place than limits.max_in_one_place",
    "more in a frame than limits.max_detections",
)


def _sentence(count: int, reason: str) -> str:
    """The sentence about so many boxes that are left out."""
    return f"{count} {'box' if count == 1 else 'boxes'} left out: {reason}"


@dataclass(frozen=True, slots=True)
class Limits(Checked):
    """Keep at most so many detections, highest scores first; of equal scores the first in a frame.

    Parameters
    ----------
    max_detections : detections in a frame.
    max_in_one_place : detections in each other's gates, so that each may belong to the same
        targets.
    frame_size : the image's width and height in pixels; (0, 0): unknown.
    """

    max_detections: PositiveCount = 1000
    max_in_one_place: PositiveCount = 25
    frame_size: tuple[float, float] = (0.0, 0.0)

    def plausible(self, found: Detections) -> tuple[I8, DiscardedBoxes]:
        """(k,) rows of boxes with plausible size and place, and the numbers of the others."""
        width, height = (_UNKNOWN_SIDE, _UNKNOWN_SIDE)
        if min(self.frame_size) > 0:
            width, height = self.frame_size
        boxes = np.ascontiguousarray(found.xyxy, np.float64)
        rows, empty = plausible_boxes(boxes, float(width), float(height), _SIDES)
        return rows, DiscardedBoxes(empty, len(found) - empty - len(rows))

    def best(self, confidence: F8) -> I8:
        """(k,) rows of the best of boxes with these scores (N,), ascending."""
        if len(confidence) <= self.max_detections:
            return np.arange(len(confidence))
        return np.sort(np.argsort(-confidence, kind="stable")[: self.max_detections])


def unit_warning(found: Detections, size: tuple[float, float]) -> str:
    """A sentence if the boxes of a frame of known size seem to have the wrong units; else empty."""
    if not len(found) or min(size) <= 0:
        return ""
    boxes = np.ascontiguousarray(found.xyxy, np.float64)
    left, top, right, bottom, least = outermost(boxes)
    if max(right, bottom) <= _MAX_SHARE:
        return (
            f"no coordinate exceeds {max(left, top, right, bottom):.3g}: boxes must be in pixels of"
            " the image, not in shares of its size"
        )
    if left < size[0] and top < size[1] and least > 0:
        return ""
    outside = ((found.xyxy[:, 2:] <= 0) | (found.xyxy[:, :2] >= size)).any(axis=1).sum()
    beyond = left >= size[0] or top >= size[1]
    swapped = beyond and right <= size[1] and bottom <= size[0]
    return (
        f"{outside} of {len(found)} boxes lie outside the frame of {size[0]:g}x{size[1]:g} pixels"
        + (f": perhaps it is {size[1]:g} wide and {size[0]:g} high" if swapped else "")
    )


def sizes_warning(found: Detections) -> str:
    """A sentence if sizes seem to be given for second corners: most boxes of a frame would have
    their right sides left of their left ones, or the lower above the upper; else empty.
    """
    wrong = int((found.xyxy[:, 2:] < found.xyxy[:, :2]).any(axis=1).sum())
    if 2 * wrong <= len(found):
        return ""
    return (
        f"{wrong} of {len(found)} boxes end before they begin: boxes must be left, top, right,"
        " bottom. If these are left, top, width, height, say boxes[:, 2:] += boxes[:, :2]; if they"
        " are centre, width, height, say boxes[:, :2] -= boxes[:, 2:] / 2 before that. A result of"
        " Ultralytics can be passed as it is"
    )


def within_frame(
    table: DetectionTable, info: SequenceInfo, path: Path, *, units: str = "", box: str = ""
) -> tuple[DetectionTable, tuple[str, ...]]:
    """The detections that lie at least partly in the frame, and a sentence for each reason why
    others were left out.

    Parameters
    ----------
    table : detections of a sequence.
    info : its size.
    path : their file, for messages.
    units, box : what the user states about the boxes, which is not doubted then; empty for nothing.

    Raises
    ------
    InputError : all boxes are outside, or they look like shares of the frame's size, like corners
        in place of sizes, or like scores in place of heights.
    """
    found = table.detections
    size = (info.width, info.height)
    check_units(found.xyxy, found.confidence, size, path, units=units, box=box)
    sentences = list[str]()
    if table.empty:
        sentences.append(
            f"{path}: {table.empty} of the boxes have width or height 0 and are left out"
        )
    kept = share_inside(table.detections.xyxy, info.width, info.height) > 0
    if kept.all():
        return table, tuple(sentences)
    outside = int((~kept).sum())
    problem = (
        f"{outside} of {len(table)} boxes lie outside the frame of {info.width}x{info.height}"
        " pixels"
    )
    if outside == len(table):
        raise InputError(
            problem,
            where=path,
            cure="Boxes must be in pixels of the original video: check them, or --frame-size.",
        )
    first = int(table.frame[~kept][0])
    sentences.append(f"{path}: {problem} and are left out, the first in frame {first}")
    return table.select(kept), tuple(sentences)


def check_units(
    xyxy: F8,
    confidence: F8,
    size: tuple[int, int],
    path: Path,
    *,
    units: str = "",
    box: str = "",
) -> None:
    """Raise `InputError` if the columns of a file seem to have been misread.

    Parameters
    ----------
    xyxy : (M, 4) boxes as they were read.
    confidence : (M,) their scores.
    size : width and height of the frames, pixels.
    path : the file, for messages.
    units, box : what the user states about the boxes, which is not doubted then; empty for nothing.
    """
    if not len(xyxy):
        return
    if not units and xyxy.max() <= _MAX_SHARE < min(size):
        raise InputError(
            unit_warning(Detections.of(xyxy), size),
            where=path,
            cure="Say --units shares, or multiply them by the frame's width and height.",
        )
    if len(xyxy) < _MIN_BOXES or box:
        return
    sign = _sign_of_corners(xyxy, size)
    if sign:
        raise InputError(
            f"{sign}; perhaps corners were read as sizes",
            where=path,
            cure=(
                "Say --box ltrb, or name the columns in a header line: frame, left, top, right,"
                " bottom, score. If they are sizes, say --box ltwh."
            ),
        )
    height = xyxy[:, 3] - xyxy[:, 1]
    scored = (confidence != 1).any()
    if height.max() <= 1 and np.ptp(height) > 0 and not scored:
        raise InputError(
            f"no box is higher than {height.max():.3g} pixels and none has a score; perhaps a score"
            " was read as the height",
            where=path,
            cure="Name the columns in a header line: frame, left, top, width, height, score.",
        )


def _sign_of_corners(xyxy: F8, size: tuple[int, int]) -> str:
    """The sign that the second corners of boxes (M, 4) were read as their sizes; empty if there is
    none.
    """
    left, top, right, bottom = xyxy.T
    width = right - left
    if ((width > left) & (bottom - top > top)).mean() <= _MIN_CORNERS:
        return ""
    beyond = (right > size[0]) | (bottom > size[1])
    if beyond.mean() > _MIN_BEYOND:
        return f"{beyond.sum()} of {len(xyxy)} boxes exceed the frame of {size[0]}x{size[1]} pixels"
    spread = left.std() * width.std()
    if spread > 0 and np.mean((left - left.mean()) * (width - width.mean())) > _FOLLOWS * spread:
        return "the further right a box is the wider it is, as right corners would be"
    return ""


def _numbers(values: object, where: str, expected: str = _COLUMNS) -> F8:
    """``values`` as float64. Raises `InputError` if they form no rectangular table of numbers."""
    try:
        # A tensor may be on a GPU, or of a type that NumPy does not have.
        detach = getattr(values, "detach", None)
        if detach is not None:
            values = detach().cpu().double()
        return np.array(values, dtype=np.float64)
    except (TypeError, ValueError, RuntimeError) as error:
        problem = (
            f"expected {expected}; got {type(values).__name__} that does not convert to numbers"
            f" ({error})"
        )
        cure = ""
        if expected == _COLUMNS:
            cure = "Boxes, scores and classes: numpy.column_stack([boxes, scores, classes])."
        raise InputError(problem, where=where, cure=cure) from None


def _attribute(obj: object, names: tuple[str, str], n: int, where: str) -> F8 | None:
    """(n,) the first of the attributes ``names`` that ``obj`` has; None if it has none."""
    for name in names:
        value: Any = getattr(obj, name, None)
        if value is not None:
            values = _numbers(value, where)
            if values.size != n:
                raise InputError(
                    f"expected .{name} with one value for each of {n} boxes, got {values.shape}",
                    where=where,
                )
            return values.reshape(n)
    return None


def _checked(found: Detections, where: str) -> Detections:
    """``found`` itself, with embeddings of 32 bits. Raises `InputError` if its shapes or values are
    wrong.
    """
    n = len(found.xyxy)
    xyxy = found.xyxy
    cov = found.covariance
    shapes = xyxy.shape, found.confidence.shape, found.class_id.shape
    if shapes != ((n, 4), (n,), (n,)):
        got = f"{shapes[0]}, {shapes[1]} and {shapes[2]}"
        raise InputError(
            f"expected xyxy (N, 4), confidence (N,) and class_id (N,), got {got}", where=where
        )
    row = first_not_finite(
        np.ascontiguousarray(xyxy, np.float64), np.ascontiguousarray(found.confidence, np.float64)
    )
    if row >= 0:
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
    known = found.embeddings
    if known is None:
        return found
    if known.dtype == np.float32 and known.ndim == 2 and len(known) == n and known.shape[1]:
        _check_finite(known, known, where)
        return found
    embeddings = as_embeddings(known, n, where)
    if known.dtype != np.float32:
        return replace(found, embeddings=embeddings)
    return found
