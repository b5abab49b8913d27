"""The recent past of the association graph: its open vertices, its edges and the best matching between them.

A vertex is an extracted state; vertices are numbered through. Its out-side is a column of the matching problem, its in-side
a row. Vertices younger than the span are open on both sides and carry their state predicted for the present frame, moved on
step by step, so that an edge over j frames uses the j-step transition. An older one keeps its out-side open while the row
that it is matched to is. A record is never written into; each frame makes a new one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.associate.triangle import Block
from phdtrack.errors import InputError
from phdtrack.kernels.association import LANES
from phdtrack.kernels.linking import link_states
from phdtrack.types import F8, I8


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Out-sides (S,) of the vertices from ``first`` on: ``next`` is the vertex matched to each, −1 where none is, −2 where
    the out-side is closed; ``price`` its dual variable."""

    first: int
    next: I8
    price: F8


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """Edges by row: row r has those from start[r] to start[r + 1] − 1, to vertices ``target`` with gains ``gain``."""

    start: I8
    target: I8
    gain: F8

    def arrays(self) -> tuple[I8, I8, F8]:
        """As the kernels take them."""
        return self.start, self.target, self.gain


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """In-sides (R,) of the vertices from ``first`` on, whose link may still be corrected.

    ``since`` model time since their frame, descending. ``previous`` the vertex matched, −1 where none is, and ``gain`` of
    that link; ``price`` the dual variable. Edges are those of ``older`` and then of ``recent``: the few frames' that are
    copied to add the next ones, so that most are not.
    """

    first: int
    since: F8
    previous: I8
    gain: F8
    price: F8
    older: Edges
    recent: Edges


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """Columns and rows of the recent past; ``mean`` (d, G + R) and ``cov`` (k, G + R) predict the rows' vertices for now.

    Of covariances the lower triangle is held, its k = d·(d + 1)/2 elements by row (`lower`). The first G states are of
    vertices that have been closed: they are left behind with the next prediction.
    """

    columns: Columns
    rows: Rows
    mean: F8
    cov: F8


@dataclass(frozen=True, slots=True, eq=False)
class Moved:
    """The R states of the window predicted for now, and the n new ones behind them.

    ``mean``, ``cov`` (d, R + n), (k, R + n); ``noise`` (k, n) the motion's in this interval from the new states, as far as
    a measurement shows it. Of covariances the lower triangles, as in `Window`.
    """

    mean: F8
    cov: F8
    noise: F8


@dataclass(frozen=True, slots=True)
class Terms:
    """What links are made under: ``span`` in model time, ``gate``, log of ``miss``, ``consistent`` of `GraphMatching`."""

    span: float
    gate: float
    log_miss: float
    consistent: float


@dataclass(frozen=True, slots=True, eq=False)
class Links:
    """Links (L,) from vertex ``later`` back to vertex ``earlier``, with their gains."""

    later: I8
    earlier: I8
    gain: F8


_NONE, _ZERO = np.zeros(0, np.int64), np.zeros(0)
_NO_EDGES = Edges(np.zeros(1, np.int64), _NONE, _ZERO)
NO_LINKS = Links(_NONE, _NONE, _ZERO)


