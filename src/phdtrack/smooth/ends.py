"""Corrected tracks are carried on, before their first row and after their last, by detections that
no track uses.

A filter loses a target that leaves the picture some frames before the detector does: what the
picture's border cuts is smaller than expected, and its centre lies elsewhere. It finds one that
enters late for the same reason. Here the whole track is known. Its box goes on at the velocity of
its last rows, is cut by the picture, and compared with the detections that are left; where they
overlap, the track has a row there. It ends at the second frame in a row without one.
"""

from __future__ import annotations

import numpy as np

from phdtrack.arrays import iou_of_pairs
from phdtrack.types import F8, I8, Bool, MeasurementHistory, Tracks

# Rows from which the velocity is taken, the least overlap (IoU) with a detection, frames in a row
# without one.
_ROWS = 5
_OVERLAP = 0.3
_MISSED = 1


def carried_on(
    tracks: Tracks, seen: MeasurementHistory, boxes: F8, size: tuple[float, float], most: float
) -> Tracks:
    """The tracks, and the rows that detections add at their ends: with their boxes, and the
    confidence of the row there.

    Parameters
    ----------
    tracks : M rows.
    seen : the measurements; of detections without a place NaN.
    boxes : (Z, 4) the boxes of the measurements, pixels.
    size : width and height of the picture, pixels.
    most : time units for which a track is carried on, at most.
    """
    row, step, speed = _ends(tracks, seen)
    free = np.isfinite(boxes.sum(axis=1))
    place = np.searchsorted(seen.number, tracks.frame)
    known = tracks.detection >= 0
    free[seen.start[place[known]] + tracks.detection[known]] = False
    added = [tracks]
    at = place[row].copy()
    missed = np.zeros(len(row), np.int64)
    # Those that still go on.
    going = np.arange(len(row))
    while len(going):
        at[going] += step[going]
        going = going[
            (at[going] >= 0) & (at[going] < len(seen.number)) & (missed[going] <= _MISSED)
        ]
        passed = seen.time[at[going]] - seen.time[place[row[going]]]
        expected = np.clip(
            tracks.xyxy[row[going]] + speed[going] * passed[:, None], 0, [*size, *size]
        )
        stay = (np.abs(passed) <= most) & (expected[:, 2:] - expected[:, :2] > 1).all(axis=1)
        going = going[stay]
        some, column = _taken(expected[stay], at[going], seen.start, boxes, free)
        end = going[some]
        missed[going] += 1
        missed[end] = 0
        old = row[end]
        now = at[end]
        name = tracks.identity[old]
        sure = tracks.confidence[old]
        added.append(
            Tracks.of(seen.number[now], name, boxes[column], sure, column - seen.start[now])
        )
    return Tracks.concatenate(added)


def _ends(tracks: Tracks, seen: MeasurementHistory) -> tuple[I8, I8, F8]:
    """Both ends of each track of two rows or more: the row, 1 for its last and −1 for its first,
    and (n, 4) the velocity.
    """
    order = np.lexsort((tracks.frame, tracks.identity))
    _, first, count = np.unique(tracks.identity[order], return_index=True, return_counts=True)
    first = first[count > 1]
    count = count[count > 1]
    last = first + count - 1
    back = np.minimum(count - 1, _ROWS)
    row = order[np.concatenate([first, last])]
    other = order[np.concatenate([first + back, last - back])]
    time = seen.time[np.searchsorted(seen.number, tracks.frame)]
    centre = (tracks.xyxy[:, :2] + tracks.xyxy[:, 2:]) / 2
    speed = (centre[row] - centre[other]) / (time[row] - time[other])[:, None]
    return row, np.repeat([-1, 1], len(first)), np.tile(speed, 2)


def _taken(expected: F8, at: I8, start: I8, boxes: F8, free: Bool) -> tuple[I8, I8]:
    """Which of the ``expected`` boxes (n, 4) take a detection of frame ``at`` (n,), and its column;
    it is free no more.
    """
    count = start[at + 1] - start[at]
    end = np.repeat(np.arange(len(at)), count)
    column = start[at][end] + np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    end = end[free[column]]
    column = column[free[column]]
    overlap = iou_of_pairs(expected[end], boxes[column])
    best = np.argsort(-overlap, kind="stable")
    best = best[overlap[best] >= _OVERLAP]
    taken = np.zeros(len(at), np.bool_)
    chosen = []
    for k in best.tolist():
        if free[column[k]] and not taken[end[k]]:
            free[column[k]] = False
            taken[end[k]] = True
            chosen.append(k)
    return end[chosen], column[chosen]
