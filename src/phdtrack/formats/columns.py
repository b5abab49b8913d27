"""Which column means what: by position in MOTChallenge files, by name where there is a header.

By position (1-based), the same for all: 1 frame, 2 identity, 3–6 left, top, width, height, 7 confidence (optional). Then

* detections: 11 class, 12–21 the upper triangle, by rows, of the covariance of (centre x, centre y, width, height);
* truth of 8 or 9 columns (MOT16 and later): 8 class; in 10 columns (MOT15) 8–10 are places in the world, not used;
* tracks: 11 detection, 12 confirmed.

By name, a box may be given by left, top, width, height, by left, top, right, bottom, or by its centre and size. Plain
``x, y`` with a size means left and top, as in COCO, unless the header names left or centre otherwise.

`rows_of_text` and `rows_of_parquet` make `Rows` of the columns. A Parquet file has the names of columns of a CSV file with
a header; it needs pyarrow, which is imported on use.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, auto
from pathlib import Path

import numpy as np

from phdtrack.errors import InputError
from phdtrack.formats.rows import Rows
from phdtrack.formats.text import Origin, Text, normalise, numbers, scan
from phdtrack.types import F8

Aliases = tuple[str, ...]

LEFT: Aliases = ("left", "bb_left", "bbox_left", "xmin", "x_min", "x1")
TOP: Aliases = ("top", "bb_top", "bbox_top", "ymin", "y_min", "y1")
RIGHT: Aliases = ("right", "bb_right", "bbox_right", "xmax", "x_max", "x2")
BOTTOM: Aliases = ("bottom", "bb_bottom", "bbox_bottom", "ymax", "y_max", "y2")
WIDTH: Aliases = ("width", "bb_width", "bbox_width", "w")
HEIGHT: Aliases = ("height", "bb_height", "bbox_height", "h")
CENTRE_X: Aliases = ("cx", "xc", "center_x", "centre_x", "x_center", "x_centre")
CENTRE_Y: Aliases = ("cy", "yc", "center_y", "centre_y", "y_center", "y_centre")


class Kind(Enum):
    """What a file is read as."""

    DETECTIONS = auto()
    TRUTH = auto()
    TRACKS = auto()


class Role(Enum):
    """What a column is used for: the names by which a header may call it, the usual one first (boxes: see `Form`)."""

    FRAME = ("frame", "frame_id", "frame_number", "frame_no", "frame_num", "frame_idx", "frame_index", "frameid")
    IDENTITY = ("identity", "id", "track_id", "trackid", "tracker_id", "target_id", "object_id", "track", "label")
    BOX = ("box",)
    CONFIDENCE = ("confidence", "conf", "score", "probability", "prob")
    CLASS = ("class", "class_id", "category_id", "category", "cls")
    COVARIANCE = ("covariance",)
    DISTRACTOR = ("distractor", "ignore", "ignored")
    DETECTION = ("detection", "detection_index")
    CONFIRMED = ("confirmed", "is_confirmed")


class Form(Enum):
    """How four columns give a box."""

    CORNER_SIZE = (LEFT, TOP, WIDTH, HEIGHT)
    CORNERS = (LEFT, TOP, RIGHT, BOTTOM)
    CENTRE_SIZE = (CENTRE_X, CENTRE_Y, WIDTH, HEIGHT)
    PLAIN = (("x",), ("y",), WIDTH, HEIGHT)


COVARIANCE: tuple[Aliases, ...] = tuple((f"cov_{a}_{b}",) for i, a in enumerate("xywh") for b in "xywh"[i:])

_OPTIONAL = {
    Kind.DETECTIONS: (Role.CONFIDENCE, Role.CLASS),
    Kind.TRUTH: (Role.CONFIDENCE, Role.DISTRACTOR),
    Kind.TRACKS: (Role.CONFIDENCE, Role.DETECTION, Role.CONFIRMED),
}


@dataclass(frozen=True, slots=True)
class Layout:
    """The columns in use: ``columns`` 0-based in the file, the role of each, its label in messages, and the box's form."""

    roles: tuple[Role, ...]
    columns: tuple[int, ...]
    labels: tuple[str, ...]
    form: Form = Form.CORNER_SIZE

    def place(self, role: Role) -> list[int]:
        """Which of ``columns`` have this role."""
        return [i for i, r in enumerate(self.roles) if r is role]

    def without(self, absent: Sequence[int]) -> Layout:
        """The same layout less the file's columns ``absent``."""
        keep = [i for i, column in enumerate(self.columns) if column not in absent]
        return Layout(
            tuple(self.roles[i] for i in keep),
            tuple(self.columns[i] for i in keep),
            tuple(self.labels[i] for i in keep),
            self.form,
        )

    @property
    def optional(self) -> list[int]:
        """The file's columns that may be empty from top to bottom."""
        needed = (Role.FRAME, Role.IDENTITY, Role.BOX, Role.COVARIANCE)
        return [column for role, column in zip(self.roles, self.columns, strict=True) if role not in needed]


