"""Clocks: medians with quartiles of many repeats, and comparisons whose sides take turns.

A machine that others use is fast one second and slow the next. So whatever is compared is measured
in turns within one run, and the ratio is that of medians over the same stretch of time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

F8 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Spread:
    """Median, quartiles and least of ``count`` values."""

    median: float
    low: float
    high: float
    least: float
    count: int

    @classmethod
    def of(cls, values: Sequence[float] | F8, unit: float = 1.0) -> Spread:
        """Return quartiles of ``values`` times ``unit`` (1e3 turns seconds into milliseconds)."""
        array = unit * np.asarray(values, dtype=np.float64)
        low, median, high = np.percentile(array, [25, 50, 75])
        return cls(float(median), float(low), float(high), float(array.min()), len(array))

    def as_dict(self) -> dict[str, float]:
        """For JSON."""
        return asdict(self)


# Seconds by the clock on the wall, and of processor time that this thread was given: others on the
# machine lengthen only the first. Of several threads the second knows only one.
Took = tuple[float, float]


def clock() -> Took:
    """The two clocks."""
    return time.perf_counter(), time.thread_time()


def took(began: Took, ended: Took) -> Took:
    """Seconds between two readings."""
    return ended[0] - began[0], ended[1] - began[1]


def seconds(call: Callable[[], Any], repeats: int, warm_up: int = 1) -> F8:
    """(repeats,) seconds of each call, after ``warm_up`` calls that do not count."""
    for _ in range(warm_up):
        call()
    out = np.empty(repeats)
    for i in range(repeats):
        began = time.perf_counter()
        call()
        out[i] = time.perf_counter() - began
    return out


def in_turns(calls: Sequence[Callable[[], Any]], repeats: int, warm_up: int = 1) -> list[F8]:
    """For each call its (repeats,) seconds; the calls take turns, so that all see the same
    machine.
    """
    for _ in range(warm_up):
        for call in calls:
            call()
    out = [np.empty(repeats) for _ in calls]
    for i in range(repeats):
        for spent, call in zip(out, calls, strict=True):
            began = time.perf_counter()
            call()
            spent[i] = time.perf_counter() - began
    return out


def exponent(sizes: Sequence[float], times: Sequence[float]) -> float:
    """e of the least-squares fit times ∝ sizes^e, on logarithms; NaN of fewer than two sizes."""
    if len(sizes) < 2:
        return float("nan")
    return float(np.polyfit(np.log(sizes), np.log(times), 1)[0])
