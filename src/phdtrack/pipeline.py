"""The loop: measure → predict and update → extract → associate → learn. It owns the order and knows
protocols only.

`advance` is one frame as a pure function: state and detections in, state and `Step` out. `run`
drives it over a sequence.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import Any

import numpy as np

from phdtrack.errors import InputError
from phdtrack.models.warp import as_warp
from phdtrack.protocols import AnyStages, Model
from phdtrack.types import (
    F8,
    I8,
    STILL,
    Detections,
    Estimates,
    Explanation,
    Step,
    Tracks,
    UpdateInfo,
)

NO_STATES: F8 = np.zeros((0, 0))
# Where measurements are put that show nothing of any state: no state is near.
NOWHERE = 1e9
ALL: I8 = np.zeros(0, np.int64)


@dataclass(frozen=True, slots=True)
class TrackingState:
    """Everything that is carried from frame to frame.

    Attributes
    ----------
    intensity, association : the filter's and the associator's state.
    number, time : of the last frame; seconds.
    targets : (d, n) the last frame's states, where the sensor asks which targets hide which; empty
        otherwise.
    given : which detections the filter was given, of the frames that it may still revise; (0,)
        where it was given all.
    learned : what was learned while tracking, None where nothing is.
    expected : the targets that merged measurements are divided by, None where they are not.
    pace : how many intervals there were, and the sum of the logarithms of their seconds.
    shown : what the boxes of online rows have taught, None where they are the filter's.
    camera : what is known of the camera's motion, None where it is not looked for.
    """

    intensity: Any
    association: Any
    number: int = 0
    time: float = 0.0
    targets: F8 = field(default_factory=lambda: NO_STATES)
    given: tuple[I8, ...] = ()
    learned: Any = None
    expected: Any = None
    pace: tuple[int, float] = (0, 0.0)
    shown: Any = None
    camera: Any = None


def start(stages: AnyStages, rng: np.random.Generator) -> TrackingState:
    """The state before the first frame."""
    learning = stages.detection_scores
    explainer = stages.explainer
    model = stages.model
    learned = learning and learning.start()
    expected = explainer and explainer.start()
    camera = stages.camera and stages.camera.start()
    intensity = stages.filter.start(learning.model(learned, model) if learning else model, rng)
    shown = stages.online and stages.online.start()
    first = stages.associator.start()
    return TrackingState(
        intensity, first, learned=learned, expected=expected, shown=shown, camera=camera
    )


def advance(
    stages: AnyStages,
    state: TrackingState,
    detections: Detections,
    number: int,
    time: float,
    rng: np.random.Generator,
    warp: F8 = STILL,
) -> tuple[TrackingState, Step]:
    """The state after a frame, and everything that the frame brought. Raises `InputError` where
    number or time does not grow or is no number, or the warp is no homography.

    Parameters
    ----------
    stages : the tracker's parts.
    state : after the frame before.
    detections : of this frame; with ``observed`` False it is predicted and nothing more.
    number, time, rng : from 1; seconds; the filter's randomness.
    warp : (3, 3) homography from pixels of the frame before to this one's; `types.STILL` where the
        camera stands still.
    """
    _check_order(state, number, time)
    learning = stages.detection_scores
    explainer = stages.explainer
    learned = state.learned
    expected = state.expected
    camera, seen = _seen(stages, state, detections, warp, (number, time))
    if learning:
        model = learning.model(learned, seen)
    else:
        model = seen
    pace, dt = _paced(stages, state, time, model)
    began = clock.perf_counter()
    explanation = Explanation.unchanged(detections)
    if explainer:
        expected, explanation = explainer.explain(expected, detections, model, dt)
    measured = model.sensor.measure(
        explanation.detections if detections.observed else Detections.empty(observed=False)
    )
    given = _Given(explanation, measured, np.flatnonzero(np.isfinite(measured).all(axis=0)))
    if detections.observed:
        if learning:
            weighted = learning.with_scores(
                learned, model, explanation.detections.select(given.usable)
            )
        else:
            weighted = model
        intensity, info = stages.filter.step(
            state.intensity, given.z, _watching(weighted, state.targets, dt), dt, rng
        )
    else:
        intensity = stages.filter.predict(state.intensity, model, dt, rng)
        info = UpdateInfo(intensity.mass, 0.0, intensity.mass, np.zeros(0), np.zeros(0))
    filtered = clock.perf_counter()
    estimates = _renumbered(stages.extractor.extract(intensity, given.z, model), given.usable)
    expected = explainer and explainer.advance(expected, explanation, estimates, model, dt)
    numbers = (*state.given, given.numbers)[-1 - len(estimates.past) :]
    z, info, estimates = given.in_terms_of_detections(info, estimates, numbers[:-1])
    extracted = clock.perf_counter()
    association, tracks = stages.associator.extend(
        state.association, estimates, z, number, dt, model
    )
    shown = None
    if stages.online:
        shown, tracks = stages.online.advance(state.shown, tracks, detections, number, time)
    seconds = (filtered - began, extracted - filtered, clock.perf_counter() - extracted)
    step = Step(
        number, time, detections, info, estimates, tracks, seconds, given.unusable, seen.warp
    )
    learned = learning and learning.advance(learned, step)
    camera = stages.camera and stages.camera.with_targets(camera, estimates)
    if model.sensor.occlusion:
        targets = estimates.state
    else:
        targets = NO_STATES
    after = TrackingState(
        intensity,
        association,
        number,
        time,
        targets,
        numbers,
        learned,
        expected,
        pace,
        shown,
        camera,
    )
    return after, step


def _paced(
    stages: AnyStages, state: TrackingState, time: float, model: Model
) -> tuple[tuple[int, float], float]:
    """`TrackingState.pace`, and the interval before this frame in the model's time units.

    Streams of few pictures show slow things: where the usual interval, the geometric mean, is
    longer than ``Stages.longest_interval``, the filter's time runs slower, so that it is as long as
    that.
    """
    if state.number == 0:
        return (0, 0.0), model.first
    seconds = time - state.time
    count = state.pace[0] + 1
    logs = state.pace[1] + math.log(seconds)
    factor = stages.longest_interval / math.exp(logs / count)
    # 1e-6: an interval of 0.2 s is one, whatever rounding makes of it.
    return (count, logs), seconds * (factor if 0 < factor <= 1 - 1e-6 else 1.0) * model.rate


def _seen(
    stages: AnyStages,
    state: TrackingState,
    detections: Detections,
    warp: F8,
    when: tuple[int, float],
) -> tuple[Any, Model]:
    """What is known of the camera's motion, and the model of the frame: with the motion that was
    given, or was found.
    """
    if len(warp) and state.number:
        moved = as_warp(warp, f"frame {when[0]}")
    else:
        moved = STILL
    camera = state.camera
    if stages.camera and state.number:
        interval = (when[1] - state.time) * stages.model.rate
        camera, moved = stages.camera.between(camera, detections, stages.model, interval, moved)
    return camera, replace(stages.model, warp=moved) if len(moved) else stages.model


def run(
    stages: AnyStages, frames: Iterable[tuple[int, float, Detections]], rng: np.random.Generator
) -> Iterator[tuple[TrackingState, Step]]:
    """The state and the step of each frame of a sequence.

    Parameters
    ----------
    stages, rng : the tracker's parts, and the filter's randomness.
    frames : number, seconds and detections of each.
    """
    state = start(stages, rng)
    for number, time, detections in frames:
        state, step = advance(stages, state, detections, number, time, rng)
        yield state, step


def flush(stages: AnyStages, state: TrackingState) -> Tracks:
    """The online rows that the output delay holds back; none without a delay."""
    tracks = stages.associator.flush(state.association, stages.model)
    if stages.online:
        return stages.online.shown(state.shown, tracks)[1]
    return tracks


def finish(stages: AnyStages, state: TrackingState) -> Tracks:
    """The corrected tracks of everything seen until ``state``, joined and smoothed."""
    tracks = stages.associator.finish(state.association, stages.model)
    if stages.smoother is None:
        return tracks
    return stages.smoother.smooth(
        tracks, stages.associator.measurements(state.association), stages.model
    )


def merged(steps: Sequence[Step], index: Sequence[I8], detections: Detections) -> Step:
    """One step of several pipelines that share a frame; its rows are those of the first.

    Parameters
    ----------
    steps, index : of each, and (n,) which of the frame's detections it was given.
    detections : of the frame, (N).
    """
    infos = [step.info for step in steps]
    first = steps[0]
    evidence, clutter = np.zeros((2, len(detections)))
    whole = all(len(info.evidence) == len(at) for info, at in zip(infos, index, strict=True))
    for info, at in zip(infos, index, strict=True) if whole else ():
        evidence[at] = info.evidence
        clutter[at] = info.clutter
    known = all(len(info.cardinality) for info in infos)
    info = UpdateInfo(
        sum(info.mass_predicted for info in infos),
        sum(info.mass_born for info in infos),
        sum(info.mass for info in infos),
        evidence if whole else np.zeros(0),
        clutter if whole else np.zeros(0),
        sum(info.vanished for info in infos),
        reduce(np.convolve, [info.cardinality for info in infos]) if known else np.zeros(0),
        sum(info.detected for info in infos),
    )
    parts = [step.estimates for step in steps]
    tagged = all(len(part.tag) == len(part) for part in parts)
    estimates = Estimates(
        np.concatenate([part.state for part in parts], axis=1),
        np.concatenate([part.covariance for part in parts]),
        np.concatenate([part.weight for part in parts]),
        np.concatenate([part.xyxy for part in parts]),
        np.concatenate(
            [np.append(at, -1)[part.detection] for part, at in zip(parts, index, strict=True)]
        ),
        # One that no other class has.
        np.concatenate([len(parts) * part.tag + k for k, part in enumerate(parts)])
        if tagged
        else np.zeros(0, np.int64),
    )
    a, b, c = np.sum([step.seconds for step in steps], axis=0).tolist()
    unusable = sum(step.unusable for step in steps)
    return Step(
        first.number,
        first.time,
        detections,
        info,
        estimates,
        first.tracks,
        (a, b, c),
        unusable,
        first.warp,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Given:
    """What the filter is given of a frame's N detections: N′ by an explanation, of which it is
    given the usable ones.

    ``measured`` (m, N′) are their measurements; a column with NaN, as of a foot above the horizon,
    is not ``usable``.
    """

    explanation: Explanation
    measured: F8
    usable: I8

    @property
    def unusable(self) -> int:
        """How many of the N′ the filter is not given."""
        return int(self.measured.shape[1]) - len(self.usable)

    @property
    def z(self) -> F8:
        """(m, n) the measurements that the filter is given."""
        if self.unusable:
            return np.ascontiguousarray(self.measured[:, self.usable])
        return self.measured

    @property
    def numbers(self) -> I8:
        """(n,) the frame's detection that each of them rests on; (0,) where it is given all as they
        are.
        """
        if self.unusable or self.explanation.changed:
            return self.explanation.source[self.usable]
        return ALL

    def in_terms_of_detections(
        self, info: UpdateInfo, estimates: Estimates, past: tuple[I8, ...]
    ) -> tuple[F8, UpdateInfo, Estimates]:
        """Measurements (m, N), info and states in terms of the frame's detections; ``past`` are
        earlier frames' numbers.

        What is not usable counts as a false alarm and lies where no state is. A detection that
        several targets share has the measurement of one of them and the largest evidence; of pieces
        of one target the first has its measurement.
        """
        z = self.measured
        e = self.explanation
        if self.unusable or e.changed:
            z = np.full((len(self.measured), len(e.part)), NOWHERE)
            z[:, e.source[self.usable]] = self.z
            if len(info.evidence) == len(self.usable):
                evidence, clutter = np.zeros((2, len(e.source)))
                evidence[self.usable] = info.evidence
                clutter[self.usable] = info.clutter
                largest = evidence[e.part]
                np.maximum.at(largest, e.source, evidence)
                info = replace(info, evidence=largest, clutter=clutter[e.part])
            estimates = _renumbered(estimates, e.source)
        if any(len(numbers) for numbers in past):
            revised = zip(estimates.past[len(estimates.past) - len(past) :], past, strict=True)
            again = tuple(
                _renumbered(x, numbers) if x is not None and len(numbers) else x
                for x, numbers in revised
            )
            estimates = replace(estimates, past=again)
        return z, info, estimates


def _renumbered(estimates: Estimates, numbers: I8) -> Estimates:
    """The states with each detection k replaced by ``numbers[k]``."""
    # The last place stands for no detection.
    return replace(estimates, detection=np.append(numbers, -1)[estimates.detection])


def _watching(model: Model, targets: F8, dt: float) -> Model:
    """The model whose sensor knows which targets of the last frame may hide others by now."""
    if targets.shape[1] == 0:
        return model
    expected, _, _ = model.motion.transition(model.warp_states(np.ascontiguousarray(targets)), dt)
    return replace(model, sensor=model.sensor.watching(expected))


def _check_order(state: TrackingState, number: int, time: float) -> None:
    """Raise `InputError` where number or time does not grow, or is none."""
    if number < 1:
        raise InputError(f"expected a frame number from 1, got {number}")
    if not math.isfinite(time):
        raise InputError(
            f"expected the time of a frame in seconds, got {time:g}", where=f"frame {number}"
        )
    if state.number and (number <= state.number or not time > state.time):
        last = f"frame {state.number} at {state.time:g} s"
        problem = (
            f"frame numbers and times must grow, but frame {number} at {time:g} s follows {last}"
        )
        raise InputError(
            problem, cure="Sort the frames, or reset the tracker before a new sequence"
        )
