"""Which measurement belongs to which track: clusters that compete, the k best assignments, and
marginal probabilities.

*Assignment* by shortest augmenting paths (Jonker and Volgenant). Rows may stay unassigned at gain
0. Dual variables certify that the total gain is the maximum: u_r + v_c ≤ −gain on every edge, with
equality where the row has the column; u_r ≤ 0, with equality where the row is unassigned; v_c ≤ 0,
and 0 where the column is free.

*The k best assignments* (Murty 1968) over all hypotheses of a cluster. Every measurement goes to a
track or to none, every track takes one at most. The best assignment of each hypothesis is a node;
the best node of all is given out and what remains of its set is divided: the s-th part has the
first s measurements where the node has them and the s-th elsewhere. Assignments below a share of
the best, or below those that will fill the remaining places, are not needed; and the dual variables
of a node bound what a part can gain before it is solved.

*Marginal probabilities* by loopy belief propagation [W14; W15]. With ψ_e the odds of a pair e =
(target, measurement) against the target being missed and the measurement being no earlier target's,
the messages are

    μ_e = ψ_e / (1 + Σ_{other pairs of the target} ψ ν)      ν_e = 1 / (1 + Σ_{other pairs of the
    measurement} μ)

They converge, whatever ψ [W14], and are exact where pairs form a tree; a round costs as many steps
as there are pairs whose messages still change.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from phdtrack.kernels import F8, I8, Bool, Records
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.gaussian import records

# A column without a row, and one that no row may take any more.
UNUSED = -1
CLOSED = -2
# What a search has seen of a column: nothing, that an edge leads to it, the shortest path to it.
UNSEEN = 0
TOUCHED = 1
REACHED = 2
# A place for a node: without one, with one, with one that was given out.
FREE = 0
OPEN = 1
DONE = 2
# Rounds at most, and the change of every message below which they are enough.
ROUNDS = 50
SETTLED = 1e-6
# A pair: its odds ψ and its messages, of which the first is at the end the probability that the
# target has the measurement; its two ends; and a number that all pairs share which are joined by
# targets and measurements.
EDGE = records("odds mu nu", "target measurement island")


class Edges(NamedTuple):
    """Row r may have the columns target[start[r]:start[r + 1]], at these gains; columns below 0
    count for none.
    """

    start: I8
    target: I8
    gain: F8


class Matching(NamedTuple):
    """``column`` (m,) of each row, −1: none; ``row`` (n,) of each column, or UNUSED or CLOSED;
    ``u`` (m,) and ``v`` (n,).
    """

    column: I8
    row: I8
    u: F8
    v: F8


class Paths(NamedTuple):
    """Working space of searches, each (n,): rows and lengths of the paths, columns seen (all 0 at
    first), and which.
    """

    via: I8
    distance: F8
    seen: I8
    touched: I8


class Nodes(NamedTuple):
    """Sets of assignments, each with its best one; the k-th has ``status`` FREE, OPEN or DONE.

    ``value`` of its best assignment; ``parent`` the hypothesis; rows before ``fixed`` are fixed,
    and row ``fixed`` may not have the columns ``banned``. ``choice``, ``u``, ``v`` are the best
    assignments, by row.
    """

    status: I8
    value: F8
    parent: I8
    fixed: I8
    choice: I8
    u: F8
    v: F8
    banned: Bool


@njit(**INNER)
def new_paths(columns: int) -> Paths:
    """Working space."""
    whole = np.zeros((3, columns), np.int64)
    return Paths(whole[0], np.empty(columns), whole[1], whole[2])


@njit(**INNER)
def augment(edges: Edges, row: int, first: int, banned: Bool, x: Matching, paths: Paths) -> bool:
    """Assign ``row`` too, in place, by the shortest augmenting path; False where it cannot be done.

    Row ``first`` may not have the columns ``banned``, and not stay unassigned where the last of
    them is true.
    """
    start, target, gain = edges
    u = x.u
    v = x.v
    via, distance, seen, touched = paths
    u[row] = np.inf if row == first and banned[-1] else 0.0
    for e in range(start[row], start[row + 1]):
        c = target[e]
        if (
            c >= 0
            and x.row[c] != CLOSED
            and not (row == first and banned[c])
            and -gain[e] - v[c] < u[row]
        ):
            u[row] = -gain[e] - v[c]
    if u[row] == np.inf:
        return False
    # The best end so far: the row that it leaves unassigned, or a free column.
    here = row
    reached = 0.0
    count = 0
    shortest = np.inf
    loser = -1
    end = -1
    while True:
        if not (here == first and banned[-1]) and reached - u[here] < shortest:
            shortest = reached - u[here]
            loser = here
        for e in range(start[here], start[here + 1]):
            c = target[e]
            if c < 0 or seen[c] == REACHED or x.row[c] == CLOSED or (here == first and banned[c]):
                continue
            if seen[c] == UNSEEN:
                seen[c] = TOUCHED
                touched[count] = c
                distance[c] = np.inf
                count += 1
            along = reached - gain[e] - u[here] - v[c]
            if along < distance[c]:
                distance[c] = along
                via[c] = here
        nearest = np.inf
        chosen = -1
        for t in range(count):
            c = touched[t]
            if seen[c] == TOUCHED and distance[c] < nearest:
                nearest = distance[c]
                chosen = c
        if chosen < 0 or shortest <= nearest:
            break
        seen[chosen] = REACHED
        if x.row[chosen] < 0:
            shortest = nearest
            end = chosen
            break
        here = x.row[chosen]
        reached = nearest
    u[row] += shortest
    for t in range(count):
        c = touched[t]
        if seen[c] == REACHED and x.row[c] >= 0:
            u[x.row[c]] += shortest - distance[c]
            v[c] -= shortest - distance[c]
        seen[c] = UNSEEN
    if shortest == np.inf:
        return False
    if end < 0:
        if loser == row:
            end = -1
        else:
            end = x.column[loser]
        x.column[loser] = -1
    # Flip the matching along the path, from its end back to the new row.
    while end >= 0:
        owner = via[end]
        if owner == row:
            before = -1
        else:
            before = x.column[owner]
        x.column[owner] = end
        x.row[end] = owner
        end = before
    return True


@njit(**INNER)
def gain_of(edges: Edges, row: int, column: int) -> float:
    """The gain of the edge from a row to a column; 0 where the column is −1."""
    for e in range(edges.start[row], edges.start[row + 1] if column >= 0 else 0):
        if edges.target[e] == column:
            gain: float = edges.gain[e]
            return gain
    return 0.0


@njit(**INNER)
def _assign(edges: Edges, n: int, first: int, banned: Bool, x: Matching, paths: Paths) -> float:
    """Assign the rows from ``first`` on to n columns; the sum of all rows' gains, −∞ where it
    cannot be done.

    Rows before ``first`` have the columns that ``x`` says, in which the assignment is written; row
    ``first`` may not have the columns ``banned`` as of `augment`.
    """
    for c in range(n):
        x.row[c] = UNUSED
        x.v[c] = 0.0
    for r in range(x.column.size):
        if r >= first:
            x.column[r] = -1
        elif x.column[r] >= 0:
            x.row[x.column[r]] = CLOSED
    total = 0.0
    for row in range(first, x.column.size):
        if not augment(edges, row, first, banned, x, paths):
            return -np.inf
    for row in range(x.column.size):
        total += gain_of(edges, row, x.column[row])
    return total


@njit(**ENTRY)
def best_pairs(row: I8, column: I8, gain: F8, count: int) -> I8:
    """(count,) the column of each of ``count`` rows, −1: none, so that the sum of the gains is the
    largest.

    ``row``, ``column``, ``gain`` (E,): the pairs that there may be, in the order of their rows;
    columns are below ``count``.
    """
    start = np.zeros(count + 1, np.int64)
    none = np.zeros(count + 1, np.bool_)
    for r in row:
        start[r + 1] += 1
    for r in range(count):
        start[r + 1] += start[r]
    x = Matching(
        np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count), np.empty(count)
    )
    _assign(Edges(start, column, gain), count, 0, none, x, new_paths(count))
    return x.column


@njit(**INNER)
def _bound(edges: Edges, row: int, fixed: int, banned: Bool, choice: I8, u: F8, v: F8) -> float:
    """What a node loses at least if ``row`` may no longer have what it has: the smallest slack of
    what else it could have.

    ``fixed`` is the row of the node to which ``banned`` applies; the columns of rows before ``row``
    are taken.
    """
    least = np.inf
    if choice[row] >= 0 and not (row == fixed and banned[-1]):
        least = -u[row]
    for e in range(edges.start[row], edges.start[row + 1]):
        c = edges.target[e]
        slack = -edges.gain[e] - u[row] - v[c]
        if c == choice[row] or slack >= least or (row == fixed and banned[c]):
            continue
        taken = False
        for before in range(row):
            taken = taken or choice[before] == c
        least = least if taken else slack
    return max(least, 0.0)


@njit(**INNER)
def _place(status: I8, value: F8, fresh: float) -> int:
    """A place for a node of value ``fresh``: a free one, or that of the worst open one if that is
    worse; else −1.
    """
    worst = fresh
    found = -1
    for i in range(status.size):
        if status[i] == FREE:
            return i
        if status[i] == OPEN and value[i] < worst:
            worst = value[i]
            found = i
    return found


@njit(**INNER)
def _keep(
    nodes: Nodes, total: float, least: float, parent: int, fixed: int, banned: Bool, x: Matching
) -> None:
    """Keep the assignment as an open node, where its value ``total`` is ``least`` or more and there
    is room.
    """
    if total > -np.inf and total >= least:
        at = _place(nodes.status, nodes.value, total)
    else:
        at = -1
    if at >= 0:
        nodes.status[at] = OPEN
        nodes.value[at] = total
        nodes.parent[at] = parent
        nodes.fixed[at] = fixed
        for r in range(x.column.size):
            nodes.choice[at, r] = x.column[r]
            nodes.u[at, r] = x.u[r]
        for c in range(x.v.size):
            nodes.v[at, c] = x.v[c]
            nodes.banned[at, c] = banned[c]
        nodes.banned[at, -1] = banned[-1]


@njit(**INNER)
def _write_edges(gain: F8, held: I8, edges: Edges, number: I8) -> int:
    """How many tracks a hypothesis holds; their numbers into ``number``, and the edges of the
    measurements to them.
    """
    n = 0
    count = 0
    for t in range(held.size):
        if held[t] >= 0:
            number[n] = held[t]
            n += 1
    for j in range(gain.shape[0]):
        for c in range(n):
            if gain[j, number[c]] > -np.inf:
                edges.target[count] = c
                edges.gain[count] = gain[j, number[c]]
                count += 1
        edges.start[j + 1] = count
    return n


@njit(**INNER)
def _divide(
    nodes: Nodes,
    node: int,
    edges: Edges,
    n: int,
    limits: tuple[float, float],
    x: Matching,
    paths: Paths,
) -> None:
    """Keep the parts of what remains of a node's set: the s-th has the first rows as the node and
    the s-th otherwise.

    ``limits``: the value of leaving all rows unassigned, and the least value that is kept.
    """
    parent = nodes.parent[node]
    fixed = nodes.fixed[node]
    banned = np.empty(nodes.banned.shape[1], np.bool_)
    choice = nodes.choice[node].copy()
    u = nodes.u[node].copy()
    v = nodes.v[node].copy()
    old = nodes.banned[node].copy()
    for row in range(fixed, choice.size):
        most = nodes.value[node] - _bound(edges, row, fixed, old, choice, u, v)
        if most < limits[1] or _place(nodes.status, nodes.value, most) < 0:
            continue
        for c in range(banned.size):
            banned[c] = old[c] if row == fixed else False
        # The last place stands for no column.
        banned[choice[row]] = True
        for r in range(row):
            x.column[r] = choice[r]
        total = limits[0] + _assign(edges, n, row, banned, x, paths)
        _keep(nodes, total, limits[1], parent, row, banned, x)


@njit(**ENTRY)
def best_assignments(
    gain: F8, unassigned: F8, held: I8, base: F8, most: int, log_ratio: float
) -> tuple[I8, I8, F8]:
    """The best assignments of the measurements of a cluster, over all its hypotheses, best first.

    ``gain`` (m, A): log-weight of each measurement from each of the cluster's tracks, in all their
    forms, against its being unassigned and the track's being missed; −∞ outside the gate.
    ``unassigned`` (m,): log-weight of each measurement as a false alarm or a new target. ``held``
    (P, T): which of the A each hypothesis holds, −1: none. ``base`` (P,): log-weight of each
    hypothesis if all its tracks are missed. At ``most`` so many are given, and none whose
    log-weight is below the best's plus ``log_ratio`` (below 0): the hypothesis (K,) of each, which
    of the A each measurement goes to (K, m), −1: none, and their log-weights (K,).
    """
    m = gain.shape[0]
    width = held.shape[1]
    nodes = Nodes(
        np.zeros(most, np.int64), np.empty(most), np.empty(most, np.int64), np.empty(most, np.int64),
        np.empty((most, m), np.int64), np.empty((most, m)), np.empty((most, width)), np.empty((most, width + 1), np.bool_),
    )  # fmt: skip
    x = Matching(np.empty(m, np.int64), np.empty(width, np.int64), np.empty(m), np.empty(width))
    edges = Edges(np.zeros(m + 1, np.int64), np.empty(m * width, np.int64), np.empty(m * width))
    paths = new_paths(width)
    number = np.empty(width, np.int64)
    none = np.zeros(width + 1, np.bool_)
    rest = unassigned.sum()
    best = -np.inf
    for p in range(base.size):
        n = _write_edges(gain, held[p], edges, number)
        total = base[p] + rest + _assign(edges, n, 0, none, x, paths)
        _keep(nodes, total, best + log_ratio, p, 0, none, x)
        best = max(best, total)
    parent = np.empty(most, np.int64)
    choice = np.empty((most, m), np.int64)
    weight = np.empty(most)
    given = 0
    while given < most:
        node = -1
        for i in range(most):
            if nodes.status[i] == OPEN and (node < 0 or nodes.value[i] > nodes.value[node]):
                node = i
        if node < 0 or nodes.value[node] < best + log_ratio:
            break
        nodes.status[node] = DONE
        p = nodes.parent[node]
        n = _write_edges(gain, held[p], edges, number)
        parent[given] = p
        weight[given] = nodes.value[node]
        for j in range(m):
            c = nodes.choice[node, j]
            choice[given, j] = number[c] if c >= 0 else -1
        given += 1
        _divide(nodes, node, edges, n, (base[p] + rest, best + log_ratio), x, paths)
    return parent[:given], choice[:given], weight[:given]


@njit(**INNER)
def root(parent: I8, i: int) -> int:
    """The representative of ``i``; ways to it are halved in place."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(**INNER)
