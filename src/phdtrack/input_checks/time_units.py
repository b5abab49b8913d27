"""Frame numbers and timestamps in other units than frames and seconds, and jumps of the time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

# Steps from frame to frame after which the usual one is known.
_KNOWN = 11
# A step of the time that is so many times the usual one, or so small a part of it, is a jump.
_LONG = 300.0
_SHORT = 0.01
# How many of each unit are a second.
_UNITS = {"milliseconds": 1_000, "microseconds": 1_000_000, "nanoseconds": 1_000_000_000}
# Times in such a unit grow by what a second has of it, divided by fps. Timestamps do so within the
# first factor, because fps is often left as it is, frame numbers within the second one: where the
# detector runs in every tenth frame they grow by 10.
_TIME_FACTOR = 6.0
_NUMBER_FACTOR = 1.05
# At a thousand frames a second every frame is a millisecond.
_MIN_STEP = 10


class FrameTimes(NamedTuple):
    """Numbers and times of the frames so far.

    Attributes
    ----------
    number, time : of the last frame; 0 and 0 before the first.
    steps : how both grew to the first frames.
    usual : the seconds between two frames that are usual; 0 until they are known.
    """

    number: int = 0
    time: float = 0.0
    steps: tuple[tuple[int, float], ...] = ()
    usual: float = 0.0

    def resumed(self) -> FrameTimes:
        """The same for a stream that goes on after a pause, which is no jump."""
        return self._replace(number=0)


def with_time(times: FrameTimes, number: int, time: float, fps: float) -> tuple[FrameTimes, str]:
    """The times after a frame, and a warning of wrong units or of a jump, empty without any.

    Parameters
    ----------
    times : before the frame.
    number, time : of the frame; seconds.
    fps : frames per second that the tracker was told.
    """
    last, last_time, steps, usual = times
    if not last:
        return FrameTimes(number, time, steps, usual), ""
    seconds = time - last_time
    if usual:
        warning = ""
        if not _SHORT * usual <= seconds <= _LONG * usual:
            warning = jump_warning(last, seconds, usual)
        return FrameTimes(number, time, steps, usual), warning
    steps = (*steps, (number - last, seconds))
    if len(steps) < _KNOWN:
        return FrameTimes(number, time, steps, usual), ""
    usual = float(np.median([each for _, each in steps]))
    return FrameTimes(number, time, (), usual), time_unit_warning(steps, fps)


def time_unit_warning(steps: tuple[tuple[int, float], ...], fps: float) -> str:
    """A sentence if numbers or times seem to be in a unit smaller than frames and seconds.

    ``steps`` are how both grew from frame to frame, ``fps`` what the tracker was told.
    """
    frames = float(np.median([number for number, _ in steps]))
    interval = float(np.median([seconds / number for number, seconds in steps]))
    for unit, parts in _UNITS.items():
        if frames >= _MIN_STEP and _within(frames, parts / fps, _NUMBER_FACTOR):
            return (
                f"frame numbers grow by {frames:g} at a time, which at fps={fps:g} looks like"
                f" {unit}: pass frame=1, 2, 3, …, and times as timestamp in seconds"
            )
        if _within(interval, parts / fps, _TIME_FACTOR):
            return (
                f"timestamps grow by {interval:g} a frame, which at fps={fps:g} looks like {unit}:"
                f" pass seconds (divide by {parts:,}), or the true fps if they are seconds"
            )
    return ""


def jump_warning(last: int, seconds: float, usual: float) -> str:
    """A sentence on an interval that is far from the usual one.

    Parameters
    ----------
    last : number of the frame before.
    seconds, usual : since then, and as usual.
    """
    if seconds > usual:
        return (
            f"{seconds:.3g} s have passed since frame {last}, usually it is {usual:.3g} s: tracks"
            " end in such a gap. Call update for frames without detections too and check the times;"
            " call reset() for another sequence, or trust_times() if the stream may pause"
        )
    return (
        f"only {seconds:.3g} s have passed since frame {last}, usually it is {usual:.3g} s: speeds"
        " are wrong unless that is the time between the two pictures. Pass the times at which"
        " pictures were taken, not at which they arrived, or none"
    )


def _within(value: float, expected: float, factor: float) -> bool:
    """True if the value is the expected one up to a factor."""
    return expected / factor <= value <= expected * factor
