"""Which detections may be false, for a person to confirm: by what a tracker with uniform models made of them.

Three reasons, each with a score from 0 to 1:

``place``     Its place fires too often. A *still* detection is one that no track holds that moves there. Such ones at one
              place and of one size (IoU ≥ ½) come from something that stays: from an object, on n frames with
              n ~ Poisson(s · fps) if it stays for s seconds, in few runs. A place that fires does so all along: the n of T
              frames in which it does are drawn at random, with n(T − n + 1)/T runs [Wald and Wolfowitz 1940], or, where it
              fires in bursts, it leaves hardly any s seconds out. The score is P(N < n), times how far one of the two holds.
``rejected``  The filter took it for clutter and no track rests on it: its posterior probability κ/(κ + C) of being clutter.
``short``     Its track was short and hardly moved, or there were too few detections for a track. At most 0.4, halved with
              each second of its life: of such detections more are true than false, so that they are only shown.

None of them is proof. A person who sits there for the whole stretch looks like a place that fires; one who is hidden half of
the time, in a crowd, is rejected. Suggestions may be made in a thread while a person labels already (`Background`), and are
kept in a file for the next time.
"""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from phdtrack.arrays import iou, to_cxcywh
from phdtrack.types import F8, I8, Bool, DetectionTable, Tracks

