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
    """What was compiled so far by this process, in order: seconds of processor time of each kernel.

    ``kernels``: its own, without those of kernels that it calls; ``whole``: with them, of those not compiled on behalf of
    another, by ``module.function``. Parts of Numba itself that a kernel uses count as its own: they are what it costs.
    """

    kernels: dict[str, float] = field(default_factory=dict)
    whole: dict[str, float] = field(default_factory=dict)

    @property
    def seconds(self) -> float:
        """Of all together."""
        return sum(self.kernels.values())


@dataclass(slots=True)
class _Begun:
    """A function that is being compiled; ``within``: seconds of the kernels compiled on its behalf."""

    name: str
    path: str
    ours: bool
    clock: float = field(default_factory=time.thread_time)
    within: float = 0.0


# Numba has no types.
class _Listener(event.Listener):  # type: ignore[misc]
    """Adds up. Numba compiles one function at a time, and those that it calls in between."""

    def __init__(self, into: Compiled, begun: Callable[[], None]) -> None:
        self._into, self._begun = into, begun
        self._stack: list[_Begun] = []

    def on_start(self, event: event.Event) -> None:
        """A function begins to be compiled."""
        function = event.data["dispatcher"].py_func
        ours = function.__module__.startswith("phdtrack.")
        if ours and not self._into.kernels and not self._stack:
            self._begun()
        path = f"{function.__module__.rpartition('.')[2]}.{function.__name__}"
        self._stack.append(_Begun(function.__name__, path, ours))

    def on_end(self, event: event.Event) -> None:
        """It has been compiled."""
        ended = self._stack.pop()
        passed = time.thread_time() - ended.clock
        if ended.ours:
            kernels = self._into.kernels
            kernels[ended.name] = kernels.get(ended.name, 0.0) + passed - ended.within
        if not self._stack:
            whole = self._into.whole
            whole[ended.path] = whole.get(ended.path, 0.0) + passed
        else:
            self._stack[-1].within += passed if ended.ours else ended.within


@contextmanager
def watched(begun: Callable[[], None]) -> Iterator[Compiled]:
    """While this lasts, count the kernels compiled in any thread; ``begun`` is called once, before the first one is."""
    compiled = Compiled()
    with event.install_listener("numba:compile", _Listener(compiled, begun)):
        yield compiled
