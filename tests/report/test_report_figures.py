from __future__ import annotations

from dataclasses import replace

import cv2
import matplotlib
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from report_runs import run_record

from phdtrack.report import report_html
from phdtrack.report.charts import (
    Picture,
    count_chart,
    heat_picture,
    lifetime_chart,
    thinned,
    timing_chart,
    trajectory_picture,
)
from phdtrack.report.record import HeatMap
from phdtrack.types import SequenceInfo, Tracks


def pixels(picture: Picture) -> np.ndarray:
    assert picture.mime == "image/jpeg"
    return cv2.imdecode(np.frombuffer(picture.data, np.uint8), cv2.IMREAD_COLOR)


def drawn(picture: Picture) -> str:
    assert picture.mime == "image/svg+xml"
    text = picture.data.decode()
    assert text.startswith("<svg")
    assert text.rstrip().endswith("</svg>")
    return text


def test_the_count_chart_draws_truth_only_where_there_is_one() -> None:
    with_truth, without = drawn(count_chart(run_record())), drawn(count_chart(run_record(truth=False)))
    banded = drawn(count_chart(run_record(cardinality=(0.1, 0.2, 0.6, 0.1))))
    assert banded.count("fill-opacity: 0.18") == with_truth.count("fill-opacity: 0.18") + 2  # the band and its legend
    assert with_truth.count("#2a9d74") > without.count("#2a9d74") == 0
    for colour in ("#3b6fd4", "#e08a1e", "#9aa5b8"):
        assert colour in without


def test_a_lifetime_has_a_bar_for_each_stretch() -> None:
    record = run_record(12, 1, truth=False)  # every third frame predicted: 4 stretches seen, 4 predicted
    svg = drawn(lifetime_chart(record))
    assert svg.count("stroke-opacity: 0.35") == 4
    assert svg.count("stroke: #ff9f1c") == 8


def test_thousands_of_bars_become_pixels() -> None:
    n = 4000
    many = Tracks(np.ones(n, int), np.arange(1, n + 1), np.ones((n, 4)), np.ones(n), np.zeros(n, int), np.ones(n, bool))
    info = SequenceInfo(20, 20, 10.0)
    picture = lifetime_chart(replace(run_record(3), info=info, tracks=many))
    assert "<image" in drawn(picture)
    assert len(picture.data) < 300_000


def test_the_heat_map_is_bright_where_the_mass_is() -> None:
    density = np.zeros((20, 20))
    density[4:7, 4:7] = 0.1
    none = np.zeros((0, 4))
    heat = HeatMap(1, np.full((100, 100, 3), 60, np.uint8), density, 5.0, none, none)
    image = pixels(heat_picture(heat, SequenceInfo(100, 100, 10.0)))
    blank = pixels(heat_picture(HeatMap(1, heat.image, 0 * density, 5.0, none, none), SequenceInfo(100, 100, 10.0)))
    high, wide = image.shape[:2]
    changed = np.abs(image.astype(int) - blank).max(axis=2)[:, : int(0.75 * wide)] > 90
    rows, columns = np.nonzero(changed)
    assert len(rows) > 500
    assert 0.1 < rows.mean() / high < 0.4
    assert 0.1 < columns.mean() / wide < 0.4


@settings(max_examples=8, deadline=None)
@given(st.integers(1, 3000), st.integers(1, 3000), st.integers(1, 3), st.integers(0, 2), st.floats(0, 60), st.booleans())
def test_every_figure_can_be_made_of_any_run(
    wide: int, high: int, frames: int, objects: int, fps: float, video: bool
) -> None:
    record = run_record(frames, objects, info=SequenceInfo(wide, high, fps), video=video, truth=objects == 1)
    for chart in (count_chart, lifetime_chart, timing_chart):
        drawn(chart(record))
    assert pixels(trajectory_picture(record)).std() > 0
    for heat in record.heat_maps[:1]:
        assert pixels(heat_picture(heat, record.info)).std() > 0


def test_matplotlib_is_left_as_it_was() -> None:
    before = list(dict.items(matplotlib.rcParams))
    report_html(run_record(5), {})
    assert list(dict.items(matplotlib.rcParams)) == before


@given(st.integers(0, 300), st.integers(1, 50), st.integers(1, 3))
def test_thinning_gives_means_of_blocks(length: int, limit: int, columns: int) -> None:
    values = np.arange(length * columns, dtype=np.float64).reshape(length, columns)
    thin, block = thinned(values, limit), max(1, -(-length // limit))
    assert len(thin) <= limit
    expected = [values[k : k + block].mean(axis=0) for k in range(0, length, block)]
    np.testing.assert_allclose(thin, np.reshape(expected, (-1, columns)))
