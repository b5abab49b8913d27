"""Multi-frame graph matching, one frame at a time: candidate links, their gains, and the best matching [M07 §3].

A vertex is an extracted state; vertices are numbered through. Its out-side is a column of the assignment problem, its
in-side
a row. Rows younger than the window are open; a column stays open while the row that it is matched to is. The matching of
maximum total gain is extended by one shortest augmenting path per new row (Jonker and Volgenant). Rows may stay unmatched at
gain 0. The dual variables are kept between frames: u_r + v_c ≤ −gain on every edge, with equality on matched ones, v_c = 0
on
free columns and u_r ≤ 0 with equality on unmatched rows certify that the total gain is the maximum.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.gaussian import factor, norm2
from phdtrack.kernels.grid import make_grid, overlapping

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

# A column without a row, and one that no row may take any more.
FREE, CLOSED = -1, -2
# What a search has seen of a column: nothing, that an edge leads to it, the shortest way to it.
UNSEEN, TOUCHED, DONE = 0, 1, 2


class Window(NamedTuple):
    """Open vertices, the edges between them and their matching.

    Attributes
    ----------
    column, row : numbers of the first vertex whose out-side and of the first whose in-side is held.
    next, column_price : (C,) the vertex matched to each out-side (or FREE, CLOSED), and its dual variable.
    since, previous, gain, row_price : (R,) of each in-side the model time since its frame, the vertex matched (−1: none),
        that
        link's gain, and the dual variable.
    start, target, edge_gain : (R + 1,), (E,), (E,) row r has edges to the vertices target[start[r]:start[r + 1]].
    mean, covariance : (R, d), (R, d, d) of the rows' vertices, predicted for the present frame.
    """

    column: int
    row: int
    next: I8
    column_price: F8
    since: F8
    previous: I8
    gain: F8
    row_price: F8
    start: I8
    target: I8
    edge_gain: F8
    mean: F8
    covariance: F8


class Links(NamedTuple):
    """Links (L,) from vertex ``later`` back to vertex ``earlier``, with their gains."""

    later: I8
    earlier: I8
    gain: F8


class Terms(NamedTuple):
    """What links are made under.

    Attributes
    ----------
    window : model time over which states are linked.
    loose_end : deviations from a typical prediction at which a link is worth two loose ends.
    gap_cost : nats per model time unit without a state.
    max_distance : deviations that linked states may be apart.
    """

    window: float
    loose_end: float
    gap_cost: float
    max_distance: float


class Fresh(NamedTuple):
    """The n states of the present frame.

    Attributes
    ----------
    mean, covariance : (n, d), (n, d, d).
    typical : (n, r, r) covariance of a typical one-step innovation at each.
    observed : (r,) rows of the state that a measurement shows; the first two are its position.
    """

    mean: F8
    covariance: F8
    typical: F8
    observed: I8


@njit(**INNER)
def _kept(values: F8, begin: int, more: int, fill: float) -> F8:
    """A copy of ``values`` from ``begin`` on with ``more`` elements ``fill`` behind."""
    out = np.empty(values.size - begin + more, values.dtype)
    for k in range(out.size):
        out[k] = values[begin + k] if begin + k < values.size else fill
    return out


@njit(**INNER)
def _block(covariance: F8, i: int, other: F8, j: int, observed: I8, out: F8) -> None:
    """The observed block of covariance i plus, unless j < 0, that of ``other`` j."""
    for a in range(observed.size):
        for b in range(observed.size):
            out[a, b] = covariance[i, observed[a], observed[b]]
            if j >= 0:
                out[a, b] += other[j, observed[a], observed[b]]


@njit(**INNER)
def _candidates(mean: F8, covariance: F8, since: F8, fresh: Fresh, terms: Terms, dt: float) -> tuple[I8, I8, F8, int]:
    """Pairs (new state, row, gain) whose link gains more than two loose ends, by row, and how many.

    gain = log N(step; 0, S) − log-density of two loose ends − gap_cost·(since − dt), S = predicted + new covariance, in the
    observed rows. A gain above 0 needs d² < 2·(loose ends − price of the gap) − log|S|, and |S| is at least that of either.
    """
    n, r = fresh.mean.shape[0], fresh.observed.size
    x, y = fresh.observed[0], fresh.observed[1]
    at, loose, own = np.empty((2, n)), np.empty(n), np.empty(n)
    block, root, step, space = np.empty((r, r)), np.empty((r, r)), np.empty(r), np.empty(r)
    best, least, wide, high, farthest = -np.inf, np.inf, 0.0, 0.0, terms.max_distance * terms.max_distance
    for i in range(n):
        at[0, i], at[1, i] = fresh.mean[i, x], fresh.mean[i, y]
        loose[i] = 0.5 * (terms.loose_end * terms.loose_end + factor(fresh.typical[i], root))
        _block(fresh.covariance, i, fresh.covariance, -1, fresh.observed, block)
        own[i] = factor(block, root)
        own[i] = own[i] if own[i] > -np.inf else -np.inf  # also NaN: not positive definite
        best, least = loose[i] if loose[i] > best else best, own[i] if own[i] < least else least
        wide = fresh.covariance[i, x, x] if fresh.covariance[i, x, x] > wide else wide
        high = fresh.covariance[i, y, y] if fresh.covariance[i, y, y] > high else high
    grid, found = make_grid(at, at, 0.0, 0.0), np.empty(n, np.int64)
    room, count = 8 * since.size + 64, 0
    state, row, gain = np.empty(room, np.int64), np.empty(room, np.int64), np.empty(room)
    for c in range(since.size):
        price = terms.gap_cost * (since[c] - dt)
        _block(covariance, c, fresh.covariance, -1, fresh.observed, block)
        predicted = factor(block, root)
        predicted = predicted if predicted > -np.inf else -np.inf
        limit = 2.0 * (best - price) - (least if least > predicted else predicted)
        limit = farthest if farthest < limit else limit
        if not limit > 0.0:
            continue
        left, top = mean[c, x], mean[c, y]
        reach_x = np.sqrt(limit * (covariance[c, x, x] + wide))
        reach_y = np.sqrt(limit * (covariance[c, y, y] + high))
        some = overlapping(left - reach_x, top - reach_y, left + reach_x, top + reach_y, grid, found)
        if count + some > room:
            room = 2 * (count + some)
            state, row = _kept(state, 0, room - state.size, 0), _kept(row, 0, room - row.size, 0)
            gain = _kept(gain, 0, room - gain.size, 0.0)
        for k in range(some):
            i = found[k]
            limit = 2.0 * (loose[i] - price) - (own[i] if own[i] > predicted else predicted)
            limit = farthest if farthest < limit else limit
            dx, dy = fresh.mean[i, x] - left, fresh.mean[i, y] - top
            if not dx * dx <= limit * (covariance[c, x, x] + fresh.covariance[i, x, x]):
                continue
            if not dy * dy <= limit * (covariance[c, y, y] + fresh.covariance[i, y, y]):
                continue
            _block(covariance, c, fresh.covariance, i, fresh.observed, block)
            log_det = factor(block, root)
            for a in range(r):
                step[a] = fresh.mean[i, fresh.observed[a]] - mean[c, fresh.observed[a]]
            distance2 = norm2(step, root, space)
            worth = loose[i] - price - 0.5 * (distance2 + log_det)
            if worth > 0.0 and distance2 <= farthest:
                state[count], row[count], gain[count] = i, c, worth
                count += 1
    return state, row, gain, count


@njit(**INNER)
def _with_edges(window: Window, closed: int, n: int, state: I8, row: I8, gain: F8, count: int) -> tuple[I8, I8, F8]:
    """Edges (start, target, gain) of the rows but the first ``closed``, and behind them of the n new ones."""
    old, first = window.since.size - closed, window.start[closed]
    held = window.start[window.since.size] - first
    start, target = np.zeros(old + n + 1, np.int64), np.empty(held + count, np.int64)
    value = np.empty(held + count)
    for r in range(old + 1):
        start[r] = window.start[closed + r] - first
    for e in range(held):
        target[e], value[e] = window.target[first + e], window.edge_gain[first + e]
    for p in range(count):
        start[old + 1 + state[p]] += 1
    for r in range(old, old + n):
        start[r + 1] += start[r]
    place = np.empty(n, np.int64)
    for i in range(n):
        place[i] = start[old + i]
    for p in range(count):
        e = place[state[p]]
        target[e], value[e] = window.row + closed + row[p], gain[p]
        place[state[p]] += 1
    return start, target, value


@njit(**ENTRY)
def link_states(window: Window, predicted: F8, covariance: F8, fresh: Fresh, terms: Terms, dt: float) -> tuple[Window, int]:
    """One frame of the open matching: time passes, old vertices are closed, n new ones are linked [M07 §3].

    Parameters
    ----------
    window : of the frame before.
    predicted, covariance : (R, d), (R, d, d) its states, predicted for the present frame.
    fresh : the n states of this frame.
    terms : what links are made under.
    dt : model time since the frame before.

    Returns
    -------
    The window with the new vertices, and how many rows of the old one were closed: their links can no longer change.
    """
    n, d, closed = fresh.mean.shape[0], fresh.mean.shape[1], 0
    while closed < window.since.size and window.since[closed] + dt > terms.window:
        closed += 1
    onward = _kept(window.next, 0, n, FREE)
    # A closed row takes its matched column with it, and a closed column without a row ends its track.
    for r in range(closed):
        if window.previous[r] >= 0:
            onward[window.previous[r] - window.column] = CLOSED
    begin = window.row - window.column
    for c in range(begin, begin + closed):
        if onward[c] < 0:
            onward[c] = CLOSED
    gone = 0
    while gone < begin + closed and onward[gone] == CLOSED:
        gone += 1
    since = _kept(window.since, closed, n, -dt)
    for r in range(since.size):
        since[r] += dt
    old = since.size - n
    mean, cov = np.empty((old + n, d)), np.empty((old + n, d, d))
    for r in range(old + n):
        for a in range(d):
            mean[r, a] = predicted[closed + r, a] if r < old else fresh.mean[r - old, a]
            for b in range(d):
                cov[r, a, b] = covariance[closed + r, a, b] if r < old else fresh.covariance[r - old, a, b]
    state, row, gain, count = _candidates(mean, cov, since[:old], fresh, terms, dt)
    start, target, value = _with_edges(window, closed, n, state, row, gain, count)
    after = Window(
        window.column + gone,
        window.row + closed,
        _kept(onward, gone, 0, FREE),
        _kept(window.column_price, gone, n, 0.0),
        since,
        _kept(window.previous, closed, n, -1),
        _kept(window.gain, closed, n, 0.0),
        _kept(window.row_price, closed, n, 0.0),
        start,
        target,
        value,
        mean,
        cov,
    )
    match_rows(after, old)
    return after, closed


@njit(**ENTRY)
def match_rows(w: Window, first: int) -> None:
    """Match the rows of a new window from place ``first`` on, in place; those before it are matched optimally."""
    columns = w.next.size
    seen, via, touched = np.zeros(columns, np.uint8), np.empty(columns, np.int64), np.empty(columns, np.int64)
    distance, along_gain = np.empty(columns), np.empty(columns)
    for row in range(first, w.since.size):
        w.row_price[row] = 0.0
        for e in range(w.start[row], w.start[row + 1]):
            c = w.target[e] - w.column
            if c >= 0 and w.next[c] != CLOSED and -w.edge_gain[e] - w.column_price[c] < w.row_price[row]:
                w.row_price[row] = -w.edge_gain[e] - w.column_price[c]
        here, reached, count = row, 0.0, 0
        shortest, loser, end = np.inf, -1, -1  # the best end so far: the row that it leaves unmatched, or a free column
        while True:
            if reached - w.row_price[here] < shortest:
                shortest, loser = reached - w.row_price[here], here
            for e in range(w.start[here], w.start[here + 1]):
                c = w.target[e] - w.column
                if c < 0 or seen[c] == DONE or w.next[c] == CLOSED:
                    continue
                along = reached - w.edge_gain[e] - w.row_price[here] - w.column_price[c]
                if seen[c] == UNSEEN:
                    seen[c], touched[count], distance[c] = TOUCHED, c, np.inf
                    count += 1
                if along < distance[c]:
                    distance[c], via[c], along_gain[c] = along, here, w.edge_gain[e]
            nearest, chosen = np.inf, -1
            for t in range(count):
                c = touched[t]
                if seen[c] == TOUCHED and distance[c] < nearest:
                    nearest, chosen = distance[c], c
            if chosen < 0 or shortest <= nearest:
                break
            seen[chosen] = DONE
            if w.next[chosen] < 0:
                shortest, end = nearest, chosen
                break
            here, reached = w.next[chosen] - w.row, nearest
        w.row_price[row] += shortest
        for t in range(count):
            c = touched[t]
            if seen[c] == DONE and w.next[c] >= 0:
                w.row_price[w.next[c] - w.row] += shortest - distance[c]
                w.column_price[c] -= shortest - distance[c]
            seen[c] = UNSEEN
        if end < 0:
            end = -1 if loser == row else w.previous[loser] - w.column
            w.previous[loser], w.gain[loser] = -1, 0.0
        # Flip the matching along the path, from its end back to the new row.
        while end >= 0:
            owner = via[end]
            before = w.previous[owner] - w.column
            w.previous[owner], w.next[end], w.gain[owner] = w.column + end, w.row + owner, along_gain[end]
            end = -1 if owner == row else before
