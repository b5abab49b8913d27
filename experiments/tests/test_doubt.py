"""Warnings beside MOTA."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import pytest

from experiments.doubt import (
    DOUBTFUL,
    ErrorRates,
    JudgedRun,
    best_threshold,
    doubt_table,
    error_table,
    left_out,
)
from phdtrack.errors import InputError
from phdtrack.report.doubtful_tracks import DoubtfulTracks


def run(kind: str, mota: float, share: float) -> JudgedRun:
    """A run with a hundred boxes."""
    return JudgedRun(kind, kind, "change", mota, DoubtfulTracks(100, 5, share, share))


RUNS = [
    run("street", 0.9, 0.1),
    run("street", 0.8, 0.5),
    run("trees", 0.1, 0.6),
    run("trees", 0.3, 0.2),
    run("indoor", 0.5, 0.6),
    run("indoor", -1.0, 0.9),
]


def test_errors_are_counted_both_ways() -> None:
    assert ErrorRates.of(RUNS) == ErrorRates(missed=1, bad=3, false=1, good=2)
    assert ErrorRates.of(RUNS).cells == ("1 of 3", "1 of 2")
    assert ErrorRates.of(RUNS).mean == pytest.approx((1 / 3 + 1 / 2) / 2)
    assert ErrorRates.of([]).mean == 0
    verdicts = [one.verdict() for one in RUNS]
    assert verdicts == ["right", "false warning", "right", "missed", "either", "right"]


def test_no_boxes_are_no_warning() -> None:
    nothing = JudgedRun("empty", "street", "change", 0.0, DoubtfulTracks())
    assert nothing.verdict(0.0) == "missed"


def test_threshold_of_a_kind_is_chosen_on_other_kinds() -> None:
    # Without the street nothing is good, and the lowest threshold would do.
    assert best_threshold(RUNS[2:]) < 0.2
    assert best_threshold(RUNS) == pytest.approx(0.575)
    assert left_out(RUNS) == ErrorRates(missed=2, bad=3, false=1, good=2)


def test_run_is_read_from_its_folder_or_its_json(tmp_path: Path) -> None:
    document = {
        "input": {"detector": "mog2"},
        "scores": {"MOTA": 0.25},
        "doubtful_boxes": asdict(DoubtfulTracks(10, 2, 0.5, 0.5)),
    }
    (tmp_path / "run.json").write_text(json.dumps(document))
    found = JudgedRun.of("a", "street", tmp_path)
    assert found == JudgedRun.of("a", "street", document, 0.25)
    assert (found.detector, found.mota, found.doubtful.share) == ("mog2", 0.25, 0.5)
    objects = document | {"input": {"detections": "det.txt"}, "doubtful_boxes": None}
    with pytest.raises(InputError, match="got one with detections from a file"):
        JudgedRun.of("a", "street", objects)


def test_tables_have_a_row_for_each_run_worst_first() -> None:
    lines = doubt_table(RUNS).splitlines()
    assert len(lines) == 2 + len(RUNS)
    assert lines[2].startswith("| indoor | indoor | change | -1.000 | 90 % |")
    assert lines[-1].endswith("| right |")
    errors = error_table(RUNS)
    assert f"at {100 * DOUBTFUL:.0f} %, as shipped | 1 of 3 | 1 of 2 |" in errors
    assert "chosen without the kind" in errors
