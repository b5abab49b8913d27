"""From the numbers of a table, text or Parquet, to rows of boxes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from phdtrack.formats.columns import Form, Kind, Layout, Role, by_name, by_position
from phdtrack.formats.rows import Rows
from phdtrack.formats.source import Origin
from phdtrack.formats.text import Text, numbers, scan
from phdtrack.types import F8


def rows_of_text(path: Path, content: bytes, kind: Kind, first: int) -> Rows:
    """The boxes in a text table; ``first`` is the number that the file gives the first frame.

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
    """Rows from the ``values`` (M, k) of the k columns of ``layout``."""

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
