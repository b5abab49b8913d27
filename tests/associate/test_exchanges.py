"""Identities that two targets exchange, where they look as if they had taken each other's."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from appearance_cases import DARK, FPS, FRAMES, HIDDEN, LOOKS, SIZE, D, meeting, tracker_of
from phdtrack import Tracker
from phdtrack.associate import reidentification
from phdtrack.associate.reidentification import (
    EXCHANGED,
    EXCHANGED_WITH_LOST,
    Names,
    Returns,
    Shown,
    compared,
    exchanged,
    given_back,
)
from phdtrack.kernels.appearance import UNKNOWN, Looks, likeness, plain
from phdtrack.kernels.identities import (
    LABELS,
    LIKELY,
    MET,
    SEEN,
    Rules,
    Seen,
    exchange_odds,
    met_after,
    nobody,
)
from phdtrack.state import from_bytes, to_bytes
from phdtrack.types import F8, Exchange, Tracks
from tracker_cases import equal


def identities(rows: list[Tracks], k: int) -> tuple[int, int]:
    """Of the two, in frame k."""
    found = [np.flatnonzero(rows[k].detection == j) for j in (0, 1)]
    return tuple(int(rows[k].identity[at[0]]) if len(at) else 0 for at in found)


@pytest.mark.parametrize("turn", [False, True])
def test_two_who_meet_keep_their_identities(turn: bool):
    """Whether they go on or turn back, which motion cannot know: from 1.5 s after both are seen."""
    tracker = tracker_of()
    rows = [tracker.update(found) for found in meeting(turn)]
    before = identities(rows, HIDDEN[0] - 5)
    assert 0 not in before
    for k in range(DARK[-1] + round(1.5 * FPS), FRAMES):
        assert identities(rows, k) == before


def test_an_exchange_is_told():
    """What motion gets wrong is in `Tracker.exchanges`, and two have no one identity in a frame."""
    told = list[int]()
    for turn in (False, True):
        tracker = tracker_of()
        rows = [tracker.update(found) for found in meeting(turn)]
        two = set(identities(rows, HIDDEN[0] - 5))
        for each in tracker.exchanges:
            assert set(each.identities) == two
            assert each.odds > 1
            assert HIDDEN[0] < each.frame <= DARK[-1] + 1.5 * FPS
        told.append(len(tracker.exchanges))
        for row in rows:
            assert len(set(row.identity.tolist())) == len(row)
    assert sum(told) >= 1


@pytest.mark.parametrize("kind", ["alike", "no looks"])
def test_where_both_look_alike_nothing_is_exchanged(kind: str):
    looks = LOOKS.copy()
    looks[1] = looks[0]
    for turn in (False, True):
        tracker = tracker_of()
        for found in meeting(turn, looks):
            tracker.update(replace(found, embeddings=None) if kind == "no looks" else found)
        assert tracker.exchanges == ()


def test_a_saved_state_exchanges_the_same():
    frames = meeting(turn=True)
    for until in (HIDDEN[4], DARK[-1] + 3):
        whole = tracker_of()
        for found in frames[:until]:
            whole.update(found)
        again = tracker_of()
        again.load_state_dict(from_bytes(to_bytes(whole.state_dict())))
        for found in frames[until:]:
            assert equal(whole.update(found), again.update(found))
        assert whole.exchanges == again.exchanges


def test_other_filters_exchange_nothing():
    tracker = Tracker(SIZE, fps=25, filter="gm-phd")
    tracker.update(np.array([[10.0, 10, 50, 90]]), embeddings=np.ones((1, 4)))
    assert tracker.exchanges == ()


def test_pairs_that_meet_are_those_whose_boxes_nearly_touch(rng: np.random.Generator):
    """Against a plain definition; known targets only, and pairs are forgotten after a time."""
    known = np.zeros(20, SEEN)
    known["label"] = np.arange(0, 40, 2)
    expected = dict[int, float]()
    met = np.zeros(0, MET)
    for k in range(30):
        label = np.sort(rng.permutation(40)[:12])
        corner = rng.uniform(0, 300, (12, 2))
        boxes = np.hstack([corner, corner + rng.uniform(10, 60, (12, 2))])
        time = 1.5 * k
        met = met_after(met, known, (label, boxes), time, (0.25, 5.0))
        center = 0.5 * (boxes[:, :2] + boxes[:, 2:])
        half = 0.5 * 1.25 * (boxes[:, 2:] - boxes[:, :2])
        for a in range(12):
            for b in range(a + 1, 12):
                both = label[a] in known["label"] and label[b] in known["label"]
                if both and (abs(center[a] - center[b]) < half[a] + half[b]).all():
                    expected[int(label[a]) * LABELS + int(label[b])] = time
        expected = {pair: last for pair, last in expected.items() if time - last <= 5}
        assert met["pair"].tolist() == sorted(expected)
        assert met["when"].tolist() == [expected[pair] for pair in sorted(expected)]
    assert len(met)
    met = met_after(met, known[:0], (label, boxes), time, (0.25, 5.0))
    assert not len(met)


def state_of(own: np.ndarray, lately: np.ndarray, alive: list[bool]) -> Returns:
    """Targets 3, 5, … that have all met, with these looks."""
    n = len(own)
    label = 3 + 2 * np.arange(n)
    pairs = [a * LABELS + b for i, a in enumerate(label) for b in label[i + 1 :]]
    rows = with_columns(
        np.zeros(n, SEEN),
        label=label,
        identity=np.where(alive, 0, 100 + label),
        last=np.where(alive, 9.0, 8.0),
        right=20,
        bottom=40,
        detections=90,
        alive=alive,
        weight=9,
        number=9,
        lately_weight=3,
        lately_number=2,
        updated=9,
    )
    looks = np.stack([own, lately], axis=1).astype(np.float32)
    met = with_columns(np.zeros(len(pairs), MET), pair=pairs, when=8.5)
    return Returns(seen=Seen(rows, looks), lost=nobody(D), met=met, time=9.0)


def with_columns(rows: np.ndarray, **columns: object) -> np.ndarray:
    """The rows with other values in these columns."""
    rows = rows.copy()
    for name, values in columns.items():
        rows[name] = values
    return rows


def looks_of(time: float = 9.0, doubt: float = 0.0) -> Looks:
    law = UNKNOWN._replace(
        means_weight=0.9,
        means_same=0.8,
        means_deviation=0.1,
        means_other_deviation=0.2,
        doubt=doubt,
        within=math.inf,
    )
    none = np.zeros((0, D), np.float32)
    return Looks(none, none, np.zeros(D, np.float32), np.zeros(0), law, time, 3.0)


def rules_of(*prior: float) -> tuple[float, ...]:
    """`Rules` with log odds before anything is known."""
    return tuple(Rules(10.0, 0.7, 0.25, 5.0, *prior, 1.5, 3, 3.0))


def odds_of(state: Returns, *prior: float) -> F8:
    """(M,) the log odds of exchanges of the pairs that have met."""
    return exchange_odds(tuple(state.seen), state.met, plain(looks_of()), rules_of(*prior))


def exchanges(state: Returns, frame: int, names: Names) -> list[Exchange]:
    """The exchanges of a frame that has shown all that is known."""
    odds = odds_of(state, EXCHANGED, EXCHANGED_WITH_LOST)
    likely = np.zeros(np.count_nonzero(odds > 0), LIKELY)
    likely["pair"] = state.met["pair"][odds > 0]
    likely["odds"] = odds[odds > 0]
    return reidentification.exchanges(state, Shown(likely, 0, 0), frame, names)


NAMES = Names(np.array([3, 5, 7]), np.array([11, 12, 13]))


def test_odds_are_those_of_the_four_likelihoods(rng: np.random.Generator):
    """p(looks | exchanged)/p(looks | as they are), with the prior; of a lost one no looks count."""
    own = rng.normal(0, 1, (3, D))
    # Each looks a little like the next one.
    lately = 0.4 * own + 0.7 * own[[1, 2, 0]]
    state = state_of(own, lately, [True, True, False])
    both = np.vstack([own, lately]).astype(np.float32)
    number = np.array([9.0] * 3 + [2.0] * 3)
    before, after = np.indices((3, 3)).reshape(2, -1)
    fits = likeness(both, number, np.zeros(6), before, 3 + after, plain(looks_of())).reshape(3, 3)
    ratios = np.array(
        [
            fits[0, 1] + fits[1, 0] - fits[0, 0] - fits[1, 1],
            fits[2, 0] - fits[0, 0],
            fits[2, 1] - fits[1, 1],
        ]
    )
    for prior in ((30.0, 20.0), (EXCHANGED, EXCHANGED_WITH_LOST)):
        odds = odds_of(state, *prior)
        expected = ratios + np.array([prior[0], prior[1], prior[1]])
        possible = np.isfinite(odds)
        np.testing.assert_allclose(odds[possible], expected[possible], rtol=1e-6)
        assert (expected[~possible] <= 0).all()
        assert possible.all() == (prior[0] > 0)
    unseen = with_columns(state.seen.rows, lately_number=[2, 1, 2])
    odds = odds_of(replace(state, seen=Seen(unseen, state.seen.looks)), 30.0, 30.0)
    # Of the hidden one nothing is known, and no pair of two of whom nothing is.
    assert np.isneginf(odds).tolist() == [False, False, True]
    np.testing.assert_allclose(odds[0], 30.0 + fits[1, 0] - fits[0, 0], rtol=1e-6)


def test_exchanges_are_doubted_where_looks_change_places(rng: np.random.Generator):
    own = rng.normal(0, 1, (3, D))
    state = state_of(own, own[[1, 2, 0]], [True, True, False])
    rules = rules_of(30.0, 20.0)
    usual, doubtful = (
        exchange_odds(tuple(state.seen), state.met, plain(looks_of(doubt=doubt)), rules)
        for doubt in (0.0, 1.5)
    )
    np.testing.assert_allclose(usual - doubtful, 1.5)


def test_a_target_takes_the_identity_of_a_lost_one():
    """It hid another, which the filter then dropped, and went on with the wrong one: the lost one's
    identity is the target's, and the target's is that of one who is lost.
    """
    own = np.eye(3, D)
    lately = own[[1, 1, 2]]
    state = state_of(own, lately, [True, False, True])
    (found,) = exchanges(state, 77, NAMES)
    assert found.labels == (3, 5)
    assert found.identities == (11, 105)
    assert found.frame == 77
    state = exchanged(state, [found])
    np.testing.assert_array_equal(state.seen.looks[:, 0], own[[1, 0, 2]])
    assert state.seen.rows["identity"].tolist() == [0, 11, 0]
    assert state.exchanges == (found,)
    assert exchanges(state, 78, NAMES) == []
    # Somebody who looks like the first one then has that one's identity.
    rows = with_columns(state.seen.rows, first=[0, 0, 8.9], detections=[90, 90, 5])
    looks = state.seen.looks.copy()
    looks[:, 0] = own[[1, 0, 0]]
    seen = Seen(rows, looks)
    state = replace(state, seen=seen, extent=(0, 0, 100, 100), begun=-100.0, confirmed=3)
    found = compared(state, looks_of())
    assert found is not None
    (back,) = given_back(state, found)
    assert (back.earlier, back.later, back.identity) == (5, 7, 11)


def test_a_target_takes_the_identity_of_a_hidden_one():
    """The other one is followed, but others cover it: what it looks like now is not known."""
    own = np.eye(3, D)
    state = state_of(own, own[[1, 1, 2]], [True, True, True])
    hidden = with_columns(state.seen.rows, lately_number=[2, 1, 2])
    (found,) = exchanges(replace(state, seen=Seen(hidden, state.seen.looks)), 77, NAMES)
    assert found.labels == (3, 5)
    assert found.identities == (11, 12)


def test_pairs_of_somebody_forgotten_do_nothing():
    """One who was lost long ago may have met another by where it was thought to be."""
    own = np.eye(3, D)
    state = state_of(own, own[[1, 0, 2]], [True, True, True])
    for gone in (0, 1, 2):
        left = replace(state, seen=state.seen.select(np.arange(3) != gone))
        found = exchanges(left, 5, NAMES)
        assert [each.labels for each in found] == ([(3, 5)] if gone == 2 else [])
    nobody_left = replace(state, seen=nobody(D))
    assert exchanges(nobody_left, 5, NAMES) == []


def test_three_exchange_in_turn():
    """Each has the identity of the next: two exchanges, one frame after the other, put it right."""
    own = np.eye(3, D)
    state = state_of(own, own[[1, 2, 0]], [True, True, True])
    names = NAMES
    for k in range(2):
        found = exchanges(state, k, names)
        assert len(found) == 1
        identity = names.identity.copy()
        at = np.searchsorted(names.label, found[0].labels)
        identity[at] = identity[at[::-1]]
        names = Names(names.label, identity)
        state = exchanged(state, found)
    assert names.identity.tolist() == [12, 13, 11]
    assert exchanges(state, 3, names) == []
