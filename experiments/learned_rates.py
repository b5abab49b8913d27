"""Learning p_D and the false-alarm rate while tracking, from the stream. A section of vo.md.

**p_D** is the share of frames, from one detection of a track to its next, in which it was detected:
n detections over g frames of tracks give n/Σg. Frames before the first and after the last detection
of a track do not count, nor do tracks that never moved: repeated false alarms in one place must not
affect the estimate. **False alarms** are counted by the sum of the false-alarm probabilities of
labelled detections (`experiments.labelling`), and until they are labelled, of the filter's, so that
a very wrong rate is corrected within a few frames. Both are posterior means with a prior around the
setting (Beta for p_D, Gamma for the rate), within limits.

A track that breaks at a long gap hides the gap, so p_D is estimated too high; repeated false alarms
in one place are counted as objects. *Cautious* estimates therefore change only in the other
direction: p_D below its setting, false alarms above theirs.

Learned rates go into the model in steps of a few per cent, so that the parts of a model keep their
values for many frames and derived values are computed once. In real videos both biases are larger
than the gain: vo.md shows the result if everything else is known.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from experiments.labelling import PendingFrames, TrackEvidence, label
from phdtrack.errors import Checked, NonNegative, Positive
from phdtrack.models.box import BoxSensor
from phdtrack.models.clutter import BoxClutter, PlaneClutter, UniformClutter
from phdtrack.models.plane import PlaneSensor
from phdtrack.models.point import PointSensor
from phdtrack.protocols import Learning, Model
from phdtrack.types import F8, I8, Detections, Step

# Weights of the settings as priors: frames of one track; frames; detections, if the rate is per
# detection.
PRIOR_TRACKED = 10.0
PRIOR_FRAMES = 2.0
PRIOR_DETECTIONS = 50.0
# Limits of p_D; of the rate as a multiple of the setting; of a share of the detections.
DETECTION_LIMITS = (0.3, 0.99)
CLUTTER_LIMIT = 300.0
SHARE_LIMITS = (0.01, 1.0)


@dataclass(frozen=True, slots=True)
class RatesSettings(Checked):
    """Which rates are learned while tracking; they start at the other settings. All are reported.

    Parameters
    ----------
    detection : use the learned p_D.
    clutter : use the learned rate of false alarms.
    cautious : use p_D only if it is lower, and the rate of false alarms only if it is higher, than
        the setting.
    memory : seconds after which a frame counts for 37 %.
    verdict_delay : seconds until a detection is labelled, beyond ``associate.output_delay``.
    update_interval : seconds between updates.
    """

    detection: bool = False
    clutter: bool = False
    cautious: bool = True
    memory: Positive = 120.0
    verdict_delay: NonNegative = 1.0
    update_interval: NonNegative = 1.0


@dataclass(frozen=True, slots=True)
class Priors:
    """The settings: p_D, and false alarms per frame, or per detection if ``each`` is True."""

    detection: float
    clutter: float
    each: bool


@dataclass(frozen=True, slots=True)
class Rates:
    """Estimates with frame ``number``, at ``time`` seconds.

    Attributes
    ----------
    detection : p_D.      clutter : false alarms per frame, or per detection if set so.
    limited : names of those that were kept within limits.
    """

    number: int
    time: float
    detection: float
    clutter: float
    limited: tuple[str, ...] = ()


class RateSums(NamedTuple):
    """Sums that fade: ``hits`` in ``span`` frames of tracks; ``false`` alarms among ``detections``
    of ``frames``.
    """

    hits: float = 0.0
    span: float = 0.0
    false: float = 0.0
    detections: float = 0.0
    frames: float = 0.0

    def plus(self, other: RateSums, fade: float = 1.0) -> RateSums:
        """The sum of these sums times ``fade`` and others."""
        return RateSums(*(fade * mine + more for mine, more in zip(self, other, strict=True)))

    def rates(self, priors: Priors) -> Rates:
        """The estimates."""
        detection = (PRIOR_TRACKED * priors.detection + self.hits) / (PRIOR_TRACKED + self.span)
        over = self.frames
        prior = PRIOR_FRAMES
        begun = priors.clutter
        limits = priors.clutter / CLUTTER_LIMIT, max(priors.clutter, 1.0) * CLUTTER_LIMIT
        if priors.each:
            # Of a rate per detection no more than all of them can be false alarms.
            over = self.detections
            prior = PRIOR_DETECTIONS
            begun = min(begun, 1.0)
            limits = SHARE_LIMITS
        found = np.array([detection, (prior * begun + self.false) / (prior + over)])
        kept = np.clip(found, *np.transpose((DETECTION_LIMITS, limits)))
        limited = tuple(
            name for name, out in zip(("detection", "clutter"), found != kept, strict=True) if out
        )
        return Rates(0, 0.0, float(kept[0]), float(kept[1]), limited)


@dataclass(frozen=True, slots=True, eq=False)
class CountedTracks:
    """For tracks ``identity`` (n,), ascending, the ``hits`` and the ``span`` (n,) that the sums
    include.
    """

    identity: I8 = field(default_factory=lambda: np.zeros(0, np.int64))
    hits: F8 = field(default_factory=lambda: np.zeros(0))
    span: F8 = field(default_factory=lambda: np.zeros(0))

    def updated(self, evidence: TrackEvidence) -> tuple[CountedTracks, RateSums]:
        """The confirmed tracks that moved, and their additional counts."""
        moved = evidence.confirmed & evidence.moved()
        identity = evidence.identity[moved]
        hits = (evidence.hits[moved] - 1).astype(np.float64)
        span = (evidence.last[moved] - evidence.first[moved]).astype(np.float64)
        kept = np.isin(self.identity, identity)
        more = float(hits.sum() - self.hits[kept].sum()), float(span.sum() - self.span[kept].sum())
        return CountedTracks(identity, hits, span), RateSums(*more)


@dataclass(frozen=True, slots=True, eq=False)
class LearnedRates:
    """The state: the ``rates`` in use, sums over labelled frames, frames that wait for labels, and
    ``learned``, the time of the last update, NaN before.
    """

    rates: Rates
    sums: RateSums = field(default_factory=RateSums)
    counted: CountedTracks = field(default_factory=CountedTracks)
    pending: PendingFrames = field(default_factory=PendingFrames)
    learned: float = math.nan

    def detections_per_frame(self, now: int) -> float:
        """Mean number of detections with ``now`` in the frame at hand; false alarms cannot be
        more.
        """
        known = self.sums.plus(_waiting(self.pending))
        return (known.detections + now) / (known.frames + 1)


@dataclass(frozen=True, slots=True)
class RatesLearning:
    """Settings of the learning: its options, initial values, and labels ``delay`` seconds late."""

    settings: RatesSettings
    priors: Priors
    delay: float

    def begin(self) -> LearnedRates:
        """The state before the first frame: the settings."""
        return LearnedRates(RateSums().rates(self.priors))

    def advance(self, state: LearnedRates, step: Step) -> LearnedRates:
        """Process one frame, and update the rates if it is time to. Unobserved frames are
        ignored.
        """
        state = replace(state, pending=state.pending.joined(step))
        if math.isnan(state.learned):
            return replace(state, learned=step.time)
        if step.time < state.learned + self.settings.update_interval or not state.pending.frames:
            return state
        pending, labels = label(state.pending, step.time - self.delay, state.rates.detection)
        counted, tracked = state.counted.updated(pending.evidence)
        new = RateSums(
            tracked.hits, tracked.span, float(labels.false.sum()), len(labels.false), labels.frames
        )
        sums = state.sums.plus(new, math.exp(-labels.seconds / self.settings.memory))
        rates = replace(
            sums.plus(_waiting(pending)).rates(self.priors), number=step.number, time=step.time
        )
        return LearnedRates(rates, sums, counted, pending, step.time)


def _waiting(pending: PendingFrames) -> RateSums:
    """Sums over the frames that wait for labels, by the filter's probabilities."""
    false = [frame.false for frame in pending.frames]
    return RateSums(
        false=sum(float(f.sum()) for f in false), detections=sum(map(len, false)), frames=len(false)
    )


