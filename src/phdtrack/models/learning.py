"""Learning while tracking as stages of the loop: the scene (`scene.online`) and the rates (`scene.rates`).

The scene is learned from a *shadow tracker*, a second run over the same frames that does not use what is learned. A run that
learned from itself would doubt a target that stands where a false alarm came, learn it as false, and doubt it more. While
nothing is in use the tracks are those of a run that does not learn.

Learned rates go into the model in steps of a few per cent, so that the parts of a model stay the same values for many frames
and what is computed of them is computed once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, Protocol

from phdtrack.models.births import MeasurementBirth
from phdtrack.models.box_sensor import BoxSensor
from phdtrack.models.clutter import LocalClutter, LocalPlaneClutter, ScoredClutter, UniformClutter
from phdtrack.models.plane_birth import PlaneBirth
from phdtrack.models.plane_sensor import PlaneSensor
from phdtrack.models.point_birth import PointBirth
from phdtrack.models.point_sensor import PointSensor
from phdtrack.models.scene import with_scene
from phdtrack.models.standing import not_standing
from phdtrack.protocols import Birth, Clutter, Learning, Model, NoLearning, Sensor
from phdtrack.scene import Scene, TrackedObjects, online, rates
from phdtrack.scene.online import OnlineLearning, OnlineScene, Regime
from phdtrack.scene.rates import LearnedRates, Priors, RatesLearning
from phdtrack.types import Detections, Step

# p_D goes into the model in steps of this size, rates in steps of this ratio.
DETECTION_STEP, RATE_RATIO = 0.01, 1.05


class ShadowTracker(Protocol):
    """A second run over the same frames that does not use what is learned."""

    def start(self) -> Any:
        """The state before the first frame."""

    def advance(self, state: Any, step: Step) -> tuple[Any, Step]:
        """The state after one frame, and what it makes of the detections in ``step``."""


@dataclass(frozen=True, slots=True, eq=False)
class SceneState:
    """What is ``known``, the state of the ``shadow`` tracker, and births and false alarms in use, None for the model's."""

    known: OnlineScene
    shadow: Any = None
    birth: Birth | None = None
    clutter: Clutter | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SceneLearning:
    """Learning births and false alarms while tracking.

    Attributes
    ----------
    rule : how the scene is learned.      shipped : the model to which what is learned is added.
    shadow : what is learned from.      particles : Jmax, see `SceneBirth`.
    scenes : what was learned before, one for each regime.
    """

    rule: OnlineLearning
    shipped: Model
    shadow: ShadowTracker
    particles: int = 500
    scenes: tuple[Scene, ...] = ()

    def start(self) -> SceneState:
        """Before the first frame."""
        return self._in_use(online.begin(self.rule, self.scenes), self.shadow.start())

    def model(self, state: SceneState, model: Model) -> Model:
        """The model with what is in use. Raises `InputError` where the camera moves: what is learned lies at pixels."""
        if len(model.warp):
            raise not_standing("learning where false alarms and entrances are")
        if state.birth is None and state.clutter is None:
            return model
        return replace(model, birth=state.birth or model.birth, clutter=state.clutter or model.clutter)

    def with_scores(self, state: SceneState, model: Model, detections: Detections) -> Model:
        """The same model: scores are not learned here."""
        return model

    def advance(self, state: SceneState, step: Step) -> SceneState:
        """Take in one frame."""
        shadow, seen = self.shadow.advance(state.shadow, step)
        known = online.advance(self.rule, state.known, seen)
        if known.last is state.known.last:
            return SceneState(known, shadow, state.birth, state.clutter)
        return self._in_use(known, shadow)

    def mode(self, state: SceneState, name: str) -> SceneState:
        """With the regime of this name in use from now on; a new one, which knows nothing, where there is none."""
        return self._in_use(online.named(self.rule, state.known, name), state.shadow)

    def scene(self, regime: Regime, source: str) -> Scene:
        """What is in use of a regime, to be written to a file."""
        return online.scene_of(self.rule, regime, source)

    def _in_use(self, known: OnlineScene, shadow: Any) -> SceneState:
        used = known.regime.used
        objects = None if used.objects is None else TrackedObjects(0.0, used.objects)
        model = with_scene(self.shipped, used.births, used.clutter, objects, self.particles)
        birth = None if used.births is None else model.birth
        return SceneState(known, shadow, birth, None if used.clutter is None else model.clutter)


@dataclass(frozen=True, slots=True, eq=False)
class RatesState:
    """What is known of the rates, and the state of ``other`` learning."""

    learned: LearnedRates
    other: Any = None


