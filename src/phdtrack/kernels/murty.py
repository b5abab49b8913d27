"""The k best assignments over all hypotheses of a cluster (Murty 1968; Jonker and Volgenant's shortest paths inside).

Every measurement of a cluster goes to a track of a hypothesis or to none, every track takes one measurement at most. The
best assignment of each hypothesis is a node; the best node of all is given out and what remains of its set of assignments is
divided: the s-th part has the first s measurements where the node has them and the s-th elsewhere. So the assignments of all
hypotheses come in order of their total, each once.

Two bounds keep that cheap. Assignments below a share of the best, or below those that will fill the rest of the places, are
not needed. And the dual variables of a node bound, before a part is solved, what it can gain.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, INNER

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
B1 = NDArray[np.bool_]

FREE, OPEN, DONE = 0, 1, 2


@njit(**INNER)
def assign(
    gain: F8, n: int, first: int, banned: B1, choice: I8, u: F8, v: F8, row_of: I8, distance: F8, via: I8, done: B1
) -> float:
    """Assign the rows from ``first`` on as well as can be; the sum of all rows' gains, −∞ where it cannot be done.

    Parameters
    ----------
    gain : (m, ≥ n) what a row gains from a column instead of staying unassigned; −∞: not possible.
    n : number of columns.
    first : rows before it have the columns that ``choice`` says.
    banned : (≥ n + 1,) columns that row ``first`` may not have; the n-th: that it may not stay unassigned.
    choice : (m,) the column of each row, −1: unassigned; in place.
    u, v : (m,), (≥ n,) dual variables of the rows from ``first`` on and of the columns: u_r + v_c ≤ −gain, u_r ≤ 0 where a
        row may stay unassigned, with equality where it is; v_c ≤ 0, and 0 where the column is free. Out.
    row_of, distance, via, done : (≥ n,) working space.
    """
    m = choice.size
    total = 0.0
    for c in range(n):
        row_of[c] = -1
        v[c] = 0.0
    for r in range(first):
        if choice[r] >= 0:
            row_of[choice[r]] = -2
            total += gain[r, choice[r]]
    for row in range(first, m):
        least = np.inf if row == first and banned[n] else 0.0
        for c in range(n):
            if row_of[c] != -2 and not (row == first and banned[c]):
                least = min(least, -gain[row, c] - v[c])
            distance[c], done[c] = np.inf, row_of[c] == -2
        if least == np.inf:
            return -np.inf
        u[row] = least
        here, reached = row, 0.0
        shortest, loser, end = np.inf, -1, -1
        while True:
            if not (here == first and banned[n]) and reached - u[here] < shortest:
                shortest, loser = reached - u[here], here
            best, chosen = np.inf, -1
            for c in range(n):
                if done[c]:
                    continue
                if not (here == first and banned[c]):
                    along = reached - gain[here, c] - u[here] - v[c]
                    if along < distance[c]:
                        distance[c], via[c] = along, here
                if distance[c] < best:
                    best, chosen = distance[c], c
            if chosen < 0 or shortest <= best:
                break
            if row_of[chosen] < 0:
                shortest, loser, end = best, -1, chosen
                break
            done[chosen] = True
            here, reached = row_of[chosen], best
        if shortest == np.inf:
            return -np.inf
        u[row] += shortest
        for c in range(n):
            if done[c] and row_of[c] >= 0:
                u[row_of[c]] += shortest - distance[c]
                v[c] -= shortest - distance[c]
        if end < 0:
            end = choice[loser] if loser != row else -1
            choice[loser] = -1
        while end >= 0:
            owner = via[end]
            before = choice[owner] if owner != row else -1
            choice[owner], row_of[end] = end, owner
            end = before
    for row in range(first, m):
        if choice[row] >= 0:
            total += gain[row, choice[row]]
    return total


@njit(**INNER)
def bound(gain: F8, n: int, row: int, fixed: int, banned: B1, choice: I8, u: F8, v: F8) -> float:
    """What a node loses at least if ``row`` may no longer have what it has: the smallest slack of what else it could have.

    ``fixed`` is the row of the node to which ``banned`` applies; the columns of rows before ``row`` are not its to have.
    """
    least = np.inf
    if choice[row] >= 0 and not (row == fixed and banned[n]):
        least = -u[row]
    for c in range(n):
        if c == choice[row] or gain[row, c] == -np.inf or (row == fixed and banned[c]):
            continue
        slack = -gain[row, c] - u[row] - v[c]
        if slack < least:
            taken = False
            for before in range(row):
                taken = taken or choice[before] == c
            if not taken:
                least = slack
    return max(least, 0.0)


@njit(**INNER)
def place(status: I8, value: F8, fresh: float) -> int:
    """A place for a node of value ``fresh``: a free one, or that of the worst open one if that is worse; else −1."""
    worst, found = fresh, -1
    for i in range(status.size):
        if status[i] == FREE:
            return i
        if status[i] == OPEN and value[i] < worst:
            worst, found = value[i], i
    return found


@njit(**ENTRY)
def best_assignments(gain: F8, unassigned: F8, held: I8, base: F8, most: int, log_ratio: float) -> tuple[I8, I8, F8]:
    """The best assignments of the measurements of a cluster, over all its hypotheses, best first.

    Parameters
    ----------
    gain : (m, A) log-weight of each measurement from each of the cluster's tracks, in all their forms, against its being
        unassigned and the track's being missed; −∞ outside the gate.
    unassigned : (m,) log-weight of each measurement as a false alarm or a new target.
    held : (P, T) which of the A each hypothesis holds, −1: none.
    base : (P,) log-weight of each hypothesis if all its tracks are missed.
    most : at most this many are given.
    log_ratio : none is given whose log-weight is below the best's plus this (below 0).

    Returns
    -------
    parent (K,), choice (K, m) : the hypothesis of each, and which of the A each measurement goes to, −1: none.
    weight (K,) : their log-weights.
    """
    m, width = gain.shape[0], held.shape[1]
    parents = base.size
    status = np.zeros(most, np.int64)
    value = np.empty(most)
    parent, fixed = np.empty(most, np.int64), np.empty(most, np.int64)
    choices, banned = np.empty((most, m), np.int64), np.empty((most, width + 1), np.bool_)
    us, vs = np.empty((most, m)), np.empty((most, width))
    choice, u, v = np.empty(m, np.int64), np.empty(m), np.empty(width)
    ban = np.empty(width + 1, np.bool_)
    row_of, via = np.empty(width, np.int64), np.empty(width, np.int64)
    distance, done = np.empty(width), np.empty(width, np.bool_)
    table, column, count = np.empty((m, width)), np.empty((parents, width), np.int64), np.zeros(parents, np.int64)
    all_unassigned = 0.0
    for j in range(m):
        all_unassigned += unassigned[j]
    best = -np.inf
    for p in range(parents):
        n = 0
        for t in range(width):
            if held[p, t] >= 0:
                column[p, n] = held[p, t]
                n += 1
        count[p] = n
        for j in range(m):
            for c in range(n):
                table[j, c] = gain[j, column[p, c]]
        for c in range(n + 1):
            ban[c] = False
        total = base[p] + all_unassigned + assign(table, n, 0, ban, choice, u, v, row_of, distance, via, done)
        at = place(status, value, total) if total > -np.inf and total >= best + log_ratio else -1
        if at >= 0:
            best = max(best, total)
            status[at], value[at], parent[at], fixed[at] = OPEN, total, p, 0
            choices[at], us[at], vs[at], banned[at] = choice, u, v, ban
    given = 0
    order = np.empty(most, np.int64)
    while given < most:
        node = -1
        for i in range(most):
            if status[i] == OPEN and (node < 0 or value[i] > value[node]):
                node = i
        if node < 0 or value[node] < best + log_ratio:
            break
        status[node] = DONE
        order[given] = node
        given += 1
        p, n = parent[node], count[parent[node]]
        for j in range(m):
            for c in range(n):
                table[j, c] = gain[j, column[p, c]]
        for row in range(fixed[node], m):
            least = best + log_ratio
            loss = bound(table, n, row, fixed[node], banned[node], choices[node], us[node], vs[node])
            if value[node] - loss < least or place(status, value, value[node] - loss) < 0:
                continue
            for c in range(n + 1):
                ban[c] = banned[node, c] if row == fixed[node] else False
            had = choices[node, row]
            ban[had if had >= 0 else n] = True
            for r in range(m):
                choice[r] = choices[node, r] if r < row else -1
            total = base[p] + all_unassigned + assign(table, n, row, ban, choice, u, v, row_of, distance, via, done)
            at = place(status, value, total) if total > -np.inf and total >= least else -1
            if at >= 0:
                status[at], value[at], parent[at], fixed[at] = OPEN, total, p, row
                choices[at], us[at], vs[at], banned[at] = choice, u, v, ban
    out_parent, out_choice, out_value = np.empty(given, np.int64), np.empty((given, m), np.int64), np.empty(given)
    for k in range(given):
        node = order[k]
        out_parent[k], out_value[k] = parent[node], value[node]
        for j in range(m):
            c = choices[node, j]
            out_choice[k, j] = column[parent[node], c] if c >= 0 else -1
    return out_parent, out_choice, out_value
