"""Reading detections, truth and tracks: one function each, for every format.

The content decides what a file is: Parquet by its first bytes, XML by ``<``, JSON by ``[`` or
``{``, JSON lines where its first line is an object with a frame; anything else is a text table,
MOTChallenge, KITTI or CSV. An empty file is a file without rows. Frames are numbered from 1 in what
is returned. ``first_frame`` is the number that the file gives the first frame, for tools that count
otherwise than their format does: 0 in CVML, CVAT and KITTI, 1 elsewhere. Truth is read in
`truth.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from phdtrack.errors import InputError
from phdtrack.files import AnyPath, load
from phdtrack.formats.checks import Origin, Rule, WrongRows, enforce, far, flag, repeated, whole
from phdtrack.formats.kitti import is_kitti, rows_of_kitti
from phdtrack.formats.markup import rows_of_json, table_of_coco, table_of_xml
from phdtrack.formats.table import Column, Kind, Source, Table, table_of_parquet, table_of_text
from phdtrack.formats.text import scan
from phdtrack.types import I8, Bool, Detections, DetectionTable, Tracks

NO_ROWS = Table(Origin(Path(), "line", np.zeros(0, np.int64)), 1, {}, np.zeros((0, 0)))


def read_detections(
    path: AnyPath, *, first_frame: int | None = None, left_out: WrongRows | None = None
) -> DetectionTable:
    """The detections in a MOTChallenge ``det.txt``, CSV, Parquet, JSON, CVML or CVAT file, sorted
    by frame.

    Boxes in pixels, xyxy. Confidence is 1 and class 0 where the file has none; confidence has no
    bounds. Classes that are words get numbers, see `DetectionTable.names`; KITTI's label files have
    all types but regions. Real detectors give boxes of width or height 0 now and then: they are
    left out and counted in `DetectionTable.empty`. Raises `InputError` where the file is missing or
    malformed, or no row is right; the message names the line.

    Parameters
    ----------
    path : the file.
    first_frame : the number that the file gives the first frame; None: what is usual in its format.
    left_out : counts rows that are wrong, and these are left out; None: the first of them is an
        error.
    """
    return detections_of(
        table_of(Path(path), Kind.DETECTIONS, first_frame, left_out=left_out), left_out
    )


def detections_of(table: Table, left_out: WrongRows | None = None) -> DetectionTable:
    """The detections in a table, sorted by frame; `InputError` names the first row that is none, if
    none is left out.
    """
    label = table.get(Column.CLASS)
    covariance = None
    rules = [*box_rules(table, least=0.0), whole(label, "class")]
    if table.triangle.shape[1]:
        covariance = np.empty((len(label), 4, 4))
        i, j = np.triu_indices(4)
        covariance[:, i, j] = covariance[:, j, i] = table.triangle
        finite: Bool = np.isfinite(np.abs(covariance).max(axis=(1, 2)))
        matrix = np.where(finite[:, None, None], covariance, 0.0)
        lowest = np.linalg.eigvalsh(matrix).min(axis=1, initial=0.0)
        wrong = ~finite | (lowest < -1e-6 * np.abs(matrix).max(axis=(1, 2), initial=0.0))
        problem = (
            "expected a covariance that is finite and positive semidefinite, came another matrix"
        )
        rules.append(Rule(wrong, problem, lowest))
    try:
        enforce(table.origin, *rules)
    except InputError as error:
        if left_out is None:
            raise
        bad = np.any([rule.bad for rule in rules], axis=0)
        left_out.take(error, *table.origin.number[bad].tolist())
        table = table.select(~bad)
        label = label[~bad]
        if covariance is None:
            covariance = None
        else:
            covariance = covariance[~bad]
    if left_out is not None and left_out.first is not None and not len(label):
        raise left_out.first
    frame = frames_of(table)
    box = table.xyxy()
    order = np.argsort(frame, kind="stable")
    order = order[np.all(box[order, 2:] > box[order, :2], axis=1)]
    found = Detections(box, table.get(Column.CONFIDENCE), label.astype(np.int64), covariance)
    return DetectionTable(frame[order], found.select(order), len(frame) - len(order), table.names)


def read_tracks(path: AnyPath, *, first_frame: int | None = None, kitti: str = "") -> Tracks:
    """The tracks in a MOTChallenge (6 to 12 columns), KITTI, CSV, Parquet, JSON, CVML or CVAT file,
    by frame, then identity.

    Where the file does not say, ``confidence`` is 1, ``detection`` −1 (none known) and
    ``confirmed`` true. Raises `InputError` where the file is missing or malformed; the message
    names the line.

    Parameters
    ----------
    path : the file.
    first_frame : the number that the file gives the first frame; None: what is usual in its format.
    kitti : the type that is read of a KITTI file, as Car.
    """
    return _tracks_of(table_of(Path(path), Kind.TRACKS, first_frame, kitti))


def read_tracks_named(path: AnyPath) -> tuple[Tracks, Mapping[int, str]]:
    """The tracks in a file, and what it calls their classes; `InputError` as `read_tracks`."""
    table = table_of(Path(path), Kind.TRACKS, None)
    return _tracks_of(table), table.names


def _tracks_of(table: Table) -> Tracks:
    """The tracks in a table, by frame, then identity; `InputError` where a row cannot be one.

    Of truth, what is not to be counted is left out: distractors, regions, and rows of confidence 0
    in 8 or 9 columns. Of KITTI files only regions are: a tracker's rows of hidden objects count.
    """
    ignore = table.get(Column.DISTRACTOR)
    confidence = table.get(Column.CONFIDENCE)
    enforce(table.origin, flag(ignore, "distractor"))
    scored = (table.get(Column.MOT_CLASS) == -1) | (confidence != 0)
    table = table.select(scored & ((ignore == 0) | table.kitti) & (table.get(Column.REGION) == 0))
    used, confirmed, label = (
        table.get(column) for column in (Column.DETECTION, Column.CONFIRMED, Column.CLASS)
    )
    rules = whole(used, "detection", low=-1), flag(confirmed, "confirmed"), whole(label, "class")
    frame, identity = identified(table, *rules)
    box = table.xyxy()
    score = table.get(Column.CONFIDENCE)
    found = Tracks(
        frame, identity, box, score, used.astype(np.int64), confirmed != 0, label.astype(np.int64)
    )
    return found.select(np.lexsort((identity, frame)))


def table_of(
    path: Path,
    kind: Kind,
    first_frame: int | None,
    kitti: str = "",
    left_out: WrongRows | None = None,
) -> Table:
    """The rows of a file, not checked yet. Raises `InputError` where the file is missing, or cannot
    be understood.

    Parameters
    ----------
    path : the file.
    kind : what it is read as.
    first_frame : the number that it gives the first frame; None: what is usual in its format.
    kitti : the type of objects of which a KITTI file is read.
    left_out : takes rows that cannot be read, in text and JSON; None: they are errors.
    """
    content = load(path)
    start = content[:4096].removeprefix(b"\xef\xbb\xbf").lstrip()[:4]  # without a byte order mark
    usual = 0 if start.startswith(b"<") else 1
    source = Source(path, content, kind, usual if first_frame is None else first_frame, left_out)
    if not content.strip():
        return replace(NO_ROWS, origin=Origin(path, "line", np.zeros(0, np.int64)))
    if start == b"PAR1":
        return table_of_parquet(source)
    if start.startswith(b"<"):
        return table_of_xml(source)
    if start.startswith(b"{"):
        lines = rows_of_json(source)
    else:
        lines = None
    if lines is None and start.startswith((b"[", b"{")):
        return table_of_coco(source)
    if lines is None:
        text = scan(path, content)
    else:
        text = lines
    if is_kitti(text):
        source = source._replace(first=0 if first_frame is None else first_frame)
        if left_out is None:
            text = text
        else:
            text = text.readable({}, left_out)
        rows = rows_of_kitti(text, kitti if kitti or kind is Kind.TRUTH else None)
        return replace(table_of_text(source, rows), kitti=True)
    if kitti and kind is Kind.TRUTH:
        problem = (
            f"expected a KITTI label file of 17 columns with types as {kitti}, came another table"
        )
        raise InputError(problem, where=path, cure="Leave out --kitti, or in Python kitti.")
    return table_of_text(source, text)


def frames_of(table: Table) -> I8:
    """(M,) frame numbers from 1."""
    return table.get(Column.FRAME).astype(np.int64) + (1 - table.first)


def identified(table: Table, *rules: Rule) -> tuple[I8, I8]:
    """Frames and identities (M,) of rows that obey the rules and have one box for an identity in a
    frame.
    """
    values = table.get(Column.IDENTITY)
    origin = table.origin
    cure = "An identity of −1 means that there is none: is this a file of detections?"
    enforce(origin, *box_rules(table), whole(values, "identity", low=0, cure=cure), *rules)
    frame = frames_of(table)
    identity = values.astype(np.int64)
    before = repeated(identity, frame)
    problem = f"identity {{}} is in frame {{}} (counted from 1) already, in {origin.unit} {{}}"
    cure = "One object has one box in a frame: remove one, or give it an identity of its own."
    if len(before):
        earlier = origin.number[before]
    else:
        earlier = before
    enforce(origin, Rule(before >= 0, problem, np.stack([identity, frame, earlier], axis=1), cure))
    return frame, identity


def box_rules(table: Table, *, least: float | None = None) -> list[Rule]:
    """The faults of frame numbers, boxes and confidences; widths and heights are above 0, or at
    ``least`` so much.
    """
    first = table.first
    frame = table.get(Column.FRAME)
    box = table.xyxy()
    confidence = table.get(Column.CONFIDENCE)
    number = whole(frame, "frame number")
    if first == 1:
        cure = "Where the file counts from 0, add 1, or in Python read it with first_frame=0."
    else:
        cure = ""
    with np.errstate(invalid="ignore", over="ignore"):
        early = frame < first
        size = box[:, 2:] - box[:, :2]
        flat = ~(size > 0 if least is None else size >= least).all(axis=1)
    finite: Bool = np.isfinite(np.abs(box).max(axis=1))  # a NaN is the largest
    came = "left {:.7g}, top {:.7g}, right {:.7g}, bottom {:.7g}"
    empty = "expected a width and a height above 0, came width {:.7g}, height {:.7g}"
    return [
        number,
        Rule(early & ~number.bad, f"expected frame {first} or later, came {{:.15g}}", frame, cure),
        far(np.where(number.bad, 0.0, frame)),
        Rule(~finite, f"expected finite numbers for the box, came {came}", box, "Remove the row."),
        Rule(flat & finite, empty, size, "Mend or remove the row."),
        Rule(~np.isfinite(confidence), "expected a finite confidence, came {}", confidence),
    ]
