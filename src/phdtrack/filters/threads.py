"""Ranges of work on threads. Kernels release the interpreter's lock, and their results do not depend on the division."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import TypeVar

T = TypeVar("T")


@lru_cache(maxsize=4)
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="phdtrack")


def in_ranges(work: Callable[[int, int], T], count: int, threads: int) -> list[T]:
    """``work(lo, hi)`` over ranges that cover 0 … count, in their order; ``threads`` 0 means one per core."""
    threads = threads or os.cpu_count() or 1
    if threads == 1 or count < 2 * threads:
        return [work(0, count)]
    # More ranges than threads, because blocks differ in what they cost.
    edges = [count * i // (4 * threads) for i in range(4 * threads + 1)]
    return list(_pool(threads).map(work, edges[:-1], edges[1:]))
