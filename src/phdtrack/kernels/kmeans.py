"""Modified K-means over blocks of particles: assignment, means, and the division of clusters that are too heavy [M07 §3].

Most blocks lie near one centre only, or nearer to it than to any other by all of their bounding box. What such a block adds
to its cluster is known from its sums, and none of its particles is looked at. A block with particles of several clusters, or
of none, is mixed: its particles have labels of their own. Which centres are near a block is found once, from the centres'
side, with room for them to move; only blocks with a centre that has moved are looked at again.

Every island (see `kernels.islands`) is settled by itself, from its first assignment to the moments of its clusters, while
its particles are at hand. That is not an approximation: how often a centre may move is counted for each by itself.

Distances are in units of the noise at the centre where a cluster began; a divided cluster's new centre takes it over. A
centre reaches ``reach`` of its deviations in position.

The tables of blocks and clusters are those of `kernels.nearest`; rows, labels and lists are those of one island.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.blocks import Real, U, load_steps, whole, working_memory
from phdtrack.kernels.cache import njit
from phdtrack.kernels.clustering import cluster_moments
from phdtrack.kernels.dividing import begin_cluster, divide, divisions, find_farthest, note_strays
from phdtrack.kernels.fast32 import ENTRY, VECTOR
from phdtrack.kernels.nearest import (
    ALIVE,
    CENTRE,
    COUNT,
    MASS,
    MIXED,
    MOVED,
    NOBODY,
    ROOM,
    STEPS,
    X,
    Y,
    contenders,
    file_centre,
    nearest_in_block,
    reached,
)  # fmt: skip

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
I4 = NDArray[np.int32]
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
    weight: Real, begin: int, n: int, d: int, known: F8, b: int, near: I8, count: int, which: I4, own: I4, scratch: Real,
    table: F8, flags: I8,
) -> None:  # fmt: skip
    """Count the particles of block b whose cluster has changed from ``own`` to ``which`` in the sums of those ``near``.

    ``scratch`` holds their steps from the middle of the block. What joins a cluster and what leaves it is summed over the
    whole block: to ask of each particle by itself whether it has changed is a guess that fails every second time.
    """
    real, at, factor = scratch.dtype.type, U(begin), d + d % 2
    for c in range(count):
        j, name = near[c], np.int32(near[c])
        joined, left = np.int32(0), np.int32(0)
        for i in range(U(n)):
            comes, goes = np.int32(which[i] == name), np.int32(own[at + i] == name)
            joined += comes
            left += goes
            scratch[factor, i] = real(comes) - real(goes)
        if joined == 0 and left == 0:
            continue
        unit, mass = float(weight[0]), real(joined) - real(left)
        if weight.size > 1:
            unit, mass = 1.0, real(0)
            for i in range(U(n)):
                scratch[factor, i] *= weight[at + i]
                mass += scratch[factor, i]
        flags[j, COUNT] += joined - left
        table[j, MASS] += unit * mass
        for r in range(d):
            total = real(0)
            for i in range(U(n)):
                total += scratch[factor, i] * scratch[r, i]
            table[j, CENTRE + 3 * d + r] += unit * (total + mass * known[b, 1 + 2 * d + r])
    for i in range(U(n)):
        own[at + i] = which[i]


@njit(**VECTOR)
def with_others(e: int, link: I8, near: I8, count: int) -> int:
    """Put behind the first ``count`` centres of ``near`` the others on the list that begins with e; how many then."""
    while e >= 0:
        j, known = link[0, e], False
        e = link[1, e]
        for c in range(count):
            known |= near[c] == j
        if not known:
            near[count] = j
            count += 1
    return count


@njit(**VECTOR)
def assign(
    state: Real, weight: Real, start: I8, known: F8, table: F8, flags: I8, reach: float, blocks: I8, label: I4, own: I4,
    head: I8, link: I8, near: I8, scratch: Real, which: I4,
) -> bool:  # fmt: skip
    """Look at the blocks near centres that have moved, and give their particles to the nearest; whether any has changed."""
    d, changed = state.shape[0], False
    for q in range(blocks.size):
        b, e = blocks[q], head[q]
        begin, n = start[b], start[b + 1] - start[b]
        while e >= 0 and flags[link[0, e], MOVED] == 0:
            e = link[1, e]
        if e < 0 or n == 0:
            continue
        some, all_of_it, first = contenders(d, table, flags, reach, known, b, head[q], link, near)
        before, now = np.int64(label[b]), near[0] if all_of_it else NOBODY if some == 0 else MIXED
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
        load_steps(state, begin, n, known, b, scratch)
        if now == MIXED:
            nearest_in_block(scratch, whole(n), d, table, reach, known, b, near, some, which)
        else:
            for i in range(n):
                which[i] = now
            label[b] = now
        differs = np.int32(0)
        for i in range(U(n)):
            differs |= which[i] ^ own[at + i]
        if differs != 0:
            changed = True
            some = with_others(head[q], link, near, some)
            regroup(weight, begin, n, d, known, b, near, some, which, own, scratch, table, flags)
    return changed


@njit(**VECTOR)
def move(d: int, k: int, least: float, iterations: int, table: F8, flags: I8) -> None:
    """Means of the clusters, and which centres have to follow theirs: not those that have moved so often already."""
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
        flags[j, MOVED] = 1 if moved and flags[j, STEPS] < iterations else 0


@njit(**VECTOR)
def follow(d: int, j: int, reach: float, table: F8, flags: I8) -> bool:
    """Put a centre that has moved on its mean; whether it is so far from where it was filed that it must be filed again."""
    if flags[j, MOVED] == 0:
        return False
    flags[j, STEPS] += 1
    for r in range(d):
        table[j, CENTRE + r] = table[j, CENTRE + 2 * d + r]
    far = abs(table[j, CENTRE] - table[j, X]) > (ROOM - 1.0) * reach * table[j, CENTRE + d]
    far |= abs(table[j, CENTRE + 1] - table[j, Y]) > (ROOM - 1.0) * reach * table[j, CENTRE + d + 1]
    away: bool = far and flags[j, ALIVE] != 0
    return away


@njit(**VECTOR)
def begin_island(
    d: int, members: I8, blocks: I8, centres: F8, scales: F8, listed: I8, entries: I8, place: I8,
    table: F8, flags: I8, label: I4, head: I8, link: I8,
) -> tuple[I8, int]:  # fmt: skip
    """Clusters without particles, and the lists of an island's blocks: these, which may have grown, and their length."""
    for j in range(members.size):
        at = members[j]
        for c in range(table.shape[1]):
            table[j, c] = 0.0
        for r in range(d):
            table[j, CENTRE + r], table[j, CENTRE + 2 * d + r] = centres[r, at], centres[r, at]
            table[j, CENTRE + d + r], table[j, CENTRE + 4 * d + r] = scales[r, at], 1.0 / scales[r, at]
        table[j, X], table[j, Y] = centres[0, at], centres[1, at]
        begin_cluster(j, j, flags)
    used = 0
    for q in range(blocks.size):
        head[q], label[blocks[q]] = -1, NOBODY
        e = listed[blocks[q]]
        while e >= 0:
            # By number of centres, not of entries: an island's list is short, and seldom grows.
            if used == link.shape[1]:
                longer = np.empty((2, 2 * used), np.int64)
                for p in range(used):
                    longer[0, p], longer[1, p] = link[0, p], link[1, p]
                link = longer
            link[0, used], link[1, used] = place[entries[0, e]], head[q]
            head[q] = used
            used += 1
            e = entries[1, e]
    return link, used


