"""KITTI's label files: 17 columns separated by blanks, from which the rows of one type and its neighbours are read.

Frame from 0, identity, type, truncated, occluded, angle, left, top, right, bottom, and seven of the object in space; in
results an 18th column is the score. DontCare rows are regions.
"""

from __future__ import annotations

import numpy as np

from phdtrack.errors import InputError
from phdtrack.formats.checks import Origin
from phdtrack.formats.text import Text, is_number

_NEIGHBOURS = {"car": ("van",), "pedestrian": ("person", "person_sitting")}
_REGION = "dontcare"
_MOST_OCCLUDED = 2
# Output of at most so many pixels' height that matches no object does not count.
LEAST_HEIGHT = 25.0
_HEADER = ("frame", "id", "left", "top", "right", "bottom", "confidence", "distractor", "region")


def is_kitti(text: Text) -> bool:
    """Whether the columns are those of a KITTI label file."""
    return len(text) > 0 and text.width in (17, 18) and not text.header and not is_number(text.cells(0)[2])


def rows_of_all(text: Text) -> Text:
    """The rows of all types but regions, as a table with a header and a class; `InputError` where one is cut short."""
    kept = [row for row in range(len(text)) if "".join(text.cells(row)[2:3]).lower() != _REGION]
    lines = []
    for row in kept:
        cells = text.cells(row)
        if len(cells) != text.width:
            raise InputError(f"expected {text.width} columns, came {len(cells)}", where=text.origin.at(row))
        lines.append(",".join([*cells[:2], *cells[6:10], cells[17] if text.width == 18 else "1", cells[2]]))
    origin = Origin(text.origin.path, text.origin.unit, text.origin.number[np.array(kept, np.int64)])
    return Text(origin, lines, ",", len(_HEADER[:7]) + 1, (*_HEADER[:7], "class"))


def rows_of_type(text: Text, kind: str) -> Text:
    """The rows of a type, of its neighbours and regions, as a table with a header; the only type needs no name.

    Raises `InputError` where none of several types was named, or truncated or occluded is no number.
    """
    if not kind:
        types = sorted({"".join(text.cells(row)[2:3]) for row in range(len(text))} - {"", "DontCare"})
        if len(types) > 1:
            where, cure = text.origin.path, f"Say --kitti {types[0]}, or in Python kitti={types[0]!r}."
            problem = f"this KITTI label file has several types of objects ({', '.join(types[:9])}), and none was named"
            raise InputError(problem, where=where, cure=cure)
        kind = "".join(types)
    wanted, lines, kept = kind.lower(), list[str](), list[int]()
    for row in range(len(text)):
        cells = text.cells(row)
        name = cells[2].lower() if len(cells) > 2 else ""
        if name and name not in (wanted, _REGION, *_NEIGHBOURS.get(wanted, ())):
            continue
        if len(cells) != text.width or not (is_number(cells[3]) and is_number(cells[4])):
            problem = f"expected {text.width} columns, the fourth and fifth numbers (truncated, occluded), came {cells[:5]}"
            raise InputError(problem, where=text.origin.at(row))
        hidden = float(cells[3]) > 0 or float(cells[4]) > _MOST_OCCLUDED
        score = cells[17] if text.width == 18 else "1"
        marks = str(int(name != wanted or hidden)), str(int(name == _REGION))
        lines.append(",".join([*cells[:2], *cells[6:10], score, *marks]))
        kept.append(row)
    origin = Origin(text.origin.path, text.origin.unit, text.origin.number[np.array(kept, np.int64)])
    return Text(origin, lines, ",", len(_HEADER), _HEADER)