def by_position(kind: Kind, width: int, where: str | Path) -> Layout:
    """The layout of a file of ``width`` columns without a header.

    Parameters
    ----------
    kind : what the file is read as.
    width : its number of columns.
    where : what messages name.

    Raises
    ------
    InputError : there are fewer than six columns.
    """
    if width < 6:
        raise InputError(
            f"expected at least 6 columns (frame, id, left, top, width, height), came {width}",
            where=where,
            cure="Give the columns in this order, or name them in a header line.",
        )
    names = [aliases[0] for aliases in Form.CORNER_SIZE.value]
    spec = [
        (Role.FRAME, "frame"),
        (Role.IDENTITY, "id"),
        *((Role.BOX, name) for name in names),
        (Role.CONFIDENCE, "confidence"),
    ]
    columns = list(range(min(width, 7)))
    if kind is Kind.DETECTIONS:
        spec += [(Role.CLASS, "class")] + [(Role.COVARIANCE, aliases[0]) for aliases in COVARIANCE]
        columns += range(10, 21) if width >= 21 else [10] if width > 10 else []
    elif kind is Kind.TRUTH:
        spec += [(Role.CLASS, "class")]
        columns += [7] if width in (8, 9) else []
    else:
        spec += [(Role.DETECTION, "detection"), (Role.CONFIRMED, "confirmed")]
        columns += [10, 11] if width >= 12 else []
    used = list(zip(spec, columns, strict=False))
    if kind is Kind.DETECTIONS:  # the identity is −1 there by convention; whatever it is, it is not used
        used = [entry for entry in used if entry[0][0] is not Role.IDENTITY]
    return Layout(tuple(r for (r, _), _ in used), tuple(c for _, c in used), tuple(name for (_, name), _ in used))


def by_name(kind: Kind, header: Sequence[str], where: str | Path) -> Layout:
    """The layout that a ``header`` of lower-case names tells; unknown names are passed over.

    Parameters
    ----------
    kind : what the file is read as.
    header : lower-case names of its columns.
    where : what messages name.

    Raises
    ------
    InputError : there is no column for the frame, for the box, or (truth and tracks) for the identity.
    """
    form = next((form for form in Form if all(_find(header, aliases) >= 0 for aliases in form.value)), None)
    wanted = [Role.FRAME] if kind is Kind.DETECTIONS else [Role.FRAME, Role.IDENTITY]
    missing = next((role.value for role in wanted if _find(header, role.value) < 0), None)
    if form is None or missing is not None:
        what, cure = _missing(missing)
        came = ", ".join(header)
        raise InputError(f"no column for the {what}; the columns are {came[:200]}", where=where, cure=cure)
    found = [(role, _find(header, role.value)) for role in wanted]
    found += [(Role.BOX, _find(header, aliases)) for aliases in form.value]
    found += [(role, i) for role in _OPTIONAL[kind] if (i := _find(header, role.value)) >= 0]
    covariance = [_find(header, aliases) for aliases in COVARIANCE]
    if kind is Kind.DETECTIONS and min(covariance) >= 0:
        found += [(Role.COVARIANCE, i) for i in covariance]
    return Layout(tuple(r for r, _ in found), tuple(c for _, c in found), tuple(header[c] for _, c in found), form)


def _find(header: Sequence[str], aliases: Aliases) -> int:
    """The column with the first of the ``aliases`` that the header has; −1 for none."""
    return next((header.index(name) for name in aliases if name in header), -1)


def _missing(aliases: Aliases | None) -> tuple[str, str]:
    if aliases is not None:
        return aliases[0], f"Name it one of {', '.join(aliases)}."
    return "box", "Name left, top, width, height, or left, top, right, bottom, or cx, cy, width, height."


