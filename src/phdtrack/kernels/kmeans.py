"""Modified K-means over blocks of particles: assignment, means, and the division of clusters that are too heavy [M07 §3].

Most blocks lie near one centre only, or nearer to it than to any other by all of their bounding box. What such a block adds
to its cluster is known from its sums, and none of its particles is looked at. A block with particles of several clusters, or
of none, is mixed: its particles have labels of their own. Which centres are near a block is found once, from the centres'
side, with room for them to move; only blocks with a centre that has moved are looked at again.

Distances are in units of ``scale``, the noise at the centre where its cluster began; a divided cluster's new centre takes it
over. A centre reaches ``reach`` of its deviations in position. ``label`` (B,) is a block's cluster, −1 for none, −2 for a
mixed block, whose particles' clusters stand in ``own`` (L,).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.blocks import Real, load_steps, load_weight
from phdtrack.kernels.fast32 import FAST
from phdtrack.kernels.overlaps import overlapping

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
I4 = NDArray[np.int32]
Bool = NDArray[np.bool_]
MIXED, NOBODY = -2, -1
# A centre is filed with every block in this many times its reach, so that it may move that much before it is filed again.
ROOM = 1.5
# A cluster is not divided any more after this many divisions in which one part got less than this share of the split
# mass: its farthest particles were strays, and peeling them off one by one would not end.
PATIENCE, STRAY = 4, 0.05
# A centre that has moved by less than this many deviations has not moved.
STILL = 0.02


@njit(nogil=True, fastmath=FAST, error_model="numpy")
def least_excess(centre: F8, scale: F8, a: int, b: int, low: Real, high: Real, block: int) -> float:
    """The least of |x − c_b|² − |x − c_a|², each in its own deviations, over a block's box: above 0 nothing is nearer to b.

    A sum over components of parabolas, each of which is least at an end of its side or at its vertex.
    """
    total = 0.0
    for r in range(centre.shape[0]):
        pa, pb = 1.0 / (scale[r, a] * scale[r, a]), 1.0 / (scale[r, b] * scale[r, b])
        ca, cb = centre[r, a], centre[r, b]
        left, right = float(low[block, r]), float(high[block, r])
        least = pb * (left - cb) ** 2 - pa * (left - ca) ** 2
        at_right = pb * (right - cb) ** 2 - pa * (right - ca) ** 2
        least = at_right if at_right < least else least
        if pb > pa:
            vertex = (pb * cb - pa * ca) / (pb - pa)
            if left < vertex < right:
                at_vertex = pb * (vertex - cb) ** 2 - pa * (vertex - ca) ** 2
                least = at_vertex if at_vertex < least else least
        total += least
    return total


@njit(nogil=True, fastmath=FAST, error_model="numpy")
def contenders(
    centre: F8, scale: F8, alive: Bool, reach: float, low: Real, high: Real, origin: Real, b: int,
    head: I8, following: I8, filed: I8, near: I8,
) -> tuple[int, bool]:  # fmt: skip
    """Write into ``near`` the living centres that may own a particle of block b, ascending; how many, and if all of it."""
    count = 0
    e = head[b]
    while e >= 0:
        j = filed[e]
        e = following[e]
        rx, ry = reach * scale[0, j], reach * scale[1, j]
        outside = low[b, 0] > centre[0, j] + rx or high[b, 0] < centre[0, j] - rx
        outside |= low[b, 1] > centre[1, j] + ry or high[b, 1] < centre[1, j] - ry
        if outside or not alive[j]:
            continue
        at = count
        while at > 0 and near[at - 1] > j:
            at -= 1
        # A centre that has been filed again stands in the list twice.
        if at > 0 and near[at - 1] == j:
            continue
        for q in range(count, at, -1):
            near[q] = near[q - 1]
        near[at] = j
        count += 1
    if count == 0:
        return 0, False
    best, first = np.inf, near[0]
    for c in range(count):
        j, distance2 = near[c], 0.0
        for r in range(centre.shape[0]):
            step = (origin[b, r] - centre[r, j]) / scale[r, j]
            distance2 += step * step
        if distance2 < best:
            best, first = distance2, j
    rx, ry = reach * scale[0, first], reach * scale[1, first]
    held = low[b, 0] >= centre[0, first] - rx and high[b, 0] <= centre[0, first] + rx
    held &= low[b, 1] >= centre[1, first] - ry and high[b, 1] <= centre[1, first] + ry
    if not held:
        return count, False
    kept = 0
    for c in range(count):
        j = near[c]
        if j == first or not least_excess(centre, scale, first, j, low, high, b) > 0.0:
            near[kept] = j
            kept += 1
    return kept, kept == 1


@njit(nogil=True, fastmath=FAST, error_model="numpy")
def nearest_in_block(
    step: Real, n: int, centre: F8, scale: F8, reach: float, origin: Real, b: int, near: I8, count: int,
    distance2: Real, best: Real, which: I4,
) -> None:  # fmt: skip
    """For each of n particles the nearest of the centres ``near`` that reach it (−1: none); the lower index wins a tie."""
    real = step.dtype.type
    for i in range(n):
        best[i] = np.inf
        which[i] = NOBODY
    for c in range(count):
        j = near[c]
        for i in range(n):
            distance2[i] = real(0)
        for r in range(centre.shape[0]):
            at, inverse = real(centre[r, j] - origin[b, r]), real(1.0 / scale[r, j])
            for i in range(n):
                part = (step[r, i] - at) * inverse
                distance2[i] += part * part
        x, y = real(centre[0, j] - origin[b, 0]), real(centre[1, j] - origin[b, 1])
        rx, ry = real(reach * scale[0, j]), real(reach * scale[1, j])
        for i in range(n):
            closer = (abs(step[0, i] - x) <= rx) & (abs(step[1, i] - y) <= ry) & (distance2[i] < best[i])
            best[i] = distance2[i] if closer else best[i]
            which[i] = np.int32(j) if closer else which[i]


@njit(nogil=True, fastmath=FAST, error_model="numpy")
def owners(which: I4, n: int, near: I8) -> int:
    """Write into ``near`` the clusters that n particles belong to; how many."""
    count = 0
    for i in range(n):
        j = which[i]
        known = j < 0
        for c in range(count):
            known |= near[c] == j
        if not known:
            near[count] = j
            count += 1
    return count


@njit(nogil=True, fastmath=FAST, error_model="numpy")
def add_block(
    sign: int, j: int, b: int, n: int, origin: Real, block_mass: F8, first: F8, count: I8, mass: F8, sums: F8
) -> None:  # fmt: skip
    """Add a whole block to the particles, mass and sum of states of cluster j, or take it away (``sign`` −1)."""
    count[j] += sign * n
    mass[j] += sign * block_mass[b]
    for r in range(sums.shape[0]):
        sums[r, j] += sign * (first[b, r] + block_mass[b] * origin[b, r])


@njit(nogil=True, fastmath=FAST, error_model="numpy")
def add_mixed(
    sign: int, which: I4, near: I8, some: int, step: Real, w: Real, n: int, origin: Real, b: int, mine: Real,
    count: I8, mass: F8, sums: F8,
) -> None:  # fmt: skip
    """The same for the particles of a mixed block, which belong to the clusters ``near`` or to none."""
    zero = step.dtype.type(0)
    for c in range(some):
        j = near[c]
        total, members = zero, 0
        for i in range(n):
            mine[i] = w[i] if which[i] == j else zero
            members += 1 if which[i] == j else 0
            total += mine[i]
        count[j] += sign * members
        mass[j] += sign * total
        for r in range(step.shape[0]):
            part = zero
            for i in range(n):
                part += mine[i] * step[r, i]
            sums[r, j] += sign * (part + float(total) * origin[b, r])


@njit(nogil=True, fastmath=FAST, error_model="numpy")
def file_centre(
    j: int, x: float, y: float, scale: F8, reach: float, lower: F8, upper: F8, frame: F8, cells: I8, item: I8, corner: I8,
    head: I8, following: I8, filed: I8, used: int, found: I8,
) -> tuple[I8, I8, int]:  # fmt: skip
    """Put centre j on the lists of the blocks near it; the lists, which may have grown, and how much of them is used."""
    rx, ry = ROOM * reach * scale[0, j], ROOM * reach * scale[1, j]
    count = overlapping(x - rx, y - ry, x + rx, y + ry, lower, upper, frame, cells, item, corner, found)
    if used + count > filed.size:
        longer_next, longer = np.empty(2 * (used + count), np.int64), np.empty(2 * (used + count), np.int64)
        for e in range(used):
            longer_next[e], longer[e] = following[e], filed[e]
        following, filed = longer_next, longer
    for p in range(count):
        filed[used] = j
        following[used] = head[found[p]]
        head[found[p]] = used
        used += 1
    return following, filed, used


@njit(nogil=True, fastmath=FAST, error_model="numpy")
def farthest_in_block(
    step: Real, n: int, centre: F8, scale: F8, j: int, origin: Real, b: int, which: I4, whole: bool, distance2: Real
) -> tuple[int, float]:
    """Of the block's particles in cluster j the one farthest from its centre, and its distance² (−1: there is none)."""
    real = step.dtype.type
    for i in range(n):
        distance2[i] = real(0)
    for r in range(centre.shape[0]):
        at, inverse = real(centre[r, j] - origin[b, r]), real(1.0 / scale[r, j])
        for i in range(n):
            part = (step[r, i] - at) * inverse
            distance2[i] += part * part
    most, at_most = -1.0, -1
    for i in range(n):
        if distance2[i] > most and (whole or which[i] == j):
            most, at_most = float(distance2[i]), i
    return at_most, most


