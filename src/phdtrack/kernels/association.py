"""The association's work on every open vertex in every frame: predict it, and find who could follow it.

Covariances are planes: of (d, d) the lower triangle, row by row, each element for all states in one stretch (k, C),
k = d (d + 1)/2. So the compiler makes vectors of the loops over states, and a symmetric matrix takes half the room.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, INNER

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

# Matrices that are factored side by side.
LANES = 64


@njit(**ENTRY)
def predict_covariances(
    old: F8, skip: int, noise: F8, row: I8, column: I8, value: F8, place: I8, out: F8, begin: int
) -> None:
    """F P Fᵀ + Q for ``w`` states from ``begin`` on, written into the planes ``out``.

    Parameters
    ----------
    old : (k, skip + C) planes of P; the state at ``begin`` + i of ``out`` is that at ``skip`` + ``begin`` + i here.
    noise : (d, d, w or more) planes of Q.
    row, column, value : (e,), (e,), (e, w) the elements of F − I that are not 0, of which motion models have few.
    place : (d, d) the plane of each element.
    out : (k, C or more).
    """
    # Unsigned places: a signed one may count from the end, and the question keeps the compiler from making vectors.
    d, width = noise.shape[0], np.uint64(value.shape[1])
    source, target = np.uint64(skip + begin), np.uint64(begin)
    for r in range(d):
        for s in range(r + 1):
            k = place[r, s]
            for i in range(width):
                out[k, target + i] = old[k, source + i] + noise[r, s, i]
    # With F = I + E: P + E P + P Eᵀ + E P Eᵀ.
    for e in range(row.size):
        r, c = row[e], column[e]
        for s in range(d):
            k, p = place[r, s], place[c, s]
            times = 2.0 if r == s else 1.0
            for i in range(width):
                out[k, target + i] += times * value[e, i] * old[p, source + i]
        for f in range(row.size):
            if row[f] <= r:
                k, p = place[r, row[f]], place[c, column[f]]
                for i in range(width):
                    out[k, target + i] += value[e, i] * value[f, i] * old[p, source + i]


@njit(**INNER)
def _eliminate(block: F8, width: int, det: F8, begin: int) -> None:
    """Determinants of the matrices ``block`` (m, m, lanes), to ``det`` from ``begin`` on.

    Gauss's elimination on lower triangles, in place, for the first ``width`` lanes; on the diagonal 1/pivot is left. NaN
    where a matrix is not positive definite.
    """
    m, lanes, first = block.shape[1], np.uint64(width), np.uint64(begin)
    for i in range(lanes):
        det[first + i] = 1.0
    for t in range(m):
        for i in range(lanes):
            pivot = block[t, t, i] if block[t, t, i] > 0.0 else np.nan
            det[first + i] *= pivot
            block[t, t, i] = 1.0 / pivot
        for a in range(t + 1, m):
            for b in range(t + 1, a + 1):
                for i in range(lanes):
                    block[a, b, i] -= block[a, t, i] * block[t, t, i] * block[b, t, i]


@njit(**INNER)
def determinants(cov: F8, plane: I8, block: F8, out: F8) -> None:
    """|P| of the rows that a measurement shows, written to ``out``; NaN where P is not positive definite.

    Parameters
    ----------
    cov : (k, C) planes.
    plane : (m, m) the planes of those rows.
    block : (m + 3, m, LANES) working space.
    out : (C or less,) for the first states.
    """
    for begin in range(0, out.size, LANES):
        width = LANES if begin + LANES <= out.size else out.size - begin
        offset = np.uint64(begin)
        for a in range(plane.shape[0]):
            for b in range(a + 1):
                for i in range(np.uint64(width)):
                    block[a, b, i] = cov[plane[a, b], offset + i]
        _eliminate(block, width, out, begin)


@njit(**INNER)
def near_pairs(
    mean: F8,
    cov: F8,
    open_end: F8,
    price: F8,
    rows: I8,
    plane: I8,
    consistent: float,
    closed: int,
    det: F8,
    start: I8,
    order: I8,
    state: I8,
    column: I8,
) -> int:
    """Pairs of a new state and a column between which an edge can be worth taking; a column's stand together.

    gain > 0 needs distance² < 2·(open_end + price) − log|S|, and |S| is at least that of either covariance.

    Parameters
    ----------
    mean, cov : (d, C + n), (k, C + n) planes: the C columns predicted for now, then the n new states.
    open_end : (n,) what two loose ends are worth.
    price : (C,) log-probability of the gap.
    rows, plane : (m,), (m, m) as for `determinants`; the first two rows are the position, which is finite.
    consistent : the most deviations that two states may be apart.
    closed : the first columns, which are left out.
    det : (C + n,) determinants of all covariances as `determinants` gives them; used up.
    start, order : (g² + 1,) zeros and (n or more,), working space: a grid of g × g cells over the new states.
    state, column : (K,) outputs.

    Returns
    -------
    How many pairs there are. Those beyond K are not written.
    """
    count, n, side = price.size, open_end.size, int(np.sqrt(start.size - 1))
    px, py, vx, vy = rows[0], rows[1], plane[0, 0], plane[1, 1]
    left, top = mean[px, count], mean[py, count]
    right, bottom = left, top
    best, least, wide, high, farthest = -np.inf, np.inf, 0.0, 0.0, consistent * consistent
    # Conditionals and not min and max, here and below: they compile faster.
    for i in range(n):
        x, y = mean[px, count + i], mean[py, count + i]
        left = x if x < left else left
        right = x if x > right else right
        top = y if y < top else top
        bottom = y if y > bottom else bottom
        best = open_end[i] if open_end[i] > best else best
        det[count + i] = np.log(det[count + i]) if det[count + i] > 0.0 else -np.inf
        least = det[count + i] if det[count + i] < least else least
        wide = cov[vx, count + i] if cov[vx, count + i] > wide else wide
        high = cov[vy, count + i] if cov[vy, count + i] > high else high
    # Cells per pixel; a little less, so that the last point is in the last cell.
    fx, fy = side * 0.999999 / (right - left + 1e-9), side * 0.999999 / (bottom - top + 1e-9)
    for i in range(n):
        start[int((mean[py, count + i] - top) * fy) * side + int((mean[px, count + i] - left) * fx) + 1] += 1
    for k in range(1, start.size):
        start[k] += start[k - 1]
    for i in range(n - 1, -1, -1):
        # Counted down from its end to its beginning: afterwards cell k begins at start[k + 1].
        k = int((mean[py, count + i] - top) * fy) * side + int((mean[px, count + i] - left) * fx) + 1
        start[k] -= 1
        order[start[k]] = i
    found, most_det, paid = 0, np.inf, np.nan
    for c in range(closed, count):
        if price[c] != paid:
            # All columns of a frame pay the same.
            paid = price[c]
            most_det = np.exp(2.0 * (best + paid))
        if det[c] >= most_det:
            continue
        log_det = np.log(det[c]) if det[c] > 0.0 else -np.inf
        limit = 2.0 * (best + price[c]) - (least if least > log_det else log_det)
        if not limit > 0.0:
            continue
        limit = farthest if farthest < limit else limit
        x, y = mean[px, c], mean[py, c]
        reach_x, reach_y = np.sqrt(limit * (cov[vx, c] + wide)), np.sqrt(limit * (cov[vy, c] + high))
        x0, x1, y0, y1 = x - reach_x, x + reach_x, y - reach_y, y + reach_y
        if not (x1 >= left and x0 <= right and y1 >= top and y0 <= bottom):
            continue
        first, last = int((x0 - left) * fx) if x0 > left else 0, int((x1 - left) * fx) if x1 < right else side - 1
        upper, lower = int((y0 - top) * fy) if y0 > top else 0, int((y1 - top) * fy) if y1 < bottom else side - 1
        for line in range(upper, lower + 1):
            end = line * side + last + 2
            for p in range(start[line * side + first + 1], start[end] if end < start.size else n):
                i = order[p]
                j = count + i
                most = 2.0 * (open_end[i] + price[c]) - (det[j] if det[j] > log_det else log_det)
                most = farthest if farthest < most else most
                dx, dy = mean[px, j] - x, mean[py, j] - y
                if dx * dx <= most * (cov[vx, c] + cov[vx, j]) and dy * dy <= most * (cov[vy, c] + cov[vy, j]):
                    if found < state.size:
                        state[found], column[found] = i, c
                    found += 1
    return found


@njit(**INNER)
def find_edges(
    mean: F8,
    cov: F8,
    open_end: F8,
    price: F8,
    rows: I8,
    plane: I8,
    consistent: float,
    state: I8,
    column: I8,
    first: int,
    block: F8,
    start: I8,
    target: I8,
    gain: F8,
    value: F8,
) -> None:
    """Edges of positive gain from new states back to columns, as compressed rows behind those held [M07 §3].

    gain = log N(step; 0, S) − log-density of two loose ends + price of the gap, S = predicted + own covariance, on the rows
    that a measurement shows.

    Parameters
    ----------
    mean, cov, open_end, price, rows, plane, consistent : as for `near_pairs`.
    state, column : (P,) the pairs to look at, by column; used up.
    first : number of the first column.
    block : (m + 3, m, LANES) working space.
    start, target, gain : (n + 1,), (start[0] + P or more,) outputs: row r has the edges start[r] … start[r + 1] − 1 to
        columns ``target``, ascending. start[0] is given.
    value : (P,) working space.
    """
    m, n, count, kept = rows.size, open_end.size, price.size, 0
    for r in range(n):
        start[r + 1] = 0
    step, det, norm2 = block[m], block[m + 1, 0], block[m + 2, 0]
    for begin in range(0, state.size, LANES):
        width = LANES if begin + LANES <= state.size else state.size - begin
        for a in range(m):
            for i in range(width):
                step[a, i] = mean[rows[a], count + state[begin + i]] - mean[rows[a], column[begin + i]]
            for b in range(a + 1):
                p = plane[a, b]
                for i in range(width):
                    block[a, b, i] = cov[p, column[begin + i]] + cov[p, count + state[begin + i]]
        _eliminate(block, width, det, 0)
        for i in range(width):
            norm2[i] = 0.0
        for t in range(m):
            for i in range(width):
                norm2[i] += step[t, i] * step[t, i] * block[t, t, i]
            for a in range(t + 1, m):
                for i in range(width):
                    step[a, i] -= block[a, t, i] * block[t, t, i] * step[t, i]
        for i in range(width):
            r, c = state[begin + i], column[begin + i]
            worth = open_end[r] + price[c] - 0.5 * (norm2[i] + np.log(det[i]))
            if worth > 0.0 and norm2[i] <= consistent * consistent:
                state[kept], column[kept], value[kept] = r, c, worth
                start[r + 1] += 1
                kept += 1
    # Sorted by row by counting; stable.
    end = start[0] + kept
    for r in range(n):
        start[r + 1] += start[r]
    for e in range(kept - 1, -1, -1):
        r = state[e] + 1
        start[r] -= 1
        target[start[r]], gain[start[r]] = first + column[e], value[e]
    for r in range(1, n):
        start[r] = start[r + 1]
    start[n] = end
