"""Large arrays whose memory is used again once nobody refers to them any more.

The operating system hands out fresh pages one fault at a time, which for a million particles is thousands of faults a frame.
`empty` gives out memory that an earlier array has left; an array that is still referred to, be it through a view, keeps its
memory, so that states remain values that nobody writes into.
"""

from __future__ import annotations

import weakref

import numpy as np

from phdtrack.types import F4

# Free buffers that are kept, and how much larger than asked for a buffer may be.
KEPT, SLACK = 4, 4


class _Shelf:
    """Buffers that nobody uses, and the references that tell when one is no longer used; by the buffers' ids."""

    def __init__(self) -> None:
        self.free: dict[int, F4] = {}
        self.lent: dict[int, tuple[weakref.ref[F4], F4]] = {}

    def take(self, size: int) -> F4:
        """A float32 array of ``size`` numbers or somewhat more, of any content."""
        fitting = [(held.size, key) for key, held in list(self.free.items()) if size <= held.size <= SLACK * size + 4096]
        # Another thread may have been faster: then there is new memory.
        memory = self.free.pop(min(fitting)[1], None) if fitting else None
        if memory is None:
            # A quarter more, because the number of particles goes up and down.
            memory = np.empty(size + size // 4 + 64, np.float32)
        # Behind a memoryview the array is the base of all its views: when it goes, they all have gone.
        array: F4 = np.frombuffer(memory.data, np.float32)
        key = id(memory)
        self.lent[key] = weakref.ref(array, lambda _: self.take_back(key)), memory
        return array

    def take_back(self, key: int) -> None:
        """The array over this buffer has gone. Runs wherever that happens, so every step is a single one."""
        _, memory = self.lent.pop(key)
        self.free[key] = memory
        if len(self.free) > KEPT:
            self.free.pop(next(iter(list(self.free))), None)


_SHELF = _Shelf()


def empty(rows: int, columns: int) -> F4:
    """(rows, columns) float32, C-contiguous, of any content."""
    size = rows * columns
    return _SHELF.take(size)[:size].reshape(rows, columns)
