"""The rates of a stream as they are learned while tracking: `rates` as a stage, and its estimates in place of the model's.

Estimates are put into the model in steps of a few per cent, so that parts of a model, which are values, stay the same ones
for many frames and what is computed of them is computed once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

from phdtrack.models.births import MeasurementBirth
from phdtrack.models.box_motion import BoxMotion
from phdtrack.models.box_sensor import BoxSensor
from phdtrack.models.clutter import LocalClutter, LocalPlaneClutter, ScoredClutter, UniformClutter
from phdtrack.models.plane_birth import PlaneBirth
from phdtrack.models.plane_sensor import PlaneSensor
from phdtrack.models.point_birth import PointBirth
from phdtrack.models.point_sensor import PointSensor
from phdtrack.protocols import Birth, Clutter, Learning, Model, NoLearning, Sensor
from phdtrack.scene.rates import Following, Learned, Noise, Priors, advance, begin
from phdtrack.types import Detections, Step

# p_D is put into the model in steps of this size, rates in steps of this ratio.
STEP, RATIO = 0.01, 1.05


@dataclass(frozen=True, slots=True, eq=False)
class RatesState:
    """What is known of the rates, and what another learner beside them knows."""

    learned: Learned
    beside: Any = None


@dataclass(frozen=True, slots=True, eq=False)
class FollowRates:
    """Learning rates while tracking.

    Attributes
    ----------
    rule : how they are followed.     beside : what else is learned; its births and false alarms keep their own rates.
    """

    rule: Following
    beside: Learning[Any] = field(default_factory=NoLearning)

    def start(self) -> RatesState:
        """Before the first frame."""
        return RatesState(begin(self.rule), self.beside.start())

    def model(self, state: RatesState, model: Model) -> Model:
        """The model with what was learned."""
        learns, rates = self.rule.learns, state.learned.rates
        if self.rule.cautious:
            rates = rates.cautious(self.rule.priors)
        motion, sensor, birth, clutter = model.motion, model.sensor, model.birth, model.clutter
        if learns.noise and isinstance(motion, BoxMotion) and isinstance(sensor, BoxSensor):
            set_to = self.rule.priors.noise
            sensor = _measuring(sensor, _rounded(rates.noise.spread, set_to.spread))
            motion = _moving(
                motion,
                _rounded(rates.noise.acceleration, set_to.acceleration),
                _rounded(rates.noise.resize, set_to.resize),
            )
        if learns.detection:
            sensor = with_detection(sensor, STEP * round(rates.detection / STEP))
        if learns.clutter:
            clutter = with_clutter(clutter, _rounded(rates.clutter, self.rule.priors.clutter))
        if learns.births:
            birth = with_births(birth, model.rate * _rounded(rates.births, self.rule.priors.births))
        return self.beside.model(state.beside, replace(model, motion=motion, sensor=sensor, birth=birth, clutter=clutter))

    def weighed(self, state: RatesState, model: Model, detections: Detections) -> Model:
        """The model with the false alarms of a frame by the number and the scores of its detections."""
        model = self.beside.weighed(state.beside, model, detections)
        if len(detections) == 0:
            return model
        if self.rule.learns.clutter and not (self.rule.cautious or self.rule.priors.clutter_each):
            model = self._bounded(state.learned, model, len(detections))
        scale = state.learned.scale
        if not self.rule.learns.scores or len(scale.at) < 2:
            return model
        return replace(model, clutter=ScoredClutter(model.clutter, scale.odds(detections.confidence)))

    def _bounded(self, learned: Learned, model: Model, now: int) -> Model:
        """With no more false alarms a frame than there are detections: at first that is all that is known."""
        rate = min(learned.rates.clutter, learned.most(now))
        return replace(model, clutter=with_clutter(model.clutter, _rounded(rate, self.rule.priors.clutter)))

    def advance(self, state: RatesState, step: Step) -> RatesState:
        """Take in one frame."""
        return RatesState(advance(self.rule, state.learned, step), self.beside.advance(state.beside, step))

    def mode(self, state: RatesState, name: str) -> RatesState:
        """With the mode of this name, of what else is learned."""
        return RatesState(state.learned, self.beside.mode(state.beside, name))


def _rounded(value: float, about: float) -> float:
    """The nearest value that is ``about`` times a power of `RATIO`; ``value`` itself where one of them is 0."""
    if value <= 0 or about <= 0:
        return value
    return about * RATIO ** round(math.log(value / about, RATIO))


def with_detection(sensor: Sensor, detection: float) -> Sensor:
    """The sensor with this p_D; one of somebody's own stays as it is."""
    return _detecting(sensor, detection) if isinstance(sensor, BoxSensor | PlaneSensor | PointSensor) else sensor


