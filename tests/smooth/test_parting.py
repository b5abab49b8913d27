"""Corrected tracks of objects that look different: parted, joined, and found again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from smoothing_cases import model_of, sequence, walk

from phdtrack.kernels.appearance import UNKNOWN, Looks
from phdtrack.protocols import Model
from phdtrack.smooth.parting import parted
from phdtrack.smooth.paths import paths_of
from phdtrack.smooth.sequence import Sequence
from phdtrack.smooth.smoothing import Smoothing
from phdtrack.smooth.stitching import returns
from phdtrack.types import MeasurementHistory, Tracks

D = 8
OWN = np.eye(4, D)
SMOOTHING = Smoothing(frame_size=(640.0, 480.0), max_continuation=0.0)
# Frames in which two objects stand in one place; they come from above and below.
MEET = range(41, 61)
LAST = 100


def law(**other: float) -> Looks:
    """What similarity says after many lessons, of objects that look different."""
    found = UNKNOWN._replace(
        weight=0.5,
        means_weight=1.0,
        means_same=0.95,
        means_deviation=0.08,
        means_other=-0.3,
        means_other_deviation=0.15,
        signal=0.7,
        independent=0.1,
        within=np.inf,
    )
    found = found._replace(**other)
    none = np.zeros((0, D), np.float32)
    return Looks(none, none, OWN.mean(axis=0).astype(np.float32), np.zeros(0), found, 0.0, 3.0)


def seen(model: Model, looks: Looks | None = None) -> Model:
    return replace(model, appearance=looks or law())


def with_looks(
    measurements: MeasurementHistory, objects: list[int], unknown: float = 0.0
) -> MeasurementHistory:
    """The measurements with noisy views of these objects, in their order; some without any."""
    rng = np.random.default_rng(len(objects))
    views = OWN[objects] + rng.normal(0, 0.1, (len(objects), D))
    views[rng.random(len(objects)) < unknown] = 0
    return replace(measurements, embeddings=views.astype(np.float32))


def meeting(
    *, swapped: bool, unknown: float = 0.0, gap: range = range(0)
) -> tuple[Tracks, MeasurementHistory]:
    """Two tracks from the left that stand in one place for a while; each goes on where it came
    from, above or below. If ``swapped``, they have each other's looks from then on. In the frames
    ``gap`` the rows are predicted.
    """
    rng = np.random.default_rng(4)
    pieces = []
    for side in (-1, 1):
        away = np.concatenate(
            [np.arange(MEET[0] - 1, 0, -1), np.zeros(len(MEET)), np.arange(1, LAST - MEET[-1] + 1)]
        )
        centre = np.stack([200 + 0 * away, 240 + side * 2.5 * away], axis=1)
        boxes = np.hstack([centre, np.broadcast_to([40.0, 80.0], (LAST, 2))])
        boxes = boxes + rng.normal(0, 2, boxes.shape)
        pieces.append({n: None if n in gap else boxes[n - 1] for n in range(1, LAST + 1)})
    tracks, measurements = sequence(pieces, LAST, model_of())
    objects = []
    for n in range(1, LAST + 1):
        if n not in gap:
            objects += [1, 0] if swapped and n > MEET[len(MEET) // 2] else [0, 1]
    return tracks, with_looks(measurements, objects, unknown)


def pieces_of(
    tracks: Tracks, measurements: MeasurementHistory, looks: Looks | None = None
) -> Tracks:
    """The tracks, parted."""
    return parted(
        tracks, paths_of(tracks, measurements), Sequence.of(measurements, seen(model_of(), looks))
    )


def names(tracks: Tracks, frame: int) -> list[int]:
    """The identities of both detections of a frame."""
    at = tracks.select((tracks.frame == frame) & (tracks.detection >= 0))
    return at.identity[np.argsort(at.detection)].tolist()


@pytest.mark.parametrize("unknown", [0.0, 0.3])
def test_tracks_that_swapped_are_parted_and_joined(unknown: float):
    tracks, measurements = meeting(swapped=True, unknown=unknown)
    pieces = pieces_of(tracks, measurements)
    assert len(np.unique(pieces.identity)) == 4
    for name in (1, 2):
        assert pieces.frame[pieces.identity == name].max() in MEET
    whole = SMOOTHING.smooth(tracks, measurements, seen(model_of()))
    assert names(whole, 10) == [1, 2]
    assert names(whole, LAST - 10) == [2, 1]
    assert len(np.unique(whole.identity)) == 2
    plain = SMOOTHING.smooth(tracks, measurements, model_of())
    assert names(plain, LAST - 10) == [1, 2]


def test_two_who_swapped_are_parted_at_one_time():
    """Though one is not known for a while after: else its end overlaps the rest of the other."""
    tracks, measurements = meeting(swapped=True)
    middle = MEET[len(MEET) // 2]
    number = np.repeat(measurements.number, np.diff(measurements.start))
    views = measurements.embeddings.copy()
    hidden = (number > middle) & (number < middle + 8) & (measurements.row == 1)
    assert hidden.sum() == 7
    views[hidden] = 0
    measurements = replace(measurements, embeddings=views)
    pieces = pieces_of(tracks, measurements)
    assert len(np.unique(pieces.identity)) == 4
    ends = [pieces.frame[pieces.identity == name].max() for name in (1, 2)]
    begins = [pieces.frame[pieces.identity == name].min() for name in (3, 4)]
    assert max(ends) < min(begins)
    whole = SMOOTHING.smooth(tracks, measurements, seen(model_of()))
    assert len(np.unique(whole.identity)) == 2
    assert names(whole, LAST - 10) == [2, 1]


def test_tracks_far_apart_are_parted_each_at_its_own_time():
    tracks, measurements = meeting(swapped=True)
    column = measurements.columns(tracks)
    z = measurements.z.copy()
    z[0, column[tracks.identity == 2]] += 400
    number = np.repeat(measurements.number, np.diff(measurements.start))
    views = measurements.embeddings.copy()
    middle = MEET[len(MEET) // 2]
    views[(number > middle) & (number < middle + 8) & (measurements.row == 1)] = 0
    pieces = pieces_of(tracks, replace(measurements, z=z, embeddings=views))
    ends = [pieces.frame[pieces.identity == name].max() for name in (1, 2)]
    assert ends[0] != ends[1]


def test_tracks_of_one_object_each_stay_whole():
    tracks, measurements = meeting(swapped=False)
    assert pieces_of(tracks, measurements) is tracks
    whole = SMOOTHING.smooth(tracks, measurements, seen(model_of()))
    assert names(whole, LAST - 10) == names(whole, 10) == [1, 2]


def test_rows_predicted_at_the_cut_are_left_out():
    gap = MEET
    tracks, measurements = meeting(swapped=True, gap=gap)
    pieces = pieces_of(tracks, measurements)
    assert len(np.unique(pieces.identity)) == 4
    assert not np.isin(pieces.frame, np.array(gap)).any()
    assert len(pieces) == len(tracks) - 2 * len(gap)


@pytest.mark.parametrize(
    "looks",
    [
        law(means_weight=0.0),
        law(means_same=-0.3, means_deviation=0.15),
        law()._replace(raw=np.zeros((0, 3), np.float32)),
    ],
    ids=["nothing learned", "all alike", "another length"],
)
def test_tracks_stay_whole_where_looks_say_nothing(looks: Looks):
    tracks, measurements = meeting(swapped=True)
    assert pieces_of(tracks, measurements, looks) is tracks


def test_tracks_without_descriptors_stay_whole():
    tracks, measurements = meeting(swapped=True, unknown=1.0)
    assert pieces_of(tracks, measurements) is tracks
    none = replace(measurements, embeddings=np.zeros((0, 0), np.float32))
    assert pieces_of(tracks, none) is tracks
    whole = SMOOTHING.smooth(tracks, none, seen(model_of()))
    assert whole.identity.tolist() == SMOOTHING.smooth(tracks, none, model_of()).identity.tolist()


@pytest.mark.parametrize(("odd", "tracks_after"), [(range(200, 250), 1), (range(200, 401), 2)])
def test_who_looks_like_another_for_a_while_is_still_the_same(odd: range, tracks_after: int):
    """For two seconds of sixteen; for good it is another one."""
    boxes = walk(np.random.default_rng(6), 400, (50.0, 240.0), (1.0, 0.0))
    piece = {n: boxes[n - 1] for n in range(1, 401)}
    tracks, measurements = sequence([piece], 400, model_of())
    measurements = with_looks(measurements, [int(n in odd) for n in range(1, 401)])
    pieces = pieces_of(tracks, measurements)
    assert len(np.unique(pieces.identity)) == tracks_after
    whole = SMOOTHING.smooth(tracks, measurements, seen(model_of()))
    assert len(np.unique(whole.identity)) == tracks_after


def test_a_few_odd_views_part_no_track():
    """Less than one and a half independent ones on a side."""
    tracks, measurements = meeting(swapped=False)
    views = measurements.embeddings.copy()
    views[2 * 30 : 2 * 30 + 4] = views[[2 * 30 + 1, 2 * 30] * 2]
    assert pieces_of(tracks, replace(measurements, embeddings=views)) is tracks


def ends(lost: int, found: tuple[int, int]) -> tuple[Tracks, MeasurementHistory]:
    """A track of object ``lost`` that ends, and two that begin 3 s later at equal distances from
    where it would be, of the objects ``found``.
    """
    rng = np.random.default_rng(1)
    first = walk(rng, 40, (100.0, 240.0), (3.0, 0.0))
    upper = walk(rng, 40, (445.0, 215.0), (3.0, 0.0))
    lower = walk(rng, 40, (445.0, 265.0), (3.0, 0.0))
    pieces = [
        {n: first[n - 1] for n in range(1, 41)},
        {n: upper[n - 116] for n in range(116, 156)},
        {n: lower[n - 116] for n in range(116, 156)},
    ]
    tracks, measurements = sequence(pieces, 160, model_of())
    objects = [lost] * 40 + [one for _ in range(40) for one in found]
    # Boxes side by side, so that none is covered.
    narrow = measurements.z.copy()
    narrow[3] = 30.0
    return tracks, with_looks(replace(measurements, z=narrow), objects)


@pytest.mark.parametrize(
    ("found", "wanted"), [((0, 2), [1, 2]), ((2, 0), [2, 1]), ((2, 3), [2, 3])]
)
def test_looks_choose_what_a_track_is_joined_with(found: tuple[int, int], wanted: list[int]):
    tracks, measurements = ends(0, found)
    whole = SMOOTHING.smooth(tracks, measurements, seen(model_of()))
    assert names(whole, 10) == [1]
    assert names(whole, 140) == wanted


def test_pairs_of_returns_name_their_detections(monkeypatch: pytest.MonkeyPatch):
    """The last one before and the first one after, where nobody has a twin."""
    monkeypatch.setattr("phdtrack.models.returns.TWINS", 1e-3)
    tracks, measurements = ends(0, (2, 0))
    paths = paths_of(tracks, measurements)
    assert returns(paths, Sequence.of(measurements, seen(model_of()))) == [((40, 0), (116, 1))]
    for looks in (law(within=2.9), law(means_weight=0.0)):
        assert returns(paths, Sequence.of(measurements, seen(model_of(), looks))) == []
    assert returns(paths, Sequence.of(measurements, model_of())) == []
    within = law(within=3.2)
    assert len(returns(paths, Sequence.of(measurements, seen(model_of(), within)))) == 1


@pytest.mark.parametrize("alike", [False, True])
def test_where_many_look_alike_looks_say_less(alike: bool, monkeypatch: pytest.MonkeyPatch):
    """One leaves, and one who looks the same comes 1.6 s later, elsewhere. Two others are there
    together all the time, who look ``alike``.
    """
    # That of these two counts.
    monkeypatch.setattr("phdtrack.models.returns.PRIOR_TWINS", 0.1)
    rng = np.random.default_rng(3)
    upper = walk(rng, 300, (100.0, 60.0), (0.3, 0.0))
    lower = walk(rng, 300, (100.0, 420.0), (0.3, 0.0))
    first = walk(rng, 130, (300.0, 240.0), (1.0, 0.0))
    later = walk(rng, 130, (520.0, 160.0), (0.5, 0.0))
    pieces = [{n: box[n - 1] for n in range(1, 301)} for box in (upper, lower)]
    pieces += [{n: first[n - 1] for n in range(1, 131)}]
    pieces += [{n: later[n - 171] for n in range(171, 301)}]
    tracks, measurements = sequence(pieces, 300, model_of())
    objects = []
    for n in range(1, 301):
        objects += [0, 0 if alike else 1] + [2] * (not 130 < n < 171)
    measurements = with_looks(measurements, objects)
    found = returns(paths_of(tracks, measurements), Sequence.of(measurements, seen(model_of())))
    assert found == ([] if alike else [((130, 2), (171, 2))])


def test_one_frame_alone_has_no_returns():
    boxes = np.array([[100.0, 100, 40, 80], [300, 100, 40, 80]])
    tracks, measurements = sequence([{1: box} for box in boxes], 1, model_of())
    measurements = with_looks(measurements, [0, 1])
    scene = Sequence.of(measurements, seen(model_of()))
    assert returns(paths_of(tracks, measurements), scene) == []
