"""Identities given back to targets that were deleted and come again."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from appearance_cases import (
    FPS,
    SIZE,
    D,
    frame_of,
    identity_of,
    pacing,
    prototypes,
    tracker_of,
)
from phdtrack import Tracker
from phdtrack.associate import reidentification
from phdtrack.associate.reidentification import (
    Names,
    Returns,
    compared,
    forgetting,
    named,
    remembering,
    taken,
)
from phdtrack.associate.reidentification import given_back as given_back_by
from phdtrack.kernels.appearance import UNKNOWN, Looks
from phdtrack.kernels.identities import MET, nobody
from phdtrack.models.returns import (
    NEARBY,
    PRIOR_ENDED,
    RETURN,
    RETURN_TIME,
    TWINS,
    Rates,
    among,
    log_odds,
    mean_away,
    returning_share,
    twin_chance,
    twins_among,
)
from phdtrack.models.track_returns import with_returns
from phdtrack.protocols import Associator
from phdtrack.state import from_bytes, to_bytes
from phdtrack.types import Detections, Estimates, Return, Tracks
from tracker_cases import equal

LOOKS = prototypes(8)
# Five people, of whom the first one leaves; another one looks like nobody before.
PEOPLE = (0, 1, 2, 3, 4)
OTHER = 6
LEARNED = 200


def scene(*gone: tuple[int, int], frames: int, other: int | None = None) -> list[Detections]:
    """Frames of `PEOPLE` without the first one in these stretches; after the last ``other`` is in
    their place, if given.
    """
    out = []
    for k in range(frames):
        away = any(begin <= k < end for begin, end in gone)
        found = frame_of(PEOPLE[away:], k, LOOKS)
        if other is not None and k >= gone[-1][1]:
            looks = LOOKS.copy()
            looks[0] = LOOKS[other]
            found = frame_of(PEOPLE, k, looks)
        out.append(found)
    return out


def given_back(tracker: Tracker) -> tuple[Return, ...]:
    return tracker.stages.associator.returns(tracker.state.association)


def first_ones(tracks: Tracks, frames: range) -> set[int]:
    """Identities of detection 0 in frames from 1."""
    rows = tracks.select(
        (tracks.detection == 0) & np.isin(tracks.frame, np.array(frames, np.int64))
    )
    return set(rows.identity.tolist())


@pytest.mark.parametrize("seconds", [5, 20])
def test_a_target_that_comes_back_is_itself_again(seconds: int):
    """Online three frames after it is confirmed, in corrected tracks from its first detection."""
    back = LEARNED + round(seconds * FPS)
    tracker = tracker_of()
    rows = [tracker.update(found) for found in scene((LEARNED, back), frames=back + 40)]
    before = identity_of(rows[LEARNED - 1], 0)
    assert before > 0
    assert [identity_of(row, 0) for row in rows[back + 10 :]] == [before] * 30
    (pair,) = given_back(tracker)
    assert pair.identity == before
    assert pair.odds > 1
    assert pair.ended == (LEARNED, 0)
    assert back < pair.began[0] <= back + 8
    corrected = tracker.tracks()
    assert len(np.unique(corrected.identity)) == len(PEOPLE)
    one = first_ones(corrected, range(1, LEARNED + 1))
    assert first_ones(corrected, range(back + 1, back + 41)) == one
    (name,) = one
    own = corrected.frame[corrected.identity == name]
    assert set(own.tolist()) == {*range(1, LEARNED + 1), *range(back + 1, back + 41)}


@pytest.mark.parametrize("seconds", [5, 20])
def test_another_target_gets_another_identity(seconds: int):
    back = LEARNED + round(seconds * FPS)
    frames = scene((LEARNED, back), frames=back + 40, other=OTHER)
    tracker = tracker_of()
    rows = [tracker.update(found) for found in frames]
    assert given_back(tracker) == ()
    assert identity_of(rows[-1], 0) not in {0, identity_of(rows[LEARNED - 1], 0)}
    corrected = tracker.tracks()
    assert len(np.unique(corrected.identity)) == len(PEOPLE) + 1


def test_without_appearance_a_target_is_a_new_one():
    tracker = tracker_of(appearance={"kind": "none"})
    rows = [tracker.update(found) for found in scene((LEARNED, 250), frames=290)]
    assert identity_of(rows[-1], 0) not in {0, identity_of(rows[LEARNED - 1], 0)}
    assert len(np.unique(tracker.tracks().identity)) == len(PEOPLE) + 1


def test_a_target_comes_back_twice():
    tracker = tracker_of()
    frames = scene((LEARNED, 260), (320, 400), frames=440)
    rows = [tracker.update(found) for found in frames]
    first = identity_of(rows[LEARNED - 1], 0)
    assert identity_of(rows[310], 0) == identity_of(rows[-1], 0) == first
    pairs = given_back(tracker)
    assert [pair.identity for pair in pairs] == [first, first]
    assert pairs[1].earlier == pairs[0].later
    assert len(np.unique(tracker.tracks().identity)) == len(PEOPLE)


def test_no_two_targets_have_one_identity():
    """A twin of one that is still there, and a twin of one that has come back already."""
    tracker = tracker_of()
    looks = LOOKS.copy()
    looks[5] = looks[1]
    looks[7] = looks[0]
    rows = []
    for k in range(400):
        people = list(PEOPLE)
        if LEARNED <= k < 250:
            people.remove(0)
        if k >= 270:
            people.append(5)
        if k >= 320:
            people.append(7)
        rows.append(tracker.update(frame_of(people, k, looks)))
    for row in rows:
        assert len(set(row.identity.tolist())) == len(row)
    names = rows[-1].identity.tolist()
    assert len(names) == 7
    assert identity_of(rows[-1], 0) == identity_of(rows[LEARNED - 1], 0)
    assert [pair.identity for pair in given_back(tracker)] == [identity_of(rows[0 + 199], 0)]


@pytest.mark.parametrize(("within", "known"), [(0.0, True), (10.0, True), (4.0, False)])
def test_identities_are_given_back_within_a_time(within: float, known: bool):
    tracker = tracker_of(appearance={"reidentify_within": within})
    rows = [tracker.update(found) for found in scene((LEARNED, 260), frames=300)]
    assert (identity_of(rows[-1], 0) == identity_of(rows[LEARNED - 1], 0)) == known
    assert len(given_back(tracker)) == known
    assert (len(np.unique(tracker.tracks().identity)) == len(PEOPLE)) == known


@pytest.mark.parametrize("fps", [1.0, 0.2])
@pytest.mark.parametrize(("share", "known"), [(1.5, True), (0.5, False)])
def test_the_time_of_slow_streams_is_in_seconds(fps: float, share: float, known: bool):
    """Also in corrected tracks, whose filter's time runs slower. 30 frames are 30 or 150 s."""
    within = share * 30 / fps
    tracker = Tracker(SIZE, fps=fps, appearance={"reidentify_within": within})
    for found in scene((LEARNED, LEARNED + 30), frames=LEARNED + 70):
        tracker.update(found)
    joined = len(np.unique(tracker.tracks().identity)) == len(PEOPLE)
    if fps == 1.0:
        assert joined == known
    else:
        # After 150 s the odds decide, but nothing is joined past the limit.
        assert known or not joined


