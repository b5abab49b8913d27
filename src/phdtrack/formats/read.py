"""Reading detections, truth and tracks: one function each, for every format.

The content decides what a file is: Parquet by its first bytes, XML by ``<``, JSON by ``[`` or ``{``; anything else is a
text table, MOTChallenge or CSV. An empty file is a file without rows. Frames are numbered from 1 in what is returned.
``first_frame`` is the number that the file gives the first frame, for tools that count otherwise than their format does:
0 in CVML, 1 elsewhere.

The truth of MOT16, MOT17 and MOT20 has a flag in column 7 and a class in column 8. Pedestrians (class 1) with flag 1 are
scored. People on vehicles (2), static persons (7), distractors (8), reflections (12), and in MOT20 other vehicles (6),
whatever their flag, are not scored, and neither is output that matches them. All others are left out. This is the
benchmark's own preprocessing as TrackEval does it, with one difference that a `Truth` cannot express: there, rows that are
left out still take part in the matching by which distractors find the output to remove.

MOT15 has no classes: a row with 0 in column 7 is left out, all others are scored.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from phdtrack.files import AnyPath, load
from phdtrack.formats.checks import Origin, Rule, enforce, repeated, whole
from phdtrack.formats.markup import table_of_coco, table_of_cvml
from phdtrack.formats.table import Column, Kind, Source, Table, table_of_parquet, table_of_text
from phdtrack.types import F8, I8, Bool, Detections, DetectionTable, Tracks, Truth

_DISTRACTORS, _MOT20_DISTRACTORS = (2, 7, 8, 12), (2, 6, 7, 8, 12)
_PEDESTRIAN, _LAST_CLASS = 1, 13


def read_detections(path: AnyPath, *, first_frame: int | None = None) -> DetectionTable:
    """The detections in a MOTChallenge ``det.txt``, CSV, Parquet, COCO JSON or CVML file, sorted by frame.

    Boxes in pixels, xyxy. Confidence is 1 and class 0 where the file has none; confidence has no bounds. Real detectors give
    boxes of width or height 0 now and then: they are left out and counted in `DetectionTable.empty`.

    Raises
    ------
    InputError : the file is missing or malformed; the message names the line.
    """
    table = _read(Path(path), Kind.DETECTIONS, first_frame)
    label, covariance = table.get(Column.CLASS), None
    rules = [*_box_rules(table, least=0.0), whole(label, "class")]
    if table.triangle.shape[1]:
        covariance = np.empty((len(label), 4, 4))
        i, j = np.triu_indices(4)
        covariance[:, i, j] = covariance[:, j, i] = table.triangle
        rules.append(_definite(covariance))
    enforce(table.origin, *rules)
    frame, box = _frames(table), table.xyxy()
    order = np.argsort(frame, kind="stable")
    order = order[np.all(box[order, 2:] > box[order, :2], axis=1)]
    found = Detections(box, table.get(Column.CONFIDENCE), label.astype(np.int64), covariance)
    return DetectionTable(frame[order], found.take(order), len(frame) - len(order))


def read_truth(path: AnyPath, *, first_frame: int | None = None) -> Truth:
    """The annotated objects in a MOTChallenge ``gt.txt``, CSV, Parquet, COCO JSON or CVML file, sorted by frame.

    Rows of confidence 0 that are no distractors are left out. In truth with classes (MOT16 and later) pedestrians are
    scored, rows of the benchmark's distractors are marked, all others left out. The distractors are the classes 2, 7, 8, 12,
    and 6 too where the path has a folder called MOT20-something.

    Raises
    ------
    InputError : the file is missing or malformed; the message names the line.
    """
    path = Path(path)
    table = _read(path, Kind.TRUTH, first_frame)
    confidence, ignore, label = (table.get(c) for c in (Column.CONFIDENCE, Column.DISTRACTOR, Column.MOT_CLASS))
    rules = [_flag(ignore, "distractor")]
    if (label != -1).any():
        cure = "Truth of 8 or 9 columns has a MOTChallenge class in column 8; with 10 columns (MOT15) it has none."
        rules.append(whole(label, "class", low=_PEDESTRIAN, high=_LAST_CLASS, cure=cure))
        mot20 = any(part.upper().startswith("MOT20") for part in path.absolute().parts)
        ignore = np.isin(label, _MOT20_DISTRACTORS if mot20 else _DISTRACTORS).astype(np.float64)
        confidence = np.where(label == _PEDESTRIAN, confidence, 0.0)
    frame, identity = _identified(table, *rules)
    order = np.argsort(frame, kind="stable")
    order = order[(confidence[order] != 0) | (ignore[order] != 0)]
    return Truth(frame[order], identity[order], table.xyxy()[order], ignore[order] != 0)


def read_tracks(path: AnyPath, *, first_frame: int | None = None) -> Tracks:
    """The tracks in a MOTChallenge (6 to 12 columns), CSV, Parquet, COCO JSON or CVML file, sorted by frame, then identity.

    Where the file does not say, ``confidence`` is 1, ``detection`` −1 (none known) and ``confirmed`` true.

    Raises
    ------
    InputError : the file is missing or malformed; the message names the line.
    """
    table = _read(Path(path), Kind.TRACKS, first_frame)
    used, confirmed = table.get(Column.DETECTION), table.get(Column.CONFIRMED)
    frame, identity = _identified(table, whole(used, "detection", low=-1), _flag(confirmed, "confirmed"))
    confidence = table.get(Column.CONFIDENCE)
    everything = Tracks(frame, identity, table.xyxy(), confidence, used.astype(np.int64), confirmed != 0)
    return everything.take(np.lexsort((identity, frame)))


def _read(path: Path, kind: Kind, first_frame: int | None) -> Table:
    """The rows of a file, not checked yet."""
    content = load(path)
    start = content[:4096].removeprefix(b"\xef\xbb\xbf").lstrip()[:4]  # without a byte order mark
    usual = 0 if start.startswith(b"<") else 1
    source = Source(path, content, kind, usual if first_frame is None else first_frame)
    if not content.strip():
        return Table(Origin(path, "line", np.zeros(0, np.int64)), 1, {}, np.zeros((0, 0)))
    if start == b"PAR1":
        return table_of_parquet(source)
    if start.startswith(b"<"):
        return table_of_cvml(source)
    return table_of_coco(source) if start.startswith((b"[", b"{")) else table_of_text(source)


def _frames(table: Table) -> I8:
    """(M,) frame numbers from 1."""
    return table.get(Column.FRAME).astype(np.int64) + (1 - table.first)


def _identified(table: Table, *rules: Rule) -> tuple[I8, I8]:
    """Frames and identities (M,) of rows that obey the rules and have one box for an identity in a frame."""
    values, origin = table.get(Column.IDENTITY), table.origin
    cure = "An identity of −1 means that there is none: is this a file of detections?"
    enforce(origin, *_box_rules(table), whole(values, "identity", low=0, cure=cure), *rules)
    frame, identity = _frames(table), values.astype(np.int64)
    before = repeated(identity, frame)
    problem = f"identity {{}} is in frame {{}} (counted from 1) already, in {origin.unit} {{}}"
    cure = "One object has one box in a frame: remove one, or give it an identity of its own."
    earlier = origin.number[before] if len(before) else before
    enforce(origin, Rule(before >= 0, problem, np.stack([identity, frame, earlier], axis=1), cure))
    return frame, identity


def _box_rules(table: Table, *, least: float | None = None) -> list[Rule]:
    """The faults of frame numbers, boxes and confidences; widths and heights are above 0, or at ``least`` so much."""
    first, frame, box, confidence = table.first, table.get(Column.FRAME), table.xyxy(), table.get(Column.CONFIDENCE)
    number = whole(frame, "frame number")
    cure = "Where the file counts from 0, add 1, or in Python read it with first_frame=0." if first == 1 else ""
    with np.errstate(invalid="ignore", over="ignore"):
        early, size = frame < first, box[:, 2:] - box[:, :2]
        flat = ~(size > 0 if least is None else size >= least).all(axis=1)
    finite: Bool = np.isfinite(np.abs(box).max(axis=1))  # a NaN is the largest
    came = "left {:.7g}, top {:.7g}, right {:.7g}, bottom {:.7g}"
    empty = "expected a width and a height above 0, came width {:.7g}, height {:.7g}"
    return [
        number,
        Rule(early & ~number.bad, f"expected frame {first} or later, came {{:.15g}}", frame, cure),
        Rule(~finite, f"expected finite numbers for the box, came {came}", box, "Remove the row."),
        Rule(flat & finite, empty, size, "Mend or remove the row."),
        Rule(~np.isfinite(confidence), "expected a finite confidence, came {}", confidence),
    ]


def _flag(values: F8, name: str) -> Rule:
    """The fault of a value that is neither 0 nor 1."""
    return Rule((values != 0) & (values != 1), f"expected 0 or 1 for {name}, came {{:.15g}}", values)


def _definite(covariance: F8) -> Rule:
    """The fault of a matrix that is no covariance."""
    finite: Bool = np.isfinite(np.abs(covariance).max(axis=(1, 2)))
    matrix = np.where(finite[:, None, None], covariance, 0.0)
    lowest = np.linalg.eigvalsh(matrix).min(axis=1, initial=0.0)
    bad = ~finite | (lowest < -1e-6 * np.abs(matrix).max(axis=(1, 2), initial=0.0))
    return Rule(bad, "expected a covariance that is finite and positive semidefinite, came another matrix", lowest)