@njit(**VECTOR)
def strangers(i: int, count: int, found: I8, of_block: I8, place: I8, escaped: I8, gone: int) -> tuple[I8, int]:
    """Note the blocks of ``found`` that are not on island i; the others get the numbers that they have on it.

    Gives the list of those that have been noted, which may have grown, and its length.
    """
    if gone + count > escaped.shape[1]:
        longer = np.empty((2, 2 * (gone + count)), np.int64)
        for p in range(gone):
            longer[0, p], longer[1, p] = escaped[0, p], escaped[1, p]
        escaped = longer
    for p in range(count):
        if of_block[found[p]] == i:
            found[p] = place[found[p]]
        else:
            escaped[0, gone], escaped[1, gone] = i, found[p]
            gone += 1
    return escaped, gone


@njit(**VECTOR)
def settle(
    i: int, state: Real, weight: Real, start: I8, known: F8, lower: F8, upper: F8, frame: F8, cells: I8, item: I8,
    corner: I8, reach: float, split: float, least: float, iterations: int, rounds: int, blocks: I8, of_block: I8,
    place: I8, k: int, rows: int, table: F8, flags: I8, label: I4, own: I4, head: I8, link: I8, used: int, near: I8,
    escaped: I8, gone: int, scratch: Real, which: I4,
) -> tuple[int, I8, I8, int]:  # fmt: skip
    """Cluster the particles of island i, whose k clusters have begun: how many there are then, in at most ``rows`` rows.

    Ends as soon as a centre reaches a block that is not on the island. Gives also the lists, which may have grown, and what
    `strangers` gives.
    """
    d, began, filed, before = state.shape[0], k, k, gone
    for turn in range(rounds + 1):
        changed = True
        while changed:
            for j in range(k):
                if follow(d, j, reach, table, flags) or j >= filed:
                    table[j, X], table[j, Y] = table[j, CENTRE], table[j, CENTRE + 1]
                    some = reached(
                        table[j, X], table[j, Y], reach * table[j, CENTRE + d], reach * table[j, CENTRE + d + 1],
                        lower, upper, frame, cells, item, corner, near,
                    )  # fmt: skip
                    escaped, gone = strangers(i, some, near, of_block, place, escaped, gone)
                    if gone > before:
                        return k, link, escaped, gone
                    link, used = file_centre(j, some, near, head, link, used)
            filed = k
            changed = assign(
                state, weight, start, known, table, flags, reach, blocks, label, own, head, link, near, scratch, which
            )  # fmt: skip
            move(d, k, least, iterations, table, flags)
        note_strays(began, k, split, table, flags)
        began = k
        if turn == rounds:
            break
        find_farthest(state, start, known, table, flags, k, split, blocks, label, own, head, link, scratch)
        k = divide(state, k, rows, table, flags)
        if k == began:
            break
    return k, link, escaped, gone


