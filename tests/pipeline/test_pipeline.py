"""The loop: its order, true intervals, unobserved frames, and errors before anything
changes.
"""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from phdtrack import config, pipeline
from phdtrack.errors import InputError
from phdtrack.filters import ParticlePHD
from phdtrack.protocols import Stages
from phdtrack.types import Detections, SequenceInfo

INFO = SequenceInfo(640, 480, 25.0)
BOX = Detections.of([[100, 100, 140, 200]])


class Recorded:
    """A stage whose calls are written down: the method and its arguments."""

    def __init__(self, inner, calls: list) -> None:
        self.inner = inner
        self.calls = calls

    def __getattr__(self, name: str):
        def call(*arguments):
            self.calls.append((name, *arguments))
            return getattr(self.inner, name)(*arguments)

        return call


def recorded(rate: float = 25.0) -> tuple[Stages, list]:
    """The stages of the PMB filter, and the calls of filter, extractor and associator after the
    start.
    """
    built = config.build(
        config.load(sets=[f"time.units_per_second={rate}", "time.longest_interval=0"]), INFO
    )
    calls = []
    own = {
        name: Recorded(getattr(built, name), calls)
        for name in ("filter", "extractor", "associator")
    }
    return replace(built, **own), calls


def advanced(stages: Stages, calls: list, frames, rng):
    """The state and the step after the last of the frames; only their calls are left."""
    state = pipeline.start(stages, rng)
    calls.clear()
    for number, time, found in frames:
        state, step = pipeline.advance(stages, state, found, number, time, rng)
    return state, step


def test_a_frame_is_filtered_extracted_and_linked(rng):
    stages, calls = recorded()
    state, step = advanced(stages, calls, [(1, 0.0, BOX)], rng)
    # The boxes that are shown depend on which frames are still remembered.
    assert [name for name, *_ in calls] == ["step", "extract", "extend", "oldest"]
    filtered, extracted, extended, _ = calls
    _, _, z, _, dt, _ = filtered
    _, seen, shown, _ = extracted
    _, _, estimates, *_, number, interval, _ = extended
    assert (dt, interval, number) == (1.0, 1.0, 1)
    assert shown is z
    assert seen is state.intensity
    assert estimates.state is step.estimates.state
    assert (state.number, state.time) == (step.number, step.time) == (1, 0.0)
    assert step.detections is BOX
    assert len(step.seconds) == 3
    assert min(step.seconds) >= 0


@pytest.mark.parametrize(("rate", "times", "intervals"), [
    (25.0, [0.0, 0.04, 0.08], [1, 1, 1]),
    (25.0, [0.0, 1 / 7, 4 / 7], [1, 25 / 7, 75 / 7]),
    (1.0, [10.0, 11.0, 11.5], [1, 1, 0.5]),
    (1000.0, [0.0, 0.001, 3600.0], [1, 1, 3599999]),
])  # fmt: skip
def test_intervals_are_those_of_the_times(
    rate: float, times: list[float], intervals: list[float], rng
):
    stages, calls = recorded(rate)
    advanced(stages, calls, [(k, t, BOX) for k, t in enumerate(times, 1)], rng)
    assert [call[4] for call in calls if call[0] == "step"] == pytest.approx(intervals)
    assert [call[6] for call in calls if call[0] == "extend"] == pytest.approx(intervals)


def test_an_unobserved_frame_is_only_predicted(rng):
    stages, calls = recorded()
    unseen = Detections(BOX.xyxy, BOX.confidence, BOX.class_id, observed=False)
    before, step = advanced(stages, calls, [(1, 0.0, unseen)], rng)
    # Before the first observed frame there is no track to show.
    assert [name for name, *_ in calls] == ["predict", "extract"]
    assert len(step.estimates) == 0, "its boxes are not taken up"
    assert len(step.info.evidence) == len(step.info.clutter) == 0
    state, _ = pipeline.advance(stages, before, BOX, 2, 0.04, rng)
    calls.clear()
    after, _ = pipeline.advance(stages, state, unseen, 3, 0.08, rng)
    assert [name for name, *_ in calls] == ["predict", "extract", "extend"]
    assert after.intensity is state.intensity
    assert (after.number, after.time) == (3, 0.08)
    assert (after.observed, after.observed_time) == (2, 0.04)


def test_intervals_are_those_since_the_last_observed_frame(rng):
    stages, calls = recorded()
    unseen = Detections.empty(observed=False)
    frames = [(1, 0.0, BOX), (2, 0.04, unseen), (3, 0.08, unseen), (4, 0.12, BOX)]
    advanced(stages, calls, frames, rng)
    intervals = [call[4] for call in calls if call[0] == "step"]
    assert intervals == pytest.approx([1, 3])
    assert [call[3] for call in calls if call[0] == "predict"] == pytest.approx([1, 2])
    assert [call[6] for call in calls if call[0] == "extend"] == pytest.approx([1, 1, 2, 3])


KINDS = {
    "pmb": [],
    "particle-phd": [
        "filter.kind=particle-phd",
        "filter.particles_per_target=200",
        "birth.particles=200",
    ],
}


@pytest.fixture(params=KINDS)
def stages(request):
    return config.build(config.load(sets=KINDS[request.param]), INFO)


def test_an_empty_frame_is_not_an_unobserved_one(stages, rng):
    state = pipeline.start(stages, rng)
    for k in range(1, 11):
        state, _ = pipeline.advance(stages, state, BOX, k, k / 25, rng)
    before = state.intensity.mass
    unseen, step = pipeline.advance(
        stages, state, Detections.empty(observed=False), 11, 11 / 25, rng
    )
    empty, _ = pipeline.advance(stages, state, Detections.empty(), 11, 11 / 25, rng)
    survival = stages.model.motion.survival_probability ** (1 / 25)
    p_d = stages.model.sensor.detection_probability
    assert unseen.intensity is state.intensity
    assert step.info.mass == pytest.approx(before * survival)
    if isinstance(stages.filter, ParticlePHD):
        assert empty.intensity.mass == pytest.approx(before * survival * (1 - p_d))
    else:
        # One who may be hidden: at least what would be left of somebody in view for certain.
        missed = before * survival * (1 - p_d)
        assert missed / (missed + 1 - before * survival) <= empty.intensity.mass < step.info.mass
    assert len(step.estimates) == 1
    assert step.estimates.detection.tolist() == [-1]


@pytest.mark.parametrize(
    ("number", "time", "says"), [(1, math.nan, "seconds"), (0, 0.0, "from 1, got 0")]
)
def test_the_first_frame_is_1_at_some_time(stages, rng, number: int, time: float, says: str):
    with pytest.raises(InputError, match=says):
        pipeline.advance(stages, pipeline.start(stages, rng), BOX, number, time, rng)


def test_a_sequence_may_end_before_it_begins(stages, rng):
    assert list(pipeline.run(stages, [], rng)) == []
    assert len(pipeline.finish(stages, pipeline.start(stages, rng))) == 0
