"""Rows of boxes as a file gives them, and what becomes of them: checked once, the same way for every format.

A reader of a format fills `Rows` with numbers and nothing else. `detections`, `truth` and `tracks` check them and build the
records. The first bad row is reported, by its place in the file, with the number of further rows that have the same fault.

The truth of MOT16, MOT17 and MOT20 has a flag in column 7 and a class in column 8. Pedestrians (class 1) with flag 1 are
scored. People on vehicles (2), static persons (7), distractors (8), reflections (12), and in MOT20 other vehicles (6),
whatever their flag, are not scored, and neither is output that matches them. All others are left out. This is the
benchmark's own preprocessing as TrackEval does it, with one difference that a `Truth` cannot express: there, rows that are
left out still take part in the matching by which distractors find the output to remove.

MOT15 has no classes: a row with 0 in column 7 is left out, all others are scored.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from phdtrack.errors import InputError
from phdtrack.formats.text import Origin
from phdtrack.types import F8, I8, Bool, Detections, DetectionTable, SequenceInfo, Tracks, Truth

_LARGEST = 2.0**53  # beyond it a float no longer tells neighbouring integers apart


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """M boxes, unchecked. Columns that the file does not have are None.

    Attributes
    ----------
    origin : where each row stands in its file.
    frame : (M,) as the file numbers them, the first one being ``first``.
    xyxy : (M, 4) pixels.
    identity, confidence, class_id, detection : (M,).
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
    distractor: F8 | None = None
    detection: F8 | None = None
    confirmed: F8 | None = None
    covariance: F8 | None = None

    def __len__(self) -> int:
        return len(self.frame)


@dataclass(frozen=True, slots=True, eq=False)
class Rule:
    """A fault: ``bad`` (M,) marks the rows that have it, ``problem`` tells it of one row, ``cure`` says what to do."""

    bad: Bool
    problem: Callable[[int], str]
    cure: str = ""


def enforce(origin: Origin, rules: list[Rule]) -> None:
    """Raise for the first row that breaks a rule.

    Raises
    ------
    InputError : a row breaks a rule.
    """
    broken = [(int(np.argmax(rule.bad)), rule) for rule in rules if rule.bad.any()]
    if not broken:
        return
    row, rule = min(broken, key=lambda pair: pair[0])
    others = int(np.count_nonzero(rule.bad)) - 1
    more = f" ({others} more like it)" if others else ""
    raise InputError(rule.problem(row) + more, where=origin.at(row), cure=rule.cure)


def detections(rows: Rows, within: SequenceInfo | None = None) -> DetectionTable:
    """The rows as detections, sorted by frame, in the file's order within it; ``within`` tells the size of the picture.

    Raises
    ------
    InputError : a row has no valid frame, box, confidence, class or covariance, or its box lies outside of the picture.
    """
    confidence = np.ones(len(rows)) if rows.confidence is None else rows.confidence
    label = np.zeros(len(rows)) if rows.class_id is None else rows.class_id
    rules = [*_box_rules(rows), _finite(confidence, "confidence"), whole(label, "class")]
    if within is not None:
        rules.append(_outside(rows.xyxy, within))
    cov = None if rows.covariance is None else _symmetric(rows.covariance)
    if cov is not None:
        rules.append(_definite(cov))
    enforce(rows.origin, rules)
    frame = _frames(rows)
    order = np.argsort(frame, kind="stable")
    table = Detections(rows.xyxy, confidence, label.astype(np.int64), cov)
    return DetectionTable(frame[order], table.take(order))


