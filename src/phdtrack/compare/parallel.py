"""Work shared out to processes, so that none of it can take the rest along.

Every process has its own pipe and works on one thing at a time: one that dies, of memory for example, is missed at once,
what it worked on is told as failed, and another process takes its place. Ctrl-C ends them all.
"""

from __future__ import annotations

import multiprocessing
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnContext, SpawnProcess
from types import FrameType
from typing import Generic, NoReturn, TypeVar

from phdtrack.errors import InputError, interrupted

T = TypeVar("T")
# Seconds that a process has to tidy up before it is killed.
_PATIENCE = 5.0


@dataclass(frozen=True, slots=True)
class Failed:
    """Why a piece of work came to nothing, in a sentence."""

    reason: str


def outcomes(work: Sequence[Callable[[], T]], jobs: int) -> Iterator[tuple[int, T | Failed]]:
    """The number (from 0) and the result of each piece of work, as they come, by ``jobs`` processes; with 1 by this one.

    Work and results go through pipes, so both must be of classes and functions that a fresh interpreter can import.
    """
    if min(jobs, len(work)) > 1:
        yield from _shared(work, min(jobs, len(work)))
        return
    for number, piece in enumerate(work):
        yield number, _tried(piece)


def _tried(piece: Callable[[], T]) -> T | Failed:
    """The result, or why there is none. Ctrl-C goes through, whatever compiled code has made of it."""
    try:
        return piece()
    except Exception as error:
        if interrupted(error):
            raise KeyboardInterrupt from error
        if isinstance(error, InputError):
            return Failed(str(error))
        first = str(error).partition("\n")[0]
        return Failed(f"{type(error).__name__}: {first}" if first else type(error).__name__)


@dataclass(slots=True)
class _Worker(Generic[T]):
    """A process, our end of its pipe, and the number of what it works on."""

    process: SpawnProcess
    pipe: Connection
    number: int

    def give(self, number: int, piece: Callable[[], T]) -> None:
        """The next piece of work."""
        self.number = number
        self.pipe.send(piece)

    def taken(self) -> T | Failed:
        """Its result; why there is none, where the process has died."""
        try:
            result: T | Failed = self.pipe.recv()
        except (EOFError, OSError):
            self.process.join()
            return Failed(f"its process ended with status {self.process.exitcode} (out of memory?)")
        return result

    def end(self) -> None:
        """Stop it, whatever it does: it may tidy up, and is killed where that takes long."""
        self.process.terminate()
        self.process.join(_PATIENCE)
        self.process.kill()
        self.process.join()
        self.pipe.close()


def _started(context: SpawnContext, number: int, piece: Callable[[], T]) -> _Worker[T]:
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs,), daemon=True)
    process.start()
    # While we hold the other end too, a process that dies would not end the pipe.
    theirs.close()
    worker: _Worker[T] = _Worker(process, ours, number)
    worker.give(number, piece)
    return worker


def _shared(work: Sequence[Callable[[], T]], jobs: int) -> Iterator[tuple[int, T | Failed]]:
    context, waiting = multiprocessing.get_context("spawn"), iter(enumerate(work))
    workers: list[_Worker[T]] = []
    try:
        workers.extend(_started(context, *next(waiting)) for _ in range(jobs))
        while workers:
            ready = wait([worker.pipe for worker in workers])
            for worker in [worker for worker in workers if worker.pipe in ready]:
                number, result = worker.number, worker.taken()
                following = next(waiting, None)
                if following is None or not worker.process.is_alive():
                    worker.end()
                    workers.remove(worker)
                    if following is not None:
                        workers.append(_started(context, *following))
                else:
                    worker.give(*following)
                yield number, result
    finally:
        for worker in workers:
            worker.end()


def _ended(number: int, frame: FrameType | None) -> NoReturn:
    sys.exit(128 + number)


def _serve(pipe: Connection) -> None:
    """A process's life: work until the pipe ends. Ctrl-C is the parent's business, who ends us then.

    An end is an exception here, so that nothing half-written stays behind.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _ended)
    while True:
        try:
            pipe.send(_tried(pipe.recv()))
        except (EOFError, OSError):
            # Nobody is there any more to give work or to take results.
            return
