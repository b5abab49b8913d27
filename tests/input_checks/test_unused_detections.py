"""Warnings of detections that come again and again and are used by no track."""

from __future__ import annotations

import logging

import numpy as np
import pytest

from input_checks.streams import SIZE, scored, walkers, warnings
from phdtrack import Tracker
from phdtrack.input_checks.unused_detections import UseCounts, use_warning
from phdtrack.types import Detections

# With these nothing becomes an object, however often it is detected.
CLUTTER = {"clutter": {"clutter_per_detection": 1e5}}
UNCERTAIN = {"extract": {"min_weight": 1 - 1e-9}}


@pytest.mark.parametrize(("fps", "frames"), [(1.0, 80), (25.0, 200), (60.0, 420)])
@pytest.mark.parametrize("count", [1, 30])
def test_unused_detections_are_reported_once(fps: float, frames: int, count: int) -> None:
    said = warnings(walkers(frames, count, fps), fps, **CLUTTER)
    assert len(said) == 1
    assert "detections that recur in 6 or more frames in a row are used by a track" in said[0]
    assert "the filter takes them for false alarms. If they show objects, check fps" in said[0]
    assert "set sensor.detection_probability to" in said[0]
    assert "filter.static_clutter_prior" in said[0]


@pytest.mark.parametrize(("fps", "frames"), [(1.0, 80), (25.0, 200), (60.0, 420)])
@pytest.mark.parametrize("count", [1, 30])
def test_used_detections_are_no_warning(fps: float, frames: int, count: int) -> None:
    assert warnings(walkers(frames, count, fps), fps) == []
    assert warnings(scored(walkers(frames, count, fps)), fps) == []


def test_sentence_reaches_the_logger(caplog: pytest.LogCaptureFixture) -> None:
    tracker = Tracker(SIZE, **CLUTTER)
    with caplog.at_level(logging.WARNING):
        for boxes in walkers(200):
            tracker.update(boxes)
    assert [(r.name, r.getMessage()) for r in caplog.records] == [
        ("phdtrack.tracker", sentence) for sentence in tracker.warnings
    ]
    assert tracker.warnings[0].startswith("frame 1")
    assert " none of " in tracker.warnings[0]


def test_a_few_that_are_used_are_counted() -> None:
    counts = UseCounts(0.0, 300, 320, 300, 12, 0, 290.0)
    said = use_warning(counts, 0.9, 25.0, ("sensor.detection_probability",))
    assert said == (
        "at most 12 of 300 detections that recur in 6 or more frames in a row are used by a track:"
        " the filter takes them for false alarms. If they show objects, check fps=25 or set"
        " sensor.detection_probability to the share of frames in which an object is detected"
    )
    above = counts._replace(unusable=200)
    assert "they show no possible place on the ground" in use_warning(above, 0.9, 25.0, ())


def test_low_scores_are_named() -> None:
    (said,) = warnings(scored(walkers(200), 0.25), **UNCERTAIN)[1:]
    assert "the filter finds no object that is certain enough" in said
    assert "check fps=25 and the scores, of which the highest is 0.25" in said
    assert "extract.min_weight" in said


def test_only_settings_of_the_filter_are_named() -> None:
    (said,) = warnings(walkers(200, 3), filter="gm-phd", **CLUTTER)
    assert "static_clutter_prior" not in said
    assert "lower clutter.clutter_per_detection or extract.min_weight" in said


def test_false_alarms_by_chance_are_no_warning() -> None:
    rng = np.random.default_rng(3)
    corner = rng.uniform(0, [1800, 900], (250, 60, 2))
    frames = np.concatenate([corner, corner + np.array([60, 160])], axis=2)
    assert warnings(frames, **CLUTTER) == []


def test_a_few_seconds_are_too_short() -> None:
    assert warnings(walkers(100, 30), **CLUTTER) == []
    assert warnings(walkers(290, 30, 60.0), 60.0, **CLUTTER) == []
    assert warnings(walkers(20, 30, 1.0), 1.0, **CLUTTER) == []


def test_a_delay_of_the_rows_is_no_warning() -> None:
    assert warnings(walkers(250, 5), associate={"output_delay": 100}) == []
    assert len(warnings(walkers(450, 5), associate={"output_delay": 100}, **CLUTTER)) == 1


def test_empty_scene_before_many_objects_is_no_warning() -> None:
    frames = [np.zeros((0, 4))] * 300 + list(walkers(100, 40))
    assert warnings(frames) == []


def test_unobserved_frames_do_not_break_the_chains() -> None:
    frames = list[object]()
    for boxes in walkers(100, 3, 5.0):
        frames += [boxes, *[Detections.empty(observed=False)] * 4]
    assert warnings(frames) == []
    assert len(warnings(frames, **CLUTTER)) == 1
