"""The embeddings of no use, the simulation of people who come back, and how pairs are counted."""

from __future__ import annotations

import math

import numpy as np
import pytest

from experiments import appearance, appearance_pictures, appearance_returns
from experiments.appearance_inputs import PEERS
from experiments.appearance_returns import HiddenRun, Walks
from experiments.appearance_runs import HARMFUL, before, exchanged, owners
from experiments.degraded_inputs import Input
from phdtrack import Tracks


def crossing() -> Input:
    """Two objects at 5 frames a second that meet in frames 4 to 6 of 20, both always detected; the
    second one is nearer.
    """
    frame = np.repeat(np.arange(1, 21), 2)
    left = np.column_stack([20.0 * np.arange(20), 160 - 20.0 * np.arange(20)]).ravel()
    top = np.tile([0.0, 5.0], 20)
    xyxy = np.column_stack([left, top, left + 50, top + 100])
    identity = np.tile([7, 9], 20)
    truth = np.column_stack([frame, identity, xyxy[:, :2], np.tile([50.0, 100.0, 1.0], (40, 1))])
    return Input(
        frame, xyxy, np.ones(40), 20, (640, 480), 5.0, truth.astype(float), np.zeros((0, 7))
    )


def test_detections_belong_to_the_object_they_overlap():
    given = crossing()
    assert owners(given)[:2].tolist() == [7, 9]
    given.xyxy[0] += 200
    assert owners(given)[0] == -1


def test_objects_that_meet_exchange_looks_for_two_seconds():
    given = crossing()
    source = exchanged(given, owners(given)).reshape(20, 2)
    own = np.arange(40).reshape(20, 2)
    swapped = (source != own).all(axis=1)
    meet = int(np.flatnonzero(swapped)[0])
    assert np.abs(given.xyxy[2 * meet, 0] - given.xyxy[2 * meet + 1, 0]) < 50
    assert swapped.sum() == 10
    assert (source[swapped] == own[swapped][:, ::-1]).all()
    assert (source[~swapped] == own[~swapped]).all()


def test_one_that_is_not_detected_lends_its_last_look():
    given = crossing()
    owner = owners(given)
    start = int(np.flatnonzero(exchanged(given, owner) != np.arange(40))[0])
    owner[start + 3] = -1
    source = exchanged(given, owner)
    assert source[start + 2] == start + 1
    assert source[start + 3] == start + 3


def test_a_covered_box_has_the_look_of_what_is_before():
    given = crossing()
    away = np.abs(given.xyxy[0::2, 0] - given.xyxy[1::2, 0])
    for part in (0.0, 0.25):
        source = before(given, part).reshape(20, 2)
        covered = (50 - away) * 95 / 5000 > part
        assert (source[:, 1] == np.arange(1, 40, 2)).all()
        assert ((source[:, 0] == source[:, 1]) == covered).all()


def rows(values: dict[str, float], group: str = "g") -> list[dict[str, str]]:
    """The row of each case, all scores the same, and the row of the group."""
    found = [
        {"group": group, "sequence": case, "detector": "x"}
        | {score: str(value) for score in appearance.SCORES}
        for case, value in values.items()
    ]
    mean = str(np.mean(list(values.values())))
    whole = {"group": group, "sequence": "ALL", "detector": "ALL"}
    return [*found, whole | dict.fromkeys(appearance.SCORES, mean)]


def test_pairs_that_are_equal_count_half():
    own = rows({"a": 50, "b": 60, "c": 70})
    peers = [rows({"a": 49, "b": 60, "c": 10}), rows({"a": 10, "b": 10, "c": 71})]
    found = appearance.ahead(own, peers)
    assert [one[0] for one in found] == [1, 1, 1, 0.5, 0.5, 0.5, 0, 0, 0]
    assert found[-1][1] == -1
    assert appearance.ahead(own, peers, "h") == []


def test_differences_have_a_sign_and_an_error():
    assert appearance.signed([1.0]) == "+1.00"
    assert appearance.signed([-1.0, -3.0], 1) == "-2.0 ± 1.0"


def test_kept_peers_have_every_case_and_group():
    kept = appearance.kept_peers()
    by_run: dict[tuple[str, str], set[tuple[str, str, str]]] = {}
    for row in kept:
        name = (row["group"], row["sequence"], row["detector"])
        by_run.setdefault((row["quality"], row["tracker"]), set()).add(name)
    assert {name for _, name in by_run} == set(PEERS)
    assert {len(cases) for cases in by_run.values()} == {46 + 8}


