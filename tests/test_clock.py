"""What the stamps of a file mean, and which frame is shown at which time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack.clock import Clock, as_clock, settled

STEP = 0.04
EVEN = [1.4 + STEP * k for k in range(40)]


def times(stamps: list[float | None], interval: float = STEP) -> tuple[list[float], list[int]]:
    """The times of frames with these stamps, and the frames whose stamps are not believed."""
    doubted = list[tuple[int, float]]()
    reads = ((number, stamp, None) for number, stamp in enumerate(stamps, start=1))
    found = [time for _, time, _ in settled(reads, interval, doubted)]
    assert len(found) == len(stamps)
    assert np.all(np.diff(found) > 0)
    return found, [number for number, _ in doubted]


def test_time_begins_with_the_first_frame() -> None:
    for begin in (-2.0, 0.0, 1.4, 3600.0):
        found, doubted = times([begin + STEP * k for k in range(20)])
        np.testing.assert_allclose(found, STEP * np.arange(20), atol=1e-9)
        assert doubted == []


@pytest.mark.parametrize(
    "wrong",
    [
        {12: 150_000.0},
        {12: 150_000.0, 13: 150_000.04},
        {12: -7.0},
        {12: EVEN[11]},
        {12: None},
        {12: 9_000.0, 20: -3.0, 21: None, 25: EVEN[24], 30: 1.0},
        {0: 3_000.0},
        {0: -3_000.0},
        {39: 9_000.0},
    ],
)
def test_single_wrong_stamps_change_no_time(wrong: dict[int, float | None]) -> None:
    stamps = [wrong.get(k, stamp) for k, stamp in enumerate(EVEN)]
    found, doubted = times(stamps)
    np.testing.assert_allclose(found, STEP * np.arange(40), atol=1e-9)
    assert doubted == [k + 1 for k in sorted(wrong) if wrong[k] is not None]


def test_pauses_and_slower_parts_are_believed() -> None:
    """A pause of 20 s, also shortly before the end, and 30, then 5 pictures a second."""
    for after in (1, 2, 20):
        stamps = EVEN + [EVEN[-1] + 20 + STEP * k for k in range(after)]
        found, doubted = times([*stamps])
        np.testing.assert_allclose(found, np.array(stamps) - 1.4, atol=1e-9)
        assert doubted == []
    slower = [k / 30 for k in range(90)] + [3 + k / 5 for k in range(100)]
    np.testing.assert_allclose(times([*slower], 1 / 8)[0], slower, atol=1e-9)
    lapse = [3600.0 * k for k in range(5)]
    assert times([*lapse], 3600)[0] == lapse


def test_a_second_recording_continues_the_first() -> None:
    found, doubted = times([*EVEN, *EVEN[:25]])
    np.testing.assert_allclose(found, STEP * np.arange(65), atol=1e-9)
    assert doubted == []


def test_without_stamps_the_rate_counts() -> None:
    for stamps in ([None] * 30, [0.0] * 30):
        np.testing.assert_allclose(times([*stamps])[0], STEP * np.arange(30), atol=1e-9)
    half = [stamp if k % 2 else None for k, stamp in enumerate(EVEN)]
    np.testing.assert_allclose(np.diff(times(half)[0][1:]), STEP, atol=1e-9)


def test_frames_are_held_only_while_a_stamp_is_open() -> None:
    """An even stream comes out as it goes in; after a jump a few frames wait."""
    read = list[int]()

    def reads():
        for number, stamp in enumerate([*EVEN, *(stamp + 20 for stamp in EVEN)], start=1):
            read.append(number)
            yield number, stamp, None

    held = [read[-1] - number for number, *_ in settled(reads(), STEP)]
    assert max(held[1:39]) == 0
    assert 0 < max(held) < 10


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.none() | st.floats(-1e6, 1e6) | st.sampled_from(EVEN), max_size=40),
    st.floats(1e-3, 10),
)
def test_times_grow_whatever_the_stamps_are(stamps: list[float | None], interval: float) -> None:
    found, _ = times(stamps, interval)
    assert not found or found[0] == 0
    assert np.isfinite(found).all()


def test_a_clock_knows_times_and_frames() -> None:
    clock = Clock.of([3, 1, 5, 5], [0.2, 0.0, 2.2, 2.2], 10.0)
    np.testing.assert_allclose(clock.times([1, 2, 3, 4, 5, 7]), [0, 0.1, 0.2, 1.2, 2.2, 2.4])
    assert [clock.frame_at(time) for time in (-5.0, 0.0, 0.1, 0.19, 1.2, 2.2, 2.41)] == [
        *(1, 1, 2, 2, 4, 5, 7)
    ]
    assert clock.passed(range(3, 5)) == pytest.approx(2.0)
    constant = as_clock(29.97)
    for number in (1, 2, 100, 10_007):
        assert constant.time(number) == (number - 1) / 29.97
        assert constant.frame_at(constant.time(number)) == number
    assert as_clock(clock) is clock
    assert Clock.of([], [], 5.0).time(6) == 1.0
