"""Tables of boxes in text and Parquet files. The names in a header, or else the positions, decide
which column means what.

A MOTChallenge file has no header. Its columns by position (1-based) are: 1 frame, 2 identity, 3–6
left, top, width, height, 7 confidence (optional). Then

* detections: 11 class, 12–21 the upper triangle, by rows, of the covariance of (centre x, centre y,
  width, height);
* columns 7 to 10 of truth, tracks and VisDrone's detections: as `mot_layout.py` decides;
* tracks: 11 detection, 12 confirmed, 13 class.

Classes are whole numbers, or words, which get numbers from 1 in alphabetical order.

A header may name a box as left, top, width, height, as left, top, right, bottom, or by its centre
and size. Plain ``x, y`` with a size means left and top, as in COCO, unless the header names left or
centre as well. A Parquet file needs pyarrow, which is imported on use.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import NamedTuple

import numpy as np

from phdtrack.conventions import BY_EVIDENCE, Conventions, report
from phdtrack.errors import InputError, needed
from phdtrack.formats.checks import MalformedRows, Origin
from phdtrack.formats.class_words import words_by_number
from phdtrack.formats.image_names import with_frame_numbers
from phdtrack.formats.mot_layout import (
    OTHERS_CATEGORY,
    REGION_CATEGORY,
    MotLayout,
    layout_of_detections,
    layout_of_tracks,
    layout_of_truth,
    own_class_names,
)
from phdtrack.formats.text import Text, is_number, normalise, numbers
from phdtrack.types import F8, I8, Bool


class Column(Enum):
    """A column: the value of rows in files without it (None if it is required), and the names that
    a header may give it, the usual one first.

    Headers are compared in lower case, so none matches "MOT class": it is known by position only.
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
    """The kind of rows that a file is read as, with the columns that are read beside the box."""

    DETECTIONS = Column.FRAME, Column.CONFIDENCE, Column.CLASS
    TRUTH = (
        Column.FRAME,
        Column.IDENTITY,
        Column.CONFIDENCE,
        Column.MOT_CLASS,
        Column.DISTRACTOR,
        Column.REGION,
        Column.CLASS,
    )
    IGNORED = Column.FRAME, Column.IDENTITY
    TRACKS = *TRUTH, Column.DETECTION, Column.CONFIRMED


LTWH = (Column.LEFT, Column.TOP, Column.WIDTH, Column.HEIGHT)
_CORNERS = (Column.LEFT, Column.TOP, Column.RIGHT, Column.BOTTOM)
_CENTRE_SIZE = (Column.CENTRE_X, Column.CENTRE_Y, Column.WIDTH, Column.HEIGHT)
# Corners first: a width and a height beside them may be the image's.
_BOXES = (_CORNERS, LTWH, _CENTRE_SIZE, (Column.X, Column.Y, Column.WIDTH, Column.HEIGHT))
_COVARIANCE = tuple(f"cov_{a}_{b}" for i, a in enumerate("xywh") for b in "xywh"[i:])


class Source(NamedTuple):
    """A file to be read: its bytes ``content``, and the number ``first`` that it gives the first
    frame. Malformed rows are errors, or are added to ``left_out``; sentences about guesses are
    added to ``notices``, or logged without it."""

    path: Path
    content: bytes
    kind: Kind
    first: int
    left_out: MalformedRows | None = None
    conventions: Conventions = BY_EVIDENCE
    notices: list[str] | None = None

    def report(self, sentence: str) -> None:
        """Tell the user what was guessed."""
        report(self.notices, self.path, sentence)


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """M boxes, not checked yet.

    Attributes
    ----------
    origin : the place of each row in its file.
    first : the number of the first frame.
    values : (M,) of each column that the file has.
    triangle : (M, 10) upper triangle, by rows, of the covariance of (centre x, centre y, width,
        height) in pixels²; (M, 0) if the file has none.
    names : the names of the classes by number; empty if the file has numbers.
    kitti : True for a KITTI label file.
    """

    origin: Origin
    first: int
    values: Mapping[Column, F8]
    triangle: F8
    names: Mapping[int, str] = field(default_factory=dict)
    kitti: bool = False

    def get(self, column: Column) -> F8:
        """(M,) the column, or its default if the file does not have it."""
        if column in self.values:
            return self.values[column]
        return np.full(len(self.origin.number), column.default or 0.0)

    def select(self, index: I8 | Bool) -> Table:
        """The rows ``index``."""
        origin = self.origin.select(index)
        values = {column: value[index] for column, value in self.values.items()}
        return replace(self, origin=origin, values=values, triangle=self.triangle[index])

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
    """The boxes in a text table. Raises `InputError` if a column or a number is missing or
    malformed.
    """
    if len(text) and not text.header and text.width < 6:
        raise InputError(
            f"expected at least 6 columns (frame, id, left, top, width, height), got {text.width}",
            where=text.origin.at(0),
            cure="Give the columns in this order, or name them in a header line.",
        )
    if text.header:
        text, sentences = with_frame_numbers(text, Column.FRAME.names, source.path)
        for sentence in sentences:
            source.report(sentence)
    header: Sequence[str] = text.header
    mot = MotLayout.MOT15
    if not header:
        kind = _kind(source, text)
        mot = _mot_layout(source, text, kind)
        header = _by_position(kind, text.width or 6, mot)
    layout = _layout(source, header, text.empty)
    columns = {place: header[place] for place in layout.places}
    if source.left_out is not None:
        words = _place_of_words(text, layout)
        numeric = {place: name for place, name in columns.items() if place != words}
        text = text.readable(numeric, source.left_out)
    text, names = _number_classes(text, layout, source.left_out)
    table = _table(source, text.origin, layout, numbers(text, columns), names)
    return _benchmark_table(source, table, mot)