def truth(rows: Rows) -> Truth:
    """The rows as truth, sorted by frame. A row of confidence 0 is left out unless it is marked as a distractor.

    Raises
    ------
    InputError : a row has no valid frame, identity or box, or an identity occurs twice in a frame.
    """
    none = np.zeros(len(rows))
    identity = none if rows.identity is None else rows.identity
    confidence = none + 1 if rows.confidence is None else rows.confidence
    ignore = none if rows.distractor is None else rows.distractor
    rules = [*_box_rules(rows), _identities(identity), _finite(confidence, "confidence"), _flag(ignore, "distractor")]
    enforce(rows.origin, rules)
    frame, who = _frames(rows), identity.astype(np.int64)
    enforce(rows.origin, [_twice(rows.origin, frame, who)])
    order = np.argsort(frame, kind="stable")
    order = order[(confidence[order] != 0) | (ignore[order] != 0)]
    return Truth(frame[order], who[order], rows.xyxy[order], ignore[order] != 0)


def tracks(rows: Rows) -> Tracks:
    """The rows as tracks, sorted by frame, then identity.

    Where the file does not tell, confidence is 1, every row is confirmed, and ``detection`` is −1: none is known.

    Raises
    ------
    InputError : a row has no valid frame, identity, box or flag, or an identity occurs twice in a frame.
    """
    ones = np.ones(len(rows))
    identity = np.zeros(len(rows)) if rows.identity is None else rows.identity
    confidence = ones if rows.confidence is None else rows.confidence
    used = -ones if rows.detection is None else rows.detection
    confirmed = ones if rows.confirmed is None else rows.confirmed
    rules = [*_box_rules(rows), _identities(identity), _finite(confidence, "confidence")]
    enforce(rows.origin, [*rules, whole(used, "detection", lowest=-1), _flag(confirmed, "confirmed")])
    frame, who = _frames(rows), identity.astype(np.int64)
    enforce(rows.origin, [_twice(rows.origin, frame, who)])
    everything = Tracks(frame, who, rows.xyxy, confidence, used.astype(np.int64), confirmed != 0)
    return everything.take(np.lexsort((who, frame)))


def _frames(rows: Rows) -> I8:
    return rows.frame.astype(np.int64) + (1 - rows.first)


def _box_rules(rows: Rows) -> list[Rule]:
    first, box = rows.first, rows.xyxy
    number = whole(rows.frame, "frame number")
    cure = "Where the file counts from 0, add 1, or in Python read it with first_frame=0." if first == 1 else ""
    with np.errstate(invalid="ignore"):
        early = rows.frame < first
        flat = ~((box[:, 2] > box[:, 0]) & (box[:, 3] > box[:, 1]))
    finite: Bool = np.isfinite(np.abs(box).max(axis=1))  # a NaN is the largest
    return [
        number,
        Rule(early & ~number.bad, lambda i: f"expected frame {first} or later, came {rows.frame[i]:.15g}", cure),
        Rule(~finite, lambda i: f"expected finite numbers for the box, came {_box(box[i])}", "Remove the row."),
        Rule(
            flat & finite,
            lambda i: f"expected a width and a height above 0, came {_size(box[i])}",
            "Mend or remove the row.",
        ),
    ]


def _box(box: F8) -> str:
    return ", ".join(f"{name} {value:.7g}" for name, value in zip(("left", "top", "right", "bottom"), box, strict=True))


def _size(box: F8) -> str:
    return f"width {box[2] - box[0]:.7g}, height {box[3] - box[1]:.7g}"


def _finite(values: F8, name: str) -> Rule:
    return Rule(~np.isfinite(values), lambda i: f"expected a finite {name}, came {values[i]}")


def whole(values: F8, name: str, *, lowest: float = -_LARGEST) -> Rule:
    """A value that is no whole number, below ``lowest``, or too large to be told from its neighbours.

    Parameters
    ----------
    values : (M,).
    name : what messages call them.
    lowest : the least that is allowed.
    """
    with np.errstate(invalid="ignore"):
        good = (np.abs(values) <= _LARGEST) & (np.floor(values) == values) & (values >= lowest)
    least = "" if lowest == -_LARGEST else f" of {lowest:.0f} or more"
    return Rule(~good, lambda i: f"expected a whole number{least} for the {name}, came {values[i]:.15g}")


def _identities(values: F8) -> Rule:
    rule = whole(values, "identity", lowest=0)
    return Rule(rule.bad, rule.problem, "An identity of −1 means that there is none: is this a file of detections?")