def test_seconds_of_frames_follow_the_clock():
    """Whatever the filter's time does: at a steady rate, with pauses, with frames left out."""
    for steps in ([2.0] * 8, [0.04] * 8, [1.0, 3.0, 0.5, 60.0, 2.0, 2.0, 7.0, 1.0]):
        times = np.cumsum(steps)
        for unobserved in (False, True):
            tracker = Tracker(SIZE, fps=25)
            for k, time in enumerate(times.tolist()):
                found = frame_of(PEOPLE, k, LOOKS)
                if unobserved and k % 3 == 2:
                    found = Detections.empty(observed=False)
                tracker.update(found, timestamp=time)
            stages = tracker.stages
            history = stages.associator.measurements(tracker.state.association)
            seconds = history.seconds(stages.model.rate)
            observed = np.diff(history.start) > 0
            expected = times[history.number - 1] - times[0]
            np.testing.assert_allclose(seconds[observed], expected[observed], rtol=1e-9)


def test_looks_are_forgotten_after_the_time_limit():
    """Also while nobody is there: of those who have left, not of those who are hidden."""
    tracker = tracker_of(appearance={"reidentify_within": 4.0})
    sizes = []
    for k in range(300):
        tracker.update(frame_of(PEOPLE if k < LEARNED else (), k, LOOKS))
        returns = tracker.state.association.returns
        sizes.append(len(returns.seen.label) + len(returns.lost.label))
    assert sizes[LEARNED - 1] == sizes[LEARNED + 20] == len(PEOPLE)
    assert sizes[-1] == 0


