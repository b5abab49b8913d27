"""A few items spread evenly over a stream whose length nobody knows, in one pass and bounded memory.

Items whose index is a multiple of the stride are kept. When more than the capacity are held, every other one is dropped
and the stride doubles. No randomness: the same stream keeps the same items. After n items the stride is the smallest power
of two that leaves at most ``capacity`` of them, so at least half the capacity is held once n reaches the capacity.
"""

from __future__ import annotations

from typing import Generic, TypeVar

import numpy as np

T = TypeVar("T")


class Spread(Generic[T]):
    """Keeps at most ``capacity`` of the items offered to it, spread evenly over all of them."""

    def __init__(self, capacity: int) -> None:
        self._capacity = max(1, capacity)
        self._stride = 1
        self._kept: list[tuple[int, T]] = []

    def wants(self, index: int) -> bool:
        """Whether item ``index`` (from 1, ascending) would be kept: ask before making an expensive item."""
        return index % self._stride == 0

    def put(self, index: int, item: T) -> None:
        """Offer item ``index`` (from 1, ascending)."""
        if not self.wants(index):
            return
        self._kept.append((index, item))
        while len(self._kept) > self._capacity:
            self._stride *= 2
            self._kept = [pair for pair in self._kept if self.wants(pair[0])]

    @property
    def items(self) -> tuple[T, ...]:
        """Everything held, in the order of the stream."""
        return tuple(item for _, item in self._kept)


def evenly(items: tuple[T, ...], count: int) -> tuple[T, ...]:
    """At most ``count`` of the items, evenly spaced, the last one among them."""
    if len(items) <= count:
        return items
    if count <= 0:
        return ()
    index = np.linspace(len(items), 0, count, endpoint=False)[::-1].round().astype(int) - 1
    return tuple(items[i] for i in index)
