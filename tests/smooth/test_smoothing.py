"""Laws of smoothing: what is joined and what is not, which rows there are, what each switch does."""

from __future__ import annotations

import numpy as np
import pytest
from smoothing_cases import model_of, piece, sequence, walk

from phdtrack.errors import InputError
from phdtrack.smooth import Smoothing
from phdtrack.types import MeasurementHistory, Tracks

MODEL = model_of(scaled_noise=True, acceleration=0.005, size_noise=0.05)


def names(tracks: Tracks) -> dict[int, list[int]]:
    return {int(i): tracks.frame[tracks.identity == i].tolist() for i in np.unique(tracks.identity)}


def smoothed(pieces, frames: int = 60, model=MODEL, **settings) -> Tracks:
    return Smoothing(**settings).smooth(*sequence(pieces, frames, model), model)


@pytest.mark.parametrize("missing", [1, 5, 12, 25])
@pytest.mark.parametrize("seed", range(4))
def test_a_track_that_was_cut_is_one_again(missing: int, seed: int):
    rng = np.random.default_rng(seed)
    a, b = walk(rng, 60, (60, 240), (4, 0)), walk(rng, 60, (600, 60), (-1, 3))
    tracks = smoothed(
        [piece(a, 1, (1, 20)), piece(a, 1, (21 + missing, 60)), piece(b, 1, (1, 60))], max_gap_uncertainty=100.0
    )
    assert names(tracks) == {1: list(range(1, 61)), 2: list(range(1, 61))}
    gap = tracks.take((tracks.identity == 1) & (tracks.frame > 20) & (tracks.frame <= 20 + missing))
    assert (gap.detection == -1).all()
    centre = gap.xyxy[:, :2] + gap.xyxy[:, 2:]
    np.testing.assert_allclose(centre / 2, np.stack([60 + 4 * (gap.frame - 1), np.full(missing, 240)], axis=1), atol=8)


@pytest.mark.parametrize("seed", range(4))
def test_pieces_of_pieces_are_one(seed: int):
    """The piece in the middle is so short that nobody knows where it goes."""
    rng = np.random.default_rng(seed)
    a, b = walk(rng, 60, (60, 240), (4, 0)), walk(rng, 60, (600, 60), (-1, 3))
    cut = [piece(a, 1, (1, 20)), piece(a, 1, (27, 28)), piece(a, 1, (36, 60))]
    assert len(names(smoothed([*cut, piece(b, 1, (1, 60))]))) == 2


@pytest.mark.parametrize("seed", range(4))
def test_people_who_never_meet_stay_two(seed: int):
    """One leaves on the left, another comes on the right a moment later."""
    rng = np.random.default_rng(seed)
    a, b = walk(rng, 60, (100, 240), (-2, 0)), walk(rng, 60, (520, 240), (-2, 0))
    assert len(names(smoothed([piece(a, 1, (1, 30)), piece(b, 1, (35, 60))]))) == 2


@pytest.mark.parametrize(("jump", "count"), [((0, 0), 1), ((60, 0), 2), ((0, 120), 2)])
def test_nothing_is_joined_across_a_jump(rng, jump, count: int):
    a, far = walk(rng, 60, (100, 240), (2, 0)), walk(rng, 60, (500, 80), (0, 1))
    b = a + np.array([*jump, 0, 0])
    tracks = smoothed([piece(a, 1, (1, 29)), piece(b, 1, (32, 60)), piece(far, 1, (1, 60))])
    assert len(names(tracks)) == count + 1


def test_two_who_cross_out_of_sight_keep_their_ways(rng):
    a, b = walk(rng, 60, (100, 200), (5, 0)), walk(rng, 60, (395, 206), (-5, 0))
    pieces = [piece(a, 1, (1, 25)), piece(b, 1, (1, 25)), piece(b, 1, (36, 60)), piece(a, 1, (36, 60))]
    tracks = smoothed(pieces)
    for identity in (1, 2):
        own = tracks.take(tracks.identity == identity)
        x = 0.5 * (own.xyxy[:, 0] + own.xyxy[:, 2])
        speed = np.diff(x) / np.diff(own.frame)
        assert np.all(speed > 2) or np.all(speed < -2)
    assert len(names(tracks)) == 2


