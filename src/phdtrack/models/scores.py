"""Scores of detections as evidence: p(s|target)/p(s|false alarm), right on the first frame and learned without any labels.

Today's detectors report boxes down to a score of 0.05 and leave it to the tracker what to make of them. With x the log odds
log(s/(1 − s)) of a score s between 0 and 1, or of its rank among those seen where scores are on another scale,

    log p(s|target)/p(s|false alarm) = a·x + b

within limits, a logistic regression whose prior reads s as a probability. It learns from delayed verdicts that do not look
at scores: a detection that overlaps one of the next frame, and so on through `LENGTH` frames, was true, one whose chain ends
before was false. A verdict of the tracker itself would call false whatever it does not follow, and confirm its own doubts.
Each verdict is one step of Newton's method on the posterior of (a, b), a Gaussian with the precision of what was seen so
far; what is old is forgotten. Where all scores are the same they say nothing.

False alarms that last, as of a poster or of one's own mirror image, are linked like targets, so that nothing is learned of
them. Against these a score is read as the probability that it claims to be, and a rank as half of what was learned.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from phdtrack.errors import Checked, InputError, Positive
from phdtrack.kernels.box import following
from phdtrack.models.clutter import ScoredClutter
from phdtrack.protocols import Learning, Model
from phdtrack.types import F8, I8, Detections, Step

# Scores, and verdicts, that are remembered, the newest.
KEPT = 3000
# Frames that a chain of detections must last to be of a target, and the overlap (IoU) of its links.
LENGTH, LINKED = 6, 0.3
# Precisions of a and of b that the prior has, and its verdicts, true and false.
PRIOR_PRECISION = np.array([4.0, 1.0])
PRIOR_VERDICTS = np.array([7.0, 3.0])
# Slope of the prior for ranks, and the rank that says nothing.
RANKS = (1.0, 0.45)
# What a rank says of false alarms that last, as a share of what it says of others.
LASTING_SHARE = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class ScoresSeen:
    """What is known of scores, and the state of ``other`` learning.

    Attributes
    ----------
    scores : (n,) the newest.
    ranked : a score was seen that is no probability.
    boxes : (m, 4) detections of the last frame.
    waiting : (m, `LENGTH`) x of the detections of their chains that wait for a verdict, NaN where there is none.
    length : (m,) frames that their chains have lasted.
    information, precision : (2,), (2, 2) precision times mean, and precision, of (a, b); empty before the first verdict.
    verdicts : (2,) how many were true, and false.
    """

    scores: F8 = field(default_factory=lambda: np.zeros(0))
    ranked: bool = False
    boxes: F8 = field(default_factory=lambda: np.zeros((0, 4)))
    waiting: F8 = field(default_factory=lambda: np.zeros((0, LENGTH)))
    length: I8 = field(default_factory=lambda: np.zeros(0, np.int64))
    information: F8 = field(default_factory=lambda: np.zeros(0))
    precision: F8 = field(default_factory=lambda: np.zeros((0, 0)))
    verdicts: F8 = field(default_factory=lambda: PRIOR_VERDICTS)
    other: Any = None


@dataclass(frozen=True, slots=True)
class ScoreOdds(Checked, Learning[ScoresSeen]):
    """Settings of what scores are read as before anything is learned.

    Parameters
    ----------
    slope : a of the prior for probabilities: 1 reads a score as one, 0.5 believes it less, 2 more.
    even_score : between 0 and 1, the score that targets and false alarms have equally often, by the prior.
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

    def log_odds(self, score: F8, state: ScoresSeen) -> tuple[F8, F8]:
        """Log p(s|target)/p(s|false alarm) of the scores (n,) of a frame, and the same against false alarms that last.

        Both (n,), and 0 for NaN and where all scores are the same.
        """
        x, ranked = _log_odds(score, state)
        slope, offset = self._line(state, ranked)
        limit = np.log(self.max_odds)
        single = np.clip(slope * x + offset, -limit, limit)
        lasting = LASTING_SHARE * single if ranked else x
        return np.where(np.isnan(x), 0.0, single), np.where(np.isnan(x), 0.0, lasting)

    def _line(self, state: ScoresSeen, ranked: bool) -> F8:
        """(2,) a and b."""
        if len(state.information) == 0 or ranked != state.ranked:
            return self._prior(ranked)
        line = np.linalg.solve(state.precision, state.information)
        return np.array([max(line[0], 0.0), line[1]])

    def _prior(self, ranked: bool) -> F8:
        """(2,) a and b of the prior."""
        slope, even = RANKS if ranked else (self.slope, self.even_score)
        return np.array([slope, -slope * np.log(even / (1 - even))])

    def start(self) -> ScoresSeen:
        """No score seen."""
        return ScoresSeen(other=self.other and self.other.start())

    def model(self, state: ScoresSeen, model: Model) -> Model:
        """The model with what else is learned."""
        return self.other.model(state.other, model) if self.other else model

    def with_scores(self, state: ScoresSeen, model: Model, detections: Detections) -> Model:
        """The model whose false alarms are weighed by the scores of the detections."""
        model = self.other.with_scores(state.other, model, detections) if self.other else model
        single, lasting = self.log_odds(detections.confidence, state)
        return replace(model, clutter=ScoredClutter(model.clutter, np.exp(single), lasting))

    def advance(self, state: ScoresSeen, step: Step) -> ScoresSeen:
        """Remember the scores of a frame, prolong the chains, and learn from those on which there is a verdict."""
        other = self.other and self.other.advance(state.other, step)
        if not step.detections.observed:
            return replace(state, other=other)
        boxes, score = step.detections.xyxy, step.detections.confidence
        x, ranked = _log_odds(score, state)
        before = following(state.boxes, boxes, LINKED)
        length = np.append(state.length, 0)[before] + 1
        waiting = np.vstack([state.waiting, np.full(LENGTH, np.nan)])[before]
        waiting[np.arange(len(x)), np.minimum(length, LENGTH) - 1] = x
        ended = np.ones(len(state.boxes), bool)
        ended[before[before >= 0]] = False
        long = length >= LENGTH
        true, false = waiting[long], state.waiting[ended]
        waiting[long] = np.nan
        seen = np.append(state.scores, score)[-KEPT:]
        if ranked != state.ranked:
            state = replace(self.start(), ranked=ranked)
        state = replace(state, scores=seen, boxes=boxes, waiting=waiting, length=length, other=other)
        return self._learned(state, true[~np.isnan(true)], false[~np.isnan(false)])

    def _learned(self, state: ScoresSeen, true: F8, false: F8) -> ScoresSeen:
        """With the verdicts that the detections of these x (n,) were true and false."""
        n = len(true) + len(false)
        if n == 0:
            return state
        kept, prior = max(1 - n / KEPT, 0.0), np.diag(PRIOR_PRECISION)
        start, information, precision = self._prior(state.ranked), state.information, state.precision
        if len(information) == 0:
            information, precision = prior @ start, prior
        information = np.asarray(kept * information + (1 - kept) * prior @ start)
        precision = kept * precision + (1 - kept) * prior
        verdicts = kept * state.verdicts + (1 - kept) * PRIOR_VERDICTS + np.array([len(true), len(false)])
        rows = np.stack([np.concatenate([true, false]), np.ones(n)])
        line = np.linalg.solve(precision, information)
        p = 1 / (1 + np.exp(-(line @ rows + np.log(verdicts[0] / verdicts[1]))))
        curvature = (p * (1 - p) * rows) @ rows.T
        information = information + curvature @ line + rows @ ((np.arange(n) < len(true)) - p)
        return replace(state, verdicts=verdicts, precision=precision + curvature, information=information)

    def mode(self, state: ScoresSeen, name: str) -> ScoresSeen | None:
        """With the regime of this name, of what else is learned."""
        other = self.other and self.other.mode(state.other, name)
        return replace(state, other=other) if other else None


def _log_odds(score: F8, state: ScoresSeen) -> tuple[F8, bool]:
    """(n,) x of the scores (n,) of a frame, NaN where they say nothing; whether it is that of their ranks."""
    seen = np.append(state.scores, score)
    seen = seen[~np.isnan(seen)]
    if len(seen) == 0:
        return np.full(len(score), np.nan), state.ranked
    low, high = seen.min(), seen.max()
    ranked = state.ranked or low < 0 or high > 1
    share = np.full(len(score), np.nan) if low == high else score
    if ranked and low < high:
        # The mean rank of equal scores; neither 0 nor 1.
        seen = np.sort(seen)
        below, up_to = (np.searchsorted(seen, score, side=side) for side in ("left", "right"))
        share = np.where(np.isnan(score), np.nan, (below + up_to + 1) / (2 * len(seen) + 2))
    share = np.clip(share, 1e-3, 1 - 1e-3)
    return np.log(share) - np.log1p(-share), bool(ranked)
