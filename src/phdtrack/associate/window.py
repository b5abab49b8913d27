"""The recent past of the association graph: its open vertices, its edges and the best matching between them.

A vertex is an extracted state; vertices are numbered through. Its out-side is a column of the matching problem, its in-side
a row. Vertices younger than the span are open on both sides and carry their state predicted for the present frame, moved on
step by step, so that an edge over j frames uses the j-step transition. An older one keeps its out-side open while the row
that it is matched to is. A record is never written into; each frame makes a new one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.kernels.matching import insert_rows
from phdtrack.types import F8, I8

# An out-side that can no longer be linked.
CLOSED = -2


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


def close(window: Window, dt: float, span: float) -> tuple[Window, Links]:
    """Let ``dt`` pass and close what is older than ``span``; states are left as they are.

    Returns the window and the links that can no longer change. A closed row takes its
    matched column with it; a closed column without a row ends its track. The rest stays optimally matched, because the
    dual variables of what is left still certify it.
    """
    rows, columns = window.rows, window.columns
    since = rows.since + dt
    count = 0 if len(since) == 0 or since[0] <= span else len(since) - int(since[::-1].searchsorted(span, side="right"))
    if count == 0:
        aged = Rows(rows.first, since, rows.previous, rows.gain, rows.price, rows.older, rows.recent)
        return Window(columns, aged, window.mean, window.cov), NO_LINKS
    final = links(window, count)
    begin = rows.first - columns.first
    onward = columns.next.copy()
    onward[final.earlier - columns.first] = CLOSED
    expired = onward[begin : begin + count]
    expired[expired < 0] = CLOSED
    still = onward[: begin + count] != CLOSED
    first = int(still.argmax())
    gone = first if still[first] else begin + count
    older, recent = _without(count, rows.older, rows.recent)
    left = Rows(
        rows.first + count,
        since[count:],
        rows.previous[count:],
        rows.gain[count:],
        rows.price[count:],
        older,
        recent,
    )
    open_columns = Columns(columns.first + gone, onward[gone:], columns.price[gone:])
    return Window(open_columns, left, window.mean, window.cov), final


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


def insert(window: Window, n: int, edges: Edges, mean: F8, cov: F8) -> Window:
    """Add the ``n`` vertices of the present frame, with ``edges`` from them back to those in the window.

    ``mean`` and ``cov`` are the predicted states with the new ones behind them. The matching is extended by one augmenting
    path per new vertex, which may undo earlier links: the correction of false hypotheses [M07 §3].
    """
    rows, columns = window.rows, window.columns
    nobody, zero = np.full(n, -1), np.zeros(n)
    older, recent = rows.older, _joined(rows.recent, edges)
    if 4 * len(recent.start) > len(older.start):
        older, recent = _joined(older, recent), _NO_EDGES
    previous, onward = np.concatenate((rows.previous, nobody)), np.concatenate((columns.next, nobody))
    gain, u = np.concatenate((rows.gain, zero)), np.concatenate((rows.price, zero))
    v = np.concatenate((columns.price, zero))
    size = len(v)
    insert_rows(
        len(rows.since),
        rows.first,
        columns.first,
        *older.arrays(),
        *recent.arrays(),
        previous,
        onward,
        gain,
        u,
        v,
        np.zeros(size, np.uint8),
        np.empty(size),
        np.empty(size, np.int64),
        np.empty(size),
        np.empty(size, np.int64),
    )
    since = np.concatenate((rows.since, zero))
    return Window(Columns(columns.first, onward, v), Rows(rows.first, since, previous, gain, u, older, recent), mean, cov)
