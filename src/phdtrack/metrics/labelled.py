"""Truth of which only some frames were labelled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from phdtrack.types import I8, Bool, DetectionTable, Tracks, Truth

# Labelled frames at equal distances are a rule from so many on.
_FEWEST = 5
# Objects in less than this share of the frames, and tracks in at least this share of the others,
# raise a doubt.
_SPARSE = 0.5


def regularly_labelled(truth: Truth, tracks: Tracks | None) -> I8:
    """The frames with objects, if they follow each other at equal distances above 1, and tracks
    have rows between them: the frames between were not labelled. Otherwise empty.

    Parameters
    ----------
    truth, tracks : annotated objects, and the tracks to score; None: whatever tracks there are.
    """
    frames: I8 = np.unique(truth.frame)
    if _regular_step(frames) > 1 and (tracks is None or len(_between(frames, tracks))):
        return frames
    return frames[:0]


def _regular_step(frames: I8) -> int:
    """The distance between any two of the frames that follow each other; 0 if they differ, or there
    are few.
    """
    steps = np.diff(frames)
    if len(steps) >= _FEWEST - 1 and (steps == steps[0]).all():
        return int(steps[0])
    return 0


def keyframe_doubt(truth: Truth, tracks: Tracks) -> str:
    """A sentence if objects are annotated in few frames, and tracks are in most of the others; else
    empty.

    Parameters
    ----------
    truth, tracks : annotated objects, and the tracks to score.
    """
    frames = np.unique(truth.frame)
    if len(frames) < _FEWEST:
        return ""
    span = int(frames[-1] - frames[0]) + 1
    unlabelled = span - len(frames)
    between = len(_between(frames, tracks))
    if len(frames) >= _SPARSE * span or between < _SPARSE * unlabelled:
        return ""
    return (
        f"objects are annotated in {len(frames)} of {span} frames, and rows of tracks in others"
        " count as false: if only these were annotated, say --labelled truth"
    )


def _between(frames: I8, tracks: Tracks) -> I8:
    """The frames with tracks, between the first and the last of the frames, that are not among
    them."""
    found = np.setdiff1d(tracks.frame, frames)
    between: I8 = found[(found > frames[0]) & (found < frames[-1])]
    return between


def in_frames(truth: Truth, tracks: Tracks, frames: I8) -> tuple[Truth, Tracks]:
    """Truth and tracks in these frames alone, which are numbered from 1 in their order.

    Parameters
    ----------
    truth, tracks : annotated objects, and the tracks to score.
    frames : numbers of frames, ascending.
    """
    kept = np.isin(truth.frame, frames)
    every = truth.regions[:, 0] == 0
    regions = truth.regions[every | np.isin(truth.regions[:, 0], frames)].copy()
    numbered = regions[:, 0] != 0
    regions[numbered, 0] = _ranks(regions[numbered, 0].astype(np.int64), frames)
    part = replace(
        truth,
        frame=_ranks(truth.frame[kept], frames),
        identity=truth.identity[kept],
        xyxy=truth.xyxy[kept],
        distractor=truth.distractor[kept],
        regions=regions,
    )
    rows: Bool = np.isin(tracks.frame, frames)
    found = tracks.select(rows)
    return part, replace(found, frame=_ranks(found.frame, frames))


def detections_in_frames(table: DetectionTable, frames: I8) -> DetectionTable:
    """The detections in these frames alone, which are numbered from 1 in their order.

    Parameters
    ----------
    table : detections.
    frames : numbers of frames, ascending.
    """
    kept = np.isin(table.frame, frames)
    number = _ranks(table.frame[kept], frames)
    return replace(table, frame=number, detections=table.detections.select(kept))


def _ranks(numbers: I8, frames: I8) -> I8:
    """The places of the numbers among the frames, from 1."""
    ranks: I8 = np.searchsorted(frames, numbers) + 1
    return ranks
