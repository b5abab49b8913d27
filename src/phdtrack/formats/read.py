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

from collections.abc import Collection
from pathlib import Path

import numpy as np

from phdtrack.files import AnyPath, load
from phdtrack.formats.coco import rows_of_coco
from phdtrack.formats.columns import rows_of_parquet, rows_of_text
from phdtrack.formats.cvml import rows_of_cvml
from phdtrack.formats.rows import Kind, Origin, Rows, Rule, Source, enforce, repeated, whole
from phdtrack.types import F8, I8, Bool, Detections, DetectionTable, SequenceInfo, Tracks, Truth

_DISTRACTORS, _MOT20_DISTRACTORS = (2, 7, 8, 12), (2, 6, 7, 8, 12)
_PEDESTRIAN, _LAST_CLASS = 1, 13
_BOX = "left {:.7g}, top {:.7g}, right {:.7g}, bottom {:.7g}"


def read_detections(path: AnyPath, *, first_frame: int | None = None, within: SequenceInfo | None = None) -> DetectionTable:
    """The detections in a MOTChallenge ``det.txt``, CSV, Parquet, COCO JSON or CVML file, sorted by frame.

    Boxes in pixels, xyxy. Confidence is 1 and class 0 where the file has none; confidence has no bounds. With ``within``
    a box outside of the picture is an error.

    Parameters
    ----------
    path : the file.
    first_frame : the number that it gives the first frame; None: as usual in its format.
    within : size of the picture.

    Raises
    ------
    InputError : the file is missing or malformed; the message names the line.
    """
    rows = _read(Path(path), Kind.DETECTIONS, first_frame)
    confidence, label = _filled(rows, rows.confidence, 1), _filled(rows, rows.class_id, 0)
    rules = [*_box_rules(rows), _finite(confidence, "confidence"), whole(label, "class")]
    if within is not None:
        rules.append(_outside(rows.xyxy, within))
    covariance = None if rows.covariance is None else _symmetric(rows.covariance)
    if covariance is not None:
        rules.append(_definite(covariance))
    enforce(rows.origin, *rules)
    frame = _frames(rows)
    order = np.argsort(frame, kind="stable")
    return DetectionTable(frame[order], Detections(rows.xyxy, confidence, label.astype(np.int64), covariance).take(order))


def read_truth(path: AnyPath, *, first_frame: int | None = None, distractors: Collection[int] | None = None) -> Truth:
    """The annotated objects in a MOTChallenge ``gt.txt``, CSV, Parquet, COCO JSON or CVML file, sorted by frame.

    Rows of confidence 0 that are no distractors are left out. In truth with classes (MOT16 and later) pedestrians are
    scored, rows of the classes ``distractors`` are marked, all others left out. The default is the benchmark's choice:
    2, 7, 8, 12, and 6 too where the path has a folder called MOT20-something.

    Parameters
    ----------
    path : the file.
    first_frame : the number that it gives the first frame; None: as usual in its format.
    distractors : classes that do not count; None: the benchmark's.

    Raises
    ------
    InputError : the file is missing or malformed; the message names the line.
    """
    path = Path(path)
    rows = _read(path, Kind.TRUTH, first_frame)
    confidence, ignore = _filled(rows, rows.confidence, 1), _filled(rows, rows.distractor, 0)
    rules = [_finite(confidence, "confidence"), _flag(ignore, "distractor")]
    if rows.mot_class is not None and (rows.mot_class != -1).any():
        label = rows.mot_class
        cure = "Truth of 8 or 9 columns has a MOTChallenge class in column 8; with 10 columns (MOT15) it has none."
        unknown = ~np.isin(label, np.arange(1, _LAST_CLASS + 1))
        rules.append(Rule(unknown, f"expected a class from 1 to {_LAST_CLASS}, came {{:.15g}}", label, cure))
        if distractors is None:
            mot20 = any(part.upper().startswith("MOT20") for part in path.absolute().parts)
            distractors = _MOT20_DISTRACTORS if mot20 else _DISTRACTORS
        ignore = np.isin(label, list(distractors)).astype(np.float64)
        confidence = np.where(label == _PEDESTRIAN, confidence, 0.0)
    frame, identity = _identified(rows, *rules)
    order = np.argsort(frame, kind="stable")
    order = order[(confidence[order] != 0) | (ignore[order] != 0)]
    return Truth(frame[order], identity[order], rows.xyxy[order], ignore[order] != 0)


def read_tracks(path: AnyPath, *, first_frame: int | None = None) -> Tracks:
    """The tracks in a MOTChallenge (6 to 12 columns), CSV, Parquet, COCO JSON or CVML file, sorted by frame, then identity.

    Where the file does not say, ``confidence`` is 1, ``detection`` −1 (none known) and ``confirmed`` true.

    Raises
    ------
    InputError : the file is missing or malformed; the message names the line.
    """
    rows = _read(Path(path), Kind.TRACKS, first_frame)
    confidence, used = _filled(rows, rows.confidence, 1), _filled(rows, rows.detection, -1)
    confirmed = _filled(rows, rows.confirmed, 1)
    rules = _finite(confidence, "confidence"), whole(used, "detection", lowest=-1), _flag(confirmed, "confirmed")
    frame, identity = _identified(rows, *rules)
    everything = Tracks(frame, identity, rows.xyxy, confidence, used.astype(np.int64), confirmed != 0)
    return everything.take(np.lexsort((identity, frame)))


