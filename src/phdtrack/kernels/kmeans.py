"""Modified K-means over blocks of particles: assignment, means, and the division of clusters that are too heavy [M07 §3].

Most blocks lie near one centre only, or nearer to it than to any other by all of their bounding box. What such a block adds
to its cluster is known from its sums, and none of its particles is looked at. A block with particles of several clusters, or
of none, is mixed: its particles have labels of their own. Which centres are near a block is found once, from the centres'
side, with room for them to move; only blocks with a centre that has moved are looked at again.

Distances are in units of the noise at the centre where a cluster began; a divided cluster's new centre takes it over. A
centre reaches ``reach`` of its deviations in position.

The tables of blocks and clusters are those of `kernels.nearest`.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.blocks import Real, U, load_steps
from phdtrack.kernels.fast32 import ENTRY, VECTOR
from phdtrack.kernels.nearest import (
    ALIVE,
    APART,
    CENTRE,
    COUNT,
    FARTHEST,
    MASS,
    MIXED,
    MOVED,
    NOBODY,
    PARENT,
    ROOM,
    STRAYS,
    X,
    Y,
    contenders,
    file_centre,
    nearest_in_block,
    squares,
)  # fmt: skip

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
I4 = NDArray[np.int32]
# A cluster is not divided any more after this many divisions in which one part got less than this share of the split
# mass: its farthest particles were strays, and peeling them off one by one would not end.
PATIENCE, STRAY = 4, 0.05
# A centre that has moved by less than this many deviations has not moved.
STILL = 0.02
# A cluster with less than this share of all mass does not move: the difference of larger sums says nothing of its place.
DUST = 1e-12


@njit(**VECTOR)
def add_block(sign: float, j: int, n: int, d: int, b: int, known: F8, table: F8, flags: I8) -> None:
    """Add a whole block of n particles to cluster j, or take it away (``sign`` −1)."""
    flags[j, COUNT] += n if sign > 0.0 else -n
    table[j, MASS] += sign * known[b, 0]
    for r in range(d):
        table[j, CENTRE + 3 * d + r] += sign * known[b, 1 + 3 * d + r]


@njit(**VECTOR)
def regroup(
    state: Real, weight: Real, begin: int, n: int, which: I4, own: I4, table: F8, flags: I8
) -> None:  # fmt: skip
    """Give the particles of a block whose cluster has changed from ``own`` to ``which`` to the new one."""
    d = state.shape[0]
    at = U(begin)
    for i in range(U(n)):
        old, new = own[at + i], which[i]
        if old == new:
            continue
        own[at + i] = new
        w = float(weight[at + i if weight.size > 1 else U(0)])
        for turn in range(2):
            j, sign = (old, -1.0) if turn == 0 else (new, 1.0)
            if j >= 0:
                flags[j, COUNT] += 1 if turn == 1 else -1
                table[j, MASS] += sign * w
                for r in range(d):
                    table[j, CENTRE + 3 * d + r] += sign * w * state[r, at + i]


@njit(**VECTOR)
def assign(
    state: Real, weight: Real, start: I8, known: F8, table: F8, flags: I8, reach: float, label: I4, own: I4,
    head: I8, link: I8, near: I8, scratch: Real, which: I4,
) -> bool:  # fmt: skip
    """Look at the blocks near centres that have moved, and give their particles to the nearest; whether any has changed."""
    d, changed = state.shape[0], False
    for b in range(head.size):
        begin, n = start[b], start[b + 1] - start[b]
        e = head[b]
        while e >= 0 and flags[link[0, e], MOVED] == 0:
            e = link[1, e]
        if e < 0 or n == 0:
            continue
        some, whole, first = contenders(d, table, flags, reach, known, b, head, link, near)
        before, now = np.int64(label[b]), near[0] if whole else NOBODY if some == 0 else MIXED
        if now == before and now != MIXED:
            continue
        if now != MIXED and before != MIXED:
            if before >= 0:
                add_block(-1.0, before, n, d, b, known, table, flags)
            if now >= 0:
                add_block(1.0, now, n, d, b, known, table, flags)
            label[b], changed = now, True
            continue
        at = U(begin)
        if before != MIXED:
            # As if all of it belonged to the nearest: few particles have to be told otherwise one by one.
            if before < 0:
                before = first
                add_block(1.0, before, n, d, b, known, table, flags)
            for i in range(U(n)):
                own[at + i] = before
            label[b], changed = MIXED, True
        if now == MIXED:
            load_steps(state, begin, n, known, b, scratch)
            nearest_in_block(scratch, n, d, table, reach, known, b, near, some, which)
        else:
            for i in range(n):
                which[i] = now
            label[b] = now
        differs = np.int32(0)
        for i in range(U(n)):
            differs |= which[i] ^ own[at + i]
        if differs != 0:
            changed = True
            regroup(state, weight, begin, n, which, own, table, flags)
    return changed


@njit(**VECTOR)
def move(d: int, k: int, least: float, table: F8, flags: I8) -> None:
    """Means of the clusters, and which centres have to follow theirs."""
    for j in range(k):
        held = 1 if flags[j, COUNT] > 0 else 0
        moved = held != flags[j, ALIVE]
        flags[j, ALIVE] = held
        m = table[j, MASS]
        for r in range(d):
            centre = table[j, CENTRE + r]
            if held == 0:
                table[j, MASS], table[j, CENTRE + 3 * d + r] = 0.0, 0.0
            mean = table[j, CENTRE + 3 * d + r] / m if held == 1 and m > least else centre
            table[j, CENTRE + 2 * d + r] = mean
            moved |= abs(mean - centre) > STILL * table[j, CENTRE + d + r]
        flags[j, MOVED] = 1 if moved else 0


@njit(**VECTOR)
def follow(d: int, j: int, reach: float, table: F8, flags: I8) -> bool:
    """Put a centre that has moved on its mean; whether it is so far from where it was filed that it must be filed again."""
    if flags[j, MOVED] == 0:
        return False
    for r in range(d):
        table[j, CENTRE + r] = table[j, CENTRE + 2 * d + r]
    far = abs(table[j, CENTRE] - table[j, X]) > (ROOM - 1.0) * reach * table[j, CENTRE + d]
    far |= abs(table[j, CENTRE + 1] - table[j, Y]) > (ROOM - 1.0) * reach * table[j, CENTRE + d + 1]
    away: bool = far and flags[j, ALIVE] != 0
    return away


@njit(**VECTOR)
def find_farthest(
    state: Real, start: I8, known: F8, table: F8, flags: I8, k: int, split: float, label: I4, own: I4,
    head: I8, link: I8, scratch: Real,
) -> None:  # fmt: skip
    """Of each cluster to divide the particle farthest from its centre: −1 where there is nothing to divide."""
    d, heavy = state.shape[0], False
    out = d + d % 2
    for j in range(k):
        table[j, APART] = 0.0 if table[j, MASS] > split and flags[j, STRAYS] < PATIENCE else np.inf
        flags[j, FARTHEST] = -1
        heavy |= table[j, APART] == 0.0
    for b in range(head.size if heavy else 0):
        begin, n, loaded = start[b], start[b + 1] - start[b], False
        whole = label[b] >= 0
        if label[b] == NOBODY or n == 0 or (whole and table[label[b], APART] == np.inf):
            continue
        e = head[b]
        while e >= 0:
            j = link[0, e]
            e = link[1, e]
            if table[j, APART] == np.inf or (whole and label[b] != j):
                continue
            if not loaded:
                load_steps(state, begin, n, known, b, scratch)
                loaded = True
            squares(scratch, n, d, table, j, known, b)
            for i in range(n):
                if scratch[out, i] > table[j, APART] and (whole or own[begin + i] == j):
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
def divide(state: Real, k: int, table: F8, flags: I8) -> int:
    """Put a new centre on the farthest particle of each cluster to divide, while there is room; how many clusters then."""
    d, before = state.shape[0], k
    for j in range(before):
        # The others go on from the centres that they were assigned to.
        flags[j, MOVED] = 0
        if flags[j, FARTHEST] < 0 or k == table.shape[0]:
            continue
        for c in range(table.shape[1]):
            table[k, c] = 0.0
        for r in range(d):
            table[k, CENTRE + 2 * d + r] = state[r, flags[j, FARTHEST]]
            table[k, CENTRE + r], table[k, CENTRE + d + r] = table[k, CENTRE + 2 * d + r], table[j, CENTRE + d + r]
        flags[k, COUNT], flags[k, MOVED], flags[k, ALIVE], flags[k, PARENT], flags[k, STRAYS] = 0, 1, 1, j, 0
        k += 1
    return k


@njit(**ENTRY)
def kmeans(
    state: Real, weight: Real, start: I8, known: F8, lower: F8, upper: F8, frame: F8, cells: I8, item: I8, corner: I8,
    centres: F8, scales: F8, reach: float, split: float, iterations: int, rounds: int,
    listed: I8, entries: I8, filed: int, table: F8, flags: I8, label: I4, own: I4, scratch: Real, which: I4,
) -> int:  # fmt: skip
    """Cluster the particles of B blocks, starting from the centres given; the number of clusters.

    Parameters
    ----------
    state, weight, start, known : the blocks, and what `blocks.summarise` knows of them; lower … corner : the grid over
        their boxes.
    centres, scales : (d, k) first centres, and the deviations by which distances from them are measured.
    split : clusters heavier than this are divided; ``rounds`` bounds how often, and the rows of ``table`` how much.
    iterations : bound on the iterations after each division.
    table, flags : written: the clusters, of which `MASS` and the mean are of use; one without particles keeps its centre.
    label, own : written: (B,) a block's cluster, −1 for none, −2 for a mixed block, whose particles' are in own (L,).
    listed, entries : lists of the first ``filed`` centres near each block, as `clustering.outside` gives them.
    scratch, which : working memory, (≥ even d + 2, n) zeros and (n,) for n particles in the largest block.
    """
    d, k = centres.shape[0], int(centres.shape[1])
    used, began, total = entries.shape[1], k, 0.0
    head, link = np.empty(listed.size, np.int64), np.empty((2, 2 * (used + listed.size) + 64), np.int64)
    near = np.empty(max(table.shape[0], listed.size), np.int64)
    for b in range(head.size):
        head[b], label[b] = listed[b], NOBODY
        total += known[b, 0]
    for e in range(used):
        link[0, e], link[1, e] = entries[0, e], entries[1, e]
    for j in range(k):
        for c in range(table.shape[1]):
            table[j, c] = 0.0
        for r in range(d):
            table[j, CENTRE + r], table[j, CENTRE + 2 * d + r] = centres[r, j], centres[r, j]
            table[j, CENTRE + d + r] = scales[r, j]
        table[j, X], table[j, Y] = centres[0, j], centres[1, j]
        flags[j, COUNT], flags[j, MOVED], flags[j, ALIVE], flags[j, PARENT], flags[j, STRAYS] = 0, 1, 1, j, 0
    for turn in range(rounds + 1):
        for _ in range(iterations + 1):
            for j in range(k):
                if follow(d, j, reach, table, flags) or j >= filed:
                    table[j, X], table[j, Y] = table[j, CENTRE], table[j, CENTRE + 1]
                    link, used = file_centre(
                        j, table[j, X], table[j, Y], reach * table[j, CENTRE + d], reach * table[j, CENTRE + d + 1],
                        lower, upper, frame, cells, item, corner, head, link, used, near,
                    )  # fmt: skip
            filed = k
            changed = assign(state, weight, start, known, table, flags, reach, label, own, head, link, near, scratch, which)
            move(d, k, DUST * total, table, flags)
            if not changed:
                break
        note_strays(began, k, split, table, flags)
        began = k
        if turn == rounds:
            break
        find_farthest(state, start, known, table, flags, k, split, label, own, head, link, scratch)
        k = divide(state, k, table, flags)
        if k == began:
            break
    return k
