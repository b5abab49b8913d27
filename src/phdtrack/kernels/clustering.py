"""K-means over blocks of particles: which centre each particle belongs to, and what the centres' clusters are.

Most blocks lie near one centre only, or nearer to it than to any other by all of their bounding box. What such a block adds
to its cluster is known from its sums, and none of its particles is looked at again. A block with particles of several
clusters, or of none, is mixed: its particles have labels of their own.

Centres are (d, k), ``scale`` the deviations by which distances are measured, (d, k); a centre reaches ``reach`` deviations
in position, and one with ``alive`` not above 0 reaches nowhere. ``label`` (B,) is a block's cluster, −1 for none, −2 for a
mixed block, whose particles' clusters stand in ``own`` (L,).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.blocks import Real, even, gather, load_steps, load_weight, weigh, widest
from phdtrack.kernels.fast32 import FAST
from phdtrack.kernels.overlaps import overlapping, rectangle_grid

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
I4 = NDArray[np.int32]
Bool = NDArray[np.bool_]
MIXED = -2


@njit(nogil=True, fastmath=FAST)
def reaches(centre: F8, scale: F8, reach: float, alive: F8) -> tuple[F8, F8]:
    """Corners (2, k) of the rectangles that the centres reach."""
    k = centre.shape[1]
    lower, upper = np.empty((2, k)), np.empty((2, k))
    for j in range(k):
        for r in range(2):
            half = reach * scale[r, j] if alive[j] > 0.0 else 0.0
            lower[r, j], upper[r, j] = centre[r, j] - half, centre[r, j] + half
    if not np.isfinite(lower.sum() + upper.sum()):
        raise ValueError("centres and their deviations must be finite")
    return lower, upper


@njit(nogil=True, fastmath=FAST)
def reaching(
    low: Real, high: Real, lower: F8, upper: F8, frame: F8, cells: I8, item: I8, corner: I8, alive: F8, near: I8
) -> int:
    """Write into ``near`` (k,) the living centres that reach into a block's box, ascending; how many."""
    found = overlapping(low[0], low[1], high[0], high[1], lower, upper, frame, cells, item, corner, near)
    count = 0
    for c in range(found):
        j = near[c]
        if alive[j] > 0.0:
            at = count
            while at > 0 and near[at - 1] > j:
                near[at] = near[at - 1]
                at -= 1
            near[at] = j
            count += 1
    return count


@njit(nogil=True, fastmath=FAST)
def holds(lower: F8, upper: F8, j: int, low: Real, high: Real) -> bool:
    """Whether rectangle j holds all of a block's box."""
    inside: bool = lower[0, j] <= low[0] and high[0] <= upper[0, j] and lower[1, j] <= low[1] and high[1] <= upper[1, j]
    return inside


@njit(nogil=True, fastmath=FAST)
def least_excess(centre: F8, scale: F8, a: int, b: int, low: Real, high: Real) -> float:
    """The least of |x − c_b|² − |x − c_a|², each in its own deviations, over a box: above 0 nothing in it is nearer to b.

    A sum over components of parabolas, each of which is least at an end of its side or at its vertex.
    """
    total = 0.0
    for r in range(centre.shape[0]):
        pa, pb = 1.0 / (scale[r, a] * scale[r, a]), 1.0 / (scale[r, b] * scale[r, b])
        ca, cb = centre[r, a], centre[r, b]
        at_low = pb * (low[r] - cb) ** 2 - pa * (low[r] - ca) ** 2
        at_high = pb * (high[r] - cb) ** 2 - pa * (high[r] - ca) ** 2
        least = min(at_low, at_high)
        if pb > pa:
            vertex = (pb * cb - pa * ca) / (pb - pa)
            if low[r] < vertex < high[r]:
                least = min(least, pb * (vertex - cb) ** 2 - pa * (vertex - ca) ** 2)
        total += least
    return total


