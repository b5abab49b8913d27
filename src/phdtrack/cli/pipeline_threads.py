"""Stages that overlap: each runs ahead of the next in a thread of its own, by a bounded number of items.

    with ahead(source) as frames, ahead(detected(frames)) as found:
        for frame, detections in found:
            ...

Decoding, detecting, drawing and encoding are C code that lets other threads run, so the slowest stage alone decides how fast
the whole is. Order and values are those of the plain loop: each stage is one thread and one iterator, whatever it remembers.

*Memory.* A stage takes a place before it makes an item, and the place is free again once the next stage has taken the item.
So at most ``depth`` items are under way between two stages, however long the source is.

*Errors.* What a stage raises is raised again in the loop, the same object, after the items that came before it. When the
block is left, by an error or Ctrl-C too, the stages are told to stop and waited for, the last one first: nothing still runs
or holds a file afterwards. Items that were made and not taken are dropped.
"""

from __future__ import annotations

import threading
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from queue import SimpleQueue
from typing import Generic, TypeVar

T = TypeVar("T")
DEPTH = 3
"""Items under way: one being made, one ready, and one to even out stages whose pace varies."""


@dataclass(frozen=True, slots=True)
class _Ended:
    """The last message of a stage: ``error`` is what ended it, None where the items did."""

    error: BaseException | None = None


@dataclass(frozen=True, slots=True, eq=False)
class _Belt(Generic[T]):
    """What connects the thread of a stage with its taker: places to be filled, items in order, the word to stop."""

    free: threading.Semaphore
    ready: SimpleQueue[tuple[T] | _Ended] = field(default_factory=SimpleQueue)
    stop: threading.Event = field(default_factory=threading.Event)

    def fill(self, items: Iterable[T]) -> None:
        """In the stage's thread: every item, one place each, until they end, one fails, or nobody wants more."""
        try:
            iterator = iter(items)
            try:
                while self._place():
                    self.ready.put((next(iterator),))
            except StopIteration:
                pass
            finally:
                # Here and not by the garbage collector: files are closed by the thread that used them, before it ends.
                if isinstance(iterator, Generator):
                    iterator.close()
        except BaseException as error:  # whatever it is, it belongs to the loop that takes the items
            self.ready.put(_Ended(error))
        else:
            self.ready.put(_Ended())

    def _place(self) -> bool:
        """Wait for a place; False where nothing more is wanted."""
        self.free.acquire()
        return not self.stop.is_set()

    def taken(self) -> Iterator[T]:
        """In the taker's thread: the items in order; raises what ended the stage."""
        while True:
            message = self.ready.get()
            if isinstance(message, _Ended):
                if message.error is not None:
                    raise message.error
                return
            self.free.release()
            yield message[0]


@contextmanager
def ahead(items: Iterable[T], depth: int = DEPTH) -> Iterator[Iterator[T]]:
    """The same items, made by a thread of their own while earlier ones are used; to be gone through once.

    Parameters
    ----------
    items : run through in that thread only, and closed there where it is a generator.
    depth : how many items at most are being made or wait to be taken, at least 1.
    """
    belt: _Belt[T] = _Belt(threading.Semaphore(depth))
    stage = threading.Thread(target=belt.fill, args=(items,), name="phdtrack stage", daemon=True)
    stage.start()
    try:
        yield belt.taken()
    finally:
        belt.stop.set()
        belt.free.release()
        stage.join()
