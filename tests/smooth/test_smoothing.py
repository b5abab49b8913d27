"""Laws of smoothing: what is joined and what is not, which rows there are, what each switch
does.
"""

from dataclasses import replace

import numpy as np
import pytest
from smoothing_cases import model_of, piece, sequence, walk

from phdtrack.smooth.smoothing import Smoothing
from phdtrack.types import MeasurementHistory, Tracks

MODEL = model_of(scaled_noise=True, acceleration=0.005, size_noise=0.05)


def names(tracks: Tracks) -> dict[int, list[int]]:
    return {int(i): tracks.frame[tracks.identity == i].tolist() for i in np.unique(tracks.identity)}


def smoothed(pieces, frames: int = 60, model=MODEL, **settings) -> Tracks:
    return Smoothing(**settings).smooth(*sequence(pieces, frames, model), model)


@pytest.mark.parametrize("missing", [1, 5, 12, 25])
@pytest.mark.parametrize("seed", range(4))
def test_interrupted_track_is_joined(missing: int, seed: int):
    rng = np.random.default_rng(seed)
    a = walk(rng, 60, (60, 240), (4, 0))
    b = walk(rng, 60, (600, 60), (-1, 3))
    tracks = smoothed(
        [piece(a, 1, (1, 20)), piece(a, 1, (21 + missing, 60)), piece(b, 1, (1, 60))],
        max_gap_uncertainty=100.0,
    )
    assert names(tracks) == {1: list(range(1, 61)), 2: list(range(1, 61))}
    gap = tracks.select(
        (tracks.identity == 1) & (tracks.frame > 20) & (tracks.frame <= 20 + missing)
    )
    assert (gap.detection == -1).all()
    centre = gap.xyxy[:, :2] + gap.xyxy[:, 2:]
    np.testing.assert_allclose(
        centre / 2, np.stack([60 + 4 * (gap.frame - 1), np.full(missing, 240)], axis=1), atol=8
    )


def cut(begin, velocity, *shown: tuple[int, int]):
    """Makes pieces of one walk, {frame: measurement}, for the stretches in which it is shown."""

    def make(rng) -> list[dict]:
        walked = walk(rng, 60, begin, velocity)
        return [piece(walked, 1, stretch) for stretch in shown]

    return make


ELSEWHERE = cut((600, 60), (-1, 3), (1, 60))
BROKEN = cut((60, 240), (4, 0), (1, 20), (31, 60))


@pytest.mark.parametrize(
    ("walks", "count", "settings"),
    [
        # The piece in the middle is so short that it does not say where it goes.
        ([cut((60, 240), (4, 0), (1, 20), (27, 28), (36, 60)), ELSEWHERE], 2, {}),
        # One leaves on the left, another comes on the right a moment later.
        ([cut((100, 240), (-2, 0), (1, 30)), cut((520, 240), (-2, 0), (35, 60))], 2, {}),
        # A jump is no way.
        ([cut((100, 240), (2, 0), (1, 29)), cut((160, 240), (2, 0), (32, 60)), ELSEWHERE], 3, {}),
        ([cut((100, 240), (2, 0), (1, 29)), cut((100, 360), (2, 0), (32, 60)), ELSEWHERE], 3, {}),
        # Frame 31 is 11 frames of 1/25 s after frame 20.
        ([BROKEN, ELSEWHERE], 2, {"max_gap": 0.44}),
        ([BROKEN, ELSEWHERE], 3, {"max_gap": 0.43}),
        # Two walk side by side, one width apart, and one leaves when the other has just come.
        ([cut((60, 240), (4, 0), (1, 35)), cut((100, 240), (4, 0), (20, 60))], 2, {}),
        # Two meet in frame 30, face to face, when both are there.
        ([cut((100, 240), (5, 0), (1, 34)), cut((400, 240), (-5, 0), (26, 60))], 2, {}),
    ],
)
@pytest.mark.parametrize("seed", range(3))
def test_only_plausible_pairs_are_joined(seed: int, walks, count: int, settings):
    rng = np.random.default_rng(seed)
    assert len(names(smoothed([part for make in walks for part in make(rng)], **settings))) == count


def test_long_gaps_are_joined_but_stay_open(rng):
    """Late in a long sequence, where frames are more than there are rows of tracks."""
    a = walk(rng, 100, (60, 240), (4, 0))
    b = walk(rng, 100, (600, 60), (-1, 3))
    tracks = smoothed(
        [piece(a, 301, (301, 320)), piece(a, 301, (361, 400)), piece(b, 301, (301, 400))], 400
    )
    assert names(tracks)[1] == [*range(301, 321), *range(361, 401)]


def test_targets_crossing_while_hidden_keep_their_identities(rng):
    a = walk(rng, 60, (100, 200), (5, 0))
    b = walk(rng, 60, (395, 206), (-5, 0))
    pieces = [
        piece(a, 1, (1, 25)),
        piece(b, 1, (1, 25)),
        piece(b, 1, (36, 60)),
        piece(a, 1, (36, 60)),
    ]
    tracks = smoothed(pieces)
    for identity in (1, 2):
        own = tracks.select(tracks.identity == identity)
        x = 0.5 * (own.xyxy[:, 0] + own.xyxy[:, 2])
        speed = np.diff(x) / np.diff(own.frame)
        assert np.all(speed > 2) or np.all(speed < -2)
    assert len(names(tracks)) == 2


