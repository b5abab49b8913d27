"""Rows of numbers as a file gives them, where each stands in it, and the checks that all formats share.

The first bad row is reported, by its place in the file, with the number of further rows that have the same fault.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto
from pathlib import Path
from typing import NamedTuple

import numpy as np

from phdtrack.errors import InputError
from phdtrack.types import F8, I8, Bool

_LARGEST = 2.0**53  # beyond it a float no longer tells neighbouring integers apart


class Kind(Enum):
    """What a file is read as."""

    DETECTIONS = auto()
    TRUTH = auto()
    TRACKS = auto()


class Source(NamedTuple):
    """A file to be read: ``content`` are its bytes, ``first`` is the number that it gives the first frame."""

    path: Path
    content: bytes
    kind: Kind
    first: int


@dataclass(frozen=True, slots=True, eq=False)
class Origin:
    """Where rows came from: ``path``, and for each row the 1-based ``number`` (M,) of its ``unit`` ("line", "row") there."""

    path: Path
    unit: str
    number: I8

    def at(self, row: int) -> str:
        """The place of row ``row`` in words: "det.txt, line 12"."""
        return f"{self.path}, {self.unit} {self.number[row]}"


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """M boxes, unchecked. Columns that the file does not have are None.

    Attributes
    ----------
    origin : where each row stands in its file.
    frame : (M,) as the file numbers them, the first one being ``first``.
    xyxy : (M, 4) pixels.
    identity, confidence, class_id, detection : (M,).
    mot_class : (M,) the class of MOTChallenge's truth, which decides whether a row is scored.
    distractor, confirmed : (M,) 0 or 1.
    covariance : (M, 10) upper triangle, by rows, of (centre x, centre y, width, height) in pixels².
    """

    origin: Origin
    frame: F8
    xyxy: F8
    first: int = 1
    identity: F8 | None = None
    confidence: F8 | None = None
    class_id: F8 | None = None
    mot_class: F8 | None = None
    distractor: F8 | None = None
    detection: F8 | None = None
    confirmed: F8 | None = None
    covariance: F8 | None = None


class Rule(NamedTuple):
    """A fault: the rows that have it (M,), its description with places for the row's ``values`` (M,) or (M, k), a cure."""

    bad: Bool
    problem: str
    values: F8 | I8
    cure: str = ""


def enforce(origin: Origin, *rules: Rule) -> None:
    """Raise `InputError` for the first row that breaks a rule."""
    broken = [(int(np.argmax(rule.bad)), rule) for rule in rules if rule.bad.any()]
    if not broken:
        return
    row, rule = min(broken, key=lambda pair: pair[0])
    others = int(np.count_nonzero(rule.bad)) - 1
    more = f" ({others} more like it)" if others else ""
    problem = rule.problem.format(*np.atleast_1d(rule.values[row]).tolist())
    raise InputError(problem + more, where=origin.at(row), cure=rule.cure)


def whole(values: F8, name: str, *, lowest: float = -_LARGEST, cure: str = "") -> Rule:
    """The fault of a value that is no whole number, is below the lowest, or too large to be exact.

    Parameters
    ----------
    values : (M,).
    name : what messages call them.
    lowest : smallest value allowed.
    cure : what the message advises.
    """
    with np.errstate(invalid="ignore"):
        good = (np.abs(values) <= _LARGEST) & (np.floor(values) == values) & (values >= lowest)
    least = "" if lowest == -_LARGEST else f" of {lowest:.0f} or more"
    return Rule(~good, f"expected a whole number{least} for the {name}, came {{:.15g}}", values, cure)


def repeated(*columns: F8 | I8) -> I8:
    """(M,) for each row an earlier one with the same values in all columns (M,); −1 where there is none."""
    order = np.lexsort(columns)
    same = np.all([np.diff(column[order]) == 0 for column in columns], axis=0)
    before = np.full(len(order), -1)
    before[order[1:][same]] = order[:-1][same]
    return before