def test_corrected_tracks_without_smoothing_have_returns():
    """Then those of the online rows are taken."""
    usual = tracker_of()
    tracker = Tracker(stages=replace(usual.stages, smoother=None), fps=FPS)
    for found in scene((LEARNED, 260), frames=300):
        tracker.update(found)
    corrected = tracker.tracks()
    assert len(given_back(tracker)) == 1
    assert len(np.unique(corrected.identity)) == len(PEOPLE)


@pytest.mark.parametrize("unknown", [0.0, np.nan])
def test_some_unknown_descriptors_do_no_harm(unknown: float, rng: np.random.Generator):
    tracker = tracker_of()
    for found in scene((LEARNED, 260), frames=300):
        assert found.embeddings is not None
        looks = found.embeddings.copy()
        looks[rng.random(len(looks)) < 0.1] = unknown
        tracker.update(replace(found, embeddings=looks))
    assert len(given_back(tracker)) == 1
    assert len(np.unique(tracker.tracks().identity)) == len(PEOPLE)


def test_frames_without_descriptors_do_no_harm():
    """Every second frame has none."""
    tracker = tracker_of()
    for k, found in enumerate(scene((300, 360), frames=420)):
        tracker.update(found if k % 2 else replace(found, embeddings=None))
    assert len(given_back(tracker)) == 1
    assert len(np.unique(tracker.tracks().identity)) == len(PEOPLE)


def test_classes_with_pipelines_of_their_own_have_returns():
    """Nobody takes the identity of a target of another class, however alike."""
    looks = LOOKS.copy()
    looks[5:] = LOOKS[:3]
    tracker = tracker_of()
    rows = []
    for k in range(300):
        people = [p for p in (*PEOPLE, 5, 6, 7) if not (p == 0 and LEARNED <= k < 260)]
        if k >= 230:
            # One of the second class has gone, whom one of the first looks like.
            people = [p for p in people if p != 5]
        found = frame_of(people, k, looks)
        kinds = np.array([0 if p < 5 else 1 for p in people])
        rows.append(tracker.update(replace(found, class_id=kinds)))
    first = rows[LEARNED - 1]
    assert identity_of(rows[-1], 0) == identity_of(first, 0)
    by_class = {k: set(rows[-1].identity[rows[-1].class_id == k].tolist()) for k in (0, 1)}
    assert by_class[0] == set(first.identity[first.class_id == 0].tolist())
    assert by_class[1] < set(first.identity[first.class_id == 1].tolist())
    corrected = tracker.tracks()
    assert len(np.unique(corrected.identity)) == 8
    for name in np.unique(corrected.identity):
        assert len(np.unique(corrected.class_id[corrected.identity == name])) == 1


@pytest.mark.parametrize("until", [100, 230, 263])
def test_a_saved_state_goes_on_to_the_byte(until: int):
    """While lessons are taken, while the target is away, and before it has its identity again."""
    frames = scene((LEARNED, 260), frames=300)
    whole = tracker_of()
    for found in frames[:until]:
        whole.update(found)
    saved = to_bytes(whole.state_dict())
    again = tracker_of()
    again.load_state_dict(from_bytes(saved))
    for found in frames[until:]:
        assert equal(whole.update(found), again.update(found))
    seen = [tracker.state.appearance.lessons for tracker in (whole, again)]
    assert all(map(np.array_equal, *seen))
    assert given_back(whole) == given_back(again)
    assert len(given_back(again)) == 1
    assert equal(whole.tracks(), again.tracks())


def rows_of(*stretches: tuple[int, range]) -> Tracks:
    """A row for each frame of each (identity, frames), on a detection of its own; identity 1 has
    detection 1, and so on.
    """
    frame = np.concatenate([np.array(frames) for _, frames in stretches])
    identity = np.concatenate([np.full(len(frames), one) for one, frames in stretches])
    order = np.lexsort((identity, frame))
    n = len(frame)
    return Tracks(
        frame[order],
        identity[order],
        np.zeros((n, 4)),
        np.ones(n),
        identity[order],
        np.ones(n, np.bool_),
    )