def test_order_of_tracks_does_not_matter(rng):
    a = walk(rng, 60, (60, 240), (4, 0))
    b = walk(rng, 60, (600, 60), (-1, 3))
    tracks, measured = sequence(
        [piece(a, 1, (1, 20)), piece(a, 1, (27, 60)), piece(b, 1, (1, 60))], 60, MODEL
    )
    wanted = Smoothing().smooth(tracks, measured, MODEL)
    for order in ([3, 1, 2], [2, 3, 1], [1, 3, 2]):
        other = Tracks.concatenate([replace(tracks, identity=np.array(order)[tracks.identity - 1])])
        found = Smoothing().smooth(other, measured, MODEL)
        assert sorted(names(found).values()) == sorted(names(wanted).values())
        boxes = [t.xyxy[np.lexsort((t.xyxy[:, 0], t.frame))] for t in (found, wanted)]
        np.testing.assert_allclose(*boxes, atol=1e-7)


def test_stitching_and_smoothing_can_be_disabled(rng):
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
    assert names(Smoothing(max_gap_uncertainty=0).smooth(tracks, measured, MODEL)) == {
        1: [*range(1, 21), *range(27, 61)]
    }


def test_undetected_rows_are_smoothed_only_inside_a_track(rng):
    a = walk(rng, 30, (60, 240), (4, 0))
    shown = piece(a, 1, (3, 10), (14, 25)) | dict.fromkeys((1, 2, 11, 12, 13, 26))
    tracks, measured = sequence([shown], 30, MODEL)
    found = Smoothing().smooth(tracks, measured, MODEL)
    assert found.frame.tolist() == list(range(1, 27))
    inside = (found.frame >= 3) & (found.frame <= 25)
    np.testing.assert_array_equal(found.xyxy[~inside], tracks.xyxy[~inside])
    middle = found.xyxy[10:13, :2] + found.xyxy[10:13, 2:]
    np.testing.assert_allclose(middle[:, 0] / 2, 60 + 4 * np.arange(10, 13), atol=3)


def test_a_track_has_one_row_per_frame(rng):
    """The first piece goes on without measurements for longer than until the second begins, or
    ends.
    """
    a = walk(rng, 60, (60, 240), (4, 0))
    first = piece(a, 1, (1, 20)) | dict.fromkeys(range(21, 31))
    assert names(smoothed([first, piece(a, 1, (27, 60))])) == {1: list(range(1, 61))}
    first = piece(a, 1, (1, 30)) | dict.fromkeys(range(31, 46))
    second = piece(a, 1, (31, 40)) | dict.fromkeys(range(41, 46))
    assert names(smoothed([first, second])) == {1: list(range(1, 46))}


def test_shared_measurement_belongs_to_no_track(rng):
    """In frames 11 to 13 one box stands for two people."""
    a = walk(rng, 30, (100, 240), (4, 0), noise=0.5)
    b = walk(rng, 30, (100, 340), (4, 0), noise=0.5)
    tracks, measured = sequence([piece(a, 1, (1, 30)), piece(b, 1, (1, 30))], 30, MODEL)
    detection = tracks.detection.copy()
    shared = (tracks.frame >= 11) & (tracks.frame <= 13)
    detection[shared] = 0
    found = Smoothing().smooth(replace(tracks, detection=detection), measured, MODEL)
    for identity, y in ((1, 240), (2, 340)):
        rows = found.xyxy[(found.identity == identity) & (found.frame >= 11) & (found.frame <= 13)]
        np.testing.assert_allclose((rows[:, 1] + rows[:, 3]) / 2, y, atol=2)


def test_no_tracks_give_no_tracks():
    none = np.zeros(0, np.int64)
    start = np.zeros(1, np.int64)
    empty = MeasurementHistory(none, np.zeros(0), start, np.zeros((4, 0)), np.zeros((0, 3, 3)))
    assert len(Smoothing().smooth(Tracks.empty(), empty, MODEL)) == 0
    tracks, measured = sequence([{1: np.array([50.0, 50, 20, 40])}], 1, MODEL)
    np.testing.assert_allclose(Smoothing().smooth(tracks, measured, MODEL).xyxy, tracks.xyxy)
    assert len(Smoothing().smooth(replace(tracks, detection=np.array([-1])), measured, MODEL)) == 1


