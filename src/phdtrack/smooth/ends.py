"""Extension of corrected tracks at both ends by detections that no track uses.

A filter loses a target that leaves the picture some frames before the detector does: a box cut by
the picture's border is smaller than predicted, and its centre is shifted. For the same reason it
finds a target that enters too late. Here the whole track is known. Its box continues at the
velocity of its last rows, is cut by the border, and is compared with the unused detections. Where
they overlap the track gets a row. It ends at the second frame in a row without one.
"""

from __future__ import annotations

import numpy as np

from phdtrack.arrays import iou_of_pairs
from phdtrack.types import F8, I8, Bool, MeasurementHistory, Tracks

# Rows from which the velocity is estimated, least overlap (IoU) with a detection, and frames in a
# row without one that a track survives.
_ROWS = 5
_MIN_IOU = 0.3
_MAX_MISSED = 1


def continued(
    tracks: Tracks,
    measurements: MeasurementHistory,
    boxes: F8,
    size: tuple[float, float],
    limit: float,
) -> Tracks:
    """The tracks, with further rows at their ends that have the boxes of detections, and the
    confidence of the end.

    Parameters
    ----------
    tracks : M rows.
    measurements : of all detections; NaN for those without a place.
    boxes : (Z, 4) the boxes of the measurements, pixels.
    size : width and height of the picture, pixels.
    limit : time units by which a track is extended, at most.
    """
    row, step, velocity = _ends(tracks, measurements)
    free = np.isfinite(boxes.sum(axis=1))
    place = np.searchsorted(measurements.number, tracks.frame)
    free[measurements.columns(tracks)[tracks.detection >= 0]] = False
    added = [tracks]
    at = place[row].copy()
    missed = np.zeros(len(row), np.int64)
    active = np.arange(len(row))
    while len(active):
        at[active] += step[active]
        inside = (at[active] >= 0) & (at[active] < len(measurements.number))
        active = active[inside & (missed[active] <= _MAX_MISSED)]
        passed = measurements.time[at[active]] - measurements.time[place[row[active]]]
        predicted = tracks.xyxy[row[active]] + velocity[active] * passed[:, None]
        predicted = np.clip(predicted, 0, [*size, *size])
        visible = (predicted[:, 2:] - predicted[:, :2] > 1).all(axis=1)
        stay = (np.abs(passed) <= limit) & visible
        active = active[stay]
        matched, column = _matched(predicted[stay], at[active], measurements.start, boxes, free)
        end = active[matched]
        missed[active] += 1
        missed[end] = 0
        frame = at[end]
        added.append(
            Tracks.of(
                measurements.number[frame],
                tracks.identity[row[end]],
                boxes[column],
                tracks.confidence[row[end]],
                measurements.row[column],
            )
        )
    return Tracks.concatenate(added)


def _ends(tracks: Tracks, measurements: MeasurementHistory) -> tuple[I8, I8, F8]:
    """Both ends of each track with at least two rows: (n,) the row, (n,) 1 for the last and −1 for
    the first, and (n, 4) the velocity of its box.
    """
    order = np.lexsort((tracks.frame, tracks.identity))
    _, first, count = np.unique(tracks.identity[order], return_index=True, return_counts=True)
    first = first[count > 1]
    count = count[count > 1]
    last = first + count - 1
    back = np.minimum(count - 1, _ROWS)
    row = order[np.concatenate([first, last])]
    other = order[np.concatenate([first + back, last - back])]
    time = measurements.time[np.searchsorted(measurements.number, tracks.frame)]
    centre = (tracks.xyxy[:, :2] + tracks.xyxy[:, 2:]) / 2
    velocity = (centre[row] - centre[other]) / (time[row] - time[other])[:, None]
    return row, np.repeat([-1, 1], len(first)), np.tile(velocity, 2)


def _matched(predicted: F8, at: I8, start: I8, boxes: F8, free: Bool) -> tuple[I8, I8]:
    """The ``predicted`` boxes (n, 4) that match a free detection of frame ``at`` (n,), and the
    columns of the detections, which are marked as used.
    """
    count = start[at + 1] - start[at]
    end = np.repeat(np.arange(len(at)), count)
    column = start[at][end] + np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    end = end[free[column]]
    column = column[free[column]]
    overlap = iou_of_pairs(predicted[end], boxes[column])
    best = np.argsort(-overlap, kind="stable")
    best = best[overlap[best] >= _MIN_IOU]
    done = np.zeros(len(at), np.bool_)
    chosen = []
    for k in best.tolist():
        if free[column[k]] and not done[end[k]]:
            free[column[k]] = False
            done[end[k]] = True
            chosen.append(k)
    return end[chosen], column[chosen]
