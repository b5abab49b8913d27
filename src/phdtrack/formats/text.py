"""Tables in text: any usual delimiter, with or without a header, and errors that name the line.

Values are separated by semicolons, tabs, commas or blanks, found from the first line that is
neither empty nor a comment (``#``). That line is a header when no value in it is a number. Windows
line ends, a byte order mark, quotes and an empty value at the end of every line are understood.
Numbers have a decimal point.

There are two ways through a file. NumPy parses a clean one in one go. Where that fails, the lines
are read one by one: either the reason is found and reported with its line, or it was harmless
(quotes, say).
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from phdtrack.errors import InputError
from phdtrack.files import AnyPath, load
from phdtrack.formats.checks import Origin, WrongRows
from phdtrack.types import F8


@dataclass(frozen=True, slots=True, eq=False)
class Text:
    """The lines of a file that hold values.

    Attributes
    ----------
    origin : the file, and for each line its 1-based number there.
    lines : the M lines with values, without header, comments and empty lines.
    delimiter : None for any number of blanks.
    width : the number of columns: of values in the first line, header or not, without empty ones at
        its end.
    header : the names of the columns in lower case, empty where the file has no header.
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
        """The lines ``rows``, from 0."""
        origin = replace(self.origin, number=self.origin.number[np.array(rows, np.int64)])
        return replace(self, origin=origin, lines=[self.lines[row] for row in rows])

    def readable(self, columns: Mapping[int, str], left_out: WrongRows) -> Text:
        """The lines that have values for the ``columns`` (see `numbers`); the others go to
        ``left_out``.
        """
        kept = []
        for row in range(len(self)):
            try:
                _parse(self, row, columns)
                kept.append(row)
            except InputError as error:
                left_out.take(error, float(self.origin.number[row]))
        return self.select(kept)

    def empty(self, column: int) -> bool:
        """Whether no line has a value in this column."""
        return not any("".join(self.cells(row)[column : column + 1]) for row in range(len(self)))


def scan(path: Path, content: bytes) -> Text:
    """Find delimiter, header and the lines with values; `InputError` where the content is not UTF-8
    text.
    """
    everything = _decode(path, content).replace("\r\n", "\n").replace("\r", "\n").split("\n")
    kept = [
        i
        for i, line in enumerate(everything)
        if line and not line.isspace() and line.lstrip()[0] != "#"
    ]
    lines = [everything[i] for i in kept]
    number = np.array(kept, dtype=np.int64) + 1
    if not lines:
        return Text(Origin(path, "line", number), [])
    delimiter = next((d for d in ";\t," if d in lines[0]), None)
    first = _split(lines[0], delimiter)
    named = not any(is_number(cell) for cell in first)
    if named:
        header = tuple(normalise(cell) for cell in first)
    else:
        header = ()
    return Text(
        Origin(path, "line", number[named:]), lines[named:], delimiter, _filled(first), header
    )


def normalise(name: str) -> str:
    """The name of a column as it is compared: lower case, with ``_`` for blanks and hyphens."""
    return name.strip(" '").lower().replace(" ", "_").replace("-", "_")


def numbers(text: Text, columns: Mapping[int, str]) -> F8:
    """(M, k) the values of the k ``columns``, by place from 0, with the names that messages call
    them by.

    Raises `InputError` where a value is not a number, or a line has more or fewer values than the
    first.
    """
    if not len(text):
        return np.zeros((0, len(columns)))
    try:
        table = np.loadtxt(text.lines, delimiter=text.delimiter, comments=None, ndmin=2)
        # It passes over lines that are empty without their quotes.
        if table.shape == (len(text), text.width):
            return table[:, list(columns)]
    except ValueError:
        pass  # the slow way finds the line
    return np.array([_parse(text, row, columns) for row in range(len(text))])


def read_columns(path: AnyPath, names: Sequence[str], widths: Sequence[int]) -> tuple[Origin, F8]:
    """Where each row of a table stands, and the values (M, k) of its columns in the order of
    ``names``.

    They are found by the names in its header or else by position. Raises `InputError` where the
    file is missing, has other columns, or a value is not a number.

    Parameters
    ----------
    path : the file.
    names : of the columns, in lower case.
    widths : how many of them, from the first, a file may have.
    """
    text = scan(Path(path), load(path))
    if text.header:
        found = [name for name in names if name in text.header]
    else:
        found = list(names[: text.width or min(widths)])
    if text.header or not len(text):
        width = len(found)
    else:
        width = text.width
    if (
        width not in widths
        or found != list(names[:width])
        or max(map(text.header.count, found), default=0) > 1
    ):
        wanted = " or ".join(map(str, widths))
        came = ", ".join(text.header) or f"{width} numbers a line"
        if len(text):
            where = text.origin.at(0)
        else:
            where = str(path)
        raise InputError(f"expected {wanted} columns, {', '.join(names)}; came {came}", where=where)
    if text.header:
        at = [text.header.index(name) for name in found]
    else:
        at = list(range(width))
    return text.origin, numbers(text, dict(zip(at, found, strict=True)))


def _parse(text: Text, row: int, columns: Mapping[int, str]) -> list[float]:
    """The values of one line."""
    cells = text.cells(row)
    if len(cells) != text.width:
        if text.header:
            first = "header"
        else:
            first = "first line"
        problem = f"expected {text.width} values as in the {first}, came {_filled(cells)}"
        cure = "A line cut short is what an interrupted program leaves: mend or remove it."
        raise InputError(problem, where=text.origin.at(row), cure=cure)
    for column, label in columns.items():
        if not is_number(cells[column]):
            if cells[column]:
                came = f"'{cells[column][:40]}'"
            else:
                came = "nothing"
            problem = f"expected a number for the {label} (column {column + 1}), came {came}"
            cure = "Numbers are written as 12 or 12.5, with a point."
            raise InputError(problem, where=text.origin.at(row), cure=cure)
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
    """Number of cells without the empty ones at the end."""
    return next((i for i in range(len(cells), 0, -1) if cells[i - 1]), 0)


def is_number(cell: str) -> bool:
    """Whether a value is a number as other programs write it."""
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell  # Python's own notation, which no other program writes or reads


def _decode(path: Path, content: bytes) -> str:
    """The content as text; NUL bytes and whatever is not UTF-8 are refused."""
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError("expected UTF-8 text, came UTF-16", where=path, cure="Save it as UTF-8.")
    bad = content.find(b"\0")
    if bad < 0:
        try:
            return content.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            bad = error.start
    line = content.count(b"\n", 0, bad) + 1
    problem = (
        "expected detections, truth or tracks as text, XML, JSON or Parquet, came bytes that are no"
        " UTF-8 text"
    )
    raise InputError(problem, where=f"{path}, line {line}", cure="Is it the right file?")