def unite(parent: I8, i: int, j: int) -> None:
    """Make one of the sets of ``i`` and ``j``; the smaller number represents it."""
    i = root(parent, i)
    j = root(parent, j)
    parent[max(i, j)] = min(i, j)


@njit(**INNER)
def numbered(parent: I8) -> I8:
    """(n,) the number of the set of each, from 0 in order of appearance."""
    out = np.empty(parent.size, np.int64)
    count = 0
    for i in range(parent.size):
        first = root(parent, i)
        if first == i:
            out[i] = count
            count += 1
        else:
            out[i] = out[first]
    return out


@njit(**ENTRY)
def components(count: int, first: I8, second: I8) -> I8:
    """(count,) the component of each vertex of a graph with edges ``first``–``second`` (E,), from 0
    by first appearance.
    """
    parent = np.arange(count)
    for e in range(first.size):
        unite(parent, first[e], second[e])
    out: I8 = numbered(parent)
    return out


@njit(**ENTRY)
def competing(leaf: I8, trace: I8, most: int) -> I8:
    """(T,) the component of each track of a cluster; tracks that have ever taken the same
    measurement are in one.

    ``leaf`` (H, T): the form in which each hypothesis holds each track, −1: not at all. ``trace``
    (L, W): the measurement, below ``most``, that each form rests on in each frame of the window,
    −1: none.
    """
    hypotheses, tracks = leaf.shape
    window = trace.shape[1]
    parent = np.arange(tracks)
    owner = np.full((window, most), -1, np.int64)
    seen = np.zeros(trace.shape[0], np.bool_)
    for h in range(hypotheses):
        for t in range(tracks):
            form = leaf[h, t]
            if form < 0 or seen[form]:
                continue
            seen[form] = True
            for w in range(window):
                j = trace[form, w]
                if j < 0:
                    continue
                if owner[w, j] < 0:
                    owner[w, j] = t
                else:
                    unite(parent, owner[w, j], t)
    out: I8 = numbered(parent)
    return out


