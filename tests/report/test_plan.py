"""The plan: what is where in the picture."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from phdtrack.groups.clusters import Groups
from phdtrack.groups.encounters import Encounter
from phdtrack.groups.group_stages import GroupFrame
from phdtrack.groups.life_cycle import Event
from phdtrack.report.drawing import Canvas, identity_colour
from phdtrack.report.ground_plan import Plan, PlanScene
from phdtrack.report.pages import render
from phdtrack.run.grouping import extent_of

PLAN = Plan((-9.0, 0.0, 9.0, 10.0), 200)
NOWHERE = np.zeros((2, 0))


def groups(
    *places: tuple[float, float], contours: tuple[np.ndarray, ...] = (), **more: Any
) -> GroupFrame:
    """Groups 1, 2, … of two people at these places, who stand; the first one has the contours."""
    n = len(places)
    none = np.zeros(0, np.int64)
    mean = np.vstack([np.array(places).reshape(-1, 2).T, np.zeros((2, n))])
    found = Groups(none, np.full(n, 2.0), np.full(n, 0.4), mean, np.zeros((n, 4, 4)))
    rings = (contours, *[()] * (n - 1))[:n]
    filled = {"events": (), "warnings": ()} | more
    return GroupFrame(3, 0.5, np.arange(1, n + 1), found, rings, none, none, **filled)


def scene(frame: GroupFrame, detections: np.ndarray = NOWHERE) -> PlanScene:
    return PlanScene(frame, detections, NOWHERE, np.zeros(0, np.int64))


def colour_at(image: np.ndarray, x: float, y: float) -> np.ndarray:
    u, v = PLAN.pixels(np.array([[x], [y]]))[:, 0].round().astype(int)
    return image[v, u].astype(int)


def test_metres_are_square_and_y_goes_up() -> None:
    assert PLAN.scale == pytest.approx(20)
    corners = PLAN.pixels(np.array([[-9.0, 9, 0], [0, 10, 5]]))
    assert corners == pytest.approx(np.array([[0.0, 360, 180], [200, 0, 100]]))
    wide = Plan((0.0, 0.0, 100.0, 1.0), 400)
    assert (wide.width, wide.scale) == (720, pytest.approx(7.2))
    assert wide.pixels(np.array([[50.0], [0.5]])) == pytest.approx(np.array([[360.0], [200.0]]))


def test_people_are_coloured_and_groups_outlined() -> None:
    """Two in a group are dots in their own colours with one line around both; one alone has no line
    around.
    """
    frame = groups((-4.0, 5.0), (6.0, 5.0))
    frame = replace(frame, member=np.array([3, 4, 9]), membership=np.array([1, 1, 2]))
    place = np.array([[-5.0, -3.0, 6.0], [5.0, 5.0, 5.0]])
    image = PLAN.draw(PlanScene(frame, NOWHERE, place, np.array([3, 4, 9])))
    for k, identity in enumerate((3, 4, 9)):
        assert colour_at(image, *place[:, k]) == pytest.approx(
            identity_colour(identity)[::-1], abs=2
        )
    line = colour_at(image, -4.5, 4.5)
    assert line.max() < 120
    assert colour_at(image, 6.0, 4.5).min() > 180


def test_labels_do_not_overlap() -> None:
    canvas = Canvas(np.zeros((400, 600, 3), np.uint8))
    for k in range(6):
        canvas.label(f"{10 + k}", (300 + 3 * k, 300 + 2 * k), (255, 255, 255))
    for (a, b, c, d), (e, f, g, h) in itertools.combinations(canvas.labels, 2):
        assert c <= e or g <= a or d <= f or h <= b


def test_the_field_of_view_and_edges_lie_behind() -> None:
    field = np.array([[-10.0, 10, 0], [0, 0, 9.5]])
    plan = Plan(PLAN.extent, 200, field, (np.array([[8.0, 8.0], [9, 4]]),))
    image = plan.draw(scene(groups()))
    assert colour_at(image, 0.3, 2.3) == pytest.approx([246, 228, 216], abs=1)
    assert (colour_at(image, -8.3, 8.3) == 255).all()
    assert colour_at(image, 8.0, 6.3) == pytest.approx([80, 120, 150], abs=30)


def test_detections_and_warnings_with_a_place_are_drawn() -> None:
    warnings = tuple(
        Encounter(first, second, 1.5, 0.5, 0.1, (0.0, 0.0), 0.9)
        for first, second in ((1, 2), (1, 7))
    )
    crosses = np.array([[5.3, np.nan, 1e6], [7.3, 2.0, 0.0]])
    image = PLAN.draw(scene(groups((-6.0, 8.0), (6.0, 1.0), warnings=warnings), crosses))
    assert colour_at(image, 5.3, 7.3).max() < 120
    quarter = np.array([-6.0, 8.0]) + 0.25 * np.array([12.0, -7.0])
    assert colour_at(image, *quarter) == pytest.approx([60, 60, 208], abs=40)


def test_extent_ignores_remote_outliers() -> None:
    rng = np.random.default_rng(0)
    places = np.hstack([rng.uniform(-20, 20, (2, 500)), [[900.0, np.nan], [900.0, 1.0]]])
    left, low, right, high = extent_of(places)
    assert -22 < left < -20
    assert 20 < high < 22
    assert extent_of(NOWHERE) == (-4, -4, 4, 4)
    assert right - left > 40
    assert low < -20


def test_the_report_shows_counts_events_and_warnings() -> None:
    events = [Event(4, i, "split", i, 1) for i in range(50)]
    warned = Encounter(1, 2, 0.5, 0.5, 0.1, (0.0, 0.0), 0.9)
    frames = [groups((0.0, 0.0), events=(event,), warnings=(warned,)) for event in events]
    known = {"found": {"people_mean": 2.0, "groups_mean": 1.0}, "stills": ()}
    text = render("groups.html", frames=frames, detections=[3] * 50, **known)
    for words in ("People and groups", "10 more rows in events.csv", "1 and 2", "raw detections"):
        assert words in text
    assert "No frame" in render("groups.html", frames=[], detections=[], **known)
