"""Data association: clusters of competing tracks, the k best assignments, marginal probabilities.

*Assignment* by shortest augmenting paths (Jonker and Volgenant). Rows may stay unassigned at gain
0. Dual variables certify that the total gain is the maximum: u_r + v_c ≤ −gain on every edge, with
equality where the row has the column; u_r ≤ 0, with equality where the row is unassigned; v_c ≤ 0,
and 0 where the column is free.

*The k best assignments* (Murty 1968) over all hypotheses of a cluster. Every measurement goes to a
track or to none, every track takes one at most. The best assignment of each hypothesis is a node;
the best node of all is returned and what remains of its set is partitioned: the s-th part assigns
the first s measurements as the node does and the s-th differently. Assignments below a share of the
best, or below those that will fill the remaining places, are not needed; and the dual variables of
a node bound what a part can gain before it is solved.

*Marginal probabilities* by loopy belief propagation [W14; W15; PMB (8), (9)]. With ψ_e the odds of
a pair e = (target, measurement) against the target being missed and the measurement being no
earlier target's, the messages are

    μ_e = ψ_e / (1 + Σ_{other pairs of the target} ψ ν)
    ν_e = 1 / (1 + Σ_{other pairs of the measurement} μ)

They converge, whatever ψ [W14], and are exact where pairs form a tree; a round costs as many steps
as there are pairs of targets and measurements whose messages still change.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from phdtrack.kernels import F8, I8, Bool, Records
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.gaussian import records
from phdtrack.kernels.grid import sorted_by_cell
from phdtrack.kernels.small_arrays import flags, floats, zeros

# A column without a row, and one that no row may take any more.
UNUSED = -1
CLOSED = -2
# A column in a search: no edge leads to it yet; its path may still become shorter; its path is the
# shortest.
UNVISITED = 0
QUEUED = 1
SCANNED = 2
# A place for a node: empty, with a node, with a node that was returned.
FREE = 0
OPEN = 1
DONE = 2
# Messages are passed at most so often, and until none changes by more than this.
ROUNDS = 50
SETTLED = 1e-6
# A pair: its odds ψ, and μ, which becomes its marginal probability; its two ends.
EDGE = records("odds mu", "target measurement")


class Edges(NamedTuple):
    """Edges of row r to the columns target[start[r]:start[r + 1]], with gains; columns below 0 are
    ignored.
    """

    start: I8
    target: I8
    gain: F8


class Matching(NamedTuple):
    """A matching: ``column`` (m,) of each row, −1: none; ``row`` (n,) of each column, or UNUSED or
    CLOSED; dual variables ``u`` (m,) and ``v`` (n,).
    """

    column: I8
    row: I8
    u: F8
    v: F8


class Paths(NamedTuple):
    """Working space of a search, each (n,): the last row and the length of the path to each column,
    its status (all UNVISITED between searches), and the columns that were visited.
    """

    via: I8
    distance: F8
    status: I8
    visited: I8


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
    """Working space for a search over so many columns."""
    return Paths(zeros(columns), np.empty(columns), zeros(columns), zeros(columns))


@njit(**INNER)
def augment(edges: Edges, row: int, first: int, banned: Bool, x: Matching, paths: Paths) -> bool:
    """Assign ``row`` too, in place, by the shortest augmenting path; False if it cannot be done.

    Row ``first`` may not have the columns ``banned``, and not stay unassigned if the last of them
    is true.
    """
    x.u[row] = _dual_of_row(edges, row, row == first, banned, x)
    if x.u[row] == np.inf:
        return False
    length, end, loser, visited = _shortest_path(edges, row, first, banned, x, paths)
    # Update the dual variables, so that slacks along the path become 0.
    x.u[row] += length
    for t in range(visited):
        c = paths.visited[t]
        if paths.status[c] == SCANNED and x.row[c] >= 0:
            x.u[x.row[c]] += length - paths.distance[c]
            x.v[c] -= length - paths.distance[c]
        paths.status[c] = UNVISITED
    if length == np.inf:
        return False
    if end < 0:
        if loser != row:
            end = x.column[loser]
        x.column[loser] = -1
    # Flip the matching along the path, from its end back to the new row.
    while end >= 0:
        owner = paths.via[end]
        before = -1
        if owner != row:
            before = x.column[owner]
        x.column[owner] = end
        x.row[end] = owner
        end = before
    return True


@njit(**INNER)
def _dual_of_row(edges: Edges, row: int, restricted: bool, banned: Bool, x: Matching) -> float:
    """The dual variable of a new row, the smallest slack of its edges; ∞ if it has no choice.

    The columns ``banned`` apply if the row is ``restricted``.
    """
    dual = 0.0
    if restricted and banned[-1]:
        dual = np.inf
    for e in range(edges.start[row], edges.start[row + 1]):
        c = edges.target[e]
        if c < 0 or x.row[c] == CLOSED or (restricted and banned[c]):
            continue
        slack = -edges.gain[e] - x.v[c]
        if slack < dual:
            dual = slack
    return dual


@njit(**INNER)
def _shortest_path(
    edges: Edges, row: int, first: int, banned: Bool, x: Matching, paths: Paths
) -> tuple[float, int, int, int]:
    """The length of the shortest augmenting path from ``row``, and where it ends (Dijkstra).

    Returns the length, the free column at its end or −1, the row that it leaves unassigned if there
    is no such column, and how many columns were visited.
    """
    _, distance, status, visited = paths
    here = row
    reached = 0.0
    count = 0 * row
    shortest = np.inf
    loser = -1
    end = -1
    while True:
        # A path may end in a row that stays unassigned.
        if not (here == first and banned[-1]) and reached - x.u[here] < shortest:
            shortest = reached - x.u[here]
            loser = here
        count = _visit(edges, here, reached, here == first, banned, x, paths, count)
        nearest = np.inf
        chosen = -1
        for t in range(count):
            c = visited[t]
            if status[c] == QUEUED and distance[c] < nearest:
                nearest = distance[c]
                chosen = c
        if chosen < 0 or shortest <= nearest:
            break
        status[chosen] = SCANNED
        if x.row[chosen] < 0:
            shortest = nearest
            end = chosen
            break
        here = x.row[chosen]
        reached = nearest
    return shortest, end, loser, count


@njit(**INNER)
def _visit(
    edges: Edges,
    here: int,
    reached: float,
    restricted: bool,
    banned: Bool,
    x: Matching,
    paths: Paths,
    count: int,
) -> int:
    """Shorten the paths to the columns of row ``here``, to which the path has length ``reached``.

    Returns how many columns were visited so far, of which there were ``count``.
    """
    via, distance, status, visited = paths
    for e in range(edges.start[here], edges.start[here + 1]):
        c = edges.target[e]
        if c < 0 or status[c] == SCANNED or x.row[c] == CLOSED or (restricted and banned[c]):
            continue
        if status[c] == UNVISITED:
            status[c] = QUEUED
            visited[count] = c
            distance[c] = np.inf
            count += 1
        length = reached - edges.gain[e] - x.u[here] - x.v[c]
        if length < distance[c]:
            distance[c] = length
            via[c] = here
    return count


@njit(**INNER)
def gain_of(edges: Edges, row: int, column: int) -> float:
    """The gain of the edge from a row to a column; 0 if the column is −1."""
    if column < 0:
        return 0.0
    for e in range(edges.start[row], edges.start[row + 1]):
        if edges.target[e] == column:
            gain: float = edges.gain[e]
            return gain
    return 0.0


@njit(**INNER)
def _assign(edges: Edges, n: int, first: int, banned: Bool, x: Matching, paths: Paths) -> float:
    """Assign the rows from ``first`` on to n columns; the sum of all rows' gains, −∞ if it cannot
    be done.

    Rows before ``first`` keep their columns in ``x``, into which the assignment is written; row
    ``first`` may not have the columns ``banned``, see `augment`.
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
    """(count,) the column of each of ``count`` rows, −1: none, with the largest sum of gains.

    ``row``, ``column``, ``gain`` (E,): the possible pairs, in the order of their rows; columns are
    below ``count``.
    """
    start = zeros(count + 1)
    none = flags(count + 1, False)
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
    """A lower bound of what a node loses if ``row`` must change its column: the smallest slack of
    its alternatives.

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
        if not taken:
            least = slack
    return max(least, 0.0)


@njit(**INNER)
def _place(status: I8, value: F8, fresh: float) -> int:
    """A place for a node of value ``fresh``: a free one, else that of the worst open node if that
    is worse, else −1.
    """
    worst = fresh
    place = -1
    for i in range(status.size):
        if status[i] == FREE:
            return i
        if status[i] == OPEN and value[i] < worst:
            worst = value[i]
            place = i
    return place


@njit(**INNER)
def _keep(
    nodes: Nodes, total: float, least: float, parent: int, fixed: int, banned: Bool, x: Matching
) -> None:
    """Keep the assignment as an open node, if its value ``total`` is at least ``least`` and there
    is room.
    """
    if total == -np.inf or total < least:
        return
    at = _place(nodes.status, nodes.value, total)
    if at < 0:
        return
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
    """Write the numbers of the tracks that a hypothesis holds, and the edges of the measurements to
    them; returns how many tracks there are.
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
    """Partition what remains of a node's set: the s-th part keeps the node's first rows and changes
    the s-th.

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
            banned[c] = row == fixed and old[c]
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

    ``gain`` (m, A): log-weight of each measurement as detection of each single-target hypothesis of
    the cluster, against its being unassigned and the track's being missed; −∞ outside the gate.
    ``unassigned`` (m,): log-weight of each measurement as a false alarm or a new target. ``held``
    (P, T): which of the A each hypothesis holds, −1: none. ``base`` (P,): log-weight of each
    hypothesis if all its tracks are missed. Returns at ``most`` so many, and none whose log-weight
    is below the best's plus ``log_ratio`` (below 0): the hypothesis (K,) of each, which of the A
    each measurement is assigned to (K, m), −1: none, and their log-weights (K,).
    """
    m = gain.shape[0]
    width = held.shape[1]
    nodes = Nodes(
        np.zeros(most, np.int64),
        np.empty(most),
        np.empty(most, np.int64),
        np.empty(most, np.int64),
        np.empty((most, m), np.int64),
        np.empty((most, m)),
        np.empty((most, width)),
        np.empty((most, width + 1), np.bool_),
    )
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
    count = 0
    while count < most:
        node = -1
        for i in range(most):
            if nodes.status[i] == OPEN and (node < 0 or nodes.value[i] > nodes.value[node]):
                node = i
        if node < 0 or nodes.value[node] < best + log_ratio:
            break
        nodes.status[node] = DONE
        p = nodes.parent[node]
        n = _write_edges(gain, held[p], edges, number)
        parent[count] = p
        weight[count] = nodes.value[node]
        for j in range(m):
            c = nodes.choice[node, j]
            choice[count, j] = number[c] if c >= 0 else -1
        count += 1
        _divide(nodes, node, edges, n, (base[p] + rest, best + log_ratio), x, paths)
    return parent[:count], choice[:count], weight[:count]


