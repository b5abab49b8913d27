"""The loop: measure → predict and update → extract → associate → learn. It owns the order and knows
protocols only.

`advance` is one frame as a pure function: state and detections in, state and `Step` out. `run`
drives it over a sequence.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Iterable, Iterator, Sequence
from copy import deepcopy
from dataclasses import field, replace
from functools import reduce
from typing import Any

import numpy as np

from phdtrack.errors import InputError
from phdtrack.models.track_returns import with_returns
from phdtrack.models.warp import as_warp, back, joined
from phdtrack.protocols import AnyStages, Model
from phdtrack.types import (
    F8,
    STILL,
    Appeared,
    Detections,
    DividedDetections,
    Estimates,
    Step,
    Tracks,
    UpdateInfo,
    state_record,
)

NO_STATES: F8 = np.zeros((0, 0))


@state_record
class TrackingState:
    """Everything that is carried from frame to frame.

    Attributes
    ----------
    intensity, association : the filter's and the associator's state.
    number, time : of the last frame; seconds.
    observed, observed_time : of the last frame that was observed, 0 before there was one.
    pending, moved : (3, 3) the camera's motion since then as it was given, and as it was found;
        `types.STILL` for none.
    targets : (d, n) the last frame's states, if the sensor asks which targets hide which; empty
        otherwise.
    detection_scores : what scores have taught; None without that stage.
    expected_targets : the targets that merged measurements are divided by; None without that stage.
    intervals : the number of intervals between observed frames so far, and the sum of the
        logarithms of their seconds.
    online_boxes : what the boxes of online rows have taught; None if they are the filter's.
    camera : what is known of the camera's motion; None if it is not looked for.
    appearance : what is known of what boxes look like; None without that stage.
    """

    intensity: Any
    association: Any
    number: int = 0
    time: float = 0.0
    observed: int = 0
    observed_time: float = 0.0
    pending: F8 = field(default_factory=lambda: STILL)
    moved: F8 = field(default_factory=lambda: STILL)
    targets: F8 = field(default_factory=lambda: NO_STATES)
    detection_scores: Any = None
    expected_targets: Any = None
    intervals: tuple[int, float] = (0, 0.0)
    online_boxes: Any = None
    camera: Any = None
    appearance: Any = None


def start(stages: AnyStages, rng: np.random.Generator) -> TrackingState:
    """The state before the first frame."""
    model = stages.model
    scores = None
    if stages.detection_scores:
        scores = stages.detection_scores.start()
        model = stages.detection_scores.model(scores, model)
    return TrackingState(
        stages.filter.start(model, rng),
        stages.associator.start(),
        detection_scores=scores,
        expected_targets=stages.explainer and stages.explainer.start(),
        online_boxes=stages.online and stages.online.start(),
        camera=stages.camera and stages.camera.start(),
        appearance=stages.appearance and stages.appearance.start(),
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
    """The state after a frame, and everything that the frame brought.

    Raises `InputError` if number or time does not grow or is not finite, or if the warp is no
    homography.

    Parameters
    ----------
    stages : the tracker's parts.
    state : after the frame before.
    detections : of this frame; if ``observed`` is False, the frame is only predicted.
    number, time, rng : from 1; seconds; the filter's randomness.
    warp : (3, 3) homography from pixels of the frame before to this one's; `types.STILL` if the
        camera stands still.
    """
    _check_order(state, number, time)
    if not detections.observed:
        return _unobserved(stages, state, detections, (number, time), rng, warp)

    # Measure
    z = stages.model.sensor.measure(detections)
    camera, model = _with_camera_motion(stages, state, z, warp, (number, time))
    intervals, dt, model = _with_pace(stages, state, time, model)
    began = clock.perf_counter()
    targets, divided, z = _explained(stages, state, detections, z, model, dt)
    divided, z, unusable = _usable(divided, detections, z)
    measured = divided.detections if divided else detections

    # Predict and update
    appearance, model = _with_looks(stages, state, model, measured, time)
    frame_model = _with_hidden_targets(model, state.targets, dt)
    if stages.detection_scores:
        frame_model = stages.detection_scores.with_scores(
            state.detection_scores, frame_model, measured
        )
    intensity, info = stages.filter.step(state.intensity, z, frame_model, dt, rng)
    updated = clock.perf_counter()

    # Extract
    estimates = stages.extractor.extract(intensity, z, model)
    if stages.explainer and divided:
        targets = stages.explainer.advance(targets, divided, estimates, model, dt)
    extracted = clock.perf_counter()

    # Associate
    association, tracks = stages.associator.extend(
        state.association, estimates, z, measured, number, dt, model
    )
    online_boxes = None
    if stages.online:
        online_boxes, tracks = stages.online.advance(
            state.online_boxes,
            tracks,
            detections,
            number,
            time,
            stages.associator.oldest(association),
        )
    appeared = _appeared(stages, association, model, estimates, info)
    step = Step(
        number,
        time,
        detections,
        divided.in_frame(info) if divided else info,
        estimates.in_rows(measured.row),
        tracks,
        (updated - began, extracted - updated, clock.perf_counter() - extracted),
        unusable,
        _since_last(state.moved, model.warp),
        appeared,
    )

    # Learn
    scores = state.detection_scores
    if stages.detection_scores:
        scores = stages.detection_scores.advance(scores, step)
    if stages.camera:
        camera = stages.camera.with_targets(camera, estimates)
    if stages.appearance:
        sure = appeared[0].sure if appeared else info.sure
        appearance = stages.appearance.advance(appearance, sure, model.appearance)
    after = TrackingState(
        intensity,
        association,
        number,
        time,
        number,
        time,
        STILL,
        STILL,
        estimates.state if model.sensor.occlusion else NO_STATES,
        scores,
        targets,
        intervals,
        online_boxes,
        camera,
        appearance,
    )
    return after, step


def _unobserved(
    stages: AnyStages,
    state: TrackingState,
    detections: Detections,
    when: tuple[int, float],
    rng: np.random.Generator,
    warp: F8,
) -> tuple[TrackingState, Step]:
    """The state and the step of a frame in which no detector ran, ``when`` its number and time.

    Its targets are predicted from the last frame that was observed, and are forgotten again: what
    comes next is the same as if the frame had been left out.
    """
    number, time = when
    nothing = Detections.empty(observed=False)
    z = stages.model.sensor.measure(nothing)
    began = clock.perf_counter()
    _, model = _with_camera_motion(stages, state, z, warp, when)
    _, dt, model = _with_pace(stages, state, time, model)
    ahead = stages.filter.predict(state.intensity, model, dt, deepcopy(rng))
    predicted = clock.perf_counter()
    estimates = stages.extractor.extract(ahead, z, model)
    extracted = clock.perf_counter()
    association = state.association
    tracks = Tracks.empty()
    online_boxes = state.online_boxes
    if state.observed:
        association, tracks = stages.associator.extend(
            association, estimates, z, nothing, number, dt, model
        )
        if stages.online:
            online_boxes, tracks = stages.online.shown(online_boxes, tracks)
    step = Step(
        number,
        time,
        detections,
        UpdateInfo.without_update(ahead.mass),
        estimates,
        tracks,
        (predicted - began, extracted - predicted, clock.perf_counter() - extracted),
        warp=_since_last(state.moved, model.warp),
    )
    after = replace(
        state,
        association=association,
        number=number,
        time=time,
        pending=_since_observed(state, warp, number),
        moved=model.warp,
        online_boxes=online_boxes,
    )
    return after, step


def _with_looks(
    stages: AnyStages, state: TrackingState, model: Model, measured: Detections, time: float
) -> tuple[Any, Model]:
    """The state of appearance, and the model with what the detections look like."""
    if stages.appearance is None:
        return state.appearance, model
    appearance, looks = stages.appearance.looks(state.appearance, measured, time)
    if looks is None and model.appearance is None:
        return appearance, model
    return appearance, model.with_appearance(looks)


def _appeared(
    stages: AnyStages, association: Any, model: Model, estimates: Estimates, info: UpdateInfo
) -> tuple[Appeared, ...]:
    """`Step.appeared`, after the frame's ``association``."""
    if model.appearance is None:
        return ()
    seen = Appeared(model.appearance, estimates, info.sure)
    return (stages.associator.appeared(association, seen),)


