"""Events: what is counted of walks, of trembling ones and of ones with gaps; that a state can be
saved; and nobody twice.
"""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phdtrack.groups.life_cycle import Event as GroupEvent
from phdtrack.live.events import Event, Watch, WatchState
from phdtrack.live.zones import Place
from phdtrack.state import from_bytes, to_bytes, unpack
from phdtrack.types import F8, Tracks

DOOR = Place("door", ((0.0, 100.0), (200.0, 100.0)), closed=False)
ROOM = Place("room", ((0.0, 100.0), (200.0, 100.0), (200.0, 300.0), (0.0, 300.0)), closed=True)
WATCH = Watch((DOOR, ROOM), dwell=2.0)
HEIGHT = 50.0
FPS = 10


def rows(
    number: int, feet: dict[int, tuple[float, float]], *, confirmed: bool = True, label: int = 0
) -> Tracks:
    """Rows of people of 50 pixels whose feet are there."""
    boxes = np.array([[x - 10, y - HEIGHT, x + 10, y] for x, y in feet.values()]).reshape(-1, 4)
    found = Tracks.of(number, 1, boxes, 1.0, 0, confirmed)
    identity = np.array(list(feet), np.int64)
    return Tracks(
        found.frame,
        identity,
        boxes,
        found.confidence,
        found.detection,
        found.confirmed,
        np.full(len(feet), label),
    )


def watched(
    walks: list[dict[int, tuple[float, float]]], watch: Watch = WATCH, *, saved: bool = False
) -> tuple[WatchState, list[Event]]:
    """The state and all events of walks, frame by frame; ``saved``: the state is saved and loaded
    after every frame.
    """
    state = watch.start()
    events = list[Event]()
    for k, feet in enumerate(walks, start=1):
        state, new = watch.advance(state, rows(k, feet), k, k / FPS)
        events += new
        if saved:
            state = unpack(from_bytes(to_bytes(state)), WatchState)
    return state, events


def straight(start: tuple[float, float], end: tuple[float, float], count: int) -> F8:
    return np.linspace(start, end, count)


def kinds(events: list[Event]) -> list[str]:
    return [event.kind for event in events]


def test_who_walks_in_and_out_is_counted() -> None:
    way = np.vstack([straight((100, 50), (100, 200), 16), straight((100, 200), (100, 40), 17)])
    state, events = watched([{7: (x, y)} for x, y in way.tolist()] + [{}] * 40)
    # Over the door the feet stay in the room for 2 s, which is the dwell.
    assert kinds(events) == ["appear", "enter", "cross", "dwell", "cross", "exit", "leave"]
    assert [e.direction for e in events if e.kind == "cross"] == ["in", "out"]
    assert state.counts[0].entered == state.counts[0].left == 1
    assert (state.counts[1].entered, state.counts[1].occupancy) == (1, 0)
    assert state.counts[1].seconds == pytest.approx(2.2)
    assert not state.visitors
    assert [e.occupancy for e in events if e.place == "room"] == [1, 1, 0]
    assert events[-1].seconds == pytest.approx(3.2)


@pytest.mark.parametrize("seed", range(200))
def test_who_trembles_is_counted_once(seed: int) -> None:
    """A slow walk over a line, trembling by a twentieth of the height, often back and forth: one
    crossing, one entry.
    """
    rng = np.random.default_rng(seed)
    way = straight((100, 60), (100, 140), 120) + rng.normal(0, HEIGHT / 40, (120, 2))
    state, events = watched([{1: (x, y)} for x, y in way.tolist()])
    assert kinds(events).count("cross") == 1
    assert kinds(events).count("enter") == 1
    assert "exit" not in kinds(events)
    assert state.counts[0].entered == 1


def test_who_trembles_on_the_line_and_turns_back_has_not_crossed() -> None:
    way = [(100.0, y) for y in (80, 90, 99, 101, 98, 102, 99, 90, 80)]
    _, events = watched([{1: at} for at in way], Watch((DOOR,)))
    assert kinds(events) == ["appear"]


@pytest.mark.parametrize("gap", [0, 5, 25])
def test_a_track_lost_before_and_found_behind_a_line_crosses(gap: int) -> None:
    _, events = watched([{3: (100, 80)}, *[{}] * gap, {3: (110, 130)}], Watch((DOOR,)))
    assert kinds(events) == ["appear", "cross"]


def test_a_return_after_leaving_appears_anew_without_crossing() -> None:
    _, events = watched([{3: (100, 80)}, *[{}] * 35, {3: (110, 130)}], Watch((DOOR,)))
    assert kinds(events) == ["appear", "leave", "appear"]


