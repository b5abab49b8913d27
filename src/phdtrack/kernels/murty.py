"""The k best assignments over all hypotheses of a cluster (Murty 1968; Jonker and Volgenant's shortest paths inside).

Every measurement of a cluster goes to a track of a hypothesis or to none, every track takes one measurement at most. The
best assignment of each hypothesis is a node; the best node of all is given out and what remains of its set of assignments is
divided: the s-th part has the first s measurements where the node has them and the s-th elsewhere. So the assignments of all
hypotheses come in order of their total, each once.

Two bounds keep that cheap. Assignments below a share of the best, or below those that will fill the rest of the places, are
not needed. And the dual variables of a node bound, before a part is solved, what it can gain.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
B1 = NDArray[np.bool_]

FREE, OPEN, DONE = 0, 1, 2


class Assignment(NamedTuple):
    """An assignment of m rows to n columns with its dual variables.

    ``choice`` (m,) is the column of each row, −1: unassigned. ``u`` (m,), ``v`` (≥ n,) are the dual variables of rows and
    columns: u_r + v_c ≤ −gain, u_r ≤ 0 where a row may stay unassigned, with equality where it is; v_c ≤ 0, and 0 where the
    column is free.
    """

    choice: I8
    u: F8
    v: F8


class Work(NamedTuple):
    """Working space of a shortest path, each (≥ n,): the row of a column, rows and lengths of the path, what is settled."""

    row_of: I8
    via: I8
    distance: F8
    done: B1


class Nodes(NamedTuple):
    """Sets of assignments, each with its best one; the k-th has ``status`` FREE, OPEN or DONE.

    ``value`` of its best assignment; ``parent`` the hypothesis; rows before ``fixed`` are fixed, and row ``fixed`` may not
    have the columns ``banned``. ``choice``, ``u``, ``v`` are the best assignments, by row.
    """

    status: I8
    value: F8
    parent: I8
    fixed: I8
    choice: I8
    u: F8
    v: F8
    banned: B1


@njit(**INNER)
def augment(gain: F8, n: int, row: int, first: int, banned: B1, x: Assignment, work: Work) -> bool:
    """Assign ``row`` too, in place, by the shortest augmenting path (Jonker and Volgenant); False where it cannot be done.

    Arguments as of `assign`.
    """
    choice, u, v = x.choice, x.u, x.v
    row_of, via, distance, done = work.row_of, work.via, work.distance, work.done
    least = np.inf if row == first and banned[n] else 0.0
    for c in range(n):
        if row_of[c] != -2 and not (row == first and banned[c]):
            least = min(least, -gain[row, c] - v[c])
        distance[c], done[c] = np.inf, row_of[c] == -2
    if least == np.inf:
        return False
    u[row] = least
    here, reached, shortest, loser, end = row, 0.0, np.inf, -1, -1
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
        return False
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
    return True


@njit(**INNER)
def assign(gain: F8, n: int, first: int, banned: B1, x: Assignment, work: Work) -> float:
    """Assign the rows from ``first`` on as well as can be; the sum of all rows' gains, −∞ where it cannot be done.

    Parameters
    ----------
    gain : (m, ≥ n) what a row gains from a column instead of staying unassigned; −∞: not possible.
    n : number of columns.
    first : rows before it have the columns that ``x.choice`` says.
    banned : (≥ n + 1,) columns that row ``first`` may not have; the n-th: that it may not stay unassigned.
    x : the assignment, written in place; its dual variables are of the rows from ``first`` on.
    work : working space.
    """
    choice, row_of, v, total = x.choice, work.row_of, x.v, 0.0
    for c in range(n):
        row_of[c], v[c] = -1, 0.0
    for r in range(first):
        if choice[r] >= 0:
            row_of[choice[r]] = -2
    for row in range(first, choice.size):
        if not augment(gain, n, row, first, banned, x, work):
            return -np.inf
    for row in range(choice.size):
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


@njit(**INNER)
def keep(nodes: Nodes, total: float, least: float, parent: int, fixed: int, banned: B1, x: Assignment) -> None:
    """Keep the assignment as an open node, where its value ``total`` is ``least`` or more and there is room."""
    at = place(nodes.status, nodes.value, total) if total > -np.inf and total >= least else -1
    if at >= 0:
        nodes.status[at], nodes.value[at], nodes.parent[at], nodes.fixed[at] = OPEN, total, parent, fixed
        for r in range(x.choice.size):
            nodes.choice[at, r], nodes.u[at, r] = x.choice[r], x.u[r]
        for c in range(x.v.size):
            nodes.v[at, c] = x.v[c]
        for c in range(banned.size):
            nodes.banned[at, c] = banned[c]


@njit(**INNER)
def columns_of(gain: F8, held: I8, table: F8, column: I8) -> int:
    """How many tracks a hypothesis holds; their numbers into ``column`` and their gains into the columns of ``table``."""
    n = 0
    for t in range(held.size):
        if held[t] >= 0:
            column[n] = held[t]
            for j in range(gain.shape[0]):
                table[j, n] = gain[j, held[t]]
            n += 1
    return n


@njit(**INNER)
def divide(nodes: Nodes, node: int, table: F8, n: int, limits: tuple[float, float], x: Assignment, work: Work) -> None:
    """Keep the parts of what remains of a node's set: the s-th has the first rows as the node and the s-th otherwise.

    ``limits``: the value of leaving all rows unassigned, and the least value that is kept.
    """
    parent, fixed, m, banned = nodes.parent[node], nodes.fixed[node], x.choice.size, np.empty(n + 1, np.bool_)
    choice, u, v, old = nodes.choice[node].copy(), nodes.u[node].copy(), nodes.v[node].copy(), nodes.banned[node].copy()
    for row in range(fixed, m):
        most = nodes.value[node] - bound(table, n, row, fixed, old, choice, u, v)
        if most < limits[1] or place(nodes.status, nodes.value, most) < 0:
            continue
        for c in range(n + 1):
            banned[c] = old[c] if row == fixed else False
        banned[choice[row] if choice[row] >= 0 else n] = True
        for r in range(m):
            x.choice[r] = choice[r] if r < row else -1
        total = limits[0] + assign(table, n, row, banned, x, work)
        keep(nodes, total, limits[1], parent, row, banned, x)


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
    nodes = Nodes(
        np.zeros(most, np.int64), np.empty(most), np.empty(most, np.int64), np.empty(most, np.int64),
        np.empty((most, m), np.int64), np.empty((most, m)), np.empty((most, width)), np.empty((most, width + 1), np.bool_),
    )  # fmt: skip
    x = Assignment(np.empty(m, np.int64), np.empty(m), np.empty(width))
    work = Work(np.empty(width, np.int64), np.empty(width, np.int64), np.empty(width), np.empty(width, np.bool_))
    table, column, free = np.empty((m, width)), np.empty(width, np.int64), np.zeros(width + 1, np.bool_)
    rest, best = unassigned.sum(), -np.inf
    for p in range(base.size):
        n = columns_of(gain, held[p], table, column)
        for r in range(m):
            x.choice[r] = -1
        total = base[p] + rest + assign(table, n, 0, free, x, work)
        keep(nodes, total, best + log_ratio, p, 0, free, x)
        best = max(best, total)
    parent, choice, weight, given = np.empty(most, np.int64), np.empty((most, m), np.int64), np.empty(most), 0
    while given < most:
        node = -1
        for i in range(most):
            if nodes.status[i] == OPEN and (node < 0 or nodes.value[i] > nodes.value[node]):
                node = i
        if node < 0 or nodes.value[node] < best + log_ratio:
            break
        nodes.status[node] = DONE
        p = nodes.parent[node]
        n = columns_of(gain, held[p], table, column)
        parent[given], weight[given] = p, nodes.value[node]
        for j in range(m):
            c = nodes.choice[node, j]
            choice[given, j] = column[c] if c >= 0 else -1
        given += 1
        divide(nodes, node, table, n, (base[p] + rest, best + log_ratio), x, work)
    return parent[:given], choice[:given], weight[:given]
