"""The times of frames: what the stamps of a file mean, and which frame is shown at which time.

A frame's time is its stamp, in seconds since the first frame. `settled` turns stamps into times
that grow from frame to frame, and decides about stamps that cannot be right. `Clock` keeps the
times of a sequence, for everything that has frame numbers and needs seconds.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from phdtrack.types import F8

Item = TypeVar("Item")
# Frames that are waited for before a stamp that looks wrong is judged.
_AHEAD = 8
# A step is ordinary up to this many usual ones; the usual one is the median of the last steps.
_ORDINARY = 4.0
_STEPS = 9
# Seconds by which the very first or last frame may be away, however short the rest is.
_AWAY = 60.0
# Seconds of the shortest step between two frames.
_SHORTEST = 1e-6
# From so many frames on the length of a sequence says something.
_FEW = 3


@dataclass(frozen=True, slots=True, eq=False)
class Clock:
    """The times of the frames of a sequence.

    Attributes
    ----------
    frame, seconds : (K,) float64, numbers from 1 and times, both ascending; K ≥ 1. Times between
        two of them are interpolated.
    rate : frames per second before the first and after the last of them.
    """

    frame: F8
    seconds: F8
    rate: float

    @classmethod
    def constant(cls, rate: float) -> Clock:
        """The clock of frames at a constant rate, the first at 0 s; ``rate`` per second, above
        0.
        """
        return cls(np.ones(1), np.zeros(1), rate)

    @classmethod
    def of(cls, frame: ArrayLike, seconds: ArrayLike, rate: float) -> Clock:
        """The clock that is known at some frames, which may repeat; constant without any.

        Parameters
        ----------
        frame, seconds : (K,) numbers and times.
        rate : frames per second where they say nothing.
        """
        numbers, first = np.unique(np.asarray(frame, np.float64), return_index=True)
        if not len(numbers):
            return cls.constant(rate)
        return cls(numbers, np.asarray(seconds, np.float64)[first], rate)

    def times(self, frame: ArrayLike) -> F8:
        """(n,) seconds of the frames with these numbers (n,), whole or not."""
        number = np.asarray(frame, np.float64)
        known = np.interp(number, self.frame, self.seconds)
        before = np.minimum(number - self.frame[0], 0.0)
        after = np.maximum(number - self.frame[-1], 0.0)
        found: F8 = known + (before + after) / self.rate
        return found

    def time(self, frame: float) -> float:
        """Seconds of a frame."""
        return float(self.times([frame])[0])

    def passed(self, frames: range) -> float:
        """Seconds from the first of these frames up to that after the last one."""
        return self.time(frames.stop) - self.time(frames.start)

    def frame_at(self, seconds: float) -> int:
        """The frame that is shown at a time: the last one that is not later, at least 1."""
        # Rounding of times must not show the frame before.
        return max(1, int(np.floor(self.number_at(seconds + 1e-6))))

    def number_at(self, seconds: float) -> float:
        """The number of the frame at a time, with the part of the interval that has passed since
        it.
        """
        before = min(seconds - self.seconds[0], 0.0)
        after = max(seconds - self.seconds[-1], 0.0)
        known = float(np.interp(seconds, self.seconds, self.frame))
        return known + float(before + after) * self.rate


def as_clock(fps: float | Clock) -> Clock:
    """The clock that frames per second, or a clock, stand for."""
    if isinstance(fps, Clock):
        return fps
    return Clock.constant(fps)


class _Read(NamedTuple):
    """A frame's number, and its stamp in seconds; None if it has none."""

    number: int
    stamp: float | None


def settled(
    reads: Iterable[tuple[int, float | None, Item]],
    interval: float,
    doubted: list[tuple[int, float]] | None = None,
) -> Iterator[tuple[int, float, Item]]:
    """Frames with the times that their stamps mean: seconds since the first, growing.

    The order of the stamps is the evidence. A step ahead that later stamps keep is a pause. If they
    go back behind it, that stamp is wrong. If all later stamps are smaller than those before, a
    second recording begins: time goes on after one usual interval. A frame whose stamp is missing,
    repeated or wrong comes one usual interval after the frame before it, or earlier if the next
    frame demands it. A few frames are held back while that is open, otherwise none.

    Parameters
    ----------
    reads : numbers, stamps in seconds (None: it has none), and anything else.
    interval : seconds between two frames that are usual at the beginning.
    doubted : gets the number and the stamp of each frame whose stamp was not believed.
    """
    stamps = _Stamps(interval, [] if doubted is None else doubted)
    reads_held = deque[_Read]()
    items = deque[Item]()
    for number, stamp, item in reads:
        reads_held.append(_Read(number, stamp))
        items.append(item)
        while reads_held and stamps.decides(reads_held):
            yield reads_held[0].number, stamps.next(reads_held), items.popleft()
            reads_held.popleft()
    while reads_held:
        yield reads_held[0].number, stamps.next(reads_held, end=True), items.popleft()
        reads_held.popleft()


