"""Delayed labelling: which detections were false alarms, and where targets were born, decided some seconds later [M09 §VI].

At once a filter gives a detection the probability κ/(κ + C) to be a false alarm. To learn from that alone goes wrong: the
first detections of a target that enters are doubted, so that entrances become places of false alarms and are doubted more;
and a place that fires often is confirmed, so that it is never learned. Some seconds later, track evidence says more:

* a detection on a track of an object, or where that track was before it began, is no false alarm;
* a detection on a track that was confirmed but is not an object is a false alarm;
* any other detection is a false alarm with the probability that the filter gave it.

A confirmed track is an object if its detections have a standard deviation of 0.4 of its width or height, or if they came as
often as p_D says: with h of n frames detected, if

    h log(p_D/q) + (n − h) log((1 − p_D)/(1 − q)) > 0,     q = p_D/2

which holds from h/n = 0.71 on for p_D = 0.9. A false alarm that returns in one place is detected in fewer frames and goes
nowhere. An object that stands still and is detected in every second frame looks the same, and so does a place that fires in
nine frames of ten look like an object. Births are the first states of tracks of objects.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from phdtrack.arrays import to_cxcywh, to_xyxy
from phdtrack.scene.training import first_state
from phdtrack.types import F8, I8, Bool, Step, Tracks

# Standard deviation of a track's centres, in its widths or heights, from which it has moved.
MOVED = 0.4
# Overlap (intersection over union) from which a detection lies on a track.
ON_TRACK = 0.3
# Frames before its first state through which a track is extrapolated back.
BACK = 10
# Observed frames after which a track that is not detected is forgotten, beyond the delay.
FORGET = 250
_NONE: I8 = np.zeros(0, np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class TrackEvidence:
    """What is known of the tracks of the last seconds, identities (n,) ascending.

    ``first``, ``last`` (n,): places of their first and last detections, counted in observed frames. ``hits`` (n,): frames in
    which they were detected. ``sums`` (4, n) of the boxes then, centres and sizes; ``squares`` (2, n) of the centres.
    ``confirmed`` (n,).
    """

    identity: I8
    first: I8
    last: I8
    hits: I8
    sums: F8
    squares: F8
    confirmed: Bool

    @classmethod
    def none(cls) -> TrackEvidence:
        """No tracks."""
        return cls(_NONE, _NONE, _NONE, _NONE, np.zeros((4, 0)), np.zeros((2, 0)), np.zeros(0, np.bool_))

    def __len__(self) -> int:
        return len(self.identity)

    def since(self, place: int) -> TrackEvidence:
        """Without tracks that were last detected before ``place``."""
        kept = self.last >= place
        if kept.all():
            return self
        return TrackEvidence(
            self.identity[kept], self.first[kept], self.last[kept], self.hits[kept],
            self.sums[:, kept], self.squares[:, kept], self.confirmed[kept],
        )  # fmt: skip

    def with_rows(self, rows: Tracks, place: I8) -> TrackEvidence:
        """With more rows of tracks, of frames at the places (M,)."""
        seen = rows.detection >= 0
        rows, place = rows.take(seen), place[seen]
        if not len(rows):
            return self
        identity = np.union1d(self.identity, rows.identity)
        n, old, new = len(identity), np.searchsorted(identity, self.identity), np.searchsorted(identity, rows.identity)
        first, last, hits = np.full(n, np.iinfo(np.int64).max), np.full(n, -1), np.zeros(n, np.int64)
        sums, squares, confirmed = np.zeros((4, n)), np.zeros((2, n)), np.zeros(n, np.bool_)
        first[old], last[old], hits[old], confirmed[old] = self.first, self.last, self.hits, self.confirmed
        sums[:, old], squares[:, old] = self.sums, self.squares
        box = to_cxcywh(rows.xyxy)
        np.minimum.at(first, new, place)
        np.maximum.at(last, new, place)
        hits += np.bincount(new, minlength=n)
        for r in range(4):
            sums[r] += np.bincount(new, box[r], n)
        for r in range(2):
            squares[r] += np.bincount(new, np.square(box[r]), n)
        np.logical_or.at(confirmed, new, rows.confirmed)
        return TrackEvidence(identity, first, last, hits, sums, squares, confirmed)

    def moved(self) -> Bool:
        """(n,) whether each track has gone somewhere."""
        mean, size = self.sums[:2] / self.hits, self.sums[2:] / self.hits
        spread: Bool = self.squares / self.hits - np.square(mean) > np.square(MOVED * size)
        out: Bool = spread[0] | spread[1]
        return out

    def objects(self, detection: float) -> Bool:
        """(n,) whether each track is an object's, where objects are detected with this probability."""
        p = min(max(detection, 0.01), 0.99)
        missed = self.last - self.first + 1 - self.hits
        often = self.hits * math.log(2) + missed * math.log((1 - p) / (1 - p / 2)) > 0
        out: Bool = self.confirmed & (self.moved() | often)
        return out

    def of(self, identity: I8, values: Bool) -> Bool:
        """(M,) the ``values`` (n,) of identities (M,); False for those that are not known."""
        if not len(self):
            return np.zeros(len(identity), np.bool_)
        place = np.minimum(np.searchsorted(self.identity, identity), len(self) - 1)
        out: Bool = values[place] & (self.identity[place] == identity)
        return out


