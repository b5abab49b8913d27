"""Samples from a person's marks: false alarms, objects, and the states of entering targets
[M09 §IV].

A target rarely enters in a frame that was drawn at random. So births are marked on the short clip
around each drawn frame, on the first box of a target that the frame before does not show. The first
frame of a clip has no frame before: its births are not counted. The number of marks divided by the
number of other frames, each once if clips overlap, is an unbiased estimate of the birth rate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from phdtrack.arrays import to_cxcywh
from phdtrack.clock import Clock
from phdtrack.label.store import DRAWN, Label, LabelStore
from phdtrack.types import F8, I8, DetectionTable, SequenceInfo, Tracks

# Longest sequence in frames: five days at 25 a second.
LONGEST = 10_000_000
# Frames of a clip before the drawn one, and after it.
REACH = 10
# Frames after a mark whose detections give the velocity, and how many of them are needed.
_LINKS = 3
_MIN_LINKS = 2
# A box moves at most this many of its sizes √(wh) in a second, plus this error, and grows or
# shrinks at most by this factor.
_SPEED = 6.0
_ERROR = 0.3
_GROWTH = 1.5


def shuffled(last: int, seed: int) -> list[int]:
    """The frames 1 … ``last`` in random order: the first n of them are n frames drawn at random."""
    out: list[int] = (np.random.default_rng(seed).permutation(last) + 1).tolist()
    return out


def clip(number: int, last: int) -> range:
    """The frames around the drawn frame ``number`` of a sequence that ends with frame ``last``."""
    return range(max(1, number - REACH), min(last, number + REACH) + 1)


def boxes_of(labels: list[Label], table: DetectionTable) -> F8:
    """(4, n) centres and sizes of the labelled boxes in pixels: as drawn or moved, otherwise as
    detected.
    """
    places = [
        table.at(one.frame).xyxy[one.box] if one.place is None else one.place for one in labels
    ]
    return to_cxcywh(np.array(places).reshape(-1, 4))


@dataclass(frozen=True, slots=True, eq=False)
class Marks:
    """The marks in a stretch of frames, as samples.

    Attributes
    ----------
    store, table, info : the labels, their detections, the sequence with its number of frames.
    stretch : the frames that count, all of the sequence; None for all.
    clock : the times of the frames; None for a constant rate.
    """

    store: LabelStore
    table: DetectionTable
    info: SequenceInfo
    stretch: range | None = None
    clock: Clock | None = None

    @property
    def looked_at(self) -> list[int]:
        """The drawn frames that are done; only their marks are complete."""
        return [number for number, done in self.store.frames() if done and number in self._frames]

    @property
    def false_boxes(self) -> F8:
        """(4, n) centres and sizes in pixels of the boxes marked as false on done frames."""
        return boxes_of(self._false, self.table)

    @property
    def object_boxes(self) -> F8:
        """(4, n) centres and sizes in pixels of the objects on done frames: the detections that are
        not marked as false, moved if a person moved them, followed by the `missed` objects.
        """
        marked = {(label.frame, label.box): label for label in self.store.labels()}
        seen = (
            marked.get((n, k), Label(n, k, "none"))
            for n in self.looked_at
            for k in range(len(self.table.at(n)))
        )
        return boxes_of([*(one for one in seen if one.mark != "false"), *self.missed], self.table)

    @property
    def missed(self) -> list[Label]:
        """The objects that the detector missed on done frames: boxes that a person drew."""
        done = set(self.looked_at)
        return [
            label for label in self.store.labels() if label.box >= DRAWN and label.frame in done
        ]

    def share_followed(self, tracks: Tracks) -> float:
        """The share of the boxes marked as false on done frames that belong to a track.

        It is (k + 1)/(n + 2) for k of n, Laplace's rule, so that few samples do not give 0. The
        tracks are of the same detections.
        """
        false = {(label.frame, label.box) for label in self._false}
        followed = false.intersection(
            zip(tracks.frame.tolist(), tracks.detection.tolist(), strict=True)
        )
        return (len(followed) + 1) / (len(false) + 2)

    @property
    def watched(self) -> I8:
        """(n,) the frames in which births were looked for, ascending: the clips of all done
        frames.
        """
        clips = [clip(number, self._frames.stop - 1)[1:] for number in self.looked_at]
        seen = {frame for frames in clips for frame in frames if frame > self._frames.start}
        return np.array(sorted(seen), np.int64)

    def time_watched(self, rate: float) -> float:
        """The time in which births were looked for, in units of 1/``rate`` seconds."""
        clock = self._clock
        seconds = clock.times(self.watched) - clock.times(self.watched - 1)
        return float(seconds.sum()) * rate

    def birth_states(self, rate: float) -> F8:
        """(6, n) states (px, py, vx, vy, w, h) of the boxes marked as births in the `watched`
        frames [M09 §IV].

        In pixels and pixels per unit of time, 1/``rate`` seconds; NaN if a box could not be linked
        to detections in two of the next three frames.
        """
        counted = set(self.watched.tolist())
        births = [
            label
            for label in self.store.labels()
            if label.mark == "birth" and label.frame in counted
        ]
        velocity = (
            np.array([_velocity(self.table, label, self._clock) for label in births])
            .reshape(-1, 2)
            .T
            / rate
        )
        box = boxes_of(births, self.table)
        return np.concatenate([box[:2], velocity, box[2:]])

    @property
    def _clock(self) -> Clock:
        return self.clock or Clock.constant(self.info.fps)

    @property
    def _frames(self) -> range:
        if self.stretch is None:
            return range(1, self.info.frames + 1)
        return self.stretch

    @property
    def _false(self) -> list[Label]:
        done = set(self.looked_at)
        return [
            label for label in self.store.labels() if label.mark == "false" and label.frame in done
        ]


def _velocity(table: DetectionTable, birth: Label, clock: Clock) -> F8:
    """(2,) velocity in pixels per second: the slope of the straight line through the centres of the
    box and of the detections linked to it.
    """
    # A drawn box is no detection.
    own = birth.box if birth.box < DRAWN else -1
    times = [clock.time(birth.frame)]
    boxes = [boxes_of([birth], table)[:, 0]]
    slope = np.zeros(2)
    for number in range(birth.frame + 1, birth.frame + 1 + _LINKS):
        time = clock.time(number)
        passed = time - times[-1]
        predicted = np.concatenate([boxes[-1][:2] + passed * slope, boxes[-1][2:]])
        own = _next(table, number, predicted, own, _ERROR + _SPEED * passed)
        if own >= 0:
            times.append(time)
            boxes.append(to_cxcywh(table.at(number).xyxy)[:, own])
            slope = np.polyfit(np.array(times) - times[0], np.array(boxes)[:, :2], 1)[0]
    if len(times) > _MIN_LINKS:
        return slope
    return np.full(2, math.nan)


def _next(table: DetectionTable, number: int, predicted: F8, own: int, gate: float) -> int:
    """The detection of frame ``number`` that continues the ``predicted`` box (4,); −1 for none.

    It is the nearest in the gate, unless a box of the frame before other than ``own`` is nearer to
    it.
    """
    found, before = (to_cxcywh(table.at(frame).xyxy) for frame in (number, number - 1))
    offset, growth = _apart(predicted, found)
    distance = np.where((offset <= gate) & (growth <= math.log(_GROWTH)), offset + growth, math.inf)
    if not np.isfinite(distance).any():
        return -1
    nearest = int(np.argmin(distance))
    if own >= 0:
        rivals = np.delete(before, own, axis=1)
    else:
        rivals = before
    if np.add(*_apart(found[:, nearest], rivals)).min(initial=math.inf) < distance[nearest]:
        return -1
    return nearest


def _apart(box: F8, others: F8) -> tuple[F8, F8]:
    """Distances of the centres of ``others`` (4, n) from that of ``box`` (4,), in its sizes, and
    the log ratios of their sizes.
    """
    offset = np.hypot(*(others[:2] - box[:2, None])) / math.sqrt(box[2] * box[3])
    growth = np.abs(np.log(others[2:] / box[2:, None])).max(axis=0)
    return offset, growth