@njit(nogil=True, fastmath=FAST)
def contenders(
    centre: F8, scale: F8, lower: F8, upper: F8, low: Real, high: Real, origin: Real, near: I8, count: int
) -> tuple[int, bool]:
    """Keep in ``near`` the centres that may own a particle of the block, in their order; how many, and whether the block
    belongs to the first as a whole."""
    best, first = np.inf, 0
    for c in range(count):
        j, distance2 = near[c], 0.0
        for r in range(centre.shape[0]):
            step = (origin[r] - centre[r, j]) / scale[r, j]
            distance2 += step * step
        if distance2 < best:
            best, first = distance2, j
    if not holds(lower, upper, first, low, high):
        return count, False
    kept = 0
    for c in range(count):
        j = near[c]
        if j == first or not least_excess(centre, scale, first, j, low, high) > 0.0:
            near[kept] = j
            kept += 1
    return kept, kept == 1


@njit(nogil=True, fastmath=FAST)
def nearest_in_block(
    step: Real, n: int, centre: F8, scale: F8, reach: float, origin: Real, near: I8, count: int,
    distance2: Real, best: Real, which: I4,
) -> None:  # fmt: skip
    """For each of n particles the nearest of the centres ``near`` that reach it (−1: none), and its distance².

    The lower index wins a tie.
    """
    real = step.dtype.type
    wide = real(reach)
    for i in range(n):
        best[i] = np.inf
        which[i] = -1
    for c in range(count):
        j = near[c]
        for i in range(n):
            distance2[i] = real(0)
        for r in range(centre.shape[0]):
            row, at, inverse = step[r], real(centre[r, j] - origin[r]), real(1.0 / scale[r, j])
            for i in range(n):
                part = (row[i] - at) * inverse
                distance2[i] += part * part
        x, y = step[0], step[1]
        cx, cy = real(centre[0, j] - origin[0]), real(centre[1, j] - origin[1])
        rx, ry = wide * real(scale[0, j]), wide * real(scale[1, j])
        for i in range(n):
            closer = (abs(x[i] - cx) <= rx) & (abs(y[i] - cy) <= ry) & (distance2[i] < best[i])
            best[i] = distance2[i] if closer else best[i]
            which[i] = np.int32(j) if closer else which[i]


@njit(nogil=True, cache=True, fastmath=FAST)
def block_grid(low: Real, high: Real) -> tuple[F8, F8, F8, I8, I8, I8]:
    """A grid over the blocks' boxes in position, as `overlaps.overlapping` asks it: their corners (2, B), and the grid."""
    blocks = low.shape[0]
    lower, upper = np.empty((2, blocks)), np.empty((2, blocks))
    for b in range(blocks):
        for r in range(2):
            lower[r, b], upper[r, b] = low[b, r], high[b, r]
    frame, cells, item, corner = rectangle_grid(lower, upper)
    return lower, upper, frame, cells, item, corner


@njit(nogil=True, fastmath=FAST)
def stirred(
    centre: F8, scale: F8, alive: F8, was_centre: F8, was_scale: F8, was_alive: F8, reach: float,
    lower: F8, upper: F8, frame: F8, cells: I8, item: I8, corner: I8,
) -> Bool:  # fmt: skip
    """(B,) which blocks may be labelled otherwise than before: those that a changed centre reaches or reached."""
    k, before = centre.shape[1], was_centre.shape[1]
    out, found = np.zeros(lower.shape[1], np.bool_), np.empty(lower.shape[1], np.int64)
    for j in range(k):
        moved = j >= before or (alive[j] > 0.0) != (was_alive[j] > 0.0)
        if not moved and alive[j] > 0.0:
            for r in range(centre.shape[0]):
                moved |= centre[r, j] != was_centre[r, j] or scale[r, j] != was_scale[r, j]
        if not moved:
            continue
        x, y, half_x, half_y = centre[0, j], centre[1, j], reach * scale[0, j], reach * scale[1, j]
        left, top, right, bottom = x - half_x, y - half_y, x + half_x, y + half_y
        if j < before:
            x, y, half_x, half_y = was_centre[0, j], was_centre[1, j], reach * was_scale[0, j], reach * was_scale[1, j]
            left, top = min(left, x - half_x), min(top, y - half_y)
            right, bottom = max(right, x + half_x), max(bottom, y + half_y)
        for p in range(overlapping(left, top, right, bottom, lower, upper, frame, cells, item, corner, found)):
            out[found[p]] = True
    return out


