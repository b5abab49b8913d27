"""The worst frames: their mistakes are those that the scores count, and the frames are the right ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from compare_cases import FRAMES, small

from phdtrack.compare import Comparison, run
from phdtrack.compare.failures import _conditions, _mistakes, worst_frames, write_frames
from phdtrack.compare.store import RunResult


@pytest.fixture(scope="module")
def comparison(tmp_path_factory: pytest.TempPathFactory) -> Comparison:
    folder = tmp_path_factory.mktemp("worst")
    return run(small(folder, clutter=[0.0, 4.0], seeds=1), folder / "out")


def test_mistakes_of_all_frames_are_those_of_the_scores(comparison: Comparison) -> None:
    conditions = list(_conditions(comparison, comparison.plan.cases[0].sequence))
    assert [condition.rate for condition in conditions] == [0.0, 4.0]
    for condition in conditions:
        for one in condition.scored:
            cell = next(
                cell
                for cell in comparison.plan.cells
                if cell.case is condition.case and cell.rate == condition.rate and cell.method.name == one.method
            )
            outcome = comparison.result(cell, 1)
            assert isinstance(outcome, RunResult)
            assert outcome.scores is not None
            drawn = [_mistakes(condition.truth, one, frame) for frame in range(1, FRAMES + 1)]
            assert sum(len(frame.missed) for frame in drawn) == outcome.scores.misses
            assert sum(len(frame.false) for frame in drawn) == outcome.scores.false_positives
            assert sum(int(frame.switched.sum()) for frame in drawn) == outcome.scores.id_switches
            assert sum(len(frame.found) for frame in drawn) == outcome.scores.matches
            each = [len(frame.missed) + len(frame.false) + int(frame.switched.sum()) for frame in drawn]
            np.testing.assert_array_equal(one.errors[1:], each)


def test_pictures_are_written_and_show_something(comparison: Comparison, tmp_path: Path) -> None:
    frames = list(worst_frames(comparison, 1))
    assert {frame.name.split("-")[0] for frame in frames} == {"a", "b"}
    files = write_frames(tmp_path / "worst", frames)
    assert all(file.read_bytes().startswith(b"\x89PNG") for file in files)
    for frame in frames:
        assert frame.image.std() > 5
        assert "gm-phd: " in frame.caption
        assert "none: " in frame.caption
    assert list(worst_frames(comparison, 0)) == []
