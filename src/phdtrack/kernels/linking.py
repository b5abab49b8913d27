"""Multi-frame graph matching, one frame at a time: candidate links, their gains, and the best
matching [M07 §3].

A vertex is an extracted state; vertices are numbered through. Its out-side is a column of the
assignment problem, its in-side a row. Rows younger than the window are open; a column stays open
while the row that it is matched to is. The matching of maximum total gain is extended by one
augmenting path per new row, and its dual variables are kept between frames (`kernels.association`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from phdtrack.kernels import F8, I8
from phdtrack.kernels.association import (
    CLOSED,
    UNUSED,
    Edges,
    Matching,
    augment,
    gain_of,
    new_paths,
)
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.gaussian import factor, norm2
from phdtrack.kernels.grid import make_grid, overlapping

# Links that a vertex may have, the best. Where 25 states are about it in each of 50 frames there
# are more.
MOST_LINKS = 512


class Window(NamedTuple):
    """Open vertices, the edges between them and their matching.

    ``column``, ``row``: numbers of the first vertex whose out-side and of the first whose in-side
    is held. ``next``, ``column_price`` (C,): the vertex matched to each out-side (or UNUSED,
    CLOSED), and its dual variable. ``since``, ``previous``, ``gain``, ``row_price`` (R,): of each
    in-side the model time since its frame, the vertex matched (−1: none), that link's gain, and the
    dual variable. ``start`` (R + 1,), ``target``, ``edge_gain`` (E,): row r has edges to the
    vertices target[start[r]:start[r + 1]]. ``mean`` (R, d), ``covariance`` (R, d, d): of the rows'
    vertices, predicted for the present frame.
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
    """The conditions for links.

    States are linked over a model time of ``window`` and ``max_distance`` deviations apart at most.
    ``loose_end``: deviations from a typical prediction at which a link gains as much as two loose
    ends. ``gap_cost``: nats per model time unit without a state.
    """

    window: float
    loose_end: float
    gap_cost: float
    max_distance: float


