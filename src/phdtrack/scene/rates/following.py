"""Following the rates of a stream: frames wait until it is known what became of their detections, then they are counted.

The filter's own probabilities κ/(κ + C) stand for the detections of frames that are not judged yet, so that a rate of false
alarms that is far off is mended within a few frames; judged ones (`context.verdict`) replace them. Everything is a value.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from phdtrack.scene.rates.known import Counted, Known, Priors, Rates
from phdtrack.scene.rates.noise import Moments
from phdtrack.scene.rates.scores import Judged, Scale, Successive, scale
from phdtrack.scene.verdict import Verdict, Watch, judged, look_of
from phdtrack.types import F8, Step, Tracks


@dataclass(frozen=True, slots=True)
class Learns:
    """Which of the estimates are used; the others are made all the same, and the settings hold."""

    detection: bool = True
    clutter: bool = True
    births: bool = True
    scores: bool = True
    noise: bool = False


@dataclass(frozen=True, slots=True)
class Following:
    """How rates are followed: ``rate`` time units a second; ``memory`` seconds after which a frame counts for 37 %; ``wait``
    seconds until a detection is judged; ``every`` so many seconds something is learned; ``cautious``: see `rates.known`."""

    priors: Priors
    rate: float
    memory: float
    wait: float
    every: float
    learns: Learns = Learns()
    cautious: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Learned:
    """What is known: sums over judged frames, the frames that wait and their scores, and the ``rates`` in use.

    ``learned``: when something was last learned, NaN before.
    """

    rates: Rates
    known: Known = field(default_factory=Known)
    counted: Counted = field(default_factory=Counted)
    watch: Watch = field(default_factory=Watch)
    scores: tuple[F8, ...] = ()
    judged: Judged = field(default_factory=Judged)
    successive: Successive = field(default_factory=Successive)
    scale: Scale = field(default_factory=Scale)
    moments: Moments = field(default_factory=Moments)
    learned: float = math.nan

    def most(self, now: int) -> float:
        """Detections a frame, ``now`` in the one at hand: false alarms cannot be more."""
        known = _waiting(self.known, self.watch)
        return (known.detections + now) / (known.frames + 1)


def begin(rule: Following) -> Learned:
    """Knowing what the settings say."""
    return Learned(Known().rates(rule.priors, rule.priors.noise, (1.0, 1.0), 0, 0.0))


def advance(rule: Following, state: Learned, step: Step) -> Learned:
    """Take in one frame, and learn where it is time to. Frames that nobody observed teach nothing."""
    if step.detections.observed:
        looks = (*state.watch.looks, look_of(step))
        scores = (*state.scores, step.detections.confidence)
        state = replace(state, watch=replace(state.watch, looks=looks), scores=scores)
    if math.isnan(state.learned):
        return replace(state, learned=step.time)
    if step.time < state.learned + rule.every or not state.watch.looks:
        return state
    state = replace(state, successive=_followed(state))
    looks = state.watch.looks
    watch, verdict = judged(state.watch, step.time - rule.wait, state.rates.detection, rule.rate)
    state = replace(state, moments=state.moments.joined(looks, verdict.frames, rule.rate))
    return _learned(rule, replace(state, watch=watch, learned=step.time), verdict, step)


def _learned(rule: Following, state: Learned, verdict: Verdict, step: Step) -> Learned:
    """With what a verdict told."""
    many, frames = len(verdict.false), verdict.frames
    counted, known = state.counted.counting(
        state.known.faded(math.exp(-verdict.seconds / rule.memory)), state.watch.sightings
    )
    units = verdict.seconds * rule.rate
    known = Known(
        known.hits,
        known.span,
        known.false + float(verdict.false.sum()),
        known.detections + many,
        known.frames + frames,
        known.births + verdict.births.shape[1],
        known.units + units,
        known.chances + many * units / max(frames, 1),
    )
    told, table = state.judged, state.scale
    if frames:
        told = told.joined(np.concatenate(state.scores[:frames]), verdict.false)
        table = scale(told, state.successive.share)
    ends = (float(np.exp(table.worth[0])), float(np.exp(table.worth[-1]))) if len(table.at) > 1 else (1.0, 1.0)
    noise = state.moments.noise(rule.priors.noise)
    rates = _waiting(known, state.watch).rates(rule.priors, noise, ends, step.number, step.time)
    return replace(state, rates=rates, known=known, counted=counted, scores=state.scores[frames:], judged=told, scale=table)


def _followed(state: Learned) -> Successive:
    """With the scores of the detections that confirmed rows not met before rest on."""
    looks, met = state.watch.looks, state.watch.met
    number = np.array([look.number for look in looks], np.int64)
    rows = Tracks.concatenate([look.rows for look in looks[met:]])
    rows = rows.take((rows.detection >= 0) & rows.confirmed & np.isin(rows.frame, number))
    many = np.array([len(score) for score in state.scores], np.int64)
    start = np.cumsum(many) - many
    score = np.concatenate([*state.scores, np.zeros(0)])[start[np.searchsorted(number, rows.frame)] + rows.detection]
    return state.successive.joined(rows.identity, rows.frame, score)


def _waiting(known: Known, watch: Watch) -> Known:
    """With the frames that wait, by what the filter thought of their detections."""
    return replace(
        known,
        false=known.false + sum(float(look.chance.sum()) for look in watch.looks),
        detections=known.detections + sum(len(look.chance) for look in watch.looks),
        frames=known.frames + len(watch.looks),
    )
