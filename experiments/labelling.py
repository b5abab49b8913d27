"""Delayed labelling: decide some seconds later which detections were false alarms.

At first a filter gives a detection the false-alarm probability κ/(κ + C). Learning from this alone
fails: the first detections of an entering target have a high one, so that entrances are learned as
places of false alarms; and frequent false alarms in one place are confirmed as a target, so that
they are never learned. Some seconds later there is track evidence:

* a detection on a track of an object, or on its extrapolation before its beginning, is no false
  alarm;
* a detection on a track that was confirmed but is not an object is a false alarm;
* any other detection is a false alarm with the filter's probability.

A confirmed track is an object if its detections have a standard deviation of 0.4 of its width or
height, or if they are as frequent as p_D implies: with h of n frames detected, if

    h log(p_D/q) + (n − h) log((1 − p_D)/(1 − q)) > 0,     q = p_D/2

which holds from h/n = 0.71 on for p_D = 0.9. A repeated false alarm in one place is detected in
fewer frames and does not move. A standing object that is detected in every second frame looks the
same, and a false alarm in nine of ten frames looks like an object.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from phdtrack.arrays import iou, to_cxcywh, to_xyxy
from phdtrack.scene.training import first_state
from phdtrack.types import F8, I8, Bool, Step, Tracks

# Standard deviation of a track's centres, in its widths or heights, above which it has moved.
MOVED = 0.4
# Overlap (intersection over union) above which a detection lies on a track.
ON_TRACK = 0.3
# Frames before its first state through which a track is extrapolated back.
BACK = 10
# Observed frames after which a track that is not detected is forgotten, beyond the delay.
FORGET = 250
_NONE: I8 = np.zeros(0, np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class TrackEvidence:
    """Evidence about the tracks of the last seconds, identities (n,) ascending.

    ``first``, ``last`` (n,): places of their first and last detections, counted in observed frames.
    ``hits`` (n,): frames in which they were detected. ``confirmed`` (n,). ``sums`` (6, n): of the
    boxes then, as centres and sizes, and of the squares of the centres.
    """

    identity: I8 = field(default_factory=_NONE.copy)
    first: I8 = field(default_factory=_NONE.copy)
    last: I8 = field(default_factory=_NONE.copy)
    hits: I8 = field(default_factory=_NONE.copy)
    confirmed: Bool = field(default_factory=lambda: np.zeros(0, np.bool_))
    sums: F8 = field(default_factory=lambda: np.zeros((6, 0)))

    def since(self, place: int) -> TrackEvidence:
        """Without tracks whose last detection is before ``place``."""
        kept = self.last >= place
        identity, first, last, hits = (
            column[kept] for column in (self.identity, self.first, self.last, self.hits)
        )
        return TrackEvidence(identity, first, last, hits, self.confirmed[kept], self.sums[:, kept])

    def with_rows(self, rows: Tracks, place: I8) -> TrackEvidence:
        """With more rows of tracks, of frames at the places (M,)."""
        seen = rows.detection >= 0
        rows = rows.select(seen)
        place = place[seen]
        if not len(rows):
            return self
        box = to_cxcywh(rows.xyxy)
        identity = np.concatenate([self.identity, rows.identity])
        order = np.argsort(identity, kind="stable")
        start = np.flatnonzero(np.diff(identity[order], prepend=-1))
        first, last = (np.concatenate([old, place])[order] for old in (self.first, self.last))
        hits = np.concatenate([self.hits, np.ones(len(rows), np.int64)])[order]
        sums = np.hstack([self.sums, np.vstack([box, np.square(box[:2])])])[:, order]
        return TrackEvidence(
            identity[order][start],
            np.minimum.reduceat(first, start),
            np.maximum.reduceat(last, start),
            np.add.reduceat(hits, start),
            np.logical_or.reduceat(np.concatenate([self.confirmed, rows.confirmed])[order], start),
            np.add.reduceat(sums, start, axis=1),
        )

    def moved(self) -> Bool:
        """(n,) whether each track has moved."""
        mean, size, square = np.split(self.sums / self.hits, 3)
        return np.asarray(
            (square - np.square(mean) > np.square(MOVED * size)).any(axis=0), np.bool_
        )

    def objects(self, detection: float) -> Bool:
        """(n,) whether each track is an object's, for this detection probability."""
        p = min(max(detection, 0.01), 0.99)
        missed = self.last - self.first + 1 - self.hits
        often = self.hits * math.log(2) + missed * math.log((1 - p) / (1 - p / 2)) > 0
        out: Bool = self.confirmed & (self.moved() | often)
        return out


@dataclass(frozen=True, slots=True, eq=False)
class ObservedFrame:
    """An observed frame: its number and time, the boxes detected (N, 4), the filter's probability
    (N,) that each is a false alarm, and the online rows of the frame."""

    number: int
    time: float
    xyxy: F8
    false: F8
    rows: Tracks


