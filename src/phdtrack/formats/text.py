"""Tables in text: any usual delimiter, with or without a header, and errors that name the line.

The delimiter (semicolon, tab, comma or blanks) is detected from the first line that is neither
empty nor a comment (``#``). That line is a header if none of its values is a number. Windows line
ends, a byte order mark, quotes and an empty value at the end of every line are accepted. Numbers
have a decimal point.

NumPy parses a clean file in one go. If that fails, the lines are parsed one by one: either the
faulty line is found and reported, or the reason was harmless, such as quotes.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from phdtrack.errors import InputError
from phdtrack.files import AnyPath, load
from phdtrack.formats.checks import MalformedRows, Origin
from phdtrack.types import F8


@dataclass(frozen=True, slots=True, eq=False)
class Text:
    """The lines of a file that hold values.

    Attributes
    ----------
    origin : the file, and for each line its 1-based number there.
    lines : the M lines with values, without header, comments and empty lines.
    delimiter : None for any number of blanks.
    width : the number of values in the first line, header or not, without empty ones at its end.
    header : the names of the columns in lower case; empty if the file has no header.
    """

    origin: Origin
    lines: list[str]
    delimiter: str | None = None
    width: int = 0
    header: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.lines)

    def cells(self, row: int) -> list[str]:
        """The values of line ``row`` (0-based among ``lines``) as text, without empty ones beyond
        the last column.
        """
        cells = _split(self.lines[row], self.delimiter)
        return cells[: max(self.width, _filled(cells))]

    def select(self, rows: Sequence[int]) -> Text:
        """The lines ``rows`` (0-based)."""
        origin = self.origin.select(np.array(rows, np.int64))
        return replace(self, origin=origin, lines=[self.lines[row] for row in rows])

    def readable(self, columns: Mapping[int, str], wrong: MalformedRows) -> Text:
        """The lines that have numbers in the ``columns`` (see `numbers`); the others are added to
        ``wrong``.
        """
        rows = []
        for row in range(len(self)):
            try:
                _parse(self, row, columns)
                rows.append(row)
            except InputError as error:
                wrong.add(error, float(self.origin.number[row]))
        return self.select(rows)

    def empty(self, column: int) -> bool:
        """True if no line has a value in this column."""
        return not any("".join(self.cells(row)[column : column + 1]) for row in range(len(self)))


def scan(path: Path, content: bytes) -> Text:
    """Find the delimiter, the header and the lines with values. Raises `InputError` if the content
    is not UTF-8 text.
    """
    all_lines = _decode(path, content).replace("\r\n", "\n").replace("\r", "\n").split("\n")
    kept = [
        i
        for i, line in enumerate(all_lines)
        if line and not line.isspace() and line.lstrip()[0] != "#"
    ]
    lines = [all_lines[i] for i in kept]
    number = np.array(kept, dtype=np.int64) + 1
    if not lines:
        return Text(Origin(path, "line", number), [])
    delimiter = next((d for d in ";\t," if d in lines[0]), None)
    first = _split(lines[0], delimiter)
    header: tuple[str, ...] = ()
    if not any(is_number(cell) for cell in first):
        header = tuple(normalise(cell) for cell in first)
        lines = lines[1:]
        number = number[1:]
    return Text(Origin(path, "line", number), lines, delimiter, _filled(first), header)


def normalise(name: str) -> str:
    """The name of a column as names are compared: lower case, with ``_`` for blanks and hyphens."""
    return name.strip(" '").lower().replace(" ", "_").replace("-", "_")


def numbers(text: Text, columns: Mapping[int, str]) -> F8:
    """(M, k) the values of the k ``columns``, a mapping from 0-based position to the name for
    messages.

    Raises `InputError` if a value is not a number, or a line has more or fewer values than the
    first.
    """
    if not len(text):
        return np.zeros((0, len(columns)))
    try:
        table = np.loadtxt(text.lines, delimiter=text.delimiter, comments=None, ndmin=2)
        # NumPy skips lines that hold only quotes: then the shape differs.
        if table.shape == (len(text), text.width):
            return table[:, list(columns)]
    except ValueError:
        pass  # Parsing line by line below finds the faulty one.
    return np.array([_parse(text, row, columns) for row in range(len(text))])


def read_columns(path: AnyPath, names: Sequence[str], widths: Sequence[int]) -> tuple[Origin, F8]:
    """Read a table of numbers: the place of each row, and the values (M, k) of its columns in the
    order of ``names``.

    Columns are found by the names in the header, or else by position. Raises `InputError` if the
    file is missing, has other columns, or a value is not a number.

    Parameters
    ----------
    path : the file.
    names : the columns, in lower case.
    widths : how many of them, from the first, a file may have.
    """
    text = scan(Path(path), load(path))
    if text.header:
        present = [name for name in names if name in text.header]
        places = [text.header.index(name) for name in present]
        expected = len(present) in widths and present == list(names[: len(present)])
        expected = expected and all(text.header.count(name) == 1 for name in present)
    else:
        width = text.width or min(widths)
        present = list(names[:width])
        places = list(range(width))
        expected = width in widths
    if not expected:
        wanted = f"{' or '.join(map(str, widths))} columns, {', '.join(names)}"
        got = ", ".join(text.header) or f"{text.width} numbers a line"
        where = text.origin.at(0) if len(text) else path
        raise InputError(f"expected {wanted}; got {got}", where=str(where))
    return text.origin, numbers(text, dict(zip(places, present, strict=True)))


def _parse(text: Text, row: int, columns: Mapping[int, str]) -> list[float]:
    """The values of one line."""
    cells = text.cells(row)
    if len(cells) != text.width:
        first = "header" if text.header else "first line"
        raise InputError(
            f"expected {text.width} values as in the {first}, got {_filled(cells)}",
            where=text.origin.at(row),
            cure="An interrupted program leaves a line cut short: complete or remove it.",
        )
    for column, label in columns.items():
        if not is_number(cells[column]):
            got = f"'{cells[column][:40]}'" if cells[column] else "nothing"
            raise InputError(
                f"expected a number for the {label} (column {column + 1}), got {got}",
                where=text.origin.at(row),
                cure="Write numbers as 12 or 12.5, with a decimal point.",
            )
    return [float(cells[column]) for column in columns]


def _split(line: str, delimiter: str | None) -> list[str]:
    if delimiter is None:
        return [cell.strip('"') for cell in line.split()]
    if '"' in line:
        parts = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
    else:
        parts = line.split(delimiter)
    return [cell.strip() for cell in parts]


def _filled(cells: Sequence[str]) -> int:
    """The number of cells without the empty ones at the end."""
    return next((i for i in range(len(cells), 0, -1) if cells[i - 1]), 0)


def is_number(cell: str) -> bool:
    """True if the text is a number in the notation that programs share."""
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell  # 1_000 is a number in Python only.


def _decode(path: Path, content: bytes) -> str:
    """The content as text; refuses NUL bytes and anything that is not UTF-8."""
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError("expected UTF-8 text, got UTF-16", where=path, cure="Save it as UTF-8.")
    bad = content.find(b"\0")
    if bad < 0:
        try:
            return content.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            bad = error.start
    line = content.count(b"\n", 0, bad) + 1
    raise InputError(
        "expected detections, truth or tracks as text, XML, JSON or Parquet, got bytes that are not"
        " UTF-8 text",
        where=f"{path}, line {line}",
        cure="Is it the right file?",
    )


def text_of_rows(
    path: Path,
    rows: Sequence[Mapping[str, str]],
    numbers: Sequence[int],
    places: Sequence[int] = (),
    every: int = 0,
) -> Text:
    """Rows of named cells, from the lines ``numbers`` of a file, as a table with a header; cells
    that a row does not have are empty.

    Parameters
    ----------
    path : the file.
    rows : the cells of each row by column.
    numbers : the line of each row in the file.
    places, every : the number of each among all rows of the file, and how many there are; by
        default these are all.
    """
    header = tuple(dict.fromkeys(name for row in rows for name in row))
    lines = [",".join(row.get(name, "") for name in header) for row in rows]
    row = np.array(places, np.int64)
    origin = Origin(path, "line", np.array(numbers, np.int64), row, every)
    return Text(origin, lines, ",", len(header), header)


def as_cell(value: object) -> str:
    """A value of JSON or XML as a cell of a table."""
    if value is None:
        return ""
    if isinstance(value, bool):
        value = int(value)
    return re.sub(r'[^\S ]|[,"]', "_", str(value).strip())
