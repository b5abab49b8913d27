"""Warnings of scores that are all the same."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from input_checks.streams import scored, walkers, warnings
from phdtrack.types import F8

RATES = [(1.0, 80), (25.0, 120), (60.0, 120)]


@pytest.mark.parametrize(("fps", "frames"), RATES)
@pytest.mark.parametrize("count", [1, 30])
@pytest.mark.parametrize("score", [0.8, 0.0, -1.0, 100.0])
def test_equal_scores_are_reported_once(fps: float, frames: int, count: int, score: float) -> None:
    (said,) = warnings(scored(walkers(frames, count, fps), score), fps, filter="none")
    assert f"100% of the scores are {score:g}: scores that are all the same cannot tell" in said
    assert "Pass the detector's confidence in each box, or no scores" in said


@pytest.mark.parametrize(("fps", "frames"), RATES)
@pytest.mark.parametrize("count", [1, 30])
def test_different_scores_or_none_are_no_warning(fps: float, frames: int, count: int) -> None:
    assert warnings(walkers(frames, count, fps), fps, filter="none") == []
    assert warnings(scored(walkers(frames, count, fps)), fps, filter="none") == []
    assert warnings(scored(walkers(frames, count, fps), 1.0), fps, filter="none") == []


def some_equal(share: float) -> Iterator[F8]:
    """Boxes, this share of whose scores are 1."""
    rng = np.random.default_rng(6)
    for boxes in scored(walkers(200, 5)):
        boxes[rng.random(len(boxes)) < share, 4] = 1.0
        yield boxes


def test_share_of_equal_scores_decides() -> None:
    (said,) = warnings(some_equal(0.97), filter="none")
    assert "% of the scores are 1: " in said
    assert warnings(some_equal(0.6), filter="none") == []


def test_few_scores_are_no_warning() -> None:
    assert warnings(scored(walkers(45, 10), 0.9), filter="none") == []