@dataclass(frozen=True, slots=True, eq=False)
class PendingFrames:
    """Frames that wait for their labels.

    ``place``: number of observed frames before them. The rows of the first ``counted`` of them are
    in ``evidence``.
    """

    frames: tuple[ObservedFrame, ...] = ()
    place: int = 0
    counted: int = 0
    evidence: TrackEvidence = field(default_factory=TrackEvidence)

    def joined(self, step: Step) -> PendingFrames:
        """With one more frame, if it was observed."""
        if not step.detections.observed:
            return self
        n = len(step.detections)
        false = step.info.clutter_probability
        false = false if len(false) == n else np.ones(n)
        frame = ObservedFrame(step.number, step.time, step.detections.xyxy, false, step.tracks)
        return replace(self, frames=(*self.frames, frame))


@dataclass(frozen=True, slots=True, eq=False)
class Labels:
    """Labels of ``frames`` frames, in which ``seconds`` passed.

    ``false`` (N,): probability that each detection is a false alarm.
    """

    frames: int
    seconds: float
    false: F8


def label(pending: PendingFrames, until: float, detection: float) -> tuple[PendingFrames, Labels]:
    """Label the frames up to a time.

    Parameters
    ----------
    pending : frames in order.
    until : time of the last frame to label, seconds.
    detection : p_D.

    Returns
    -------
    The frames that still wait, and the labels.
    """
    frames = pending.frames
    place = pending.place
    number = np.array([f.number for f in frames], np.int64)
    time = np.array([f.time for f in frames])
    rows, new = (
        Tracks.concatenate([f.rows for f in frames[begin:]]) for begin in (0, pending.counted)
    )
    new = new.select(np.isin(new.frame, number))
    evidence = pending.evidence.with_rows(new, place + np.searchsorted(number, new.frame))
    due = int(np.searchsorted(time, until, side="right"))
    objects = evidence.objects(detection)
    of_object = np.isin(rows.identity, evidence.identity[objects])
    of_none = np.isin(rows.identity, evidence.identity[evidence.confirmed & ~objects])
    # Tracks that began in these frames or so soon after them that detections in them may be theirs.
    begun = np.flatnonzero(
        objects & (evidence.first >= place) & (evidence.first < place + due + BACK)
    )
    before, where = _led_back(rows, evidence.identity[begun], number, time)
    box = np.concatenate([np.zeros((0, 4)), *(f.xyxy for f in frames[:due])])
    false = np.concatenate([np.zeros(0), *(f.false for f in frames[:due])])
    frame = np.repeat(number[:due], [len(f.xyxy) for f in frames[:due]])
    true = _on(
        frame,
        box,
        np.append(rows.frame[of_object], before),
        np.concatenate([rows.xyxy[of_object], where]),
    )
    false = np.where(
        true, 0.0, np.where(_on(frame, box, rows.frame[of_none], rows.xyxy[of_none]), 1.0, false)
    )
    # A frame that no other follows lasts as long as those before it on average.
    ends = time[min(due, len(time) - 1)] if due else time[0]
    seconds = (ends - time[0]) * (due / max(1, min(due, len(time) - 1)))
    labels = Labels(due, float(seconds), false)
    kept = evidence.since(place - FORGET)
    return PendingFrames(frames[due:], place + due, len(frames) - due, kept), labels


def _led_back(rows: Tracks, begun: I8, number: I8, time: F8) -> tuple[I8, F8]:
    """Frame numbers and boxes of the tracks ``begun`` (B,), extrapolated to frames before their
    beginning.
    """
    frames = [_NONE]
    boxes = [np.zeros((0, 4))]
    for identity in begun:
        its = np.flatnonzero((rows.identity == identity) & (rows.detection >= 0))
        place = np.searchsorted(number, rows.frame[its])
        box = to_cxcywh(rows.xyxy[its])
        seconds = time[place] - time[place[0]]
        velocity = first_state(box, seconds)[2:4] if len(its) > 2 else np.zeros(2)
        earlier = np.arange(max(0, place[0] - BACK), place[0])
        back = np.outer(velocity, time[earlier] - time[place[0]])
        frames.append(number[earlier])
        boxes.append(
            to_xyxy(np.concatenate([box[:2, :1] + back, np.tile(box[2:, :1], len(earlier))]))
        )
    return np.concatenate(frames), np.concatenate(boxes)


def _on(frame: I8, xyxy: F8, row_frame: I8, row_xyxy: F8) -> Bool:
    """(N,) whether each box (N, 4) of a frame (N,) lies on one of the rows (M, 4) of the same
    frame.
    """
    on = np.zeros(len(frame), np.bool_)
    for number in np.intersect1d(frame, row_frame):
        here = frame == number
        on[here] = (iou(xyxy[here], row_xyxy[row_frame == number]) >= ON_TRACK).any(axis=1)
    return on
