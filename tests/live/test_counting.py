"""Counting among whole tracks: nobody twice for flicker, zones are left when somebody was last
seen, figures add up.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack.live.events import Event, Watch, place_events, tallies
from phdtrack.live.flows import flows, flows_csv, passages, passages_csv, stays
from phdtrack.live.zones import Place
from phdtrack.types import Tracks

DOOR = Place("door", ((0.0, 100.0), (200.0, 100.0)), closed=False)
ROOM = Place("room", ((0.0, 100.0), (200.0, 100.0), (200.0, 300.0), (0.0, 300.0)), closed=True)
WATCH = Watch((DOOR, ROOM))
FPS = 10.0


def walk(identity: int, feet: dict[int, float], label: int = 0) -> Tracks:
    """A person of 50 pixels, whose feet are at this height in each frame."""
    boxes = np.array([[90.0, y - 50, 110, y] for y in feet.values()]).reshape(-1, 4)
    rows = Tracks.of(np.array([*feet], np.int64), identity, boxes, 1.0, 0)
    return rows.with_class(np.full(len(feet), label))


def test_in_and_out_by_class_visits_and_occupancy() -> None:
    first = walk(1, {k: 50 + 10 * k for k in range(1, 11)}, label=2)
    second = walk(2, {k: 190 - 10 * k for k in range(5, 15)}, label=3)
    watch = Watch((DOOR, ROOM), names={2: "person", 3: "car"})
    events = place_events(watch, Tracks.concatenate([first, second]), 20, FPS)
    assert [(e.kind, e.identity, e.number) for e in events if e.place == "room"] == [
        *(("enter", 1, 5), ("enter", 2, 5), ("exit", 2, 10), ("exit", 1, 10))
    ]
    assert [e.occupancy for e in events if e.place == "room"] == [1, 2, 1, 0]
    found = {(one.place, one.label): one for one in tallies(watch, events, 0.0, 2.0)}
    assert (found["door", "all"].entered, found["door", "all"].left) == (1, 1)
    assert (found["door", "person"].entered, found["door", "car"].left) == (1, 1)
    assert (found["door", "person"].left, found["door", "car"].entered) == (0, 0)
    assert math.isnan(found["door", "all"].most)
    room = found["room", "all"]
    assert (room.entered, room.left, room.inside, room.most) == (2, 2, 0, 2)
    assert (room.stay, room.longest, room.mean) == pytest.approx((0.5, 0.5, 0.5))


@settings(deadline=None, max_examples=40)
@given(st.lists(st.booleans(), min_size=60, max_size=60), st.integers(0, 2**32 - 1))
def test_flicker_counts_nobody_twice(seen: list[bool], seed: int) -> None:
    """Rows that come and go, and a foot that trembles by a twentieth of the height: one crossing,
    one visit.
    """
    tremble = np.random.default_rng(seed).uniform(-2.4, 2.4, 60)
    feet = {k: 60 + 1.5 * k + tremble[k] for k in range(60) if k in (0, 59) or seen[k]}
    # No gap is as long as after which a track has left.
    feet |= {k: 60 + 1.5 * k for k in range(1, 60, 20)}
    rows = Tracks.concatenate([walk(1, {k + 1: feet[k] for k in sorted(feet)})])
    line, zone = tallies(WATCH, place_events(WATCH, rows, 60, FPS), 0.0, 6.0)
    assert (line.entered, line.left) == (1, 0)
    assert (zone.entered, zone.left, zone.most) == (1, 0, 1)


def test_a_vanished_visitor_leaves_the_zone_when_last_seen() -> None:
    rows = Tracks.concatenate(
        [walk(1, dict.fromkeys(range(1, 31), 150.0)), walk(2, dict.fromkeys(range(21, 101), 150.0))]
    )
    events = place_events(WATCH, rows, 100, FPS)
    assert [(e.kind, e.identity, e.number) for e in events] == [
        ("enter", 1, 1),
        ("enter", 2, 21),
        ("exit", 1, 30),
    ]
    zone = tallies(WATCH, events, 0.0, 9.9)[1]
    assert (zone.entered, zone.left, zone.inside, zone.most) == (2, 1, 1, 2)
    assert zone.longest == pytest.approx(7.9)
    # Shortly before the end, too.
    assert [e.number for e in place_events(WATCH, walk(1, {98: 150.0, 99: 150.0}), 100, FPS)] == [
        98,
        99,
    ]


def test_a_return_after_leaving_begins_another_visit() -> None:
    rows = walk(1, {1: 150.0, 2: 150.0, 5_000_000: 150.0})
    events = place_events(WATCH, rows, 5_000_001, FPS)
    assert [(e.kind, e.number) for e in events] == [
        *(("enter", 1), ("exit", 2), ("enter", 5_000_000), ("exit", 5_000_000))
    ]


def test_no_tracks() -> None:
    assert place_events(WATCH, Tracks.empty(), 0, FPS) == []
    assert [one.entered for one in tallies(WATCH, [], 0.0, 0.0)] == [0, 0]


LEFT = Place("left", ((0.0, 0.0), (50.0, 0.0), (50.0, 200.0), (0.0, 200.0)), closed=True)
RIGHT = Place("right", ((150.0, 0.0), (200.0, 0.0), (200.0, 200.0), (150.0, 200.0)), closed=True)
FAR = Place("far", ((900.0, 0.0), (950.0, 0.0), (950.0, 200.0), (900.0, 200.0)), closed=True)
ZONES = Watch((LEFT, RIGHT, FAR), leave_after=3.0)


def across(identity: int, x: dict[int, float]) -> Tracks:
    """A person whose feet are at this place of a row in each frame."""
    boxes = np.array([[at - 10, 100, at + 10, 150] for at in x.values()]).reshape(-1, 4)
    return Tracks.of(np.array([*x], np.int64), identity, boxes, 1.0, 0)


def there_and_back() -> list[Event]:
    """The events of two that go from the left to the right zone, one of which comes back."""
    one = across(1, {k: 25.0 + 5 * (k - 1) for k in range(1, 31)})
    back = across(
        2, {k: 25.0 + 5 * (k - 1) if k < 31 else 175.0 - 5 * (k - 31) for k in range(1, 62)}
    )
    return place_events(ZONES, Tracks.concatenate([one, back]), 80, FPS)


def test_flows_are_the_ways_from_zone_to_zone() -> None:
    found = flows(ZONES, there_and_back())
    assert [(one.start, one.end, one.objects) for one in found] == [
        ("left", "right", 2),
        ("right", "left", 1),
    ]
    # From where the foot is clear of one zone, by a tenth of a box, to the border of the other.
    assert found[0].seconds == pytest.approx((150 - 55) / 5 / FPS, abs=0.11)
    lines = flows_csv(found).splitlines()
    assert lines[0] == "from,to,objects,seconds"
    assert lines[1].startswith("left,right,2,")
    assert flows(WATCH, place_events(WATCH, across(1, {1: 20.0, 2: 30.0}), 10, FPS)) == []


def test_a_return_to_the_same_zone_is_a_way_too() -> None:
    x = {k: 25.0 + 5 * (k - 1) for k in range(1, 11)}
    x |= {k: 70.0 - 5 * (k - 11) for k in range(11, 21)}
    found = flows(ZONES, place_events(ZONES, across(1, x), 40, FPS))
    assert [(one.start, one.end, one.objects) for one in found] == [("left", "left", 1)]


def test_passages_of_each_minute_add_up() -> None:
    events = there_and_back()
    rows = passages(ZONES, events, 0.0, 8.0, 2.0)
    assert len(rows) == 3 * 4
    assert [row.start for row in rows if row.place == "left"] == [0.0, 2.0, 4.0, 6.0]
    for one in tallies(ZONES, events, 0.0, 8.0):
        mine = [row for row in rows if row.place == one.place]
        assert (sum(r.entered for r in mine), sum(r.left for r in mine)) == (one.entered, one.left)
    assert [row.entered for row in rows if row.place == "left"] == [2, 0, 1, 0]
    lines = passages_csv(rows).splitlines()
    assert lines[:2] == ["start,place,in,out", "0.000,left,2,2"]
    assert passages(ZONES, (), 0.0, 0.0, 60.0)[0].entered == 0


def test_stays_are_of_visits_that_ended() -> None:
    events = there_and_back()
    assert stays(FAR, events) == []
    found = stays(LEFT, events)
    assert len(found) == 3
    assert np.mean(found) == pytest.approx(tallies(ZONES, events, 0.0, 8.0)[0].stay)
