"""Places of rows in files, and the checks that all formats share.

An error names the first bad row by its place in the file and counts the other rows with the same
fault.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from phdtrack.errors import InputError
from phdtrack.types import F8, I8, LAST_FRAME, Bool

# Beyond it, a float cannot tell neighbouring integers apart.
_LARGEST_EXACT = 2.0**53


@dataclass(frozen=True, slots=True, eq=False)
class Origin:
    """The source of M rows.

    Attributes
    ----------
    path : the file.
    unit, number : (M,) the number of each row, from 1, in this unit of the file ("line", "row").
    row : (M,) the number of each among the rows of the file, from 0, without headers, comments and
        empty lines; by default they are all.
    rows : number of rows of the file.
    """

    path: Path
    unit: str
    number: I8
    row: I8 = field(default_factory=lambda: np.zeros(0, np.int64))
    rows: int = 0

    def __post_init__(self) -> None:
        if len(self.row) != len(self.number):
            object.__setattr__(self, "row", np.arange(len(self.number)))
        object.__setattr__(self, "rows", max(self.rows, len(self.number)))

    def select(self, index: I8 | Bool) -> Origin:
        """The source of the rows ``index``."""
        return replace(self, number=self.number[index], row=self.row[index])

    def at(self, row: int) -> str:
        """The place of row ``row`` (0-based) for messages: "det.txt, line 12"."""
        return f"{self.path}, {self.unit} {self.number[row]}"


class Rule(NamedTuple):
    """A possible fault: which rows have it (M,), its description with placeholders for the row's
    ``values`` (M,) or (M, k), and the cure.
    """

    bad: Bool
    problem: str
    values: F8 | I8
    cure: str = ""


@dataclass(slots=True)
class MalformedRows:
    """The malformed rows of a file that were skipped: how many ``rows``, and the ``first`` error,
    which stands at ``place`` in the file.
    """

    rows: int = 0
    first: InputError | None = None
    place: float = math.inf

    def add(self, error: InputError, *places: float) -> None:
        """Count the rows at these places; ``error`` is about the first of them."""
        self.rows += len(places)
        if places[0] < self.place:
            self.first = error
            self.place = places[0]

    def document(self) -> dict[str, object]:
        """The entries of run.json; empty if no row was skipped."""
        if self.rows:
            return {"rows_left_out": self.rows, "first_left_out": str(self.first)}
        return {}

    def sentences(self) -> tuple[str, ...]:
        """A warning for the user; empty if no row was skipped."""
        if self.rows == 1:
            return (f"1 malformed row skipped: {self.first}",)
        if self.rows:
            return (f"{self.rows} malformed rows skipped, the first: {self.first}",)
        return ()


def enforce(origin: Origin, *rules: Rule) -> None:
    """Raise `InputError` for the first row that breaks a rule."""
    broken = [(int(np.argmax(rule.bad)), rule) for rule in rules if rule.bad.any()]
    if not broken:
        return
    row, rule = min(broken, key=lambda pair: pair[0])
    problem = rule.problem.format(*np.atleast_1d(rule.values[row]).tolist())
    others = int(np.count_nonzero(rule.bad)) - 1
    if others:
        problem += f" ({others} more like it)"
    raise InputError(problem, where=origin.at(row), cure=rule.cure)


def whole_number(
    values: F8,
    name: str,
    *,
    low: float = -_LARGEST_EXACT,
    high: float = _LARGEST_EXACT,
    cure: str = "",
) -> Rule:
    """The fault of a value that is not a whole number from ``low`` to ``high``.

    Parameters
    ----------
    values : (M,).
    name : what messages call them.
    low, high : smallest and largest value allowed; by default, as far as floats are exact.
    cure : the advice in the message.
    """
    with np.errstate(invalid="ignore"):
        good = (np.floor(values) == values) & (values >= low) & (values <= high)
    limits = ""
    if high < _LARGEST_EXACT:
        limits = f" from {low:.0f} to {high:.0f}"
    elif low > -_LARGEST_EXACT:
        limits = f" of {low:.0f} or more"
    problem = f"expected a whole number{limits} for the {name}, got {{:.15g}}"
    return Rule(~good, problem, values, cure)


def after_last_frame(frame: F8) -> Rule:
    """The fault of a frame number beyond `LAST_FRAME`."""
    problem = f"expected frame {LAST_FRAME:,} or earlier, got {{:.15g}}"
    return Rule(frame > LAST_FRAME, problem, frame)


def earlier_duplicate(*columns: F8 | I8) -> I8:
    """(M,) index of an earlier row with equal values in all columns (M,); −1 if there is none."""
    order = np.lexsort(columns)
    same = np.all([np.diff(column[order]) == 0 for column in columns], axis=0)
    before = np.full(len(order), -1)
    before[order[1:][same]] = order[:-1][same]
    return before


def zero_or_one(values: F8, name: str) -> Rule:
    """The fault of a value that is neither 0 nor 1."""
    problem = f"expected 0 or 1 for {name}, got {{:.15g}}"
    return Rule((values != 0) & (values != 1), problem, values)
