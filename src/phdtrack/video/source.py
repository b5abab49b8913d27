"""What every source of frames has, and the clock that turns time stamps into times that only go forward."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

from phdtrack.errors import InputError
from phdtrack.protocols import Source
from phdtrack.types import Image


class VideoSource(Source, Protocol):
    """A source that also says what it assumed and what went wrong, for the caller to print and to store."""

    @property
    def note(self) -> str:
        """What was assumed because nobody said it (the rate of a folder of images); empty where nothing was."""

    @property
    def problem(self) -> str:
        """After the iteration: why the frames ended early, or which were lost; empty where all were read."""


@dataclass(slots=True)
class Clock:
    """Times in seconds since the first frame, strictly increasing.

    A stamp that is missing, or not later than the one before, counts as one ``interval`` (seconds) after it. A stream
    that jumps back (two recordings joined) goes on from there, with the intervals that its later stamps have.
    """

    interval: float
    _last: float = field(default=0.0, init=False)
    _zero: float | None = field(default=None, init=False)
    _started: bool = field(default=False, init=False)

    def __call__(self, stamp: float | None) -> float:
        """The time of the next frame, whose stamp in seconds is ``stamp``, None where the stream gives none."""
        expected = self._last + self.interval if self._started else 0.0
        time = expected if stamp is None or self._zero is None else stamp - self._zero
        if self._started and time <= self._last:
            time = expected
        if stamp is not None:
            self._zero = stamp - time
        self._last, self._started = time, True
        return time


def check_size(image: Image, width: int, height: int, where: str) -> None:
    """Raise InputError where ``image`` (H, W, 3) is not ``width`` x ``height`` pixels like the first frame."""
    got = (image.shape[1], image.shape[0])
    if got != (width, height):
        raise InputError(
            f"this frame is {got[0]}x{got[1]} pixels, the first one {width}x{height}",
            where=where,
            cure="All frames of a sequence need one size: split the input where the size changes.",
        )
