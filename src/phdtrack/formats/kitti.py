"""KITTI's label files: 17 columns separated by blanks, from which the rows of one type and its
neighbours are read.

Frame from 0, identity, type, truncated, occluded, angle, left, top, right, bottom, and seven of the
object in space; in results an 18th column is the score. DontCare rows are regions.
"""

from __future__ import annotations

from dataclasses import replace

from phdtrack.errors import InputError
from phdtrack.formats.text import Text, is_number

_NEIGHBOURS = {"car": ("van",), "pedestrian": ("person", "person_sitting")}
_REGION = "dontcare"
_MOST_OCCLUDED = 2
# Output of at most so many pixels' height that matches no object does not count.
LEAST_HEIGHT = 25.0
_HEADER = ("frame", "id", "left", "top", "right", "bottom", "confidence")


def is_kitti(text: Text) -> bool:
    """Whether the columns are those of a KITTI label file."""
    return (
        len(text) > 0
        and text.width in (17, 18)
        and not text.header
        and not is_number(text.cells(0)[2])
    )


def rows_of_kitti(text: Text, kind: str | None) -> Text:
    """The rows of a type, its neighbours and regions; None: of all types but regions, with a class.
    A table with a header.

    The only type needs no name. Raises `InputError` where none of several types was named, a row is
    cut short, or one of a type has no number for truncated or occluded.
    """
    if kind == "":
        types = sorted(
            {"".join(text.cells(row)[2:3]) for row in range(len(text))} - {"", "DontCare"}
        )
        if len(types) > 1:
            where = text.origin.path
            cure = f"Say --kitti {types[0]}, or in Python kitti={types[0]!r}."
            problem = (
                f"this KITTI label file has several types of objects ({', '.join(types[:9])}), and"
                " none was named"
            )
            raise InputError(problem, where=where, cure=cure)
        kind = "".join(types)
    every = kind is None
    wanted = (kind or "").lower()
    lines = list[str]()
    kept = list[int]()
    # A row without a type is cut short, which is said below.
    chosen = ("", wanted, _REGION, *_NEIGHBOURS.get(wanted, ()))
    for row in range(len(text)):
        cells = text.cells(row)
        name = "".join(cells[2:3]).lower()
        if (every and name == _REGION) or (not every and name not in chosen):
            continue
        if len(cells) != text.width or not (every or (is_number(cells[3]) and is_number(cells[4]))):
            came = f"the fourth and fifth numbers (truncated, occluded), came {cells[:5]}"
            if every:
                came = f"came {len(cells)}"
            else:
                came = came
            raise InputError(f"expected {text.width} columns, {came}", where=text.origin.at(row))
        more = cells[2:3]
        if not every:
            hidden = float(cells[3]) > 0 or float(cells[4]) > _MOST_OCCLUDED
            more = [str(int(name != wanted or hidden)), str(int(name == _REGION))]
        lines.append(
            ",".join([*cells[:2], *cells[6:10], cells[17] if text.width == 18 else "1", *more])
        )
        kept.append(row)
    header: tuple[str, ...]
    if every:
        header = (*_HEADER, "class")
    else:
        header = (*_HEADER, "distractor", "region")
    return replace(text.select(kept), lines=lines, delimiter=",", width=len(header), header=header)
