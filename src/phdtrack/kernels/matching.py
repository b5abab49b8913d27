"""Maximum-weight bipartite matching that grows one row at a time (Jonker and Volgenant's shortest augmenting path).

Rows may stay unmatched at gain 0. Dual variables u (rows), v (columns) are kept between calls, so that a new row costs one
search of the alternating tree around it and not a new solution: Σu + Σv certifies that the total gain is the maximum.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import INNER

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
U1 = NDArray[np.uint8]

# Whose a column is: no row's yet, and none's ever again.
FREE, CLOSED = -1, -2
# What a search has seen of a column: nothing, that an edge leads to it, the shortest way to it.
UNSEEN, TOUCHED, DONE = 0, 1, 2


@njit(**INNER)
def insert_rows(
    first: int,
    row_base: int,
    column_base: int,
    older_start: I8,
    older_column: I8,
    older_gain: F8,
    start: I8,
    column: I8,
    gain: F8,
    column_of: I8,
    row_of: I8,
    worth: F8,
    u: F8,
    v: F8,
    seen: U1,
    distance: F8,
    via: I8,
    along_gain: F8,
    touched: I8,
) -> None:
    """Match the rows from place ``first`` on, those before it being matched optimally.

    Parameters
    ----------
    first : how many of the R rows are matched already.
    row_base, column_base : numbers of the first row and of the first column: both are numbered through, so that what was
        stored about them stays true when others leave. Places in arrays count from these.
    older_start, older_column, older_gain : edges by row: row r has the edges start[r]…start[r+1]−1 to columns of these
        numbers. Edges to columns before the first are none.
    start, column, gain : those of the rows behind, so that the greater part need not be copied to add to the other.
    column_of, row_of : (R,), (C,) the matching by number, −1 where unmatched; row_of −2 where a column is closed. In place,
        as all that follows: in the new rows −1 and 0.
    worth : (R,) gains of the rows' links.
    u, v : (R,), (C,) dual variables: u_r + v_c ≤ −gain on every edge with equality on matched ones, v_c = 0 on free
        columns, u_r ≤ 0 with equality on unmatched rows.
    seen, distance, via, along_gain, touched : (C,) working space, of any content but ``seen``: zeros.
    """
    split = older_start.size - 1
    for row in range(first, u.size):
        count = 0
        here, reached = row, 0.0
        shortest, loser = np.inf, -1  # the best end so far that leaves a row unmatched, and which row
        end_column = -1
        u[row] = 0.0
        while True:
            old = here < split
            begin = older_start[here] if old else start[here - split]
            end = older_start[here + 1] if old else start[here - split + 1]
            if here == row:
                for e in range(begin, end):
                    c = (older_column[e] if old else column[e]) - column_base
                    if c >= 0 and row_of[c] != CLOSED:
                        bound = -(older_gain[e] if old else gain[e]) - v[c]
                        u[row] = bound if bound < u[row] else u[row]
            if reached - u[here] < shortest:
                shortest, loser = reached - u[here], here
            for e in range(begin, end):
                c = (older_column[e] if old else column[e]) - column_base
                if c < 0 or seen[c] == DONE or row_of[c] == CLOSED:
                    continue
                value = older_gain[e] if old else gain[e]
                along = reached - value - u[here] - v[c]
                if seen[c] == UNSEEN:
                    seen[c], touched[count], distance[c] = TOUCHED, c, np.inf
                    count += 1
                if along < distance[c]:
                    distance[c], via[c], along_gain[c] = along, here, value
            best, chosen = np.inf, -1
            for t in range(count):
                c = touched[t]
                if seen[c] == TOUCHED and distance[c] < best:
                    best, chosen = distance[c], c
            if chosen < 0 or shortest <= best:
                break
            seen[chosen] = DONE
            if row_of[chosen] < 0:
                shortest, end_column = best, chosen
                break
            here, reached = row_of[chosen] - row_base, best
        u[row] += shortest
        for t in range(count):
            c = touched[t]
            if seen[c] == DONE and row_of[c] >= 0:
                u[row_of[c] - row_base] += shortest - distance[c]
                v[c] -= shortest - distance[c]
            seen[c] = UNSEEN
        # Flip the matching along the path, from its end back to the new row.
        if end_column < 0:
            end_column = column_of[loser] - column_base
            column_of[loser], worth[loser] = -1, 0.0
            if loser == row:
                end_column = -1
        while end_column >= 0:
            owner = via[end_column]
            before = column_of[owner] - column_base
            column_of[owner], row_of[end_column] = column_base + end_column, row_base + owner
            worth[owner] = along_gain[end_column]
            end_column = -1 if owner == row else before
