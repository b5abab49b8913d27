"""Lines and zones in the picture: crossings of a move, and points inside.

A file of places is TOML, in pixels of the video:

    [[line]]
    name = "door"
    points = [[100, 400], [300, 400]]

    [[zone]]
    name = "shop window"
    points = [[400, 300], [600, 300], [600, 450], [400, 450]]
    anchor = "centre"
    classes = ["person"]

``anchor`` is the part of a box that counts: the middle of its lower edge (``feet``, the default) or
its ``centre``.
"""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any, Literal

from phdtrack.errors import InputError, did_you_mean
from phdtrack.files import AnyPath, read_toml, write_text

Point = tuple[float, float]
Anchor = Literal["feet", "centre"]
ANCHORS: tuple[Anchor, ...] = ("feet", "centre")
# Pixels below which two points are the same: the square of a smaller distance may be 0.
_SAME = 1e-3
# Coordinates as they are written: of a line, and of a zone.
_EXAMPLES = ("x1,y1,x2,y2", "x1,y1,x2,y2,x3,y3")
_TABLE_EXAMPLES = {
    "line": "points = [[x1, y1], [x2, y2]]",
    "zone": "points = [[x1, y1], [x2, y2], [x3, y3]]",
}
# Points in shares of the frame's size do not exceed this number.
_MAX_SHARE = 1.5


@dataclass(frozen=True, slots=True)
class Place:
    """A line or a zone. Raises `InputError` for too few points, points that are not finite, and a
    zone whose border crosses itself.

    Attributes
    ----------
    name : unique among all places.
    points : corners in pixels; at least two along a line, at least three around a zone.
    closed : True for a zone.
    anchor : the part of a box that counts.
    classes : names of the classes that count; empty for all.
    """

    name: str
    points: tuple[Point, ...]
    closed: bool
    anchor: Anchor = "feet"
    classes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        kind, least = ("zone", 3) if self.closed else ("line", 2)
        where = f"{kind} {self.name!r}"
        if not all(math.isfinite(x) and math.isfinite(y) for x, y in self.points):
            raise InputError("expected points of finite numbers", where=where)
        if len(self.points) < least:
            raise InputError(
                f"expected at least {least} points, got {len(self.points)}",
                where=where,
                cure=f"Name the pixels of each, as {self.name}={_EXAMPLES[int(self.closed)]}.",
            )
        if any(math.dist(a, b) < _SAME for a, b in self.edges):
            raise InputError(
                "two points that follow each other are the same", where=where, cure="Leave one out."
            )
        if self.closed and _self_crossing(self.edges):
            raise InputError(
                "the border crosses itself",
                where=where,
                cure="Name the corners in their order around it.",
            )

    @property
    def edges(self) -> list[tuple[Point, Point]]:
        """Its edges; the last edge of a zone leads back to the first corner."""
        return list(pairwise((*self.points, self.points[0]) if self.closed else self.points))

    def distance(self, point: Point) -> float:
        """Pixels from a point to the line, or to the border of the zone; negative outside of a
        zone.

        A point on the border has distance 0.
        """
        nearest = min(_distance(point, a, b) for a, b in self.edges)
        if not self.closed or self._holds(point):
            return nearest
        return -nearest

    def crossings(self, start: Point, end: Point) -> int:
        """How often the straight move crosses the line from its left to its right, minus how often
        the other way.

        Left and right are as seen in the picture, looking from the line's beginning to its end.
        """
        return sum(_crossing(a, b, start, end) for a, b in self.edges)

    def outside(self, width: float, height: float) -> bool:
        """True if it lies wholly outside of a frame of this size in pixels."""
        xs = [x for x, _ in self.points]
        ys = [y for _, y in self.points]
        return max(xs) < 0 or max(ys) < 0 or min(xs) > width or min(ys) > height

    def _holds(self, point: Point) -> bool:
        """True if the point is inside, by the even–odd rule."""
        x, y = point
        inside = False
        for (ax, ay), (bx, by) in self.edges:
            if (ay > y) != (by > y) and x < ax + (y - ay) * (bx - ax) / (by - ay):
                inside = not inside
        return inside


