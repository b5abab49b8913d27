"""Multi-frame graph matching, one frame at a time: candidate links, their gains, and the best
matching [M07 §3].

A vertex is an extracted state; vertices are numbered consecutively. Its out-side is a column of the
assignment problem, its in-side a row. Rows younger than the window are open; a column stays open
while the row that it is matched to is. The matching of maximum total gain is extended by one
augmenting path per new row, and its dual variables are kept between frames (`kernels.association`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from phdtrack.kernels import F8, I8
from phdtrack.kernels.appearance import (
    HOLDER,
    MOST,
    Looks,
    Pasts,
    named,
    pair_ratios,
    past_directions,
)
from phdtrack.kernels.association import (
    CLOSED,
    EDGE,
    UNUSED,
    Edges,
    Matching,
    augment,
    gain_of,
    new_paths,
)
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INLINED, INNER
from phdtrack.kernels.gaussian import PAIR, copy_gaussian, factor, norm2
from phdtrack.kernels.grid import Grid, make_grid, overlapping
from phdtrack.kernels.small_arrays import ascending_at
from phdtrack.kernels.verdicts import DOUBTFUL, write_verdicts

# A vertex keeps its best links, at most so many. It has more if 25 states are near it in each of 50
# frames.
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
    """Settings of links.

    States are linked over a model time of at most ``window`` and at most ``max_distance``
    deviations. ``loose_end``: deviations from a typical prediction at which a link gains as much as
    two loose ends. ``gap_cost``: nats per model time unit without a state.
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
    left = values.size - begin
    out = np.empty(left + more, values.dtype)
    for k in range(left):
        out[k] = values[begin + k]
    for k in range(left, out.size):
        out[k] = fill
    return out


@njit(**INLINED)
def _log_det(covariance: F8, i: int, other: F8, j: int, observed: I8, block: F8, root: F8) -> float:
    """Log-determinant of the observed block of covariance i plus, unless j < 0, that of ``other``
    j; writes its Cholesky factor into ``root``.

    −∞ if the block is not positive definite.
    """
    for a in range(observed.size):
        for b in range(observed.size):
            block[a, b] = covariance[i, observed[a], observed[b]]
            if j >= 0:
                block[a, b] += other[j, observed[a], observed[b]]
    # Not NaN either.
    log_det: float = max(-np.inf, factor(block, root))
    return log_det


@njit(**INNER)
def _best_links(target: I8, gain: F8) -> int:
    """Move the best edges of a vertex to the front, at most `MOST_LINKS`, in their order; returns
    how many there are.
    """
    if gain.size <= MOST_LINKS:
        return gain.size
    least = ascending_at(gain, gain.size - MOST_LINKS)
    kept = 0
    for k in range(gain.size):
        if gain[k] >= least and kept < MOST_LINKS:
            target[kept] = target[k]
            gain[kept] = gain[k]
            kept += 1
    return kept


class Linked(NamedTuple):
    """The looks of states, as far as links need them.

    ``past`` (R,): which of ``pasts`` each open vertex has, −1 for none. ``detection`` (n,): the
    measurement of each new state, −1 for none. ``looks``: of the measurements.
    """

    past: I8
    detection: I8
    pasts: Pasts
    looks: Looks


class Bounds(NamedTuple):
    """Bounds that limit the search for links.

    Of the n new states: ``loose`` (n,) the gain of two loose ends, ``own`` (n,) log-determinants of
    their covariances. Of the open vertices: ``price`` (R,) of the gap to them, ``predicted`` (R,)
    log-determinants of their covariances. ``farthest``: squared distance beyond which nothing is
    linked. ``most``: what appearance may add to a gain.
    """

    loose: F8
    own: F8
    price: F8
    predicted: F8
    farthest: float
    most: float


# The functions of one pair take arrays and no records: a record in a loop would have all of its
# arrays counted again.
@njit(**INNER)
def _limit(loose: float, own: float, price: float, predicted: float, farthest: float) -> float:
    """Squared distance within which a link may gain anything; the arguments are elements of
    `Bounds`, of the new state and of the open vertex.

    A gain above 0 needs d² < 2·(loose ends − price of the gap) − log|S|, and |S| is at least that
    of either covariance.
    """
    limit: float = 2.0 * (loose - price) - max(predicted, own)
    return min(limit, farthest)


