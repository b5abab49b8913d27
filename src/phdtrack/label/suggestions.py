"""Suggestions of false alarms, for a person to confirm, from the result of a tracker with uniform
models.

There are three reasons, each with a score from 0 to 1:

``place``
    There are too many detections in its place. A *still* detection is one of no moving track.
    Still detections in one place and of one size (IoU ≥ ½) come from an object that stays, or from
    a place of false alarms. An object that stays for s seconds gives n ~ Poisson(s · fps) of them,
    in few runs. False alarms occur all the time: on n of T frames at random, in n(T − n + 1)/T runs
    [Wald and Wolfowitz 1940], or in bursts with hardly any gap of s seconds. The score is P(N < n)
    times the degree to which one of the two holds. With a background detector, which finds leaves
    in bursts, a place also counts in which things come again and again and never go anywhere
    (`scene.flicker`).
``rejected``
    The filter rejected it as clutter and no track uses it. The score is its posterior probability
    κ/(κ + C) of being clutter. Where a background detector finds something, something moves: this
    alone is never enough to be ticked.
``short``
    Its track was short and hardly moved, or it has no track. The score is at most 0.4, halved with
    each second of the track's life. Most such detections are true, so they are only shown.

What belongs to an object that went somewhere is never suggested, and what the border of the picture
cuts off, where objects enter, never ticked.

None of them is proof: a person sitting in one place all the time looks like a place of false
alarms, and a person hidden half of the time in a crowd is rejected.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np

from phdtrack.arrays import iou, to_cxcywh
from phdtrack.clock import Clock, as_clock
from phdtrack.detect.table_detector import frames_walked
from phdtrack.multiclass import ClassSettings
from phdtrack.protocols import AnyStages
from phdtrack.run.loop import TrackedFrame, table_frames, track_frames
from phdtrack.scene.flicker import (
    Sightings,
    learn_flicker,
    of_objects,
    touches_border,
    travellers,
)
from phdtrack.tracker import Tracker
from phdtrack.types import F8, I8, Bool, DetectionTable, Tracks

Reason = Literal["place", "rejected", "short"]
REASONS: tuple[Reason, ...] = get_args(Reason)
# Score from which a suggestion is preselected, and from which it is shown.
TICKED = 0.9
SHOWN = 0.2
# Overlap (IoU) from which boxes are in the same place and of the same size.
ALIKE = 0.5
# Boxes of one place scatter: overlap (IoU) with a box of a place from which a box belongs to it.
_SAME = 0.25
# s, seconds that an object stays in one place. Speed, in sizes √(wh) per second, from which a track
# moves.
STAY = 4.0
SLOW = 0.5
# Runs, as a share of those of random frames, and windows of s seconds with a detection, as a share
# of all: where they begin to indicate a place of false alarms, and where they leave no doubt. Fewer
# windows than these say nothing.
_RUNS = (0.5, 0.8)
_SPREAD = (0.8, 0.95)
_WINDOWS = 15
# Seconds up to which a track is short, and its largest score.
SHORT = 1.0
_MAX_SHORT = 0.4
# Largest score of what is not sure enough to be ticked; exponent of the probability that a place
# flickers: one of more than twice as many arrivals as visits of objects is ticked.
_MAX_UNSURE = 0.85
_FLICKER = 0.15


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """The result of a tracker with uniform models on the detections of a stretch.

    Attributes
    ----------
    table, clock, frames : the stretch's detections, M rows, its times, and its frames.
    clutter : (M,) the posterior probability that each is a false alarm.
    tracks : the corrected ones, whose ``detection`` counts within the frame.
    frame_size : width and height of a frame, pixels; (0, 0): unknown.
    background : whether a background detector found the detections.
    """

    table: DetectionTable
    clock: Clock
    frames: range
    clutter: F8
    tracks: Tracks
    frame_size: tuple[float, float] = (0.0, 0.0)
    background: bool = False

    @property
    def cut_off(self) -> Bool:
        """(M,) True for detections that the border of the picture may cut off."""
        return touches_border(to_cxcywh(self.table.detections.xyxy), self.frame_size)

    @classmethod
    def of(
        cls,
        table: DetectionTable,
        fps: float | Clock,
        frames: range,
        stages: AnyStages | ClassSettings,
        seed: int = 0,
        advance: Callable[[int], object] = id,
    ) -> Evidence:
        """The result of a tracker on the detections of some frames.

        A filter that does not report false alarms (`filters.none`) leaves all probabilities at 0,
        and so do the limits of a frame's detections.

        Parameters
        ----------
        table, fps : of the whole sequence; frames per second, or the times of the frames.
        frames : the stretch.
        stages, seed : how to track.
        advance : called with the number of frames done.
        """
        rows = np.arange(*np.searchsorted(table.frame, [frames.start, frames.stop]))
        stretch = DetectionTable(table.frame[rows], table.detections.select(rows))
        clock = as_clock(fps)
        tracker = Tracker(stages=stages, fps=clock.rate, seed=seed)
        clutter = _ClutterProbabilities(advance)
        numbers = frames_walked(table, frames.stop - 1, clock.rate)
        inside = (number for number in numbers if number >= frames.start)
        track_frames(tracker, table_frames(table, inside, clock), (clutter,))
        false = np.concatenate(clutter.values)
        return cls(stretch, clock, frames, false, tracker.tracks())


class _ClutterProbabilities:
    """Keeps the probability that each detection is a false alarm."""

    def __init__(self, advance: Callable[[int], object]) -> None:
        self.values = list[F8]()
        self._advance = advance

    def take(self, tracked: TrackedFrame) -> None:
        """Keep those of a frame."""
        step = tracked.step
        probability = np.zeros(len(tracked.detected.detections))
        if len(step.info.clutter_probability):
            probability[step.detections.row] = step.info.clutter_probability
        self.values.append(probability)
        self._advance(len(self.values))


class Suggestion(NamedTuple):
    """A detection that may be false.

    Attributes
    ----------
    frame, box : the frame, and the number of the detection in it, from 0.
    reason, score : the reason, and from 0 to 1 how likely it is false.
    place : number of the place of false alarms, −1 for other reasons.
    """

    frame: int
    box: int
    reason: Reason
    score: float
    place: int


def suggest(evidence: Evidence, frames: Sequence[int]) -> list[Suggestion]:
    """Suggestions among the detections of some frames, worst first; none outside the stretch."""
    table = evidence.table
    own = _tracks_of(table, evidence.tracks)
    speed, span = _lives(table, own, evidence.clock)
    requested = np.isin(table.frame, np.asarray(frames, np.int64))
    box = to_cxcywh(table.detections.xyxy)
    seen = Sightings(box, evidence.clock.times(table.frame), own)
    objects = travellers(seen)
    # A background detector also finds objects in parts.
    went = of_objects(seen, objects) if evidence.background else np.isin(own, objects)
    goes = (speed >= SLOW) | went
    place, fires = _places(evidence, ~goes, requested & ~goes)
    rejected = np.where(own >= 0, 0.0, evidence.clutter)
    if evidence.background:
        place, fires = _or_flickering(place, fires, np.where(goes, 0.0, _flicker(evidence, seen)))
        # Something moves there, even if no track follows it.
        rejected = np.minimum(rejected, _MAX_UNSURE)
    short = np.where(~goes & (span < SHORT), _MAX_SHORT * 0.5**span * (1 - speed / SLOW), 0.0)
    scores = np.where(went, 0.0, np.stack([fires, rejected, short]))
    scores = np.minimum(scores, np.where(evidence.cut_off, _MAX_UNSURE, 1.0))
    reason = scores.argmax(axis=0)
    score = scores.max(axis=0)
    rows = np.flatnonzero(requested & (score >= SHOWN))
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


def _flicker(evidence: Evidence, seen: Sightings) -> F8:
    """(M,) the score of places in which things come again and again and never go anywhere."""
    learned = learn_flicker(seen, evidence.frame_size)
    odds = learned.odds_among(seen.box, learned.others(seen.box))
    return np.asarray((1 - odds) ** _FLICKER)


def _or_flickering(place: I8, fires: F8, flicker: F8) -> tuple[I8, F8]:
    """The places (M,) and their scores (M,), of which those without a number that flicker share a
    further one.
    """
    more = (place < 0) & (flicker > fires)
    return np.where(more, place.max(initial=-1) + 1, place), np.maximum(fires, flicker)


def _tracks_of(table: DetectionTable, tracks: Tracks) -> I8:
    """(M,) the track of each detection, counted from 0; −1 for none."""
    own = np.full(len(table), -1)
    rests = tracks.detection >= 0
    _, which = np.unique(tracks.identity[rests], return_inverse=True)
    own[np.searchsorted(table.frame, tracks.frame[rests]) + tracks.detection[rests]] = which
    return own


def _lives(table: DetectionTable, own: I8, clock: Clock) -> tuple[F8, F8]:
    """(M,) speed of each detection's track there in sizes per second, and (M,) its duration in
    seconds; 0 without a track.

    The speed is the distance between the means over the second before and the second after.
    """
    box = to_cxcywh(table.detections.xyxy)
    speed, span = np.zeros((2, len(table)))
    order = np.argsort(own, kind="stable")
    for rows in np.split(order, np.searchsorted(own[order], np.arange(own.max(initial=-1) + 1)))[
        1:
    ]:
        time = clock.times(table.frame[rows])
        here = np.arange(len(rows))
        total = np.hstack([np.zeros((2, 1)), np.cumsum(box[:2, rows], axis=1)])
        first = np.searchsorted(time, time - 1.0)
        last = np.searchsorted(time, time + 1.0, side="right")
        before = (total[:, here + 1] - total[:, first]) / (here + 1 - first)
        behind = (total[:, last] - total[:, here]) / (last - here)
        speed[rows] = np.hypot(*(behind - before)) / np.sqrt(box[2, rows] * box[3, rows]).mean()
        span[rows] = clock.time(table.frame[rows[-1]] + 1) - time[0]
    return speed, span


def _places(evidence: Evidence, still: Bool, requested: Bool) -> tuple[I8, F8]:
    """(M,) the place of each ``requested`` detection, −1 for none, and (M,) the score of that
    place.
    """
    frame = evidence.table.frame
    xyxy = evidence.table.detections.xyxy
    rows = np.flatnonzero(still)
    candidates = np.flatnonzero(requested)
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
    """The score of a place that has still detections in these frames of the stretch."""
    from scipy.special import gammaincc

    hits = np.unique(frame)
    length = len(evidence.frames)
    n = len(hits)
    clock = evidence.clock
    seconds = clock.passed(evidence.frames)
    window = STAY * length / seconds
    if n < 2:
        return 0.0
    often = float(gammaincc(n, window))  # P(N < n)
    runs = 1 + (np.diff(hits) > 1).sum()
    passed = clock.times(hits) - clock.time(evidence.frames.start)
    # Rounding of times must not move a frame into the window before.
    windows = len(np.unique((passed + 1e-6) // STAY))
    at_random = np.interp(runs / (n * (length - n + 1) / length), _RUNS, (0, 1))
    parts = seconds / STAY
    all_along = np.interp(windows / math.ceil(parts), _SPREAD, (0, 1)) if parts >= _WINDOWS else 0.0
    return often * float(max(at_random, all_along))


def _alike(box: F8, others: F8) -> I8:
    """Indices of the ``others`` (n, 4) in the place and of the size of ``box`` (4,)."""
    return np.flatnonzero(iou(box[None], others)[0] >= ALIKE)


class Background:
    """A search for suggestions in a thread.

    ``share`` of the work is done; ``found`` are the suggestions, None before they are complete;
    ``problem`` is the reason if there will be none. ``work`` gets a function that reports the share
    that is done, and raises if it fails.
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