def _explained(
    stages: AnyStages, state: TrackingState, detections: Detections, z: F8, model: Model, dt: float
) -> tuple[Any, DividedDetections | None, F8]:
    """The expected targets, the detections that the filter gets, None if they are as they were, and
    their measurements.
    """
    if stages.explainer is None:
        return None, None, z
    targets, divided = stages.explainer.explain(state.expected_targets, detections, z, model, dt)
    if divided.changed:
        z = model.sensor.measure(divided.detections)
    return targets, divided, z


def _usable(
    divided: DividedDetections | None, detections: Detections, z: F8
) -> tuple[DividedDetections | None, F8, int]:
    """The detections that the filter gets and their measurements (m, N), without those that show no
    possible state, and the number of these.
    """
    finite = np.isfinite(z)
    # Counted, as `all` takes several times as long.
    if np.count_nonzero(finite) == finite.size:
        return divided, z, 0
    usable = np.asarray(finite.all(axis=0))
    kept = (divided or DividedDetections.unchanged(detections)).select(usable)
    return kept, np.ascontiguousarray(z[:, usable]), int(np.count_nonzero(~usable))


def _with_pace(
    stages: AnyStages, state: TrackingState, time: float, model: Model
) -> tuple[tuple[int, float], float, Model]:
    """`TrackingState.intervals`, the interval since the last observed frame in the model's time
    units, and the model with its `Model.pace`.

    Streams of few frames a second show slow things: if the usual interval, the geometric mean, is
    longer than ``Stages.longest_interval``, the filter's time runs slower, so that the usual
    interval is as long as that.
    """
    if state.observed == 0:
        return (0, 0.0), model.first, replace(model, births_before=stages.births_before)
    seconds = time - state.observed_time
    count = state.intervals[0] + 1
    logs = state.intervals[1] + math.log(seconds)
    pace = stages.longest_interval / math.exp(logs / count)
    # Within rounding an interval of 0.2 s is 0.2 s.
    if not 0 < pace <= 1 - 1e-6:
        return (count, logs), seconds * model.rate, model
    return (count, logs), seconds * pace * model.rate, replace(model, pace=pace)