def _mot_layout(source: Source, text: Text, kind: Kind) -> MotLayout:
    """The meaning of columns 7 to 10 of a file without a header."""
    if kind is Kind.TRUTH:
        return layout_of_truth(source.path, text, source.conventions)
    if kind is Kind.TRACKS:
        return layout_of_tracks(source.path, text, source.conventions)
    if kind is Kind.DETECTIONS:
        return layout_of_detections(text, source.conventions)
    return MotLayout.MOT15


def _benchmark_table(source: Source, table: Table, layout: MotLayout) -> Table:
    """The table with the regions and distractors that the layout marks by its class numbers, and
    the names of own classes; the layout is reported if it is a guess.
    """
    if not source.conventions.format and layout not in (MotLayout.MOT15, MotLayout.MOT17):
        _report_layout(source, table, layout)
    label = table.get(Column.CLASS)
    if source.kind is Kind.DETECTIONS:
        annotated = layout is MotLayout.VISDRONE and (table.get(Column.CONFIDENCE) == 0).any()
        return table.select(label != REGION_CATEGORY) if annotated else table
    if layout is MotLayout.OWN_CLASSES and not table.names:
        return replace(table, names=own_class_names(source.path, np.unique(label).tolist()))
    if layout is not MotLayout.VISDRONE or (table.get(Column.CONFIDENCE) % 1 != 0).any():
        return table
    if source.kind is Kind.TRACKS and (label != REGION_CATEGORY).all():
        return table
    region = (label == REGION_CATEGORY).astype(np.float64)
    others = (label == OTHERS_CATEGORY).astype(np.float64)
    values = {**table.values, Column.REGION: region, Column.DISTRACTOR: others}
    return replace(table, values=values)


def _report_layout(source: Source, table: Table, layout: MotLayout) -> None:
    """Report what was taken for the layout of annotated objects, by which rows are scored."""
    if source.kind is not Kind.TRUTH or table.names:
        return
    rule = "all rows are objects"
    if layout is MotLayout.OWN_CLASSES:
        rule = "all rows with flag 1 are objects (--format mot17: class 1 alone)"
    if layout is MotLayout.VISDRONE:
        rule = "category 0 is a region to ignore, category 11 an object to ignore"
    source.report(f"read as {layout.value}: {rule}")


def table_of_parquet(source: Source) -> Table:
    """The boxes in a Parquet file. Raises `InputError` if a column is missing or does not hold
    numbers, or pyarrow is missing.
    """
    arrow = needed("pyarrow")
    parquet = needed("pyarrow.parquet")
    try:
        table = parquet.ParquetFile(arrow.BufferReader(source.content)).read()
    except (arrow.ArrowException, OSError, UnicodeDecodeError) as error:
        # A broken footer raises any of them.
        raise InputError(
            f"expected a Parquet file, which cannot be read: {error}", where=source.path
        ) from None
    header = [normalise(str(name)) for name in table.column_names]
    layout = _layout(source, header, lambda place: table.column(place).null_count == len(table))
    values = []
    names = dict[int, str]()
    for k, place in enumerate(layout.places):
        cells = table.column(place)
        try:
            if layout.columns[k : k + 1] == [Column.CLASS]:
                words = cells.to_pylist()
                if any(isinstance(word, str) for word in words):
                    names = words_by_number(word for word in words if word is not None)
                    number = {word: key for key, word in names.items()}
                    cells = arrow.array([number.get(word) for word in words])
            column = cells.cast(arrow.float64()).fill_null(np.nan)
        except (arrow.ArrowException, UnicodeDecodeError):
            raise InputError(
                f"expected numbers in the column {table.column_names[place]}, got {cells.type}",
                where=source.path,
                cure="Convert it before writing the file.",
            ) from None
        values.append(column.to_numpy(zero_copy_only=False))
    origin = Origin(source.path, "row", np.arange(1, len(table) + 1))
    return _table(source, origin, layout, np.stack(values, axis=1), names)