def empty_window(dim: int) -> Window:
    """No vertices."""
    rows = Rows(0, _ZERO, _NONE, _ZERO, _ZERO, _NO_EDGES, _NO_EDGES)
    return Window(Columns(0, _NONE, _ZERO), rows, np.zeros((dim, 0)), np.zeros((dim * (dim + 1) // 2, 0)))


def links(window: Window, most: int | None = None) -> Links:
    """The links of the rows, or of the first ``most`` of them."""
    rows = window.rows
    linked = (rows.previous[:most] >= 0).nonzero()[0]
    if len(linked) == 0:
        return NO_LINKS
    return Links(rows.first + linked, rows.previous[linked], rows.gain[linked])


def extend(window: Window, moved: Moved, sigma: F8, shown: Block, terms: Terms, dt: float) -> tuple[Window, Links]:
    """Let ``dt`` pass, close what is older than the span, and add the n vertices of the present frame [M07 §3].

    ``sigma`` (d, n) are the deviations with which the new states are measured, in the rows ``shown``. Edges lead from them
    back to vertices of the window where that gains more than two loose ends:

    gain = log N(step; 0, S) − log-density of two loose ends + (since − dt)·log miss, S = predicted + own covariance, on the
    rows that a measurement shows. The loose ends' is the density at ``gate`` deviations from a typical one-step prediction:
    two measurements' noise and one step of the motion's. The matching is extended by one augmenting path per new vertex,
    which may undo earlier links: the correction of false hypotheses.

    Returns the window and the links that can no longer change. A closed row takes its matched column with it; a closed
    column without a row ends its track. The rest stays optimally matched, because the dual variables of what is left still
    certify it. Raises `InputError` where a position is not finite.
    """
    # Most often enough; memory that is not written to costs nothing.
    room = 8 * len(window.rows.since) + 64
    while True:
        found, extended, final = _extended(window, moved, sigma, shown, terms, dt, room)
        if found < 0:
            raise InputError("expected positions that are finite", where="the extracted states")
        if found <= room:
            return extended, final
        room = found


def _extended(
    window: Window, moved: Moved, sigma: F8, shown: Block, terms: Terms, dt: float, room: int
) -> tuple[int, Window, Links]:
    """`extend` with room for so many pairs: how many there are, and, where that is not more, the result."""
    rows, columns, older, recent = window.rows, window.columns, window.rows.older, window.rows.recent
    n, m = sigma.shape[1], len(shown.rows)
    count, size, side = len(rows.since) + n, len(columns.next) + n, int(n**0.5) + 1
    since, gain, u = np.empty((3, count))
    previous, onward, v = np.empty(count, np.int64), np.empty(size, np.int64), np.empty(size)
    most = int(recent.start[-1]) + room
    edges = Edges(np.empty(len(recent.start) + n, np.int64), np.empty(most, np.int64), np.empty(most))
    pairs = np.empty((2, room), np.int64)
    found, closed, gone = link_states(
        dt,
        terms.span,
        terms.gate,
        terms.log_miss,
        terms.consistent,
        rows.first,
        columns.first,
        *older.arrays(),
        moved.mean,
        moved.cov,
        moved.noise.copy(),
        sigma,
        shown.rows,
        shown.triangle,
        np.empty((m + 3, m, LANES)),
        (rows.since, rows.previous, rows.gain, rows.price, columns.next, columns.price, *recent.arrays()),
        since,
        previous,
        gain,
        u,
        onward,
        v,
        *edges.arrays(),
        pairs[0],
        pairs[1],
        np.empty(room),
        np.empty((3, size)),
        np.empty((2, size), np.int64),
        np.zeros(side * side + 1, np.int64),
        np.zeros(size, np.uint8),
    )
    final = links(window, closed) if closed else NO_LINKS
    end = int(edges.start[-1])
    older, recent = _settled(closed, older, Edges(edges.start, edges.target[:end], edges.gain[:end]))
    left = Rows(rows.first + closed, since[closed:], previous[closed:], gain[closed:], u[closed:], older, recent)
    open_columns = Columns(columns.first + gone, onward[gone:], v[gone:])
    return found, Window(open_columns, left, moved.mean, moved.cov), final


def _settled(closed: int, older: Edges, recent: Edges) -> tuple[Edges, Edges]:
    """The edges of all rows but the first ``closed``; joined where the recent ones have become many."""
    if closed:
        older, recent = _without(closed, older, recent)
    if 4 * len(recent.start) > len(older.start):
        return _joined(older, recent), _NO_EDGES
    return older, recent


def _without(count: int, older: Edges, recent: Edges) -> tuple[Edges, Edges]:
    """The edges of all rows but the first ``count``. Nothing is copied: joining them lets go of what is not theirs."""
    held = len(older.start) - 1
    if count < held:
        return Edges(older.start[count:], older.target, older.gain), recent
    return Edges(recent.start[count - held :], recent.target, recent.gain), _NO_EDGES


def _joined(a: Edges, b: Edges) -> Edges:
    """The rows of ``a``, then those of ``b``."""
    low, high, begin, end = a.start[0], a.start[-1], b.start[0], b.start[-1]
    return Edges(
        np.concatenate((a.start - low, b.start[1:] + (high - low - begin))),
        np.concatenate((a.target[low:high], b.target[begin:end])),
        np.concatenate((a.gain[low:high], b.gain[begin:end])),
    )