def _read(path: Path, kind: Kind, first_frame: int | None) -> Rows:
    """The rows of a file, not checked yet."""
    content = load(path)
    start = content[:4096].removeprefix(b"\xef\xbb\xbf").lstrip()[:4]  # without a byte order mark
    usual = 0 if start.startswith(b"<") else 1
    source = Source(path, content, kind, usual if first_frame is None else first_frame)
    if not content.strip():
        return Rows(Origin(path, "line", np.zeros(0, np.int64)), np.zeros(0), np.zeros((0, 4)))
    if start == b"PAR1":
        return rows_of_parquet(source)
    if start.startswith(b"<"):
        return rows_of_cvml(source)
    return rows_of_coco(source) if start.startswith((b"[", b"{")) else rows_of_text(source)


def _filled(rows: Rows, column: F8 | None, default: float) -> F8:
    """(M,) the column, or the default where the file does not have it."""
    return np.full(len(rows.frame), float(default)) if column is None else column


def _frames(rows: Rows) -> I8:
    return rows.frame.astype(np.int64) + (1 - rows.first)


def _identified(rows: Rows, *rules: Rule) -> tuple[I8, I8]:
    """Frames and identities (M,) of rows that obey the rules and have one box for an identity in a frame."""
    values, origin = _filled(rows, rows.identity, 0), rows.origin
    cure = "An identity of −1 means that there is none: is this a file of detections?"
    enforce(origin, *_box_rules(rows), whole(values, "identity", lowest=0, cure=cure), *rules)
    frame, identity = _frames(rows), values.astype(np.int64)
    before = repeated(identity, frame)
    problem = f"identity {{}} is in frame {{}} (counted from 1) already, in {origin.unit} {{}}"
    cure = "One object has one box in a frame: remove one, or give it an identity of its own."
    earlier = origin.number[before] if len(before) else before
    enforce(origin, Rule(before >= 0, problem, np.stack([identity, frame, earlier], axis=1), cure))
    return frame, identity


def _box_rules(rows: Rows) -> list[Rule]:
    first, box = rows.first, rows.xyxy
    number = whole(rows.frame, "frame number")
    cure = "Where the file counts from 0, add 1, or in Python read it with first_frame=0." if first == 1 else ""
    with np.errstate(invalid="ignore", over="ignore"):
        early, size = rows.frame < first, box[:, 2:] - box[:, :2]
        flat = ~(box[:, 2:] > box[:, :2]).all(axis=1)
    finite: Bool = np.isfinite(np.abs(box).max(axis=1))  # a NaN is the largest
    empty = "expected a width and a height above 0, came width {:.7g}, height {:.7g}"
    return [
        number,
        Rule(early & ~number.bad, f"expected frame {first} or later, came {{:.15g}}", rows.frame, cure),
        Rule(~finite, f"expected finite numbers for the box, came {_BOX}", box, "Remove the row."),
        Rule(flat & finite, empty, size, "Mend or remove the row."),
    ]


def _finite(values: F8, name: str) -> Rule:
    return Rule(~np.isfinite(values), f"expected a finite {name}, came {{}}", values)


def _flag(values: F8, name: str) -> Rule:
    return Rule((values != 0) & (values != 1), f"expected 0 or 1 for {name}, came {{:.15g}}", values)


def _outside(box: F8, picture: SequenceInfo) -> Rule:
    """The fault of a box of which nothing is in the picture. Parts outside are usual: people walk in and out."""
    with np.errstate(invalid="ignore"):
        inside = (box[:, :2] < (picture.width, picture.height)) & (box[:, 2:] > 0)
    problem = f"expected a box in the picture of {picture.width} × {picture.height} pixels, came {_BOX}"
    cure = "Do the detections belong to this video, and are they in pixels of its full size?"
    return Rule(np.logical_not(inside.all(axis=1)), problem, box, cure)


def _symmetric(triangle: F8) -> F8:
    """(M, 4, 4) from the (M, 10) upper triangles."""
    full = np.empty((len(triangle), 4, 4))
    i, j = np.triu_indices(4)
    full[:, i, j] = full[:, j, i] = triangle
    return full


def _definite(covariance: F8) -> Rule:
    finite: Bool = np.isfinite(np.abs(covariance).max(axis=(1, 2)))
    matrix = np.where(finite[:, None, None], covariance, 0.0)
    lowest = np.linalg.eigvalsh(matrix).min(axis=1, initial=0.0)
    bad = ~finite | (lowest < -1e-6 * np.abs(matrix).max(axis=(1, 2), initial=0.0))
    return Rule(bad, "expected a covariance that is finite and positive semidefinite, came another matrix", lowest)