def places(rows: Tracks) -> set[tuple[int, int]]:
    return set(zip(rows.frame.tolist(), rows.detection.tolist(), strict=True))


def test_pairs_of_tracks_get_one_identity():
    """Also three in a row, in any order; identities are in order of appearance again."""
    rows = rows_of((1, range(1, 5)), (2, range(2, 9)), (3, range(7, 9)), (4, range(10, 12)))
    for pairs in (
        [((4, 1), (7, 3)), ((8, 3), (10, 4))],
        [((8, 3), (10, 4)), ((4, 1), (7, 3))],
    ):
        joined = with_returns(rows, pairs)
        # A detection is called as its track was.
        wanted = np.array([0, 1, 2, 1, 1])[joined.detection]
        np.testing.assert_array_equal(joined.identity, wanted)
        assert places(joined) == places(rows)
    late = with_returns(rows, [((8, 2), (10, 4))])
    np.testing.assert_array_equal(late.identity, np.array([0, 1, 2, 3, 2])[late.detection])


@pytest.mark.parametrize("pair", [((4, 1), (2, 2)), ((5, 1), (7, 3)), ((4, 1), (9, 9))])
def test_tracks_that_cannot_be_one_stay_two(pair: tuple):
    """Those with a frame in common, and those of detections that have no row."""
    rows = rows_of((1, range(1, 5)), (2, range(2, 9)), (3, range(7, 9)))
    assert with_returns(rows, [pair]) is rows


def test_tracks_joined_already_stay_apart_from_others():
    """The second piece of one track was there at the time of a third one."""
    rows = rows_of((1, range(1, 5)), (2, range(7, 12)), (3, range(9, 12)))
    joined = with_returns(rows, [((4, 1), (7, 2)), ((4, 1), (9, 3))])
    np.testing.assert_array_equal(joined.identity, np.array([0, 1, 1, 2])[joined.detection])


def test_odds_are_by_bayes_rule(rng: np.random.Generator):
    """The rate of returning at a place and a time, over that of new targets."""
    n = 20
    gap = rng.uniform(0.1, 60, n)
    corner = rng.uniform(0, 300, (2, n, 2))
    size = np.array([30.0, 60])
    lost = np.hstack([corner[0], corner[0] + size])
    new = np.hstack([corner[1], corner[1] + size])
    apart = np.linalg.norm(corner[1] - corner[0], axis=1)
    deviation = 60 * (0.5 + gap)
    # What is wider than the area is one there.
    peak = np.maximum(1 / (2 * math.pi * deviation**2), 1 / 5e4)
    place = NEARBY * peak * np.exp(-((apart / deviation) ** 2) / 2) + (1 - NEARBY) / 5e4
    back = 0.3 * np.exp(-gap / 12.0) / 12.0 * place
    rates = Rates(0.2, 0.3, 12.0)
    odds = log_odds(gap, lost, new, rates, 5e4)
    np.testing.assert_allclose(odds, np.log(back / (0.2 / 5e4)), rtol=1e-9)
    assert (np.diff(log_odds(np.array([1.0, 5, 50]), lost[:3], lost[:3], rates, 5e4)) < 0).all()
    assert np.isneginf(log_odds(np.array([0.0, -1.0]), lost[:2], new[:2], rates, 5e4)).all()


def test_looks_alone_say_no_more_than_that_some_look_alike():
    """However alike two look: one of those who were there may be a twin. Little evidence stays."""
    ratio = np.array([-3.0, 0.0, 1.0, 6.0, 60.0])
    twin = twin_chance(0.0, 0.0, 5)
    assert twin == TWINS / 5
    found = among(ratio, twin)
    np.testing.assert_allclose(found, np.log(1 / ((1 - twin) * np.exp(-ratio) + twin)))
    assert found[-1] == pytest.approx(math.log(50))
    assert found[1] == 0
    many = among(ratio, twin_chance(0.0, 0.0, 1000))
    assert (many[1:] >= found[1:]).all()
    assert many[3] > 5


