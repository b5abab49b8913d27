"""With which identities two people leave a blob that they shared."""

from __future__ import annotations

from typing import Literal

import numpy as np

from experiments.common import Case
from phdtrack.arrays import iou
from phdtrack.types import I8, Tracks, Truth

Leave = Literal["right", "swapped", "new", "lost"]
# Their axes are this far apart, in widths, when they begin to touch as a detector sees it.
_TOUCH = 1.3
# Frames before and after in which identities are read; how many beside the touch itself are left out.
_BEFORE, _AFTER, _AROUND = 10, 17, 3
_MATCH = 0.4


def outcome(case: Case, tracks: Tracks) -> Leave:
    """What became of the two identities: ``right``, ``swapped``, ``new`` for one or both, ``lost``: one not followed."""
    first, last = touching(case.truth)
    before = [_identity(case, tracks, who, np.arange(first - _AROUND - _BEFORE, first - _AROUND)) for who in (1, 2)]
    after = [_identity(case, tracks, who, np.arange(last + _AROUND, last + _AROUND + _AFTER)) for who in (1, 2)]
    if 0 in before + after or before[0] == before[1] or after[0] == after[1]:
        return "lost"
    if before == after:
        return "right"
    return "swapped" if before == after[::-1] else "new"


def touching(truth: Truth) -> tuple[int, int]:
    """The first and the last frame in which the two touch."""
    boxes = {who: truth.xyxy[truth.identity == who] for who in (1, 2)}
    frames = {who: truth.frame[truth.identity == who] for who in (1, 2)}
    both, one, two = np.intersect1d(frames[1], frames[2], return_indices=True)
    a, b = boxes[1][one], boxes[2][two]
    near = np.abs(a[:, [0, 2]].mean(axis=1) - b[:, [0, 2]].mean(axis=1)) < _TOUCH * (a[:, 2] - a[:, 0])
    return int(both[near][0]), int(both[near][-1])


def _identity(case: Case, tracks: Tracks, who: int, frames: I8) -> int:
    """The identity that most of these frames give this person, 0 where none does."""
    votes = [0]
    for number in frames.tolist():
        true = case.truth.xyxy[(case.truth.frame == number) & (case.truth.identity == who)]
        rows = np.flatnonzero(tracks.frame == number)
        if not len(true) or not len(rows):
            continue
        overlap = iou(true[:1], tracks.xyxy[rows])[0]
        if overlap.max() >= _MATCH:
            votes.append(int(tracks.identity[rows[overlap.argmax()]]))
    counts = np.bincount(votes)
    counts[0] = 0
    return int(counts.argmax()) if counts.any() else 0