@njit(**INNER)
def _bounds_of(
    covariance: F8, since: F8, fresh: Fresh, terms: Terms, dt: float, most: float
) -> Bounds:
    """Bounds of links from the new states to vertices with these covariances."""
    old = since.size
    n = fresh.mean.shape[0]
    r = fresh.observed.size
    block = np.empty((r, r))
    root = np.empty((r, r))
    loose = np.empty(n)
    own = np.empty(n)
    price = np.empty(old)
    predicted = np.empty(old)
    for i in range(n):
        loose[i] = 0.5 * (terms.loose_end * terms.loose_end + factor(fresh.typical[i], root))
        own[i] = _log_det(fresh.covariance, i, fresh.covariance, -1, fresh.observed, block, root)
    for c in range(old):
        price[c] = terms.gap_cost * (since[c] - dt)
        predicted[c] = _log_det(covariance, c, fresh.covariance, -1, fresh.observed, block, root)
    return Bounds(loose, own, price, predicted, terms.max_distance * terms.max_distance, most)


@njit(**INNER)
def _grid_of_vertices(mean: F8, covariance: F8, fresh: Fresh, bounds: Bounds) -> Grid:
    """A grid of rectangles about the open vertices, outside of which no new state can be linked to
    them.
    """
    old = bounds.price.size
    widest = np.zeros(2)
    best = -np.inf
    least = np.inf
    for i in range(fresh.mean.shape[0]):
        best = max(best, bounds.loose[i] + bounds.most)
        least = min(least, bounds.own[i])
        for a in range(2):
            o = fresh.observed[a]
            widest[a] = max(widest[a], fresh.covariance[i, o, o])
    lower = np.empty((2, old))
    upper = np.empty((2, old))
    for c in range(old):
        limit = _limit(best, least, bounds.price[c], bounds.predicted[c], bounds.farthest)
        for a in range(2):
            o = fresh.observed[a]
            extent = 0.0
            if limit > 0.0:
                extent = np.sqrt(limit * (covariance[c, o, o] + widest[a]))
            lower[a, c] = mean[c, o] - extent
            upper[a, c] = mean[c, o] + extent
    grid: Grid = make_grid(lower, upper, 0.0, 0.0)
    return grid


@njit(**INLINED)
def _step_within(
    mean: F8,
    covariance: F8,
    c: int,
    new_mean: F8,
    new_covariance: F8,
    i: int,
    observed: I8,
    limit: float,
    step: F8,
) -> bool:
    """Write the step from vertex c to new state i in the observed rows; False if the position
    alone shows that it is too long.
    """
    near = True
    for a in range(step.size):
        o = observed[a]
        step[a] = new_mean[i, o] - mean[c, o]
        if a < 2:
            spread = covariance[c, o, o] + new_covariance[i, o, o]
            near = near and step[a] * step[a] <= limit * spread
    return near


@njit(**INNER)
def _add_edges(
    mean: F8,
    covariance: F8,
    fresh: Fresh,
    bounds: Bounds,
    row: int,
    start: I8,
    target: I8,
    gain: F8,
) -> tuple[I8, F8]:
    """Targets and gains of the edges with those of the new states behind them, whose ends go into
    ``start``.

    gain = log N(step; 0, S) − log-density of two loose ends − gap_cost·(since − dt), S = predicted
    + new covariance, in the observed rows. ``row``: number of the first open vertex. Gains that
    appearance may make positive are among them.
    """
    new_mean, new_covariance, _, observed = fresh
    loose, own, price, predicted, farthest, most = bounds
    old = price.size
    r = observed.size
    block = np.empty((r, r))
    root = np.empty((r, r))
    step = np.empty(r)
    y = np.empty(r)
    grid = _grid_of_vertices(mean, covariance, fresh, bounds)
    near = np.empty(old, np.int64)
    count = start[old]
    for i in range(new_mean.shape[0]):
        px = new_mean[i, observed[0]]
        py = new_mean[i, observed[1]]
        some = overlapping(px, py, px, py, grid, near)
        if count + some > target.size:
            target = _kept(target, 0, count + some, 0)
            gain = _kept(gain, 0, count + some, 0.0)
        first = count
        for k in range(some):
            c = near[k]
            limit = _limit(loose[i] + most, own[i], price[c], predicted[c], farthest)
            if not _step_within(
                mean, covariance, c, new_mean, new_covariance, i, observed, limit, step
            ):
                continue
            log_det = _log_det(covariance, c, new_covariance, i, observed, block, root)
            distance2 = norm2(step, root, y)
            value = loose[i] - price[c] - 0.5 * (distance2 + log_det)
            if value > -most and distance2 <= farthest:
                target[count] = row + c
                gain[count] = value
                count += 1
        count = first + _best_links(target[first:count], gain[first:count])
        start[old + 1 + i] = count
    return target, gain


