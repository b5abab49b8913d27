"""The division of clusters that are too heavy: a new centre on the particle farthest from the old one [M07 §3]."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.blocks import Real, load_steps, whole
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import VECTOR
from phdtrack.kernels.nearest import (
    ALIVE,
    APART,
    CENTRE,
    COUNT,
    FARTHEST,
    MASS,
    MOVED,
    NOBODY,
    PARENT,
    STEPS,
    STRAYS,
    squares,
)

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
I4 = NDArray[np.int32]
# A cluster is not divided any more after this many divisions in which one part got less than this share of the split
# mass: its farthest particles were strays, and peeling them off one by one would not end.
PATIENCE, STRAY = 4, 0.05


@njit(**VECTOR)
def find_farthest(
    state: Real, start: I8, known: F8, table: F8, flags: I8, k: int, split: float, blocks: I8, label: I4, own: I4,
    head: I8, link: I8, scratch: Real,
) -> None:  # fmt: skip
    """Of each cluster to divide the particle farthest from its centre: −1 where there is nothing to divide."""
    d, heavy = state.shape[0], False
    out = d + d % 2
    for j in range(k):
        table[j, APART] = 0.0 if table[j, MASS] > split and flags[j, STRAYS] < PATIENCE else np.inf
        flags[j, FARTHEST] = -1
        heavy |= table[j, APART] == 0.0
    for q in range(blocks.size if heavy else 0):
        b, e = blocks[q], head[q]
        begin, n, loaded = start[b], start[b + 1] - start[b], False
        all_of_it = label[b] >= 0
        if label[b] == NOBODY or n == 0 or (all_of_it and table[label[b], APART] == np.inf):
            continue
        while e >= 0:
            j = link[0, e]
            e = link[1, e]
            if table[j, APART] == np.inf or (all_of_it and label[b] != j):
                continue
            if not loaded:
                load_steps(state, begin, n, known, b, scratch)
                loaded = True
            squares(scratch, whole(n), d, table, j, known, b)
            for i in range(n):
                if scratch[out, i] > table[j, APART] and (all_of_it or own[begin + i] == j):
                    table[j, APART], flags[j, FARTHEST] = float(scratch[out, i]), begin + i


@njit(**VECTOR)
def note_strays(began: int, k: int, split: float, table: F8, flags: I8) -> None:
    """Count the divisions from which one part came away with next to nothing while the other is still too heavy."""
    for j in range(began, k):
        i = flags[j, PARENT]
        a, b = table[i, MASS], table[j, MASS]
        if (a > split or b > split) and (a < STRAY * split or b < STRAY * split):
            flags[i, STRAYS] += 1
            flags[j, STRAYS] = flags[i, STRAYS]


@njit(**VECTOR)
def begin_cluster(j: int, parent: int, flags: I8) -> None:
    """An empty cluster whose centre is yet to be looked at; that does not count as a step."""
    flags[j, COUNT], flags[j, MOVED], flags[j, ALIVE], flags[j, PARENT], flags[j, STRAYS] = 0, 1, 1, parent, 0
    flags[j, STEPS] = -1


@njit(**VECTOR)
def divide(state: Real, k: int, rows: int, table: F8, flags: I8) -> int:
    """Put a new centre on the farthest particle of each cluster to divide, while there is room; how many clusters then."""
    d, before = state.shape[0], k
    for j in range(before):
        # The others go on from the centres that they were assigned to.
        flags[j, MOVED] = 0
        if flags[j, FARTHEST] < 0 or k == rows:
            continue
        for c in range(table.shape[1]):
            table[k, c] = 0.0
        for r in range(d):
            table[k, CENTRE + 2 * d + r] = state[r, flags[j, FARTHEST]]
            table[k, CENTRE + r], table[k, CENTRE + d + r] = table[k, CENTRE + 2 * d + r], table[j, CENTRE + d + r]
            table[k, CENTRE + 4 * d + r] = table[j, CENTRE + 4 * d + r]
        begin_cluster(k, j, flags)
        flags[j, STEPS] = 0
        k += 1
    return k


@njit(**VECTOR)
def divisions(mass: float, split: float) -> int:
    """How many divisions there may be: each adds a cluster, and a mass M holds at most M/split too heavy ones."""
    return int(np.ceil(2.0 * mass / split))