def test_the_order_of_tracks_does_not_matter(rng):
    a, b = walk(rng, 60, (60, 240), (4, 0)), walk(rng, 60, (600, 60), (-1, 3))
    tracks, measured = sequence([piece(a, 1, (1, 20)), piece(a, 1, (27, 60)), piece(b, 1, (1, 60))], 60, MODEL)
    wanted = Smoothing().smooth(tracks, measured, MODEL)
    for order in ([3, 1, 2], [2, 3, 1], [1, 3, 2]):
        other = Tracks.concatenate(
            [Tracks(t.frame, np.full(len(t), k), t.xyxy, t.confidence, t.detection, t.confirmed)
             for i, k in enumerate(order, start=1) for t in [tracks.take(tracks.identity == i)]]
        )  # fmt: skip
        found = Smoothing().smooth(other, measured, MODEL)
        assert sorted(names(found).values()) == sorted(names(wanted).values())
        boxes = [t.xyxy[np.lexsort((t.xyxy[:, 0], t.frame))] for t in (found, wanted)]
        np.testing.assert_allclose(*boxes, atol=1e-7)


def test_each_part_can_be_switched_off(rng):
    a = walk(rng, 60, (60, 240), (4, 0))
    pieces = [piece(a, 1, (1, 20)), piece(a, 1, (27, 60))]
    tracks, measured = sequence(pieces, 60, MODEL)
    assert Smoothing(stitching=False, smoothing=False).smooth(tracks, measured, MODEL) is tracks
    joined = Smoothing(smoothing=False).smooth(tracks, measured, MODEL)
    assert names(joined) == {1: list(range(1, 61))}
    np.testing.assert_array_equal(joined.xyxy[joined.detection >= 0], tracks.xyxy)
    straight = Smoothing(stitching=False).smooth(tracks, measured, MODEL)
    assert names(straight) == names(tracks)
    assert np.abs(straight.xyxy - tracks.xyxy).max() > 0.5
    assert names(Smoothing(max_gap_uncertainty=0).smooth(tracks, measured, MODEL)) == {1: [*range(1, 21), *range(27, 61)]}


def test_long_gaps_are_joined_in_name_and_left_open(rng):
    a, b = walk(rng, 100, (60, 240), (4, 0)), walk(rng, 100, (600, 60), (-1, 3))
    tracks = smoothed([piece(a, 1, (1, 20)), piece(a, 1, (61, 100)), piece(b, 1, (1, 100))], 100)
    assert names(tracks)[1] == [*range(1, 21), *range(61, 101)]


def test_longest_is_the_longest(rng):
    a, b = walk(rng, 60, (60, 240), (4, 0)), walk(rng, 60, (600, 60), (-1, 3))
    pieces = [piece(a, 1, (1, 20)), piece(a, 1, (31, 60)), piece(b, 1, (1, 60))]
    # Frame 31 is 11 frames of 1/25 s after frame 20.
    assert len(names(smoothed(pieces, max_gap=0.44))) == 2
    assert len(names(smoothed(pieces, max_gap=0.43))) == 3


def test_a_gap_that_somebody_left_open_inside_a_track_stays_open(rng):
    a = walk(rng, 60, (60, 240), (4, 0))
    assert names(smoothed([piece(a, 1, (1, 20), (27, 60))])) == {1: [*range(1, 21), *range(27, 61)]}


def test_rows_that_rest_on_nothing_are_smoothed_inside_and_stay_outside(rng):
    a = walk(rng, 30, (60, 240), (4, 0))
    shown = piece(a, 1, (3, 10), (14, 25)) | dict.fromkeys((1, 2, 11, 12, 13, 26))
    tracks, measured = sequence([shown], 30, MODEL)
    found = Smoothing().smooth(tracks, measured, MODEL)
    assert found.frame.tolist() == list(range(1, 27))
    inside = (found.frame >= 3) & (found.frame <= 25)
    np.testing.assert_array_equal(found.xyxy[~inside], tracks.xyxy[~inside])
    middle = found.xyxy[10:13, :2] + found.xyxy[10:13, 2:]
    np.testing.assert_allclose(middle[:, 0] / 2, 60 + 4 * np.arange(10, 13), atol=3)


def test_a_track_says_once_where_it_is(rng):
    """The first piece goes on without measurements for longer than until the second begins."""
    a = walk(rng, 60, (60, 240), (4, 0))
    first = piece(a, 1, (1, 20)) | dict.fromkeys(range(21, 31))
    tracks = smoothed([first, piece(a, 1, (27, 60))])
    assert names(tracks) == {1: list(range(1, 61))}
    assert len(set(zip(tracks.frame, tracks.identity, strict=True))) == len(tracks)


def test_two_tracks_of_one_that_both_go_on_unseen_go_on_once(rng):
    """The second piece begins before the first ends; both have rows without measurements behind their last."""
    a = walk(rng, 60, (60, 240), (4, 0))
    first = piece(a, 1, (1, 30)) | dict.fromkeys(range(31, 46))
    second = piece(a, 1, (31, 40)) | dict.fromkeys(range(41, 46))
    tracks = smoothed([first, second])
    assert names(tracks) == {1: list(range(1, 46))}


