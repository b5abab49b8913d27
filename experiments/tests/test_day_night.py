"""The stream of days and nights, and tracking with scenes that change on the way."""

from __future__ import annotations

import numpy as np
import pytest

from experiments import day_night
from experiments.common import Case
from experiments.day_night import StreamJob
from phdtrack import config
from phdtrack.arrays import iou

WORLD = next(iter(day_night.WORLDS))
FRAMES = 120


@pytest.fixture(scope="module")
def stream() -> Case:
    return day_night.stream(StreamJob(WORLD, 1, FRAMES))


def steady(stream: Case, phase: int) -> np.ndarray:
    """(n,) for each frame's detections of a phase, in how many of its frames there is a detection
    at the same place.
    """
    frame = stream.table.frame
    boxes = stream.table.detections.xyxy
    rows = np.flatnonzero((frame > phase * FRAMES) & (frame <= (phase + 1) * FRAMES))
    return boxes[rows][(iou(boxes[rows], boxes[rows]) > 0.5).sum(axis=1) > 0.35 * FRAMES]


def test_false_alarms_come_from_other_places_by_night(stream) -> None:
    day, night, again, _ = (steady(stream, phase) for phase in range(4))
    assert (iou(day, again).max(axis=1) > 0.4).mean() > 0.95
    assert (iou(day, night).max(axis=1) > 0.4).mean() < 0.5


def test_a_stream_goes_on_without_a_gap_and_nobody_returns(stream) -> None:
    assert stream.info.frames == 4 * FRAMES
    assert (np.diff(stream.table.frame) >= 0).all()
    phase = (stream.truth.frame - 1) // FRAMES
    by_phase = [set(stream.truth.identity[phase == k].tolist()) for k in range(4)]
    assert sum(map(len, by_phase)) == len(set.union(*by_phase))
    assert all(by_phase)


def test_stages_may_change_while_tracking(stream) -> None:
    """The same ones give the same scores; those that expect thousands of false alarms from the
    third phase on find nobody there.
    """
    stages = config.build(day_night.settings(WORLD), stream.info)
    flooded = config.build(
        day_night.settings(WORLD, "clutter.clutter_per_detection=1e6"), stream.info
    )
    same = day_night.followed(stream, lambda _: stages, 2 * FRAMES)
    blind = day_night.followed(
        stream, lambda frame: stages if frame <= 2 * FRAMES else flooded, 2 * FRAMES
    )
    assert same.truth_boxes == blind.truth_boxes
    assert same.misses < 0.5 * same.truth_boxes
    assert blind.misses > 0.8 * blind.truth_boxes