def _with_camera_motion(
    stages: AnyStages, state: TrackingState, z: F8, warp: F8, when: tuple[int, float]
) -> tuple[Any, Model]:
    """The state of the camera's motion, and the model that scores have taught with the motion since
    the last observed frame.

    The motion is ``warp``, or what the measurements ``z`` (m, N) show; ``when`` is number and time.
    """
    camera = state.camera
    model = stages.model
    if stages.detection_scores:
        model = stages.detection_scores.model(state.detection_scores, model)
    if not state.observed:
        return camera, model
    warp = _since_observed(state, warp, when[0])
    if stages.camera:
        interval = (when[1] - state.observed_time) * stages.model.rate
        camera, warp = stages.camera.between(camera, z, stages.model, interval, warp)
    if len(warp):
        model = model.with_warp(warp)
    return camera, model


def _since_observed(state: TrackingState, warp: F8, number: int) -> F8:
    """The camera's given motion since the last observed frame: ``warp`` after what is pending.

    Before the first observed frame there is nothing to move. Raises `InputError` if the motion
    ``warp`` to frame ``number`` is no homography.
    """
    if len(warp):
        warp = as_warp(warp, f"frame {number}")
    if not state.observed:
        return STILL
    return joined([state.pending, warp])


def _since_last(moved: F8, warp: F8) -> F8:
    """The part of the motion ``warp`` since the last observed frame that is not in ``moved``, that
    up to the frame before.
    """
    if len(moved):
        return joined([back(moved), warp])
    return warp


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
        return stages.online.shown(state.online_boxes, tracks)[1]
    return tracks


def finish(stages: AnyStages, state: TrackingState) -> Tracks:
    """The corrected tracks of everything seen until ``state``, joined and smoothed."""
    tracks = stages.associator.finish(state.association, stages.model)
    if stages.smoother:
        model = stages.model
        if stages.appearance:
            model = model.with_appearance(stages.appearance.known(state.appearance))
        tracks = stages.smoother.smooth(
            tracks, stages.associator.measurements(state.association), model
        )
    else:
        pairs = stages.associator.returns(state.association)
        tracks = with_returns(tracks, [(pair.ended, pair.began) for pair in pairs])
    return tracks


def merged(steps: Sequence[Step], detections: Detections) -> Step:
    """One step of several pipelines that share a frame; its rows are those of the first.

    Parameters
    ----------
    steps : of each, of which every detection has a different row.
    detections : of the frame, (N,) those of all.
    """
    first = steps[0]
    parts = [step.estimates for step in steps]
    tag = np.zeros(0, np.int64)
    if all(len(part.tag) == len(part) for part in parts):
        # Tags of different pipelines differ.
        tag = np.concatenate([len(parts) * part.tag + k for k, part in enumerate(parts)])
    estimates = Estimates(
        np.concatenate([part.state for part in parts], axis=1),
        np.concatenate([part.covariance for part in parts]),
        np.concatenate([part.weight for part in parts]),
        np.concatenate([part.xyxy for part in parts]),
        np.concatenate([part.detection for part in parts]),
        tag,
    )
    return Step(
        first.number,
        first.time,
        detections,
        _merged_info(steps),
        estimates,
        first.tracks,
        tuple(np.sum([step.seconds for step in steps], axis=0).tolist()),
        sum(step.unusable for step in steps),
        first.warp,
        tuple(each for step in steps for each in step.appeared),
    )


def _merged_info(steps: Sequence[Step]) -> UpdateInfo:
    """The record of the updates of several pipelines that share a frame."""
    infos = [step.info for step in steps]
    evidence = clutter = probability = cardinality = np.zeros(0)
    if all(len(step.info.evidence) == len(step.detections) for step in steps):
        order = np.argsort(np.concatenate([step.detections.row for step in steps]))
        evidence = np.concatenate([info.evidence for info in infos])[order]
        clutter = np.concatenate([info.clutter for info in infos])[order]
        probability = np.concatenate([info.clutter_probability for info in infos])[order]
    if all(len(info.cardinality) for info in infos):
        cardinality = reduce(np.convolve, [info.cardinality for info in infos])
    return UpdateInfo(
        sum(info.mass_predicted for info in infos),
        sum(info.mass_born for info in infos),
        sum(info.mass for info in infos),
        evidence,
        clutter,
        probability,
        sum(info.vanished for info in infos),
        cardinality,
        sum(info.detected for info in infos),
    )


def _with_hidden_targets(model: Model, targets: F8, dt: float) -> Model:
    """The model whose sensor knows which targets of the last frame may hide others by now."""
    if targets.shape[1] == 0:
        return model
    ahead, _, _ = model.motion.transition(model.warp_states(np.ascontiguousarray(targets)), dt)
    return replace(model, sensor=model.sensor.watching(ahead))


def _check_order(state: TrackingState, number: int, time: float) -> None:
    """Raise `InputError` if number or time does not grow, or is not finite."""
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
