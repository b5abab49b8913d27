"""Tracks that end as no target does: the odds by their definition, and what is left out."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from smoothing_cases import HEIGHT, WIDTH, model_of, piece, sequence, walk

from phdtrack.smooth.smoothing import Smoothing
from phdtrack.smooth.vanished import (
    FLATTERY,
    REPEATED,
    Endings,
    ending_likelihood,
    target_probability,
)
from phdtrack.types import Tracks

MODEL = model_of()
RATE = MODEL.rate


def confident(tracks: Tracks, confidence: list[float]) -> Tracks:
    """The tracks with these confidences by identity, from 1."""
    return replace(tracks, confidence=np.array(confidence)[tracks.identity - 1])


def left(pieces, confidence: list[float], frames: int = 120) -> set[tuple[float, ...]]:
    """The rounded confidences of the tracks that are left."""
    tracks, measured = sequence(pieces, frames, MODEL)
    smoothing = Smoothing(existence=True, frame_size=(WIDTH, HEIGHT))
    rows = smoothing.smooth(confident(tracks, confidence), measured, MODEL)
    return {round(float(each), 4) for each in rows.confidence}


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.floats(0.01, 2.0), min_size=0, max_size=6),
    st.floats(0.01, 0.99),
    st.floats(0.001, 3.0),
)
def test_likelihood_is_the_sum_over_all_ways_to_end(
    intervals: list[float], missed: float, rate: float
):
    ways = 0.0
    inside = 0.0
    for vanishes_at in range(len(intervals) + 1):
        chance = 1.0
        for k, interval in enumerate(intervals[: vanishes_at + 1]):
            stays = np.exp(-rate * interval)
            chance *= 1 - stays if k == vanishes_at else stays * missed
        ways += chance
        inside += chance if vanishes_at < len(intervals) else 0.0
    column = np.zeros((8, 1))
    column[: len(intervals), 0] = intervals
    one = np.ones(1)
    likelihood, vanished = ending_likelihood(Endings(column, missed * one, one, one, 0.04), rate)
    assert likelihood == pytest.approx([ways])
    assert vanished == pytest.approx([inside / ways])


@pytest.mark.parametrize(
    ("interval", "flattery"), [(0.02, FLATTERY), (0.02, 2.0), (0.1, 60.0), (0.2, 1.0)]
)
def test_probabilities_are_right_for_simulated_tracks(interval: float, flattery: float):
    """Of the tracks with probability p the share p are targets, and their rate is found, however
    often a detector runs, and however much the filter claims.
    """
    rng = np.random.default_rng(4)
    count = 40_000
    rate = 0.4
    missed = 0.05
    true = rng.random(count) < 0.7
    life = rng.exponential(1 / rate, count)
    record = rng.exponential(40.0, count)
    stops = rng.geometric(-np.expm1(-interval / REPEATED), count)
    unseen = (rng.geometric(1 - missed, count) - 1) * interval
    frames = np.floor(np.minimum(life, record) / interval)
    seen = np.maximum(frames * interval - unseen, 0.0)
    lasted = np.where(true, seen, (stops - 1) * interval)
    detected = np.where(true, np.round(lasted / interval) + 1, stops)
    after = record - lasted
    intervals = np.where(np.arange(50)[:, None] < np.floor(after / interval + 1e-9), interval, 0.0)
    # What a filter knows before the end is known: the prior, the life of targets, and evidence.
    known = np.log(0.7 / 0.3) - rate * lasted + np.where(true, 2.0, -2.0) + rng.normal(0, 2, count)
    claimed = 1 / (1 + np.exp(-known - np.log(flattery)))
    # Few records end before a false alarm has stopped.
    kept = after >= 0
    true = true[kept]
    endings = Endings(
        intervals[:, kept], np.full(len(true), missed), detected[kept], lasted[kept], interval
    )
    probability, found = target_probability(claimed[kept], endings, 0.075)
    assert found == pytest.approx(rate, rel=0.15)
    for low, high in itertools.pairwise((0.02, 0.2, 0.4, 0.6, 0.8, 0.98)):
        here = (probability >= low) & (probability < high)
        error = 0.5 / np.sqrt(here.sum())
        assert here.sum() > 200
        assert true[here].mean() == pytest.approx(probability[here].mean(), abs=0.04 + 4 * error)


def test_few_tracks_leave_the_prior():
    """One track does not show by how much the filter claims too much."""
    endings = Endings(
        np.full((50, 1), 0.04), np.full(1, 0.1), np.full(1, 8.0), np.full(1, 0.3), 0.04
    )
    one = target_probability(np.full(1, 0.9), endings, 0.05)[0]
    assert 0.003 < one[0] < 0.3


def test_a_track_that_was_never_sure_and_stops_in_view_is_out(rng):
    sure = piece(walk(rng, 120, (200, 200), (1, 0)), 1, (1, 120))
    brief = piece(walk(rng, 12, (400, 300), (1, 0)), 40, (40, 51))
    assert left([sure, brief], [0.9999, 0.9]) == {0.9999}


@pytest.mark.parametrize(
    ("begin", "velocity", "first", "confidence"),
    [
        ((500, 300), (1, 0), 109, 0.9),  # the record ends
        ((545, 300), (9, 0), 40, 0.9),  # it leaves the picture
        ((400, 300), (1, 0), 40, 0.99999),  # it was sure
    ],
)
def test_what_a_target_may_do_is_no_reason(rng, begin, velocity, first, confidence):
    sure = piece(walk(rng, 120, (200, 200), (1, 0)), 1, (1, 120))
    brief = piece(walk(rng, 12, begin, velocity), first, (first, first + 11))
    assert left([sure, brief], [0.999999, confidence]) == {1.0, round(confidence, 4)}


def test_a_long_track_of_a_weak_detector_stays(rng):
    """Fifty detections in a row are no coincidence, even if none of them was convincing."""
    sure = piece(walk(rng, 120, (200, 200), (1, 0)), 1, (1, 120))
    weak = piece(walk(rng, 80, (300, 300), (1, 0)), 10, (10, 89))
    assert left([sure, weak], [0.9999, 0.9]) == {0.9999, 0.9}


def test_confidences_that_are_no_probabilities_decide_nothing(rng):
    brief = piece(walk(rng, 12, (400, 300), (1, 0)), 40, (40, 51))
    sure = piece(walk(rng, 120, (200, 200), (1, 0)), 1, (1, 120))
    tracks, measured = sequence([sure, brief], 120, MODEL)
    rows = Smoothing(frame_size=(WIDTH, HEIGHT)).smooth(
        confident(tracks, [0.9999, 0.9]), measured, MODEL
    )
    assert len(np.unique(rows.identity)) == 2


def test_all_tracks_may_be_left_out(rng):
    brief = piece(walk(rng, 6, (400, 300), (1, 0)), 40, (40, 45))
    tracks, measured = sequence([brief], 120, MODEL)
    smoothing = Smoothing(existence=True, frame_size=(WIDTH, HEIGHT))
    assert len(smoothing.smooth(confident(tracks, [0.6]), measured, MODEL)) == 0


def test_states_of_other_tracks_are_unchanged(rng):
    sure = piece(walk(rng, 120, (200, 200), (1, 0)), 1, (1, 120))
    brief = piece(walk(rng, 12, (400, 300), (1, 0)), 40, (40, 51))
    tracks, measured = sequence([sure, brief], 120, MODEL)
    tracks = confident(tracks, [0.9999, 0.9])
    size = (WIDTH, HEIGHT)
    with_it = Smoothing(frame_size=size).smooth(tracks, measured, MODEL)
    without = Smoothing(existence=True, frame_size=size).smooth(tracks, measured, MODEL)
    kept = with_it.select(with_it.confidence > 0.99)
    assert np.array_equal(kept.frame, without.frame)
    assert np.allclose(kept.xyxy, without.xyxy)


def test_what_is_neither_joined_nor_smoothed_stays_as_it_came(rng):
    """As in presets of the papers, which have no such rule."""
    brief = piece(walk(rng, 6, (400, 300), (1, 0)), 40, (40, 45))
    tracks, measured = sequence([brief], 120, MODEL)
    as_it_came = Smoothing(existence=True, stitching=False, smoothing=False)
    assert len(as_it_came.smooth(confident(tracks, [0.6]), measured, MODEL)) == 6


@pytest.mark.parametrize(("last", "fewest", "most"), [(14, 23, 23), (34, 20, 32)])
def test_a_gap_whose_place_is_not_known_stays_open(last: int, fewest: int, most: int):
    """Ten frames at each end of a track; between them three, and twenty-three of a fast walk."""
    rng = np.random.default_rng(2)
    fast = model_of(acceleration=4.0)
    pieces = [
        piece(walk(rng, 120, (200, 400), (1, 0)), 1, (1, 120)),
        {
            **piece(walk(rng, 60, (100, 100), (3, 0)), 1, (1, 10), (last, last + 9)),
            **dict.fromkeys(range(11, last)),
        },
    ]
    tracks, measured = sequence(pieces, 120, fast)
    tracks = confident(tracks, [0.9999, 0.999999])
    found = Smoothing(existence=True, noise_by_track=False, frame_size=(WIDTH, HEIGHT)).smooth(
        tracks, measured, fast
    )
    assert fewest <= (found.confidence > 0.99999).sum() <= most
    everything = Smoothing(noise_by_track=False, frame_size=(WIDTH, HEIGHT)).smooth(
        tracks, measured, fast
    )
    assert (everything.confidence > 0.99999).sum() == last + 9
