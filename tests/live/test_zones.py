"""Lines and zones: geometry against OpenCV and a plain definition, and what a file may say."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phdtrack.errors import InputError
from phdtrack.live.zones import Place, Point, places_of, read_places

DOOR = Place("door", ((100.0, 400.0), (300.0, 400.0)), closed=False)
WINDOW = Place(
    "window", ((400.0, 300.0), (600.0, 300.0), (600.0, 450.0), (400.0, 450.0)), closed=True
)
# A zigzag, a corner of which lies on whole numbers.
BENT = Place("bent", ((0.0, 0.0), (10.0, 10.0), (20.0, 0.0), (30.0, 10.0)), closed=False)
whole = st.integers(-5, 35).map(float)
point = st.tuples(whole, whole)


def star(radii: list[int]) -> Place:
    """A polygon around (50, 50) whose corners are as far as ``radii``: never self-crossing."""
    angles = np.linspace(0, 2 * np.pi, len(radii), endpoint=False).tolist()
    corners = [
        (50 + r * math.cos(a), 50 + r * math.sin(a)) for r, a in zip(radii, angles, strict=True)
    ]
    return Place("star", tuple(corners), closed=True)


@given(st.lists(st.integers(5, 45), min_size=3, max_size=9), st.floats(0, 100), st.floats(0, 100))
def test_the_distance_to_a_zone_is_opencvs(radii: list[int], x: float, y: float) -> None:
    zone = star(radii)
    outline = np.array(zone.points, np.float32)[:, None]
    expected = cv2.pointPolygonTest(outline, (x, y), True)
    assert zone.distance((x, y)) == pytest.approx(expected, abs=2e-3)


@given(st.lists(point, min_size=2, max_size=12))
def test_crossings_add_up_to_the_side_that_was_reached(way: list[Point]) -> None:
    """Around an endless line the crossings less those back are where the last point lies less where
    the first did.
    """
    line = Place("wall", ((-1000.0, 3.0), (1000.0, 3.0)), closed=False)
    total = sum(line.crossings(a, b) for a, b in pairwise(way))
    # On the wall counts as behind it.
    assert total == int(way[-1][1] >= 3) - int(way[0][1] >= 3)


@given(st.lists(point, min_size=3, max_size=12))
def test_a_way_that_closes_around_no_end_crosses_as_often_back(way: list[Point]) -> None:
    """The pieces of a bent line share corners, which count once: a zigzag from border to border has
    two sides, too.
    """
    long = Place("long", ((-1000.0, 0.0), *BENT.points, (1000.0, 10.0)), closed=False)
    assert sum(long.crossings(a, b) for a, b in zip(way, [*way[1:], way[0]], strict=True)) == 0


def test_left_and_right_are_those_of_the_picture() -> None:
    """Who looks along the door from (100, 400) to (300, 400), has what is below in the picture on
    the right.
    """
    assert DOOR.crossings((200, 390), (200, 410)) == 1
    assert DOOR.crossings((200, 410), (200, 390)) == -1
    assert DOOR.crossings((310, 390), (310, 410)) == 0
    assert DOOR.crossings((200, 390), (220, 395)) == 0


def test_points_on_the_border_are_inside() -> None:
    assert WINDOW.distance((400, 350)) == 0
    assert WINDOW.distance((410, 350)) == 10
    assert WINDOW.distance((390, 350)) == -10


def test_a_file_is_read(tmp_path: Path) -> None:
    file = tmp_path / "places.toml"
    file.write_text(
        '[[zone]]\nname = "window"\npoints = [[400, 300], [600, 300], [600, 450], [400, 450]]\n'
        'anchor = "centre"\nclasses = ["car"]\n'
        "[[line]]\npoints = [[100, 400], [300, 400]]\n"
    )
    line, zone = read_places(file)
    assert line == Place("line 1", DOOR.points, closed=False)
    assert zone == Place("window", WINDOW.points, True, "centre", ("car",))


SQUARE = [[0, 0], [10, 0], [10, 10], [0, 10]]


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"lines": []}, "Did you mean line"),
        ({"line": {"points": SQUARE}}, r"expected \[\[line\]\]"),
        ({"zone": [{"points": SQUARE, "color": 1}]}, r"\[\[zone\]\] number 1: there is no 'color'"),
        ({"zone": [{"points": SQUARE[:2]}]}, "at least 3 points, got 2"),
        ({"zone": [{"points": [[0, 0], [10, 10], [10, 0], [0, 10]]}]}, "crosses itself"),
        ({"zone": [{"points": [*SQUARE, [5, 0]]}]}, "crosses itself"),
        ({"line": [{"points": [[0, 400], [5e-324, 400]]}]}, "are the same"),
        ({"zone": [{"points": [[5e-324, 0], [0, 0], [10, 10]]}]}, "are the same"),
        ({"line": [{"points": [[0, 0], [0, 0]]}]}, "the same"),
        ({"line": [{"points": [[0, 0], [float("nan"), 1]]}]}, "finite"),
        ({"line": [{"points": [[0, 0], [1, True]]}]}, "in pixels"),
        ({"line": [{"points": "0,0,1,1"}]}, "in pixels"),
        ({"line": [{"points": SQUARE, "anchor": "head"}]}, "feet or centre"),
        ({"line": [{"points": SQUARE, "classes": "car"}]}, "list of names"),
        (
            {"line": [{"points": SQUARE, "name": "a"}], "zone": [{"points": SQUARE, "name": "a"}]},
            "two places are",
        ),
    ],
)
def test_what_cannot_be_used_is_said(tables: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words) as raised:
        places_of(tables, "places.toml")
    assert "places.toml" in raised.value.where
