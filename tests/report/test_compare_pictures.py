"""Charts and pictures of a comparison: what is drawn can be found in them."""

from __future__ import annotations

import numpy as np
import pytest

from phdtrack.report.charts import score_chart
from phdtrack.report.drawing import FALSE, MISSED, MISTAKE_COLOURS, RIGHT, SWITCHED, Mistakes, side_by_side

NONE = np.zeros((0, 4))
BOX = np.array([[40.0, 60.0, 90.0, 180.0]])


@pytest.mark.parametrize("kind", [RIGHT, SWITCHED, MISSED, FALSE])
@pytest.mark.parametrize("pictured", [False, True])
def test_each_mistake_has_its_colour_where_it_is(kind: int, pictured: bool) -> None:
    ground = np.full((240, 320, 3), 90, np.uint8) if pictured else None
    every = Mistakes(np.ones(1, int), np.ones(1, int), np.array([kind]), BOX)
    # The frame is drawn 1.5 times as large, below a bar of 28 and a gap of 6 pixels, the box from 96 to 276 in it.
    empty, drawn = (side_by_side(ground, (320, 240), "h", NONE, {"m": every.at(number)})[130:320] for number in (2, 1))
    colour = MISTAKE_COLOURS[kind][::-1]
    assert not (empty == colour).all(axis=2).any()
    rows, columns = np.nonzero((drawn == colour).all(axis=2))
    assert columns.min() == pytest.approx(6 + 60, abs=3)
    assert columns.max() == pytest.approx(6 + 135, abs=3)
    assert rows.max() == pytest.approx(34 + 270 - 130, abs=3)


def test_charts_hold_with_gaps_and_with_one_rate() -> None:
    both = {"a": np.array([[0.5, 0.4], [0.1, 0.1]]), "b": np.array([[np.nan, -0.4], [np.nan, np.nan]])}
    for picture in (
        score_chart(np.array([0.0, 10.0]), "clutter", "MOTA", both),
        score_chart(["one", "another with a long name"], "", "MOTA", both),
        score_chart([], "", "MOTA", {}),
    ):
        assert picture.mime == "image/svg+xml"
        assert b"http://www.w3.org/2000/svg" in picture.data