@njit(nogil=True, fastmath=FAST)
def add_block(
    sign: float, label: int, own: I4, step: Real, weight: Real, n: int, origin: Real, mass: float, first: F8,
    count: I8, total: F8, sums: F8,
) -> None:  # fmt: skip
    """Add a block (``sign`` 1) to the numbers, masses and sums of states of its clusters, or take it away (−1).

    For a mixed block ``own``, ``step`` and ``weight`` are those of its n particles.
    """
    d = origin.size
    if label >= 0:
        count[label] += int(sign) * n
        total[label] += sign * mass
        for r in range(d):
            sums[label, r] += sign * (first[r] + mass * origin[r])
    elif label == MIXED:
        for i in range(n):
            j = own[i]
            if j >= 0:
                w = sign * weight[i]
                count[j] += int(sign)
                total[j] += w
                for r in range(d):
                    sums[j, r] += w * (float(step[r, i]) + float(origin[r]))


@njit(nogil=True, cache=True, fastmath=FAST)
def assign(
    state: Real, weight: Real, start: I8, low: Real, high: Real, origin: Real, mass: F8, first: F8,
    lower: F8, upper: F8, frame: F8, cells: I8, item: I8, corner: I8,
    centre: F8, scale: F8, reach: float, alive: F8,
    was_centre: F8, was_scale: F8, was_alive: F8, label: I4, own: I4, count: I8, total: F8, sums: F8,
) -> tuple[I4, I8, F8, F8, F8, bool]:  # fmt: skip
    """Assign every particle to the nearest centre that reaches it, and take the means of the clusters [M07 §3].

    Only blocks are looked at that a centre reaches, or reached, which is another than before.

    Parameters
    ----------
    state, weight, start : blocks; low, high, origin, mass, first : what `blocks.summarise` knows of them.
    lower … corner : their `block_grid`.
    was_centre, was_scale, was_alive : (d, k'), (d, k'), (k',) the first k' ≤ k centres as they were when the particles got
        the clusters ``label``, ``own``, with ``count``, ``total``, ``sums`` as returned; k' = 0 for no clusters yet. ``own``
        is the one array that is brought up to date in place: it is as long as the particles, and little of it changes.

    Returns
    -------
    label : the clusters of the blocks now.
    count, total, sums, mean : (k,) particles, (k,) masses, (k, d) sums of states, (d, k) means of the clusters; one without
        particles keeps its centre.
    changed : whether any particle's cluster is another than before.
    """
    d, k = centre.shape
    most = widest(start)
    touched = stirred(
        centre, scale, alive, was_centre, was_scale, was_alive, reach, lower, upper, frame, cells, item, corner
    )
    reach_lower, reach_upper = reaches(centre, scale, reach, alive)
    grid, centre_cells, centre_item, centre_corner = rectangle_grid(reach_lower, reach_upper)
    near, which = np.empty(k, np.int64), np.empty(most, np.int32)
    step, w = np.zeros((d, most), state.dtype), np.empty(most, state.dtype)
    distance2, best = np.empty(most, state.dtype), np.empty(most, state.dtype)
    now = label.copy()
    now_count, now_total, now_sums = np.zeros(k, np.int64), np.zeros(k), np.zeros((k, d))
    for j in range(count.size):
        now_count[j], now_total[j] = count[j], total[j]
        for r in range(d):
            now_sums[j, r] = sums[j, r]
    changed = False
    for b in range(mass.size):
        begin, n = start[b], start[b + 1] - start[b]
        if n == 0 or not touched[b]:
            continue
        some = reaching(
            low[b], high[b], reach_lower, reach_upper, grid, centre_cells, centre_item, centre_corner, alive, near
        )
        whole = False
        if some > 0:
            some, whole = contenders(centre, scale, reach_lower, reach_upper, low[b], high[b], origin[b], near, some)
        found = near[0] if whole else -1
        if (some > 0 and not whole) or label[b] == MIXED:
            load_steps(state, begin, n, origin[b], step)
            load_weight(weight, begin, n, w)
        if some > 0 and not whole:
            nearest_in_block(step, n, centre, scale, reach, origin[b], near, some, distance2, best, which)
            found = which[0]
            for i in range(1, n):
                if which[i] != which[0]:
                    found = MIXED
        same = found == label[b]
        if found == MIXED and same:
            for i in range(n):
                same &= which[i] == own[begin + i]
        if same:
            continue
        changed = True
        add_block(
            -1.0, label[b], own[begin : begin + n], step, w, n, origin[b], mass[b], first[b], now_count, now_total, now_sums
        )
        add_block(1.0, found, which, step, w, n, origin[b], mass[b], first[b], now_count, now_total, now_sums)
        now[b] = found
        if found == MIXED:
            for i in range(n):
                own[begin + i] = which[i]
    mean = centre.copy()
    for j in range(k):
        if now_count[j] > 0 and now_total[j] > 0.0:
            for r in range(d):
                mean[r, j] = now_sums[j, r] / now_total[j]
        else:
            now_total[j] = 0.0
    return now, now_count, now_total, now_sums, mean, changed


