"""The table of new cameras: how a best peer is chosen and how pairs are counted; the short form on
the real sequences.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
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


def written(path: Path, rows: Sequence[Mapping[str, str]]) -> None:
    """Write a table of scores."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with scores of the older peer ``old`` and of the newer ``new`` in one group of the
    cases a (100 true boxes) and b (300); ``half`` lacks b.
    """
    row = {
        "part": "released",
        "group": "g",
        "sequence": "a",
        "detector": "x",
        "name": "old",
        "HOTA": "50",
    }
    row |= {"MOTA": "70", "IDF1": "60", "FP": "10", "FN": "15", "IDSW": "5"}
    second = row | {
        "sequence": "b",
        "HOTA": "70",
        "MOTA": "90",
        "IDF1": "80",
        "FP": "9",
        "FN": "15",
        "IDSW": "6",
    }
    repeated = {key: key for key in row}
    bench = tmp_path / "bench"
    bench.mkdir()
    written(bench / "peers_more.csv", [row, second])
    new = {"name": "new", "HOTA": "66"}
    newer = [repeated, row | new, second | new, row | {"name": "half", "HOTA": "99"}]
    written(bench / "peers_new.csv", newer)
    exact = {"group": "g", "cases": "2", "name": "old", "HOTA": "64", "MOTA": "85", "IDF1": "75"}
    written(bench / "peers_more_groups.csv", [exact])
    written(bench / "peers.csv", [{"name": "s", "case": "none", "seq": "a", "HOTA": "1"}])
    for sequence, boxes in (("a", 100), ("b", 300)):
        truth = tmp_path / "more" / sequence / "gt"
        truth.mkdir(parents=True)
        lines = [f"{k + 1},1,5,5,9,9,1,-1,-1,-1" for k in range(boxes)]
        # A row that does not count.
        lines.append("1,2,50,50,9,9,0,-1,-1,-1")
        (truth / "gt.txt").write_text("\n".join(lines), encoding="utf-8")
    monkeypatch.setattr(cameras, "bench", lambda: bench)
    monkeypatch.setattr(cameras, "folder_of", lambda sequence: tmp_path / "more" / sequence)
    cameras.true_boxes.cache_clear()
    return bench


def test_best_peer_is_one_of_the_newer_ones_too(folder: Path) -> None:
    """The header that a file repeats is no peer."""
    peers = cameras.peers_of_cases()
    assert {row["name"] for row in peers} == {"old", "new", "half"}
    assert cameras.best([row for row in peers if row["sequence"] == "b"]) == [70.0, 90.0, 80.0]
    assert cameras.best([row for row in peers if row["sequence"] == "a"]) == [99.0, 70.0, 60.0]


def test_scores_of_newer_peers_are_pooled_over_whole_groups(folder: Path) -> None:
    """MOTA from the 60 errors and 400 true boxes; IDF1 and HOTA weighted by the 195 and 594 boxes
    of truth and tracks.
    """
    rows = {row["name"]: row for row in cameras.peers_of_groups()}
    assert set(rows) == {"old", "new"}
    idf1 = (195 * 60 + 594 * 80) / (195 + 594)
    values = [float(rows["new"][score]) for score in cameras.SCORES]
    assert values == pytest.approx([66, 85, idf1], abs=1e-3)


def test_error_of_a_pooled_hota_is_that_of_known_ones(folder: Path) -> None:
    rows = [row for row in cameras.peers_of_cases() if row["name"] == "old"]
    exact = [{"group": "g", "cases": "2", "name": "old", "HOTA": "64"}]
    mean = (195 * 50 + 594 * 70) / (195 + 594)
    assert cameras.hota_errors(rows, exact) == pytest.approx([mean - 64])
    assert cameras.hota_errors(rows[:1], exact) == []


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
