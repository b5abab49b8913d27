"""Warnings of frames that are empty because no detector ran."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
import pytest

from input_checks.streams import walkers, warnings
from phdtrack import Detections
from phdtrack.types import F8

NOTHING = np.zeros((0, 4))


def one_in(every: int, frames: Iterable[F8], between: object = NOTHING) -> Iterator[object]:
    """Every so-manieth frame with its boxes, the others without."""
    for k, boxes in enumerate(frames):
        yield between if k % every else boxes


@pytest.mark.parametrize("count", [2, 30])
@pytest.mark.parametrize("every", [2, 3, 10, 25])
def test_regularly_empty_frames_are_reported_once(every: int, count: int) -> None:
    (said,) = warnings(one_in(every, walkers(20 * every, count)))
    assert f"only one in {every} frames has detections, 13 times in a row" in said
    assert "pass Detections.empty(observed=False) for them" in said


@pytest.mark.parametrize("every", [2, 10])
def test_unobserved_frames_are_no_warning(every: int) -> None:
    unseen = Detections.empty(observed=False)
    assert warnings(one_in(every, walkers(20 * every, 2), unseen)) == []


@pytest.mark.parametrize("p_detect", [0.2, 0.5, 0.8])
def test_frames_that_are_empty_by_chance_are_no_warning(p_detect: float) -> None:
    rng = np.random.default_rng(5)
    lost = (boxes[rng.random(len(boxes)) < p_detect] for boxes in walkers(2000))
    assert warnings(lost, filter="none") == []


def test_empty_frames_before_the_first_detection_do_not_count() -> None:
    stream = [NOTHING] * 60 + list(walkers(60, 2)) + [NOTHING] * 60
    assert warnings(stream) == []
