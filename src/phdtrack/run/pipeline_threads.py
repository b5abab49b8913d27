"""Stages of a pipeline in threads: decoding, detection, tracking and drawing overlap."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import TypeVar

# Items under way: one being made, one ready, one to even out stages whose pace varies.
DEPTH = 3
# Seconds that a stage which was stopped may take to end what it does.
_PATIENCE = 0.7
T = TypeVar("T")


@contextmanager
def ahead(items: Iterable[T], depth: int = DEPTH) -> Iterator[Iterator[T]]:
    """The same items in the same order, made by a thread of their own while earlier ones are used.

    The thread begins when the first item is asked for. An error of a stage is raised in the loop
    after the items before it. When the block is left, by an error or Ctrl-C too, the stage is
    stopped, and waited for a while: nothing still runs or holds a file afterwards, except a read
    that hangs. At most ``depth`` items are being made or wait to be used.
    """
    iterator = iter(items)
    ended = threading.Event()
    # Items, and the error after the last of them; a slot for each item that may be under way.
    made = queue.SimpleQueue[tuple[T | None, BaseException | None]]()
    slots = threading.Semaphore(depth)

    def stage() -> None:
        error: BaseException | None = StopIteration()
        try:
            while slots.acquire() and not ended.is_set():
                made.put((next(iterator), None))
        except BaseException as stop:
            error = stop
        finally:
            if isinstance(iterator, Generator):
                # Here and not by the garbage collector: files are closed by the thread that used
                # them.
                iterator.close()
            made.put((None, error))

    def results() -> Iterator[T]:
        # Not before: what a detector learns of a scene and the decoder of its frames would be in
        # memory at the same time.
        thread.start()
        while True:
            item, error = made.get()
            if item is not None:
                slots.release()
                yield item
                continue
            if error is not None and not isinstance(error, StopIteration):
                raise error
            return

    thread = threading.Thread(target=stage, name="phdtrack stage", daemon=True)
    try:
        yield results()
    finally:
        ended.set()
        slots.release()
        if thread.ident is not None:
            thread.join(_PATIENCE)


@contextmanager
def beside(work: Callable[[], object]) -> Iterator[None]:
    """Do what the block will need in a thread of its own, from the beginning of the block on.

    An error of the work is dropped: the block meets it itself where it needs the result. When the
    block is left, by an error or Ctrl-C too, the work is waited for a while.
    """

    def stage() -> None:
        with suppress(Exception):
            work()

    thread = threading.Thread(target=stage, name="phdtrack beside", daemon=True)
    thread.start()
    try:
        yield
    finally:
        thread.join(_PATIENCE)
