"""Overload of a camera: more pictures arrive than the machine tracks."""

from __future__ import annotations

import threading
from collections import deque
from typing import NamedTuple

# Seconds over which it is judged; shares of dropped pictures above which an overload begins, and
# below which it ends, so that a load between them is not reported again and again; the fewest
# pictures that say something; seconds between two samples.
WINDOW = 30.0
_BEGINS = 0.5
_ENDS = 0.4
_FEWEST = 10
_EVERY = 1.0


class Load(NamedTuple):
    """Numbers of pictures up to a time, which only grow.

    Attributes
    ----------
    time : seconds on any clock.
    arrived, dropped, tracked : pictures that the camera sent, that newer ones replaced, and that
        were tracked.
    """

    time: float
    arrived: int
    dropped: int
    tracked: int


class Overload:
    """Judges by the last `WINDOW` seconds whether most pictures are dropped. Threads may share it.

    Parameters
    ----------
    now : the time, on the clock of `update`.
    """

    def __init__(self, now: float) -> None:
        self.tracked = now
        """When a picture was tracked last, or the camera was started."""
        self._samples = deque[Load]()
        self._lock = threading.Lock()
        self._sentence = ""

    def update(self, now: Load) -> str:
        """Take in the present numbers; a sentence while most pictures are dropped, empty otherwise.

        The sentence has the figures of the beginning and stays the same until the overload ends.
        """
        with self._lock:
            samples = self._samples
            if not samples or now.time >= samples[-1].time + _EVERY:
                samples.append(now)
            while len(samples) > 1 and samples[1].time <= now.time - WINDOW:
                samples.popleft()
            if now.time - samples[0].time >= WINDOW:
                self._judge(samples[0], now)
            return self._sentence

    def _judge(self, first: Load, last: Load) -> None:
        """Begin or end the overload by what happened between two times."""
        seconds = last.time - first.time
        arrived = last.arrived - first.arrived
        share = 0.0
        if arrived >= _FEWEST:
            share = (last.dropped - first.dropped) / arrived
        if share < _ENDS:
            self._sentence = ""
        elif share > _BEGINS and not self._sentence:
            tracked = _rate(last.tracked - first.tracked, seconds)
            self._sentence = (
                f"{100 * share:.0f} % of the pictures are dropped: the machine is too slow"
                f" ({tracked} of {_rate(arrived, seconds)} pictures a second are tracked)"
            )


def _rate(count: int, seconds: float) -> str:
    """A number a second, with a digit behind the point if it is small."""
    rate = count / seconds
    return f"{rate:.1f}" if rate < 9.95 else f"{rate:.0f}"