@njit(**INNER)
def root(parent: I8, i: int) -> int:
    """The representative of the set of ``i`` (union-find); halves the paths to it in place."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(**INNER)
def unite(parent: I8, i: int, j: int) -> None:
    """Unite the sets of ``i`` and ``j``; the smaller number represents the union."""
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
    """(count,) the connected component of each vertex of a graph with edges ``first``–``second``
    (E,), numbered from 0 by first appearance.
    """
    parent = np.arange(count)
    for e in range(first.size):
        unite(parent, first[e], second[e])
    out: I8 = numbered(parent)
    return out


@njit(**ENTRY)
def competing(leaf: I8, trace: I8, most: int) -> I8:
    """(T,) the component of each track of a cluster; tracks that share a measurement in any
    hypothesis are in one.

    ``leaf`` (H, T): the single-target hypothesis of each track in each global hypothesis, −1: none.
    ``trace`` (L, W): the measurement, below ``most``, of each leaf in each frame of the window, −1:
    none.
    """
    hypotheses, tracks = leaf.shape
    window = trace.shape[1]
    parent = np.arange(tracks)
    owner = np.full((window, most), -1, np.int64)
    done = np.zeros(trace.shape[0], np.bool_)
    for h in range(hypotheses):
        for t in range(tracks):
            own = leaf[h, t]
            if own < 0 or done[own]:
                continue
            done[own] = True
            for w in range(window):
                j = trace[own, w]
                if j < 0:
                    continue
                if owner[w, j] < 0:
                    owner[w, j] = t
                else:
                    unite(parent, owner[w, j], t)
    out: I8 = numbered(parent)
    return out


@njit(**INNER)
def beliefs(edges: Records, targets: int, measurements: int) -> tuple[F8, F8]:
    """Marginal probabilities by loopy belief propagation [PMB (9)].

    ``edges`` (E,) of `EDGE`, no pair twice, with odds ψ ≥ 0, target and measurement; μ becomes the
    probability of each pair. Returns the probabilities (T,) that each target has no measurement,
    and (N,) that each measurement is no earlier target's.
    """
    size = edges.size
    # In arrays of their own: a round reads little else.
    odds = np.empty(size)
    mu = floats(size, -1.0)
    nu = floats(size, 1.0)
    target = np.empty(size, np.int64)
    measurement = np.empty(size, np.int64)
    for e in range(size):
        odds[e] = edges[e].odds
        target[e] = edges[e].target
        measurement[e] = edges[e].measurement
    by_target = sorted_by_cell(target, targets)
    by_measurement = sorted_by_cell(measurement, measurements)
    ones = floats(size, 1.0)
    targets_changed = flags(targets, True)
    measurements_changed = flags(measurements, False)
    detected = floats(targets, 0.0)
    claimed = floats(measurements, 0.0)
    for _ in range(ROUNDS):
        changed = targets_changed, measurements_changed
        _send(by_target, odds, nu, mu, measurement, detected, changed)
        changed = measurements_changed, targets_changed
        if _send(by_measurement, ones, mu, nu, target, claimed, changed) <= SETTLED:
            break
    begin, order = by_target
    for t in range(targets):
        total = 0.0
        for k in range(begin[t], begin[t + 1]):
            total += odds[order[k]] * nu[order[k]]
        for k in range(begin[t], begin[t + 1]):
            edges[order[k]].mu = odds[order[k]] * nu[order[k]] / (1.0 + total)
        detected[t] = 1.0 / (1.0 + total)
    for j in range(measurements):
        claimed[j] = 1.0 / (1.0 + claimed[j])
    return detected, claimed


@njit(**INNER)
def _send(
    by_end: tuple[I8, I8],
    odds: F8,
    received: F8,
    sent: F8,
    other_end: I8,
    total: F8,
    changed: tuple[Bool, Bool],
) -> float:
    """Compute the messages that targets, or measurements, send along their pairs [PMB (8)]; returns
    the largest change.

    With a the odds of a pair and r the message received along it, a / (1 + Σ_{other pairs} a r) is
    sent: μ by a target with a = ψ and r = ν, ν by a measurement with a = 1 and r = μ.

    Parameters
    ----------
    by_end : where the edges of each target or measurement begin, and the edges in this order.
    odds, received, sent : (E,) a, r and what is sent; ``other_end``: (E,) who receives it.
    total : written at each that sends: Σ a r.
    changed : who received another message than before and has to send, which is cleared, and who is
        sent another one, which is marked.
    """
    begin, order = by_end
    stale, informed = changed
    largest = 0.0
    for i in range(stale.size):
        if not stale[i]:
            continue
        stale[i] = False
        total[i] = 0.0
        for k in range(begin[i], begin[i + 1]):
            total[i] += odds[order[k]] * received[order[k]]
        for k in range(begin[i], begin[i + 1]):
            e = order[k]
            others = total[i] - odds[e] * received[e]
            value = odds[e]
            # A difference of sums may be rounding below 0.
            if others > 0.0:
                value = odds[e] / (1.0 + others)
            if value != sent[e]:
                largest = max(largest, abs(value - sent[e]))
                sent[e] = value
                informed[other_end[e]] = True
    return largest
