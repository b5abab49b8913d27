"""The checks of a stream together: saved and resumed, begun anew, bounded, and without effect."""

from __future__ import annotations

import pickle
from collections.abc import Iterator

import numpy as np
import pytest

from input_checks.streams import SIZE, scored, walkers
from phdtrack import Tracker
from phdtrack.types import F8

CLUTTER = {"clutter": {"clutter_per_detection": 1e5}}


def troubles(frames: int) -> Iterator[tuple[F8, float]]:
    """Boxes with scores all the same and classes that change, and times in milliseconds."""
    rng = np.random.default_rng(0)
    for k, boxes in enumerate(scored(walkers(frames, 4), 0.5)):
        boxes[:, 5] = rng.integers(0, 2, len(boxes))
        yield boxes, 40.0 * (k + 1)


def feed(tracker: Tracker, frames: list[tuple[F8, float]]) -> None:
    for boxes, time in frames:
        tracker.update(boxes, timestamp=time)


@pytest.mark.parametrize("at", [5, 20, 60, 100])
def test_resumed_tracker_warns_as_if_it_had_gone_on(at: int) -> None:
    frames = list(troubles(160))
    whole, first, second = (Tracker(SIZE, **CLUTTER) for _ in range(3))
    feed(whole, frames)
    feed(first, frames[:at])
    second.load_state_dict(pickle.loads(pickle.dumps(first.state_dict())))
    assert second.warnings == first.warnings
    said = list(first.warnings)
    second.on_warning = said.append
    feed(second, frames[at:])
    assert tuple(said) == second.warnings
    words = [sentence.partition(": ")[2][:25] for sentence in said]
    assert sorted(words) == sorted(each.partition(": ")[2][:25] for each in whole.warnings)
    assert len(set(words)) == len(words) == 4


def test_units_of_boxes_are_not_reported_again() -> None:
    first, second = (Tracker(SIZE, filter="none") for _ in range(2))
    first.update([[0.1, 0.1, 0.5, 0.9]])
    second.load_state_dict(first.state_dict())
    second.update([[0.1, 0.1, 0.5, 0.9]])
    assert len(second.warnings) == len(first.warnings) == 1


def test_pause_before_a_resumed_run_is_no_jump() -> None:
    first, second = (Tracker(SIZE, filter="none") for _ in range(2))
    frames = list(walkers(60))
    for boxes in frames[:30]:
        first.update(boxes)
    second.load_state_dict(first.state_dict())
    for k, boxes in enumerate(frames[30:]):
        second.update(boxes, timestamp=1e4 + 0.04 * k)
    assert second.warnings == ()
    second.update(frames[0], timestamp=2e4)
    assert len(second.warnings) == 1


def test_reset_begins_the_checks_anew() -> None:
    tracker = Tracker(SIZE, filter="none")
    for _ in range(2):
        feed(tracker, list(troubles(60)))
        assert len(tracker.warnings) == 3
        tracker.reset()
        assert tracker.warnings == ()


def test_memory_of_the_checks_is_bounded() -> None:
    """Also while none of them is settled."""
    rng = np.random.default_rng(0)
    sizes = list[int]()
    tracker = Tracker(SIZE, filter="none", associate={"history": 1})
    for k in range(600):
        corner = rng.uniform(0, [1700, 900], (3, 2))
        label = rng.integers(0, 3, 3)
        score = np.full(3, 1.0)
        tracker.update(np.column_stack([corner, corner + np.array([60, 160]), score, label]))
        if k % 200 == 199:
            sizes.append(len(pickle.dumps(tracker.state_dict())))
    assert sizes[2] < sizes[0] + 2000
