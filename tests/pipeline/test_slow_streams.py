"""The time of streams of few pictures: the same tracks at one picture in five minutes, and videos
as the clock says.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from phdtrack import Tracker, config, pipeline
from phdtrack.types import Detections, SequenceInfo

FRAMES = 30
SIZE = np.array([30.0, 40.0])


def boxes(number: int, step: float) -> np.ndarray:
    """Nine targets of 30 x 40 pixels that go ``step`` pixels a frame, each its own way, measured to
    within a pixel.
    """
    rng = np.random.default_rng(number)
    corner = np.stack(np.meshgrid([100.0, 300.0, 500.0], [80.0, 220.0, 360.0]), axis=-1).reshape(
        -1, 2
    )
    way = np.array([[np.cos(k), np.sin(k)] for k in range(9)])
    corner = corner + step * (number - 1) * way + rng.normal(size=(9, 2))
    return np.column_stack([corner, corner + SIZE, np.full(9, 0.9)])


def tracked(fps: float, step: float, kind: str = "") -> tuple[np.ndarray, np.ndarray]:
    """Identity (27, 9) and box (27, 9, 4) of each target from the fourth frame on, in the corrected
    rows; identity 0 without a row.
    """
    tracker = Tracker((640, 480), fps=fps, preset="default", filter=kind)
    for number in range(1, FRAMES + 1):
        tracker.update(boxes(number, step))
    found = tracker.tracks()
    identity = np.zeros((FRAMES, 9), np.int64)
    xyxy = np.zeros((FRAMES, 9, 4))
    for frame, name, box in zip(found.frame, found.identity, found.xyxy, strict=True):
        target = np.argmin(np.abs(boxes(frame, step)[:, :4] - box).sum(axis=1))
        identity[frame - 1, target] = name
        xyxy[frame - 1, target] = box
    return identity[3:], xyxy[3:]


OTHERS = ("none", "gm-phd", "gm-cphd", "particle-phd", "mht", "pmbm", "mcmc")


@pytest.mark.parametrize(
    ("fps", "kind"), [(1.0, ""), (1 / 300, ""), (1 / 3600, ""), *((0.7, kind) for kind in OTHERS)]
)
def test_slow_targets_are_tracked_however_long_the_intervals_are(fps: float, kind: str):
    """They go a tenth of their size from picture to picture: it is as at five pictures a second,
    but more enter from picture to picture, so that tracks may begin some frames later.
    """
    identity, xyxy = tracked(fps, 3.0, kind)
    assert (identity == identity[0]).all()
    assert len(np.unique(identity[identity > 0])) == 9
    np.testing.assert_allclose(xyxy, tracked(5.0, 3.0, kind)[1], atol=1.5)


def detections(number: int) -> Detections:
    """What `boxes` gives, without scores."""
    return Detections.of(boxes(number, 3.0)[:, :4])


def test_the_time_of_videos_is_that_of_the_clock():
    """Also with a pause in between."""
    stages = config.build(config.load(preset="default"), SequenceInfo(640, 480, 25.0))
    always = replace(stages, longest_interval=0.0)
    ends = []
    for each in (stages, always):
        rng = np.random.default_rng(0)
        time = 0.0
        state = pipeline.start(each, rng)
        for number, seconds in enumerate([0.2, *[0.04, 0.1] * 5, 60.0, *[0.04] * 20], start=1):
            time += seconds
            state, _ = pipeline.advance(each, state, detections(number), number, time, rng)
        ends.append(state.intensity.layers[-1].mean)
    np.testing.assert_array_equal(*ends)


def test_clutter_decay_lowers_false_alarms_of_slow_streams():
    """Those that come again, four fifths of them: at four time units between pictures with a decay
    of log(8)/3 an eighth; at one and below it changes nothing.
    """

    def masses(dt: float, clutter: float, decay: float) -> list[float]:
        sets = [f"filter.clutter_decay={decay}", f"clutter.clutter_per_detection={clutter}"]
        stages = config.build(config.load(sets=sets), SequenceInfo(640, 480, 25.0))
        rng = np.random.default_rng(0)
        state = stages.filter.start(stages.model, rng)
        found = []
        for number in range(1, 9):
            z = stages.model.sensor.measure(detections(number))
            state, info = stages.filter.step(state, z, stages.model, dt, rng)
            found.append(info.mass)
        return found

    decay = np.log(8) / 3
    np.testing.assert_allclose(masses(4.0, 0.4, decay), masses(4.0, 0.12, 0.0), rtol=1e-9)
    assert masses(1.0, 0.4, 0.5) == masses(1.0, 0.4, 0.0)
    assert masses(0.2, 0.4, 0.5) == masses(0.2, 0.4, 0.0)


@pytest.mark.parametrize("fps", [1.0, 2.0, 10.0, 25.0, 60.0])
def test_objects_of_the_first_frame_come_with_the_second(fps: float) -> None:
    """Objects were there before the first frame: their births are not those of one interval."""
    rng = np.random.default_rng(4)
    counts = {}
    for before in (60.0, 0.0):
        tracker = Tracker((1920, 1080), fps=fps, time={"births_before": before})
        counts[before] = []
        for k in range(4):
            x = np.array([300 + 10 * k / fps, 1200.0])
            boxes = np.column_stack([x, [300, 500], x + 60, [460, 660]])
            rows = tracker.update(boxes + rng.normal(0, 2, boxes.shape))
            counts[before].append(len(rows))
    assert counts[60.0][2:] == [2, 2]
    assert counts[60.0][1] == 2 or fps < 5
    assert sum(counts[60.0]) > sum(counts[0.0])