@pytest.mark.parametrize("seed", range(4))
def test_overlapping_tracks_of_one_target_are_joined(seed: int):
    """The detector fires twice on one object in frames 25 to 32, and only on the second box from
    then on.
    """
    rng = np.random.default_rng(seed)
    a = walk(rng, 60, (60, 240), (4, 0))
    twice = walk(rng, 60, (60, 240), (4, 0))
    b = walk(rng, 60, (600, 60), (-1, 3))
    pieces = [piece(a, 1, (1, 32)), piece(twice, 1, (25, 60)), piece(b, 1, (1, 60))]
    tracks = smoothed(pieces)
    assert names(tracks) == {1: list(range(1, 61)), 2: list(range(1, 61))}
    # Of the two boxes the first track's is taken up to the middle of the time they share, frame 28,
    # the second's from 29 on.
    own = tracks.select(tracks.identity == 1)
    assert own.detection[own.frame == 28].item() == 0
    assert own.detection[own.frame == 29].item() == 1
    assert len(names(smoothed(pieces, max_overlap_time=0))) == 3
    # Frames 25 to 32 are 7 intervals of 1/25 s.
    assert len(names(smoothed(pieces, max_overlap_time=0.28))) == 2
    assert len(names(smoothed(pieces, max_overlap_time=0.27))) == 3


def test_stationary_tracks_are_dropped_if_asked(rng):
    going = walk(rng, 60, (60, 240), (4, 0))
    staying = walk(rng, 60, (500, 100), (0, 0))
    pieces = [piece(staying, 1, (1, 60)), piece(going, 1, (1, 60))]
    assert len(names(smoothed(pieces))) == 2
    for parts in ({}, {"stitching": False, "smoothing": False}):
        left = smoothed(pieces, min_extent=0.75, **parts)
        assert names(left) == {1: list(range(1, 61))}
        assert left.xyxy[-1, 0] > left.xyxy[0, 0] + 200


def test_motion_at_the_border_is_that_of_the_visible_side(rng):
    """The head goes down by 60 pixels while the feet are below the picture: the centre moves by
    half of that.
    """
    head = 600.0 + np.arange(60)
    high = 700.0 - head
    boxes = np.stack(
        [np.full(60, 300.0), head + high / 2, np.full(60, 70.0), high], axis=1
    ) + rng.normal(0, 0.3, (60, 4))
    pieces = [piece(boxes, 1, (1, 60))]
    assert names(smoothed(pieces, min_extent=0.75, frame_size=(1000.0, 700.0))) == {
        1: list(range(1, 61))
    }
    assert not names(smoothed(pieces, min_extent=0.75, frame_size=(1000.0, 900.0)))


def at_the_border(
    *lost: int, known: tuple[int, int] = (15, 40)
) -> tuple[Tracks, MeasurementHistory]:
    """Someone walks from left to right, cut by the picture in frames 2 to 6 and 51 to 56; another
    stands in the middle.

    He is detected in all of them but those ``lost``; his track has only those ``known``.
    """
    left, right = (np.clip(12 * np.arange(1, 57) + side, 0, 640) for side in (-60.0, -20.0))
    cut = np.stack(
        [(left + right) / 2, np.full(56, 240.0), right - left, np.full(56, 80.0)], axis=1
    )
    seen = {n: cut[n - 1] for n in range(2, 57) if n not in lost}
    stays = {n: np.array([320.0, 100.0, 40.0, 80.0]) for n in range(1, 61)}
    tracks, measurements = sequence([seen, stays], 60, MODEL)
    low, high = known
    return tracks.select(
        (tracks.identity == 2) | (tracks.frame >= low) & (tracks.frame <= high)
    ), measurements


@pytest.mark.parametrize(
    ("lost", "settings", "first", "last"),
    [
        ((), {}, 2, 56),
        ((), {"max_continuation": 0}, 15, 40),
        ((), {"max_continuation": 0.2}, 10, 45),
        # One frame without it, and two.
        ((8, 47), {}, 2, 56),
        ((7, 8, 47, 48), {}, 9, 46),
    ],
)
def test_track_is_extended_to_the_border_by_free_detections(lost, settings, first: int, last: int):
    smoothing = Smoothing(**({"max_continuation": 1.0, "frame_size": (640.0, 480.0)} | settings))
    given, measurements = at_the_border(*lost)
    tracks = smoothing.smooth(given, measurements, MODEL)
    own = tracks.select(tracks.xyxy[:, 1] > 150)
    assert set(own.frame.tolist()) == set(range(first, last + 1)) - set(lost)
    assert len(set(own.identity.tolist())) == 1
    # The new rows are the detections themselves, and no other track has them.
    new = own.select((own.frame < 15) | (own.frame > 40))
    assert (new.xyxy[:, 0] >= 0).all()
    assert (new.xyxy[:, 2] <= 640).all()
    assert (new.detection == 0).all()
    assert len(tracks.select(tracks.xyxy[:, 1] < 150)) == 60


def test_used_detections_extend_no_track():
    """Of two that walk through each other one is not detected any more when they meet, in frame
    56.
    """
    first, second = (
        {n: np.array([x + v * n, 240.0, 40.0, 80.0]) for n in range(1, 61)}
        for x, v in ((96, 4), (544, -4))
    )
    tracks, measurements = sequence([{n: first[n] for n in range(1, 53)}, second], 60, MODEL)
    out = Smoothing(max_continuation=1.0, frame_size=(640.0, 480.0)).smooth(
        tracks, measurements, MODEL
    )
    assert names(out) == {1: list(range(1, 53)), 2: list(range(1, 61))}