def with_clutter(clutter: Clutter, rate: float) -> Clutter:
    """False alarms with this rate; of a density that was learned, or of somebody's own, as they are."""
    return _false(clutter, rate) if isinstance(clutter, UniformClutter | LocalClutter | LocalPlaneClutter) else clutter


def with_births(birth: Birth, rate: float) -> Birth:
    """Births with this rate per second; at given or learned places as they are."""
    return _born(birth, rate) if isinstance(birth, MeasurementBirth | PlaneBirth | PointBirth) else birth


@lru_cache(maxsize=256)
def _detecting(sensor: BoxSensor | PlaneSensor | PointSensor, detection: float) -> Sensor:
    return sensor if sensor.detection_probability == detection else replace(sensor, detection_probability=detection)


@lru_cache(maxsize=256)
def _measuring(sensor: BoxSensor, spread: float) -> BoxSensor:
    return sensor if sensor.box_noise == spread else replace(sensor, box_noise=spread)


@lru_cache(maxsize=256)
def _moving(motion: BoxMotion, acceleration: float, resize: float) -> BoxMotion:
    same = (motion.acceleration, motion.size_noise) == (acceleration, resize)
    return motion if same else replace(motion, acceleration=acceleration, size_noise=resize)


@lru_cache(maxsize=256)
def _false(clutter: UniformClutter | LocalClutter | LocalPlaneClutter, rate: float) -> Clutter:
    return clutter if clutter.clutter_per_frame == rate else replace(clutter, clutter_per_frame=rate)


@lru_cache(maxsize=256)
def _born(birth: MeasurementBirth | PlaneBirth | PointBirth, rate: float) -> Birth:
    return birth if birth.births_per_second == rate else replace(birth, births_per_second=rate)


def priors(model: Model) -> Priors:
    """What a model says of its rates; of parts that have none 0, or p_D = 1."""
    detection, clutter, births, clutter_each, births_each = 1.0, 0.0, 0.0, False, False
    if isinstance(model.sensor, BoxSensor | PlaneSensor | PointSensor):
        detection = model.sensor.detection_probability
    if isinstance(model.clutter, UniformClutter | LocalClutter | LocalPlaneClutter):
        clutter, clutter_each = model.clutter.clutter_per_frame, not isinstance(model.clutter, UniformClutter)
    if isinstance(model.birth, MeasurementBirth | PlaneBirth):
        births, births_each = model.birth.births_per_second / model.rate, model.birth.volume == "local"
    elif isinstance(model.birth, PointBirth):
        births = model.birth.births_per_second / model.rate
    return Priors(detection, clutter, births, clutter_each, births_each, _noise(model))


def _noise(model: Model) -> Noise:
    """What a model of boxes says of its noises; nothing where they are no shares of the size."""
    motion, sensor = model.motion, model.sensor
    if not (isinstance(motion, BoxMotion) and isinstance(sensor, BoxSensor)):
        return Noise()
    if not motion.scaled_noise or sensor.scaling in ("fixed", "given"):
        return Noise()
    return Noise(sensor.box_noise, motion.acceleration, motion.size_noise)
