"""Warnings of frame numbers and timestamps in wrong units, and of jumps."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from input_checks.streams import SIZE, walkers
from phdtrack import Tracker


def told(
    numbers: list[int] | None, times: list[float] | None, fps: float, count: int = 1
) -> tuple[str, ...]:
    """What a tracker warns of that is given these numbers and times."""
    tracker = Tracker(SIZE, fps=fps, filter="none")
    frames = len(numbers or times or ())
    for k, boxes in enumerate(walkers(frames, count, fps)):
        tracker.update(boxes, numbers and numbers[k], times and times[k])
    return tracker.warnings


@pytest.mark.parametrize("count", [1, 30])
@pytest.mark.parametrize(
    ("fps", "seconds"), [(1.0, 1.0), (25.0, 0.04), (25.0, 0.033), (60.0, 1 / 60)]
)
@pytest.mark.parametrize(
    ("unit", "parts"), [("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9)]
)
def test_units_of_timestamps(
    fps: float, seconds: float, unit: str, parts: float, count: int
) -> None:
    times = [float(round(parts * (5 + seconds * k))) for k in range(40)]
    (said,) = told(None, times, fps, count)
    assert said.startswith("frame 12: timestamps grow by ")
    assert f"at fps={fps:g} looks like {unit}: pass seconds (divide by {parts:,.0f})" in said


@pytest.mark.parametrize("count", [1, 30])
@pytest.mark.parametrize("fps", [1.0, 25.0, 30.0, 60.0])
def test_units_of_frame_numbers(fps: float, count: int) -> None:
    numbers = [1 + round(1000 * k / fps) for k in range(40)]
    (said,) = told(numbers, None, fps, count)
    assert f"frame numbers grow by {1000 / fps:.0f} at a time" in said
    assert "looks like milliseconds: pass frame=1, 2, 3, …" in said


@pytest.mark.parametrize("fps", [1.0, 5.0, 25.0, 60.0, 1000.0])
@pytest.mark.parametrize("every", [1, 2, 10, 25, 50])
def test_right_times_are_no_warning(fps: float, every: int) -> None:
    numbers = [1 + every * k for k in range(40)]
    assert told(numbers, None, fps) == ()
    assert told(numbers, [k / fps for k in numbers], fps) == ()
    if every / fps <= 5:
        # The rate is often left as it is.
        assert told(None, [k / fps for k in numbers], 25.0) == ()


def test_times_of_real_cameras_are_no_warning() -> None:
    rng = np.random.default_rng(0)
    intervals = rng.choice(
        [0.002, 0.03, 0.04, 0.05, 0.2, 2.0], 300, p=[0.02, 0.3, 0.3, 0.3, 0.06, 0.02]
    )
    assert told(None, [1.7e9, *(1.7e9 + intervals.cumsum())], 25.0) == ()


@pytest.mark.parametrize("count", [1, 30])
@pytest.mark.parametrize("fps", [1.0, 25.0, 60.0])
def test_jumps_are_reported_once(fps: float, count: int) -> None:
    intervals = np.full(100, 1 / fps)
    intervals[[40, 70]] *= 1000
    (said,) = told(None, [0.0, *intervals.cumsum()], fps, count)
    assert said.startswith(
        f"frame 42: {1000 / fps:.3g} s have passed since frame 41, usually it is"
    )
    intervals[[40, 70]] /= 1e6
    (said,) = told(None, [0.0, *intervals.cumsum()], fps, count)
    assert said.startswith("frame 42: only ")
    assert "Pass the times at which pictures were taken" in said


def test_gap_in_frame_numbers_is_a_jump() -> None:
    numbers = [*range(1, 41), *range(2000, 2040)]
    (said,) = told(numbers, None, 25.0)
    assert said.startswith("frame 2000: 78.4 s have passed since frame 40, usually it is 0.04 s")
    assert all(b > a for a, b in pairwise(numbers))


def test_trusted_times_are_not_checked() -> None:
    tracker = Tracker(SIZE, filter="none")
    tracker.trust_times()
    for k, boxes in enumerate(walkers(40)):
        tracker.update(boxes, timestamp=40.0 * k + 1e6 * (k > 20))
    assert tracker.warnings == ()
