"""What is recorded of a run: numbers per frame, pictures."""

from __future__ import annotations

import math
import tracemalloc
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from report_runs import HIGH, WIDE, run_record, step, walkers

from phdtrack.report import About, Recorder, run_document, sentences
from phdtrack.report.pages import doubts
from phdtrack.report.record import Whole
from phdtrack.types import Frame, SequenceInfo, Tracks, Truth

INFO = SequenceInfo(WIDE, HIGH, 10.0)
NOTHING = np.zeros((0, 4))


def test_record_has_the_numbers_of_every_frame() -> None:
    frame = np.array([1, 1, 2, 7])
    truth = Truth(
        frame, np.array([1, 2, 1, 1]), np.ones((4, 4)), np.array([False, True, False, False])
    )
    recorder = Recorder(INFO, truth)
    for number, boxes in walkers(5, 3, INFO).items():
        recorder.add(None, step(number, boxes[:number], clutter=0.2), 0.5 * number)
    record = recorder.record(Tracks.empty(), About())
    np.testing.assert_array_equal(record.numbers, [1, 2, 3, 4, 5])
    np.testing.assert_allclose(record.times, [0.1, 0.2, 0.3, 0.4, 0.5])
    np.testing.assert_array_equal(record.n_detections, [1, 2, 3, 3, 3])
    np.testing.assert_allclose(record.mass, 0.8 * record.n_detections)
    assert record.whole.false_alarms == pytest.approx(0.2 * record.n_detections.sum())
    np.testing.assert_allclose(record.seconds[1], [1.0, 0.004, 0.002, 0.001])
    np.testing.assert_array_equal(record.truth_count, [1, 1, 0, 0, 0])  # distractors do not count


def test_count_range_is_kept_if_there_is_a_distribution() -> None:
    recorder = Recorder(INFO)
    for number, held in enumerate(
        [(0.04, 0.02, 0.5, 0.4, 0.03, 0.01), (), (1.0,), (0.0, 0.0, 1.0)], start=1
    ):
        recorder.add(None, step(number, NOTHING, cardinality=held), 0.0)
    found = recorder.record(Tracks.empty(), About()).count_range
    np.testing.assert_array_equal(found, [[1, 3], [np.nan, np.nan], [0, 0], [2, 2]])
    assert run_record(3).count_range.shape == (0, 2)


def test_pictures_are_scaled_down_copies() -> None:
    for info, shape in (
        (SequenceInfo(1600, 300, 10.0), (150, 800, 3)),
        (SequenceInfo(8, 6, 10.0), (6, 8, 3)),
    ):
        recorder = Recorder(info)
        picture = np.full((info.height, info.width, 3), 80, np.uint8)
        recorder.add(Frame(1, 0.0, picture), step(1, NOTHING), 0.0)
        picture[:] = 0
        record = recorder.record(Tracks.empty(), About())
        assert record.background.shape == shape
        assert (record.background == 80).all()


def test_picture_is_from_the_second_half() -> None:
    recorder = Recorder(INFO)
    for number in range(1, 8):
        recorder.add(
            Frame(number, 0.0, np.full((HIGH, WIDE, 3), number, np.uint8)),
            step(number, NOTHING),
            0.0,
        )
    assert (recorder.record(Tracks.empty(), About()).background == 4).all()


def test_memory_does_not_grow_with_the_pictures() -> None:
    recorder = Recorder(SequenceInfo(160, 120, 10.0))
    tracemalloc.start()
    for number in range(1, 1501):
        recorder.add(
            Frame(number, 0.0, np.empty((120, 160, 3), np.uint8)), step(number, NOTHING), 0.0
        )
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert held < 160 * 120 * 3 + 1500 * 1000


def test_compiling_frames_do_not_count_for_speed():
    record = run_record(10, 3, about=About(tracking_seconds=0.04, left_out=2))
    assert record.frames_per_second == pytest.approx(200)
    assert "Speed: 200.0 frames/s after a 2-frame warm-up." in " ".join(sentences(record))
    assert np.isnan(run_record(10, 3, about=About(left_out=10)).frames_per_second)


def test_short_tracks_cause_a_warning_with_the_cure() -> None:
    fine = run_record(12, 10)
    assert doubts(fine) == ()
    # Of three tracks nothing is known.
    assert doubts(run_record(4, 3)) == ()
    (said,) = doubts(run_record(4, 10))
    assert said.startswith("the tracks may be wrong: 100 % of 10 last less than half a second")
    assert "--detections FILE" in said
    # Low scores of a detector are what the filter is for.
    assert doubts(replace(fine, whole=fine.whole._replace(detections=9999))) == ()
    assert doubts(replace(fine, tracks=Tracks.empty())) == ()


def test_endless_source_counts_all_frames_and_charts_the_last():
    recorder = Recorder(INFO, most=10)
    for number, boxes in walkers(30, 2, INFO).items():
        recorder.add(None, step(number, boxes), 0.01)
    rows = Tracks.of(
        np.repeat(np.arange(1, 31), 2),
        np.tile([1, 2], 30),
        np.tile([[0.0, 0, 9, 9]], (60, 1)),
        0.5,
        0,
    )
    # Somebody is in several parts, and counts once.
    for first in (1, 11, 21):
        recorder.count(rows.select((rows.frame >= first) & (rows.frame < first + 10)))
    record = recorder.record(rows.select(rows.frame > 25), About(tracking_seconds=3.0))
    assert len(record) == len(record.track_count) == 10
    whole = record.whole
    assert (whole.frames, whole.objects, whole.rows) == (30, 2, 60)
    assert whole.seconds == pytest.approx(29 / INFO.fps)
    assert (whole.detections, record.n_detections.sum()) == (60, 20)
    assert record.frames_per_second == pytest.approx(10.0)
    document = run_document(record, {})
    assert (document["frames"], document["tracks"], document["track_rows"]) == (30, 2, 60)


def test_detection_rate_counts_observed_frames_only() -> None:
    """Two walkers, of whom one is missed in every other frame; no detector ran in frames 5 to 8."""
    whole = Whole(8, 0.3, 12, 0.0, Counter(), 0, 0, 4, 0)
    frame = np.tile(np.arange(1, 9), 2)
    identity = np.repeat([1, 2], 8)
    detection = np.where((frame > 4) | ((identity == 2) & (frame % 2 == 0)), -1, 0)
    tracks = Tracks.of(frame, identity, np.tile([0.0, 0, 9, 9], (16, 1)), 1.0, detection)
    counted = whole.with_rows(tracks, range(5, 9))
    assert (counted.rows, counted.predicted, counted.missed) == (16, 10, 2)
    assert counted.detection_rate == pytest.approx(6 / 8)
    assert math.isnan(whole.detection_rate)
