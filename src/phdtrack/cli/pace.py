"""How long frames take, those aside in which kernels were compiled or loaded: these are the price of a start."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from numba.core import event


# Numba has no types.
class _Listener(event.Listener):  # type: ignore[misc]
    """Counts how often a kernel met arguments of new types: to load or to compile it Numba takes a lock."""

    def __init__(self) -> None:
        self.times = 0

    def on_start(self, event: event.Event) -> None:
        """The lock is taken."""
        self.times += 1

    def on_end(self, event: event.Event) -> None:
        """It is given back."""


@dataclass(slots=True)
class Pace:
    """``seconds`` of wall time that frames took in which nothing was compiled or loaded; ``left_out``: the other frames."""

    seconds: float = 0.0
    left_out: int = 0
    _listener: _Listener = field(default_factory=_Listener)
    _before: int = 0
    _clock: float = field(default_factory=time.perf_counter)

    def frame(self) -> None:
        """A frame is done; the next one begins."""
        now, times = time.perf_counter(), self._listener.times
        if times == self._before:
            self.seconds += now - self._clock
        else:
            self.left_out += 1
        self._clock, self._before = now, times


@contextmanager
def paced() -> Iterator[Pace]:
    """From now on, until it ends."""
    pace = Pace()
    with event.install_listener("numba:compiler_lock", pace._listener):
        yield pace
