"""The association's work on every open vertex in every frame: predict it, and find who could follow it.

Covariances are planes: of (d, d) the lower triangle, row by row, each element for all states in one stretch (k, C),
k = d (d + 1)/2. So the compiler makes vectors of the loops over states, and a symmetric matrix takes half the room.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, LEAN
from phdtrack.kernels.matching import CLOSED, insert_rows

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
U1 = NDArray[np.uint8]

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


@njit(**LEAN)
def _eliminate(block: F8, step: F8, width: int, det: F8, norm2: F8) -> None:
    """Determinants of the matrices ``block`` (m, m, lanes) and the squared Mahalanobis norms of ``step`` (m, lanes).

    Gauss's elimination on lower triangles, in place, for the first ``width`` lanes. NaN where a matrix is not positive
    definite.
    """
    m = step.shape[0]
    for i in range(width):
        det[i], norm2[i] = 1.0, 0.0
    for t in range(m):
        for i in range(width):
            pivot = block[t, t, i] if block[t, t, i] > 0.0 else np.nan
            det[i] *= pivot
            block[t, t, i] = 1.0 / pivot
            norm2[i] += step[t, i] * step[t, i] * block[t, t, i]
        for a in range(t + 1, m):
            for i in range(width):
                step[a, i] -= block[a, t, i] * block[t, t, i] * step[t, i]
            for b in range(t + 1, a + 1):
                for i in range(width):
                    block[a, b, i] -= block[a, t, i] * block[t, t, i] * block[b, t, i]


@njit(**LEAN)
def log_determinants(cov: F8, plane: I8, block: F8, out: F8) -> None:
    """log |P| of the rows that a measurement shows, written to ``out``; −∞ where P is not positive definite.

    Parameters
    ----------
    cov : (k, C) planes.
    plane : (m, m) the planes of those rows.
    block : (m + 3, m, LANES) working space.
    out : (C or less,) for the first states.
    """
    m, count = plane.shape[0], out.size
    step, det, norm2 = block[m], block[m + 1, 0], block[m + 2, 0]
    for begin in range(0, count, LANES):
        width = LANES if begin + LANES <= count else count - begin
        offset = np.uint64(begin)
        for a in range(m):
            for i in range(np.uint64(width)):
                step[a, i] = 0.0
            for b in range(a + 1):
                for i in range(np.uint64(width)):
                    block[a, b, i] = cov[plane[a, b], offset + i]
        _eliminate(block, step, width, det, norm2)
        for i in range(np.uint64(width)):
            out[offset + i] = np.log(det[i]) if det[i] > 0.0 else -np.inf


@njit(**LEAN)
def near_pairs(
    mean: F8,
    cov: F8,
    open_end: F8,
    price: F8,
    rows: I8,
    plane: I8,
    consistent: float,
    closed: int,
    log_det: F8,
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
    rows, plane : (m,), (m, m) as for `log_determinants`; the first two rows are the position, which is finite.
    consistent : the most deviations that two states may be apart.
    closed : the first columns, which are left out.
    log_det : (C + n,) of all covariances.
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
        least = log_det[count + i] if log_det[count + i] < least else least
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
    found = 0
    for c in range(closed, count):
        limit = 2.0 * (best + price[c]) - (least if least > log_det[c] else log_det[c])
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
                most = 2.0 * (open_end[i] + price[c]) - (log_det[j] if log_det[j] > log_det[c] else log_det[c])
                most = farthest if farthest < most else most
                dx, dy = mean[px, j] - x, mean[py, j] - y
                if dx * dx <= most * (cov[vx, c] + cov[vx, j]) and dy * dy <= most * (cov[vy, c] + cov[vy, j]):
                    if found < state.size:
                        state[found], column[found] = i, c
                    found += 1
    return found


@njit(**LEAN)
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
        _eliminate(block, step, width, det, norm2)
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


@njit(**LEAN)
def _close(dt: float, span: float, row_base: int, column_base: int, since: F8, previous: I8, onward: I8) -> tuple[int, int]:
    """Let ``dt`` pass: ``since`` in place, and close the columns of ``onward`` that go with rows older than ``span``.

    Returns how many rows are closed, and before which place all columns are.
    """
    closed = 0
    for r in range(since.size):
        since[r] += dt
        closed += 1 if since[r] > span else 0
    for r in range(closed):
        if previous[r] >= 0:
            onward[previous[r] - column_base] = CLOSED
    begin = row_base - column_base
    for c in range(begin, begin + closed):
        if onward[c] < 0:
            onward[c] = CLOSED
    gone = 0
    while gone < begin + closed and onward[gone] == CLOSED:
        gone += 1
    return closed, gone


@njit(**ENTRY)
def link_states(
    dt: float,
    span: float,
    gate: float,
    log_miss: float,
    consistent: float,
    row_base: int,
    column_base: int,
    older_start: I8,
    older_target: I8,
    older_gain: F8,
    mean: F8,
    cov: F8,
    typical: F8,
    sigma: F8,
    rows: I8,
    plane: I8,
    block: F8,
    since: F8,
    previous: I8,
    worth: F8,
    u: F8,
    onward: I8,
    v: F8,
    start: I8,
    target: I8,
    gain: F8,
    state: I8,
    column: I8,
    value: F8,
    reals: F8,
    whole: I8,
    cells: I8,
    seen: U1,
) -> tuple[int, int, int]:
    """One frame of the open matching: time passes, old vertices are closed, n new ones find who they go on from [M07 §3].

    Parameters
    ----------
    dt, span, gate, log_miss, consistent : interval, and the settings of `GraphMatching`.
    row_base, column_base, older_start, older_target, older_gain : as for `insert_rows`.
    mean, cov : (d, R + n), (k, R + n) planes: the R states of the window predicted for now, and the new ones behind them.
    typical : (k, n) the motion's noise of this interval from the new states; used up.
    sigma : (d, n) their measurement's deviations.
    rows, plane : (m,), (m, m) the rows of a state that a measurement shows, and where their covariances stand.
    block : (m + 3, m, LANES) working space.
    since, previous, worth, u : (R + n,) of rows: model time since their frame, the vertex matched, the link's gain, the dual
        variable; in place, as are the columns'. Of the new ones 0, −1, 0, 0.
    onward, v : (C + n,) of columns.
    start, target, gain : (S + n + 1,), (start[S] + K or more,) the edges of the rows that are not among the older; those of
        the new rows are written behind those of the first S.
    state, column, value : (K,) working space for pairs.
    reals, whole : (3, C + n), (2, C + n) working space. cells, seen : (g² + 1,), (C + n,) zeros, working space.

    Returns
    -------
    How many pairs had to be looked at (where that is more than K nothing is right: once more, with more room; −1 where a
    position is not finite), how many rows are closed, and how many columns in front.
    """
    n = sigma.shape[1]
    count = since.size - n
    closed, gone = _close(dt, span, row_base, column_base, since[:count], previous, onward)
    for i in range(n):
        if not (np.isfinite(mean[rows[0], count + i]) and np.isfinite(mean[rows[1], count + i])):
            return -1, closed, gone
    found, last = 0, start.size - 1 - n
    if count > closed and n > 0:
        for a in range(rows.size):
            for i in range(n):
                typical[plane[a, a], i] += 2.0 * sigma[rows[a], i] * sigma[rows[a], i]
        log_det, open_end, price = reals[0, : count + n], reals[1, :n], reals[2, :count]
        log_determinants(cov, plane, block, log_det)
        log_determinants(typical, plane, block, open_end)
        for i in range(n):
            open_end[i] = 0.5 * (gate * gate + open_end[i])
        for c in range(count):
            price[c] = (since[c] - dt) * log_miss
        given = mean, cov, open_end, price, rows, plane, consistent
        found = near_pairs(*given, closed, log_det, cells, whole[0], state, column)
        if found > state.size:
            return found, closed, gone
        find_edges(*given, state[:found], column[:found], row_base, block, start[last:], target, gain, value)
    else:
        for i in range(n):
            start[last + 1 + i] = start[last]
    insert_rows(
        count,
        row_base,
        column_base,
        older_start,
        older_target,
        older_gain,
        start,
        target,
        gain,
        previous,
        onward,
        worth,
        u,
        v,
        seen,
        reals[0],
        whole[0],
        reals[1],
        whole[1],
    )
    return found, closed, gone
