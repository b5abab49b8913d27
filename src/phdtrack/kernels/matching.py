"""Maximum-weight bipartite matching that grows one row at a time (Jonker and Volgenant's shortest augmenting path).

Rows may stay unmatched at gain 0. Dual variables u (rows), v (columns) are kept between calls, so that a new row costs one
search of the alternating tree around it and not a new solution: Σu + Σv certifies that the total gain is the maximum.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
Edges = tuple[I8, I8, F8]


@njit(cache=True)
def _moved(number: I8, by: int) -> I8:
    """``number`` + ``by`` where it is one; what is below 0 stays."""
    out = np.empty_like(number)
    for i in range(number.size):
        out[i] = number[i] + by if number[i] >= 0 else number[i]
    return out


@njit(cache=True)
def insert_rows(
    first: int,
    base: tuple[int, int],
    older: Edges,
    recent: Edges,
    column_of: I8,
    row_of: I8,
    worth: F8,
    u: F8,
    v: F8,
) -> tuple[I8, I8, F8, F8, F8]:
    """Match the rows from place ``first`` on, those before it being matched optimally.

    Parameters
    ----------
    first : how many of the R rows are matched already.
    base : numbers of the first row and of the first column: both are numbered through, so that what was stored about them
        stays true when others leave. Their places in the arrays below count from these.
    older, recent : edges by row, in two parts so that the greater one need not be copied to add to the other. Each is
        (start, column, gain): its row r has the edges start[r]…start[r+1]−1 to columns of these numbers. The rows of
        ``recent`` follow those of ``older``. Edges to columns before the first are none.
    column_of, row_of : (R,), (C,) the present matching by number, −1 where unmatched; row_of −2 where a column is closed.
    worth : (R,) gains of the rows' present links.
    u, v : (R,), (C,) dual variables: u_r + v_c ≤ −gain on every edge with equality on matched ones, v_c = 0 on free
        columns, u_r ≤ 0 with equality on unmatched rows.

    Returns
    -------
    column_of, row_of, worth, u, v : the new ones.
    """
    _, zero = base
    column_of, row_of = _moved(column_of, -zero), _moved(row_of, -base[0])
    worth, u, v = worth.copy(), u.copy(), v.copy()
    columns, split = row_of.size, older[0].size - 1
    distance = np.full(columns, np.inf)
    via = np.full(columns, -1, np.int64)
    along_gain = np.zeros(columns)
    done = np.zeros(columns, np.bool_)
    touched = np.empty(columns, np.int64)
    for row in range(first, u.size):
        start, column, gain = older if row < split else recent
        own = row if row < split else row - split
        u[row] = 0.0
        for e in range(start[own], start[own + 1]):
            c = column[e] - zero
            if c >= 0 and row_of[c] > -2:
                u[row] = min(u[row], -gain[e] - v[c])
        count = 0
        here, reached = row, 0.0
        shortest, loser = np.inf, -1  # the best end so far that leaves a row unmatched, and which row
        end_column = -1
        while True:
            if reached - u[here] < shortest:
                shortest, loser = reached - u[here], here
            start, column, gain = older if here < split else recent
            own = here if here < split else here - split
            for e in range(start[own], start[own + 1]):
                c = column[e] - zero
                if c < 0 or done[c] or row_of[c] == -2:
                    continue
                if distance[c] == np.inf:
                    touched[count] = c
                    count += 1
                along = reached - gain[e] - u[here] - v[c]
                if along < distance[c]:
                    distance[c], via[c], along_gain[c] = along, here, gain[e]
            best, chosen = np.inf, -1
            for t in range(count):
                c = touched[t]
                if not done[c] and distance[c] < best:
                    best, chosen = distance[c], c
            if chosen < 0 or shortest <= best:
                break
            done[chosen] = True
            if row_of[chosen] < 0:
                shortest, end_column = best, chosen
                break
            here, reached = row_of[chosen], best
        u[row] += shortest
        for t in range(count):
            c = touched[t]
            if done[c] and row_of[c] >= 0:
                u[row_of[c]] += shortest - distance[c]
                v[c] -= shortest - distance[c]
        # Flip the matching along the path, from its end back to the new row.
        if end_column < 0:
            end_column = column_of[loser]
            column_of[loser], worth[loser] = -1, 0.0
            if loser == row:
                end_column = -1
        while end_column >= 0:
            owner = via[end_column]
            before = column_of[owner]
            column_of[owner], row_of[end_column], worth[owner] = end_column, owner, along_gain[end_column]
            end_column = -1 if owner == row else before
        for t in range(count):
            distance[touched[t]], via[touched[t]], done[touched[t]] = np.inf, -1, False
    return _moved(column_of, zero), _moved(row_of, base[0]), worth, u, v
