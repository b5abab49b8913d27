"""Scores of detections as evidence, from the first frame on: p(s|target)/p(s|false alarm) without any labels.

Today's detectors report boxes down to a score of 0.05 and leave it to the tracker what to make of them. A score s between 0
and 1 is read as a probability; of scores on other scales the rank among those seen so far stands for it. With e the score
that says nothing,

    p(s|target)/p(s|false alarm) = (s/(1 − s) · (1 − e)/e)^slope

within limits. False alarms are as many fewer, or more, see `models.clutter.ScoredClutter`: a low box continues a track, and
starts one only where low boxes come again and again. Where all scores are the same they say nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from phdtrack.errors import Checked, InputError, Positive
from phdtrack.models.clutter import ScoredClutter
from phdtrack.protocols import Learning, Model
from phdtrack.types import F8, Detections, Step

# Scores that are remembered, the newest.
KEPT = 3000


@dataclass(frozen=True, slots=True, eq=False)
class ScoresSeen:
    """The newest scores (n,), and the state of ``other`` learning."""

    scores: F8 = field(default_factory=lambda: np.zeros(0))
    other: Any = None


@dataclass(frozen=True, slots=True)
class ScoreOdds(Checked, Learning[ScoresSeen]):
    """Settings of what scores are read as.

    Parameters
    ----------
    slope : power of the odds s/(1 − s): 1 reads a score as a probability, 0.5 believes it less, 2 more.
    even_score : e, between 0 and 1, the score, or rank, that targets and false alarms have equally often.
    max_odds : the ratio is at most this, and at least one over it.
    other : what else is learned.
    """

    slope: Positive = 2.0
    even_score: Positive = 0.65
    max_odds: Positive = 400.0
    other: Learning[Any] | None = None

    def __post_init__(self) -> None:
        Checked.__post_init__(self)
        if not (self.even_score < 1 <= self.max_odds):
            problem = f"expected even_score below 1 and max_odds from 1, got {self.even_score:g} and {self.max_odds:g}"
            raise InputError(problem, where="[rates] of kind scores")

    def odds(self, score: F8, before: F8) -> F8:
        """(n,) p(s|target)/p(s|false alarm) of the scores (n,) of a frame; 1 for NaN.

        ``before`` (m,) are earlier scores: they tell the scale, and ranks are among both.
        """
        seen = np.sort(np.append(before, score))
        seen = seen[~np.isnan(seen)]
        if len(seen) == 0 or seen[0] == seen[-1]:
            return np.ones(len(score))
        share = score
        if seen[0] < 0 or seen[-1] > 1:
            # The mean rank of equal scores; neither 0 nor 1.
            below, up_to = (np.searchsorted(seen, score, side=side) for side in ("left", "right"))
            share = (below + up_to + 1) / (2 * len(seen) + 2)
        with np.errstate(divide="ignore"):
            log = self.slope * (np.log(share) - np.log1p(-share) - np.log(self.even_score / (1 - self.even_score)))
        limit = np.log(self.max_odds)
        return np.where(np.isnan(score), 1.0, np.exp(np.clip(log, -limit, limit)))

    def start(self) -> ScoresSeen:
        """No score seen."""
        return ScoresSeen(other=self.other and self.other.start())

    def model(self, state: ScoresSeen, model: Model) -> Model:
        """The model with what else is learned."""
        return self.other.model(state.other, model) if self.other else model

    def with_scores(self, state: ScoresSeen, model: Model, detections: Detections) -> Model:
        """The model whose false alarms are weighed by the scores of the detections."""
        model = self.other.with_scores(state.other, model, detections) if self.other else model
        return replace(model, clutter=ScoredClutter(model.clutter, self.odds(detections.confidence, state.scores)))

    def advance(self, state: ScoresSeen, step: Step) -> ScoresSeen:
        """Remember the scores of a frame."""
        seen = np.append(state.scores, step.detections.confidence)[-KEPT:]
        return ScoresSeen(seen, self.other and self.other.advance(state.other, step))

    def mode(self, state: ScoresSeen, name: str) -> ScoresSeen | None:
        """With the regime of this name, of what else is learned."""
        other = self.other and self.other.mode(state.other, name)
        return ScoresSeen(state.scores, other) if other else None
