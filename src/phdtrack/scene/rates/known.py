"""What frames have told of the rates: sums that fade, and the estimates that they and the settings give.

p_D is the share of frames, from one detection of a track to its next, in which it was detected: each next detection ends a
wait of g frames with probability p_D (1 − p_D)^(g−1), so that n of them over Σg frames say n/Σg. What was before the first
and after the last detection of a track does not count: nobody knows whether there was somebody. Tracks that never went
anywhere do not count either: a place that fires now and then must not teach how often objects are seen.

The false alarms of a frame are those among its detections, a sum of probabilities (the E-step of EM for κ's rate). Births
are the first states of tracks that were believed later.

Both err to one side where objects are not as the model has them. A track that breaks at a long gap hides the gap, so that
p_D comes out too high; false alarms that come again in one place pass for objects, so that their rate comes out too low; who
was never believed is not among the births, and with fewer births fewer are believed. Who is ``cautious`` (`Rates.cautious`)
therefore follows only what cannot be explained so: p_D below the setting, false alarms and births above it.

Every estimate is the mean under a prior about the setting (Beta for p_D, Gamma for rates) that is worth a stated number of
frames, detections or seconds, and it is kept within limits.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from phdtrack.scene.rates.noise import Noise
from phdtrack.scene.sightings import Sightings
from phdtrack.types import F8, I8

# What the settings are worth: frames of one track; frames, or detections where a rate is one of each; births.
TRACKED, WATCHED, DETECTED, BORN = 10.0, 2.0, 50.0, 5.0
# Limits of p_D; of the rates as multiples of the settings; of a share of the detections.
DETECTION = (0.3, 0.99)
CLUTTER, BIRTHS = 300.0, 30.0
SHARE = (0.01, 1.0)


@dataclass(frozen=True, slots=True)
class Priors:
    """The settings: p_D, false alarms and births per time unit, each of a frame or (``each``) around every detection; noises
    of boxes, where the model has them as shares of the size."""

    detection: float
    clutter: float
    births: float
    clutter_each: bool
    births_each: bool
    noise: Noise = field(default_factory=Noise)


@dataclass(frozen=True, slots=True)
class Rates:
    """What is believed with frame ``number``, at ``time`` seconds.

    ``detection`` p_D; ``clutter`` false alarms a frame, ``births`` a time unit, or both around each detection where the
    model has them so. ``noise`` of measurements and motion. ``lowest`` and ``highest``: what the worst and the best score
    are worth, p(s|object)/p(s|false alarm).
    ``limited``: the names of those that were kept within limits.
    """

    number: int
    time: float
    detection: float
    clutter: float
    births: float
    noise: Noise = field(default_factory=Noise)
    lowest: float = 1.0
    highest: float = 1.0
    limited: tuple[str, ...] = ()

    def cautious(self, priors: Priors) -> Rates:
        """With p_D at most, and the rates of false alarms and births at least, as they are set."""
        return replace(
            self,
            detection=min(self.detection, priors.detection),
            clutter=max(self.clutter, priors.clutter),
            births=max(self.births, priors.births),
        )


@dataclass(frozen=True, slots=True)
class Known:
    """Sums that fade: ``hits`` of ``span`` frames of tracks; ``false`` alarms among ``detections`` of ``frames``; ``births``
    in ``units`` of time, in which there were ``chances``, the sum of detections times units."""

    hits: float = 0.0
    span: float = 0.0
    false: float = 0.0
    detections: float = 0.0
    frames: float = 0.0
    births: float = 0.0
    units: float = 0.0
    chances: float = 0.0

    def faded(self, factor: float) -> Known:
        """All of it worth so much less."""
        return Known(*(factor * value for value in (
            self.hits, self.span, self.false, self.detections, self.frames, self.births, self.units, self.chances
        )))  # fmt: skip

    def rates(self, priors: Priors, noise: Noise, odds: tuple[float, float], number: int, time: float) -> Rates:
        """The estimates, beside those of noises and odds."""
        limited = list[str]()
        worth = TRACKED * priors.detection
        detection = (worth + self.hits) / (TRACKED + self.span)
        detection = _within(detection, *DETECTION, "detection", limited)
        over, least = (self.detections, DETECTED) if priors.clutter_each else (self.frames, WATCHED)
        # Of a rate around each detection no more than all of them can be false alarms.
        begun = min(priors.clutter, 1.0) if priors.clutter_each else priors.clutter
        clutter = (least * begun + self.false) / (least + over)
        low, high = SHARE if priors.clutter_each else (priors.clutter / CLUTTER, max(priors.clutter, 1.0) * CLUTTER)
        clutter = _within(clutter, low, high, "clutter", limited)
        births = priors.births
        if births > 0:
            chances = self.chances if priors.births_each else self.units
            births = _within(
                (BORN + self.births) / (BORN / births + chances), births / BIRTHS, births * BIRTHS, "births", limited
            )
        return Rates(number, time, detection, clutter, births, noise, *odds, tuple(limited))


def _within(value: float, low: float, high: float, name: str, limited: list[str]) -> float:
    """The value in its limits; its name goes down where they hold it."""
    if not low <= value <= high:
        limited.append(name)
    return min(max(value, low), high)


@dataclass(frozen=True, slots=True, eq=False)
class Counted:
    """Of tracks ``identity`` (n,), ascending, the ``hits`` and the ``span`` (n,) that were taken into account."""

    identity: I8 = field(default_factory=lambda: np.zeros(0, np.int64))
    hits: F8 = field(default_factory=lambda: np.zeros(0))
    span: F8 = field(default_factory=lambda: np.zeros(0))

    def counting(self, known: Known, sightings: Sightings) -> tuple[Counted, Known]:
        """With what confirmed tracks that went somewhere have told since."""
        moved = sightings.confirmed & sightings.went()
        identity = sightings.identity[moved]
        hits = (sightings.hits[moved] - 1).astype(np.float64)
        span = (sightings.last[moved] - sightings.first[moved]).astype(np.float64)
        kept = np.isin(self.identity, identity)
        place = np.searchsorted(identity, self.identity[kept])
        more_hits, more_span = hits.copy(), span.copy()
        more_hits[place] -= self.hits[kept]
        more_span[place] -= self.span[kept]
        grown = replace(known, hits=known.hits + float(more_hits.sum()), span=known.span + float(more_span.sum()))
        return Counted(identity, hits, span), grown