@dataclass(frozen=True, slots=True, eq=False)
class ObservedFrame:
    """An observed frame: its number and time, the boxes detected (N, 4), the filter's probability (N,) that each is a false
    alarm, and the online rows of the frame."""

    number: int
    time: float
    xyxy: F8
    false: F8
    rows: Tracks

    @classmethod
    def of(cls, step: Step) -> ObservedFrame:
        """What is kept of a step."""
        false = step.info.clutter_probability
        return cls(
            step.number,
            step.time,
            step.detections.xyxy,
            false if len(false) == len(step.detections) else np.ones(len(step.detections)),
            step.tracks,
        )


@dataclass(frozen=True, slots=True, eq=False)
class PendingFrames:
    """Frames that wait for their labels.

    ``place``: number of observed frames before them. The rows of the first ``counted`` of them are in ``evidence``.
    """

    frames: tuple[ObservedFrame, ...] = ()
    place: int = 0
    counted: int = 0
    evidence: TrackEvidence = field(default_factory=TrackEvidence.none)

    def joined(self, step: Step) -> PendingFrames:
        """With one more frame, if it was observed."""
        return replace(self, frames=(*self.frames, ObservedFrame.of(step))) if step.detections.observed else self


@dataclass(frozen=True, slots=True, eq=False)
class Labels:
    """Labels of ``frames`` frames, in which ``seconds`` passed.

    ``box`` (4, N): the detections as centre and size; ``false`` (N,): probability that each is a false alarm; ``births``
    (6, B): first states of the objects that appeared.
    """

    frames: int
    seconds: float
    box: F8
    false: F8
    births: F8


