"""Box conventions that the user states, and sentences about scores and frame numbers that look like
other units.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from phdtrack.conventions import report
from phdtrack.errors import InputError
from phdtrack.formats.seqinfo import find_seqinfo
from phdtrack.formats.table import Column, Source, Table
from phdtrack.types import F8, I8

# Scores above 1 up to the second number, if so many are above 1, are percent.
_LARGEST_SCORE = 1.0
_PERCENT = 100.0
_MOST = 0.9
# Frame numbers are times if so many of them follow each other at distances from 15 (a 66th of a
# second) to 1000, which differ by no more than 1 as rounded milliseconds do.
_FEWEST = 10
_SHORTEST = 15
_LONGEST = 1000


def as_stated(source: Source, table: Table) -> Table:
    """The table with its boxes as the user's conventions say, in pixels. Raises `InputError` if the
    frame's size is needed and not known.
    """
    stated = source.conventions
    values = dict(table.values)
    if stated.box == "ltrb" and Column.WIDTH in values and Column.CENTRE_X not in values:
        for old, new in ((Column.X, Column.LEFT), (Column.Y, Column.TOP)):
            if new not in values:
                values[new] = values.pop(old)
        values[Column.RIGHT] = values.pop(Column.WIDTH)
        values[Column.BOTTOM] = values.pop(Column.HEIGHT)
    if stated.box == "ltwh" and Column.RIGHT in values:
        values[Column.WIDTH] = values.pop(Column.RIGHT)
        values[Column.HEIGHT] = values.pop(Column.BOTTOM)
    if stated.units == "shares":
        width, height = _frame_size(source)
        across = (Column.LEFT, Column.RIGHT, Column.WIDTH, Column.CENTRE_X, Column.X)
        down = (Column.TOP, Column.BOTTOM, Column.HEIGHT, Column.CENTRE_Y, Column.Y)
        with np.errstate(over="ignore"):
            for columns, side in ((across, width), (down, height)):
                values |= {one: values[one] * side for one in columns if one in values}
    return replace(table, values=values)


def _frame_size(source: Source) -> tuple[int, int]:
    """Width and height in pixels, stated or of seqinfo.ini. Raises `InputError` if unknown."""
    if min(source.conventions.frame_size) > 0:
        return source.conventions.frame_size
    info = find_seqinfo(source.path)
    if info is None:
        raise InputError(
            "boxes in shares need the size of the frames, which is not known",
            where=source.path,
            cure="Say --frame-size WxH, or in Python frame_size.",
        )
    return info.width, info.height


def check_scores(confidence: F8, path: Path, notices: list[str] | None) -> None:
    """Report scores that look like percent.

    Parameters
    ----------
    confidence : (M,) scores.
    path : their file.
    notices : receives the sentence; None: it is logged.
    """
    if not len(confidence):
        return
    highest = float(confidence.max())
    above = float((confidence > _LARGEST_SCORE).mean())
    if above >= _MOST and confidence.min() >= 0 and 2 < highest <= _PERCENT:
        sentence = f"the scores go up to {highest:.4g} and seem to be percent; they are used as"
        report(notices, path, f"{sentence} they are: divide them by 100")


def check_times(frame: I8, path: Path, notices: list[str] | None) -> None:
    """Report frame numbers that look like times in milliseconds.

    Parameters
    ----------
    frame : (M,) frame numbers from 1.
    path : their file.
    notices : receives the sentence; None: it is logged.
    """
    steps = np.diff(np.unique(frame))
    if len(steps) < _FEWEST - 1:
        return
    usual = int(np.median(steps))
    close = np.abs(steps - usual) <= 1
    if _SHORTEST <= usual <= _LONGEST and close.mean() >= _MOST and frame.max() > _LONGEST:
        sentence = f"the frame numbers advance by {usual}: if they are times in milliseconds"
        report(notices, path, f"{sentence}, divide them by the frames' interval and add 1")
