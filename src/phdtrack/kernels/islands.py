"""Islands: sets of centres that share blocks with each other and with no others.

Whatever happens to the clusters of one island does not concern those of another, as long as no centre moves so far that it
reaches a block of another: so each can be settled by itself, while its particles are at hand, and several at a time.

Centres and blocks are named by their places on their island.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.cache import njit
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
def in_order(island: I8, start: I8, item: I8, place: I8) -> None:
    """Write where islands begin in the list of members (I + 1,), the list, −1 behind its end, and places on islands."""
    for i in range(start.size):
        start[i] = 0
    for j in range(island.size):
        place[j], item[j] = -1, -1
        if island[j] >= 0:
            place[j] = start[island[j] + 1]
            start[island[j] + 1] += 1
    for i in range(start.size - 1):
        start[i + 1] += start[i]
    for j in range(island.size):
        if island[j] >= 0:
            item[start[island[j]] + place[j]] = j


@njit(**ENTRY)
def islands(
    listed: I8, entries: I8, used: int, filed: int, centres: F8, scales: F8, reach: float,
    lower: F8, upper: F8, frame: F8, cells: I8, item: I8, corner: I8, few: int,
) -> tuple[I8, I8, I8, I8]:  # fmt: skip
    """The islands of k centres (d, k), and the lists of the centres near the blocks.

    ``listed``, ``entries``, ``used`` : the lists of the first ``filed`` centres, as `clustering.outside` gives them;
    ``lower`` … ``corner`` : the grid over the blocks' boxes. With at most ``few`` blocks all is one island.

    Returns
    -------
    link : (2, ≥ E) the lists with all centres.
    begin : (2, I + 1) where the islands' centres and their blocks begin in the lists of them.
    centre : (3, k) that list, ascending for each island; and for each centre its island, and its number there.
    block : (4, B) for each block the head of its list in ``link``; then the same as for centres, −1 for a block that no
        centre is near.
    """
    blocks, k = listed.size, centres.shape[1]
    centre, block, link = np.empty((3, k), np.int64), np.empty((4, blocks), np.int64), np.empty(entries.shape, np.int64)
    found, head, of_block, island = np.empty(blocks, np.int64), block[0], block[2], centre[1]
    for b in range(blocks):
        head[b] = listed[b]
    for e in range(used):
        link[0, e], link[1, e] = entries[0, e], entries[1, e]
    for j in range(filed, k):
        rx, ry = reach * scales[0, j], reach * scales[1, j]
        some = reached(centres[0, j], centres[1, j], rx, ry, lower, upper, frame, cells, item, corner, found)
        link, used = file_centre(j, some, found, head, link, used)
    parent = np.empty(k, np.int64)
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
    begin = np.empty((2, count + 1), np.int64)
    in_order(island, begin[0], centre[0], centre[2])
    in_order(of_block, begin[1], block[1], block[3])
    return link, begin, centre, block


@njit(**ENTRY)
def united(escaped: I8, centre: I8, block: I8, drop: Bool, more: Bool) -> tuple[I8, I8, I8]:
    """One island of those that have turned out not to be by themselves, and those that they have reached.

    ``escaped`` (2, P) pairs of an island and a block not on it that a centre of the island has reached; ``centre``,
    ``block`` of `islands`. Written: ``drop`` (I,), which islands are part of the one; ``more`` (B,), which blocks that were
    on none are. They are kept from one time to the next, when the one has reached others itself. Returned are ``begin``,
    ``centre`` and ``block`` with the one as the only island.
    """
    for p in range(escaped.shape[1]):
        i, b = escaped[0, p], escaped[1, p]
        drop[i] = True
        if block[2, b] >= 0:
            drop[block[2, b]] = True
        else:
            more[b] = True
    begin, centres, blocks = np.empty((2, 2), np.int64), np.empty(centre.shape, np.int64), np.empty(block.shape, np.int64)
    for j in range(centre.shape[1]):
        centres[1, j] = 0 if drop[centre[1, j]] else -1
    for b in range(block.shape[1]):
        blocks[0, b], on = block[0, b], block[2, b]
        blocks[2, b] = 0 if more[b] or (on >= 0 and drop[on]) else -1
    in_order(centres[1], begin[0], centres[0], centres[2])
    in_order(blocks[2], begin[1], blocks[1], blocks[3])
    return begin, centres, blocks
