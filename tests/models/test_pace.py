"""The time of streams of few pictures: the same tracks at one picture in five minutes, and videos as the clock says."""

from __future__ import annotations

import numpy as np
import pytest

from phdtrack import Tracker, config
from phdtrack.models.pace import FACTORS, MARGIN, Pace, PaceState
from phdtrack.protocols import Model
from phdtrack.types import Detections, SequenceInfo

FRAMES = 30
SIZE = np.array([30.0, 40.0])


def model() -> Model:
    """The model of the preset for any camera."""
    return config.build(config.load(preset="default"), SequenceInfo(640, 480, 25.0)).model


def boxes(number: int, step: float) -> np.ndarray:
    """Nine targets of 30 x 40 pixels that go ``step`` pixels a frame, each its own way, measured to within a pixel."""
    rng = np.random.default_rng(number)
    corner = np.stack(np.meshgrid([100.0, 300.0, 500.0], [80.0, 220.0, 360.0]), axis=-1).reshape(-1, 2)
    way = np.array([[np.cos(k), np.sin(k)] for k in range(9)])
    corner = corner + step * (number - 1) * way + rng.normal(size=(9, 2))
    return np.column_stack([corner, corner + SIZE, np.full(9, 0.9)])


def tracked(fps: float, step: float) -> tuple[Tracker, list[tuple[int, int, np.ndarray]]]:
    """The tracker after all frames, and frame, identity and box of its corrected rows."""
    tracker = Tracker((640, 480), fps=fps, preset="default")
    for number in range(1, FRAMES + 1):
        tracker.update(boxes(number, step))
    found = tracker.tracks()
    return tracker, list(zip(found.frame.tolist(), found.identity.tolist(), found.xyxy, strict=True))


@pytest.mark.parametrize("fps", [1.0, 1 / 300, 1 / 3600])
def test_slow_targets_are_tracked_however_long_the_intervals_are(fps: float):
    """They go a tenth of their size from picture to picture: it is the same as at five pictures a second."""
    (slow, found), (_, expected) = tracked(fps, 3.0), tracked(5.0, 3.0)
    assert slow.state.pace.factor == pytest.approx(fps / 5)
    assert len({identity for _, identity, _ in found}) == 9
    assert [row[:2] for row in found] == [row[:2] for row in expected]
    np.testing.assert_allclose([row[2] for row in found], [row[2] for row in expected], atol=1e-4)


def test_the_time_of_videos_is_that_of_the_clock():
    """Also with a pause in between; what is remembered of each picture is then nothing."""
    rule, state, world = Pace(0.2), Pace(0.2).start(np.zeros((4, 0))), model()
    for number, seconds in enumerate([0.2, *[0.04, 0.1] * 5, 60.0, *[0.04] * 20], start=1):
        state = rule.advance(state, world.sensor.measure(detections(number)), seconds, world)
        assert state.factor == 1
    assert state.before.shape == (4, 0)
    assert tracked(30.0, 1.0)[0].state.pace.factor == 1


def detections(number: int) -> Detections:
    """What `boxes` gives, without scores."""
    return Detections.of(boxes(number, 3.0)[:, :4])


def test_at_a_picture_a_second_what_moves_far_goes_by_the_clock():
    """Targets that go two of their sizes from picture to picture are found with the speeds of videos, and not slower."""
    rule, world = Pace(0.2), model()
    state = rule.start(world.sensor.measure(far(1)))
    for number in range(2, 8):
        state = rule.advance(state, world.sensor.measure(far(number)), 1.0, world)
    assert state.factor > 0.6


def far(number: int) -> Detections:
    """Three targets of 30 x 40 pixels far from each other, 70 pixels further in each frame."""
    corner = np.array([[70.0 * number, 0.0], [70.0 * number, 1000.0], [70.0 * number, 2000.0]])
    return Detections.of(np.column_stack([corner, corner + SIZE]))


def test_the_factor_is_the_most_likely_one():
    """By the definition, link by link; the most likely, times the margin, within its limits."""
    world, rng = model(), np.random.default_rng(3)
    before, z = (np.concatenate([rng.uniform(0, 300, (2, n)), rng.uniform(20, 40, (2, n))]) for n in (4, 5))
    found = Pace(0.2).advance(PaceState(before=before), z, 50.0, world)
    state, covariance = world.sensor.states(before)
    rows, clutter = [0, 1, 4, 5], world.clutter.intensity(z)
    expected = np.zeros(len(FACTORS))
    for k, factor in enumerate(FACTORS):
        mean, slope, noise = world.motion.transition(state, 50.0 * world.rate * factor)
        for j in range(5):
            total = clutter[j]
            for i in range(4):
                spread = slope[i] @ covariance[i] @ slope[i].T + noise[i]
                s = spread[np.ix_(rows, rows)] + np.diag(world.sensor.noise(state)[rows, i] ** 2)
                away = z[:, j] - mean[rows, i]
                density = np.exp(-0.5 * away @ np.linalg.solve(s, away)) / np.sqrt(np.linalg.det(2 * np.pi * s))
                total += world.sensor.detection_probability * density
            expected[k] += np.log(total)
    np.testing.assert_allclose(found.evidence, expected, rtol=1e-9)
    assert found.factor == min(max(MARGIN * FACTORS[expected.argmax()], 0.2 / 50), 1)


def test_frames_without_detections_say_nothing():
    world, rule = model(), Pace(0.2)
    z = world.sensor.measure(detections(1))
    state = rule.advance(rule.start(z), z[:, :0], 10.0, world)
    assert (state.evidence == 0).all()
    assert (rule.advance(state, z, 10.0, world).evidence == 0).all()


def test_false_alarms_of_slower_streams_are_fewer_where_asked_for():
    """At four time units between pictures half of them, with a decay of 0.5; at one and below it changes nothing."""

    def masses(dt: float, clutter: float, decay: float) -> list[float]:
        sets = [f"filter.clutter_decay={decay}", f"clutter.clutter_per_detection={clutter}"]
        stages, rng = config.build(config.load(sets=sets), SequenceInfo(640, 480, 25.0)), np.random.default_rng(0)
        state, found = stages.filter.start(stages.model, rng), []
        for number in range(1, 9):
            z = stages.model.sensor.measure(detections(number))
            state, info = stages.filter.step(state, z, stages.model, dt, rng)
            found.append(info.mass)
        return found

    np.testing.assert_allclose(masses(4.0, 0.4, 0.5), masses(4.0, 0.2, 0.0), rtol=1e-9)
    assert masses(1.0, 0.4, 0.5) == masses(1.0, 0.4, 0.0)
    assert masses(0.2, 0.4, 0.5) == masses(0.2, 0.4, 0.0)
