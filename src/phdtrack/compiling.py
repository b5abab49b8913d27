"""Says when kernels are really compiled, and measures how long that takes: Numba reports it, so nothing has to be guessed.

Compiling happens where a kernel meets arguments of new types and is not found on disk (see `kernels.cache`): on first use,
after an upgrade, on another machine. Loading from disk is no compiling and is not reported.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from numba.core import event


@dataclass(slots=True)
class Compiled:
    """What was compiled so far: names of kernels in the order in which they were begun, and seconds of all together."""

    kernels: list[str] = field(default_factory=list)
    seconds: float = 0.0


class _Listener(event.Listener):  # type: ignore[misc]
    """Counts; a kernel that is compiled on behalf of another one is inside that one's time."""

    def __init__(self, into: Compiled, begun: Callable[[], None]) -> None:
        self._into, self._begun = into, begun
        self._depth, self._clock = 0, 0.0

    def on_start(self, event: event.Event) -> None:
        """A kernel begins to be compiled."""
        if not self._into.kernels:
            self._begun()
        if not self._depth:
            self._clock = time.perf_counter()
        self._depth += 1
        self._into.kernels.append(event.data["dispatcher"].py_func.__qualname__)

    def on_end(self, event: event.Event) -> None:
        """It has been compiled."""
        self._depth -= 1
        if not self._depth:
            self._into.seconds += time.perf_counter() - self._clock


@contextmanager
def watched(begun: Callable[[], None]) -> Iterator[Compiled]:
    """While this lasts, count what is compiled in any thread; ``begun`` is called once, before the first kernel is."""
    compiled = Compiled()
    with event.install_listener("numba:compile", _Listener(compiled, begun)):
        yield compiled
