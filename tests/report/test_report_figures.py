"""Charts and pictures: what is drawn can be found in them."""

from __future__ import annotations

from dataclasses import replace

import cv2
import matplotlib
import numpy as np
from report_runs import run_record

from phdtrack.report import report_html
from phdtrack.report.charts import (
    Picture,
    count_chart,
    lifetime_chart,
)
from phdtrack.types import Tracks


def pixels(picture: Picture) -> np.ndarray:
    assert picture.mime == "image/jpeg"
    return cv2.imdecode(np.frombuffer(picture.data, np.uint8), cv2.IMREAD_COLOR)


def drawn(picture: Picture) -> str:
    assert picture.mime == "image/svg+xml"
    text = picture.data.decode()
    assert text.startswith("<svg")
    assert text.rstrip().endswith("</svg>")
    return text


def test_count_chart_draws_truth_only_if_there_is_one() -> None:
    with_truth = drawn(count_chart(run_record()))
    without = drawn(count_chart(run_record(truth=False)))
    banded = drawn(count_chart(run_record(cardinality=(0.1, 0.2, 0.6, 0.1))))
    assert (
        banded.count("fill-opacity: 0.18") == with_truth.count("fill-opacity: 0.18") + 2
    )  # the band and its legend
    assert with_truth.count("#2a9d74") > without.count("#2a9d74") == 0
    for colour in ("#3b6fd4", "#e08a1e", "#9aa5b8"):
        assert colour in without


def test_lifetime_has_a_bar_for_each_segment() -> None:
    record = run_record(
        12, 1, truth=False
    )  # every third frame predicted: 4 stretches seen, 4 predicted
    svg = drawn(lifetime_chart(record))
    assert svg.count("stroke-opacity: 0.35") == 4
    assert svg.count("stroke: #ff9f1c") == 8


def test_thousands_of_points_are_rasterised() -> None:
    n = 4000
    each = np.arange(1, n + 1)
    many = Tracks(
        np.ones(n, int), each, np.ones((n, 4)), np.ones(n), np.zeros(n, int), np.ones(n, bool)
    )
    times = each / 25
    counts = each % 7
    masses = each % 7 + 0.5
    rows = {
        "numbers": each,
        "times": times,
        "n_detections": counts,
        "mass": masses,
        "truth_count": counts,
    }
    record = replace(
        run_record(3), tracks=many, track_count=counts, seconds=np.full((n, 4), 0.01), **rows
    )
    for picture in (lifetime_chart(record), count_chart(record)):
        assert "<image" in drawn(picture)
        assert len(picture.data) < 300_000


def test_matplotlib_settings_are_unchanged() -> None:
    before = list(dict.items(matplotlib.rcParams))
    report_html(run_record(5), {})
    assert list(dict.items(matplotlib.rcParams)) == before