# p_D goes into the model in steps of this size, rates in steps of this ratio.
DETECTION_STEP = 0.01
RATE_RATIO = 1.05
# The parts of a model with a number that can be learned, and its names: of several, the one that is
# not 0.
LEARNABLE: dict[type[Any], tuple[str, ...]] = {
    **dict.fromkeys((BoxSensor, PlaneSensor, PointSensor), ("detection_probability",)),
    UniformClutter: ("clutter_per_frame",),
    BoxClutter: ("clutter_per_detection", "clutter_per_frame"),
    PlaneClutter: ("density", "clutter_per_detection", "clutter_per_frame"),
}


@dataclass(frozen=True, slots=True, eq=False)
class RateLearning(Learning[LearnedRates]):
    """Learning rates while tracking by a ``rule``."""

    rule: RatesLearning

    def start(self) -> LearnedRates:
        """The state before the first frame."""
        return self.rule.begin()

    def model(self, state: LearnedRates, model: Model) -> Model:
        """The model with the rates in use; cautious ones only if nothing else explains them."""
        used = self.rule.settings
        found = state.rates
        priors = self.rule.priors
        detection = found.detection
        clutter = found.clutter
        if used.cautious:
            detection = min(detection, priors.detection)
            clutter = max(clutter, priors.clutter)
        if used.detection:
            model = replace(
                model,
                sensor=with_rate(model.sensor, DETECTION_STEP * round(detection / DETECTION_STEP)),
            )
        if used.clutter:
            model = replace(
                model, clutter=with_rate(model.clutter, _rounded(clutter, priors.clutter))
            )
        return model

    def with_scores(self, state: LearnedRates, model: Model, detections: Detections) -> Model:
        """The model with at most as many false alarms as the frame has detections: the only initial
        information.
        """
        used = self.rule.settings
        priors = self.rule.priors
        if len(detections) == 0 or not used.clutter or used.cautious or priors.each:
            return model
        rate = min(state.rates.clutter, state.detections_per_frame(len(detections)))
        return replace(model, clutter=with_rate(model.clutter, _rounded(rate, priors.clutter)))

    def advance(self, state: LearnedRates, step: Step) -> LearnedRates:
        """The state after a frame."""
        return self.rule.advance(state, step)


