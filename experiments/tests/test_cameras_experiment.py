"""The table of new cameras: how a best peer is chosen and how pairs are counted; the short form on
the real sequences.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from experiments import cameras
from experiments.common import Options

PEERS = [
    {"sequence": "a", "detector": "x", "name": "sort", "HOTA": "40", "MOTA": "60", "IDF1": "50"},
    {"sequence": "a", "detector": "x", "name": "ocsort", "HOTA": "45", "MOTA": "55", "IDF1": "50"},
    {
        "sequence": "a",
        "detector": "x",
        "name": "pmb-online",
        "HOTA": "99",
        "MOTA": "99",
        "IDF1": "99",
    },
]


def test_best_peer_is_chosen_per_score_without_ourselves() -> None:
    assert cameras.best(PEERS) == [45.0, 60.0, 50.0]


def test_pairs_that_are_equal_count_as_won() -> None:
    rows = [
        {"sequence": "a", "detector": "x", "HOTA": "44.9", "MOTA": "60", "IDF1": "50.1"},
        {"sequence": "ALL", "detector": "ALL", "HOTA": "99", "MOTA": "99", "IDF1": "99"},
    ]
    assert cameras.pairs_won(rows, PEERS) == (2, 3)


def test_a_group_is_left_out_of_the_choice_of_its_variant() -> None:
    away = {"one": {"a": 9.0, "b": 0.0, "c": 1.0}, "other": {"a": 0.0, "b": 3.0, "c": 2.0}}
    assert cameras.left_out(away) == {"a": "other", "b": "one", "c": "one"}


def test_distances_are_means_over_cases_and_scores() -> None:
    row = {"group": "g", "sequence": "a", "detector": "x", "HOTA": "48", "MOTA": "60", "IDF1": "47"}
    whole = row | {"sequence": "ALL", "HOTA": "99"}
    assert cameras.distances([row, row | {"IDF1": "53"}, whole], PEERS) == pytest.approx({"g": 1.0})


def test_the_error_of_a_difference_is_that_of_a_mean_of_groups() -> None:
    """The jackknife of a mean over groups is its standard error, s/√n; of one group there is
    none.
    """
    one = {"a": 3.0, "b": 1.0, "c": 5.0, "d": 1.0}
    other = {"a": 1.0, "b": 1.0, "c": 1.0, "d": 1.0}
    mean, error = cameras.difference(one, other)
    assert (mean, error) == pytest.approx((1.5, np.std([2, 0, 4, 0], ddof=1) / 2))
    assert cameras.difference({"a": 2.0}, {"a": 1.0}) == (1.0, 0.0)


def test_what_is_far_behind_is_listed_by_distance() -> None:
    case = {"group": "g", "sequence": "a", "detector": "x"}
    kept = {
        ("default", "online"): [case | {"HOTA": "40.1", "MOTA": "50", "IDF1": "44"}],
        ("default", "corrected"): [case | {"HOTA": "40", "MOTA": "58.5", "IDF1": "47.9"}],
    }
    assert [(row[0], row[3], row[4]) for row in cameras.behind(kept, PEERS)] == [
        ("online", "MOTA", "50.0"),
        ("online", "IDF1", "44.0"),
        ("corrected", "HOTA", "40.0"),
        ("corrected", "IDF1", "47.9"),
    ]


@pytest.mark.slow
@pytest.mark.data
def test_the_short_form_writes_a_page(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not (data / "more").is_dir() or not (data.parent / "bench" / "score_more.py").is_file():
        pytest.skip("the sequences of new cameras are not beside the data")
    monkeypatch.setattr(cameras, "SHORT", ("KITTI-0014-car",))
    page = cameras.main(Options(quick=True, out=tmp_path, jobs=1)).read_text()
    assert "cars" in page