def test_unconfirmed_rows_and_other_classes_do_not_count() -> None:
    watch = Watch((Place("cars", DOOR.points, False, classes=("car",)),), {1: "person", 2: "car"})
    state = watch.start()
    for k, (y, label) in enumerate([(80, 1), (120, 1), (80, 1)], start=1):
        state, events = watch.advance(state, rows(k, {1: (100, y)}, label=label), k, k / FPS)
        assert "cross" not in kinds(list(events))
    for k, y in enumerate([80, 120], start=4):
        state, events = watch.advance(state, rows(k, {2: (50, y)}, label=2), k, k / FPS)
    assert [(e.kind, e.identity) for e in events] == [("cross", 2)]
    _, events = watch.advance(state, rows(6, {9: (50, 50)}, confirmed=False), 6, 0.6)
    assert not events


def test_two_in_a_zone_and_who_vanishes_there_has_left_it() -> None:
    state, events = watched([{1: (50, 150), 2: (90, 150)}, {1: (50, 150)}] + [{1: (50, 150)}] * 40)
    assert [(e.kind, e.identity, e.occupancy) for e in events if e.kind in ("enter", "exit")] == [
        ("enter", 1, 1),
        ("enter", 2, 2),
        ("exit", 2, 1),
    ]
    assert state.counts[1].occupancy == 1
    assert kinds(events).count("dwell") == 1


def test_memory_does_not_grow() -> None:
    state = WATCH.start()
    for k in range(1, 500):
        state, _ = WATCH.advance(state, rows(k, {k: (100, 50)}), k, float(k))
        assert len(state.visitors) <= 4


moves = st.lists(
    st.dictionaries(
        st.integers(1, 3), st.tuples(st.floats(-50, 250), st.floats(0, 350)), max_size=3
    ),
    max_size=25,
)


@given(moves)
def test_a_saved_state_continues_and_counts_agree_with_events(
    walks: list[dict[int, tuple[float, float]]],
) -> None:
    state, events = watched(walks)
    again, same = watched(walks, saved=True)
    assert repr(events) == repr(same)
    assert repr(state) == repr(again)
    assert state.counts[1].entered == kinds(events).count("enter")
    assert state.counts[1].left == kinds(events).count("exit")
    assert state.counts[1].occupancy == sum(
        not math.isnan(one.since[1]) for one in state.visitors.values()
    )
    assert state.counts[0].entered - state.counts[0].left == sum(
        {"in": 1, "out": -1}.get(event.direction, 0) for event in events
    )
    ids = [event.as_dict("cam", str(event.time), {})["id"] for event in events]
    assert len(set(ids)) == len(ids)


def test_events_are_json_with_what_applies() -> None:
    _, events = watched([{7: (100, 80)}, {7: (100, 120)}])
    known = [
        json.loads(json.dumps(e.as_dict("gate", "2026-01-02T03:04:05.000Z", {0: "person"})))
        for e in events
    ]
    assert known[0] == {
        "id": "gate-2026-01-02T03:04:05.000Z-appear-7-0", "time": "2026-01-02T03:04:05.000Z",
        "source": "gate", "kind": "appear", "frame": 1, "identity": 7, "class": "person",
        "x": 100.0, "y": 80.0,
    }  # fmt: skip
    assert {e["kind"]: e.get("direction") for e in known[1:]} == {"cross": "in", "enter": None}
    group = Event.of_group(GroupEvent(5, 0.5, "merge", 3, 4), 2).as_dict("gate", "t", {})
    assert group == {
        "id": "gate-t-group-3-2", "time": "t", "source": "gate", "kind": "group", "frame": 5,
        "identity": 3,
        "place": "merge", "other": 4,
    }  # fmt: skip


def test_settings_may_change_while_people_are_there() -> None:
    state, _ = watched([{1: (100, 150)}])
    more = Watch((ROOM, Place("new", ROOM.points[::-1], closed=True)), dwell=2.0)
    carried = more.carried(state, WATCH)
    assert carried.counts[0].entered == 1
    state, events = more.advance(carried, rows(2, {1: (100, 150)}), 2, 0.2)
    assert [(e.kind, e.place) for e in events] == [("enter", "new")]
    state, events = more.advance(state, rows(3, {1: (100, 40)}), 3, 0.3)
    assert [e.kind for e in events] == ["exit", "exit"]
    assert events[0].seconds == pytest.approx(0.2)
