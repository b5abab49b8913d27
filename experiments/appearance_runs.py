"""The 46 cases of real sequences tracked with embeddings of many kinds, for
`experiments.appearance`.

Those of the three `QUALITIES` are made from the truth. The `HARMFUL` ones say nothing of who is
who, or the wrong thing.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiments.appearance_inputs import F4, QUALITIES, made
from experiments.cameras import keep
from experiments.common import need_data, without_warnings
from experiments.degraded_inputs import CameraCase, Input, read_case
from phdtrack import Tracker, Tracks
from phdtrack.arrays import area, intersection, iou
from phdtrack.types import F8, I8, Detections

NONE = "none"
# What each of these embeddings is, by its name in runs.
HARMFUL = {
    "constant": "all boxes look the same",
    "random": "each box has a direction drawn anew",
    "swapped": "two objects whose boxes begin to overlap exchange their looks for 2 s",
    "occluder": "a box that overlaps one before it has the look of that one",
    "half-hidden": "the same for boxes of which a quarter or more is covered",
}
# Seconds for which two objects exchange their looks.
SWAPPED = 2.0
# The part of a box that is covered, above which it has another's look.
COVERED = {"occluder": 0.0, "half-hidden": 0.25}
# Those that all others are made of.
USUAL = "middle"
SIZE = 64


@dataclass(frozen=True, slots=True)
class LookRun:
    """A case with one kind of embeddings, drawn with a seed, and the folder of the rows."""

    case: CameraCase
    kind: str
    seed: int
    place: Path

    @property
    def name(self) -> str:
        """The folder of the rows of all cases."""
        return f"{self.kind}-{self.seed}"


def track(run: LookRun) -> None:
    """Track one case with the default; its rows go to PLACE/KIND-SEED/{online,corrected}."""
    case = run.case
    given = read_case(case)
    online, corrected = followed(given, looks(run, given))
    for output, tracks in (("online", online), ("corrected", corrected)):
        keep(tracks, run.place / run.name, output, case.sequence, case.detector)


def followed(
    given: Input, embeddings: F4 | None, **settings: dict[str, float]
) -> tuple[Tracks, Tracks]:
    """Online and corrected rows of a sequence with ``embeddings`` (M, D) of its detections."""
    tracker = Tracker(given.size, fps=given.fps, **settings)
    rows = []
    with without_warnings():
        for number in range(1, given.frames + 1):
            here = given.frame == number
            looks_here = None if embeddings is None else embeddings[here]
            found = Detections.of(given.xyxy[here], given.score[here], None, looks_here)
            rows.append(tracker.update(found, frame=number))
        online = Tracks.concatenate([*rows, tracker.flush()])
    return online, tracker.tracks()


def looks(run: LookRun, given: Input) -> F4 | None:
    """(M, D) the embeddings of a run's detections; None without any."""
    count = len(given.frame)
    if run.kind == NONE:
        return None
    if run.kind == "constant":
        return np.ones((count, SIZE), np.float32)
    if run.kind == "random":
        rng = np.random.default_rng([run.seed, zlib.crc32(run.case.name.encode())])
        return rng.normal(size=(count, SIZE)).astype(np.float32)
    quality = run.kind if run.kind in QUALITIES else USUAL
    right = made(run.case, need_data().parent / "bench", quality, run.seed, given.fps)
    if run.kind in QUALITIES:
        return right
    if run.kind == "swapped":
        return right[exchanged(given, owners(given))]
    return right[before(given, COVERED[run.kind])]


def owners(given: Input) -> I8:
    """(M,) the identity of the object that each detection is on, by an IoU of 0.5; −1 for none."""
    found = np.full(len(given.frame), -1, np.int64)
    for truth, here in _frames(given):
        if not len(truth) or not len(here):
            continue
        overlap = iou(given.xyxy[here], _boxes(truth))
        best = overlap.argmax(axis=1)
        on = overlap.max(axis=1) >= 0.5
        found[here[on]] = truth[best[on], 1].astype(np.int64)
    return found


def exchanged(given: Input, owner: I8) -> I8:
    """(M,) the detection whose look each one has, if two objects whose boxes begin to overlap
    exchange their looks for `SWAPPED` seconds.

    It is that of the other object in the same frame, or else the last one before. An object
    exchanges its look with one other at a time. ``owner``: as from `owners`.
    """
    source = np.arange(len(owner))
    length = max(round(SWAPPED * given.fps), 1)
    partner: dict[int, tuple[int, int]] = {}
    latest: dict[int, int] = {}
    together: set[tuple[int, int]] = set()
    for number, (truth, here) in enumerate(_frames(given), start=1):
        partner = {one: (other, end) for one, (other, end) in partner.items() if number < end}
        now = _overlapping(truth)
        for one, other in sorted(now - together):
            if one not in partner and other not in partner:
                partner[one] = (other, number + length)
                partner[other] = (one, number + length)
        together = now
        latest |= {int(owner[row]): row for row in here.tolist() if owner[row] >= 0}
        for row in here.tolist():
            other, _ = partner.get(int(owner[row]), (-1, 0))
            source[row] = latest.get(other, row)
    return source


def before(given: Input, covered: float) -> I8:
    """(M,) the detection whose look each one has: of those of the frame that are before it, the one
    that covers most of it, if that is more than the part ``covered``. The lower edge of what is
    before is lower.
    """
    source = np.arange(len(given.frame))
    for _, here in _frames(given):
        boxes = given.xyxy[here]
        if len(here) < 2:
            continue
        part = intersection(boxes, boxes) / area(boxes)[:, None]
        part *= boxes[:, None, 3] < boxes[None, :, 3]
        other = part.argmax(axis=1)
        hidden = part.max(axis=1) > covered
        source[here[hidden]] = here[other[hidden]]
    return source


def _frames(given: Input) -> Sequence[tuple[F8, I8]]:
    """Rows of the truth, and numbers of the detections, frame by frame."""
    truth = given.truth[given.truth[:, 1] >= 0]
    return [
        (truth[truth[:, 0] == number], np.flatnonzero(given.frame == number))
        for number in range(1, given.frames + 1)
    ]


def _overlapping(truth: F8) -> set[tuple[int, int]]:
    """Pairs of objects whose boxes overlap, the lower identity first."""
    boxes = _boxes(truth)
    identity = truth[:, 1].astype(int).tolist()
    first, second = np.nonzero(np.triu(intersection(boxes, boxes) > 0, 1))
    pairs = zip(first.tolist(), second.tolist(), strict=True)
    return {(min(identity[i], identity[k]), max(identity[i], identity[k])) for i, k in pairs}


def _boxes(truth: F8) -> F8:
    return np.column_stack([truth[:, 2:4], truth[:, 2:4] + truth[:, 4:6]])