def refuse_shares(places: Sequence[Place]) -> None:
    """Raise `InputError` if the points of a place seem to be shares of the frame's size.

    Parameters
    ----------
    places : lines and zones.
    """
    for place in places:
        largest = max(max(point) for point in place.points)
        least = min(min(point) for point in place.points)
        if least >= 0 and largest <= _MAX_SHARE:
            kind = "zone" if place.closed else "line"
            raise InputError(
                f"no coordinate exceeds {largest:.3g}: points must be in pixels of the video, not"
                " in shares of its size",
                where=f"{kind} {place.name!r}",
                cure="Multiply them by the frame's width and height.",
            )


def place_doubts(
    places: Sequence[Place],
    names: Collection[str],
    size: tuple[int, int] = (0, 0),
    those_have: str = "the detector has",
) -> Iterator[str]:
    """Sentences about places that count nothing.

    Parameters
    ----------
    places : lines and zones.
    names : of the classes that there are; empty if none has a name.
    size : width and height of the frame in pixels; 0 if they are not known.
    those_have : who has these classes, for the sentences.
    """
    for place in places:
        kind = "zone" if place.closed else "line"
        # The class of a detector without names may be asked for by its number.
        known = names or [one for one in place.classes if one.isdecimal()]
        if place.classes and not set(known) & set(place.classes):
            wanted = ", ".join(place.classes)
            if names:
                absent = "no such class"
                cure = did_you_mean(wanted, names)
            else:
                absent = "no class names"
                cure = "Leave classes out, or take a detector with classes."
            yield (
                f"{kind} {place.name!r} counts nothing: it asks for {wanted}, and {those_have}"
                f" {absent}. {cure}"
            )
        if size[0] and place.outside(*size):
            yield (
                f"{kind} {place.name!r} counts nothing: it lies outside of the picture of"
                f" {size[0]}x{size[1]} pixels. Draw it anew, or correct its points."
            )


def read_places(path: AnyPath) -> tuple[Place, ...]:
    """The lines and zones of a TOML file. Raises `InputError` if it is none, or a place cannot be
    used.
    """
    places = places_of(read_toml(Path(path)), str(path))
    refuse_shares(places)
    return places


def write_places(path: Path, places: Sequence[Place]) -> None:
    """Write the file of these places, whole or not at all. Raises `InputError` if that cannot be
    done.
    """
    tables = [
        f"[[{'zone' if one.closed else 'line'}]]\nname = {_text(one.name)}\npoints ="
        f" {json.dumps([list(point) for point in one.points])}\nanchor ="
        f" {_text(one.anchor)}\nclasses = [{', '.join(map(_text, one.classes))}]\n"
        for one in places
    ]
    text = "\n".join(tables)
    ordered = sorted(places, key=lambda place: place.closed)
    try:
        same = places_of(tomllib.loads(text.encode().decode()), str(path)) == tuple(ordered)
    except ValueError:
        same = False
    if not same:
        raise InputError("a name holds a character that a file of places cannot", where=path)
    write_text(path, text)


def _text(value: str) -> str:
    """A string as TOML has it."""
    return json.dumps(value, ensure_ascii=False)


def places_of(tables: dict[str, Any], where: str) -> tuple[Place, ...]:
    """The lines, then the zones, of the tables ``line`` and ``zone``; ``where`` names the file.
    Raises `InputError`.
    """
    for name in tables:
        if name not in ("line", "zone"):
            raise InputError(
                f"there is no table {name!r}",
                where=where,
                cure=did_you_mean(name, ("line", "zone")),
            )
    found = list[Place]()
    for kind in ("line", "zone"):
        given = tables.get(kind, [])
        if not isinstance(given, list):
            raise InputError(
                f"expected [[{kind}]], got one [{kind}]", where=where, cure="Write two brackets."
            )
        found += [_place(kind, k, table, where) for k, table in enumerate(given, 1)]
    for first, second in combinations(found, 2):
        if first.name == second.name:
            raise InputError(
                f"two places are called {first.name!r}",
                where=where,
                cure="Give each a name of its own.",
            )
    return tuple(found)


