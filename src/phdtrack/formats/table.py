"""Tables of boxes: which column means what, by the names in a header or by position, in text and in
Parquet files.

A MOTChallenge file has no header. It is read as if it had one, the names by position (1-based)
being: 1 frame, 2 identity, 3–6 left, top, width, height, 7 confidence (optional). Then

* detections: 11 class, 12–21 the upper triangle, by rows, of the covariance of (centre x, centre y,
  width, height);
* truth of 8 or 9 columns (MOT16 and later): 8 class; in 10 columns (MOT15) 8–10 are places in the
  world, not used;
* tracks: 11 detection, 12 confirmed, 13 class.

Classes are whole numbers, or words, which get numbers from 1 in alphabetical order.

By name, a box may be given by left, top, width, height, by left, top, right, bottom, or by its
centre and size. Plain ``x, y`` with a size means left and top, as in COCO, unless the header names
left or centre otherwise. A Parquet file needs pyarrow, which is imported on use.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import NamedTuple

import numpy as np

from phdtrack.errors import InputError, needed
from phdtrack.formats.checks import Origin, WrongRows
from phdtrack.formats.text import Text, is_number, normalise, numbers
from phdtrack.types import F8, I8, Bool


class Column(Enum):
    """A column: the value of rows in files without it, None where it is needed, and what a header
    may call it.

    The usual name is the first. No header has capitals when it is compared: MOTChallenge's class is
    known by its position.
    """

    FRAME = (
        None,
        "frame",
        "frame_id",
        "frame_number",
        "frame_no",
        "frame_num",
        "frame_idx",
        "frame_index",
        "frameid",
    )
    IDENTITY = (
        None,
        "identity",
        "id",
        "track_id",
        "trackid",
        "tracker_id",
        "target_id",
        "object_id",
        "track",
        "label",
    )
    CONFIDENCE = 1.0, "confidence", "conf", "score", "probability", "prob"
    CLASS = (
        0.0,
        "class",
        "class_name",
        "class_id",
        "category_id",
        "category_name",
        "category",
        "cls",
    )
    MOT_CLASS = -1.0, "MOT class"
    DISTRACTOR = 0.0, "distractor", "ignore", "ignored"
    REGION = 0.0, "region", "ignored_region"
    DETECTION = -1.0, "detection", "detection_index"
    CONFIRMED = 1.0, "confirmed", "is_confirmed"
    LEFT = None, "left", "bb_left", "bbox_left", "xmin", "x_min", "x1"
    TOP = None, "top", "bb_top", "bbox_top", "ymin", "y_min", "y1"
    RIGHT = None, "right", "bb_right", "bbox_right", "xmax", "x_max", "x2"
    BOTTOM = None, "bottom", "bb_bottom", "bbox_bottom", "ymax", "y_max", "y2"
    WIDTH = None, "width", "bb_width", "bbox_width", "w"
    HEIGHT = None, "height", "bb_height", "bbox_height", "h"
    CENTRE_X = None, "cx", "xc", "center_x", "centre_x", "x_center", "x_centre"
    CENTRE_Y = None, "cy", "yc", "center_y", "centre_y", "y_center", "y_centre"
    X = None, "x"
    Y = None, "y"

    def __init__(self, default: float | None, *names: str) -> None:
        self.default = default
        self.names = names


class Kind(Enum):
    """What a file is read as, and the columns that are read beside the box."""

    DETECTIONS = Column.FRAME, Column.CONFIDENCE, Column.CLASS
    TRUTH = (
        *(
            Column.FRAME,
            Column.IDENTITY,
            Column.CONFIDENCE,
            Column.MOT_CLASS,
            Column.DISTRACTOR,
            Column.REGION,
        ),
        Column.CLASS,
    )
    IGNORED = Column.FRAME, Column.IDENTITY
    TRACKS = *TRUTH, Column.DETECTION, Column.CONFIRMED


LTWH = (Column.LEFT, Column.TOP, Column.WIDTH, Column.HEIGHT)
_CORNERS = (Column.LEFT, Column.TOP, Column.RIGHT, Column.BOTTOM)
_CENTRE_SIZE = (Column.CENTRE_X, Column.CENTRE_Y, Column.WIDTH, Column.HEIGHT)
_BOXES = (LTWH, _CORNERS, _CENTRE_SIZE, (Column.X, Column.Y, Column.WIDTH, Column.HEIGHT))
_COVARIANCE = tuple(f"cov_{a}_{b}" for i, a in enumerate("xywh") for b in "xywh"[i:])


class Source(NamedTuple):
    """A file to be read: ``content`` are its bytes, ``first`` is the number that it gives the first
    frame. Rows that are wrong end the reading, or go to ``left_out``."""

    path: Path
    content: bytes
    kind: Kind
    first: int
    left_out: WrongRows | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """M boxes, unchecked.

    Attributes
    ----------
    origin : where each row stands in its file.
    first : the number of the first frame.
    values : (M,) of each column that the file has.
    triangle : (M, 10) upper triangle, by rows, of the covariance of (centre x, centre y, width,
        height) in pixels²; (M, 0) where the file has none.
    names : what the file calls the classes, by number; empty where they are numbers there.
    kitti : whether it is a KITTI label file.
    """

    origin: Origin
    first: int
    values: Mapping[Column, F8]
    triangle: F8
    names: Mapping[int, str] = field(default_factory=dict)
    kitti: bool = False

    def get(self, column: Column) -> F8:
        """(M,) the column, or its default where the file does not have it."""
        if column in self.values:
            return self.values[column]
        return np.full(len(self.origin.number), 0.0 if column.default is None else column.default)

    def select(self, index: I8 | Bool) -> Table:
        """The rows ``index``."""
        origin = Origin(self.origin.path, self.origin.unit, self.origin.number[index])
        values = {column: value[index] for column, value in self.values.items()}
        return Table(origin, self.first, values, self.triangle[index], self.names, self.kitti)

    def xyxy(self) -> F8:
        """(M, 4) the boxes, pixels."""
        form = next(
            (form for form in _BOXES if all(column in self.values for column in form)), LTWH
        )
        box = np.stack([self.get(column) for column in form], axis=1)
        with np.errstate(invalid="ignore", over="ignore"):
            if form is _CENTRE_SIZE:
                return np.hstack([box[:, :2] - box[:, 2:] / 2, box[:, :2] + box[:, 2:] / 2])
            if form is _CORNERS:
                return box
            return np.hstack([box[:, :2], box[:, :2] + box[:, 2:]])


def table_of_text(source: Source, text: Text) -> Table:
    """The boxes in a text table; `InputError` where a column or a number is missing or wrong."""
    if len(text) and not text.header and text.width < 6:
        problem = (
            f"expected at least 6 columns (frame, id, left, top, width, height), came {text.width}"
        )
        cure = "Give the columns in this order, or name them in a header line."
        raise InputError(problem, where=text.origin.at(0), cure=cure)
    header = text.header or _by_position(_kind(source, text), text.width or 6)
    layout = _layout(source, header, text.empty)
    columns = {i: header[i] for i in layout.at}
    if source.left_out is not None:
        at = _word(text, layout)
        text = text.readable({i: name for i, name in columns.items() if i != at}, source.left_out)
    text, names = _numbered(text, layout, source.left_out)
    return replace(_table(source, text.origin, layout, numbers(text, columns)), names=names)


def table_of_parquet(source: Source) -> Table:
    """The boxes in a Parquet file; `InputError` where a column is missing or holds no numbers, or
    pyarrow is missing.
    """
    arrow, parquet = (needed(name) for name in ("pyarrow", "pyarrow.parquet"))
    try:
        table = parquet.ParquetFile(arrow.BufferReader(source.content)).read()
    except (
        arrow.ArrowException,
        OSError,
        UnicodeDecodeError,
    ) as error:  # a broken footer can be any of them
        raise InputError(
            f"expected a Parquet file, which cannot be read: {error}", where=source.path
        ) from None
    header = [normalise(str(name)) for name in table.column_names]
    layout = _layout(source, header, lambda at: table.column(at).null_count == len(table))
    values = []
    names = dict[int, str]()
    for k, at in enumerate(layout.at):
        try:
            cells = table.column(at)
            if layout.columns[k : k + 1] == [Column.CLASS]:
                words = cells.to_pylist()
            else:
                words = []
            if any(isinstance(word, str) for word in words):
                names = dict(enumerate(sorted({str(word) for word in words} - {"None"}), start=1))
                number = {word: one for one, word in names.items()}
                cells = arrow.array([number.get(str(word)) for word in words])
            values.append(
                cells.cast(arrow.float64()).fill_null(np.nan).to_numpy(zero_copy_only=False)
            )
        except arrow.ArrowException:
            problem = (
                f"expected numbers in the column {table.column_names[at]}, came"
                f" {table.column(at).type}"
            )
            raise InputError(
                problem, where=source.path, cure="Convert it before it is written."
            ) from None
    origin = Origin(source.path, "row", np.arange(1, len(table) + 1))
    return replace(_table(source, origin, layout, np.stack(values, axis=1)), names=names)


def _kind(source: Source, text: Text) -> Kind:
    """What a table without a header holds: a file of tracks may be given as one of detections, for
    its boxes.

    Raises `InputError` where the second column of detections holds no identity: then one is
    missing.
    """
    if source.kind is not Kind.DETECTIONS or not len(text):
        return source.kind
    cell = [*text.cells(0), "", ""][1]
    if is_number(cell) and float(cell) % 1 > 0:
        problem = f"column 2 is the identity, a whole number (-1 where there is none), came {cell}"
        cure = (
            "Give frame, id, left, top, width, height, score in this order, or name the columns in"
            " a header line."
        )
        raise InputError(problem, where=text.origin.at(0), cure=cure)
    if text.width in (12, 13) and is_number(cell) and float(cell) >= 0:
        return Kind.TRACKS
    return source.kind


def _by_position(kind: Kind, width: int) -> list[str]:
    """The names of the columns of a file without a header, "" for those that are not used."""
    names = ["frame", "id", "left", "top", "width", "height", "confidence"][:width] + [""] * (
        width - 7
    )
    if kind is Kind.DETECTIONS and width > 10:
        names[10] = "class"
        names[11:21] = _COVARIANCE if width >= 21 else names[11:21]
    elif kind is not Kind.DETECTIONS and width in (8, 9):
        names[7] = "MOT class"
    elif kind is Kind.TRACKS and width >= 12:
        names[10:13] = ("detection", "confirmed", "class")[: width - 10]
    return names


class _Layout(NamedTuple):
    """The columns to be read, and where they stand in a file, followed by where the covariance does
    if there is one.
    """

    columns: list[Column]
    at: list[int]


def _layout(source: Source, header: Sequence[str], empty: Callable[[int], bool]) -> _Layout:
    """The columns to be read, without optional ones that are ``empty``; unknown names are passed
    over.
    """
    places = {
        column: next((header.index(name) for name in column.names if name in header), -1)
        for column in Column
    }
    if source.kind is Kind.DETECTIONS and places[Column.CLASS] < 0 and "label" in header:
        # Only of tracks it is the identity.
        places[Column.CLASS] = header.index("label")
    form = next((form for form in _BOXES if all(places[column] >= 0 for column in form)), ())
    missing = next(
        (column for column in source.kind.value if column.default is None and places[column] < 0),
        None,
    )
    if missing is not None or not form:
        what = "box"
        cure = (
            "Name left, top, width, height, or left, top, right, bottom, or cx, cy, width, height."
        )
        if missing is not None:
            what = missing.names[0]
            cure = f"Name it one of {', '.join(missing.names)}."
        came = ", ".join(header)[:200]
        raise InputError(
            f"no column for the {what}; the columns are {came}", where=source.path, cure=cure
        )
    wanted = [column for column in source.kind.value if places[column] >= 0]
    # An optional column without any value is as good as absent.
    columns = [
        column for column in wanted if column.default is None or not empty(places[column])
    ] + list(form)
    at = [places[column] for column in columns]
    if source.kind is Kind.DETECTIONS and all(name in header for name in _COVARIANCE):
        at += [header.index(name) for name in _COVARIANCE]
    return _Layout(columns, at)


def _word(text: Text, layout: _Layout) -> int:
    """The place of the class, where the first row that has one has no number for it; −1
    otherwise.
    """
    at = next(
        (i for column, i in zip(layout.columns, layout.at, strict=False) if column is Column.CLASS),
        -1,
    )
    cells = (text.cells(row)[at : at + 1] for row in range(len(text)))
    if at >= 0 and not is_number(next((one[0] for one in cells if one), "0")):
        return at
    return -1


def _numbered(
    text: Text, layout: _Layout, left_out: WrongRows | None
) -> tuple[Text, dict[int, str]]:
    """The table with numbers in place of classes that are words, and the words by number."""
    at = _word(text, layout)
    if at < 0:
        return text, {}
    rows = [text.cells(row) for row in range(len(text))]
    words = sorted({row[at] for row in rows if len(row) > at and not is_number(row[at])} - {""})
    bad = [k for k, row in enumerate(rows) if len(row) > at and (is_number(row[at]) or not row[at])]
    if bad:
        problem = f"expected a word for the class, as before, came '{rows[bad[0]][at]}'"
        error = InputError(problem, where=text.origin.at(bad[0]))
        if left_out is None:
            raise error
        left_out.take(error, *text.origin.number[bad].tolist())
        kept = np.delete(np.arange(len(rows)), bad).tolist()
        text = text.select(kept)
        rows = [rows[k] for k in kept]
    number = {word: str(k) for k, word in enumerate(words, start=1)}
    lines = [
        ",".join(number[c] if i == at else c.replace(",", ".") for i, c in enumerate(row))
        for row in rows
    ]
    return replace(text, lines=lines, delimiter=","), dict(enumerate(words, start=1))


def _table(source: Source, origin: Origin, layout: _Layout, values: F8) -> Table:
    """The table of the values (M, k)."""
    k = len(layout.columns)
    return Table(
        origin, source.first, dict(zip(layout.columns, values[:, :k].T, strict=True)), values[:, k:]
    )