@njit(nogil=True, cache=True, fastmath=FAST)
def outside(state: Real, start: I8, low: Real, high: Real, centre: F8, scale: F8, reach: float) -> I8:
    """The particles that no centre reaches, in their order."""
    alive = np.ones(centre.shape[1])
    lower, upper = reaches(centre, scale, reach, alive)
    frame, cells, item, corner = rectangle_grid(lower, upper)
    near = np.empty(centre.shape[1], np.int64)
    free = np.empty(widest(start), np.bool_)
    found, out = 0, np.empty(state.shape[1], np.int64)
    for b in range(start.size - 1):
        begin, n = start[b], start[b + 1] - start[b]
        if n == 0:
            continue
        count = reaching(low[b], high[b], lower, upper, frame, cells, item, corner, alive, near)
        held = False
        for c in range(count):
            held |= holds(lower, upper, near[c], low[b], high[b])
        if held:
            continue
        x, y = state[0, begin : begin + n], state[1, begin : begin + n]
        for i in range(n):
            free[i] = True
        for c in range(count):
            j = near[c]
            for i in range(n):
                free[i] &= not (
                    (x[i] >= lower[0, j]) & (x[i] <= upper[0, j]) & (y[i] >= lower[1, j]) & (y[i] <= upper[1, j])
                )
        for i in range(n):
            if free[i]:
                out[found] = begin + i
                found += 1
    return out[:found].copy()


@njit(nogil=True, cache=True, fastmath=FAST)
def farthest(state: Real, start: I8, label: I4, own: I4, centre: F8, scale: F8, heavy: Bool) -> tuple[I8, F8]:
    """For each cluster in ``heavy`` (k,) its particle farthest from the centre (−1: it has none), and that distance²."""
    d, k = centre.shape
    at, best = np.full(k, -1, np.int64), np.full(k, -1.0)
    for b in range(label.size):
        begin, n = start[b], start[b + 1] - start[b]
        if n == 0 or label[b] == -1 or (label[b] >= 0 and not heavy[label[b]]):
            continue
        for i in range(n):
            j = label[b] if label[b] >= 0 else own[begin + i]
            if j >= 0 and heavy[j]:
                apart = 0.0
                for r in range(d):
                    part = (float(state[r, begin + i]) - centre[r, j]) / scale[r, j]
                    apart += part * part
                if apart > best[j]:
                    best[j], at[j] = apart, begin + i
    return at, best