def test_how_many_look_alike_is_learned():
    """By those that are there together, who are surely two."""
    assert twin_chance(30.0, 100.0, 1) == pytest.approx(0.3, abs=0.02)
    assert twin_chance(0.0, 100.0, 1) < 0.01
    # No more than all of them look like another one.
    assert twin_chance(50.0, 10.0, 20) == 1 / 20
    # A ratio of 9 at odds of 1:9 is an even chance.
    assert twins_among(np.log([9.0, 9.0]), 0.1) == pytest.approx(1.0)


@pytest.mark.parametrize(("alike", "twins"), [(True, 1.0), (False, 0.0)])
def test_those_that_end_are_compared_with_those_there(alike: bool, twins: float):
    views = np.eye(3, D)
    if alike:
        views[1] = views[0]
    state = Returns()
    for k in range(100):
        labels = [0, 1, 2] if k < 30 else [1, 2]
        state = after(state, labels, views[labels], k + 1, 0.1 * k)
    assert state.chances == pytest.approx(2 / 3)
    assert state.twins == pytest.approx(twins, abs=0.2)
    chance = twin_chance(state.twins, state.chances, 3)
    assert state.twin_chance == chance
    assert (chance > TWINS / 3) == alike


def test_how_long_targets_are_away_is_learned():
    assert mean_away(0.0, 0.0) == RETURN_TIME
    assert mean_away(500.0, 100.0) == pytest.approx(5.0, abs=1.5)
    assert mean_away(6000.0, 100.0) == pytest.approx(60.0, abs=3)


def test_the_share_that_comes_back_is_learned():
    assert returning_share(0.0, 0) == RETURN
    assert returning_share(0.0, 1000) < 0.05
    assert returning_share(900.0, 1000) > 0.85
    assert returning_share(0.0, int(PRIOR_ENDED)) == pytest.approx(RETURN / 2)


def test_those_that_probably_came_back_are_no_births():
    """Each counts once, with its probability when it is first compared, given back or not."""
    views = np.eye(4, D)
    state = Returns()
    for k in range(30):
        state = after(state, [0, 1, 2], views[:3], k + 1, 0.1 * k)
    for k in range(30, 60):
        state = after(state, [1, 2], views[1:3], k + 1, 0.1 * k)
    assert state.back == 0
    for k in range(60, 63):
        state = after(state, [1, 2, 3], views[[1, 2, 0]], k + 1, 0.1 * k)
    looks = looks_at(6.2)
    found = reidentification.compared(state, looks)
    assert found is not None
    total = found.odds.sum()
    expected, away = reidentification.expected_back(state, found)
    assert expected == pytest.approx(total / (1 + total))
    assert expected > 0.2
    # Last seen at 2.9 s, again at 6.0 s.
    assert away == pytest.approx(3.1 * expected)
    later = after(state, [1, 2, 3], views[[1, 2, 0]], 64, 6.3)
    found = reidentification.compared(later, looks_at(6.3))
    assert found is not None
    assert reidentification.expected_back(later, found) == (0, 0)


def looks_at(time: float, raw: np.ndarray | None = None) -> Looks:
    """Of a frame with these descriptors, after lessons that told all from each other."""
    law = UNKNOWN._replace(
        weight=1.0,
        means_weight=1.0,
        means_same=0.9,
        means_deviation=0.1,
        means_other_deviation=0.3,
        within=math.inf,
    )
    seen = np.zeros((0, D), np.float32) if raw is None else raw.astype(np.float32)
    return Looks(seen, seen, np.zeros(D, np.float32), np.ones(len(seen)), law, time, 3.0)


def after(state: Returns, labels: list[int], views: np.ndarray, frame: int, time: float) -> Returns:
    """The state after a frame in which these confirmed targets are seen; their identities are one
    more than their labels.
    """
    looks = looks_at(time, views)
    n = len(labels)
    state, _ = remembering(
        state, estimates(labels, views), np.arange(n), frame, looks, np.ones(n, np.bool_)
    )
    known = np.arange(max(labels, default=0) + 1)
    state = reidentification.with_twins(state, looks)
    return forgetting(named(state, Names(known, known + 1)), looks.law.within)


