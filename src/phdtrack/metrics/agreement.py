"""A comparison of truth and tracks as they are read, and as they might be read instead."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from phdtrack.arrays import iou
from phdtrack.types import F8, I8, Tracks, Truth

# Two boxes agree from this overlap on.
_IOU = 0.5
# Frames that are looked at.
_FRAMES = 200
# Another reading is reported if so many more boxes agree, and twice as many.
_MORE = 0.25
# Coordinates that are larger are of no picture.
_LARGEST = 1e9
_FACTORS = (2.0, 0.5, 1.5, 2 / 3, 3.0, 1 / 3, 4.0, 0.25)


class _Reading(NamedTuple):
    """Another reading of the tracks: their frames and boxes, what it is, and the cure."""

    frame: I8
    xyxy: F8
    what: str
    cure: str


def other_reading(truth: Truth, tracks: Tracks) -> str:
    """A sentence if far more of the objects' boxes have a track over them when the tracks are read
    as corners, at another scale, or one frame later or earlier; else empty.

    Parameters
    ----------
    truth, tracks : annotated objects, and the tracks to score.
    """
    kept = ~truth.distractor
    frames = np.unique(truth.frame[kept])
    largest = max(np.abs(rows.xyxy).max(initial=0) for rows in (truth, tracks))
    if not len(frames) or not len(tracks) or largest > _LARGEST:
        return ""
    places = np.linspace(0, len(frames) - 1, min(_FRAMES, len(frames))).astype(np.int64)
    chosen = frames[places]
    kept = kept & np.isin(truth.frame, chosen)
    objects = (truth.frame[kept], truth.xyxy[kept])
    share = _agreement(objects, tracks.frame, tracks.xyxy)
    best = max(
        _readings(tracks),
        key=lambda reading: _agreement(objects, reading.frame, reading.xyxy),
    )
    better = _agreement(objects, best.frame, best.xyxy)
    if better < share + _MORE or better < 2 * share:
        return ""
    return (
        f"the tracks lie over {share:.0%} of the objects' boxes, and would over {better:.0%}"
        f" {best.what}: {best.cure}"
    )


def _readings(tracks: Tracks) -> Iterator[_Reading]:
    """The other ways to read the tracks."""
    frame = tracks.frame
    left, top, right, bottom = tracks.xyxy.T
    corners = np.stack([left, top, right - left, bottom - top], axis=1)
    cure = "say --box ltrb for that file (TRUTH,FILE)"
    yield _Reading(frame, corners, "if their sizes were corners", cure)
    sizes = np.stack([left, top, left + right, top + bottom], axis=1)
    cure = "say --box ltwh for that file (TRUTH,FILE)"
    yield _Reading(frame, sizes, "if their corners were sizes", cure)
    for shift, words in ((1, "later"), (-1, "earlier")):
        files = "tracks" if shift > 0 else "truth"
        option = ",0" if shift > 0 else "0,"
        cure = f"do the frames of the {files} count from 0? Say --first-frame {option}"
        yield _Reading(frame + shift, tracks.xyxy, f"one frame {words}", cure)
    for factor in _FACTORS:
        cure = "are they of a video of another size?"
        yield _Reading(frame, factor * tracks.xyxy, f"at {factor:.3g} times their size", cure)


def _agreement(objects: tuple[I8, F8], frame: I8, xyxy: F8) -> float:
    """The share of the objects' boxes that a box of the same frame overlaps."""
    usable = (xyxy[:, 2:] > xyxy[:, :2]).all(axis=1)
    order = np.argsort(frame[usable], kind="stable")
    frame = frame[usable][order]
    xyxy = xyxy[usable][order]
    found = 0
    for number in np.unique(objects[0]):
        begin, end = np.searchsorted(frame, [number, number + 1])
        if begin < end:
            overlap = iou(objects[1][objects[0] == number], xyxy[begin:end])
            found += int((overlap.max(axis=1) >= _IOU).sum())
    return found / max(1, len(objects[0]))
