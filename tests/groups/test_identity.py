"""The lives of groups: what is told, when it began, and what flickers by unnoticed."""

import numpy as np
import pytest

from phdtrack.groups.life_cycle import Event, GroupLifeCycle, LifeCycleState

T = 0.1


def play(frames, hold=0.5):
    """Groups by frame, {member: group}, and all events, of frames [{member: cluster}, …] that are T
    seconds apart.
    """
    living = GroupLifeCycle(hold)
    state = LifeCycleState()
    groups = []
    told = []
    for number, clusters in enumerate(frames, 1):
        who = np.array(list(clusters), np.int64)
        label = np.array(list(clusters.values()), np.int64)
        state, accepted, events = living.extend(
            state, who, label, np.ones(len(who)), number, number * T
        )
        groups.append(dict(zip(who.tolist(), accepted.tolist(), strict=True)))
        told += events
    return groups, told


TOGETHER = {1: 0, 2: 0, 3: 0}
APART = {1: 0, 2: 0, 3: 1}


def test_split_is_reported_once_with_its_first_frame():
    groups, told = play([{1: 0, 2: 0}] * 5 + [TOGETHER] * 5 + [APART] * 10)
    assert told == [
        Event(1, pytest.approx(T), "appear", 1),
        Event(11, pytest.approx(1.1), "split", 2, 1),
    ]
    assert groups[5] == {1: 1, 2: 1, 3: 1}
    # The larger part keeps the number.
    assert groups[-1] == {1: 1, 2: 1, 3: 2}


def test_merge_is_reported_for_the_smaller_group():
    groups, told = play([APART] * 10 + [TOGETHER] * 10)
    assert [e.kind for e in told] == ["appear", "appear", "merge"]
    assert told[2] == Event(11, pytest.approx(1.1), "merge", 2, 1)
    assert set(groups[-1].values()) == {1}


@pytest.mark.parametrize(
    ("usual", "moment", "groups"),
    [
        (TOGETHER, APART, {1: 1, 2: 1, 3: 1}),
        (APART, TOGETHER, {1: 1, 2: 1, 3: 2}),
        (APART, {1: 0, 2: 0}, {1: 1, 2: 1, 3: 2}),
        ({1: 0}, {1: 0, 9: 1}, {1: 1}),
    ],
    ids=["split", "touch", "missed", "newcomer"],
)
def test_short_changes_are_ignored(usual, moment, groups):
    found, events = play([usual] * 10 + [moment] * 3 + [usual] * 10)
    assert [event.kind for event in events] == ["appear"] * len(set(usual.values()))
    assert found[-1] == groups


def test_unseen_group_vanishes_with_its_last_frame():
    _, told = play([TOGETHER] * 10 + [{}] * 10)
    assert told[-1] == Event(10, pytest.approx(1.0), "vanish", 1)


def test_without_hold_time_groups_are_the_clusters():
    rng = np.random.default_rng(4)
    frames = [
        dict(zip(range(1, 7), rng.integers(0, 3, 6).tolist(), strict=True)) for _ in range(40)
    ]
    groups, _ = play(frames, hold=0.0)
    for clusters, group in zip(frames, groups, strict=True):
        pairs = {(clusters[m], group[m]) for m in clusters}
        assert len(pairs) == len(set(clusters.values())) == len(set(group.values()))


def test_every_group_begins_once_and_ends_at_most_once():
    for seed in range(30):
        rng = np.random.default_rng(seed)
        frames = []
        clusters = dict.fromkeys(range(1, 9), 0)
        for _ in range(120):
            if rng.random() < 0.15:
                clusters = {m: int(rng.integers(0, 3)) for m in range(1, 9) if rng.random() < 0.8}
            frames.append(clusters)
        _, told = play(frames, hold=0.3)
        began = [e.group for e in told if e.kind in ("appear", "split")]
        ended = [e.group for e in told if e.kind in ("vanish", "merge")]
        assert len(began) == len(set(began))
        assert len(ended) == len(set(ended))
        assert set(ended) <= set(began)
