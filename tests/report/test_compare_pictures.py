"""Charts and pictures of a comparison: what is drawn can be found in them."""

from __future__ import annotations

import numpy as np
import pytest

from phdtrack.report.charts import MethodScores, score_chart
from phdtrack.report.drawing import FALSE, MISSED, RIGHT, SWITCHED, Mistakes, side_by_side
from phdtrack.types import F8

NONE = np.zeros((0, 4))
BOX = np.array([[40.0, 60.0, 90.0, 180.0]])


def mistakes(method: str, found: F8 = NONE, missed: F8 = NONE, false: F8 = NONE, switched: bool = False) -> Mistakes:
    count = len(found)
    return Mistakes(method, found, np.arange(1, count + 1), np.full(count, switched), missed, false)


@pytest.mark.parametrize(
    ("one", "colour"),
    [
        (mistakes("m", found=BOX), RIGHT),
        (mistakes("m", found=BOX, switched=True), SWITCHED),
        (mistakes("m", missed=BOX), MISSED),
        (mistakes("m", false=BOX), FALSE),
    ],
)
@pytest.mark.parametrize("pictured", [False, True])
def test_each_mistake_has_its_colour_where_it_is(one: Mistakes, colour: tuple[int, int, int], pictured: bool) -> None:
    ground = np.full((240, 320, 3), 90, np.uint8) if pictured else None
    # The frame is drawn 1.5 times as large, below a bar of 28 and a gap of 6 pixels, the box from 96 to 276 in it.
    empty, drawn = (side_by_side(ground, (320, 240), "h", NONE, [which])[130:320] for which in (mistakes("m"), one))
    assert not (empty == colour[::-1]).all(axis=2).any()
    rows, columns = np.nonzero((drawn == colour[::-1]).all(axis=2))
    assert columns.min() == pytest.approx(6 + 60, abs=3)
    assert columns.max() == pytest.approx(6 + 135, abs=3)
    assert rows.max() == pytest.approx(34 + 270 - 130, abs=3)


def test_charts_hold_with_gaps_and_with_one_rate() -> None:
    nan = np.nan
    whole = MethodScores("a", np.array([0.5, 0.4]), np.array([0.1, 0.1]))
    gap = MethodScores("b", np.array([nan, -0.4]), np.array([nan, nan]))
    for picture in (
        score_chart(np.array([0.0, 10.0]), "clutter", "MOTA", [whole, gap]),
        score_chart(["one", "another with a long name"], "", "MOTA", [whole, gap]),
        score_chart([], "", "MOTA", []),
    ):
        assert picture.mime == "image/svg+xml"
        assert b"http://www.w3.org/2000/svg" in picture.data
