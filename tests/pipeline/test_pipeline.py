"""The loop: its order, true intervals, frames that nobody looked at, and errors before anything changes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from spies import INFO, spying

from phdtrack import config, pipeline
from phdtrack.errors import InputError
from phdtrack.filters import ParticlePHD
from phdtrack.types import Detections

BOX = Detections.of([[100, 100, 140, 200]])


KINDS = {"pmb": [], "particle-phd": ["filter.kind=particle-phd", "filter.particles_per_target=200", "birth.particles=200"]}


@pytest.fixture(params=KINDS)
def stages(request):
    return config.build(config.load(sets=KINDS[request.param]), INFO)


def test_a_frame_is_predicted_updated_reduced_extracted_and_linked(rng):
    stages, filter_, extractor, associator = spying()
    state, step = pipeline.advance(stages, pipeline.start(stages, rng), BOX, 1, 0.0, rng)
    assert filter_.calls == [("predict", 1.0), ("update", 1.0, (4, 1)), ("reduce",)]
    assert extractor.seen == [(("predict", 1.0), ("update", (4, 1)))]
    assert associator.frames == [(1, 1.0)]
    assert (state.number, state.time, state.association) == (1, 0.0, 1)
    assert (step.number, step.time, len(step.tracks), len(step.estimates)) == (1, 0.0, 1, 1)
    assert step.detections is BOX
    assert len(step.seconds) == 3
    assert min(step.seconds) >= 0


@pytest.mark.parametrize(("rate", "times", "intervals"), [
    (25.0, [0.0, 0.04, 0.08], [1, 1, 1]),
    (25.0, [0.0, 1 / 7, 4 / 7], [1, 25 / 7, 75 / 7]),
    (1.0, [10.0, 11.0, 11.5], [1, 1, 0.5]),
    (1000.0, [0.0, 0.001, 3600.0], [1, 1, 3599999]),
])  # fmt: skip
def test_intervals_are_those_of_the_times(rate: float, times: list[float], intervals: list[float], rng):
    stages, filter_, _, associator = spying(rate)
    list(pipeline.run(stages, [(k, t, BOX) for k, t in enumerate(times, 1)], rng))
    assert [dt for name, dt, *_ in (c for c in filter_.calls if c[0] == "predict")] == pytest.approx(intervals)
    assert [dt for name, dt, *_ in (c for c in filter_.calls if c[0] == "update")] == pytest.approx(intervals)
    assert [dt for _, dt in associator.frames] == pytest.approx(intervals)


def test_a_frame_that_nobody_looked_at_is_only_predicted(rng):
    stages, filter_, _, associator = spying()
    unseen = Detections(BOX.xyxy, BOX.confidence, BOX.class_id, observed=False)
    _, step = pipeline.advance(stages, pipeline.start(stages, rng), unseen, 1, 0.0, rng)
    assert filter_.calls == [("predict", 1.0)]
    assert associator.frames == [(1, 1.0)]
    assert len(step.estimates) == 0, "its boxes are not taken up"
    assert len(step.info.evidence) == len(step.info.clutter) == 0


def test_an_empty_frame_is_not_an_unobserved_one(stages, rng):
    state = pipeline.start(stages, rng)
    for k in range(1, 11):
        state, _ = pipeline.advance(stages, state, BOX, k, k / 25, rng)
    before = state.intensity.mass
    empty, _ = pipeline.advance(stages, state, Detections.empty(), 11, 11 / 25, rng)
    unseen, step = pipeline.advance(stages, state, Detections.empty(observed=False), 11, 11 / 25, rng)
    survival, p_d = stages.model.motion.survival_probability ** (1 / 25), stages.model.sensor.detection_probability
    assert unseen.intensity.mass == pytest.approx(before * survival)
    if isinstance(stages.filter, ParticlePHD):
        assert empty.intensity.mass == pytest.approx(before * survival * (1 - p_d))
    else:
        # One who may be hidden: at least what would be left of somebody in view for certain.
        missed = before * survival * (1 - p_d)
        assert missed / (missed + 1 - before * survival) <= empty.intensity.mass < unseen.intensity.mass
    assert len(step.estimates) == 1
    assert step.estimates.detection.tolist() == [-1]


@pytest.mark.parametrize(("number", "time"), [(3, 1.0), (2, 1.0), (4, 0.12), (4, 0.11), (4, math.nan), (4, math.inf)])
def test_numbers_and_times_must_grow(stages, rng, number: int, time: float):
    state = pipeline.start(stages, rng)
    state, _ = pipeline.advance(stages, state, BOX, 3, 0.12, rng)
    drawn = rng.bit_generator.state
    with pytest.raises(InputError, match=f"frame {number}"):
        pipeline.advance(stages, state, BOX, number, time, rng)
    assert rng.bit_generator.state == drawn, "nothing happened"


def test_the_first_time_must_be_a_number(stages, rng):
    with pytest.raises(InputError, match="seconds"):
        pipeline.advance(stages, pipeline.start(stages, rng), BOX, 1, math.nan, rng)


def test_the_first_frame_is_1(stages, rng):
    with pytest.raises(InputError, match="from 1, got 0"):
        pipeline.advance(stages, pipeline.start(stages, rng), BOX, 0, 0.0, rng)


def test_states_are_values(stages):
    """Going on twice from one state gives the same twice, and leaves the state as it was."""
    rng = np.random.default_rng(0)
    state = pipeline.start(stages, rng)
    for k in range(1, 8):
        state, _ = pipeline.advance(stages, state, BOX, k, k / 25, rng)
    ends = []
    for _ in range(2):
        here, again = state, np.random.default_rng(1)
        for k in range(8, 14):
            here, step = pipeline.advance(stages, here, BOX, k, k / 25, again)
        ends.append((here, step))
    (a, step_a), (b, step_b) = ends
    assert a.intensity.mass == b.intensity.mass
    np.testing.assert_array_equal(step_a.estimates.state, step_b.estimates.state)
    np.testing.assert_array_equal(step_a.estimates.covariance, step_b.estimates.covariance)
    np.testing.assert_array_equal(step_a.tracks.xyxy, step_b.tracks.xyxy)
    assert (state.number, len(pipeline.finish(stages, state))) == (7, 7)


def test_a_sequence_may_end_before_it_begins(stages, rng):
    assert list(pipeline.run(stages, [], rng)) == []
    assert len(pipeline.finish(stages, pipeline.start(stages, rng))) == 0


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("scaling", ["particle", "detection", "previous", "fixed", "given"])
def test_every_scaling_takes_frames_without_detections(scaling: str, kind: str, rng):
    stages = config.build(config.load(sets=[f"sensor.scaling={scaling}", f"filter.kind={kind}"]), INFO)
    cov = np.diag([4.0, 9.0, 16.0, 36.0])[None]
    # Somebody who walks.
    seen = [Detections(BOX.xyxy + 2 * k * np.array([1, 0, 1, 0]), BOX.confidence, BOX.class_id, cov) for k in range(20)]
    missed = {0: Detections.empty(), 11: Detections.empty(), 13: Detections.empty(observed=False)}
    frames = [(k + 1, k / 25, missed.get(k, found)) for k, found in enumerate(seen)]
    *_, (state, _) = pipeline.run(stages, frames, rng)
    assert set(pipeline.finish(stages, state).identity) == {1}