def estimates(labels: list[int], looks: np.ndarray) -> Estimates:
    """Targets that stand apart."""
    n = len(labels)
    left = 100.0 * np.arange(n)
    return Estimates(
        np.zeros((6, n)),
        np.zeros((n, 6, 6)),
        np.ones(n),
        np.stack([left, 0 * left, left + 40, 0 * left + 80], axis=1),
        np.arange(n),
        np.array(labels, np.int64),
        appearance=looks.astype(np.float32),
        appearance_count=np.full(n, 9.0),
        followed=np.array(labels, np.int64),
    )


def test_lost_targets_that_are_remembered_are_few(monkeypatch: pytest.MonkeyPatch):
    """The newest; and none of those whose identity was given back."""
    monkeypatch.setattr(reidentification, "MOST_LOST", 5)
    state = Returns()
    for k in range(30):
        state = after(state, [k], np.eye(1, D), k + 1, float(10 * k))
        assert len(state.seen.label) <= 2
        assert len(state.lost.label) <= 5
    assert state.lost.label.tolist() == [24, 25, 26, 27, 28]
    assert state.lost.rows["identity"].tolist() == [25, 26, 27, 28, 29]
    pair = Return(27, 29, 28, 2.0, 290.0, (28, 0), (30, 0))
    state = taken(state, [pair])
    assert state.lost.label.tolist() == [24, 25, 26, 28]
    assert state.seen.rows["given"].tolist() == [1]
    assert state.pairs == (pair,)
    monkeypatch.setattr(reidentification, "MOST_PAIRS", 3)
    for k in (24, 25, 26, 28):
        state = taken(state, [pair._replace(earlier=k)])
    assert len(state.pairs) == 3


def test_memory_is_bounded_with_thousands_of_targets():
    """Five thousand come and go, a hundred at a time: the newest are remembered, the state does not
    grow, and one of them is known again.
    """
    views = np.random.default_rng(0).normal(0, 1, (5000, D))
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    state = Returns()
    sizes = list[int]()
    time = 0.0
    for k in range(50):
        time = 1000.0 * k
        labels = np.arange(100 * k, 100 * k + 100)
        state = after(state, labels.tolist(), views[labels], k + 1, time)
        sizes.append(len(to_bytes(state)))
    held = reidentification.MOST_LOST
    assert state.lost.label.tolist() == list(range(4900 - held, 4900))
    assert max(sizes) < 1.1 * sizes[25] < 1e6
    # Of a stream to which many come back.
    state = replace(state, back=2500.0, away=30.0 * 2500)
    pairs = list[Return]()
    for k in range(50, 53):
        time += 1.0
        state = after(state, [5000], views[[4900]], k + 1, time)
        found = compared(state, looks_at(time))
        pairs = given_back_by(state, found) if found else []
    assert [pair.identity for pair in pairs] == [4901]


def test_targets_of_another_descriptor_are_forgotten():
    state = after(Returns(), [1, 2], np.eye(2, D), 1, 0.0)
    assert len(state.seen.label) == 2
    state = replace(state, met=np.zeros(1, MET))
    other = looks_at(1.0)._replace(raw=np.zeros((0, 3), np.float32), mean=np.zeros(3, np.float32))
    state, _ = remembering(
        state, Estimates.empty(6), np.zeros(0, int), 2, other, np.zeros(0, np.bool_)
    )
    assert compared(state, other) is None
    assert all(map(np.array_equal, state.seen, nobody(3)))
    assert not len(state.met)


def test_associators_without_labels_give_nothing_back():
    tracker = Tracker((640, 480), fps=25, filter="gm-phd")
    tracker.update(np.array([[10.0, 10, 50, 90]]), embeddings=np.ones((1, 4)))
    associator: Associator = tracker.stages.associator
    assert associator.returns(tracker.state.association) == ()


def test_lanes_of_people_do_not_touch():
    """What these tests rest on: nobody hides anybody."""
    for k in range(0, 400, 7):
        boxes = np.array([pacing(person, k) for person in range(8)])
        for a, b in pairwise(boxes[np.lexsort((boxes[:, 0], boxes[:, 1]))]):
            assert b[0] >= a[2] or b[1] >= a[3] or a[1] >= b[3] or a[0] >= b[2]