def priors_of(model: Model) -> Priors:
    """The rates of a model; 0, or p_D = 1, of parts that have none."""
    clutter = _name(model.clutter)
    detection = getattr(model.sensor, _name(model.sensor), 1.0)
    return Priors(
        detection, getattr(model.clutter, clutter, 0.0), clutter == "clutter_per_detection"
    )


def _name(part: Any) -> str:
    """The name of the learnable number of a model's part; empty if it has none."""
    names = next((names for kind, names in LEARNABLE.items() if isinstance(part, kind)), ("",))
    return next((name for name in names[:-1] if getattr(part, name)), names[-1])


def with_rate(part: Any, value: float) -> Any:
    """A part of a model with its number changed; the part itself if it has none."""
    name = _name(part)
    return _changed(part, name, value) if name else part


@lru_cache(maxsize=256)
def _changed(part: Any, name: str, value: float) -> Any:
    """A part with one number changed; the same object for the same number."""
    return part if getattr(part, name) == value else replace(part, **{name: value})


def _rounded(value: float, about: float) -> float:
    """The nearest ``about`` times a power of `RATE_RATIO`; ``value`` itself if one of them is 0."""
    if value <= 0 or about <= 0:
        return value
    return about * RATE_RATIO ** round(math.log(value / about, RATE_RATIO))
