"""Which column of a table means what, in text and in Parquet files: by the names in a header, or by position.

A MOTChallenge file has no header. It is read as if it had one, the names by position (1-based) being: 1 frame, 2 identity,
3–6 left, top, width, height, 7 confidence (optional). Then

* detections: 11 class, 12–21 the upper triangle, by rows, of the covariance of (centre x, centre y, width, height);
* truth of 8 or 9 columns (MOT16 and later): 8 class; in 10 columns (MOT15) 8–10 are places in the world, not used;
* tracks: 11 detection, 12 confirmed.

By name, a box may be given by left, top, width, height, by left, top, right, bottom, or by its centre and size. Plain
``x, y`` with a size means left and top, as in COCO, unless the header names left or centre otherwise. A Parquet file needs
pyarrow, which is imported on use.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from pathlib import Path
from typing import NamedTuple

import numpy as np

from phdtrack.errors import InputError
from phdtrack.formats.rows import Kind, Origin, Rows, Source
from phdtrack.formats.text import normalise, numbers, scan
from phdtrack.types import F8

_LEFT = ("left", "bb_left", "bbox_left", "xmin", "x_min", "x1")
_TOP = ("top", "bb_top", "bbox_top", "ymin", "y_min", "y1")
_RIGHT = ("right", "bb_right", "bbox_right", "xmax", "x_max", "x2")
_BOTTOM = ("bottom", "bb_bottom", "bbox_bottom", "ymax", "y_max", "y2")
_WIDTH = ("width", "bb_width", "bbox_width", "w")
_HEIGHT = ("height", "bb_height", "bbox_height", "h")
_CENTRE_X = ("cx", "xc", "center_x", "centre_x", "x_center", "x_centre")
_CENTRE_Y = ("cy", "yc", "center_y", "centre_y", "y_center", "y_centre")
_COVARIANCE = tuple(f"cov_{a}_{b}" for i, a in enumerate("xywh") for b in "xywh"[i:])
# By what names a header may call the fields of `Rows`, the usual one first. No header has capitals when it is compared:
# the class of MOTChallenge's truth is known by its position only.
_FIELDS = {
    "frame": ("frame", "frame_id", "frame_number", "frame_no", "frame_num", "frame_idx", "frame_index", "frameid"),
    "identity": ("identity", "id", "track_id", "trackid", "tracker_id", "target_id", "object_id", "track", "label"),
    "confidence": ("confidence", "conf", "score", "probability", "prob"),
    "class_id": ("class", "class_id", "category_id", "category", "cls"),
    "mot_class": ("MOT class",),
    "distractor": ("distractor", "ignore", "ignored"),
    "detection": ("detection", "detection_index"),
    "confirmed": ("confirmed", "is_confirmed"),
}
_NEEDED = {Kind.DETECTIONS: ("frame",), Kind.TRUTH: ("frame", "identity"), Kind.TRACKS: ("frame", "identity")}
_OPTIONAL = {
    Kind.DETECTIONS: ("confidence", "class_id"),
    Kind.TRUTH: ("confidence", "mot_class", "distractor"),
    Kind.TRACKS: ("confidence", "detection", "confirmed"),
}


class _Form(Enum):
    """How four columns give a box."""

    CORNER_SIZE = (_LEFT, _TOP, _WIDTH, _HEIGHT)
    CORNERS = (_LEFT, _TOP, _RIGHT, _BOTTOM)
    CENTRE_SIZE = (_CENTRE_X, _CENTRE_Y, _WIDTH, _HEIGHT)
    PLAIN = (("x",), ("y",), _WIDTH, _HEIGHT)


class _Column(NamedTuple):
    """The field of `Rows` that a column fills, or a part of it (``xyxy``, ``covariance``); its index and its name."""

    field: str
    at: int
    name: str


def rows_of_text(source: Source) -> Rows:
    """The boxes in a text table.

    Raises
    ------
    InputError : the content is no text, or a column or a number is missing or wrong.
    """
    path, content, kind, first = source
    text = scan(path, content)
    if text.header or not len(text):
        form, columns = _layout(kind, text.header or _by_position(kind, 6), path)
    else:
        if text.width < 6:
            problem = f"expected at least 6 columns (frame, id, left, top, width, height), came {text.width}"
            cure = "Give the columns in this order, or name them in a header line."
            raise InputError(problem, where=text.origin.at(0), cure=cure)
        form, columns = _layout(kind, _by_position(kind, text.width), path)
    start = text.cells(0) if len(text) else []
    suspects = [c.at for c in columns if c.field in _OPTIONAL[kind] and (c.at >= len(start) or not start[c.at])]
    if suspects and start:  # an optional column without any value is as good as absent
        cells = [text.cells(row) for row in range(len(text))]
        empty = [i for i in suspects if all(i >= len(line) or not line[i] for line in cells)]
        columns = [c for c in columns if c.at not in empty]
    values = numbers(text, [c.at for c in columns], [c.name for c in columns])
    return _rows(text.origin, form, columns, values, first)


def rows_of_parquet(source: Source) -> Rows:
    """The boxes in a Parquet file.

    Raises
    ------
    InputError : pyarrow is not installed, the file is no Parquet, or a column is missing or holds no numbers.
    """
    path, content, kind, first = source
    try:
        import pyarrow as arrow
        import pyarrow.parquet as parquet
    except ImportError:
        cure = "Install it: pip install 'phdtrack[parquet]'."
        problem = "reading Parquet needs the package pyarrow, which is not installed"
        raise InputError(problem, where=path, cure=cure) from None
    try:
        file = parquet.ParquetFile(arrow.BufferReader(content))
        names = [str(name) for name in file.schema_arrow.names]
        if len(set(names)) < len(names):
            raise InputError("expected columns of different names, came two of the same", where=path)
        form, columns = _layout(kind, [normalise(name) for name in names], path)
        table = file.read(columns=[names[c.at] for c in columns])
    except (arrow.ArrowException, OSError, UnicodeDecodeError) as error:  # a broken footer can be any of them
        raise InputError(f"expected a Parquet file, which cannot be read: {error}", where=path) from None
    found, values = [], []
    for column in columns:
        data = table[names[column.at]]
        if column.field in _OPTIONAL[kind] and data.null_count == len(table):
            continue
        try:
            values.append(data.cast(arrow.float64()).fill_null(np.nan).to_numpy())
        except arrow.ArrowException:
            problem = f"expected numbers in the column {names[column.at]}, came {data.type}"
            raise InputError(problem, where=path, cure="Convert it before it is written.") from None
        found.append(column)
    return _rows(Origin(path, "row", np.arange(1, len(table) + 1)), form, found, np.stack(values, axis=1), first)


def _by_position(kind: Kind, width: int) -> list[str]:
    """The names of the columns of a file without a header, "" for those that are not used."""
    names = ["frame", "id", "left", "top", "width", "height", "confidence"][:width] + [""] * (width - 7)
    if kind is Kind.DETECTIONS and width > 10:
        names[10] = "class"
        names[11:21] = _COVARIANCE if width >= 21 else names[11:21]
    elif kind is Kind.TRUTH and width in (8, 9):
        names[7] = "MOT class"
    elif kind is Kind.TRACKS and width >= 12:
        names[10:12] = "detection", "confirmed"
    return names


def _layout(kind: Kind, header: Sequence[str], path: Path) -> tuple[_Form, list[_Column]]:
    """How boxes are given, and the columns to be read; unknown names are passed over."""
    form = next((form for form in _Form if all(_find(header, names) >= 0 for names in form.value)), None)
    missing = next((_FIELDS[field] for field in _NEEDED[kind] if _find(header, _FIELDS[field]) < 0), None)
    if missing is not None or form is None:
        cure = "Name left, top, width, height, or left, top, right, bottom, or cx, cy, width, height."
        what, cure = ("box", cure) if missing is None else (missing[0], f"Name it one of {', '.join(missing)}.")
        raise InputError(f"no column for the {what}; the columns are {', '.join(header)[:200]}", where=path, cure=cure)
    wanted = [(field, _find(header, _FIELDS[field])) for field in (*_NEEDED[kind], *_OPTIONAL[kind])]
    wanted += [("xyxy", _find(header, names)) for names in form.value]
    if kind is Kind.DETECTIONS and all(name in header for name in _COVARIANCE):
        wanted += [("covariance", header.index(name)) for name in _COVARIANCE]
    return form, [_Column(field, i, header[i]) for field, i in wanted if i >= 0]


def _find(header: Sequence[str], names: Sequence[str]) -> int:
    """The column with the first of the ``names`` that the header has; −1 for none."""
    return next((header.index(name) for name in names if name in header), -1)


def _rows(origin: Origin, form: _Form, columns: Sequence[_Column], values: F8, first: int) -> Rows:
    """Rows from the ``values`` (M, k) of the k columns."""
    place = {c.field: [i for i, other in enumerate(columns) if other.field == c.field] for c in columns}
    box = values[:, place.pop("xyxy")]
    with np.errstate(invalid="ignore", over="ignore"):
        if form is _Form.CENTRE_SIZE:
            box = np.hstack([box[:, :2] - box[:, 2:] / 2, box[:, :2] + box[:, 2:] / 2])
        elif form is not _Form.CORNERS:
            box = np.hstack([box[:, :2], box[:, :2] + box[:, 2:]])
    frame = values[:, place.pop("frame")[0]].copy()
    covariance = values[:, place.pop("covariance")] if "covariance" in place else None
    others = {field: values[:, i].copy() for field, (i,) in place.items()}
    return Rows(origin, frame, np.ascontiguousarray(box), first, covariance=covariance, **others)