@njit(nogil=True, cache=True, fastmath=FAST, error_model="numpy")
def kmeans(
    state: Real, weight: Real, start: I8, low: Real, high: Real, origin: Real, block_mass: F8, first: F8,
    lower: F8, upper: F8, frame: F8, cells: I8, item: I8, corner: I8,
    centres: F8, scales: F8, reach: float, split: float, iterations: int, rounds: int,
) -> tuple[int, F8, F8, I4, I4]:  # fmt: skip
    """Cluster the particles of B blocks, starting from the centres given.

    Parameters
    ----------
    state, weight, start : blocks; low, high, origin, block_mass, first : what `blocks.summarise` knows of them.
    lower … corner : the grid over their boxes.
    centres, scales : (d, k) first centres, and the deviations by which distances from them are measured.
    split : clusters heavier than this are divided; ``rounds`` bounds how often.
    iterations : bound on the iterations after each division.

    Returns
    -------
    k : number of clusters.  mass : (≥ k,).  mean : (d, ≥ k); a cluster without particles keeps its centre.
    label, own : the clusters of blocks and of the particles of mixed blocks.
    """
    d, k = centres.shape
    blocks = start.size - 1
    room = k + 16
    centre, scale, mean = np.empty((d, room)), np.empty((d, room)), np.empty((d, room))
    mass, at_x, at_y, sums = np.zeros(room), np.empty(room), np.empty(room), np.zeros((d, room))
    count, moved, parent, strays = (
        np.zeros(room, np.int64),
        np.zeros(room, np.int64),
        np.zeros(room, np.int64),
        np.zeros(room, np.int64),
    )
    alive = np.zeros(room, np.bool_)
    most = 1
    for b in range(blocks):
        n = start[b + 1] - start[b]
        most = n if n > most else most
    step, w, mine = np.zeros((d, most), state.dtype), np.empty(most, state.dtype), np.empty(most, state.dtype)
    distance2, best, which = np.empty(most, state.dtype), np.empty(most, state.dtype), np.empty(most, np.int32)
    was = np.empty(most, np.int32)
    label, own = np.full(blocks, NOBODY, np.int32), np.empty(state.shape[1], np.int32)
    head, following, filed = (
        np.full(blocks, -1, np.int64),
        np.empty(4 * blocks + 64, np.int64),
        np.empty(4 * blocks + 64, np.int64),
    )
    found, near = np.empty(blocks + 1, np.int64), np.empty(room, np.int64)
    farthest, distance = np.full(room, -1, np.int64), np.full(room, -1.0)
    used, began = 0, k
    for j in range(k):
        for r in range(d):
            mean[r, j], scale[r, j] = centres[r, j], scales[r, j]
        alive[j], moved[j], at_x[j], at_y[j] = True, 1, centres[0, j], centres[1, j]
        following, filed, used = file_centre(
            j, at_x[j], at_y[j], scale, reach, lower, upper, frame, cells, item, corner, head, following, filed, used, found
        )
    for turn in range(rounds + 1):
        for _ in range(iterations + 1):
            for j in range(k):
                if moved[j]:
                    for r in range(d):
                        centre[r, j] = mean[r, j]
                far = abs(centre[0, j] - at_x[j]) > (ROOM - 1.0) * reach * scale[0, j]
                far |= abs(centre[1, j] - at_y[j]) > (ROOM - 1.0) * reach * scale[1, j]
                if far and alive[j]:
                    at_x[j], at_y[j] = centre[0, j], centre[1, j]
                    following, filed, used = file_centre(
                        j, at_x[j], at_y[j], scale, reach, lower, upper, frame, cells, item, corner, head, following, filed,
                        used, found,
                    )  # fmt: skip
            changed = False
            for b in range(blocks):
                begin, n = start[b], start[b + 1] - start[b]
                look = False
                e = head[b]
                while e >= 0:
                    look |= moved[filed[e]] != 0
                    e = following[e]
                if not look or n == 0:
                    continue
                some, whole = contenders(centre, scale, alive, reach, low, high, origin, b, head, following, filed, near)
                now = near[0] if whole else NOBODY if some == 0 else MIXED
                if now == label[b] and now != MIXED:
                    continue
                if now == MIXED or label[b] == MIXED:
                    load_steps(state, begin, n, origin[b], step)
                    load_weight(weight, begin, n, w)
                    for i in range(n):
                        was[i] = own[begin + i]
                if now == MIXED:
                    nearest_in_block(step, n, centre, scale, reach, origin, b, near, some, distance2, best, which)
                    same = label[b] == MIXED
                    for i in range(n):
                        same &= which[i] == was[i]
                    if same:
                        continue
                changed = True
                if label[b] >= 0:
                    add_block(-1, label[b], b, n, origin, block_mass, first, count, mass, sums)
                elif label[b] == MIXED:
                    some = owners(was, n, near)
                    add_mixed(-1, was, near, some, step, w, n, origin, b, mine, count, mass, sums)
                label[b] = now
                if now >= 0:
                    add_block(1, now, b, n, origin, block_mass, first, count, mass, sums)
                elif now == MIXED:
                    for i in range(n):
                        own[begin + i] = which[i]
                    some = owners(which, n, near)
                    add_mixed(1, which, near, some, step, w, n, origin, b, mine, count, mass, sums)
            for j in range(k):
                moved[j] = 1 if alive[j] != (count[j] > 0) else 0
                alive[j] = count[j] > 0
                if not alive[j]:
                    mass[j] = 0.0
                for r in range(d):
                    if alive[j]:
                        mean[r, j] = sums[r, j] / mass[j]
                        moved[j] |= abs(mean[r, j] - centre[r, j]) > STILL * scale[r, j]
                    else:
                        sums[r, j] = 0.0
            if not changed:
                break
        for j in range(began, k):
            # Where one of the two got next to nothing and the other is still too heavy, a stray particle was parted from it.
            i = parent[j]
            if (mass[i] > split or mass[j] > split) and (mass[i] < STRAY * split or mass[j] < STRAY * split):
                strays[i] += 1
                strays[j] = strays[i]
        began = k
        if turn == rounds:
            break
        heavy = 0
        for j in range(k):
            farthest[j], distance[j] = -1, 0.0
            heavy += mass[j] > split and strays[j] < PATIENCE
        if heavy == 0:
            break
        for b in range(blocks):
            begin, n = start[b], start[b + 1] - start[b]
            if n == 0 or label[b] == NOBODY or (label[b] >= 0 and not mass[label[b]] > split):
                continue
            near[0], some = label[b], 1
            if label[b] == MIXED:
                for i in range(n):
                    which[i] = own[begin + i]
                some = owners(which, n, near)
            loaded = False
            for c in range(some):
                j = near[c]
                if mass[j] > split and strays[j] < PATIENCE:
                    if not loaded:
                        load_steps(state, begin, n, origin[b], step)
                        loaded = True
                    i, apart = farthest_in_block(step, n, centre, scale, j, origin, b, which, label[b] >= 0, distance2)
                    if i >= 0 and apart > distance[j]:
                        farthest[j], distance[j] = begin + i, apart
        before = k
        for j in range(before):
            if farthest[j] < 0:
                continue
            if k == room:
                # More room for everything that is kept by cluster.
                room *= 2
                centre, scale, mean, sums = wider(centre, room), wider(scale, room), wider(mean, room), wider(sums, room)
                mass, at_x, at_y, distance = (
                    longer(mass, room),
                    longer(at_x, room),
                    longer(at_y, room),
                    longer(distance, room),
                )
                count, moved, farthest = longer(count, room), longer(moved, room), longer(farthest, room)
                parent, strays, alive = longer(parent, room), longer(strays, room), longer(alive, room)
                near = np.empty(room, np.int64)
            for r in range(d):
                mean[r, k], scale[r, k] = state[r, farthest[j]], scale[r, j]
            alive[k], moved[k], parent[k], at_x[k], at_y[k] = True, 1, j, mean[0, k], mean[1, k]
            following, filed, used = file_centre(
                k,
                at_x[k],
                at_y[k],
                scale,
                reach,
                lower,
                upper,
                frame,
                cells,
                item,
                corner,
                head,
                following,
                filed,
                used,
                found,
            )
            k += 1
        if k == before:
            break
        # The divided clusters go on from the centres that they were assigned to.
        for j in range(before):
            for r in range(d):
                mean[r, j] = centre[r, j]
            moved[j] = 0
    return k, mass, mean, label, own


@njit(nogil=True)
def wider(x: F8, room: int) -> F8:
    """(d, room) the same columns with room for more."""
    out = np.zeros((x.shape[0], room))
    for r in range(x.shape[0]):
        for j in range(x.shape[1]):
            out[r, j] = x[r, j]
    return out


@njit(nogil=True)
def longer(x: F8, room: int) -> F8:
    """(room,) the same numbers with room for more."""
    out = np.zeros(room, x.dtype)
    for j in range(x.size):
        out[j] = x[j]
    return out
