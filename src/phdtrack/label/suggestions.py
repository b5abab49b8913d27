"""Which detections may be false, for a person to confirm: by what a tracker with uniform models
made of them.

Three reasons, each with a score from 0 to 1:

``place``     Its place fires too often. A *still* detection is one that no track holds that moves
there. Such ones at one
              place and of one size (IoU ≥ ½) come from something that stays: from an object, on n
              frames with n ~ Poisson(s · fps) if it stays for s seconds, in few runs. A place that
              fires does so all along: the n of T frames in which it does are drawn at random, with
              n(T − n + 1)/T runs [Wald and Wolfowitz 1940], or, where it fires in bursts, it leaves
              hardly any s seconds out. The score is P(N < n), times how far one of the two holds.
``rejected``  The filter took it for clutter and no track rests on it: its posterior probability
κ/(κ + C) of being clutter. ``short``     Its track was short and hardly moved, or there were too
few detections for a track. At most 0.4, halved with
              each second of its life: of such detections more are true than false, so that they are
              only shown.

None of them is proof: a person who sits there for the whole stretch looks like a place that fires;
one who is hidden half of the time, in a crowd, is rejected.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np

from phdtrack import pipeline
from phdtrack.arrays import iou, to_cxcywh
from phdtrack.detect.table_detector import frames_walked
from phdtrack.protocols import AnyStages
from phdtrack.types import F8, I8, Bool, DetectionTable, Tracks

Reason = Literal["place", "rejected", "short"]
REASONS: tuple[Reason, ...] = get_args(Reason)
# Above this score a suggestion is taken for false unless a person says otherwise; below the other
# nothing is suggested.
TICKED = 0.9
SHOWN = 0.2
# Boxes are in the same place and of the same size at this overlap (IoU).
ALIKE = 0.5
# Boxes of one place scatter: what overlaps by so much with one that it is known by belongs to it.
_SAME = 0.25
# s, seconds that an object stays in one place. The speed, sizes √(wh) per second, from which a
# track goes somewhere.
STAY = 4.0
SLOW = 0.5
# Runs, as part of those that frames at random would make, and windows of s seconds with a
# detection, as part of all: from where on they speak for a place that fires, and where they leave
# no doubt. Fewer windows than these tell nothing.
_RUNS = (0.5, 0.8)
_SPREAD = (0.8, 0.95)
_WINDOWS = 15
# Seconds up to which a track is short, and its score at most.
SHORT = 1.0
_MAX_SHORT = 0.4


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What a tracker with uniform models made of the detections of a stretch.

    Attributes
    ----------
    table, fps, frames : the stretch's detections, M rows, frames per second, and its frames.
    clutter : (M,) the posterior probability that each is a false alarm.
    tracks : the corrected ones, whose ``detection`` counts within the frame.
    """

    table: DetectionTable
    fps: float
    frames: range
    clutter: F8
    tracks: Tracks

    @classmethod
    def of(
        cls,
        table: DetectionTable,
        fps: float,
        frames: range,
        stages: AnyStages,
        seed: int = 0,
        advance: Callable[[int], object] = id,
    ) -> Evidence:
        """What a tracker makes of the detections of some frames.

        A filter that says nothing of false alarms (`filters.none`) leaves all probabilities at 0.

        Parameters
        ----------
        table, fps : of the whole sequence.
        frames : the stretch.
        stages, seed : how to track.
        advance : is called with the number of frames done.
        """
        rows = np.arange(*np.searchsorted(table.frame, [frames.start, frames.stop]))
        rng = np.random.default_rng(seed)
        clutter = []
        walked = (
            number
            for number in frames_walked(table, frames.stop - 1, fps)
            if number >= frames.start
        )
        given = ((number, (number - 1) / fps, table.at(number)) for number in walked)
        for after, step in pipeline.run(stages, given, rng):
            state = after
            found = step.info.clutter_probability
            clutter.append(found if len(found) else np.zeros(len(step.detections)))
            advance(len(clutter))
        stretch = DetectionTable(table.frame[rows], table.detections.select(rows))
        return cls(stretch, fps, frames, np.concatenate(clutter), pipeline.finish(stages, state))


class Suggestion(NamedTuple):
    """A detection that may be false.

    Attributes
    ----------
    frame, box : the frame, and the number of the detection in it, from 0.
    reason, score : why, and how likely, from 0 to 1, it is false.
    place : number of the place that fires, −1 for other reasons.
    """

    frame: int
    box: int
    reason: Reason
    score: float
    place: int


def suggest(evidence: Evidence, frames: Sequence[int]) -> list[Suggestion]:
    """What may be false among the detections of some frames, worst first; outside the stretch there
    is nothing.
    """
    table = evidence.table
    fps = evidence.fps
    own = _tracks_of(table, evidence.tracks)
    speed, span = _lives(table, own, fps)
    asked = np.isin(table.frame, np.asarray(frames, np.int64))
    goes = speed >= SLOW
    place, fires = _places(evidence, ~goes, asked & ~goes)
    rejected = np.where(own >= 0, 0.0, evidence.clutter)
    short = np.where(~goes & (span < SHORT), _MAX_SHORT * 0.5**span * (1 - speed / SLOW), 0.0)
    scores = np.stack([fires, rejected, short])
    reason = scores.argmax(axis=0)
    score = scores.max(axis=0)
    rows = np.flatnonzero(asked & (score >= SHOWN))
    rows = rows[np.argsort(-score[rows], kind="stable")]
    within = rows - np.searchsorted(table.frame, table.frame[rows])
    place = np.where(reason == 0, place, -1)
    columns = (
        each.tolist()
        for each in (table.frame[rows], within, reason[rows], score[rows], place[rows])
    )
    return [
        Suggestion(n, box, REASONS[why], sure, at)
        for n, box, why, sure, at in zip(*columns, strict=True)
    ]


