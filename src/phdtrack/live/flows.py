"""Sums of the events at lines and zones: ways from zone to zone, passages in each minute, and how
long visits took.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from statistics import median
from typing import NamedTuple

from phdtrack.files import csv_text
from phdtrack.live.events import Event, Watch
from phdtrack.live.zones import Place


class Flow(NamedTuple):
    """The objects that went from one zone to another.

    Attributes
    ----------
    start, end : names of the zones; the same one for returns.
    objects : how often an object did.
    seconds : median from leaving the one to entering the other; 0 where zones overlap.
    """

    start: str
    end: str
    objects: int
    seconds: float


class Passages(NamedTuple):
    """The passages of a stretch of time at a place.

    Attributes
    ----------
    start : seconds at which the stretch begins.
    place : name of the line or zone.
    entered, left : crossings in and out, or visits that began and ended.
    """

    start: float
    place: str
    entered: int
    left: int


def flows(watch: Watch, events: Iterable[Event]) -> list[Flow]:
    """The ways between zones, in the order of the zones: after a zone an object goes to the one
    that it enters next.

    Parameters
    ----------
    watch : the places.
    events : from `place_events`, in order.
    """
    zones = [place.name for place in watch.places if place.closed]
    last = dict[int, str]()
    left = dict[tuple[int, str], float]()
    ways = defaultdict[tuple[str, str], list[float]](list)
    for event in events:
        if event.kind == "exit":
            left[event.identity, event.place] = event.time
        elif event.kind == "enter":
            before = last.get(event.identity)
            if before is not None:
                ended = left.get((event.identity, before), event.time)
                ways[before, event.place].append(max(0.0, event.time - ended))
            last[event.identity] = event.place
            left.pop((event.identity, event.place), None)
    return [
        Flow(start, end, len(ways[start, end]), median(ways[start, end]))
        for start in zones
        for end in zones
        if (start, end) in ways
    ]


def passages(
    watch: Watch, events: Sequence[Event], begin: float, end: float, width: float
) -> list[Passages]:
    """The passages at each place in each stretch of ``width`` seconds, by time.

    Parameters
    ----------
    watch : the places.
    events : from `place_events`.
    begin, end : of the sequence, seconds.
    width : seconds of a stretch.
    """
    count = 1 + max(0, math.ceil((end - begin) / width - 1e-9) - 1)
    found = dict[tuple[int, str], list[int]]()
    for event in events:
        direction = {"enter": "in", "exit": "out"}.get(event.kind, event.direction)
        if direction:
            # A visit may end when the sequence does.
            row = min(max(0, math.floor((event.time - begin) / width)), count - 1)
            found.setdefault((row, event.place), [0, 0])[direction == "out"] += 1
    return [
        Passages(begin + row * width, place.name, *found.get((row, place.name), (0, 0)))
        for row in range(count)
        for place in watch.places
    ]


def stays(place: Place, events: Iterable[Event]) -> list[float]:
    """The seconds of each visit of a zone that ended.

    Parameters
    ----------
    place : the zone.
    events : from `place_events`.
    """
    return [one.seconds for one in events if one.kind == "exit" and one.place == place.name]


def flows_csv(found: Sequence[Flow]) -> str:
    """The flows as CSV, with seconds of two decimals.

    Parameters
    ----------
    found : the flows.
    """
    rows = [(one.start, one.end, one.objects, f"{one.seconds:.2f}") for one in found]
    return csv_text([("from", "to", "objects", "seconds"), *rows])


def passages_csv(found: Sequence[Passages]) -> str:
    """The passages as CSV; ``start`` in seconds.

    Parameters
    ----------
    found : the passages.
    """
    rows = [(f"{one.start:.3f}", one.place, one.entered, one.left) for one in found]
    return csv_text([("start", "place", "in", "out"), *rows])
