"""Islands: sets of centres that share blocks with each other and with no others.

Whatever happens to the clusters of one island does not concern those of another, as long as no centre moves so far that it
reaches a block of another: so each can be settled by itself, while its particles are at hand, and several at a time.

Centres and blocks are named by their places on their island; ``of_block`` (B,) says on which island a block is, −1 for none.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.nearest import file_centre, reached

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
Bool = NDArray[np.bool_]


@njit(**INNER)
def root(parent: I8, j: int) -> int:
    """The centre that stands for all those with which j has been united; the way there becomes shorter."""
    while parent[j] != j:
        parent[j] = parent[parent[j]]
        j = parent[j]
    return j


@njit(**INNER)
def in_order(island: I8, count: int) -> tuple[I8, I8, I8]:
    """Where each of ``count`` islands begins (count + 1,) in the list of its members, the list, and places on islands."""
    start, place = np.empty(count + 1, np.int64), np.empty(island.size, np.int64)
    for i in range(count + 1):
        start[i] = 0
    for j in range(island.size):
        place[j] = -1
        if island[j] >= 0:
            place[j] = start[island[j] + 1]
            start[island[j] + 1] += 1
    for i in range(count):
        start[i + 1] += start[i]
    item = np.empty(start[count], np.int64)
    for j in range(island.size):
        if island[j] >= 0:
            item[start[island[j]] + place[j]] = j
    return start, item, place


@njit(**ENTRY)
def islands(
    listed: I8, entries: I8, used: int, filed: int, centres: F8, scales: F8, reach: float,
    lower: F8, upper: F8, frame: F8, cells: I8, item: I8, corner: I8, few: int,
) -> tuple[I8, I8, I8, I8, I8, I8, I8, I8, I8, I8]:  # fmt: skip
    """The islands of k centres (d, k), and the lists of the centres near the blocks.

    ``listed``, ``entries``, ``used`` : the lists of the first ``filed`` centres, as `clustering.outside` gives them;
    ``lower`` … ``corner`` : the grid over the blocks' boxes. With at most ``few`` blocks all is one island.

    Returns
    -------
    head, link : the lists with all centres.
    centre_start, centre_item, centre_island, centre_place : the centres of island i are centre_item[centre_start[i]] …
        centre_item[centre_start[i + 1] − 1], ascending; centre j is number centre_place[j] of centre_island[j].
    block_start, block_item, of_block, block_place : the blocks, likewise; −1 for a block that no centre is near.
    """
    blocks, k = listed.size, centres.shape[1]
    head, link = np.empty(blocks, np.int64), np.empty((2, entries.shape[1]), np.int64)
    found, of_block = np.empty(blocks, np.int64), np.empty(blocks, np.int64)
    for b in range(blocks):
        head[b] = listed[b]
    for e in range(used):
        link[0, e], link[1, e] = entries[0, e], entries[1, e]
    for j in range(filed, k):
        rx, ry = reach * scales[0, j], reach * scales[1, j]
        some = reached(centres[0, j], centres[1, j], rx, ry, lower, upper, frame, cells, item, corner, found)
        link, used = file_centre(j, some, found, head, link, used)
    parent, island = np.empty(k, np.int64), np.empty(k, np.int64)
    for j in range(k):
        parent[j] = j
    for j in range(1, k if blocks <= few else 1):
        parent[j] = 0
    for b in range(blocks if blocks > few else 0):
        if head[b] >= 0:
            one, e = root(parent, link[0, head[b]]), link[1, head[b]]
            while e >= 0:
                other = root(parent, link[0, e])
                parent[other] = one
                e = link[1, e]
    # In the order of their first blocks: what lies together in memory is asked for together. Last those without a block.
    count = 0
    for j in range(k):
        island[j] = -1
    for q in range(blocks + k):
        j = q - blocks if q >= blocks else link[0, head[q]] if head[q] >= 0 else -1
        if j >= 0:
            at = root(parent, j)
            if island[at] < 0:
                island[at] = count
                count += 1
            island[j] = island[at]
        if q < blocks:
            of_block[q] = island[j] if j >= 0 else -1
            if blocks <= few and k > 0:
                of_block[q] = 0
    centre_start, centre_item, centre_place = in_order(island, count)
    block_start, block_item, block_place = in_order(of_block, count)
    return head, link, centre_start, centre_item, island, centre_place, block_start, block_item, of_block, block_place


@njit(**ENTRY)
def united(escaped: I8, centre_island: I8, of_block: I8, drop: Bool, more: Bool) -> tuple[I8, I8, I8, I8, I8, I8, I8, I8]:
    """One island of those that have turned out not to be by themselves, and those that they have reached.

    ``escaped`` (2, P) pairs of an island and a block not on it that a centre of the island has reached. Written: ``drop``
    (I,), which islands are part of the one; ``more`` (B,), which blocks that were on none are. They are kept from one
    time to the next, when the one has reached others itself. Returned as `islands` returns them.
    """
    for p in range(escaped.shape[1]):
        i, b = escaped[0, p], escaped[1, p]
        drop[i] = True
        if of_block[b] >= 0:
            drop[of_block[b]] = True
        else:
            more[b] = True
    island, on = np.empty(centre_island.size, np.int64), np.empty(of_block.size, np.int64)
    for j in range(island.size):
        island[j] = 0 if drop[centre_island[j]] else -1
    for b in range(on.size):
        on[b] = 0 if more[b] or (of_block[b] >= 0 and drop[of_block[b]]) else -1
    centre_start, centre_item, centre_place = in_order(island, 1)
    block_start, block_item, block_place = in_order(on, 1)
    return centre_start, centre_item, island, centre_place, block_start, block_item, on, block_place
