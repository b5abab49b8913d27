"""Learning rates while tracking (`scene.rates`) as a stage of the loop.

Learned rates go into the model in steps of a few per cent, so that the parts of a model stay the same values for many frames
and what is computed of them is computed once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

from phdtrack.models.box import BoxSensor
from phdtrack.models.clutter import BoxClutter, PlaneClutter, UniformClutter
from phdtrack.models.plane import PlaneSensor
from phdtrack.models.point import PointSensor
from phdtrack.protocols import Learning, Model
from phdtrack.scene.rates import LearnedRates, Priors, RatesLearning
from phdtrack.types import Detections, Step

# p_D goes into the model in steps of this size, rates in steps of this ratio.
DETECTION_STEP, RATE_RATIO = 0.01, 1.05
# The parts of a model with a number that can be learned, and its names: of several, the one that is not 0.
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
        """Before the first frame."""
        return self.rule.begin()

    def model(self, state: LearnedRates, model: Model) -> Model:
        """The model with the rates that are used; cautious ones only where nothing else explains them."""
        used, found, priors = self.rule.settings, state.rates, self.rule.priors
        detection, clutter = found.detection, found.clutter
        if used.cautious:
            detection, clutter = min(detection, priors.detection), max(clutter, priors.clutter)
        if used.detection:
            model = replace(model, sensor=with_rate(model.sensor, DETECTION_STEP * round(detection / DETECTION_STEP)))
        if used.clutter:
            model = replace(model, clutter=with_rate(model.clutter, _rounded(clutter, priors.clutter)))
        return model

    def with_scores(self, state: LearnedRates, model: Model, detections: Detections) -> Model:
        """The model with no more false alarms than the frame has detections, which at first is all that is known."""
        used, priors = self.rule.settings, self.rule.priors
        if len(detections) == 0 or not used.clutter or used.cautious or priors.each:
            return model
        rate = min(state.rates.clutter, state.detections_per_frame(len(detections)))
        return replace(model, clutter=with_rate(model.clutter, _rounded(rate, priors.clutter)))

    def advance(self, state: LearnedRates, step: Step) -> LearnedRates:
        """Take in one frame."""
        return self.rule.advance(state, step)


def priors_of(model: Model) -> Priors:
    """The rates of a model; 0, or p_D = 1, of parts that have none."""
    clutter = _name(model.clutter)
    detection = getattr(model.sensor, _name(model.sensor), 1.0)
    return Priors(detection, getattr(model.clutter, clutter, 0.0), clutter == "clutter_per_detection")


def _name(part: Any) -> str:
    """The name of the number of a part of a model that can be learned; empty for none."""
    names = next((names for kind, names in LEARNABLE.items() if isinstance(part, kind)), ("",))
    return next((name for name in names[:-1] if getattr(part, name)), names[-1])


def with_rate(part: Any, value: float) -> Any:
    """A part of a model with its number changed; itself where it cannot be learned."""
    name = _name(part)
    return _changed(part, name, value) if name else part


@lru_cache(maxsize=256)
def _changed(part: Any, name: str, value: float) -> Any:
    """A part with one number changed; the same object for the same number."""
    return part if getattr(part, name) == value else replace(part, **{name: value})


def _rounded(value: float, about: float) -> float:
    """The nearest ``about`` times a power of `RATE_RATIO`; ``value`` itself where one of them is 0."""
    if value <= 0 or about <= 0:
        return value
    return about * RATE_RATIO ** round(math.log(value / about, RATE_RATIO))
