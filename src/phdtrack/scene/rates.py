"""Rates that are learned from the stream: p_D, false alarms, births, and what the detector's scores say.

**p_D** is the share of frames, from one detection of a track to its next, in which it was detected: n detections over g
frames of tracks say n/Σg. Frames before the first and after the last detection of a track do not count, nor do tracks that
never moved: a place that fires now and then must not teach how often objects are detected. **False alarms** are the sum of
the probabilities of labelled detections to be false (`scene.labelling`), and until they are labelled, those of the filter,
so that a rate that is far off is corrected within a few frames. **Births** are the first states of tracks of objects. Every
estimate is the mean under a prior about the setting (Beta for p_D, Gamma for rates) and is kept within limits.

A track that breaks at a long gap hides the gap, so that p_D comes out too high; false alarms that return in one place pass
for objects; an object that was never confirmed is not among the births. *Cautious* estimates therefore only go to the other
side: p_D below its setting, false alarms and births above theirs.

**Scores** are used by rank. They are cut into parts of equally many detections; in each part the share of false alarms is
estimated, and shares must fall with the score (isotonic regression by pooling adjacent violators). The score of one frame
resembles that of the next, so that n frames say as much as n (1 − ρ)/(1 + ρ) independent ones, with ρ the rank correlation
of successive scores of a track; the logarithm of the likelihood ratio is multiplied by that share.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from phdtrack.errors import Checked, NonNegative, Positive
from phdtrack.scene.labelling import PendingFrames, TrackEvidence, label
from phdtrack.types import F8, I8, Step, Tracks

# What the settings count for: frames of one track; frames; detections, where a rate is per detection; births.
PRIOR_TRACKED, PRIOR_FRAMES, PRIOR_DETECTIONS, PRIOR_BIRTHS = 10.0, 2.0, 50.0, 5.0
# Limits of p_D; of the rates as multiples of the settings; of a share of the detections.
DETECTION_LIMITS, CLUTTER_LIMIT, BIRTH_LIMIT, SHARE_LIMITS = (0.3, 0.99), 300.0, 30.0, (0.01, 1.0)
# Parts that the scores are cut into, and detections of the average that each has besides its own; newest detections kept.
SCORE_PARTS, PRIOR_SCORES, MAX_SCORES = 12, 8.0, 1500
# Pairs of successive scores that the prior correlation of 1 counts for; the largest evidence of one score, nats.
PRIOR_PAIRS, MAX_LOG_RATIO = 30.0, math.log(30.0)


@dataclass(frozen=True, slots=True)
class RatesSettings(Checked):
    """Rates that are learned while tracking, beginning with the other settings. All are reported; see which are used.

    Parameters
    ----------
    detection : use the p_D that is learned.
    clutter : use the rate of false alarms that is learned.
    birth : use the rate of births that is learned.
    scores : use how much likelier each score is among objects than among false alarms.
    cautious : use p_D only where it is lower, and rates of false alarms and births only where they are higher, than is set.
    memory : seconds after which a frame counts for 37 %.
    verdict_delay : seconds until a detection is labelled, beyond ``associate.output_delay``.
    update_interval : seconds between two times of learning.
    """

    detection: bool = False
    clutter: bool = False
    birth: bool = False
    scores: bool = True
    cautious: bool = True
    memory: Positive = 120.0
    verdict_delay: NonNegative = 1.0
    update_interval: NonNegative = 1.0


@dataclass(frozen=True, slots=True)
class Priors:
    """The settings: p_D, false alarms per frame and births per time unit; both per detection where ``each`` says so."""

    detection: float
    clutter: float
    births: float
    clutter_each: bool
    births_each: bool


@dataclass(frozen=True, slots=True)
class Rates:
    """Estimates with frame ``number``, at ``time`` seconds.

    Attributes
    ----------
    detection : p_D.      clutter : false alarms per frame.      births : per time unit; both per detection if set so.
    lowest, highest : likelihood ratio p(s|object)/p(s|false alarm) of the worst and of the best score.
    limited : names of those that were kept within limits.
    """

    number: int
    time: float
    detection: float
    clutter: float
    births: float
    lowest: float = 1.0
    highest: float = 1.0
    limited: tuple[str, ...] = ()


class RateSums(NamedTuple):
    """Sums that fade: ``hits`` in ``span`` frames of tracks; ``false`` alarms among ``detections`` of ``frames``; ``births``
    in ``units`` of time, and ``chances``, the sum of detections times units."""

    hits: float = 0.0
    span: float = 0.0
    false: float = 0.0
    detections: float = 0.0
    frames: float = 0.0
    births: float = 0.0
    units: float = 0.0
    chances: float = 0.0

    def plus(self, other: RateSums, fade: float = 1.0) -> RateSums:
        """These sums times ``fade``, and others."""
        return RateSums(*(fade * mine + more for mine, more in zip(self, other, strict=True)))

    def rates(self, priors: Priors) -> Rates:
        """The estimates of p_D and of the rates."""
        detection = (PRIOR_TRACKED * priors.detection + self.hits) / (PRIOR_TRACKED + self.span)
        over, prior, begun = self.frames, PRIOR_FRAMES, priors.clutter
        limits = priors.clutter / CLUTTER_LIMIT, max(priors.clutter, 1.0) * CLUTTER_LIMIT
        if priors.clutter_each:
            # Of a rate per detection no more than all of them can be false alarms.
            over, prior, begun, limits = self.detections, PRIOR_DETECTIONS, min(begun, 1.0), SHARE_LIMITS
        clutter, births = (prior * begun + self.false) / (prior + over), priors.births
        if births > 0:
            exposure = self.chances if priors.births_each else self.units
            births = (PRIOR_BIRTHS + self.births) / (PRIOR_BIRTHS / births + exposure)
        found = np.array([detection, clutter, births])
        allowed = (DETECTION_LIMITS, limits, (priors.births / BIRTH_LIMIT, priors.births * BIRTH_LIMIT))
        kept = np.clip(found, *np.transpose(allowed))
        names = ("detection", "clutter", "births")
        limited = tuple(name for name, out in zip(names, found != kept, strict=True) if out)
        return Rates(0, 0.0, float(kept[0]), float(kept[1]), float(kept[2]), limited=limited)


@dataclass(frozen=True, slots=True, eq=False)
class CountedTracks:
    """Of tracks ``identity`` (n,), ascending, the ``hits`` and the ``span`` (n,) that are in the sums."""

    identity: I8 = field(default_factory=lambda: np.zeros(0, np.int64))
    hits: F8 = field(default_factory=lambda: np.zeros(0))
    span: F8 = field(default_factory=lambda: np.zeros(0))

    def updated(self, evidence: TrackEvidence) -> tuple[CountedTracks, RateSums]:
        """The confirmed tracks that moved, and what they say beyond what was counted."""
        moved = evidence.confirmed & evidence.moved()
        identity = evidence.identity[moved]
        hits = (evidence.hits[moved] - 1).astype(np.float64)
        span = (evidence.last[moved] - evidence.first[moved]).astype(np.float64)
        kept = np.isin(self.identity, identity)
        more = float(hits.sum() - self.hits[kept].sum()), float(span.sum() - self.span[kept].sum())
        return CountedTracks(identity, hits, span), RateSums(*more)


@dataclass(frozen=True, slots=True, eq=False)
class ScoreScale:
    """Likelihood ratios of scores: ``log_ratio`` (k,) of p(s|object)/p(s|false alarm) at the scores ``at`` (k,), both
    ascending; linear between them, constant beyond. Without any, every ratio is 1."""

    at: F8 = field(default_factory=lambda: np.zeros(0))
    log_ratio: F8 = field(default_factory=lambda: np.zeros(0))

    def ratio(self, score: F8) -> F8:
        """(N,) p(s|object)/p(s|false alarm) of scores (N,); 1 for NaN."""
        if len(self.at) < 2:
            return np.ones(len(score))
        near = np.clip(score, self.at[0], self.at[-1])
        return np.where(np.isnan(score), 1.0, np.exp(np.interp(near, self.at, self.log_ratio)))

    @classmethod
    def learned(cls, labelled: F8, share: float = 1.0) -> ScoreScale:
        """From scores and the chance that each was a false alarm (2, n); a frame of a track is a ``share`` of a new one."""
        from scipy.optimize import isotonic_regression

        score, false = labelled[:, np.argsort(labelled[0], kind="stable")]
        n = len(score)
        if n == 0 or score[0] == score[-1]:
            return cls()
        wanted = np.unique(np.ceil(np.arange(1, SCORE_PARTS + 1) * n / SCORE_PARTS).astype(np.int64))
        # Equal scores are in one part.
        ends = np.unique(np.searchsorted(score, score[wanted - 1], side="right"))
        begins = np.append(0, ends[:-1])
        count = ends - begins + PRIOR_SCORES
        mean = (float(false.sum()) + 0.5) / (n + 1)
        share_false = (np.add.reduceat(false, begins) + PRIOR_SCORES * mean) / count
        falling = isotonic_regression(share_false, weights=count, increasing=False).x
        log_ratio = np.log((1 - falling) / falling) - math.log((1 - mean) / mean)
        finite = score[np.isfinite(score)]
        ends_at = (float(finite[0]), float(finite[-1])) if len(finite) else (0.0, 0.0)
        at = np.clip(score, *ends_at)[(begins + ends - 1) // 2]
        return cls(at, share * np.clip(log_ratio, -MAX_LOG_RATIO, MAX_LOG_RATIO))


@dataclass(frozen=True, slots=True, eq=False)
class SuccessiveScores:
    """Scores ``first`` and ``second`` (n,) of successive detections of tracks; of the tracks of late, ``identity`` (m,)
    ascending, the ``last`` (m,) score."""

    first: F8 = field(default_factory=lambda: np.zeros(0))
    second: F8 = field(default_factory=lambda: np.zeros(0))
    identity: I8 = field(default_factory=lambda: np.zeros(0, np.int64))
    last: F8 = field(default_factory=lambda: np.zeros(0))

    def joined(self, rows: Tracks, score: F8) -> SuccessiveScores:
        """With more rows of tracks and the scores (n,) of their detections. Only the newest pairs are kept."""
        order = np.lexsort((rows.frame, rows.identity))
        track, value = np.append(self.identity, rows.identity[order]), np.append(self.last, score[order])
        order = np.argsort(track, kind="stable")
        track, value = track[order], value[order]
        ends = np.diff(track, append=-1) != 0
        known = ~ends[:-1] & ~np.isnan(value[1:]) & ~np.isnan(value[:-1])
        kept = ends & np.isin(track, rows.identity) if len(rows) else ends
        first = np.append(self.first, value[:-1][known])[-MAX_SCORES:]
        second = np.append(self.second, value[1:][known])[-MAX_SCORES:]
        return SuccessiveScores(first, second, track[kept], value[kept])

    @property
    def share(self) -> float:
        """(1 − ρ)/(1 + ρ), the part of an independent frame that each frame of a track counts for."""
        n = len(self.first)
        _, place, count = np.unique(np.append(self.first, self.second), return_inverse=True, return_counts=True)
        if len(count) < 2:
            return 0.0
        rank = (np.cumsum(count) - 0.5 * count)[place] / (2 * n) - 0.5
        alike = float(rank[:n] @ rank[n:] / (0.5 * rank @ rank))
        correlation = max(0.0, (n * alike + PRIOR_PAIRS) / (n + PRIOR_PAIRS))
        return (1 - correlation) / (1 + correlation)


@dataclass(frozen=True, slots=True, eq=False)
class LearnedRates:
    """What is known: the ``rates`` in use, sums over labelled frames, frames that wait for labels, ``labelled`` scores with
    the chance that each is a false alarm (2, n), and ``learned``, the time when something was last learned, NaN before."""

    rates: Rates
    sums: RateSums = field(default_factory=RateSums)
    counted: CountedTracks = field(default_factory=CountedTracks)
    pending: PendingFrames = field(default_factory=PendingFrames)
    labelled: F8 = field(default_factory=lambda: np.zeros((2, 0)))
    successive: SuccessiveScores = field(default_factory=SuccessiveScores)
    scale: ScoreScale = field(default_factory=ScoreScale)
    learned: float = math.nan

    def detections_per_frame(self, now: int) -> float:
        """Mean number of detections with ``now`` in the frame at hand; false alarms cannot be more."""
        known = self.sums.plus(_waiting(self.pending))
        return (known.detections + now) / (known.frames + 1)


@dataclass(frozen=True, slots=True)
class RatesLearning:
    """How rates are learned: by which settings, from which values, with ``rate`` time units per second and labels ``delay``
    seconds late."""

    settings: RatesSettings
    priors: Priors
    rate: float
    delay: float

    def begin(self) -> LearnedRates:
        """Knowing the settings."""
        return LearnedRates(RateSums().rates(self.priors))

    def advance(self, state: LearnedRates, step: Step) -> LearnedRates:
        """Take in one frame, and learn when it is time to. Frames that were not observed teach nothing."""
        state = replace(state, pending=state.pending.joined(step))
        if math.isnan(state.learned):
            return replace(state, learned=step.time)
        before = state.pending.frames
        if step.time < state.learned + self.settings.update_interval or not before:
            return state
        successive = _with_successive(state)
        pending, labels = label(state.pending, step.time - self.delay, state.rates.detection)
        number, units, frames = len(labels.false), labels.seconds * self.rate, labels.frames
        counted, tracked = state.counted.updated(pending.evidence)
        new = RateSums(
            tracked.hits, tracked.span, float(labels.false.sum()), number, frames,
            labels.births, units, number * units / max(frames, 1),
        )  # fmt: skip
        sums = state.sums.plus(new, math.exp(-labels.seconds / self.settings.memory))
        labelled, scale = state.labelled, state.scale
        if frames:
            score = np.concatenate([frame.score for frame in before[:frames]])
            known = np.stack([score, labels.false])[:, ~np.isnan(score)]
            labelled = np.hstack([labelled, known])[:, -MAX_SCORES:]
            scale = ScoreScale.learned(labelled, successive.share)
        lowest, highest = np.exp(scale.log_ratio[[0, -1]]).tolist() if len(scale.at) > 1 else (1.0, 1.0)
        rates = sums.plus(_waiting(pending)).rates(self.priors)
        rates = replace(rates, number=step.number, time=step.time, lowest=lowest, highest=highest)
        return LearnedRates(rates, sums, counted, pending, labelled, successive, scale, step.time)


def _with_successive(state: LearnedRates) -> SuccessiveScores:
    """With the scores of the detections of confirmed rows that were not counted before."""
    frames, counted = state.pending.frames, state.pending.counted
    number = np.array([frame.number for frame in frames], np.int64)
    rows = Tracks.concatenate([frame.rows for frame in frames[counted:]])
    rows = rows.take((rows.detection >= 0) & rows.confirmed & np.isin(rows.frame, number))
    start = np.cumsum([0, *(len(frame.score) for frame in frames)])
    score = np.concatenate([frame.score for frame in frames])[start[np.searchsorted(number, rows.frame)] + rows.detection]
    return state.successive.joined(rows, score)


def _waiting(pending: PendingFrames) -> RateSums:
    """Sums over the frames that wait for labels, by the filter's probabilities."""
    false = [frame.false for frame in pending.frames]
    return RateSums(false=sum(float(f.sum()) for f in false), detections=sum(map(len, false)), frames=len(false))