def rows_of_text(path: Path, content: bytes, kind: Kind, first: int) -> Rows:
    """The boxes in a text table; ``first`` is the number that the file gives the first frame.

    Parameters
    ----------
    path : the file, for messages.
    content : its bytes.
    kind : what it is read as.
    first : the number that the file gives the first frame.

    Raises
    ------
    InputError : the content is no text, or a column or a number is missing or wrong.
    """
    text = scan(path, content)
    if not len(text) and not text.header:
        return assemble(text.origin, by_position(kind, 6, path), np.zeros((0, 6)), first)
    layout = by_name(kind, text.header, path) if text.header else by_position(kind, text.width, text.origin.at(0))
    layout = layout.without(_empty(text, layout))
    return assemble(text.origin, layout, numbers(text, layout.columns, layout.labels), first)


def _empty(text: Text, layout: Layout) -> list[int]:
    """The optional columns without a value in any line: as good as absent."""
    if not len(text):
        return []
    start = text.cells(0)
    suspects = [c for c in layout.optional if c >= len(start) or not start[c]]
    if not suspects:
        return []
    cells = [text.cells(row) for row in range(len(text))]
    return [c for c in suspects if all(c >= len(line) or not line[c] for line in cells)]


def assemble(origin: Origin, layout: Layout, values: F8, first: int) -> Rows:
    """Rows from the ``values`` (M, k) of the k columns of ``layout``.

    Parameters
    ----------
    origin : where each row stands in its file.
    layout : the k columns in use.
    values : (M, k).
    first : the number that the file gives the first frame.
    """

    def column(role: Role) -> F8 | None:
        place = layout.place(role)
        return np.ascontiguousarray(values[:, place[0]]) if place else None

    covariance = layout.place(Role.COVARIANCE)
    return Rows(
        origin,
        np.ascontiguousarray(values[:, layout.place(Role.FRAME)[0]]),
        _corners(values[:, layout.place(Role.BOX)], layout.form),
        first,
        identity=column(Role.IDENTITY),
        confidence=column(Role.CONFIDENCE),
        class_id=column(Role.CLASS),
        distractor=column(Role.DISTRACTOR),
        detection=column(Role.DETECTION),
        confirmed=column(Role.CONFIRMED),
        covariance=values[:, covariance] if covariance else None,
    )


def _corners(box: F8, form: Form) -> F8:
    """(M, 4) left, top, right, bottom from the four columns of a box."""
    if form is Form.CORNERS:
        return np.ascontiguousarray(box)
    start, size = box[:, :2], box[:, 2:]
    with np.errstate(invalid="ignore", over="ignore"):
        if form is Form.CENTRE_SIZE:
            return np.hstack([start - size / 2, start + size / 2])
        return np.hstack([start, start + size])


def rows_of_parquet(path: Path, content: bytes, kind: Kind, first: int) -> Rows:
    """The boxes in a Parquet file; ``first`` is the number that it gives the first frame.

    Parameters
    ----------
    path : the file, for messages.
    content : its bytes.
    kind : what it is read as.
    first : the number that the file gives the first frame.

    Raises
    ------
    InputError : pyarrow is not installed, the file is no Parquet, or a column is missing or holds no numbers.
    """
    try:
        import pyarrow as arrow
        import pyarrow.parquet as parquet
    except ImportError:
        cure = "Install it: pip install 'phdtrack[parquet]'."
        raise InputError(
            "reading Parquet needs the package pyarrow, which is not installed", where=path, cure=cure
        ) from None
    try:
        file = parquet.ParquetFile(arrow.BufferReader(content))
        names = [str(name) for name in file.schema_arrow.names]
        if len(set(names)) < len(names):
            raise InputError("expected columns of different names, came two of the same", where=path)
        layout = by_name(kind, [normalise(name) for name in names], path)
        table = file.read(columns=[names[c] for c in layout.columns])
    except (arrow.ArrowException, OSError, UnicodeDecodeError) as error:  # a broken footer can be any of them
        raise InputError(f"expected a Parquet file, which cannot be read: {error}", where=path) from None
    absent = [c for c in layout.optional if table[names[c]].null_count == len(table)]
    layout = layout.without(absent)
    origin = Origin(path, "row", np.arange(1, len(table) + 1))
    values = np.empty((len(table), len(layout.columns)))
    for i, c in enumerate(layout.columns):
        try:
            column = table[names[c]].cast(arrow.float64())
        except arrow.ArrowException:
            problem = f"expected numbers in the column {names[c]}, came {table[names[c]].type}"
            raise InputError(problem, where=path, cure="Convert it before it is written.") from None
        values[:, i] = column.fill_null(np.nan).to_numpy()
    return assemble(origin, layout, values, first)