@njit(**ENTRY)
def kmeans(
    lo: int, hi: int, state: Real, weight: Real, start: I8, known: F8, second: F8, lower: F8, upper: F8, frame: F8,
    cells: I8, item: I8, corner: I8, centres: F8, scales: F8, reach: float, split: float, iterations: int, total: float,
    entries: I8, begin: I8, centre_of: I8, block_of: I8, label: I4, own: I4, count: I8, widest: int,
) -> tuple[F8, I8]:  # fmt: skip
    """Cluster the particles on the islands lo … hi − 1, starting from the centres given.

    Parameters
    ----------
    state, weight, start, known, second : the blocks, and what `blocks.summarise` knows of them; lower … corner : the grid
        over their boxes.
    centres, scales : (d, k) first centres, and the deviations by which distances from them are measured.
    split : clusters heavier than this are divided; ``total``, the mass of all particles, bounds how often.
    iterations : how often a centre may move, and again after a division of its cluster.
    entries, begin, centre_of, block_of : as `islands.islands` gives them.
    label, own : (B,), (L,) written: a block's cluster, by its number on the island, −1 for none, −2 for a mixed block,
        whose particles' are in ``own``.
    count : (I,) written: how many clusters there are on each island.
    widest : particles in the largest block.

    Returns
    -------
    clusters : (c, 1 + d + d²) mass, mean and covariance of the islands' clusters; one without particles keeps its centre.
        There are none of an island that a centre has left.
    escaped : (2, P) islands, and blocks that are not on them but have been reached by one of their centres.
    """
    d, most, longest = state.shape[0], 0, 0
    scratch, which = working_memory(state, widest), np.empty(whole(widest), np.int32)
    centre_start, block_start, centre_item, centre_place = begin[0], begin[1], centre_of[0], centre_of[2]
    listed, block_item, of_block, block_place = block_of[0], block_of[1], block_of[2], block_of[3]
    rounds, even = divisions(total, split), state.shape[0] + state.shape[0] % 2
    rows = np.empty(hi - lo, np.int64)
    for i in range(lo, hi):
        mass, blocks = 0.0, block_start[i + 1] - block_start[i]
        for q in range(block_start[i], block_start[i + 1]):
            mass += known[block_item[q], 0]
        # As many as there could be if every division parted as little as does not count as a stray.
        rows[i - lo] = centre_start[i + 1] - centre_start[i] + 10 * divisions(mass, split)
        most, longest = max(most, rows[i - lo]), max(longest, blocks)
    table, flags = np.empty((most, CENTRE + 5 * d)), np.empty((most, 7), np.int64)
    mass_of, mean, cov, reference = np.empty(most), np.empty((d, most)), np.empty((most, d, d)), np.empty((d, most))
    one, two, shift = np.empty(d), np.empty((even, even)), np.empty(d)
    near, head = np.empty(max(most, start.size), np.int64), np.empty(longest, np.int64)
    link, escaped = np.empty((2, 4 * longest + 16), np.int64), np.empty((2, 16), np.int64)
    # A literal zero is a type of its own, for which `settle` would be compiled once more.
    out, done, gone = np.empty((2 * (centre_start[hi] - centre_start[lo]) + 16, 1 + d + d * d)), 0, 0 * lo
    for i in range(lo, hi):
        blocks = block_item[block_start[i] : block_start[i + 1]]
        members = centre_item[centre_start[i] : centre_start[i + 1]]
        link, used = begin_island(
            d, members, blocks, centres, scales, listed, entries, centre_place, table, flags, label, head, link
        )  # fmt: skip
        before = gone
        k, link, escaped, gone = settle(
            i, state, weight, start, known, lower, upper, frame, cells, item, corner, reach, split, DUST * total,
            iterations, rounds, blocks, of_block, block_place, members.size, rows[i - lo], table, flags, label, own,
            head, link, used, near, escaped, gone, scratch, which,
        )  # fmt: skip
        count[i] = k if gone == before else 0
        if gone > before:
            continue
        for j in range(k):
            for r in range(d):
                reference[r, j] = table[j, CENTRE + 2 * d + r]
        cluster_moments(
            state, weight, start, known, second, blocks, label, own, k, scratch, one, two, shift, reference,
            mass_of, mean, cov,
        )  # fmt: skip
        if done + k > out.shape[0]:
            longer = np.empty((2 * (done + k), out.shape[1]))
            for j in range(done):
                for c in range(out.shape[1]):
                    longer[j, c] = out[j, c]
            out = longer
        for j in range(k):
            out[done, 0] = mass_of[j]
            for r in range(d):
                out[done, 1 + r] = mean[r, j]
                for s in range(d):
                    out[done, 1 + d + r * d + s] = cov[j, r, s]
            done += 1
    return out[:done], escaped[:, :gone]
