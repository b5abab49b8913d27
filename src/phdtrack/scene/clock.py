"""Which mode of a scene it is by time of day."""

from __future__ import annotations

import re
from dataclasses import dataclass

from phdtrack.errors import InputError

_DAY = 24 * 60 * 60.0
_TIME = re.compile(r"([01]?\d|2[0-3]):([0-5]\d)(?::([0-5]\d))?")


@dataclass(frozen=True, slots=True)
class Clock:
    """Times of day in seconds since midnight, ascending (``begins``), at each of which a mode (``names``) begins.

    ``start`` is the time of day at which the video's seconds begin.
    """

    begins: tuple[float, ...] = ()
    names: tuple[str, ...] = ()
    start: float = 0.0

    def name(self, seconds: float) -> str:
        """The mode at ``seconds`` of the video. Before the first time of a day it is that of the day before."""
        now = (self.start + seconds) % _DAY
        return self.names[sum(begin <= now for begin in self.begins) - 1]


def clock(schedule: str, start: str) -> Clock:
    """From ``07:30 day, 19:00 night``, and the time of day at which the video begins, as ``14:05:30``.

    Raises
    ------
    InputError : what is no schedule or no time, or two modes that begin at the same time.
    """
    begin = _seconds(start, "learn.starts")
    parts = [line.split(maxsplit=1) for line in schedule.split(",") if line.strip()]
    if any(len(part) != 2 for part in parts):
        raise InputError(f"expected times with names, as 07:30 day, 19:00 night, got {schedule!r}", where="learn.schedule")
    times = sorted((_seconds(time, "learn.schedule"), name.strip()) for time, name in parts)
    begins, names = tuple(time for time, _ in times), tuple(name for _, name in times)
    if len(set(begins)) < len(begins):
        raise InputError(f"two modes begin at the same time in {schedule!r}", where="learn.schedule")
    return Clock(begins, names, begin)


def _seconds(text: str, where: str) -> float:
    found = _TIME.fullmatch(text)
    if found is None:
        raise InputError(f"expected a time of day as 07:30 or 07:30:00, got {text!r}", where=where)
    hours, minutes, seconds = (int(part or 0) for part in found.groups())
    return 3600.0 * hours + 60.0 * minutes + seconds
