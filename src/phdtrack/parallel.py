"""Pieces of work distributed to processes of this machine, or to a cluster by Ray; a failing piece
does not affect others.

Work and results must be of classes and functions that a new interpreter can import.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any, TypeVar

from phdtrack.errors import InputError, interrupted, needed

T = TypeVar("T")
# Most pieces on a cluster at a time: all of them are polled whenever one is done.
_WINDOW = 1000


@dataclass(frozen=True, slots=True)
class Failed:
    """The reason, in a sentence, why a piece of work has no result."""

    reason: str


def outcomes(
    work: Sequence[Callable[[], T]], jobs: int, *, apart: bool = False
) -> Iterator[tuple[int, T | Failed]]:
    """The number (from 0) and the result of each piece of work, as they are completed.

    Each process has its own pool: if it dies, its piece fails, and another process replaces it.

    Parameters
    ----------
    work : functions without arguments.
    jobs : processes; with 1, or a single piece, this process does the work, unless ``apart``.
    apart : do nothing in this process, so that it survives a crash.
    """
    if not apart and min(jobs, len(work)) <= 1:
        yield from enumerate(map(_tried, work))
        return
    context = multiprocessing.get_context("spawn")
    before = set(multiprocessing.active_children())
    left = list(enumerate(work))[::-1]
    idle = [ProcessPoolExecutor(1, context, _begin) for _ in range(min(jobs, len(work)))]
    running: dict[Future[Any], tuple[int, ProcessPoolExecutor]] = {}
    try:
        while left or running:
            while left and idle:
                number, piece = left.pop()
                pool = idle.pop()
                running[pool.submit(_tried, piece)] = number, pool
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                number, pool = running.pop(future)
                died = isinstance(future.exception(), BrokenProcessPool)
                idle.append(ProcessPoolExecutor(1, context, _begin) if died else pool)
                yield (
                    number,
                    Failed("its process died (out of memory?)") if died else future.result(),
                )
    finally:
        # They are idle by now, except after Ctrl-C.
        for process in set(multiprocessing.active_children()) - before:
            process.kill()
        for pool in (*idle, *(pool for _, pool in running.values())):
            pool.shutdown(cancel_futures=True)


def on_ray(
    work: Sequence[Callable[[], T]], jobs: int, address: str
) -> Iterator[tuple[int, T | Failed]]:
    """The results of `outcomes`, from a Ray cluster. A piece whose machine or process died is
    retried three times. Raises `InputError` if Ray is not installed, or there is no cluster.

    Parameters
    ----------
    work : functions without arguments; each gets a CPU.
    jobs : most pieces at a time; 0: as many as the cluster has CPUs.
    address : of the cluster, as Ray has it: ``auto``, ``HOST:PORT``, ``ray://HOST:PORT``; ``local``
        starts one here.
    """
    ray = needed("ray")
    try:
        ray.init(address=address, log_to_driver=False, configure_logging=False)
    except (ConnectionError, OSError, RuntimeError, ValueError) as error:
        first = str(error).partition("\n")[0]
        cure = (
            "Start one (`ray start --head`), or give --address HOST:PORT, or local for one on this"
            " machine."
        )
        raise InputError(
            f"no Ray cluster can be reached ({first})", where=f"--address {address}", cure=cure
        ) from error
    try:
        tried = ray.remote(_tried)
        left = list(enumerate(work))[::-1]
        running = dict[Any, int]()
        while left or running:
            while left and len(running) < (jobs or _WINDOW):
                number, piece = left.pop()
                running[tried.remote(piece)] = number
            for done in ray.wait(list(running))[0]:
                number = running.pop(done)
                try:
                    result = ray.get(done)
                except ray.exceptions.RayError as error:
                    result = Failed(f"its process or machine died ({type(error).__name__})")
                yield number, result
    finally:
        # Pieces that still run end with their driver.
        ray.shutdown()


def _begin() -> None:
    """Prepare a worker process: it ignores Ctrl-C, which its parent handles, and ends with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, name="phdtrack parent", daemon=True).start()


def _tried(piece: Callable[[], T]) -> T | Failed:
    """The result of a piece, or the reason why it failed. Ctrl-C is raised again, even if compiled
    code has turned it into another error.
    """
    try:
        return piece()
    except Exception as error:
        if interrupted(error):
            raise KeyboardInterrupt from error
        if isinstance(error, InputError):
            return Failed(str(error))
        first = str(error).partition("\n")[0]
        return Failed(f"{type(error).__name__}: {first}" if first else type(error).__name__)
