from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from report_runs import HIGH, WIDE, run_record, step, walkers

from phdtrack.errors import InputError
from phdtrack.report import About, Recorder, Series
from phdtrack.report.record import sentences, still_background
from phdtrack.types import Particles, SequenceInfo, Tracks, Truth

INFO = SequenceInfo(WIDE, HIGH, 10.0)
NOTHING = np.zeros((0, 4))


def test_numbers_of_every_frame_arrive_where_they_belong() -> None:
    recorder = Recorder(INFO)
    for number, boxes in walkers(5, 3, INFO).items():
        recorder.add(None, step(number, boxes[:number], clutter=0.2), None, 0.5 * number)
    frame = np.array([1, 1, 2, 7])
    truth = Truth(frame, np.array([1, 2, 1, 1]), np.ones((4, 4)), np.array([False, True, False, False]))
    series = recorder.record(Tracks.empty(), About(), truth).series
    np.testing.assert_array_equal(series.numbers, [1, 2, 3, 4, 5])
    np.testing.assert_allclose(series.times, [0.1, 0.2, 0.3, 0.4, 0.5])
    np.testing.assert_array_equal(series.n_detections, [1, 2, 3, 3, 3])
    np.testing.assert_array_equal(series.n_estimates, [1, 2, 3, 3, 3])
    np.testing.assert_allclose(series.mass, 0.8 * series.n_detections)
    np.testing.assert_allclose(series.clutter_mass, 0.2 * series.n_detections)
    np.testing.assert_allclose(series.seconds[1], [1.0, 0.004, 0.002, 0.001])
    np.testing.assert_array_equal(series.truth_count, [1, 1, 0, 0, 0])  # distractors do not count


def test_track_count_objects_and_speed() -> None:
    record = run_record(10, 3)
    np.testing.assert_array_equal(record.track_count, np.full(10, 3))
    assert record.n_objects == 3
    assert record.frames_per_second == pytest.approx(1 / (0.003 + 0.004 + 0.002 + 0.001))
    assert [rows.identity[0] for rows in record.by_identity()] == [1, 2, 3]
    assert all((np.diff(rows.frame) == 1).all() for rows in record.by_identity())


def test_speed_is_that_of_the_overlapping_stages_where_it_was_measured() -> None:
    record = run_record(10, 3, about=About(tracking_seconds=0.05))
    assert record.frames_per_second == pytest.approx(200)


def test_the_range_of_the_number_is_kept_where_the_filter_has_a_distribution() -> None:
    recorder = Recorder(INFO)
    for number, held in enumerate([(0.04, 0.02, 0.5, 0.4, 0.03, 0.01), (), (1.0,), (0.0, 0.0, 1.0)], start=1):
        recorder.add(None, step(number, NOTHING, cardinality=held), None, 0.0)
    found = recorder.record(Tracks.empty(), About()).series.count_range
    np.testing.assert_array_equal(found, [[1, 3], [np.nan, np.nan], [0, 0], [2, 2]])
    assert run_record(3).series.count_range.shape == (0, 2)


def test_nothing_at_all() -> None:
    record = Recorder(INFO).record(Tracks.empty(), About())
    assert len(record.series) == 0
    assert record.by_identity() == ()
    assert record.heat_maps == ()
    assert record.background.shape == (0, 0, 3)
    assert np.isnan(record.frames_per_second)


def test_heat_maps_are_few_spread_and_hold_the_mass() -> None:
    record = run_record(100, 2)
    numbers = np.array([heat.number for heat in record.heat_maps])
    assert len(numbers) == 4
    assert np.diff([0, *numbers, 100]).max() <= 50
    for heat in record.heat_maps:
        assert heat.mass == pytest.approx(2.0)
        assert heat.image.shape == (HIGH, WIDE, 3)
        assert heat.detections.shape == (2, 4)


def test_the_same_run_keeps_the_same_frames() -> None:
    first, second = run_record(37), run_record(37)
    assert [h.number for h in first.heat_maps] == [h.number for h in second.heat_maps]


def test_pictures_are_scaled_down_copies() -> None:
    info = SequenceInfo(1000, 300, 10.0)
    recorder = Recorder(info, picture_width=200)
    picture = np.full((300, 1000, 3), 80, np.uint8)
    recorder.add(picture, step(1, NOTHING), Particles(np.zeros((6, 0)), np.zeros(0)), 0.0)
    small = Recorder(SequenceInfo(8, 6, 10.0))
    tiny = np.full((6, 8, 3), 80, np.uint8)
    small.add(tiny, step(1, NOTHING), None, 0.0)
    picture[:], tiny[:] = 0, 0
    record = recorder.record(Tracks.empty(), About())
    assert record.background.shape == (60, 200, 3)
    assert (record.background == 80).all()
    assert (record.heat_maps[0].image == 80).all()
    assert (small.record(Tracks.empty(), About()).background == 80).all()


def test_memory_does_not_grow_with_the_pictures() -> None:
    info = SequenceInfo(640, 480, 10.0)
    recorder = Recorder(info, picture_width=160)
    tracemalloc.start()
    for number in range(1, 1501):
        recorder.add(np.empty((480, 640, 3), np.uint8), step(number, NOTHING), None, 0.0)
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    pictures = 12 * 160 * 120 * 3
    assert held < pictures + 1500 * 1000


def test_detections_without_a_frame_size_still_make_a_record() -> None:
    recorder = Recorder(SequenceInfo(0, 0, 10.0))
    recorder.add(None, step(1, NOTHING), Particles(np.zeros((6, 0)), np.zeros(0)), 0.0)
    assert len(recorder.record(Tracks.empty(), About()).series) == 1


def test_series_of_different_lengths_are_refused() -> None:
    one, two = np.zeros(1), np.zeros(2)
    with pytest.raises(InputError, match="same number of frames"):
        Series(two.astype(int), two, two.astype(int), two.astype(int), one, two, np.zeros((2, 4)))


def test_a_still_camera_gives_the_scene_without_objects() -> None:
    images = [np.full((20, 90, 3), 100, np.uint8) for _ in range(5)]
    for k, image in enumerate(images):
        image[:, 6 * k : 6 * k + 3] = 255
    assert (still_background(images) == 100).all()


def test_a_moving_camera_gives_one_of_its_frames(rng: np.random.Generator) -> None:
    images = [rng.integers(0, 255, (20, 30, 3), dtype=np.uint8) for _ in range(5)]
    assert (still_background(images) == images[2]).all()


def test_frames_that_compiled_are_no_measure_of_the_speed():
    record = run_record(10, 3, about=About(tracking_seconds=0.04, left_out=2))
    assert record.frames_per_second == pytest.approx(200)
    assert "ran at 200.0 frames per second, not counting 2 frames of start-up." in " ".join(sentences(record))
    assert np.isnan(run_record(10, 3, about=About(left_out=10)).frames_per_second)
