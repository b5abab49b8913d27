"""Scores of detections as evidence: p(s|target)/p(s|false alarm), right on the first frame and
learned without any labels.

Today's detectors report boxes down to a score of 0.05 and leave it to the tracker what to make of
them. With x the log odds log(s/(1 − s)) of a score s between 0 and 1, the score less a constant
where scores are log odds themselves, or the log odds of its rank among those seen where they are on
another scale,

    log p(s|target)/p(s|false alarm) = a·x + b

within limits, a logistic regression whose prior reads s as a probability. It learns from delayed
verdicts that do not look at scores: a detection that overlaps one of the next frame, and so on
through `LENGTH` frames, was true, one whose chain ends before was false. A verdict of the tracker
itself would call false whatever it does not follow, and confirm its own doubts. Each verdict is one
step of Newton's method on the posterior of (a, b), a Gaussian with the precision of what was seen
so far; what is old is forgotten. Where all scores are the same they say nothing.

What moves by more than its size from frame to frame, or is often missed, has no long chains, so
that in slow videos the best scores seemed to say little. Where no target is known, (a, b) are
others: for these a detection was true, too, if a target that was reported rests on it. Beside a
target only chains decide. The false alarms there are second boxes of it and boxes of its parts.
They have the scores of objects, and tracks follow them.

Detectors differ in how high their best scores are. If those of a stream are below 0.8, all of its x
are raised until they are not.

How many false alarms there are is learned, too: few detections of targets overlap one neither of
the frame before nor of the next. If more than the share `DetectionScores.usual_alone` are alone,
false alarms are as much more than the model says. Those near a box are no more than the boxes that
are near a box: where these are fewer than `NEAR`, false alarms are as much fewer.

False alarms that last, as of a poster or of one's own mirror image, are linked like targets, so
that nothing is learned of them. Against these a score is read as the probability that it claims to
be, and a rank as half of what was learned. Scores that tell targets from other false alarms badly,
by an a below half of the prior's, say as much less of lasting ones.

But a detector's probabilities mean little elsewhere: in some streams objects that anybody can see
have scores of 0.2 to 0.45 beside others of 0.9. False alarms that last flicker, besides being
missed as targets are. So how often chains of at least `LENGTH` frames end tells, for each x, how
many of them are false [PMB (20)]: weak detections that are followed as long as strong ones are
objects, and their scores say nothing against them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from phdtrack.errors import Checked, InputError, Positive, Share
from phdtrack.kernels.detection_scores import (
    LOGIT,
    RANK,
    Chains,
    Line,
    Steadiness,
    evidence_of,
    learned_frame,
    levelled,
)
from phdtrack.models.clutter import BoxClutter, ScoredClutter, UniformClutter
from phdtrack.protocols import Learning, Model
from phdtrack.types import F8, I8, Detections, Step, state_record

# Scores, and verdicts, that are remembered, the newest.
KEPT = 3000
# Frames that a chain of detections must last to be of a target, and the overlap (IoU) of its links.
LENGTH = 6
LINKED = 0.3
# The overlap (IoU) by which a detection lies beside a target of the last frame.
BESIDE = 0.2
# Precisions of a and of b that the prior has, and its verdicts, true and false.
PRIOR_PRECISION = np.array([4.0, 1.0])
PRIOR_VERDICTS = np.array([7.0, 3.0])
_PRECISION = np.diag(PRIOR_PRECISION)
# Detections whose being alone or not is assumed to be known at the start, none of them alone.
FIRST_SEEN = 100.0
# Detections near a detection that are expected before any are seen, and for how many detections
# that counts; of about so many a frame the neighbours are counted; and what was learned is at least
# this share of what was expected.
NEAR = 0.6
NEAR_PRIOR = 30.0
NEAR_ASKED = 32
LEAST_NEAR = 0.05
# For how many detections the neighbours count that are expected to be alone.
ALONE_PRIOR = 5.0
# Slope of the prior for ranks, and the rank that says nothing.
RANKS = (1.0, 0.45)
# What a rank says of false alarms that last, as a share of what it says of others.
LASTING_SHARE = 0.5
# Of false alarms that last a score says what it claims, unless a is surely less than this share of
# the prior's: then as much less. Surely less: with so many standard deviations more, too.
CLAIMED_SLOPE = 0.5
SURE = 2.0
# The probability that a lasting false alarm is missing in a frame in which a target would be
# detected; and of how many chains of targets how many end in a frame, before any are seen.
FLICKER = 0.15
PRIOR_BREAKS = np.array([1.0, 2.0])
# Scores are log odds where some are negative and none is above the first. A detector that reports
# negative ones reports more than it believes: the second is what says nothing. The third: x is
# between minus and plus this, as of probabilities from the last.
LARGEST_LOGIT = 25.0
EVEN_LOGIT = 2.0
BOUND = math.log(999)
LEAST = 0.001
# The x that the best scores of a stream have at least; where they are lower, all are raised. After
# so many frames what was best before counts for 37 %.
GOOD = math.log(4)
LEVEL_FRAMES = 500.0
_NO_SCORES = np.zeros(0)
_SCALES = (LARGEST_LOGIT, EVEN_LOGIT, BOUND, LEAST)
_NO_BOXES = np.zeros((0, 4))


@state_record
class ScoresSeen:
    """The knowledge of scores so far.

    Attributes
    ----------
    scores : (n,) the newest of those that are ranked.
    extent : the least and the greatest score that was ever seen.
    boxes : (m, 4) detections of the last frame.
    chains : theirs, `kernels.detection_scores.Chains`.
    targets : (t, 4) boxes of the targets of the last frame.
    line, away : what is known of (a, b) beside targets, and elsewhere; None before the first
        verdict.
    steady : what chains have shown of lasting false alarms; None before the first frame.
    level : x of the best scores, see `LEVEL_FRAMES`; −∞ before there are any.
    near : how many detections were in the neighbourhood of another, and of how many.
    near_alone : how many of these overlapped none of the frames beside them, and of how many.
    alone : how many detections overlapped none of the frames beside them, and of how many; old ones
        are forgotten.
    """

    scores: F8 = field(default_factory=lambda: np.zeros(0))
    extent: tuple[float, float] = (math.inf, -math.inf)
    boxes: F8 = field(default_factory=lambda: _NO_BOXES)
    chains: Chains = field(
        default_factory=lambda: (
            np.zeros((0, LENGTH)),
            np.zeros((0, LENGTH), np.bool_),
            np.zeros(0, np.int64),
            _NO_SCORES,
        )
    )
    targets: F8 = field(default_factory=lambda: _NO_BOXES)
    line: Line | None = None
    away: Line | None = None
    steady: Steadiness | None = None
    alone: tuple[float, float] = (0.0, FIRST_SEEN)
    near: tuple[float, float] = (0.0, 0.0)
    near_alone: tuple[float, float] = (0.0, 0.0)
    level: float = -math.inf

    @property
    def kind(self) -> int:
        """The scale of scores: probabilities, log odds, or ranked."""
        return _kind_of(*self.extent)


@dataclass(frozen=True, slots=True)
class DetectionScores(Checked, Learning[ScoresSeen]):
    """Settings of what scores are read as before anything is learned.

    Parameters
    ----------
    slope : a of the prior for probabilities: 1 reads a score as one, 0.5 believes it less, 2 more.
    even_score : between 0 and 1, the score that targets and false alarms have equally often, by the
        prior.
    max_odds : the ratio is at most this, and at least one over it.
    usual_alone : the share of detections that overlap none of the frames beside, up to which false
        alarms are as many as the model says.
    """

    slope: Positive = 2.0
    even_score: Positive = 0.65
    max_odds: Positive = 400.0
    usual_alone: Share = 0.2

    def __post_init__(self) -> None:
        Checked.__post_init__(self)
        if not (self.even_score < 1 <= self.max_odds):
            problem = (
                f"expected even_score below 1 and max_odds from 1, got {self.even_score:g} and"
                f" {self.max_odds:g}"
            )
            raise InputError(problem, where="[detection_scores] of kind scores")

    def log_odds(self, score: F8, state: ScoresSeen, boxes: F8 = _NO_BOXES) -> tuple[F8, F8]:
        """Log p(s|target)/p(s|false alarm) of the scores (n,) of a frame, and the same against
        false alarms that last.

        Both (n,), and 0 for NaN and where all scores are the same.

        Parameters
        ----------
        score : (n,) of the detections.
        state : what is known of scores.
        boxes : (n, 4) of the detections, xyxy, pixels; without them none lies beside a target.
        """
        _, kind, x, _, _ = _scaled(state, score)
        limit = math.log(self.max_odds)
        known = kind == state.kind
        slope, offset, deviation = self._line(state.line if known else None, kind)
        away = self._line(state.away if known else None, kind)[:2]
        of_lasting = LASTING_SHARE
        if kind != RANK:
            believed = CLAIMED_SLOPE * self._prior(kind)[0]
            of_lasting = min((slope + SURE * deviation) / believed, 1.0)
        steady = _claimed(kind)
        if state.steady is not None and known:
            steady = state.steady
        found: tuple[F8, F8] = evidence_of(
            x,
            (slope, offset, *away),
            (boxes, state.targets if len(boxes) else _NO_BOXES, BESIDE),
            limit,
            of_lasting,
            kind == RANK,
            tuple(steady[:2]),
        )
        return found

    def _line(self, line: Line | None, kind: int) -> tuple[float, float, float]:
        """a, b, and the standard deviation of a; of the prior if there is no line."""
        if line is None:
            return *self._prior(kind), 1 / math.sqrt(PRIOR_PRECISION[0])
        (p, q), (_, r) = line.precision.tolist()
        first, second = line.information.tolist()
        determinant = p * r - q * q
        slope = max((r * first - q * second) / determinant, 0.0)
        return slope, (p * second - q * first) / determinant, math.sqrt(r / determinant)

    def _prior(self, kind: int) -> tuple[float, float]:
        """a and b of the prior."""
        if kind == LOGIT:
            return 1.0, 0.0
        slope, even = RANKS if kind == RANK else (self.slope, self.even_score)
        return slope, _offset(slope, even)

    def start(self) -> ScoresSeen:
        """No score seen."""
        return ScoresSeen()

    def with_scores(self, state: ScoresSeen, model: Model, detections: Detections) -> Model:
        """The model whose false alarms are weighed by the scores of the detections, and as many as
        this stream shows [PMB (16)].
        """
        single, lasting = self.log_odds(detections.confidence, state, detections.xyxy)
        more = max(state.alone[0] / state.alone[1] / self.usual_alone, 1.0)
        anew = 1.0
        # What a scene has taught of false alarms, or a user says of a frame's, stands.
        clutter = model.clutter
        stated = isinstance(clutter, BoxClutter) and clutter.clutter_per_frame > 0
        if isinstance(clutter, BoxClutter | UniformClutter) and not stated:
            near, seen = state.near
            most = (NEAR_PRIOR * NEAR + near) / (NEAR_PRIOR + seen)
            more *= min(max(most / NEAR, LEAST_NEAR), 1.0)
            anew = min(self._anew(state) / more, 1.0)
        scored = ScoredClutter(
            model.clutter, np.exp(single), lasting, more, anew, self._missing(state)
        )
        return model.with_clutter(scored)

    def _missing(self, state: ScoresSeen) -> tuple[float, float]:
        """`ScoredClutter.missing`, once chains have shown it; ranks claim too little for that."""
        low, high = state.extent
        if state.steady is None or state.kind == RANK or not low < high:
            return 0.0, 0.0
        ended, chains = state.steady.breaks.tolist()
        of_target = ended / chains
        return of_target, of_target + (1 - of_target) * FLICKER

    def _anew(self, state: ScoresSeen) -> float:
        """How many times κ the false alarms are that are new in each frame [PMB (19)]."""
        count, seen = state.near_alone
        usual = self.usual_alone * NEAR
        alone = (ALONE_PRIOR * usual + count) / (ALONE_PRIOR + seen)
        return max(alone / NEAR, LEAST_NEAR)

    def advance(self, state: ScoresSeen, step: Step) -> ScoresSeen:
        """Remember the scores of a frame, prolong the chains, and learn from those on which there
        is a verdict.
        """
        if not step.detections.observed:
            return state
        boxes = step.detections.xyxy
        score = step.detections.confidence
        extent, kind, x, scores, level = _scaled(state, score)
        same = kind == state.kind
        # As plain tuples: Numba looks up the class of every named one.
        prior = _prior_line(*self._prior(kind))
        claimed = tuple(_claimed(kind))
        chains, lines, learned, steady, counts = learned_frame(
            state.boxes,
            boxes,
            x,
            _places(step),
            state.chains,
            (tuple(state.line or prior), tuple(state.away or prior)),
            prior,
            (tuple(state.steady or claimed), claimed),
            (LINKED, float(KEPT), NEAR_ASKED, FLICKER),
            same,
        )
        n = len(state.boxes)
        kept = max(1 - n / KEPT, 0.0)
        alone = kept * state.alone[0] + counts[0], kept * state.alone[1] + n
        line, away = (state.line, state.away) if same else (None, None)
        if learned:
            line, away = Line(*lines[0]), Line(*lines[1])
        return ScoresSeen(
            scores,
            extent,
            boxes,
            chains,
            step.estimates.xyxy,
            line,
            away,
            Steadiness(*steady) if same else None,
            alone,
            _with_neighbours(state.near, *counts[1:3]),
            _with_neighbours(state.near_alone, *counts[3:]),
            level,
        )


def _places(step: Step) -> I8:
    """(t,) the place of the detection that each target of a frame rests on, −1 for none."""
    row = step.detections.row
    detection = step.estimates.detection
    if not len(row) or row[-1] == len(row) - 1:
        return detection
    # Rows are ascending: some detections of the frame are of another pipeline.
    place = np.minimum(row.searchsorted(detection), len(row) - 1)
    return np.where(row[place] == detection, place, -1)


# What follows is the same in nearly every frame, and takes longer than a kernel.
@lru_cache(maxsize=8)
def _kind_of(low: float, high: float) -> int:
    """The scale of scores between these two."""
    return int(levelled(_NO_SCORES, (low, high), -math.inf, _SCALES, (GOOD, LEVEL_FRAMES))[2])


@lru_cache(maxsize=8)
def _claimed(kind: int) -> Steadiness:
    """The claims of scores about lasting false alarms, as the prior of what chains show."""
    claim = (1.0, 0.0)
    if kind == RANK:
        slope, even = RANKS
        claim = (LASTING_SHARE * slope, LASTING_SHARE * _offset(slope, even))
    return Steadiness(PRIOR_PRECISION * claim, _PRECISION, PRIOR_BREAKS)


@lru_cache(maxsize=8)
def _prior_line(slope: float, offset: float) -> tuple[F8, F8, F8]:
    """The columns of `Line` of the prior with these a and b."""
    return PRIOR_PRECISION * (slope, offset), _PRECISION, PRIOR_VERDICTS


def _offset(slope: float, even: float) -> float:
    """b of a line that is 0 at the score ``even``."""
    return -slope * math.log(even / (1 - even))


def _with_neighbours(before: tuple[float, float], count: int, asked: int) -> tuple[float, float]:
    """How many neighbours there were, and of how many detections, with those of a frame."""
    kept = max(1 - asked / KEPT, 0.0)
    return kept * before[0] + count, kept * before[1] + asked


def _scaled(state: ScoresSeen, score: F8) -> tuple[tuple[float, float], int, F8, F8, float]:
    """The extent of all scores, their kind, x of those (n,) of a frame, NaN where they say nothing,
    what is ranked, and the level of the best scores [PMB (17)].
    """
    low, high, kind, x, level = levelled(
        np.ascontiguousarray(score),
        state.extent,
        state.level,
        _SCALES,
        (GOOD, LEVEL_FRAMES),
    )
    if kind != RANK:
        return (low, high), kind, x, state.scores, level
    known = np.concatenate([state.scores, score[~np.isnan(score)]])[-KEPT:]
    if low < high:
        # The mean rank of equal scores; neither 0 nor 1.
        order = np.sort(known)
        below, up_to = (np.searchsorted(order, score, side=side) for side in ("left", "right"))
        share = np.where(np.isnan(score), np.nan, (below + up_to + 1) / (2 * len(order) + 2))
        share = np.clip(share, LEAST, 1 - LEAST)
        x = np.log(share / (1 - share))
    return (low, high), kind, x, known, state.level
