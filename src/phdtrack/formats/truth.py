"""Reading annotated objects, and what of a benchmark's truth counts neither for nor against a
tracker.

MOT16, MOT17 and MOT20 have a flag in column 7 and a class in column 8. Pedestrians (class 1) with
flag 1 are scored. People on vehicles (2), static persons (7), distractors (8), reflections (12),
and in MOT20 other vehicles (6), whatever their flag, are not scored, and neither is output that
matches them. All others are left out. This is the benchmark's own preprocessing as TrackEval does
it, with one difference that a `Truth` cannot express: there, rows that are left out still take part
in the matching by which distractors find the output to remove. MOT15 has no classes: a row with 0
in column 7 is left out, all others are scored.

KITTI label files (`kitti.py`) are scored of one type, as TrackEval does it: objects of a
neighbouring type (Van for Car, a sitting person for Pedestrian), truncated ones and those of
occlusion above 2 are distractors; output that matches no row is removed where more than half of it
lies in a DontCare region, or where it is at most 25 pixels high.

A list of what to ignore is a CSV file ``frame,x,y,w,h``: regions, in all frames where the frame is
empty. With a column for the identity, or as a MOTChallenge file, rows of an identity from 0 on are
distractors, those of −1 regions.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from phdtrack.errors import InputError
from phdtrack.files import AnyPath, load
from phdtrack.formats.checks import Rule, enforce, flag, whole
from phdtrack.formats.kitti import LEAST_HEIGHT
from phdtrack.formats.read import NO_ROWS, box_rules, identified, table_of
from phdtrack.formats.table import Column, Kind, Source, Table, table_of_text
from phdtrack.formats.text import Text, scan
from phdtrack.types import F8, Truth

_DISTRACTORS = (2, 7, 8, 12)
_MOT20_DISTRACTORS = (2, 6, 7, 8, 12)
_PEDESTRIAN = 1
_LAST_CLASS = 13


def read_truth(path: AnyPath, *, first_frame: int | None = None, kitti: str = "") -> Truth:
    """The annotated objects in a MOTChallenge ``gt.txt``, KITTI, CSV, Parquet, JSON, CVML or CVAT
    file, sorted by frame.

    Rows of confidence 0 that are no distractors are left out. In truth with classes (MOT16 and
    later) pedestrians are scored, rows of the benchmark's distractors are marked, all others left
    out. The distractors are the classes 2, 7, 8, 12, and 6 too where the path has a folder called
    MOT20-something. Raises `InputError` where the file is missing or malformed; the message names
    the line.

    Parameters
    ----------
    path : the file.
    first_frame : the number that the file gives the first frame; None: what is usual in its format.
    kitti : the type that is scored of a KITTI label file, as Car.
    """
    return _truth_of(table_of(Path(path), Kind.TRUTH, first_frame, kitti), Path(path))


def read_truth_by_class(path: AnyPath) -> dict[str, Truth]:
    """The annotated objects of each class, by its name or number, in a file that says their
    classes.

    Raises `InputError` as `read_truth`, and where the file says no classes.
    """
    path = Path(path)
    table = table_of(path, Kind.TRACKS, None)
    if Column.CLASS not in table.values:
        cure = "Name the column class, or leave out --per-class."
        raise InputError("the truth does not say the classes of its objects", where=path, cure=cure)
    if table.kitti:
        return {name: read_truth(path, kitti=name) for name in table.names.values()}
    table = table_of(path, Kind.TRUTH, None)
    label = table.get(Column.CLASS)
    enforce(table.origin, whole(label, "class"))
    return {
        table.names.get(int(one), f"{one:.0f}"): _truth_of(table.select(label == one), path)
        for one in np.unique(label)
    }


def _truth_of(table: Table, path: Path) -> Truth:
    """The truth in a table; `InputError` where a row cannot be one."""
    region = table.get(Column.REGION) != 0
    enforce(table.origin, *box_rules(table))
    table, regions = table.select(~region), _regions(table.select(region))
    confidence, ignore, label = (
        table.get(c) for c in (Column.CONFIDENCE, Column.DISTRACTOR, Column.MOT_CLASS)
    )
    rules = [flag(ignore, "distractor")]
    if (label != -1).any():
        cure = (
            "Truth of 8 or 9 columns has a MOTChallenge class in column 8; with 10 columns (MOT15)"
            " it has none."
        )
        rules.append(whole(label, "class", low=_PEDESTRIAN, high=_LAST_CLASS, cure=cure))
        mot20 = any(part.upper().startswith("MOT20") for part in path.absolute().parts)
        ignore = np.isin(label, _MOT20_DISTRACTORS if mot20 else _DISTRACTORS).astype(np.float64)
        confidence = np.where(label == _PEDESTRIAN, confidence, 0.0)
    frame, identity = identified(table, *rules)
    order = np.argsort(frame, kind="stable")
    order = order[(confidence[order] != 0) | (ignore[order] != 0)]
    if table.kitti:
        height = LEAST_HEIGHT
    else:
        height = 0.0
    return Truth(
        frame[order], identity[order], table.xyxy()[order], ignore[order] != 0, regions, height
    )


def ignoring(truth: Truth, path: AnyPath) -> Truth:
    """``truth`` with the distractors and regions of a list of what to ignore.

    Raises `InputError` where the list is missing or malformed; the message names the line.
    """
    path = Path(path)
    text = _list(scan(path, load(path)))
    # Frame 0 stands for all frames.
    if len(text):
        table = table_of_text(Source(path, b"", Kind.IGNORED, 0), text)
    else:
        table = NO_ROWS
    enforce(table.origin, *box_rules(table), whole(table.get(Column.IDENTITY), "identity", low=-1))
    region = table.get(Column.IDENTITY) < 0
    distractors = table.select(~region)
    frame = table.get(Column.FRAME).astype(np.int64)
    enforce(
        distractors.origin,
        Rule(frame[~region] == 0, "a row with an identity needs a frame", frame[~region]),
    )
    frames = np.concatenate([truth.frame, frame[~region]])
    count = len(distractors.origin.number)
    order = np.argsort(frames, kind="stable")
    identity = np.concatenate([truth.identity, distractors.get(Column.IDENTITY).astype(np.int64)])
    marked = np.concatenate([truth.distractor, np.ones(count, np.bool_)])
    xyxy = np.concatenate([truth.xyxy, distractors.xyxy()])
    regions = np.concatenate([truth.regions, _regions(table.select(region), first=1)])
    return replace(
        truth,
        frame=frames[order],
        identity=identity[order],
        xyxy=xyxy[order],
        distractor=marked[order],
        regions=regions,
    )


def _regions(table: Table, first: int | None = None) -> F8:
    """(R, 5) frame, left, top, right, bottom."""
    frame = table.get(Column.FRAME) + (1 - (table.first if first is None else first))
    return np.column_stack([frame, table.xyxy()])


def _list(text: Text) -> Text:
    """A list of what to ignore with a header and an identity in each row, −1 for regions, and frame
    0 for all frames.
    """
    names = text.header or (
        ("frame", "x", "y", "w", "h")
        if text.width == 5
        else ("frame", "id", "left", "top", "width", "height")
    )
    at = next((names.index(name) for name in Column.FRAME.names if name in names), 0)
    known = any(name in names for name in Column.IDENTITY.names)
    rows = []
    for row in range(len(text)):
        cells = [cell or "0" if i == at else cell for i, cell in enumerate(text.cells(row))]
        rows.append(",".join(cells[: len(names)] if known else [*cells, "-1"]))
    names = names if known else (*names, "id")
    return Text(text.origin, rows, ",", len(names), names)