@njit(**INNER)
def _close(window: Window, closed: int, fresh: int) -> tuple[I8, int]:
    """The vertices matched to the out-sides after the first ``closed`` rows are closed, followed by
    so many ``fresh`` ones, and how many of the first out-sides are closed.

    A closed row takes its matched column with it, and a closed column without a row ends its track.
    """
    onward = _kept(window.next, 0, fresh, UNUSED)
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
    return onward, gone


@njit(**INNER)
def _open_states(predicted: F8, covariance: F8, closed: int, fresh: Fresh) -> tuple[F8, F8]:
    """Means and covariances of the open vertices: those predicted that stay open, then the new
    ones.
    """
    old = predicted.shape[0] - closed
    n, d = fresh.mean.shape
    mean = np.empty((old + n, d))
    cov = np.empty((old + n, d, d))
    for r in range(old):
        copy_gaussian(predicted, covariance, closed + r, mean, cov, r)
    for i in range(n):
        copy_gaussian(fresh.mean, fresh.covariance, i, mean, cov, old + i)
    return mean, cov


@njit(**INNER)
def _add_appearance(start: I8, target: I8, gain: F8, old: int, row: int, linked: Linked) -> None:
    """Add the log-likelihood ratios of what states look like to the gains of the edges of the new
    states, which are those after the first ``old`` rows, and leave out those that gain nothing.

    ``row``: number of the first open vertex.
    """
    first = start[old]
    pairs = np.empty(start[start.size - 1] - first, PAIR)
    edge = np.empty(pairs.size, np.int64)
    count = 0
    for i in range(linked.detection.size):
        j = linked.detection[i]
        for k in range(start[old + i], start[old + i + 1]):
            if j >= 0:
                pairs[count].gaussian = target[k] - row
                pairs[count].measurement = j
                edge[count] = k
                count += 1
    holders = np.empty(linked.past.size, HOLDER)
    for c in range(holders.size):
        holders[c].past = linked.past[c]
    seen_before = past_directions(linked.pasts, linked.looks)
    ratio = pair_ratios(pairs[:count], holders, linked.pasts, linked.looks, seen_before)
    for q in range(ratio.size):
        gain[edge[q]] += ratio[q]
    kept = first
    begin = first
    for i in range(linked.detection.size):
        end = start[old + i + 1]
        for k in range(begin, end):
            if gain[k] > 0.0:
                target[kept] = target[k]
                gain[kept] = gain[k]
                kept += 1
        start[old + i + 1] = kept
        begin = end


@njit(**INNER)
def _by_motion(start: I8, target: I8, gain: F8, onward: I8, row: tuple[int, int], count: int) -> I8:
    """(R,) `write_verdicts` on the open vertices before the new states (n,): the state that each
    goes on with; `DOUBTFUL` for one that goes on already.

    The odds of a link are exp(gain). ``onward``: of the first open vertex and those after it, what
    each is matched to before. ``row``: the numbers of the first open vertex, and of the first
    ``onward``; ``count``: of new states.
    """
    old = start.size - 1 - count
    edges = np.empty(start[old + count] - start[old], EDGE)
    odds = np.empty(edges.size)
    found = 0
    for i in range(count):
        for k in range(start[old + i], start[old + i + 1]):
            if onward[target[k] - row[1]] == UNUSED:
                edges[found].target = target[k] - row[0]
                edges[found].measurement = i
                odds[found] = np.exp(gain[k])
                found += 1
    verdicts = np.empty(old, np.int64)
    write_verdicts(edges[:found], odds[:found], count, verdicts)
    for c in range(old):
        if onward[row[0] + c - row[1]] != UNUSED:
            verdicts[c] = DOUBTFUL
    return verdicts