def _place(kind: str, number: int, table: Any, where: str) -> Place:
    """The place of a table."""
    at = f"{where}, [[{kind}]] number {number}"
    known = ("name", "points", "anchor", "classes")
    if not isinstance(table, dict):
        raise InputError("expected a table", where=at)
    for key in table:
        if key not in known:
            raise InputError(f"there is no {key!r}", where=at, cure=did_you_mean(key, known))
    name = table.get("name", f"{kind} {number}")
    anchor = table.get("anchor", "feet")
    classes = table.get("classes", [])
    if not isinstance(name, str) or not name:
        raise InputError(f"expected a name in quotes, got {name!r}", where=at)
    if anchor not in ANCHORS:
        raise InputError(f"expected anchor feet or centre, got {anchor!r}", where=at)
    if not isinstance(classes, list) or not all(isinstance(one, str) for one in classes):
        raise InputError(f"expected classes as a list of names, got {classes!r}", where=at)
    points = table.get("points")
    pairs = isinstance(points, list) and all(
        isinstance(p, list) and len(p) == 2 and all(map(_number, p)) for p in points
    )
    if not isinstance(points, list) or not pairs:
        raise InputError("expected points = [[x, y], [x, y], …] in pixels", where=at)
    least = 3 if kind == "zone" else 2
    if len(points) < least:
        problem = f"expected at least {least} points, got {len(points)}"
        raise InputError(problem, where=at, cure=f"Write {_TABLE_EXAMPLES[kind]}.")
    try:
        return Place(
            name,
            tuple((float(x), float(y)) for x, y in points),
            kind == "zone",
            anchor,
            tuple(classes),
        )
    except InputError as error:
        raise InputError(error.problem, where=at, cure=error.cure) from None


def _number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _right(a: Point, b: Point, point: Point, shift: int = 1) -> bool:
    """True if the point is to the right of the way from a to b; y points down.

    A point on the line counts as shifted by (ε, ε²), or by its opposite with ``shift`` −1, for an
    arbitrarily small ε.
    """
    dx = b[0] - a[0]
    dy = b[1] - a[1]
    side = dx * (point[1] - a[1]) - dy * (point[0] - a[0])
    if side:
        return side > 0
    return shift * (-dy or dx) > 0


def _crossing(a: Point, b: Point, start: Point, end: Point) -> int:
    """1 if the move crosses the edge from a to b from left to right, −1 the other way, 0 if it does
    not.

    Moves count as shifted by an arbitrarily small amount, so that none ends on a line or goes
    through a corner: a crossing counts once, and a move and its reverse cancel.
    """
    before = _right(a, b, start)
    after = _right(a, b, end)
    if before == after or _right(start, end, a, -1) == _right(start, end, b, -1):
        return 0
    return 1 if after else -1


def _distance(point: Point, a: Point, b: Point) -> float:
    """Distance from a point to the edge from a to b."""
    dx = b[0] - a[0]
    dy = b[1] - a[1]
    along = ((point[0] - a[0]) * dx + (point[1] - a[1]) * dy) / (dx * dx + dy * dy)
    along = min(1.0, max(0.0, along))
    return math.hypot(point[0] - a[0] - along * dx, point[1] - a[1] - along * dy)


def _self_crossing(edges: Sequence[tuple[Point, Point]]) -> bool:
    """True if two edges of a closed border that are not neighbours cross or touch."""
    last = len(edges) - 1
    for (i, (a, b)), (j, (c, d)) in combinations(enumerate(edges), 2):
        if j - i in (1, last):
            continue
        if (
            _crossing(a, b, c, d)
            or min(_distance(c, a, b), _distance(d, a, b), _distance(a, c, d), _distance(b, c, d))
            == 0
        ):
            return True
    return False
