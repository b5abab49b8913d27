"""Frame numbers, times, or only an order, from the names of a sequence of image files.

- A date with a time of day (``20241128111015``, ``2024-11-28_11-10-15.040``) or seconds since 1970
  (``1305031102.175304``; whole numbers also in ms, µs or ns) in each name are times.
- Otherwise the last number that increases from name to name is the number of the frame, counted
  from the first file as frame 1 in steps of the names' common divisor: a file missing from
  ``000001.jpg 000002.jpg 000004.jpg`` is a dropped frame. A jump of thousands is no gap of so many
  frames, but two recordings: frames are counted on.
- Names without numbers, numbers that do not increase, and numbers of which more than nine in ten
  are missing, only tell the order.
"""

from __future__ import annotations

import math
import re
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise

_DIGITS = re.compile(r"\d+")
# Frames per file above which the numbers in the names are not those of frames.
_MAX_SPACING = 10
# Missing frames above which a gap is a jump to another recording.
_MAX_GAP = 1000
_CLOCK = re.compile(
    r"(?<!\d)((?:19|20)\d\d)[-_.]?(\d\d)[-_.]?(\d\d)[-_. T]?(\d\d)[-_.:h]?(\d\d)[-_.:m]?(\d\d)"
    r"(?:[-_.,]?(\d{3}|\d{6}|\d{9}))?(?!\d)"
)
_EPOCH = re.compile(r"(?<!\d)(\d{10})(?:\.(\d{1,9})|(\d{3}|\d{6}|\d{9})?)(?!\d)")
# Seconds since 1970 that are plausible for a recording: from 2008 to 2049.
_PLAUSIBLE = (1.2e9, 2.5e9)


@dataclass(frozen=True, slots=True)
class Numbering:
    """Numbers and times of frames, from names.

    Attributes
    ----------
    numbers : of the frames, from 1, increasing.
    times : seconds since the first frame; empty if the names are no times.
    note : what was taken for what; empty if the names are plain frame numbers.
    """

    numbers: list[int]
    times: list[float]
    note: str = ""

    @property
    def rate(self) -> float:
        """Frames per second by the median interval of the times; 0 without times."""
        if not self.times:
            return 0.0
        return 1 / statistics.median(after - before for before, after in pairwise(self.times))


def numbering(stems: Sequence[str]) -> Numbering:
    """Numbers and times of frames, from names in natural order, without their suffixes."""
    counted = list(range(1, len(stems) + 1))
    if len(stems) < 2:
        return Numbering(counted, [])
    times = _times(stems)
    if times:
        note = f"the names of the images are times, {times[-1]:g} s from the first to the last"
        return Numbering(counted, times, note)
    digits = [_DIGITS.findall(stem) for stem in stems]
    if not all(digits):
        return Numbering(counted, [], _order("have no numbers"))
    # The last number that increases: one that stays, such as a camera's, is none of a frame.
    for place in range(1, min(map(len, digits)) + 1):
        numbers = [int(found[-place]) for found in digits]
        steps = [after - before for before, after in pairwise(numbers)]
        if min(steps) > 0:
            return _frames(numbers, steps)
    return Numbering(counted, [], _order("have numbers that do not increase"))


def _frames(numbers: list[int], steps: list[int]) -> Numbering:
    """The numbers of frames; a jump counts as one step."""
    stride = math.gcd(*steps)
    usual = [step for step in steps if step <= (_MAX_GAP + 1) * stride]
    if len(usual) * 2 >= len(steps):
        # Two recordings need not have the offset of a whole step.
        stride = math.gcd(*usual)
    relative = [1]
    jumps = list[tuple[int, int]]()
    for (before, after), step in zip(pairwise(numbers), steps, strict=True):
        if step > (_MAX_GAP + 1) * stride:
            jumps.append((before, after))
            step = stride
        relative.append(relative[-1] + step // stride)
    if relative[-1] > _MAX_SPACING * len(numbers) or len(jumps) * 2 > len(steps):
        return Numbering(
            list(range(1, len(numbers) + 1)), [], _order("have numbers far from each other")
        )
    if not jumps:
        return Numbering(relative, [])
    before, after = jumps[0]
    more = f" and {len(jumps) - 1} more jumps" if len(jumps) > 1 else ""
    note = (
        f"the numbers in the names of the images jump from {before} to {after}{more}: taken as the"
        " next frame"
    )
    return Numbering(relative, [], note)


def _order(why: str) -> str:
    return f"the names of the images {why}: they only tell the order, without gaps"


def _times(stems: Sequence[str]) -> list[float]:
    """Seconds since the first name; empty if not all names have times that increase."""
    for read in (_clock, _epoch):
        found = list[tuple[int, int]]()
        for stem in stems:
            stamp = read(stem)
            if stamp is None:
                break
            found.append(stamp)
        if len(found) == len(stems) and all(a < b for a, b in pairwise(found)):
            (second, part) = found[0]
            # Whole numbers first: seconds since 1970 with nanoseconds are no exact floats.
            return [(s - second) + (p - part) / 1e9 for s, p in found]
    return []


def _clock(stem: str) -> tuple[int, int] | None:
    """Seconds since 1970 and nanoseconds of a date with a time of day; None for other names."""
    for match in _CLOCK.finditer(stem):
        year, month, day, hour, minute, second = map(int, match.groups()[:6])
        try:
            at = datetime(year, month, day, hour, minute, min(second, 59), tzinfo=UTC)
        except ValueError:
            continue
        if second <= 60:
            return int(at.timestamp()) + second - at.second, int((match[7] or "").ljust(9, "0"))
    return None


def _epoch(stem: str) -> tuple[int, int] | None:
    """Seconds since 1970 and nanoseconds of a number; None for other names."""
    for match in _EPOCH.finditer(stem):
        if _PLAUSIBLE[0] <= int(match[1]) <= _PLAUSIBLE[1]:
            return int(match[1]), int((match[2] or match[3] or "").ljust(9, "0"))
    return None
