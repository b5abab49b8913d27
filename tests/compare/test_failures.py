"""The worst frames: their mistakes are those that the scores count, and the frames are the right ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from compare_cases import FRAMES, small

from phdtrack.compare import Comparison, run
from phdtrack.compare.failures import conditions, worst_frames, write_frames
from phdtrack.compare.plans import Run
from phdtrack.compare.runs import RunResult


@pytest.fixture(scope="module")
def comparison(tmp_path_factory: pytest.TempPathFactory) -> Comparison:
    folder = tmp_path_factory.mktemp("worst")
    return run(small(folder, clutter=[0.0, 4.0], seeds=1), folder / "out")


def test_mistakes_of_all_frames_are_those_of_the_scores(comparison: Comparison) -> None:
    found = list(conditions(comparison, "a"))
    assert [rate for _, rate, _, _ in found] == [0.0, 4.0]
    for case, rate, _, mistakes in found:
        for method, rows in zip(comparison.plan.methods, mistakes.values(), strict=True):
            result = comparison.result(Run(case, rate, method, 1))
            assert isinstance(result, RunResult)
            scores = result.scores
            assert scores is not None
            right, switched, missed, false = np.bincount(rows.kind, minlength=4)
            assert (missed, false, switched) == (scores.misses, scores.false_positives, scores.id_switches)
            assert right + switched == scores.matches
            assert rows.counts(np.arange(FRAMES + 1)).sum() == missed + false + switched
            assert str(rows) == f"{missed} missed, {false} false, {switched} switched"


def test_pictures_are_written_and_show_something(comparison: Comparison, tmp_path: Path) -> None:
    frames = list(worst_frames(comparison, 1))
    assert {frame.name.split("-")[0] for frame in frames} == {"a", "b"}
    write_frames(tmp_path / "worst", frames)
    assert all((tmp_path / "worst" / frame.name).read_bytes().startswith(b"\x89PNG") for frame in frames)
    for frame in frames:
        assert frame.image.std() > 5
        assert "gm-phd: " in frame.caption
        assert "none: " in frame.caption
    assert list(worst_frames(comparison, 0)) == []
