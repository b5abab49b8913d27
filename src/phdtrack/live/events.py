"""Events of online tracks: a track appears or leaves, crosses a line, enters or leaves a zone.

`Watch.advance` is a pure function of the state and a frame's online rows. Only confirmed rows
count. Between two sightings a track's anchor is assumed to move straight: a track that is lost
before a line and found behind it has crossed it.

Hysteresis, a share of the box's height, makes a jittering track count once: it crosses a line when
its anchor is that far on the other side, and leaves a zone when it is that far outside.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple

import numpy as np

from phdtrack.clock import Clock, as_clock
from phdtrack.errors import Checked, NonNegative, Positive
from phdtrack.groups.life_cycle import Event as GroupEvent
from phdtrack.live.zones import Place, Point
from phdtrack.types import F8, Tracks

# Cells of a map across, and the half-life of their counts in seconds.
CELLS = 64
HALF_LIFE = 3600.0
Kind = Literal["appear", "leave", "cross", "enter", "exit", "dwell", "group"]


@dataclass(frozen=True, slots=True)
class Event:
    """An event.

    Attributes
    ----------
    kind : ``appear``, ``leave``; ``cross`` of a line; ``enter``, ``exit``, ``dwell`` of a zone;
        ``group``.
    number, time, index : the frame in which it became certain, its seconds, and the number of the
        event in that frame, from 0.
    identity, class_id : of the track; of a group its identity and 0.
    place : name of the line or zone, or the kind of group event.
    direction : of a crossing: ``in`` from the line's left to its right, ``out`` back.
    x, y : the anchor in pixels, where the track was last seen.
    seconds : that the track was seen (leave) or was in the zone (exit, dwell).
    occupancy : of the zone, after it.
    other : the group that a group merged into, or was split from.
    """

    kind: Kind
    number: int
    time: float
    index: int = 0
    identity: int = 0
    class_id: int = 0
    place: str = ""
    direction: str = ""
    x: float = math.nan
    y: float = math.nan
    seconds: float = math.nan
    occupancy: int = -1
    other: int = 0

    @classmethod
    def of_group(cls, event: GroupEvent, index: int = 0) -> Event:
        """The event of a group, as `groups` reports it."""
        return cls(
            "group",
            event.frame,
            event.time,
            index,
            event.group,
            place=event.kind,
            other=event.other,
        )

    def as_dict(self, source: str, wall: str, names: Mapping[int, str]) -> dict[str, object]:
        """The event for JSON, without fields that do not apply.

        Parameters
        ----------
        source : name of the camera.
        wall : ISO time of the frame; ``id`` contains it, since frames and identities may begin anew
            after a restart.
        names : of the classes.
        """
        found: dict[str, object] = {
            "id": f"{source}-{wall}-{self.kind}-{self.identity}-{self.index}",
            "time": wall,
            "source": source,
            "kind": self.kind,
            "frame": self.number,
            "identity": self.identity,
            "class": names.get(self.class_id, self.class_id) if self.class_id or names else None,
            "place": self.place or None,
            "direction": self.direction or None,
            "x": _rounded(self.x),
            "y": _rounded(self.y),
            "seconds": _rounded(self.seconds),
            "occupancy": self.occupancy if self.occupancy >= 0 else None,
            "other": self.other or None,
        }
        return {key: value for key, value in found.items() if value is not None}


@dataclass(frozen=True, slots=True)
class Count:
    """Crossings of a line each way; or entries and exits of a zone, and the seconds of all ended
    visits.
    """

    entered: int = 0
    left: int = 0
    seconds: float = 0.0

    @property
    def occupancy(self) -> int:
        """Number of tracks in the zone."""
        return self.entered - self.left


@dataclass(frozen=True, slots=True)
class Visitor:
    """A track that has not left.

    Attributes
    ----------
    identity : of the track.
    first, last : seconds at which it was first and last seen.
    class_id : its class when last seen.
    feet, centre : its anchors then.
    net : for each place its crossings of the line since it was last clear of it: those from left
        to right minus the others.
    since : for each place the time at which it entered the zone; NaN outside, and for lines.
    dwelled : for each place, True if ``dwell`` was reported for this visit.
    """

    identity: int
    first: float
    last: float
    class_id: int
    feet: Point
    centre: Point
    net: tuple[int, ...]
    since: tuple[float, ...]
    dwelled: tuple[bool, ...]

    def anchor(self, place: Place) -> Point:
        """The anchor that counts for a place."""
        if place.anchor == "feet":
            return self.feet
        return self.centre


@dataclass(frozen=True, slots=True)
class WatchState:
    """The visitors by identity, and the counts of each place."""

    visitors: dict[int, Visitor] = field(default_factory=dict)
    counts: tuple[Count, ...] = ()


@dataclass(frozen=True, slots=True)
class Watch(Checked):
    """Places to watch, and their settings.

    Parameters
    ----------
    places : lines and zones.
    names : of the classes that places ask for.
    hysteresis : distance behind a border at which an anchor has crossed it, as a share of the
        box's height.
    dwell : seconds in a zone before ``dwell`` is reported.
    leave_after : seconds without a sighting after which a track has left; if it comes back, it
        appears anew.
    """

    places: tuple[Place, ...] = ()
    names: Mapping[int, str] = field(default_factory=dict)
    hysteresis: NonNegative = 0.1
    dwell: Positive = 60.0
    leave_after: Positive = 3.0

    def start(self) -> WatchState:
        """The state without visitors and counts."""
        return WatchState({}, tuple(Count() for _ in self.places))

    def carried(self, state: WatchState, before: Watch) -> WatchState:
        """The state of other settings, for these; equal places keep their counts."""
        at = {(place.name, place.points, place.closed): k for k, place in enumerate(before.places)}
        source = [at.get((place.name, place.points, place.closed), -1) for place in self.places]
        counts = tuple(state.counts[k] if k >= 0 else Count() for k in source)
        visitors = {
            name: replace(
                one,
                net=tuple(one.net[k] if k >= 0 else 0 for k in source),
                since=tuple(one.since[k] if k >= 0 else math.nan for k in source),
                dwelled=tuple(k >= 0 and one.dwelled[k] for k in source),
            )
            for name, one in state.visitors.items()
        }
        return WatchState(visitors, counts)

    def advance(
        self, state: WatchState, rows: Tracks, number: int, time: float
    ) -> tuple[WatchState, tuple[Event, ...]]:
        """The state after a frame, and its events by identity: first of tracks that are seen, then
        of tracks that have left. Call it for empty frames too.

        Parameters
        ----------
        state : after the frame before.
        rows : online rows of one frame.
        number, time : of the frame, from 1, and in seconds; both grow.
        """
        visitors = dict(state.visitors)
        frame = _Frame(number, time, list(state.counts))
        order = [k for k in rows.identity.argsort(kind="stable").tolist() if rows.confirmed[k]]
        for k in order:
            identity = int(rows.identity[k])
            label = int(rows.class_id[k])
            left, top, right, bottom = rows.xyxy[k].tolist()
            feet = ((left + right) / 2, bottom)
            centre = ((left + right) / 2, (top + bottom) / 2)
            before = visitors.get(identity)
            if before is None:
                outside = (
                    (0,) * len(self.places),
                    (math.nan,) * len(self.places),
                    (False,) * len(self.places),
                )
                before = Visitor(identity, time, time, label, feet, centre, *outside)
                frame.add("appear", before)
            now = replace(before, last=time, class_id=label, feet=feet, centre=centre)
            visitors[identity] = self._moved(frame, before, now, self.hysteresis * (bottom - top))
        for identity in sorted(visitors):
            if time - visitors[identity].last > self.leave_after:
                gone = visitors.pop(identity)
                # A track that has left has left all zones. Its visit ends when it was last seen.
                for k, place in enumerate(self.places):
                    if not math.isnan(gone.since[k]):
                        frame.exit(k, place, gone, gone.last - gone.since[k])
                frame.add("leave", gone, seconds=gone.last - gone.first)
        return WatchState(visitors, tuple(frame.counts)), tuple(frame.events)

    def _moved(self, frame: _Frame, before: Visitor, now: Visitor, margin: float) -> Visitor:
        """The visitor after a move, with its state for each place."""
        net = list(now.net)
        since = list(now.since)
        dwelled = list(now.dwelled)
        for k, place in enumerate(self.places):
            inside = not math.isnan(since[k])
            if (
                not inside
                and place.classes
                and self.names.get(now.class_id, str(now.class_id)) not in place.classes
            ):
                continue
            depth = place.distance(now.anchor(place))
            if not place.closed:
                net[k] += place.crossings(before.anchor(place), now.anchor(place))
                if depth >= margin:
                    if net[k]:
                        frame.cross(k, place, now, inward=net[k] > 0)
                    net[k] = 0
            elif not inside and depth >= 0:
                since[k] = now.last
                dwelled[k] = False
                frame.count(k, entered=1)
                frame.add("enter", now, place, occupancy=frame.counts[k].occupancy)
            elif inside and depth < 0 and -depth >= margin:
                frame.exit(k, place, now, now.last - since[k])
                since[k] = math.nan
            elif inside and not dwelled[k] and now.last - since[k] >= self.dwell:
                dwelled[k] = True
                frame.add(
                    "dwell",
                    now,
                    place,
                    seconds=now.last - since[k],
                    occupancy=frame.counts[k].occupancy,
                )
        return replace(now, net=tuple(net), since=tuple(since), dwelled=tuple(dwelled))


@dataclass(slots=True)
class _Frame:
    """The counts after a frame, and its events."""

    number: int
    time: float
    counts: list[Count]
    events: list[Event] = field(default_factory=list)

    def add(self, kind: Kind, visitor: Visitor, place: Place | None = None, **more: Any) -> None:
        """Add an event of a visitor, at a place."""
        x, y = visitor.feet if place is None else visitor.anchor(place)
        known = {"identity": visitor.identity, "class_id": visitor.class_id, "x": x, "y": y} | more
        name = "" if place is None else place.name
        self.events.append(
            Event(kind, self.number, self.time, len(self.events), place=name, **known)
        )

    def count(self, k: int, entered: int = 0, left: int = 0, seconds: float = 0.0) -> None:
        """Add to the counts of the place at ``k``."""
        count = self.counts[k]
        self.counts[k] = Count(count.entered + entered, count.left + left, count.seconds + seconds)

    def cross(self, k: int, place: Place, visitor: Visitor, *, inward: bool) -> None:
        """Count a crossing of a line, and add its event."""
        self.count(k, entered=int(inward), left=int(not inward))
        self.add("cross", visitor, place, direction="in" if inward else "out")

    def exit(self, k: int, place: Place, visitor: Visitor, stay: float) -> None:
        """Count an exit after so many seconds, and add its event."""
        self.count(k, left=1, seconds=stay)
        self.add("exit", visitor, place, seconds=stay, occupancy=self.counts[k].occupancy)


def place_events(watch: Watch, tracks: Tracks, last: int, fps: float | Clock) -> list[Event]:
    """The events at lines and zones (cross, enter, exit, dwell) of a sequence whose tracks are
    complete, in order.

    A track that vanishes in a zone leaves it when last seen; `Watch.advance` reports that later,
    when it is certain. A track in a zone in the last frame does not leave it.

    Parameters
    ----------
    watch : the places.
    tracks : sorted by frame.
    last : number of the last frame of the sequence.
    fps : frames per second, or the times of the frames.
    """
    clock = as_clock(fps)
    state = watch.start()
    since = dict[tuple[int, str], float]()
    found = list[Event]()
    for number in _walked(np.unique(tracks.frame).tolist(), last, watch.leave_after, clock):
        rows = tracks.select(np.arange(*np.searchsorted(tracks.frame, [number, number + 1])))
        state, events = watch.advance(state, rows, number, clock.time(number))
        for event in events:
            visit = event.identity, event.place
            if event.kind == "enter":
                since[visit] = event.time
            elif event.kind == "exit":
                time = since.pop(visit) + event.seconds
                event = replace(event, time=time, number=clock.frame_at(time))
            if event.place and (number <= last or event.number < last):
                found.append(event)
    inside = dict.fromkeys((place.name for place in watch.places if place.closed), 0)
    found.sort(key=lambda event: event.number)
    for k, event in enumerate(found):
        if event.place in inside:
            inside[event.place] += {"enter": 1, "exit": -1}.get(event.kind, 0)
            found[k] = replace(event, occupancy=inside[event.place])
    return [replace(event, index=k) for k, event in enumerate(found)]


def _walked(frames: Sequence[int], last: int, patience: float, clock: Clock) -> Iterator[int]:
    """The frames up to the last one, and the empty frames between and after them in which a track
    may leave, after ``patience`` seconds.
    """
    before = 0
    for number in (*(frame for frame in frames if frame < last), last):
        yield from range(before + 1, min(_left_by(before, patience, clock) + 1, number))
        yield number
        before = number
    yield from range(last + 1, _left_by(last, patience, clock) + 1)


def _left_by(number: int, patience: float, clock: Clock) -> int:
    """A frame more than ``patience`` seconds after frame ``number``."""
    return clock.frame_at(clock.time(number) + patience) + 2


class Tally(NamedTuple):
    """The counts at a place, of a class or of ``all``.

    Of a line: crossings in and out; the rest is NaN. Of a zone: visits that began and ended, the
    number of tracks ``inside`` at the end, the largest (``most``) and the ``mean`` number, and the
    average (``stay``) and ``longest`` seconds of a visit. An open visit lasts until the end of the
    sequence.
    """

    place: str
    label: str
    entered: int
    left: int
    inside: float = math.nan
    most: float = math.nan
    mean: float = math.nan
    stay: float = math.nan
    longest: float = math.nan


def tallies(watch: Watch, events: Sequence[Event], begin: float, end: float) -> list[Tally]:
    """The counts at each place, in order: of all classes, then of each class if classes have names.

    Parameters
    ----------
    watch : the places.
    events : from `place_events`.
    begin, end : of the sequence, seconds.
    """
    found = list[Tally]()
    for place in watch.places:
        mine = [event for event in events if event.place == place.name]
        labels = sorted({event.class_id for event in mine if watch.names})
        groups = {"all": mine} | {
            watch.names.get(k, str(k)): [e for e in mine if e.class_id == k] for k in labels
        }
        found += [_tally(place, label, group, begin, end) for label, group in groups.items()]
    return found


def _tally(place: Place, label: str, events: Sequence[Event], begin: float, end: float) -> Tally:
    """The counts of a class at a place."""
    since = dict[int, float]()
    stays = list[float]()
    most = 0
    entered = sum(event.kind == "enter" or event.direction == "in" for event in events)
    left = sum(event.kind == "exit" or event.direction == "out" for event in events)
    if not place.closed:
        return Tally(place.name, label, entered, left)
    for event in events:
        if event.kind == "enter":
            since[event.identity] = event.time
            most = max(most, len(since))
        elif event.kind == "exit":
            stays.append(event.time - since.pop(event.identity, event.time))
    stays += [end - start for start in since.values()]
    mean = math.nan
    if end > begin:
        mean = sum(stays) / (end - begin)
    average, longest = (sum(stays) / len(stays), max(stays)) if stays else (math.nan, math.nan)
    return Tally(place.name, label, entered, left, entered - left, most, mean, average, longest)


def _rounded(value: float) -> float | None:
    """Two decimals; None for NaN."""
    if math.isnan(value):
        return None
    return round(value, 2)


class Minute(NamedTuple):
    """The mean and the largest number of confirmed tracks in a minute's ``frames``; it begins at
    ``wall`` (UTC seconds).
    """

    wall: float
    mean: float
    most: int
    frames: int

    @staticmethod
    def add(minutes: deque[Minute], tracks: int, wall: float) -> None:
        """Add a frame to the last minute or a new one.

        Parameters
        ----------
        minutes : in order.
        tracks, wall : number of confirmed tracks in the frame, and its time (UTC seconds).
        """
        start = wall // 60 * 60
        if not minutes or minutes[-1].wall != start:
            minutes.append(Minute(start, 0.0, 0, 0))
        _, mean, most, frames = minutes[-1]
        minutes[-1] = Minute(
            start, mean + (tracks - mean) / (frames + 1), max(most, tracks), frames + 1
        )


@dataclass(slots=True)
class Maps:
    """Maps (h, w) of people and of false alarms over the picture; both fade with a half-life of an
    hour.
    """

    people: F8
    clutter: F8
    cell: float
    time: float = 0.0

    @classmethod
    def of(cls, width: int, height: int) -> Maps:
        """Empty maps of a picture."""
        cell = width / CELLS
        shape = (max(1, round(height / cell)), CELLS)
        return cls(np.zeros(shape), np.zeros(shape), cell)

    def add(self, time: float, feet: F8, xyxy: F8, probability: F8) -> None:
        """Add a frame.

        Parameters
        ----------
        time : of the frame, seconds.
        feet : (n, 2) of confirmed tracks, pixels.
        xyxy, probability : (m, 4) detections, and (m,) the probability that each is a false alarm.
        """
        fade = 0.5 ** ((time - self.time) / HALF_LIFE)
        self.time = time
        for grid, points, weight in (
            (self.people, feet, np.ones(len(feet))),
            (self.clutter, (xyxy[:, :2] + xyxy[:, 2:]) / 2, probability),
        ):
            grid *= fade
            at = np.floor(points[:, ::-1] / self.cell).astype(np.int64)
            inside = ((at >= 0) & (at < grid.shape)).all(axis=1)
            np.add.at(grid, tuple(at[inside].T), weight[inside])
