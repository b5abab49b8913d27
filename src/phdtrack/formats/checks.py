"""Where the rows of a file stand in it, and the checks that all formats share.

The first bad row is reported, by its place in the file, with the number of further rows that have
the same fault.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from phdtrack.errors import InputError
from phdtrack.types import F8, I8, LAST_FRAME, Bool

_LARGEST = 2.0**53  # beyond it a float no longer tells neighbouring integers apart


@dataclass(frozen=True, slots=True, eq=False)
class Origin:
    """Where rows came from: ``path``, and for each row the 1-based ``number`` (M,) of its ``unit``
    ("line", "row") there.
    """

    path: Path
    unit: str
    number: I8

    def at(self, row: int) -> str:
        """The place of row ``row`` in words: "det.txt, line 12"."""
        return f"{self.path}, {self.unit} {self.number[row]}"


class Rule(NamedTuple):
    """A fault: the rows that have it (M,), its description with places for the row's ``values``
    (M,) or (M, k), a cure.
    """

    bad: Bool
    problem: str
    values: F8 | I8
    cure: str = ""


@dataclass(slots=True)
class WrongRows:
    """What is wrong in a file and was left out: how many ``rows``, and the ``first`` error, at
    ``place`` among the rows.
    """

    rows: int = 0
    first: InputError | None = None
    place: float = math.inf

    def take(self, error: InputError, *places: float) -> None:
        """Count the rows at these places, of which the first has this error."""
        self.rows += len(places)
        if places[0] < self.place:
            self.first = error
            self.place = places[0]

    def document(self) -> dict[str, object]:
        """For run.json; empty where nothing was left out."""
        if self.rows:
            return {"rows_left_out": self.rows, "first_left_out": str(self.first)}
        return {}

    def sentences(self) -> tuple[str, ...]:
        """What was left out, for people."""
        if self.rows == 1:
            many = "1 row that is wrong is"
        else:
            many = f"{self.rows} rows that are wrong are"
        if self.rows:
            return (f"{many} left out, the first: {self.first}",)
        return ()


def enforce(origin: Origin, *rules: Rule) -> None:
    """Raise `InputError` for the first row that breaks a rule."""
    broken = [(int(np.argmax(rule.bad)), rule) for rule in rules if rule.bad.any()]
    if not broken:
        return
    row, rule = min(broken, key=lambda pair: pair[0])
    others = int(np.count_nonzero(rule.bad)) - 1
    if others:
        more = f" ({others} more like it)"
    else:
        more = ""
    problem = rule.problem.format(*np.atleast_1d(rule.values[row]).tolist())
    raise InputError(problem + more, where=origin.at(row), cure=rule.cure)


def whole(
    values: F8, name: str, *, low: float = -_LARGEST, high: float = _LARGEST, cure: str = ""
) -> Rule:
    """The fault of a value that is no whole number, is below ``low`` or above ``high``, or too
    large to be exact.

    Parameters
    ----------
    values : (M,).
    name : what messages call them.
    low, high : smallest and largest value allowed.
    cure : what the message advises.
    """
    with np.errstate(invalid="ignore"):
        good = (np.floor(values) == values) & (values >= low) & (values <= high)
    if low > -_LARGEST:
        limits = f" of {low:.0f} or more"
    else:
        limits = ""
    if high < _LARGEST:
        limits = f" from {low:.0f} to {high:.0f}"
    else:
        limits = limits
    return Rule(
        ~good, f"expected a whole number{limits} for the {name}, came {{:.15g}}", values, cure
    )


def far(frame: F8) -> Rule:
    """The fault of a frame number beyond `LAST_FRAME`."""
    return Rule(
        frame > LAST_FRAME, f"expected frame {LAST_FRAME:,} or earlier, came {{:.15g}}", frame
    )


def repeated(*columns: F8 | I8) -> I8:
    """(M,) for each row an earlier one with the same values in all columns (M,); −1 where there is
    none.
    """
    order = np.lexsort(columns)
    same = np.all([np.diff(column[order]) == 0 for column in columns], axis=0)
    before = np.full(len(order), -1)
    before[order[1:][same]] = order[:-1][same]
    return before


def flag(values: F8, name: str) -> Rule:
    """The fault of a value that is neither 0 nor 1."""
    return Rule(
        (values != 0) & (values != 1), f"expected 0 or 1 for {name}, came {{:.15g}}", values
    )