def label(pending: PendingFrames, until: float, detection: float, rate: float) -> tuple[PendingFrames, Labels]:
    """Label the frames up to a time; gives the frames that still wait, too.

    Parameters
    ----------
    pending : frames in order.
    until : time of the last frame to label, seconds.
    detection : p_D.
    rate : time units per second of the births' velocities.
    """
    frames = pending.frames
    number, time = np.array([f.number for f in frames], np.int64), np.array([f.time for f in frames])
    rows = Tracks.concatenate([f.rows for f in frames])
    new = Tracks.concatenate([f.rows for f in frames[pending.counted :]])
    new = new.take(np.isin(new.frame, number))
    evidence = pending.evidence.with_rows(new, pending.place + np.searchsorted(number, new.frame))
    due = int(np.searchsorted(time, until, side="right"))
    objects = evidence.objects(detection)
    of_object = evidence.of(rows.identity, objects)
    of_none = evidence.of(rows.identity, evidence.confirmed & ~objects)
    # Tracks that began in these frames or so soon after them that detections in them may be theirs.
    begun = np.flatnonzero(objects & (evidence.first >= pending.place) & (evidence.first < pending.place + due + BACK))
    states, before = _led_back(rows, evidence.identity[begun], number, time, rate)
    box = np.concatenate([np.zeros((0, 4)), *(f.xyxy for f in frames[:due])])
    false = np.concatenate([np.zeros(0), *(f.false for f in frames[:due])])
    frame = np.repeat(number[:due], [len(f.xyxy) for f in frames[:due]])
    true = _on(
        frame, box, np.concatenate([rows.frame[of_object], before[0]]), np.concatenate([rows.xyxy[of_object], before[1]])
    )
    false = np.where(true, 0.0, np.where(_on(frame, box, rows.frame[of_none], rows.xyxy[of_none]), 1.0, false))
    # Targets of the first frames were not born then.
    came = (evidence.first[begun] < pending.place + due) & (evidence.first[begun] >= BACK)
    # A frame that no other follows lasts as long as those before it on average.
    ends = time[min(due, len(time) - 1)] if due else time[0]
    seconds = (ends - time[0]) * (due / max(1, min(due, len(time) - 1)))
    labels = Labels(due, float(seconds), to_cxcywh(box), false, np.ascontiguousarray(states[:, came]))
    kept = evidence.since(pending.place - FORGET)
    return PendingFrames(frames[due:], pending.place + due, len(frames) - due, kept), labels


def _led_back(rows: Tracks, begun: I8, number: I8, time: F8, rate: float) -> tuple[F8, tuple[I8, F8]]:
    """(6, B) first states of the identities ``begun`` (B,), and frame numbers and boxes where they were before."""
    states, frames, boxes = np.zeros((6, len(begun))), [np.zeros(0, np.int64)], [np.zeros((0, 4))]
    for b, identity in enumerate(begun):
        its = np.flatnonzero((rows.identity == identity) & (rows.detection >= 0))
        place = np.searchsorted(number, rows.frame[its])
        box, seconds = to_cxcywh(rows.xyxy[its]), time[place] - time[place[0]]
        states[:, b] = first_state(box, seconds, rate) if len(its) > 2 else np.concatenate([box[:2, 0], [0, 0], box[2:, 0]])
        earlier = np.arange(max(0, place[0] - BACK), place[0])
        back = np.outer(states[2:4, b], (time[earlier] - time[place[0]]) * rate)
        frames.append(number[earlier])
        boxes.append(to_xyxy(np.concatenate([box[:2, :1] + back, np.tile(box[2:, 0, None], len(earlier))])))
    return states, (np.concatenate(frames), np.concatenate(boxes))


def _on(frame: I8, xyxy: F8, row_frame: I8, row_xyxy: F8) -> Bool:
    """(N,) whether each box (N, 4) of a frame (N,) lies on one of the rows (M, 4) of the same frame."""
    order = np.argsort(row_frame, kind="stable")
    low, high = (np.searchsorted(row_frame[order], frame, side=side) for side in ("left", "right"))
    count = high - low
    which = np.repeat(np.arange(len(frame)), count)
    other = order[np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count) + low[which]]
    a, b = xyxy[which], row_xyxy[other]
    shared = np.maximum(np.minimum(a[:, 2:], b[:, 2:]) - np.maximum(a[:, :2], b[:, :2]), 0).prod(axis=1)
    union = (a[:, 2:] - a[:, :2]).prod(axis=1) + (b[:, 2:] - b[:, :2]).prod(axis=1) - shared
    on = np.zeros(len(frame), np.bool_)
    on[which[shared >= ON_TRACK * union]] = True
    return on
