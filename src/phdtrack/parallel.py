"""Pieces of work shared out to processes of this machine, or to a cluster by Ray: what fails takes
no other piece along.

Work and results must be of classes and functions that a fresh interpreter can import.
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
# Pieces that a cluster is given at once, at most: each is asked after whenever one is done.
_WINDOW = 1000


@dataclass(frozen=True, slots=True)
class Failed:
    """Why a piece of work has no result, in a sentence."""

    reason: str


def outcomes(
    work: Sequence[Callable[[], T]], jobs: int, *, apart: bool = False
) -> Iterator[tuple[int, T | Failed]]:
    """The number (from 0) and the result of each piece of work, as they come.

    Each process has a pool of its own: one that dies fails its own piece, and another takes its
    place.

    Parameters
    ----------
    work : what is to be done.
    jobs : processes; with 1, or a single piece, this one does it, unless ``apart``.
    apart : nothing is done by this process, so that it outlives whatever happens.
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
        # None of them has anything to do any more, but after Ctrl-C.
        for process in set(multiprocessing.active_children()) - before:
            process.kill()
        for pool in (*idle, *(pool for _, pool in running.values())):
            pool.shutdown(cancel_futures=True)


def on_ray(
    work: Sequence[Callable[[], T]], jobs: int, address: str
) -> Iterator[tuple[int, T | Failed]]:
    """As `outcomes`, by the machines of a Ray cluster. A piece whose machine or process died is
    tried again, three times. Raises `InputError` where Ray is not installed, or there is no
    cluster.

    Parameters
    ----------
    work : what is to be done; each piece is given a CPU.
    jobs : pieces that are under way at once, at most; 0: as many as the cluster has CPUs for.
    address : of the cluster, as Ray has it: ``auto``, ``HOST:PORT``, ``ray://HOST:PORT``; ``local``
        begins one here.
    """
    ray = needed("ray")
    try:
        ray.init(address=address, log_to_driver=False, configure_logging=False)
    except (ConnectionError, OSError, RuntimeError, ValueError) as error:
        first = str(error).partition("\n")[0]
        cure = (
            "Start one (`ray start --head`), or say --address HOST:PORT, or local for one on this"
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
        # What is still under way ends with its driver.
        ray.shutdown()


def _begin() -> None:
    """A process that was started: Ctrl-C is for its parent, and without that it ends, too."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, name="phdtrack parent", daemon=True).start()


def _tried(piece: Callable[[], T]) -> T | Failed:
    """The result, or why there is none. Ctrl-C goes through, also where compiled code has turned it
    into another error.
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