class Fresh(NamedTuple):
    """The n states of the present frame: ``mean`` (n, d), ``covariance`` (n, d, d).

    ``typical`` (n, r, r): covariance of a typical one-step innovation at each. ``observed`` (r,):
    rows of the state that a measurement shows; the first two are its position.
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
def _log_det(covariance: F8, i: int, other: F8, j: int, observed: I8, block: F8, root: F8) -> float:
    """log-determinant of the observed block of covariance i plus, unless j < 0, that of ``other``
    j; ``root`` its factor.

    −∞ where the block is not positive definite.
    """
    for a in range(observed.size):
        for b in range(observed.size):
            block[a, b] = covariance[i, observed[a], observed[b]]
            if j >= 0:
                block[a, b] += other[j, observed[a], observed[b]]
    found = factor(block, root)
    return found if found > -np.inf else -np.inf  # also NaN


@njit(**INNER)
def _best_links(target: I8, gain: F8) -> int:
    """How many edges of a vertex are kept, the best, which are moved to the front in their order:
    at most `MOST_LINKS`.
    """
    if gain.size <= MOST_LINKS:
        return gain.size
    least = np.sort(gain)[gain.size - MOST_LINKS]
    kept = 0
    for k in range(gain.size):
        if gain[k] >= least and kept < MOST_LINKS:
            target[kept] = target[k]
            gain[kept] = gain[k]
            kept += 1
    return kept


@njit(**INNER)
def _add_edges(
    mean: F8,
    covariance: F8,
    since: F8,
    fresh: Fresh,
    terms: Terms,
    dt: float,
    row: int,
    start: I8,
    target: I8,
    gain: F8,
) -> tuple[I8, F8]:
    """Targets and gains of the edges with those of the new states behind them, whose ends go into
    ``start``.

    gain = log N(step; 0, S) − log-density of two loose ends − gap_cost·(since − dt), S = predicted
    + new covariance, in the observed rows. A gain above 0 needs d² < 2·(loose ends − price of the
    gap) − log|S|, and |S| is at least that of either.
    """
    old = since.size
    n = fresh.mean.shape[0]
    r = fresh.observed.size
    farthest = terms.max_distance * terms.max_distance
    block = np.empty((r, r))
    root = np.empty((r, r))
    step = np.empty(r)
    space = np.empty(r)
    loose = np.empty(n)
    own = np.empty(n)
    widest = np.zeros(2)
    best = -np.inf
    least = np.inf
    for i in range(n):
        loose[i] = 0.5 * (terms.loose_end * terms.loose_end + factor(fresh.typical[i], root))
        own[i] = _log_det(fresh.covariance, i, fresh.covariance, -1, fresh.observed, block, root)
        best = loose[i] if loose[i] > best else best
        least = own[i] if own[i] < least else least
        for a in range(2):
            spread = fresh.covariance[i, fresh.observed[a], fresh.observed[a]]
            widest[a] = spread if spread > widest[a] else widest[a]
    price = np.empty(old)
    predicted = np.empty(old)
    lower = np.empty((2, old))
    upper = np.empty((2, old))
    for c in range(old):
        price[c] = terms.gap_cost * (since[c] - dt)
        predicted[c] = _log_det(covariance, c, fresh.covariance, -1, fresh.observed, block, root)
        limit = 2.0 * (best - price[c]) - (least if least > predicted[c] else predicted[c])
        if farthest < limit:
            limit = farthest
        else:
            limit = limit
        for a in range(2):
            o = fresh.observed[a]
            if limit > 0.0:
                reach = np.sqrt(limit * (covariance[c, o, o] + widest[a]))
            else:
                reach = 0.0
            lower[a, c] = mean[c, o] - reach
            upper[a, c] = mean[c, o] + reach
    grid = make_grid(lower, upper, 0.0, 0.0)
    found = np.empty(old, np.int64)
    count = start[old]
    for i in range(n):
        x = fresh.mean[i, fresh.observed[0]]
        y = fresh.mean[i, fresh.observed[1]]
        some = overlapping(x, y, x, y, grid, found)
        if count + some > target.size:
            target = _kept(target, 0, count + some, 0)
            gain = _kept(gain, 0, count + some, 0.0)
        for k in range(some):
            c = found[k]
            limit = 2.0 * (loose[i] - price[c]) - (
                own[i] if own[i] > predicted[c] else predicted[c]
            )
            if farthest < limit:
                limit = farthest
            else:
                limit = limit
            near = True
            for a in range(r):
                o = fresh.observed[a]
                step[a] = fresh.mean[i, o] - mean[c, o]
                near = near and (
                    a > 1
                    or step[a] * step[a]
                    <= limit * (covariance[c, o, o] + fresh.covariance[i, o, o])
                )
            if not near:
                continue
            log_det = _log_det(covariance, c, fresh.covariance, i, fresh.observed, block, root)
            distance2 = norm2(step, root, space)
            value = loose[i] - price[c] - 0.5 * (distance2 + log_det)
            if value > 0.0 and distance2 <= farthest:
                target[count] = row + c
                gain[count] = value
                count += 1
        count = start[old + i] + _best_links(
            target[start[old + i] : count], gain[start[old + i] : count]
        )
        start[old + 1 + i] = count
    return target, gain


@njit(**ENTRY)
def link_states(
    window: Window, predicted: F8, covariance: F8, fresh: Fresh, terms: Terms, dt: float
) -> tuple[Window, int]:
    """One frame of the open matching: time passes, old vertices are closed, n new ones are linked
    [M07 §3].

    ``predicted`` (R, d), ``covariance`` (R, d, d): the states of the window before, predicted for
    the present frame; ``dt``: model time since then. The second number is how many rows of the old
    window were closed: their links can no longer change.
    """
    n = fresh.mean.shape[0]
    d = fresh.mean.shape[1]
    closed = 0
    while closed < window.since.size and window.since[closed] + dt > terms.window:
        closed += 1
    onward = _kept(window.next, 0, n, UNUSED)
    # A closed row takes its matched column with it, and a closed column without a row ends its
    # track.
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
    old = window.since.size - closed
    since = _kept(window.since, closed, n, -dt)
    mean = np.empty((old + n, d))
    cov = np.empty((old + n, d, d))
    for r in range(old + n):
        since[r] += dt
        for a in range(d):
            mean[r, a] = predicted[closed + r, a] if r < old else fresh.mean[r - old, a]
            for b in range(d):
                cov[r, a, b] = (
                    covariance[closed + r, a, b] if r < old else fresh.covariance[r - old, a, b]
                )
    first = window.start[closed]
    start = _kept(window.start, closed, n, 0)
    room = 8 * old + 64
    for r in range(old + 1):
        start[r] -= first
    target = _kept(window.target, first, room, 0)
    value = _kept(window.edge_gain, first, room, 0.0)
    target, value = _add_edges(
        mean, cov, since[:old], fresh, terms, dt, window.row + closed, start, target, value
    )
    target = target[: start[old + n]].copy()
    value = value[: start[old + n]].copy()
    onward = _kept(onward, gone, 0, UNUSED)
    previous = _kept(window.previous, closed, n, -1)
    gain = _kept(window.gain, closed, n, 0.0)
    row_price = _kept(window.row_price, closed, n, 0.0)
    prices = _kept(window.column_price, gone, n, 0.0)
    column = window.column + gone
    row = window.row + closed
    after = Window(
        column,
        row,
        onward,
        prices,
        since,
        previous,
        gain,
        row_price,
        start,
        target,
        value,
        mean,
        cov,
    )
    _match_rows(after, old)
    return after, closed


@njit(**INNER)
def _match_rows(w: Window, first: int) -> None:
    """Match the rows of a new window from place ``first`` on, in place; those before it are matched
    optimally.
    """
    # In place of the vertices' numbers, places among the open ones; a column below 0 is no longer
    # open.
    edges = Edges(w.start, w.target - w.column, w.edge_gain)
    x = Matching(w.previous, w.next, w.row_price, w.column_price)
    for r in range(w.previous.size):
        x.column[r] -= w.column if x.column[r] >= 0 else 0
    for c in range(w.next.size):
        x.row[c] -= w.row if x.row[c] >= 0 else 0
    paths = new_paths(w.next.size)
    none = np.zeros(w.next.size + 1, np.bool_)
    for row in range(first, w.since.size):
        augment(edges, row, -1, none, x, paths)
    for r in range(w.previous.size):
        w.gain[r] = gain_of(edges, r, x.column[r])
        x.column[r] += w.column if x.column[r] >= 0 else 0
    for c in range(w.next.size):
        x.row[c] += w.row if x.row[c] >= 0 else 0
