"""The loop: predict, update, reduce, extract, associate. It owns the order and knows protocols only.

`advance` is one frame as a pure function: state and detections in, state and `Step` out. `run` drives it over a sequence.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from phdtrack.errors import InputError
from phdtrack.models.warp import as_warp
from phdtrack.protocols import AnyStages, Model
from phdtrack.types import F4, F8, I8, STILL, Detections, Estimates, Explanation, Step, Tracks, UpdateInfo

NOBODY: F8 = np.zeros((0, 0))
# Where measurements are put that tell nothing of any state: no state is near.
NOWHERE = 1e9
ALL: I8 = np.zeros(0, np.int64)
NOT_LOOKED: Mapping[int, F4] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class TrackingState:
    """Everything that is carried from frame to frame: the filter's and the associator's state, frame number and time.

    ``targets`` (d, n) are the states that the last frame showed, where the sensor asks who may hide whom; empty otherwise.
    ``usable`` are the numbers of the detections that the filter was given, of the frames that it may still revise; (0,) for
    one in which it was given all. ``learned`` is what is known of the scene, None where nothing is learned. ``expected`` are
    the targets that detections are explained by, None where nothing is explained.
    """

    intensity: Any
    association: Any
    number: int = 0
    time: float = 0.0
    targets: F8 = field(default_factory=lambda: NOBODY)
    usable: tuple[I8, ...] = ()
    learned: Any = None
    expected: Any = None


def start(stages: AnyStages, rng: np.random.Generator) -> TrackingState:
    """The state before the first frame."""
    learned = stages.learning.start()
    intensity = stages.filter.start(stages.learning.model(learned, stages.model), rng)
    return TrackingState(intensity, stages.associator.start(), learned=learned, expected=stages.explainer.start())


def advance(
    stages: AnyStages,
    state: TrackingState,
    detections: Detections,
    number: int,
    time: float,
    rng: np.random.Generator,
    warp: F8 = STILL,
) -> tuple[TrackingState, Step]:
    """Take in the detections of frame ``number`` (from 1) at ``time`` seconds.

    A frame with ``detections.observed`` False is predicted and nothing more. ``warp`` (3, 3) takes pixels of the last frame
    that was taken in to this one's, where the camera moves (`camera.warp`); before the first frame it says nothing. Raises
    `InputError` where number or time does not grow, the number is below 1, the time is no number, or the warp no homography.
    """
    if number < 1:
        raise InputError(f"expected a frame number from 1, got {number}")
    if not math.isfinite(time):
        raise InputError(f"expected the time of a frame in seconds, got {time:g}", where=f"frame {number}")
    if state.number and (number <= state.number or not time > state.time):
        raise InputError(
            f"frame numbers and times must grow, but frame {number} at {time:g} s follows frame {state.number} at "
            f"{state.time:g} s",
            cure="Sort the frames, or reset the tracker before a new sequence",
        )
    seen = replace(stages.model, warp=as_warp(warp, f"frame {number}")) if len(warp) and state.number else stages.model
    model = stages.learning.model(state.learned, seen)
    dt = (time - state.time) * model.rate if state.number else model.first
    began = clock.perf_counter()
    expected, told = stages.explainer.explain(state.expected, detections, model, dt)
    everything = model.sensor.measure(told.detections if detections.observed else Detections.empty(observed=False))
    usable = np.flatnonzero(np.isfinite(everything).all(axis=0))
    complete = len(usable) == everything.shape[1]
    z = everything if complete else np.ascontiguousarray(everything[:, usable])
    if detections.observed:
        weighed = stages.learning.weighed(
            state.learned, model, told.detections if complete else told.detections.take(usable)
        )
        intensity, info = stages.filter.step(state.intensity, z, _watching(weighed, state.targets, dt), dt, rng)
    else:
        intensity = stages.filter.predict(state.intensity, model, dt, rng)
        info = UpdateInfo(intensity.mass, 0.0, intensity.mass, np.zeros(0), np.zeros(0))
    filtered = clock.perf_counter()
    estimates = stages.extractor.extract(intensity, z, model)
    if not complete:
        everything, info, estimates = _renumbered(everything, info, estimates, usable)
    expected = stages.explainer.advance(expected, told, estimates, model, dt)
    unusable = everything.shape[1] - len(usable)
    if told.changed:
        everything, info, estimates = _as_found(everything, info, estimates, told)
    given = (*state.usable, ALL if complete and not told.changed else told.source[usable])[-1 - len(estimates.past) :]
    if any(len(numbers) for numbers in given[:-1]):
        estimates = replace(estimates, past=_renumbered_past(estimates.past, given[:-1]))
    extracted = clock.perf_counter()
    association, tracks = stages.associator.extend(state.association, estimates, everything, number, dt, model)
    ended = clock.perf_counter()
    seconds = (filtered - began, extracted - filtered, ended - extracted)
    step = Step(number, time, detections, info, estimates, tracks, seconds, unusable, seen.warp)
    targets = estimates.state if model.sensor.occlusion else NOBODY
    learned = stages.learning.advance(state.learned, step)
    return TrackingState(intensity, association, number, time, targets, given, learned, expected), step


def _renumbered(z: F8, info: UpdateInfo, estimates: Estimates, usable: I8) -> tuple[F8, UpdateInfo, Estimates]:
    """What was found with the ``usable`` columns of ``z`` (m, N) alone, in terms of all N.

    The others are taken for false alarms and lie where no state is.
    """
    count = z.shape[1]
    if len(info.evidence) == len(usable):
        evidence, clutter = np.zeros(count), np.zeros(count)
        evidence[usable], clutter[usable] = info.evidence, info.clutter
        info = replace(info, evidence=evidence, clutter=clutter)
    return np.where(np.isfinite(z).all(axis=0), z, NOWHERE), info, _numbered(estimates, usable)


def _as_found(z: F8, info: UpdateInfo, estimates: Estimates, told: Explanation) -> tuple[F8, UpdateInfo, Estimates]:
    """What the filter made of the N′ detections that it was told, with measurements ``z`` (m, N′), in terms of the N found.

    A detection that several targets share has the measurement of one of them, and the evidence for the likeliest; of pieces
    the first has the target's measurement, and the others lie where no state is.
    """
    found = np.full((len(z), len(told.part)), NOWHERE)
    found[:, told.source] = z
    if len(info.evidence) == len(told.source):
        evidence = info.evidence[told.part]
        np.maximum.at(evidence, told.source, info.evidence)
        info = replace(info, evidence=evidence, clutter=info.clutter[told.part])
    return found, info, _numbered(estimates, told.source)


def _renumbered_past(past: tuple[Estimates | None, ...], given: tuple[I8, ...]) -> tuple[Estimates | None, ...]:
    """The revised states of frames in terms of all their detections, of which the filter was ``given`` these."""
    return tuple(
        _numbered(estimates, usable) if estimates is not None and len(usable) else estimates
        for estimates, usable in zip(past[len(past) - len(given) :], given, strict=True)
    )


def _numbered(estimates: Estimates, usable: I8) -> Estimates:
    """The states with their detections in terms of all, of which the filter was given the ``usable`` ones."""
    # The last place stands for no detection.
    return replace(estimates, detection=np.append(usable, -1)[estimates.detection])


def _watching(model: Model, targets: F8, dt: float) -> Model:
    """The model whose sensor knows whom the targets of the last frame may hide by now."""
    if targets.shape[1] == 0:
        return model
    expected, _, _ = model.motion.transition(model.carried(np.ascontiguousarray(targets)), dt)
    return replace(model, sensor=model.sensor.watching(expected))


def run(
    stages: AnyStages, frames: Iterable[tuple[int, float, Detections]], rng: np.random.Generator
) -> Iterator[tuple[TrackingState, Step]]:
    """Track a sequence of (frame number, seconds, detections); yields the state and the step of each frame."""
    state = start(stages, rng)
    for number, time, detections in frames:
        state, step = advance(stages, state, detections, number, time, rng)
        yield state, step


@dataclass(frozen=True, slots=True)
class ShadowTracker:
    """The same frames once more, by ``stages`` of their own."""

    stages: AnyStages

    def start(self) -> TrackingState:
        """Before the first frame."""
        return start(self.stages, np.random.default_rng(0))

    def advance(self, state: TrackingState, step: Step) -> tuple[TrackingState, Step]:
        """What these stages make of the detections that ``step`` took in; chance is that of the frame's number."""
        rng = np.random.default_rng(step.number)
        return advance(self.stages, state, step.detections, step.number, step.time, rng)


def finish(stages: AnyStages, state: TrackingState, looks: Mapping[int, F4] = NOT_LOOKED) -> Tracks:
    """The corrected tracks of everything seen so far, smoothed with its measurements.

    ``looks`` (N, B) by a frame's number are what its detections look like, from `Smoother.describe`.
    """
    tracks = stages.associator.finish(state.association, stages.model)
    return stages.smoother.smooth(
        tracks, stages.associator.measurements(state.association).with_appearance(looks), stages.model
    )