@njit(**INNER)
def _start(edges: Records, live: I8, parent: I8, targets: int) -> None:
    """Write the first messages, the islands, and the numbers of the edges into ``live``."""
    for i in range(parent.size):
        parent[i] = i
    for e in range(edges.size):
        edge = edges[e]
        edge.nu = 1.0
        live[e] = e
        unite(parent, edge.target, targets + edge.measurement)
    for e in range(edges.size):
        edges[e].island = root(parent, edges[e].target)


@njit(**INNER)
def beliefs(edges: Records, targets: int, measurements: int) -> tuple[F8, F8]:
    """The probabilities that each target has no measurement, and (N,) that each measurement is no
    earlier target's.

    ``edges`` (E,) of `EDGE`: odds ψ ≥ 0, target and measurement are given, no pair twice; the rest
    is written.
    """
    seen = np.empty(targets)
    claimed = np.empty(measurements)
    moved = np.empty(targets)
    live = np.empty(edges.size, np.int64)
    count = edges.size
    turn = 0 * targets
    _start(edges, live, np.empty(targets + measurements, np.int64), targets)
    for j in range(measurements):
        claimed[j] = 0.0
    while True:
        for k in range(count):
            edge = edges[live[k]]
            seen[edge.target] = 0.0
            claimed[edge.measurement] = 0.0
            moved[edge.island] = 0.0
        for k in range(count):
            edge = edges[live[k]]
            seen[edge.target] += edge.odds * edge.nu
        for k in range(count):
            edge = edges[live[k]]
            others = seen[edge.target] - edge.odds * edge.nu
            if others > 0.0:
                edge.mu = edge.odds / (1.0 + others)
            else:
                edge.mu = edge.odds
            claimed[edge.measurement] += edge.mu
        turn += 1
        change = 0.0
        for k in range(count):
            edge = edges[live[k]]
            others = claimed[edge.measurement] - edge.mu
            if others > 0.0:
                value = 1.0 / (1.0 + others)
            else:
                value = 1.0
            step = abs(value - edge.nu)
            edge.nu = value
            moved[edge.island] = step if step > moved[edge.island] else moved[edge.island]
            change = step if step > change else change
        if change <= SETTLED or turn == ROUNDS:
            break
        # Where nothing has changed, nothing will: most islands are small, and one that is not would
        # keep all others waiting.
        left = 0 * count
        for k in range(count):
            if moved[edges[live[k]].island] > 0.0:
                live[left] = live[k]
                left += 1
        count = left
    for t in range(targets):
        seen[t] = 0.0
    for e in range(edges.size):
        seen[edges[e].target] += edges[e].odds * edges[e].nu
    for e in range(edges.size):
        edges[e].mu = edges[e].odds * edges[e].nu / (1.0 + seen[edges[e].target])
    for t in range(targets):
        seen[t] = 1.0 / (1.0 + seen[t])
    for j in range(measurements):
        claimed[j] = 1.0 / (1.0 + claimed[j])
    return seen, claimed
