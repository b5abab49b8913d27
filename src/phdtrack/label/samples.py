"""What is learned from a person's marks: false alarms, objects, and the states of targets that
enter [M09 §IV].

A drawn frame is hardly ever the one in which a target enters. So births are looked for on the short
clip about each drawn frame, and the mark goes on the first box of a target that was not there in
the frame before. Nothing comes before the first frame of a clip: births are not counted on it. The
number of marks over the number of the other frames, each once where clips overlap, is the rate of
births without bias.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from phdtrack.arrays import to_cxcywh
from phdtrack.label.store import DRAWN, Label, LabelStore
from phdtrack.types import F8, I8, DetectionTable, SequenceInfo, Tracks

# Frames of a sequence: five days at 25 a second.
LONGEST = 10_000_000
# Frames of a clip before the drawn one, and behind it.
REACH = 10
# Frames behind a mark whose detections give the velocity, and how many of them at least.
_LINKS = 3
_MIN_LINKS = 2
# A box may move by so many of its sizes √(wh) from one frame to the next, in a second and through
# its own error, and grow or shrink by such a factor.
_SPEED = 6.0
_ERROR = 0.3
_GROWTH = 1.5


def shuffled(last: int, seed: int) -> list[int]:
    """The frames 1 … ``last`` in random order: the first n of them are n frames drawn at random."""
    out: list[int] = (np.random.default_rng(seed).permutation(last) + 1).tolist()
    return out


def clip(number: int, last: int) -> range:
    """The frames about the drawn frame ``number`` of a sequence that ends with frame ``last``."""
    return range(max(1, number - REACH), min(last, number + REACH) + 1)


def boxes_of(labels: list[Label], table: DetectionTable) -> F8:
    """(4, n) centres and sizes of the labelled boxes, pixels: where they were drawn or moved to,
    else the detections'.
    """
    places = [
        table.at(one.frame).xyxy[one.box] if one.place is None else one.place for one in labels
    ]
    return to_cxcywh(np.array(places).reshape(-1, 4))


@dataclass(frozen=True, slots=True, eq=False)
class Marks:
    """What the marks say of a stretch of frames.

    Attributes
    ----------
    store, table, info : the labels, the detections that they are on, the sequence, with the number
        of its frames.
    stretch : the frames that count, which end with the sequence or before; all where it is None.
    """

    store: LabelStore
    table: DetectionTable
    info: SequenceInfo
    stretch: range | None = None

    @property
    def looked_at(self) -> list[int]:
        """The drawn frames that have been looked at. On other frames more may be false, or
        enter.
        """
        return [number for number, done in self.store.frames() if done and number in self._frames]

    @property
    def false_boxes(self) -> F8:
        """(4, n) centres and sizes, pixels, of the boxes that are marked as false on frames that
        were `looked_at`.
        """
        return boxes_of(self._false, self.table)

    @property
    def object_boxes(self) -> F8:
        """(4, n) centres and sizes, pixels, of the objects on frames that were `looked_at`: the
        detections that are not marked as false, where somebody moved them to if so, and behind them
        the `missed` ones."""
        marked = {(label.frame, label.box): label for label in self.store.labels()}
        seen = (
            marked.get((n, k), Label(n, k, "none"))
            for n in self.looked_at
            for k in range(len(self.table.at(n)))
        )
        return boxes_of([*(one for one in seen if one.mark != "false"), *self.missed], self.table)

    @property
    def missed(self) -> list[Label]:
        """The objects that the detector missed on frames that were `looked_at`: boxes that a person
        has drawn.
        """
        done = set(self.looked_at)
        return [
            label for label in self.store.labels() if label.box >= DRAWN and label.frame in done
        ]

    def share_followed(self, tracks: Tracks) -> float:
        """The share of the boxes marked as false, on frames that were `looked_at`, that carry one
        of the tracks.

        It is (k + 1)/(n + 2) for k of n, Laplace's rule: none of a few does not mean that there
        never will be one. The tracks are made of the same detections.
        """
        false = {(label.frame, label.box) for label in self._false}
        followed = false.intersection(
            zip(tracks.frame.tolist(), tracks.detection.tolist(), strict=True)
        )
        return (len(followed) + 1) / (len(false) + 2)

    @property
    def watched(self) -> I8:
        """(n,) the frames in which births were looked for, ascending: the clips of all frames that
        were `looked_at`.
        """
        clips = [clip(number, self._frames.stop - 1)[1:] for number in self.looked_at]
        seen = {frame for frames in clips for frame in frames if frame > self._frames.start}
        return np.array(sorted(seen), np.int64)

    def time_watched(self, rate: float) -> float:
        """The time in which births were looked for, in units of which a second has ``rate``."""
        return len(self.watched) / self.info.fps * rate

    def birth_states(self, rate: float) -> F8:
        """(6, n) states (px, py, vx, vy, w, h) of the boxes marked as births in the frames that
        were `watched` [M09 §IV].

        Pixels, and velocities in pixels per unit of time, of which a second has ``rate``; NaN where
        a box could not be linked to two of the next three frames' detections.
        """
        counted = set(self.watched.tolist())
        scale = self.info.fps / rate
        births = [
            label
            for label in self.store.labels()
            if label.mark == "birth" and label.frame in counted
        ]
        velocity = (
            np.array([_velocity(self.table, label, self.info.fps) for label in births])
            .reshape(-1, 2)
            .T
            * scale
        )
        box = boxes_of(births, self.table)
        return np.concatenate([box[:2], velocity, box[2:]])

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


def _velocity(table: DetectionTable, birth: Label, fps: float) -> F8:
    """(2,) pixels per frame: the slope of the straight line through the box's centre and those that
    go on from it.
    """
    # A box that was drawn is none of the detections.
    own = birth.box if birth.box < DRAWN else -1
    frames = [birth.frame]
    boxes = [boxes_of([birth], table)[:, 0]]
    slope = np.zeros(2)
    for number in range(birth.frame + 1, birth.frame + 1 + _LINKS):
        passed = number - frames[-1]
        expected = np.concatenate([boxes[-1][:2] + passed * slope, boxes[-1][2:]])
        own = _next(table, number, expected, own, _ERROR + _SPEED / fps * passed)
        if own >= 0:
            frames.append(number)
            boxes.append(to_cxcywh(table.at(number).xyxy)[:, own])
            slope = np.polyfit(frames, np.array(boxes)[:, :2], 1)[0]
    if len(frames) > _MIN_LINKS:
        return slope
    return np.full(2, math.nan)


def _next(table: DetectionTable, number: int, expected: F8, own: int, gate: float) -> int:
    """Which detection of frame ``number`` is the ``expected`` box (4,); −1 for none.

    It is the nearest in the gate, unless another box of the frame before, not ``own``, is nearer to
    it.
    """
    found, before = (to_cxcywh(table.at(frame).xyxy) for frame in (number, number - 1))
    offset, growth = _apart(expected, found)
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
    """How far the centres of ``others`` (4, n) lie from that of ``box`` (4,), in its sizes, and how
    their sizes differ.
    """
    offset = np.hypot(*(others[:2] - box[:2, None])) / math.sqrt(box[2] * box[3])
    growth = np.abs(np.log(others[2:] / box[2:, None])).max(axis=0)
    return offset, growth
