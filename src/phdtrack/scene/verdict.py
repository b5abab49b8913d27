"""Which detections were false alarms, and where targets were born, judged some seconds later.

When a detection comes, a filter gives it a probability κ/(κ + C) to be a false alarm. That alone teaches the wrong thing,
twice over. The first detections of everybody who comes in are doubted, so that entrances would be learned as places of
false alarms, and doubted more; and a place that fires often enough is believed, so that it would never be learned. So
judgement waits a few seconds, until it is known what became of a detection:

* it lies on a track that is believed (`sightings`), or where that track was before it was believed: no false alarm;
* it lies on a track that was confirmed and is not believed: a false alarm;
* anything else: a false alarm with the probability that the filter gave it.

Births are the first states of tracks that are believed.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from phdtrack.arrays import to_cxcywh, to_xyxy
from phdtrack.scene.samples import first_state
from phdtrack.scene.sightings import Sightings
from phdtrack.types import F8, I8, Bool, Step, Tracks

# Overlap (intersection over union) from which a detection lies on a track.
_ON = 0.3
# Frames before its first state over which a track is led back.
_BACK = 10
# Places after which a track that is not seen is forgotten, beyond the wait.
_FORGOTTEN = 250


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """An observed frame: its number and time, the boxes detected (N, 4), the filter's probability (N,) that each is false,
    and the online rows that came with it."""

    number: int
    time: float
    xyxy: F8
    chance: F8
    rows: Tracks


def look_of(step: Step) -> Look:
    """What is kept of a step."""
    info, n = step.info, len(step.detections)
    total = info.clutter + info.evidence
    # What `clutter_probability` gives, which takes care of a total of 0 at a price.
    chance = info.clutter / total if total.all() else info.clutter_probability
    chance = chance if len(chance) == n else np.ones(n)
    return Look(step.number, step.time, step.detections.xyxy, chance, step.tracks)


@dataclass(frozen=True, slots=True, eq=False)
class Watch:
    """The frames that wait for judgement, the first of them at ``place`` (observed frames before it); of ``met`` of them
    the rows are in ``sightings``."""

    looks: tuple[Look, ...] = ()
    place: int = 0
    met: int = 0
    sightings: Sightings = field(default_factory=Sightings.none)


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """Of ``frames`` frames, in which ``seconds`` passed, the boxes (4, N) as centre and size, the probability (N,) that each
    is a false alarm, and the first states (6, B) of those who came."""

    frames: int
    seconds: float
    box: F8
    false: F8
    births: F8


def judged(watch: Watch, until: float, detection: float, rate: float) -> tuple[Watch, Verdict]:
    """Judge the frames up to ``until`` seconds, where objects are detected with probability ``detection``.

    ``rate``: time units per second, of the births' velocities.
    """
    looks = watch.looks
    number, time = np.array([m.number for m in looks], np.int64), np.array([m.time for m in looks])
    rows = Tracks.concatenate([m.rows for m in looks])
    new = Tracks.concatenate([m.rows for m in looks[watch.met :]])
    known = np.isin(new.frame, number)
    sightings = watch.sightings.met(new.take(known), watch.place + np.searchsorted(number, new.frame[known]))
    due = int(np.searchsorted(time, until, side="right"))
    believed = sightings.believed(detection)
    clear = sightings.of(rows.identity, believed)
    doubtful = sightings.of(rows.identity, sightings.confirmed & ~believed)
    # So soon after these frames that detections in them may be his.
    soon = (sightings.first >= watch.place) & (sightings.first < watch.place + due + _BACK)
    begun = np.flatnonzero(believed & soon)
    states, before = _led_back(rows, sightings.identity[begun], number, time, rate)
    box = np.concatenate([m.xyxy for m in looks[:due]]) if due else np.zeros((0, 4))
    chance = np.concatenate([m.chance for m in looks[:due]]) if due else np.zeros(0)
    frame = np.repeat(number[:due], [len(m.xyxy) for m in looks[:due]])
    target = _on(frame, box, np.concatenate([rows.frame[clear], before[0]]), np.concatenate([rows.xyxy[clear], before[1]]))
    place = _on(frame, box, rows.frame[doubtful], rows.xyxy[doubtful])
    false = np.where(target, 0.0, np.where(place, 1.0, chance))
    # Who was there at the start was not born then.
    came = (sightings.first[begun] < watch.place + due) & (sightings.first[begun] >= _BACK)
    # A frame that no other follows lasts as long as one of those before it.
    ends = time[min(due, len(time) - 1)] if due else time[0]
    passed = (ends - time[0]) * (due / max(1, min(due, len(time) - 1)))
    verdict = Verdict(due, float(passed), to_cxcywh(box), false, np.ascontiguousarray(states[:, came]))
    rest = replace(watch, looks=looks[due:], place=watch.place + due, met=len(looks) - due)
    return replace(rest, sightings=sightings.since(watch.place - _FORGOTTEN)), verdict


def _led_back(rows: Tracks, begun: I8, number: I8, time: F8, rate: float) -> tuple[F8, tuple[I8, F8]]:
    """(6, B) the first states of the identities ``begun`` (B,), and where they were in the frames before: numbers, boxes.

    ``rows`` are theirs and others', sorted by frame, in frames ``number`` (F,) at ``time`` (F,) seconds.
    """
    states, frames, boxes = np.zeros((6, len(begun))), [np.zeros(0, np.int64)], [np.zeros((0, 4))]
    for b, identity in enumerate(begun):
        own = np.flatnonzero((rows.identity == identity) & (rows.detection >= 0))
        place = np.searchsorted(number, rows.frame[own])
        box, seconds = to_cxcywh(rows.xyxy[own]), time[place] - time[place[0]]
        states[:, b] = first_state(box, seconds, rate) if len(own) > 2 else np.concatenate([box[:2, 0], [0, 0], box[2:, 0]])
        earlier = np.arange(max(0, place[0] - _BACK), place[0])
        back = np.outer(states[2:4, b], (time[earlier] - time[place[0]]) * rate)
        size = np.tile(box[2:, 0, None], len(earlier))
        frames.append(number[earlier])
        boxes.append(to_xyxy(np.concatenate([box[:2, :1] + back, size])))
    return states, (np.concatenate(frames), np.concatenate(boxes))


def _on(frame: I8, xyxy: F8, row_frame: I8, row_xyxy: F8) -> Bool:
    """(N,) whether each box (N, 4) of a frame (N,) lies on one of the rows (M, 4) of the same frame."""
    order = np.argsort(row_frame, kind="stable")
    low, high = (np.searchsorted(row_frame[order], frame, side=side) for side in ("left", "right"))
    count = high - low
    which = np.repeat(np.arange(len(frame)), count)
    other = order[np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count) + low[which]]
    a, b = xyxy[which], row_xyxy[other]
    side = np.maximum(np.minimum(a[:, 2:], b[:, 2:]) - np.maximum(a[:, :2], b[:, :2]), 0)
    shared = side.prod(axis=1)
    union = (a[:, 2:] - a[:, :2]).prod(axis=1) + (b[:, 2:] - b[:, :2]).prod(axis=1) - shared
    on = np.zeros(len(frame), np.bool_)
    on[which[shared >= _ON * union]] = True
    return on
