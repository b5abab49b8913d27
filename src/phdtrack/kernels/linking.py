"""One frame of the open matching: time passes, old vertices are closed, new ones are linked where that gains most."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.association import determinants, find_edges, near_pairs
from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.matching import CLOSED, insert_rows

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
U1 = NDArray[np.uint8]


@njit(**INNER)
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


@njit(**INNER)
def _take_over(
    was: tuple[F8, I8, F8, F8, I8, F8, I8, I8, F8],
    since: F8,
    previous: I8,
    worth: F8,
    u: F8,
    onward: I8,
    v: F8,
    start: I8,
    target: I8,
    gain: F8,
) -> None:
    """Copies of the first nine in the others, which are longer: new rows and columns without age, link and price."""
    for r in range(since.size):
        old = r < was[0].size
        since[r], previous[r] = was[0][r] if old else 0.0, was[1][r] if old else -1
        worth[r], u[r] = was[2][r] if old else 0.0, was[3][r] if old else 0.0
    for c in range(onward.size):
        old = c < was[4].size
        onward[c], v[c] = was[4][c] if old else -1, was[5][c] if old else 0.0
    for r in range(was[6].size):
        start[r] = was[6][r]
    for e in range(was[6][was[6].size - 1]):
        target[e], gain[e] = was[7][e], was[8][e]


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
    was: tuple[F8, I8, F8, F8, I8, F8, I8, I8, F8],
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
    was : what the next nine were, for R rows, C columns and the edges of the S rows that are not among the older.
    since, previous, worth, u : (R + n,) outputs, of rows: model time since their frame, the vertex matched, the link's gain,
        the dual variable.
    onward, v : (C + n,) outputs, of columns: the vertex matched, the dual variable.
    start, target, gain : (S + n + 1,), (was's start[S] + K or more,) outputs: edges, with those of the new rows behind.
    state, column, value : (K,) working space for pairs.
    reals, whole : (3, C + n), (2, C + n) working space. cells, seen : (g² + 1,), (C + n,) zeros, working space.

    Returns
    -------
    How many pairs had to be looked at (where that is more than K nothing is right: once more, with more room; −1 where a
    position is not finite), how many rows are closed, and how many columns in front.
    """
    n = sigma.shape[1]
    count = since.size - n
    _take_over(was, since, previous, worth, u, onward, v, start, target, gain)
    closed, gone = _close(dt, span, row_base, column_base, since[:count], previous, onward)
    for i in range(n):
        if not (np.isfinite(mean[rows[0], count + i]) and np.isfinite(mean[rows[1], count + i])):
            return -1, closed, gone
    found, last = 0, start.size - 1 - n
    if count > closed and n > 0:
        for a in range(rows.size):
            for i in range(n):
                typical[plane[a, a], i] += 2.0 * sigma[rows[a], i] * sigma[rows[a], i]
        det, open_end, price = reals[0, : count + n], reals[1, :n], reals[2, :count]
        determinants(cov, plane, block, det)
        determinants(typical, plane, block, open_end)
        for i in range(n):
            open_end[i] = 0.5 * (gate * gate + np.log(open_end[i]))
        for c in range(count):
            price[c] = (since[c] - dt) * log_miss
        given = mean, cov, open_end, price, rows, plane, consistent
        found = near_pairs(*given, closed, det, cells, whole[0], state, column)
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
