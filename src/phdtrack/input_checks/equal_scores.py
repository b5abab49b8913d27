"""Scores that are nearly all the same, which tell nothing."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from phdtrack.types import F8

# What a judgement needs: scores, and frames with any; of a frame the first ones are looked at.
_SCORES = 60
_FRAMES = 50
_MAX_IN_FRAME = 20
# The share of equal scores that is too large.
_EQUAL = 0.9
# The score of detections without one (`types.Detections`).
_WITHOUT = 1.0
_NONE: F8 = np.zeros(0)


class FirstScores(NamedTuple):
    """Scores of the first frames, how many frames had any, and the highest."""

    scores: F8 = _NONE
    frames: int = 0
    best: float = -math.inf

    @property
    def enough(self) -> bool:
        """True if they can be judged."""
        return len(self.scores) >= _SCORES and self.frames >= _FRAMES

    def judged(self) -> FirstScores:
        """The highest score alone."""
        return FirstScores(best=self.best)


def with_scores(first: FirstScores, score: F8) -> FirstScores:
    """The same with scores (N,) of a frame."""
    if not len(score):
        return first
    scores = np.concatenate([first.scores, score[:_MAX_IN_FRAME]])
    return FirstScores(scores, first.frames + 1, max(first.best, float(score.max())))


def score_warning(scores: F8) -> str:
    """A sentence if nearly all of the scores (n,) are equal; also empty for detections without
    scores.
    """
    values, counts = np.unique(scores, return_counts=True)
    most = int(counts.argmax())
    share = counts[most] / len(scores)
    if share < _EQUAL or (len(values) == 1 and values[0] == _WITHOUT):
        return ""
    return (
        f"{share:.0%} of the scores are {values[most]:g}: scores that are all the same cannot tell"
        " objects from false alarms. Pass the detector's confidence in each box, or no scores"
    )