class _Stamps:
    """Judges one stamp after the other.

    Parameters
    ----------
    interval : seconds between two frames that are usual at the beginning.
    doubted : gets the frames whose stamps are not believed.
    """

    def __init__(self, interval: float, doubted: list[tuple[int, float]]) -> None:
        self._doubted = doubted
        self._steps = deque([interval], maxlen=_STEPS)
        # The time of the last frame, and number and stamp of the last one whose stamp was believed.
        self._time = -interval
        self._believed: _Read | None = None
        self._zero = 0.0
        # True while frames come without stamps.
        self._silent = False
        self._count = 0

    def decides(self, held: Sequence[_Read]) -> bool:
        """True if enough frames are held to judge the first of them."""
        first = held[0]
        if len(held) > _AHEAD or (first.stamp is None and self._silent):
            return True
        if self._believed is None:
            return len(held) > 1 and self._ordinary(first, held[1])
        return self._ordinary(self._believed, first)

    def next(self, held: Sequence[_Read], *, end: bool = False) -> float:
        """The time of the first frame that is held, which is then the last one; at the ``end``
        nothing follows those that are held.
        """
        time = self._judged(held, end)
        self._time = time
        self._count += 1
        return time

    def _judged(self, held: Sequence[_Read], end: bool) -> float:
        """The time of the first frame that is held."""
        first = held[0]
        usual = max(float(np.median(self._steps)), _SHORTEST)
        before = self._believed
        if before is not None and self._ordinary(before, first):
            return self._time_of(first, usual)
        place, length = _line(held, before)
        alone = self._alone_before(held) or (end and self._alone_behind(held))
        if place == 0 and not alone:
            return self._time_of(first, usual)
        if before is not None and length <= 1 and place != 0:
            start, later = _line(held, None)
            if start == 0 and later > length + 1:
                # Another recording begins.
                self._zero = (first.stamp or 0.0) - (self._time + usual)
                self._believed = first
                return self._time + usual
        if first.stamp is not None:
            self._doubted.append((first.number, first.stamp))
        self._silent = all(one.stamp is None for one in held)
        if place > 0 and before is not None:
            left = (held[place].stamp or 0.0) - self._zero - self._time
            if left > _SHORTEST * (place + 1):
                return self._time + min(usual, left / (place + 1))
        return self._time + usual

    def _time_of(self, read: _Read, usual: float) -> float:
        """The time of a frame whose stamp is believed."""
        stamp = read.stamp or 0.0
        before = self._believed
        time = stamp - self._zero
        if before is None or not time >= self._time + _SHORTEST:
            time = self._time + usual
            self._zero = stamp - time
        if before is not None:
            self._steps.append((stamp - (before.stamp or 0.0)) / (read.number - before.number))
        self._believed = read
        self._silent = False
        return time

    def _ordinary(self, before: _Read, after: _Read) -> bool:
        """True if the step between two stamps is like those before."""
        if before.stamp is None or after.stamp is None:
            return False
        step = after.stamp - before.stamp
        most = _ORDINARY * float(np.median(self._steps)) * (after.number - before.number)
        return 0 < step <= most

    def _alone_before(self, held: Sequence[_Read]) -> bool:
        """True if the very first stamp is further away from the next ones than they take."""
        known = [one.stamp for one in held if one.stamp is not None]
        if self._count or len(known) <= _FEW:
            return False
        return known[1] - known[0] > max(_AWAY, known[-1] - known[1])

    def _alone_behind(self, held: Sequence[_Read]) -> bool:
        """True if the very last stamp is further ahead than all before it took."""
        if len(held) > 1 or self._count < _FEW or self._believed is None:
            return False
        ahead = (held[0].stamp or 0.0) - (self._believed.stamp or 0.0)
        return ahead > max(_AWAY, self._time)


def _line(held: Sequence[_Read], after: _Read | None) -> tuple[int, int]:
    """The longest line of growing stamps: where it begins among the frames, −1 for none, and its
    length. Of two the one that begins earlier in time.

    Parameters
    ----------
    held : frames.
    after : only stamps that are later than that of this frame count; None: all.
    """
    lowest = -np.inf
    if after is not None and after.stamp is not None:
        lowest = after.stamp
    best = (0, 0.0, -1)
    lengths = [0] * len(held)
    for k in range(len(held) - 1, -1, -1):
        stamp = held[k].stamp
        if stamp is None or not stamp > lowest:
            continue
        following = [
            lengths[j] for j in range(k + 1, len(held)) if lengths[j] and _stamp(held[j]) > stamp
        ]
        lengths[k] = 1 + max(following, default=0)
        best = max(best, (lengths[k], -stamp, k))
    return best[2], best[0]


def _stamp(read: _Read) -> float:
    """The stamp of a frame that has one."""
    assert read.stamp is not None
    return read.stamp