Reason = Literal["place", "rejected", "short"]
REASONS: tuple[Reason, ...] = get_args(Reason)
# Above this score a suggestion is taken for false until somebody says otherwise; below the other nothing is suggested.
TICKED, SHOWN = 0.9, 0.2
# Boxes are in the same place and of the same size at this overlap (IoU).
ALIKE = 0.5
# Boxes of one place scatter: what overlaps by so much with one that it is known by belongs to it.
_SAME = 0.25
# s, seconds that an object stays in one place. The speed, sizes √(wh) per second, from which a track goes somewhere.
STAY, SLOW = 4.0, 0.5
# Runs, as part of those that frames at random would make, and windows of s seconds with a detection, as part of all: from
# where on they speak for a place that fires, and where they leave no doubt. Fewer windows than these tell nothing.
_RUNS, _SPREAD, _WINDOWS = (0.5, 0.8), (0.8, 0.95), 15
# Seconds up to which a track is short, and how much is made of it.
SHORT, _MOST = 1.0, 0.4


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What a tracker with uniform models made of the detections of a stretch.

    Attributes
    ----------
    table : the stretch's detections, M rows.
    first, last : its frames.
    clutter : (M,) the posterior probability that each is a false alarm.
    tracks : the corrected ones, whose ``detection`` counts within the frame.
    """

    table: DetectionTable
    first: int
    last: int
    clutter: F8
    tracks: Tracks


@dataclass(frozen=True, slots=True, eq=False)
class Suggestions:
    """Detections that may be false, worst first.

    Attributes
    ----------
    frame, box : (n,) the frame, and the number of the detection in it, from 0.
    reason : (n,) place in `REASONS`.
    score : (n,) how likely it is false, from 0 to 1.
    place : (n,) number of the place that fires, −1 for other reasons.
    """

    frame: I8
    box: I8
    reason: I8
    score: F8
    place: I8

    def __len__(self) -> int:
        return len(self.frame)


_NONE = np.zeros(0, np.int64)
NOTHING = Suggestions(_NONE, _NONE, _NONE, np.zeros(0), _NONE)


def suggest(evidence: Evidence, frames: Sequence[int], fps: float) -> Suggestions:
    """What may be false among the detections of some frames.

    Parameters
    ----------
    evidence : of the whole stretch.
    frames : whose detections are asked about; those outside the stretch have nothing to suggest.
    fps : frames per second.

    Returns
    -------
    Worst first.
    """
    table = evidence.table
    own = _tracks_of(table, evidence.tracks)
    speed, span = _lives(table, own, fps)
    held, goes = own >= 0, speed >= SLOW
    asked = np.isin(table.frame, np.asarray(frames, np.int64))
    scores = np.zeros((len(REASONS), len(table)))
    place, scores[0] = _places(evidence, ~goes, asked & ~goes, fps)
    scores[1] = np.where(held, 0.0, evidence.clutter)
    brief = ~goes & (span < SHORT)
    scores[2] = np.where(brief, _MOST * 0.5**span * (1 - speed / SLOW), 0.0)
    reason = np.argmax(scores, axis=0)
    score = scores[reason, np.arange(len(table))]
    rows = np.flatnonzero(asked & (score >= SHOWN))
    rows = rows[np.argsort(-score[rows], kind="stable")]
    within = rows - np.searchsorted(table.frame, table.frame[rows])
    return Suggestions(table.frame[rows], within, reason[rows], score[rows], np.where(reason[rows] == 0, place[rows], -1))


def _tracks_of(table: DetectionTable, tracks: Tracks) -> I8:
    """(M,) which track, counted from 0, holds each detection; −1 for none."""
    own = np.full(len(table), -1)
    rests = tracks.detection >= 0
    _, which = np.unique(tracks.identity[rests], return_inverse=True)
    own[np.searchsorted(table.frame, tracks.frame[rests]) + tracks.detection[rests]] = which
    return own


def _lives(table: DetectionTable, own: I8, fps: float) -> tuple[F8, F8]:
    """(M,) how fast each detection's track goes there, sizes per second, and how long it lives, seconds; 0 without one.

    The speed is the way between the means over the seconds before and behind.
    """
    box = to_cxcywh(table.detections.xyxy)
    speed, span = np.zeros((2, len(table)))
    order = np.argsort(own, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(own[order])) + 1) if len(order) else []:
        if own[rows[0]] < 0:
            continue
        time = table.frame[rows] / fps
        total = np.hstack([np.zeros((2, 1)), np.cumsum(box[:2, rows], axis=1)])
        here = np.arange(len(rows))
        first, last = np.searchsorted(time, time - 1.0), np.searchsorted(time, time + 1.0, side="right")
        before = (total[:, here + 1] - total[:, first]) / (here + 1 - first)
        behind = (total[:, last] - total[:, here]) / (last - here)
        size = np.sqrt(box[2, rows] * box[3, rows]).mean()
        speed[rows] = np.hypot(*(behind - before)) / size
        span[rows] = time[-1] - time[0] + 1 / fps
    return speed, span


def _places(evidence: Evidence, still: Bool, asked: Bool, fps: float) -> tuple[I8, F8]:
    """(M,) which place each of the ``asked`` detections belongs to, −1 for none, and how surely it fires too often."""
    frame, xyxy = evidence.table.frame, evidence.table.detections.xyxy
    rows, candidates = np.flatnonzero(still), np.flatnonzero(asked)
    where, score = np.full(len(frame), -1), np.zeros(len(frame))
    stretch = evidence.first, evidence.last
    fired = [frame[rows[_alike(box, xyxy[rows])]] for box in xyxy[candidates]]
    likely = np.array([_fires(hits, stretch, fps) for hits in fired])
    seeds, numbers = np.zeros((0, 4)), list[int]()
    # The middle of a place has the most around it.
    for seed in np.lexsort((-np.array([len(hits) for hits in fired]), -likely)):
        if likely[seed] < SHOWN:
            break
        if where[candidates[seed]] < 0:
            box = xyxy[candidates[seed]]
            alike = candidates[_alike(box, xyxy[candidates])]
            alike = alike[where[alike] < 0]
            numbers.append(_number(box, seeds, numbers))
            seeds = np.vstack([seeds, box])
            where[alike], score[alike] = numbers[-1], likely[seed]
    return where, score


def _number(box: F8, seeds: F8, numbers: list[int]) -> int:
    """The number of the place that ``box`` (4,) belongs to by what it overlaps with, or a new one."""
    overlap = iou(box[None], seeds)[0]
    return numbers[int(np.argmax(overlap))] if overlap.max(initial=0.0) >= _SAME else max(numbers, default=-1) + 1


def _fires(frame: I8, stretch: tuple[int, int], fps: float) -> float:
    """How surely a place fires by itself that has still detections in these frames of a stretch from … to."""
    from scipy.special import gammaincc

    hits, length = np.unique(frame) - stretch[0], stretch[1] - stretch[0] + 1
    n, window = len(hits), STAY * fps
    if n < 2:
        return 0.0
    often = float(gammaincc(n, window))  # P(N < n)
    runs = 1 + int((np.diff(hits) > 1).sum())
    parts, windows = length / window, len(np.unique(hits // window))
    all_along = _rising(windows / math.ceil(parts), _SPREAD) if parts >= _WINDOWS else 0.0
    return often * max(_rising(runs / (n * (length - n + 1) / length), _RUNS), all_along)


def _rising(value: float, between: tuple[float, float]) -> float:
    """0 below, 1 above, and a straight line between."""
    return min(1.0, max(0.0, (value - between[0]) / (between[1] - between[0])))


def _alike(box: F8, others: F8) -> I8:
    """Which of ``others`` (n, 4) are in the place and of the size of ``box`` (4,)."""
    return np.flatnonzero(iou(box[None], others)[0] >= ALIKE)


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """How far it is: the ``share`` that is done, the suggestions when they are there, and why there will be none."""

    share: float
    suggestions: Suggestions | None = None
    problem: str = ""


class Background:
    """Does ``work`` in a thread.

    ``work`` gets a function that reports the share that is done, and raises where it fails.
    """

    def __init__(self, work: Callable[[Callable[[float], None]], Suggestions]) -> None:
        self._work, self._answer = work, Answer(0.0)
        # A daemon: the page can be closed before there are suggestions.
        threading.Thread(target=self._run, name="suggestions", daemon=True).start()

    def __call__(self) -> Answer:
        """What is known by now."""
        return self._answer

    def _run(self) -> None:
        try:
            self._answer = Answer(1.0, self._work(self._advance))
        except Exception as error:
            self._answer = Answer(1.0, problem=str(error) or type(error).__name__)

    def _advance(self, share: float) -> None:
        self._answer = Answer(share)


def kept(path: Path, key: str, make: Callable[[], Suggestions]) -> Suggestions:
    """Suggestions from a file, or made and kept there.

    Parameters
    ----------
    path : of the file.
    key : those in the file count if they were made for the same.
    make : makes them otherwise.

    Returns
    -------
    The suggestions.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        if document.pop("key") == key:
            score = np.array(document.pop("score"), np.float64)
            return Suggestions(score=score, **{name: np.array(column, np.int64) for name, column in document.items()})
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        pass  # There is none yet, or another program's: made anew.
    found = make()
    document = {"key": key} | {name: column.tolist() for name, column in asdict(found).items()}
    part = path.with_name(path.name + ".part")
    part.write_text(json.dumps(document) + "\n", encoding="utf-8")
    part.replace(path)
    return found