def _tracks_of(table: DetectionTable, tracks: Tracks) -> I8:
    """(M,) which track, counted from 0, holds each detection; −1 for none."""
    own = np.full(len(table), -1)
    rests = tracks.detection >= 0
    _, which = np.unique(tracks.identity[rests], return_inverse=True)
    own[np.searchsorted(table.frame, tracks.frame[rests]) + tracks.detection[rests]] = which
    return own


def _lives(table: DetectionTable, own: I8, fps: float) -> tuple[F8, F8]:
    """(M,) how fast each detection's track goes there, sizes per second, and how long it lives,
    seconds; 0 without one.

    The speed is the way between the means over the seconds before and behind.
    """
    box = to_cxcywh(table.detections.xyxy)
    speed, span = np.zeros((2, len(table)))
    order = np.argsort(own, kind="stable")
    for rows in np.split(order, np.searchsorted(own[order], np.arange(own.max(initial=-1) + 1)))[
        1:
    ]:
        time = table.frame[rows] / fps
        here = np.arange(len(rows))
        total = np.hstack([np.zeros((2, 1)), np.cumsum(box[:2, rows], axis=1)])
        first = np.searchsorted(time, time - 1.0)
        last = np.searchsorted(time, time + 1.0, side="right")
        before = (total[:, here + 1] - total[:, first]) / (here + 1 - first)
        behind = (total[:, last] - total[:, here]) / (last - here)
        speed[rows] = np.hypot(*(behind - before)) / np.sqrt(box[2, rows] * box[3, rows]).mean()
        span[rows] = time[-1] - time[0] + 1 / fps
    return speed, span


def _places(evidence: Evidence, still: Bool, asked: Bool) -> tuple[I8, F8]:
    """(M,) which place each of the ``asked`` detections belongs to, −1 for none, and how surely it
    fires too often.
    """
    frame = evidence.table.frame
    xyxy = evidence.table.detections.xyxy
    rows = np.flatnonzero(still)
    candidates = np.flatnonzero(asked)
    where = np.full(len(frame), -1)
    score = np.zeros(len(frame))
    fired = [frame[rows[_alike(xyxy[k], xyxy[rows])]] for k in candidates]
    likely = np.array([_fires(hits, evidence) for hits in fired])
    seeds = np.zeros((0, 4))
    numbers = np.zeros(0, np.int64)
    # The middle of a place has the most around it.
    for seed in np.lexsort((-np.array([len(hits) for hits in fired]), -likely)):
        box = xyxy[candidates[seed]]
        if likely[seed] < SHOWN:
            break
        if where[candidates[seed]] < 0:
            # The number of the place that the box overlaps with, or a new one.
            overlap = iou(box[None], seeds)[0]
            known = overlap.max(initial=0.0) >= _SAME
            if known:
                number = numbers[np.argmax(overlap)]
            else:
                number = numbers.max(initial=-1) + 1
            seeds = np.vstack([seeds, box])
            numbers = np.append(numbers, number)
            alike = candidates[_alike(box, xyxy[candidates])]
            alike = alike[where[alike] < 0]
            where[alike] = number
            score[alike] = likely[seed]
    return where, score


def _fires(frame: I8, evidence: Evidence) -> float:
    """How surely a place fires by itself that has still detections in these frames of the
    stretch.
    """
    from scipy.special import gammaincc

    hits = np.unique(frame) - evidence.frames.start
    length = len(evidence.frames)
    n = len(hits)
    window = STAY * evidence.fps
    if n < 2:
        return 0.0
    often = float(gammaincc(n, window))  # P(N < n)
    runs = 1 + (np.diff(hits) > 1).sum()
    windows = len(np.unique(hits // window))
    at_random = np.interp(runs / (n * (length - n + 1) / length), _RUNS, (0, 1))
    parts = length / window
    all_along = np.interp(windows / math.ceil(parts), _SPREAD, (0, 1)) if parts >= _WINDOWS else 0.0
    return often * float(max(at_random, all_along))


def _alike(box: F8, others: F8) -> I8:
    """Which of ``others`` (n, 4) are in the place and of the size of ``box`` (4,)."""
    return np.flatnonzero(iou(box[None], others)[0] >= ALIKE)


class Background:
    """Makes suggestions in a thread.

    ``share`` of the work is done; ``found`` are the suggestions when they are there; ``problem`` is
    why there will be none. ``work`` gets a function that reports the share that is done, and raises
    where it fails.
    """

    def __init__(self, work: Callable[[Callable[[float], None]], list[Suggestion]]) -> None:
        self.share = 0.0
        self.problem = ""
        self.found: list[Suggestion] | None = None

        def run() -> None:
            try:
                self.found = work(lambda share: setattr(self, "share", share))
            except Exception as error:
                self.problem = str(error) or type(error).__name__
            self.share = 1.0

        # A daemon: the page can be closed before there are suggestions.
        threading.Thread(target=run, name="suggestions", daemon=True).start()