def _flag(values: F8, name: str) -> Rule:
    return Rule((values != 0) & (values != 1), lambda i: f"expected 0 or 1 for {name}, came {values[i]:.15g}")


def _twice(origin: Origin, frame: I8, identity: I8) -> Rule:
    """An identity in one frame again: the later row is at fault, the earlier one is named."""
    order = np.lexsort((identity, frame))
    same = (np.diff(frame[order]) == 0) & (np.diff(identity[order]) == 0)
    before = np.full(len(frame), -1)
    before[order[1:][same]] = order[:-1][same]

    def problem(i: int) -> str:
        place = f"{origin.unit} {origin.number[before[i]]}"
        return f"identity {identity[i]} is in frame {frame[i]} (counted from 1) already, in {place}"

    return Rule(before >= 0, problem, "One object has one box in a frame: remove one, or give it an identity of its own.")


def _outside(box: F8, picture: SequenceInfo) -> Rule:
    """A box of which nothing is in the picture. Parts outside are usual: people walk in and out."""
    width, height = picture.width, picture.height
    with np.errstate(invalid="ignore"):
        bad = (box[:, 0] >= width) | (box[:, 1] >= height) | (box[:, 2] <= 0) | (box[:, 3] <= 0)
    cure = "Do the detections belong to this video, and are they in pixels of its full size?"
    return Rule(bad, lambda i: f"expected a box in the picture of {width} × {height} pixels, came {_box(box[i])}", cure)


def _symmetric(triangle: F8) -> F8:
    """(M, 4, 4) from the (M, 10) upper triangles."""
    full = np.empty((len(triangle), 4, 4))
    i, j = np.triu_indices(4)
    full[:, i, j] = triangle
    full[:, j, i] = triangle
    return full


def _definite(covariance: F8) -> Rule:
    finite: Bool = np.isfinite(np.abs(covariance).max(axis=(1, 2)))  # a NaN is the largest
    matrix = np.where(finite[:, None, None], covariance, 0.0)
    lowest = np.linalg.eigvalsh(matrix).min(axis=1, initial=0.0)
    largest = np.abs(matrix).max(axis=(1, 2), initial=0.0)
    bad = ~finite | (lowest < -1e-6 * largest)
    return Rule(bad, lambda i: "expected a covariance that is finite and positive semidefinite, came another matrix")


MOT16_DISTRACTORS = (2, 7, 8, 12)
MOT20_DISTRACTORS = (2, 6, 7, 8, 12)
_PEDESTRIAN, _LAST_CLASS = 1, 13


def usual_distractors(path: Path) -> tuple[int, ...]:
    """The distractor classes of the benchmark that the path names: those of MOT20 where a folder is called after it."""
    mot20 = any(part.upper().startswith("MOT20") for part in path.absolute().parts)
    return MOT20_DISTRACTORS if mot20 else MOT16_DISTRACTORS


def judge(rows: Rows, distractors: Collection[int]) -> Rows:
    """The rows with their classes turned into confidence (0 where a row is left out) and distractor marks.

    Rows without classes, which includes those where every class is −1, come back as they are.

    Raises
    ------
    InputError : a class is none of the benchmark's 1–13.
    """
    label, flag = rows.class_id, rows.confidence
    if label is None or flag is None or (label == -1).all():
        return replace(rows, class_id=None)
    known = np.isin(label, np.arange(1, _LAST_CLASS + 1))
    cure = "Truth of 8 or 9 columns has a MOTChallenge class in column 8; with 10 columns (MOT15) it has none."
    enforce(rows.origin, [Rule(~known, lambda i: f"expected a class from 1 to {_LAST_CLASS}, came {label[i]:.15g}", cure)])
    ignore = np.isin(label, list(distractors))
    scored = (label == _PEDESTRIAN) & (flag != 0) & ~ignore
    return replace(rows, confidence=scored.astype(float), distractor=ignore.astype(float), class_id=None)
