"""Learning while tracking as stages of the loop: the scene (`scene.online`) and the rates (`scene.rates`).

The scene is learned from a *shadow tracker*, a second run over the same frames that does not use what is learned. A run that
learned from itself would doubt a target that stands where a false alarm came, learn it as false, and doubt it more. While
nothing is in use the tracks are those of a run that does not learn.

Learned rates go into the model in steps of a few per cent, so that the parts of a model stay the same values for many frames
and what is computed of them is computed once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from phdtrack.models.births import MeasurementBirth, PlaneBirth, PointBirth
from phdtrack.models.box import BoxSensor
from phdtrack.models.clutter import BoxClutter, PlaneClutter, ScoredClutter, UniformClutter
from phdtrack.models.plane import PlaneSensor
from phdtrack.models.point import PointSensor
from phdtrack.models.scene import not_standing, with_scene
from phdtrack.models.scores import ScoresSeen
from phdtrack.protocols import Birth, Clutter, Learning, Model
from phdtrack.scene import Scene
from phdtrack.scene.online import OnlineLearning, OnlineScene
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
    **dict.fromkeys((MeasurementBirth, PlaneBirth), ("births_per_detection", "births_per_second")),
    PointBirth: ("births_per_second",),
}


@dataclass(frozen=True, slots=True, eq=False)
class SceneState:
    """What is ``known``, the state of the ``shadow`` tracker, and births and false alarms in use, None for the model's."""

    known: OnlineScene
    shadow: Any = None
    birth: Birth | None = None
    clutter: Clutter | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SceneLearning(Learning[SceneState]):
    """Learning births and false alarms while tracking.

    Attributes
    ----------
    rule : how the scene is learned.      default : the model to which what is learned is added.
    shadow : what is learned from, a `pipeline.ShadowTracker`.      particles : Jmax, see `SceneBirth`.
    scenes : what was learned before, one for each regime.
    """

    rule: OnlineLearning
    default: Model
    shadow: Any
    particles: int = 500
    scenes: tuple[Scene, ...] = ()

    def start(self) -> SceneState:
        """Before the first frame."""
        return self._in_use(self.rule.begin(self.scenes), self.shadow.start())

    def model(self, state: SceneState, model: Model) -> Model:
        """The model with what is in use. Raises `InputError` where the camera moves: what is learned lies at pixels."""
        if len(model.warp):
            raise not_standing("learning where false alarms and entrances are")
        if state.birth is None and state.clutter is None:
            return model
        return replace(model, birth=state.birth or model.birth, clutter=state.clutter or model.clutter)

    def advance(self, state: SceneState, step: Step) -> SceneState:
        """Take in one frame."""
        shadow, seen = self.shadow.advance(state.shadow, step)
        known = self.rule.advance(state.known, seen)
        if known.last is state.known.last:
            return SceneState(known, shadow, state.birth, state.clutter)
        return self._in_use(known, shadow)

    def mode(self, state: SceneState, name: str) -> SceneState:
        """With the regime of this name in use from now on; a new one, which knows nothing, where there is none."""
        return self._in_use(self.rule.named(state.known, name), state.shadow)

    def _in_use(self, known: OnlineScene, shadow: Any) -> SceneState:
        """The state with the births and false alarms that are in use."""
        used = self.rule.scene(known.regime, "")
        model = with_scene(self.default, used.births, used.clutter, used.followed, self.particles)
        birth = None if used.births is None else model.birth
        return SceneState(known, shadow, birth, None if used.clutter is None else model.clutter)


@dataclass(frozen=True, slots=True, eq=False)
class RatesState:
    """What is known of the rates, and the state of ``other`` learning."""

    learned: LearnedRates
    other: Any = None


def scene_of(learned: Any) -> SceneState | None:
    """What is known of the scene in the state of any learning; None where nothing is."""
    learned = learned.other if isinstance(learned, RatesState | ScoresSeen) else learned
    return learned if isinstance(learned, SceneState) else None


@dataclass(frozen=True, slots=True, eq=False)
class RateLearning:
    """Learning rates while tracking.

    Attributes
    ----------
    rule : how they are learned.      other : what else is learned; its births and false alarms keep their own rates.
    """

    rule: RatesLearning
    other: Learning[Any] | None = None

    def start(self) -> RatesState:
        """Before the first frame."""
        return RatesState(self.rule.begin(), self.other and self.other.start())

    def model(self, state: RatesState, model: Model) -> Model:
        """The model with the rates that are used; cautious ones only where nothing else explains them."""
        used, found, priors = self.rule.settings, state.learned.rates, self.rule.priors
        detection, clutter, births = found.detection, found.clutter, found.births
        if used.cautious:
            detection, clutter = min(detection, priors.detection), max(clutter, priors.clutter)
            births = max(births, priors.births)
        if used.detection:
            model = replace(model, sensor=with_rate(model.sensor, DETECTION_STEP * round(detection / DETECTION_STEP)))
        if used.clutter:
            model = replace(model, clutter=with_rate(model.clutter, _rounded(clutter, priors.clutter)))
        if used.birth:
            model = replace(model, birth=with_rate(model.birth, model.rate * _rounded(births, priors.births)))
        return self.other.model(state.other, model) if self.other else model

    def with_scores(self, state: RatesState, model: Model, detections: Detections) -> Model:
        """The model with the false alarms of a frame by the number and the scores of its detections."""
        model = self.other.with_scores(state.other, model, detections) if self.other else model
        if len(detections) == 0:
            return model
        used, priors, learned = self.rule.settings, self.rule.priors, state.learned
        if used.clutter and not (used.cautious or priors.clutter_each):
            # At first the number of detections is all that is known.
            rate = min(learned.rates.clutter, learned.detections_per_frame(len(detections)))
            model = replace(model, clutter=with_rate(model.clutter, _rounded(rate, priors.clutter)))
        if not used.scores or len(learned.scale.at) < 2:
            return model
        ratio = learned.scale.ratio(detections.confidence)
        return replace(model, clutter=ScoredClutter(model.clutter, ratio, np.log(ratio)))

    def advance(self, state: RatesState, step: Step) -> RatesState:
        """Take in one frame."""
        other = self.other and self.other.advance(state.other, step)
        return RatesState(self.rule.advance(state.learned, step), other)

    def mode(self, state: RatesState, name: str) -> RatesState | None:
        """With the regime of this name, of what else is learned."""
        other = self.other and self.other.mode(state.other, name)
        return RatesState(state.learned, other) if other else None


def priors_of(model: Model) -> Priors:
    """The rates of a model; 0, or p_D = 1, of parts that have none."""
    clutter, births = _name(model.clutter), _name(model.birth)
    return Priors(
        getattr(model.sensor, _name(model.sensor), 1.0),
        getattr(model.clutter, clutter, 0.0),
        getattr(model.birth, births, 0.0) / model.rate,
        clutter == "clutter_per_detection",
        births == "births_per_detection",
    )


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