@njit(**ENTRY)
def link_states(
    window: Window,
    predicted: F8,
    covariance: F8,
    fresh: Fresh,
    terms: Terms,
    dt: float,
    appearance: Linked,
) -> tuple[Window, int, I8]:
    """One frame of the open matching: old vertices are closed, n new ones are linked [M07 §3].

    ``predicted`` (R, d), ``covariance`` (R, d, d): the states of the window before, predicted for
    the present frame; ``dt``: model time since then. ``appearance``: of the vertices of the window
    before, and of the new states. The second result is how many rows of the old window were closed:
    their links can no longer change. The third is what `_by_motion` says of the others (R',), (0,)
    where it is not known what states look like.
    """
    past, detection, pasts, looks = appearance
    n = fresh.mean.shape[0]
    # Close the vertices that have become older than the window.
    closed = 0
    while closed < window.since.size and window.since[closed] + dt > terms.window:
        closed += 1
    old = window.since.size - closed
    onward, gone = _close(window, closed, n)
    since = _kept(window.since, closed, n, -dt)
    for r in range(old + n):
        since[r] += dt
    mean, cov = _open_states(predicted, covariance, closed, fresh)
    # Link the new states to the open vertices.
    first = window.start[closed]
    start = _kept(window.start, closed, n, 0)
    for r in range(old + 1):
        start[r] -= first
    room = 8 * old + 64
    target = _kept(window.target, first, room, 0)
    gain = _kept(window.edge_gain, first, room, 0.0)
    linked = Linked(past[closed:], detection, Pasts(*pasts), named(looks))
    most = MOST * linked.looks.law.weight
    bounds = _bounds_of(cov, since[:old], fresh, terms, dt, most)
    row = window.row + closed
    target, gain = _add_edges(mean, cov, fresh, bounds, row, start, target, gain)
    verdicts = np.empty(0, np.int64)
    if len(linked.looks.mean) > 0:
        verdicts = _by_motion(start, target, gain, onward, (row, window.column), n)
        _add_appearance(start, target, gain, old, row, linked)
    # Extend the matching by the new rows.
    after = Window(
        window.column + gone,
        row,
        _kept(onward, gone, 0, UNUSED),
        _kept(window.column_price, gone, n, 0.0),
        since,
        _kept(window.previous, closed, n, -1),
        _kept(window.gain, closed, n, 0.0),
        _kept(window.row_price, closed, n, 0.0),
        start,
        target[: start[old + n]].copy(),
        gain[: start[old + n]].copy(),
        mean,
        cov,
    )
    _match_rows(after, old)
    return after, closed, verdicts


@njit(**INNER)
def _match_rows(w: Window, first: int) -> None:
    """Match the rows of a new window from place ``first`` on, in place; those before it are matched
    optimally.
    """
    # Columns and rows are counted from the first open one; a column below 0 is no longer open.
    edges = Edges(w.start, w.target - w.column, w.edge_gain)
    x = Matching(w.previous, w.next, w.row_price, w.column_price)
    _shift(x.column, -w.column)
    _shift(x.row, -w.row)
    paths = new_paths(w.next.size)
    none = np.zeros(w.next.size + 1, np.bool_)
    for row in range(first, w.since.size):
        augment(edges, row, -1, none, x, paths)
    for r in range(w.previous.size):
        w.gain[r] = gain_of(edges, r, x.column[r])
    _shift(x.column, w.column)
    _shift(x.row, w.row)


@njit(**INNER)
def _shift(numbers: I8, by: int) -> None:
    """Add ``by`` to the numbers of 0 and above."""
    for k in range(numbers.size):
        if numbers[k] >= 0:
            numbers[k] += by
