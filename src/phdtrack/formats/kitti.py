"""KITTI label files: 17 columns separated by blanks.

Frame from 0, identity, type, truncated, occluded, angle, left, top, right, bottom, and seven of the
object in 3D space; results have the score in an 18th column. Rows of type DontCare are regions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from phdtrack.errors import InputError
from phdtrack.formats.text import Text, is_number

_NEIGHBOURS = {"car": ("van",), "pedestrian": ("person", "person_sitting")}
_REGION = "dontcare"
_MAX_OCCLUSION = 2
# Output of at most this height, in pixels, is not counted if it matches no object.
LEAST_HEIGHT = 25.0
_HEADER = ("frame", "id", "left", "top", "right", "bottom", "confidence")


def is_kitti(text: Text) -> bool:
    """True if the columns are those of a KITTI label file."""
    return (
        len(text) > 0
        and text.width in (17, 18)
        and not text.header
        and not is_number(text.cells(0)[2])
    )


def kitti_of_all_types(text: Text) -> Text:
    """The rows of all types except regions, as a table with a header and the type as class.

    Raises `InputError` if a row is cut short.
    """
    rows = [row for row in range(len(text)) if _type(text.cells(row)) != _REGION]
    lines = []
    for row in rows:
        cells = text.cells(row)
        if len(cells) != text.width:
            raise InputError(
                f"expected {text.width} columns, got {len(cells)}", where=text.origin.at(row)
            )
        lines.append(_line(text, cells, cells[2]))
    return _table(text, rows, lines, "class")


def kitti_of_type(text: Text, kind: str) -> Text:
    """The rows of one type, its neighbouring types and regions, as a table with a header.

    ``kind`` may be empty if the file has only one type. Raises `InputError` if it has several and
    none was named, if a row is cut short, or if truncated or occluded is not a number.
    """
    kind = (kind or _only_type(text)).lower()
    selected = (kind, _REGION, *_NEIGHBOURS.get(kind, ()))
    rows = []
    lines = []
    for row in range(len(text)):
        cells = text.cells(row)
        # A row without a type is cut short: it is an error below.
        if _type(cells) not in ("", *selected):
            continue
        if len(cells) != text.width or not (is_number(cells[3]) and is_number(cells[4])):
            raise InputError(
                f"expected {text.width} columns, the fourth and fifth of them numbers (truncated,"
                f" occluded), got {cells[:5]}",
                where=text.origin.at(row),
            )
        hidden = float(cells[3]) > 0 or float(cells[4]) > _MAX_OCCLUSION
        distractor = str(int(_type(cells) != kind or hidden))
        region = str(int(_type(cells) == _REGION))
        rows.append(row)
        lines.append(_line(text, cells, distractor, region))
    return _table(text, rows, lines, "distractor", "region")


def _type(cells: Sequence[str]) -> str:
    """The type of a row in lower case, "" if it is cut short before."""
    return "".join(cells[2:3]).lower()


def _only_type(text: Text) -> str:
    """The one type of the objects in the file, "" if there is none."""
    types = {"".join(text.cells(row)[2:3]) for row in range(len(text))} - {"", "DontCare"}
    names = sorted(types)
    if len(names) > 1:
        raise InputError(
            f"this KITTI label file has several types of objects ({', '.join(names[:9])}): name"
            " the one to read",
            where=text.origin.path,
            cure=f"Add --kitti {names[0]}, or in Python kitti={names[0]!r}.",
        )
    return "".join(names)


def _line(text: Text, cells: Sequence[str], *more: str) -> str:
    """Frame, identity, box, confidence and ``more`` columns as a line of CSV."""
    confidence = cells[17] if text.width == 18 else "1"
    return ",".join([*cells[:2], *cells[6:10], confidence, *more])


def _table(text: Text, rows: list[int], lines: list[str], *more: str) -> Text:
    header = (*_HEADER, *more)
    return replace(text.select(rows), lines=lines, delimiter=",", width=len(header), header=header)
