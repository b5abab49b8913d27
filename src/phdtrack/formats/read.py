"""Readers of detections and tracks: one function each, for every format.

The content decides the format: Parquet by its first bytes, XML by ``<``, JSON by ``[`` or ``{``,
JSON lines if its first line is an object with a frame; anything else is a text table, MOTChallenge,
KITTI or CSV. An empty file has no rows. The readers number frames from 1. ``first_frame`` is the
number that the file gives the first frame, for tools that deviate from their format: 0 in CVML,
CVAT and KITTI, and in COCO if an image has this number; 1 elsewhere. `truth.py` reads truth.

``conventions`` go before what the content says; sentences about guesses are added to ``notices``,
or logged without such a list.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from phdtrack.conventions import BY_EVIDENCE, Conventions, report
from phdtrack.errors import InputError
from phdtrack.files import AnyPath, load
from phdtrack.formats.checks import (
    MalformedRows,
    Origin,
    Rule,
    after_last_frame,
    earlier_duplicate,
    enforce,
    whole_number,
    zero_or_one,
)
from phdtrack.formats.coco import table_of_coco
from phdtrack.formats.doubts import as_stated, check_scores, check_times
from phdtrack.formats.json_lines import rows_of_json_lines
from phdtrack.formats.kitti import is_kitti, kitti_of_all_types, kitti_of_type
from phdtrack.formats.table import Column, Kind, Source, Table, table_of_parquet, table_of_text
from phdtrack.formats.text import Text, scan
from phdtrack.formats.xml_boxes import table_of_xml
from phdtrack.types import F8, I8, Bool, Detections, DetectionTable, Tracks

NO_ROWS = Table(Origin(Path(), "line", np.zeros(0, np.int64)), 1, {}, np.zeros((0, 0)))


def read_detections(
    path: AnyPath,
    *,
    first_frame: int | None = None,
    left_out: MalformedRows | None = None,
    conventions: Conventions = BY_EVIDENCE,
    notices: list[str] | None = None,
) -> DetectionTable:
    """Read the detections in a MOTChallenge ``det.txt``, KITTI, CSV, Parquet, JSON, CVML or CVAT
    file, sorted by frame.

    Boxes are xyxy in pixels. Confidence is 1 and class 0 if the file has none; confidence is not
    bounded. Classes that are words get numbers, see `DetectionTable.names`; of KITTI label files
    all types except regions are read. Boxes of width or height 0, which real detectors report now
    and then, are skipped and counted in `DetectionTable.empty`. Raises `InputError` if the file is
    missing or malformed, or all its rows are; the message names the line.

    Parameters
    ----------
    path : the file.
    first_frame : the number that the file gives the first frame; None: as usual in its format.
    left_out : counts malformed rows, which are then skipped; None: the first one is an error.
    conventions : what goes before the evidence of the content.
    notices : receives sentences about guesses; None: they are logged.

    Returns
    -------
    The detections, boxes in pixels, frames from 1.
    """
    path = Path(path)
    conventions = conventions.starting_at(first_frame)
    table = table_of(path, Kind.DETECTIONS, conventions, left_out=left_out, notices=notices)
    found = detections_of(table, left_out)
    check_scores(found.detections.confidence, path, notices)
    check_times(found.frame, path, notices)
    if not len(found.frame):
        report(notices, path, _without_detections(found, path))
    return found


def _without_detections(found: DetectionTable, path: Path) -> str:
    """The sentence about a file from which no detection came."""
    if found.empty:
        read = f"none of its {found.empty} boxes has an area"
    elif path.stat().st_size == 0:
        read = "the file is empty"
    else:
        read = "the file holds no detection"
    return f"{read}: it is read as that of a detector that found nothing, and nothing is tracked"


def detections_of(table: Table, left_out: MalformedRows | None = None) -> DetectionTable:
    """The detections in a table, sorted by frame. Malformed rows are added to ``left_out``; without
    it, the first one raises `InputError`.
    """
    rules = [*box_rules(table, min_size=0.0), whole_number(table.get(Column.CLASS), "class")]
    if table.triangle.shape[1]:
        rules.append(_covariance_rule(_covariance(table)))
    try:
        enforce(table.origin, *rules)
    except InputError as error:
        if left_out is None:
            raise
        bad = np.any([rule.bad for rule in rules], axis=0)
        left_out.add(error, *table.origin.number[bad].tolist())
        table = table.select(~bad)
    frame = frames_of(table)
    if left_out is not None and left_out.first is not None and not len(frame):
        raise left_out.first
    box = table.xyxy()
    order = np.argsort(frame, kind="stable")
    order = order[np.all(box[order, 2:] > box[order, :2], axis=1)]
    detections = Detections(
        box,
        table.get(Column.CONFIDENCE),
        table.get(Column.CLASS).astype(np.int64),
        _covariance(table) if table.triangle.shape[1] else None,
    )
    return DetectionTable(
        frame[order],
        detections.select(order),
        len(frame) - len(order),
        table.names,
        table.origin.row[order],
        table.origin.rows,
    )


def _covariance(table: Table) -> F8:
    """(M, 4, 4) covariance of (centre x, centre y, width, height), pixels²."""
    covariance = np.empty((len(table.triangle), 4, 4))
    i, j = np.triu_indices(4)
    covariance[:, i, j] = table.triangle
    covariance[:, j, i] = table.triangle
    return covariance


def _covariance_rule(covariance: F8) -> Rule:
    """The fault of a covariance that is not finite and positive semidefinite."""
    finite: Bool = np.isfinite(np.abs(covariance).max(axis=(1, 2)))
    matrix = np.where(finite[:, None, None], covariance, 0.0)
    lowest = np.linalg.eigvalsh(matrix).min(axis=1, initial=0.0)
    negative = lowest < -1e-6 * np.abs(matrix).max(axis=(1, 2), initial=0.0)
    problem = "expected a covariance that is finite and positive semidefinite, got another matrix"
    return Rule(~finite | negative, problem, lowest)


def read_tracks(
    path: AnyPath,
    *,
    first_frame: int | None = None,
    kitti: str = "",
    conventions: Conventions = BY_EVIDENCE,
    notices: list[str] | None = None,
) -> Tracks:
    """Read the tracks in a MOTChallenge (6 to 13 columns), KITTI, CSV, Parquet, JSON, CVML or CVAT
    file, sorted by frame, then identity.

    If the file does not have them, ``confidence`` is 1, ``detection`` −1 (unknown) and
    ``confirmed`` true. Raises `InputError` if the file is missing or malformed; the message names
    the line.

    Parameters
    ----------
    path : the file.
    first_frame : the number that the file gives the first frame; None: as usual in its format.
    kitti : the type of objects to read from a KITTI file, for example Car.
    conventions : what goes before the evidence of the content.
    notices : receives sentences about guesses; None: they are logged.

    Returns
    -------
    The tracks, boxes in pixels, frames from 1.
    """
    conventions = conventions.starting_at(first_frame)
    table = table_of(Path(path), Kind.TRACKS, conventions, kitti, notices=notices)
    return _tracks_of(table, notices)


def read_tracks_named(
    path: AnyPath,
    *,
    conventions: Conventions = BY_EVIDENCE,
    notices: list[str] | None = None,
) -> tuple[Tracks, Mapping[int, str]]:
    """The tracks in a file, and the names of their classes; raises like `read_tracks`.

    Parameters
    ----------
    path : the file.
    conventions : what goes before the evidence of the content.
    notices : receives sentences about guesses; None: they are logged.

    Returns
    -------
    The tracks, boxes in pixels, and names by the number of the class.
    """
    table = table_of(Path(path), Kind.TRACKS, conventions, notices=notices)
    return _tracks_of(table, notices), table.names


def _tracks_of(table: Table, notices: list[str] | None) -> Tracks:
    """The tracks in a table, sorted by frame, then identity. Raises `InputError` for a malformed
    row.

    Rows of truth that are not scored are left out: distractors, regions, and rows of flag 0 in
    annotations of MOT16 and later. A tracker's rows count whatever their score. Of KITTI files only
    regions are left out, because a tracker's rows of hidden objects count.
    """
    ignore = table.get(Column.DISTRACTOR)
    enforce(table.origin, zero_or_one(ignore, "distractor"))
    scored = (table.get(Column.MOT_CLASS) == -1) | (table.get(Column.CONFIDENCE) != 0)
    scored &= ((ignore == 0) | table.kitti) & (table.get(Column.REGION) == 0)
    if not scored.all():
        unscored = int((~scored).sum())
        sentence = f"{unscored} of {len(scored)} rows are no objects by their flag or class"
        report(notices, table.origin.path, f"{sentence}, and are left out")
    table = table.select(scored)
    detection = table.get(Column.DETECTION)
    confirmed = table.get(Column.CONFIRMED)
    label = table.get(Column.CLASS)
    frame, identity = identified(
        table,
        whole_number(detection, "detection", low=-1),
        zero_or_one(confirmed, "confirmed"),
        whole_number(label, "class"),
    )
    tracks = Tracks(
        frame,
        identity,
        table.xyxy(),
        table.get(Column.CONFIDENCE),
        detection.astype(np.int64),
        confirmed != 0,
        label.astype(np.int64),
    )
    check_scores(tracks.confidence, table.origin.path, notices)
    check_times(frame, table.origin.path, notices)
    return tracks.select(np.lexsort((identity, frame)))


def table_of(
    path: Path,
    kind: Kind,
    conventions: Conventions = BY_EVIDENCE,
    kitti: str = "",
    left_out: MalformedRows | None = None,
    notices: list[str] | None = None,
) -> Table:
    """The rows of a file, not checked yet. Raises `InputError` if the file is missing or cannot be
    parsed.

    Parameters
    ----------
    path : the file.
    kind : the kind of rows that it is read as.
    conventions : what goes before the evidence of the content.
    kitti : the type of objects to read from a KITTI file.
    left_out : receives rows of text and JSON that cannot be parsed; None: they are errors.
    notices : receives sentences about guesses; None: they are logged.
    """
    content = load(path)
    if not content.strip():
        return replace(NO_ROWS, origin=Origin(path, "line", np.zeros(0, np.int64)))
    first = conventions.first_frame
    usual = 1 if first is None else first
    source = Source(path, content, kind, usual, left_out, conventions, notices)
    return as_stated(source, _table_of_container(source, kitti))


def _table_of_container(source: Source, kitti: str) -> Table:
    """The rows of a file by the format that its first characters announce."""
    start = first_characters(source.content)
    if start == b"PAR1":
        return table_of_parquet(source)
    if start.startswith(b"<"):
        return table_of_xml(source)
    _refuse_other(source, ("cvat", "detrac"), "XML, which begins with <")
    if start.startswith(b"{"):
        rows = rows_of_json_lines(source)
        if rows is not None:
            return _table_of_rows(source, rows, kitti)
    if start.startswith((b"[", b"{")):
        return table_of_coco(source)
    _refuse_other(source, ("coco",), "JSON, which begins with [ or {")
    return _table_of_rows(source, scan(source.path, source.content), kitti)


def _refuse_other(source: Source, formats: tuple[str, ...], expected: str) -> None:
    """Raise `InputError` if the user named a format that the file does not have."""
    if source.conventions.format in formats:
        raise InputError(
            f"expected {expected}, for the format {source.conventions.format}, got another file",
            where=source.path,
            cure="Leave out --format, or in Python format.",
        )


def first_characters(content: bytes) -> bytes:
    """The first four bytes after a byte order mark and blanks."""
    return content[:4096].removeprefix(b"\xef\xbb\xbf").lstrip()[:4]


def _table_of_rows(source: Source, text: Text, kitti: str) -> Table:
    """The rows of a text table, of KITTI or any other."""
    truth = source.kind is Kind.TRUTH
    if is_kitti(text):
        if source.conventions.first_frame is None:
            source = source._replace(first=0)
        if source.left_out is not None:
            text = text.readable({}, source.left_out)
        rows = kitti_of_type(text, kitti) if kitti or truth else kitti_of_all_types(text)
        return replace(table_of_text(source, rows), kitti=True)
    if (kitti and truth) or (source.conventions.format == "kitti" and len(text)):
        raise InputError(
            "expected a KITTI label file of 17 columns with types such as"
            f" {kitti or 'Car'}, got another table",
            where=source.path,
            cure="Omit --kitti and --format, or in Python kitti and format.",
        )
    return table_of_text(source, text)


def frames_of(table: Table) -> I8:
    """(M,) frame numbers from 1."""
    return table.get(Column.FRAME).astype(np.int64) + (1 - table.first)


def identified(table: Table, *rules: Rule) -> tuple[I8, I8]:
    """Frames and identities (M,) of the rows. Raises `InputError` for a row that breaks a rule, or
    an identity that has several boxes in a frame.
    """
    values = table.get(Column.IDENTITY)
    origin = table.origin
    cure = "An identity of −1 means that there is none: is this a file of detections?"
    enforce(origin, *box_rules(table), whole_number(values, "identity", low=0, cure=cure), *rules)
    frame = frames_of(table)
    identity = values.astype(np.int64)
    before = earlier_duplicate(identity, frame)
    if len(before):
        problem = f"identity {{}} is in frame {{}} (counted from 1) already, in {origin.unit} {{}}"
        cure = "An object has one box in a frame: remove one, or give it its own identity."
        places = np.stack([identity, frame, origin.number[before]], axis=1)
        enforce(origin, Rule(before >= 0, problem, places, cure))
    return frame, identity


def box_rules(table: Table, *, min_size: float | None = None) -> list[Rule]:
    """The faults of frame numbers, boxes and confidences. Widths and heights must be above 0, or at
    least ``min_size``.
    """
    first = table.first
    frame = table.get(Column.FRAME)
    box = table.xyxy()
    confidence = table.get(Column.CONFIDENCE)
    number = whole_number(frame, "frame number")
    cure = ""
    if first == 1:
        cure = (
            "If the file counts from 0, say --first-frame 0, add 1, or in Python read it with"
            " first_frame=0."
        )
    with np.errstate(invalid="ignore", over="ignore"):
        # Regions of frame 0 hold in all frames.
        early = (frame < first) & ~((frame == 0) & (table.get(Column.REGION) != 0))
        size = box[:, 2:] - box[:, :2]
        large_enough = size > 0 if min_size is None else size >= min_size
        flat = ~large_enough.all(axis=1)
    finite: Bool = np.isfinite(np.abs(box).max(axis=1))  # The maximum of NaN and others is NaN.
    got = "left {:.7g}, top {:.7g}, right {:.7g}, bottom {:.7g}"
    empty = "expected a width and a height above 0, got width {:.7g}, height {:.7g}"
    return [
        number,
        Rule(early & ~number.bad, f"expected frame {first} or later, got {{:.15g}}", frame, cure),
        after_last_frame(np.where(number.bad, 0.0, frame)),
        Rule(~finite, f"expected finite numbers for the box, got {got}", box, "Remove the row."),
        Rule(flat & finite, empty, size, "Correct or remove the row."),
        Rule(~np.isfinite(confidence), "expected a finite confidence, got {}", confidence),
    ]