def test_every_kind_without_use_is_told_on_the_page():
    assert set(appearance.HARMFUL) == set(HARMFUL)
    assert all(text for text in HARMFUL.values())


def test_people_come_back_after_the_given_time():
    run = HiddenRun(5.0, 4, 1, seconds=200.0)
    scene = appearance_returns.walks(run)
    assert scene.frame[0] == 1
    assert scene.frame.max() <= 200 * appearance_returns.FPS
    gone = round(5.0 * appearance_returns.FPS)
    checked = 0
    for number, person, back in scene.appearances:
        mine = scene.frame[scene.person == person]
        assert number in mine
        assert number - 1 not in mine
        earlier = mine[mine < number]
        if back and len(earlier):
            assert number - earlier.max() == gone + 1
            checked += 1
        if not back and person >= 4:
            assert not len(earlier)
    assert checked > 5


def test_nobody_walks_faster_than_the_speed():
    path = appearance_returns.random_walk(500, np.random.default_rng(1))
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert steps.max() <= appearance_returns.SPEED / appearance_returns.FPS + 1e-9


def test_one_covered_by_more_than_half_is_not_detected():
    boxes = np.array([[0, 0, 60, 150], [10, 10, 70, 160], [100, 0, 160, 150.0]])
    assert appearance_returns.covered(boxes).tolist() == [True, False, False]


def back_and_stranger() -> tuple[Walks, Tracks]:
    """Person 0 is there in frames 1 to 60 and 121 to 240, 1 from 151 on, and 2 in 1 to 30."""
    spans = ((0, 1, 60), (0, 121, 240), (1, 151, 240), (2, 1, 30))
    frame = np.concatenate([np.arange(first, last + 1) for _, first, last in spans])
    person = np.concatenate([np.full(last - first + 1, who) for who, first, last in spans])
    order = np.argsort(frame, kind="stable")
    scene = Walks(
        frame[order],
        person[order],
        np.zeros((len(order), 4)),
        np.arange(3),
        ((121, 0, True), (151, 1, False)),
    )
    rows_of = Tracks.of(
        scene.frame, scene.person + 1, scene.xyxy, 1.0, np.zeros(len(order), np.int64)
    )
    return scene, rows_of


@pytest.mark.parametrize(
    ("again", "stranger", "kept", "mistaken"),
    [(1, 2, True, False), (4, 2, False, False), (1, 3, True, True), (3, 1, False, False)],
)
def test_identities_are_judged_by_who_had_them(
    again: int, stranger: int, kept: bool, mistaken: bool
):
    """A stranger is mistaken for somebody only if that one is gone: the last case is a swap."""
    scene, tracks = back_and_stranger()
    tracks.identity[(scene.person == 0) & (scene.frame > 100)] = again
    tracks.identity[scene.person == 1] = stranger
    assert appearance_returns.judge(scene, tracks, scene.person) == ((kept,), (mistaken,))


def test_rows_without_a_detection_are_of_nobody():
    ends = np.array([0, 2, 2, 3])
    tracks = Tracks.of(
        np.array([1, 2, 3]), np.array([1, 1, 1]), np.zeros((3, 4)), 1.0, np.array([1, -1, 0])
    )
    assert appearance_returns.person_of(tracks, ends, np.array([5, 6, 8])).tolist() == [6, -1, 8]


def test_claims_are_pooled_by_their_probability():
    claims = [(0.55, True), (0.55, False), (0.92, True), (0.9, False)]
    bins = appearance_returns.calibration(claims)
    assert [(low, right, number) for low, _, _, right, number in bins] == [
        (0.5, 1, 2),
        (0.8, 0, 1),
        (0.9, 1, 1),
    ]
    low, high = appearance_returns.interval(1, 2)
    assert 0 < low < 0.5 < high < 1
    assert "2 were right" in appearance_returns.verdict(claims, bins)
    assert appearance_returns.verdict([], []) == "No identity was given back."


def test_both_sources_count_alike():
    rows_of = np.array([[3.0, 4.0], [0.0, 0.0]], np.float32)
    unit = appearance_pictures.unit(rows_of)
    assert math.isclose(float(np.linalg.norm(unit[0])), 1, rel_tol=1e-6)
    assert not unit[1].any()
