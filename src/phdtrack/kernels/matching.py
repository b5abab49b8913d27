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


@njit(cache=True)
def insert_rows(
    first: int, start: I8, column: I8, gain: F8, column_of: I8, row_of: I8, u: F8, v: F8
) -> tuple[I8, I8, F8, F8]:
    """Match the rows ``first``…R−1, the earlier ones being matched optimally; returns new (column_of, row_of, u, v).

    Parameters
    ----------
    first : the first new row.
    start, column, gain : edges by row, row r has the edges start[r]…start[r+1]−1; start is (R+1,).
    column_of, row_of : (R,), (C,) the present matching, −1 where unmatched.
    u, v : (R,), (C,) dual variables: u_r + v_c ≤ −gain on every edge with equality on matched ones, v_c = 0 on free
        columns, u_r ≤ 0 with equality on unmatched rows.
    """
    column_of, row_of, u, v = column_of.copy(), row_of.copy(), u.copy(), v.copy()
    columns = row_of.size
    distance = np.full(columns, np.inf)
    via = np.full(columns, -1, np.int64)
    done = np.zeros(columns, np.bool_)
    touched = np.empty(columns, np.int64)
    for row in range(first, start.size - 1):
        u[row] = 0.0
        for e in range(start[row], start[row + 1]):
            u[row] = min(u[row], -gain[e] - v[column[e]])
        count = 0
        here, reached = row, 0.0
        shortest, loser = np.inf, -1  # the best end so far that leaves a row unmatched, and which row
        end_column = -1
        while True:
            if reached - u[here] < shortest:
                shortest, loser = reached - u[here], here
            for e in range(start[here], start[here + 1]):
                c = column[e]
                if done[c]:
                    continue
                if distance[c] == np.inf:
                    touched[count] = c
                    count += 1
                along = reached - gain[e] - u[here] - v[c]
                if along < distance[c]:
                    distance[c], via[c] = along, here
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
            column_of[loser] = -1
            if loser == row:
                end_column = -1
        while end_column >= 0:
            owner = via[end_column]
            before = column_of[owner]
            column_of[owner], row_of[end_column] = end_column, owner
            end_column = -1 if owner == row else before
        for t in range(count):
            distance[touched[t]], via[touched[t]], done[touched[t]] = np.inf, -1, False
    return column_of, row_of, u, v
