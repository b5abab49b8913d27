"""Births marked by hand: in which frames births were looked for, and the states that they give [M09 §IV].

A drawn frame is hardly ever the one in which a target enters. So births are looked for on the short clip about each drawn
frame, and the mark goes on the first box of a target that was not there in the frame before. Nothing comes before the first
frame of a clip: births are not counted on it. The number of marks over the number of the other frames, each once where clips
overlap, is the rate of births without bias.
"""

from __future__ import annotations

import math

import numpy as np

from phdtrack.arrays import to_cxcywh
from phdtrack.label.store import LabelStore
from phdtrack.types import F8, I8, DetectionTable, SequenceInfo

# Frames of a clip before the drawn one, and behind it.
REACH = 10
# Frames behind a mark whose detections give the velocity, and how many of them at least.
LINKS, FEWEST = 3, 2
# A box may move by so many of its sizes √(wh) from one frame to the next, in a second and through its own error, and grow
# or shrink by such a factor.
_SPEED, _ERROR, _GROWTH = 6.0, 0.3, 1.5


def clip(number: int, last: int) -> range:
    """The frames about the drawn frame ``number`` of a sequence that ends with frame ``last``."""
    return range(max(1, number - REACH), min(last, number + REACH) + 1)


def all_frames(info: SequenceInfo, table: DetectionTable) -> range:
    """All frames; up to the last detection where the video does not say how many there are."""
    return range(1, (info.frames or table.last) + 1)


def watched(store: LabelStore, stretch: range) -> I8:
    """(n,) the frames in which births were looked for, ascending: the clips of all frames of ``stretch`` that are done.

    ``stretch`` ends with the sequence or before; clips do not reach beyond it.
    """
    clips = [clip(number, stretch.stop - 1) for number, done in store.frames() if done and number in stretch]
    seen = {frame for frames in clips for frame in frames[1:] if frame > stretch.start}
    return np.array(sorted(seen), np.int64)


def time_watched(
    store: LabelStore, table: DetectionTable, info: SequenceInfo, rate: float, stretch: range | None = None
) -> float:
    """Time units in which births were looked for: what their number is divided by for s̄.

    Parameters
    ----------
    store, table, info : the labels, the detections that they are on, the sequence.
    rate : time units a second.
    stretch : the frames that count; all where it is None.

    Returns
    -------
    Time units.
    """
    return len(watched(store, stretch or all_frames(info, table))) / info.fps * rate


def birth_states(
    store: LabelStore, table: DetectionTable, info: SequenceInfo, rate: float, stretch: range | None = None
) -> F8:
    """(6, n) states (px, py, vx, vy, w, h) of the boxes marked as births in the frames that were `watched` [M09 §IV].

    Parameters
    ----------
    store, table, info, rate, stretch : as in `time_watched`.

    Returns
    -------
    Pixels, and velocities in pixels per time unit; NaN where a box could not be linked to two of the next three frames'
    detections.
    """
    counted = set(watched(store, stretch or all_frames(info, table)).tolist())
    states = [
        _state(table, label.frame, label.box, info.fps, rate)
        for label in store.labels()
        if label.mark == "birth" and label.frame in counted
    ]
    return np.array(states).reshape(-1, 6).T.copy()


def _state(table: DetectionTable, number: int, index: int, fps: float, rate: float) -> F8:
    """The box with the slope of the straight line through its centre and those of the detections that go on from it."""
    frames, boxes = [number], [to_cxcywh(table.at(number).xyxy)[:, index]]
    own = index
    for later in range(number + 1, number + 1 + LINKS):
        own = _next(table, later, _expected(frames, boxes, later), own, fps, later - frames[-1])
        if own >= 0:
            frames.append(later)
            boxes.append(to_cxcywh(table.at(later).xyxy)[:, own])
    velocity = _slope(frames, boxes) * fps / rate if len(frames) > FEWEST else np.full(2, math.nan)
    return np.concatenate([boxes[0][:2], velocity, boxes[0][2:]])


def _next(table: DetectionTable, number: int, expected: F8, own: int, fps: float, passed: int) -> int:
    """Which detection of frame ``number`` is the ``expected`` box (4,), ``passed`` frames after the last one; −1 for none.

    It is the nearest in the gate, unless another box of the frame before, not ``own``, is nearer to it.
    """
    found = to_cxcywh(table.at(number).xyxy)
    offset, growth = _apart(expected, found)
    gate = _ERROR + _SPEED / fps * passed
    distance = np.where((offset <= gate) & (growth <= math.log(_GROWTH)), offset + growth, math.inf)
    if not np.isfinite(distance).any():
        return -1
    nearest = int(np.argmin(distance))
    others = to_cxcywh(table.at(number - 1).xyxy)
    rivals = np.delete(others, own, axis=1) if own >= 0 else others
    theirs = np.array(_apart(found[:, nearest], rivals)).sum(axis=0)
    return -1 if theirs.min(initial=math.inf) < distance[nearest] else nearest


def _apart(box: F8, others: F8) -> tuple[F8, F8]:
    """How far the centres of ``others`` (4, n) lie from that of ``box`` (4,), in its sizes, and how their sizes differ."""
    offset = np.hypot(*(others[:2] - box[:2, None])) / math.sqrt(box[2] * box[3])
    growth = np.abs(np.log(others[2:] / box[2:, None])).max(axis=0)
    return offset, growth


def _expected(frames: list[int], boxes: list[F8], number: int) -> F8:
    """The last box, moved on to frame ``number`` by the velocity so far."""
    if len(frames) < FEWEST:
        return boxes[-1]
    step = _slope(frames, boxes) * (number - frames[-1])
    return np.concatenate([boxes[-1][:2] + step, boxes[-1][2:]])


def _slope(frames: list[int], boxes: list[F8]) -> F8:
    """(2,) pixels per frame: of the straight lines through the centres, by least squares."""
    time = np.array(frames, np.float64) - np.mean(frames)
    centre = np.array([box[:2] for box in boxes])
    slope: F8 = (time[:, None] * centre).sum(axis=0) / (time**2).sum()
    return slope