@dataclass(frozen=True, slots=True, eq=False)
class RateLearning:
    """Learning rates while tracking.

    Attributes
    ----------
    rule : how they are learned.      other : what else is learned; its births and false alarms keep their own rates.
    """

    rule: RatesLearning
    other: Learning[Any] = field(default_factory=NoLearning)

    def start(self) -> RatesState:
        """Before the first frame."""
        return RatesState(rates.begin(self.rule), self.other.start())

    def model(self, state: RatesState, model: Model) -> Model:
        """The model with the rates that are used."""
        used, found, priors = self.rule.settings, state.learned.rates, self.rule.priors
        if used.cautious:
            found = found.cautious(priors)
        if used.detection:
            detection = DETECTION_STEP * round(found.detection / DETECTION_STEP)
            model = replace(model, sensor=with_detection(model.sensor, detection))
        if used.clutter:
            model = replace(model, clutter=with_clutter(model.clutter, _rounded(found.clutter, priors.clutter)))
        if used.birth:
            model = replace(model, birth=with_births(model.birth, model.rate * _rounded(found.births, priors.births)))
        return self.other.model(state.other, model)

    def with_scores(self, state: RatesState, model: Model, detections: Detections) -> Model:
        """The model with the false alarms of a frame by the number and the scores of its detections."""
        model = self.other.with_scores(state.other, model, detections)
        if len(detections) == 0:
            return model
        used, priors, learned = self.rule.settings, self.rule.priors, state.learned
        if used.clutter and not (used.cautious or priors.clutter_each):
            # At first the number of detections is all that is known.
            rate = min(learned.rates.clutter, learned.detections_per_frame(len(detections)))
            model = replace(model, clutter=with_clutter(model.clutter, _rounded(rate, priors.clutter)))
        if not used.scores or len(learned.scale.at) < 2:
            return model
        return replace(model, clutter=ScoredClutter(model.clutter, learned.scale.ratio(detections.confidence)))

    def advance(self, state: RatesState, step: Step) -> RatesState:
        """Take in one frame."""
        return RatesState(rates.advance(self.rule, state.learned, step), self.other.advance(state.other, step))

    def mode(self, state: RatesState, name: str) -> RatesState:
        """With the regime of this name, of what else is learned."""
        return RatesState(state.learned, self.other.mode(state.other, name))


def priors_of(model: Model) -> Priors:
    """The rates of a model; 0, or p_D = 1, of parts that have none."""
    detection, clutter, births, clutter_each, births_each = 1.0, 0.0, 0.0, False, False
    if isinstance(model.sensor, BoxSensor | PlaneSensor | PointSensor):
        detection = model.sensor.detection_probability
    if isinstance(model.clutter, UniformClutter | LocalClutter | LocalPlaneClutter):
        clutter, clutter_each = model.clutter.clutter_per_frame, not isinstance(model.clutter, UniformClutter)
    if isinstance(model.birth, MeasurementBirth | PlaneBirth):
        births, births_each = model.birth.births_per_second / model.rate, model.birth.volume == "local"
    elif isinstance(model.birth, PointBirth):
        births = model.birth.births_per_second / model.rate
    return Priors(detection, clutter, births, clutter_each, births_each)


def with_detection(sensor: Sensor, detection: float) -> Sensor:
    """The sensor with this p_D; a sensor of another kind stays as it is."""
    return (
        _with(sensor, "detection_probability", detection)
        if isinstance(sensor, BoxSensor | PlaneSensor | PointSensor)
        else sensor
    )


def with_clutter(clutter: Clutter, rate: float) -> Clutter:
    """False alarms with this rate; learned ones and those of another kind stay as they are."""
    return (
        _with(clutter, "clutter_per_frame", rate)
        if isinstance(clutter, UniformClutter | LocalClutter | LocalPlaneClutter)
        else clutter
    )


def with_births(birth: Birth, rate: float) -> Birth:
    """Births with this rate per second; those at given or learned places stay as they are."""
    return (
        _with(birth, "births_per_second", rate) if isinstance(birth, MeasurementBirth | PlaneBirth | PointBirth) else birth
    )


@lru_cache(maxsize=256)
def _with(part: Any, name: str, value: float) -> Any:
    """A part of a model with one number changed; the same object for the same number."""
    return part if getattr(part, name) == value else replace(part, **{name: value})


def _rounded(value: float, about: float) -> float:
    """The nearest ``about`` times a power of `RATE_RATIO`; ``value`` itself where one of them is 0."""
    if value <= 0 or about <= 0:
        return value
    return about * RATE_RATIO ** round(math.log(value / about, RATE_RATIO))