def _kind(source: Source, text: Text) -> Kind:
    """The kind of a table without a header: a file of tracks may be given as one of detections, for
    its boxes.

    Raises `InputError` if the second column of detections cannot be an identity: then the column
    is missing.
    """
    if source.kind is not Kind.DETECTIONS or not len(text):
        return source.kind
    cell = [*text.cells(0), "", ""][1]
    if is_number(cell) and float(cell) % 1 > 0:
        raise InputError(
            f"column 2 is the identity, a whole number (-1 if there is none), got {cell}",
            where=text.origin.at(0),
            cure=(
                "Give frame, id, left, top, width, height, score in this order, or name the columns"
                " in a header line."
            ),
        )
    if text.width in (12, 13) and is_number(cell) and float(cell) >= 0:
        return Kind.TRACKS
    return source.kind


def _by_position(kind: Kind, width: int, layout: MotLayout) -> list[str]:
    """The names of the columns of a file without a header, "" for those that are not used."""
    names = ["frame", "id", "left", "top", "width", "height", "confidence"][:width]
    names += [""] * (width - len(names))
    for place, name in layout.columns.items():
        names[place] = name
    if kind is Kind.DETECTIONS:
        if width > 10:
            names[10] = "class"
        if width >= 21:
            names[11:21] = _COVARIANCE
    elif kind is Kind.TRACKS and width >= 12:
        names[10:13] = ("detection", "confirmed", "class")[: width - 10]
    return names


class _Layout(NamedTuple):
    """The columns to be read and their positions in the file, followed by the positions of the
    covariance if there is one.
    """

    columns: list[Column]
    places: list[int]


def _layout(source: Source, header: Sequence[str], empty: Callable[[int], bool]) -> _Layout:
    """Choose the columns to be read. Optional columns that are ``empty`` and unknown names are
    ignored.
    """
    places = {}
    for column in Column:
        name = next((name for name in column.names if name in header), "")
        if name:
            places[column] = header.index(name)
    if source.kind is Kind.DETECTIONS and Column.CLASS not in places and "label" in header:
        # In tracks a label is the identity.
        places[Column.CLASS] = header.index("label")
    required = [column for column in source.kind.value if column.default is None]
    missing = next((column for column in required if column not in places), None)
    form = next((form for form in _BOXES if all(column in places for column in form)), None)
    if missing is not None or form is None:
        name = "box"
        cure = (
            "Name left, top, width, height, or left, top, right, bottom, or cx, cy, width, height."
        )
        if missing is not None:
            name = missing.names[0]
            cure = f"Name it one of {', '.join(missing.names)}."
            if missing is Column.FRAME:
                cure += " Names of images that end in numbers may stand in a column called image."
        raise InputError(
            f"no column for the {name}; the columns are {', '.join(header)[:200]}",
            where=source.path,
            cure=cure,
        )
    columns = [
        column
        for column in source.kind.value
        if column in places and (column.default is None or not empty(places[column]))
    ]
    columns += form
    used = [places[column] for column in columns]
    if source.kind is Kind.DETECTIONS and all(name in header for name in _COVARIANCE):
        used += [header.index(name) for name in _COVARIANCE]
    return _Layout(columns, used)


def _place_of_words(text: Text, layout: _Layout) -> int:
    """The position of the class column if its first value is not a number; −1 otherwise."""
    if Column.CLASS not in layout.columns:
        return -1
    place = layout.places[layout.columns.index(Column.CLASS)]
    for row in range(len(text)):
        cells = text.cells(row)
        if len(cells) > place:
            return -1 if is_number(cells[place]) else place
    return -1


def _number_classes(
    text: Text, layout: _Layout, left_out: MalformedRows | None
) -> tuple[Text, dict[int, str]]:
    """Replace classes that are words by numbers: the table, and the words by number."""
    place = _place_of_words(text, layout)
    if place < 0:
        return text, {}
    rows = [text.cells(row) for row in range(len(text))]
    bad = [
        k
        for k, row in enumerate(rows)
        if len(row) > place and (is_number(row[place]) or not row[place])
    ]
    if bad:
        problem = f"expected a word for the class, as before, got '{rows[bad[0]][place]}'"
        error = InputError(problem, where=text.origin.at(bad[0]))
        if left_out is None:
            raise error
        left_out.add(error, *text.origin.number[bad].tolist())
        kept = np.delete(np.arange(len(rows)), bad).tolist()
        text = text.select(kept)
        rows = [rows[k] for k in kept]
    names = words_by_number(row[place] for row in rows if len(row) > place)
    number = {word: str(key) for key, word in names.items()}
    lines = []
    for row in rows:
        cells = [cell.replace(",", ".") for cell in row]
        if len(row) > place:
            cells[place] = number[row[place]]
        lines.append(",".join(cells))
    return replace(text, lines=lines, delimiter=","), names


def _table(
    source: Source, origin: Origin, layout: _Layout, values: F8, names: Mapping[int, str]
) -> Table:
    """The table of the values (M, k)."""
    k = len(layout.columns)
    columns = dict(zip(layout.columns, values[:, :k].T, strict=True))
    return Table(origin, source.first, columns, values[:, k:], names)