def test_few_rows_late_in_a_long_sequence(rng):
    """Frames may be more than there are rows of tracks."""
    a, b = walk(rng, 400, (60, 240), (1, 0)), walk(rng, 400, (60, 60), (0, 0.5))
    tracks = smoothed([piece(a, 1, (370, 380)), piece(a, 1, (386, 396)), piece(b, 1, (371, 396))], 400)
    assert names(tracks) == {1: list(range(370, 397)), 2: list(range(371, 397))}


def test_a_measurement_that_two_share_places_neither(rng):
    """In frames 11 to 13 one box stands for two people."""
    a, b = walk(rng, 30, (100, 240), (4, 0), noise=0.5), walk(rng, 30, (100, 340), (4, 0), noise=0.5)
    tracks, measured = sequence([piece(a, 1, (1, 30)), piece(b, 1, (1, 30))], 30, MODEL)
    detection = tracks.detection.copy()
    shared = (tracks.frame >= 11) & (tracks.frame <= 13)
    detection[shared] = 0
    found = Smoothing().smooth(
        Tracks(tracks.frame, tracks.identity, tracks.xyxy, tracks.confidence, detection, tracks.confirmed), measured, MODEL
    )
    for identity, y in ((1, 240), (2, 340)):
        rows = found.xyxy[(found.identity == identity) & (found.frame >= 11) & (found.frame <= 13)]
        np.testing.assert_allclose((rows[:, 1] + rows[:, 3]) / 2, y, atol=2)


def test_nothing_comes_of_nothing():
    empty = MeasurementHistory(
        np.zeros(0, np.int64), np.zeros(0), np.zeros(1, np.int64), np.zeros((4, 0)), np.zeros((0, 3, 3))
    )
    assert len(Smoothing().smooth(Tracks.empty(), empty, MODEL)) == 0
    tracks, measured = sequence([{1: np.array([50.0, 50, 20, 40])}], 1, MODEL)
    np.testing.assert_allclose(Smoothing().smooth(tracks, measured, MODEL).xyxy, tracks.xyxy)
    predicted = Tracks(tracks.frame, tracks.identity, tracks.xyxy, tracks.confidence, np.array([-1]), tracks.confirmed)
    assert len(Smoothing().smooth(predicted, measured, MODEL)) == 1


def test_wrong_settings_are_told():
    with pytest.raises(InputError, match="below 1"):
        Smoothing(reentry_probability=1.0)
    with pytest.raises(InputError, match=r"Smoothing\.mean_occluded_time"):
        Smoothing(mean_occluded_time=0.0)


@pytest.mark.parametrize("seed", range(4))
def test_a_second_track_that_begins_before_the_first_ends_is_the_same(seed: int):
    """The detector fires twice on one object in frames 25 to 32, and only on the second box from then on."""
    rng = np.random.default_rng(seed)
    a, twice, b = walk(rng, 60, (60, 240), (4, 0)), walk(rng, 60, (60, 240), (4, 0)), walk(rng, 60, (600, 60), (-1, 3))
    pieces = [piece(a, 1, (1, 32)), piece(twice, 1, (25, 60)), piece(b, 1, (1, 60))]
    tracks = smoothed(pieces)
    assert names(tracks) == {1: list(range(1, 61)), 2: list(range(1, 61))}
    # Of the two boxes the first track's is taken up to the middle of the time they share, frame 28, the second's from 29 on.
    own = tracks.take(tracks.identity == 1)
    assert own.detection[own.frame == 28].item() == 0
    assert own.detection[own.frame == 29].item() == 1
    assert len(names(smoothed(pieces, max_overlap_time=0))) == 3
    # Frames 25 to 32 are 7 intervals of 1/25 s.
    assert len(names(smoothed(pieces, max_overlap_time=0.28))) == 2
    assert len(names(smoothed(pieces, max_overlap_time=0.27))) == 3


def test_two_who_walk_beside_each_other_for_a_while_stay_two(rng):
    """One width apart, one leaves when the other has just come."""
    a, b = walk(rng, 60, (60, 240), (4, 0)), walk(rng, 60, (100, 240), (4, 0))
    assert len(names(smoothed([piece(a, 1, (1, 35)), piece(b, 1, (20, 60))]))) == 2


def test_two_who_meet_while_one_comes_and_one_goes_stay_two(rng):
    """They meet in frame 30, face to face, when both are there."""
    a, b = walk(rng, 60, (100, 240), (5, 0)), walk(rng, 60, (400, 240), (-5, 0))
    assert len(names(smoothed([piece(a, 1, (1, 34)), piece(b, 1, (26, 60))]))) == 2