@njit(nogil=True, fastmath=FAST)
def add_part(mass: float, first: F8, second: F8, shift: F8, j: int, total: F8, mean: F8, cov: F8) -> None:
    """Add to cluster j's raw moments those of a part, given about a point that lies ``shift`` (d,) from the reference."""
    total[j] += mass
    for r in range(shift.size):
        mean[r, j] += first[r] + mass * shift[r]
        for s in range(r + 1):
            cov[j, r, s] += second[r, s] + first[r] * shift[s] + shift[r] * first[s] + mass * shift[r] * shift[s]


@njit(nogil=True, fastmath=FAST)
def centred(total: F8, mean: F8, cov: F8, reference: F8) -> None:
    """Turn raw moments about ``reference`` (d, k) into masses, means (d, k) and covariances (k, d, d), in place."""
    for j in range(total.size):
        m = total[j]
        for r in range(mean.shape[0]):
            if m > 0.0:
                mean[r, j] /= m
            for s in range(r + 1):
                if m > 0.0:
                    cov[j, r, s] = cov[j, r, s] / m - mean[r, j] * mean[s, j]
                cov[j, s, r] = cov[j, r, s]
        for r in range(mean.shape[0]):
            mean[r, j] += reference[r, j]


@njit(nogil=True, cache=True, fastmath=FAST)
def cluster_moments(
    state: Real, weight: Real, start: I8, origin: Real, mass: F8, first: F8, second: F8,
    label: I4, own: I4, cluster: I8, reference: F8,
) -> tuple[F8, F8, F8]:  # fmt: skip
    """Masses (k,), means (d, k) and covariances (k, d, d) of the clusters.

    Label j counts for cluster ``cluster[j]``, or for none where that is −1. Moments are taken about ``reference`` (d, k), a
    point in the middle of each cluster, because the difference of moments about a far point loses all digits.
    """
    d, k = reference.shape
    most = widest(start)
    total, mean, cov = np.zeros(k), np.zeros((d, k)), np.zeros((k, d, d))
    step, weighted = np.zeros((even(d), most), state.dtype), np.zeros((even(d), most), state.dtype)
    w, mine = np.empty(most, state.dtype), np.empty(most, state.dtype)
    shift, one, two = np.empty(d), np.empty(d), np.empty((even(d), even(d)))
    done = np.empty(most, np.int64)
    for b in range(label.size):
        begin, n = start[b], start[b + 1] - start[b]
        if label[b] >= 0:
            j = cluster[label[b]]
            if j >= 0:
                for r in range(d):
                    shift[r] = origin[b, r] - reference[r, j]
                add_part(mass[b], first[b], second[b], shift, j, total, mean, cov)
        elif label[b] == MIXED:
            load_steps(state, begin, n, origin[b], step)
            load_weight(weight, begin, n, w)
            served = 0
            for i in range(n):
                j = cluster[own[begin + i]] if own[begin + i] >= 0 else -1
                known = j < 0
                for q in range(served):
                    known |= done[q] == j
                if known:
                    continue
                done[served] = j
                served += 1
                for q in range(n):
                    member = own[begin + q] >= 0 and cluster[own[begin + q]] == j
                    mine[q] = w[q] if member else state.dtype.type(0)
                m = weigh(mine, step, n, d, weighted)
                gather(weighted, step, n, 1.0, one, two)
                for r in range(d):
                    shift[r] = origin[b, r] - reference[r, j]
                add_part(m, one, two, shift, j, total, mean, cov)
    centred(total, mean, cov, reference)
    return total, mean, cov
