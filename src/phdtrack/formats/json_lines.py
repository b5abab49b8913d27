"""JSON lines: one object a line. Its keys are the names that a CSV header may have; ``bbox`` is
left, top, width, height.
"""

from __future__ import annotations

import json

from phdtrack.errors import InputError
from phdtrack.files import read_json
from phdtrack.formats.json_entry import entry_of
from phdtrack.formats.table import Column, Source
from phdtrack.formats.text import Text, as_cell, normalise, text_of_rows


def rows_of_json_lines(source: Source) -> Text | None:
    """JSON lines as a table with a header; None if the first line is not an object with a frame."""
    try:
        first = json.loads(source.content.lstrip().partition(b"\n")[0])
    except (ValueError, RecursionError):
        return None
    if not isinstance(first, dict) or not {normalise(key) for key in first} & {*Column.FRAME.names}:
        return None
    rows = list[dict[str, str]]()
    numbers = list[int]()
    places = list[int]()
    every = 0
    for number, line in enumerate(source.content.split(b"\n"), start=1):
        if not line.strip():
            continue
        every += 1
        try:
            rows.append(_row(source, line, number))
            numbers.append(number)
            places.append(every - 1)
        except InputError as error:
            # The JSON parser counts lines from this one.
            where = f"{source.path}, line {number}"
            placed = InputError(error.problem, where=where, cure=error.cure)
            if source.left_out is None:
                raise placed from None
            source.left_out.add(placed, float(number))
    return text_of_rows(source.path, rows, numbers, places, every)


def _row(source: Source, line: bytes, number: int) -> dict[str, str]:
    """The cells of one line by the names of their columns."""
    where = f"{source.path}, line {number}"
    entry = entry_of(read_json(source.path, line), where, "frame and a box")
    values = dict(entry.values)
    if "bbox" in values:
        values.update(zip(("left", "top", "width", "height"), entry.box(), strict=True))
    return {normalise(key): as_cell(value) for key, value in values.items()}
