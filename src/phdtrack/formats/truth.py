"""Readers of annotated objects, and of the parts of a benchmark's truth that are not scored.

MOT16, MOT17 and MOT20 have a flag in column 7 and a class in column 8. Pedestrians (class 1) with
flag 1 are scored. People on vehicles (2), static persons (7), distractors (8), reflections (12),
and in MOT20 other vehicles (6), are distractors whatever their flag: they are not scored, and
neither is output that matches them. All other rows are left out. This is TrackEval's preprocessing,
with one difference that a `Truth` cannot express: there, rows that are left out still take part in
the matching that finds the output of distractors. MOT15 has no classes: rows with 0 in column 7 are
left out, all others are scored.

KITTI label files (`kitti.py`) are scored for one type, like in TrackEval: objects of a neighbouring
type (Van for Car, a sitting person for Pedestrian), truncated ones and those of occlusion above 2
are distractors. Unmatched output is ignored if more than half of it lies in a DontCare region, or
if it is at most 25 pixels high.

A list of what to ignore is a CSV file ``frame,x,y,w,h`` of regions, which hold in all frames if the
frame is empty, or a header names none. With a column for the identity, or as a MOTChallenge file,
rows of an identity from 0 on are distractors, those of −1 regions.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from phdtrack.conventions import BY_EVIDENCE, Conventions, report
from phdtrack.errors import InputError
from phdtrack.files import AnyPath, load
from phdtrack.formats.checks import Rule, enforce, whole_number, zero_or_one
from phdtrack.formats.kitti import LEAST_HEIGHT
from phdtrack.formats.mot_layout import LAST_CLASS, PEDESTRIAN
from phdtrack.formats.read import NO_ROWS, box_rules, frames_of, identified, table_of
from phdtrack.formats.table import Column, Kind, Source, Table, table_of_text
from phdtrack.formats.text import Text, scan
from phdtrack.types import F8, Truth

_DISTRACTORS = (2, 7, 8, 12)
_MOT20_DISTRACTORS = (2, 6, 7, 8, 12)
# The columns of a list of what to ignore.
_REGION = ("frame", "x", "y", "w", "h")


def read_truth(
    path: AnyPath,
    *,
    first_frame: int | None = None,
    kitti: str = "",
    conventions: Conventions = BY_EVIDENCE,
    notices: list[str] | None = None,
) -> Truth:
    """Read the annotated objects in a MOTChallenge ``gt.txt``, KITTI, CSV, Parquet, JSON, CVML,
    CVAT or UA-DETRAC file, sorted by frame.

    Rows of confidence 0 that are not distractors are left out. In truth with classes of MOT16 and
    later pedestrians are scored, the benchmark's distractors are marked, and all others are left
    out. The distractors are the classes 2, 7, 8, 12, and 6 too if a folder of the path is called
    MOT20-something. Rows of identity −1 and flag 0 are regions to ignore. Raises `InputError` if
    the file is missing or malformed; the message names the line.

    Parameters
    ----------
    path : the file.
    first_frame : the number that the file gives the first frame; None: as usual in its format.
    kitti : the type of objects to score in a KITTI label file, for example Car.
    conventions : what goes before the evidence of the content.
    notices : receives sentences about guesses; None: they are logged.

    Returns
    -------
    The annotated objects, boxes in pixels, frames from 1.
    """
    path = Path(path)
    conventions = conventions.starting_at(first_frame)
    table = table_of(path, Kind.TRUTH, conventions, kitti, notices=notices)
    label = table.get(Column.MOT_CLASS)
    flagged = (label != -1) & (label != PEDESTRIAN) & (table.get(Column.CONFIDENCE) != 0)
    if flagged.any() and not conventions.format:
        report(
            notices,
            path,
            f"{int(flagged.sum())} rows with flag 1 are of other classes than 1 and are not scored,"
            " as in MOT16, MOT17 and MOT20, after which a folder is called",
        )
    return _truth_of(table, notices)


def read_truth_by_class(
    path: AnyPath,
    *,
    conventions: Conventions = BY_EVIDENCE,
    notices: list[str] | None = None,
) -> dict[str, Truth]:
    """Read the annotated objects of each class, by its name or number.

    Raises `InputError` like `read_truth`, and if the file has no classes.

    Parameters
    ----------
    path : the file.
    conventions : what goes before the evidence of the content.
    notices : receives sentences about guesses; None: they are logged.

    Returns
    -------
    The objects of each class, by its name or number.
    """
    path = Path(path)
    tracks = table_of(path, Kind.TRACKS, conventions, notices=[])
    if tracks.kitti:
        return {
            name: read_truth(path, kitti=name, conventions=conventions, notices=notices)
            for name in tracks.names.values()
        }
    table = table_of(path, Kind.TRUTH, conventions, notices=notices)
    if Column.CLASS not in table.values:
        raise InputError(
            "the truth has no classes",
            where=path,
            cure="Name the column class, or omit --per-class.",
        )
    label = table.get(Column.CLASS)
    enforce(table.origin, whole_number(label, "class"))
    # Regions hold for objects of every class.
    region = table.get(Column.REGION) != 0
    return {
        table.names.get(int(number), f"{number:.0f}"): _truth_of(
            table.select((label == number) | region), notices
        )
        for number in np.unique(label[~region])
    }


def _truth_of(table: Table, notices: list[str] | None) -> Truth:
    """The truth in a table. Raises `InputError` for a malformed row."""
    path = table.origin.path
    unnamed = (table.get(Column.IDENTITY) == -1) & (table.get(Column.CONFIDENCE) == 0)
    if unnamed.any():
        rows = int(unnamed.sum())
        report(notices, path, f"{rows} rows with identity −1 and flag 0 are regions to ignore")
    region = (table.get(Column.REGION) != 0) | unnamed
    enforce(table.origin, *box_rules(table))
    regions = _regions(table.select(region))
    table = table.select(~region)
    confidence = table.get(Column.CONFIDENCE)
    ignore = table.get(Column.DISTRACTOR)
    label = table.get(Column.MOT_CLASS)
    rules = [zero_or_one(ignore, "distractor")]
    if (label != -1).any():
        cure = (
            "Truth of 8 or 9 columns has a MOTChallenge class in column 8; with 10 columns (MOT15)"
            " it has none."
        )
        rules.append(whole_number(label, "class", low=PEDESTRIAN, high=LAST_CLASS, cure=cure))
        mot20 = any(part.upper().startswith("MOT20") for part in path.absolute().parts)
        ignore = np.isin(label, _MOT20_DISTRACTORS if mot20 else _DISTRACTORS).astype(np.float64)
        confidence = np.where(label == PEDESTRIAN, confidence, 0.0)
    frame, identity = identified(table, *rules)
    order = np.argsort(frame, kind="stable")
    order = order[(confidence[order] != 0) | (ignore[order] != 0)]
    if len(frame) and not len(order):
        report(notices, path, f"all {len(frame)} rows have flag 0 or a class that is not scored")
    return Truth(
        frame[order],
        identity[order],
        table.xyxy()[order],
        ignore[order] != 0,
        regions,
        LEAST_HEIGHT if table.kitti else 0.0,
    )


def ignoring(truth: Truth, path: AnyPath) -> Truth:
    """The ``truth`` with the distractors and regions of a list of what to ignore.

    Raises `InputError` if the list is missing or malformed; the message names the line.

    Parameters
    ----------
    truth : annotated objects, boxes in pixels.
    path : the list, as this module describes it.

    Returns
    -------
    The rows of both.
    """
    path = Path(path)
    text = _ignore_list(scan(path, load(path)))
    table = NO_ROWS
    if len(text):
        # Frame 0 means all frames.
        table = table_of_text(Source(path, b"", Kind.IGNORED, 0), text)
    identity = table.get(Column.IDENTITY)
    enforce(table.origin, *box_rules(table), whole_number(identity, "identity", low=-1))
    # UAVDT numbers the regions of its lists, which are called M0101_gt_ignore.txt.
    is_region = (identity < 0) | path.stem.endswith("gt_ignore")
    distractors = table.select(~is_region)
    frame = distractors.get(Column.FRAME).astype(np.int64)
    rule = Rule(frame == 0, "a row with an identity needs a frame", frame)
    enforce(distractors.origin, rule)
    frames = np.concatenate([truth.frame, frame])
    order = np.argsort(frames, kind="stable")
    identities = np.concatenate([truth.identity, identity[~is_region].astype(np.int64)])
    marked = np.concatenate([truth.distractor, np.ones(len(frame), np.bool_)])
    xyxy = np.concatenate([truth.xyxy, distractors.xyxy()])
    # The frames of the list count from 1, although it may contain 0.
    regions = _regions(replace(table.select(is_region), first=1))
    return replace(
        truth,
        frame=frames[order],
        identity=identities[order],
        xyxy=xyxy[order],
        distractor=marked[order],
        regions=np.concatenate([truth.regions, regions]),
    )


def _regions(table: Table) -> F8:
    """(R, 5) frame (0: all), left, top, right, bottom."""
    return np.column_stack([frames_of(table), table.xyxy()])


def _ignore_list(text: Text) -> Text:
    """A list of what to ignore, with a header and an identity in each row (−1 for regions) and
    frame 0 for all frames. Raises `InputError` if a list without a header has too few columns.
    """
    names = text.header
    if not names and 0 < text.width < len(_REGION):
        raise InputError(
            f"expected {','.join(_REGION)}, the columns of a list without a header, got"
            f" {text.width} values",
            where=str(text.origin.at(0)),
            cure="Begin each line with a comma for all frames, or name the columns in a header.",
        )
    if not names and text.width == len(_REGION):
        names = _REGION
    elif not names:
        names = ("frame", "id", "left", "top", "width", "height")
    frame = next((names.index(name) for name in Column.FRAME.names if name in names), -1)
    identified = any(name in names for name in Column.IDENTITY.names)
    rows = []
    for row in range(len(text)):
        cells = text.cells(row)
        if len(cells) < text.width or (len(cells) > text.width and not identified):
            # The columns that are added here are none of the file's.
            first = "header" if text.header else "first line"
            problem = f"expected {text.width} values as in the {first}, got {len(cells)}"
            cure = "Complete the line, or remove it."
            raise InputError(problem, where=str(text.origin.at(row)), cure=cure)
        if -1 < frame < len(cells) and not cells[frame]:
            cells[frame] = "0"
        rows.append(",".join(cells[: len(names)] if identified else [*cells, "-1"]))
    if not identified:
        names = (*names, "id")
    if frame < 0:
        names = (*names, Column.FRAME.names[0])
        rows = [f"{row},0" for row in rows]
    return Text(text.origin, rows, ",", len(names), names)
