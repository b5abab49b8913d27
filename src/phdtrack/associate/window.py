"""The recent past of the association graph: its open vertices, its edges and the best matching between them.

A vertex is an extracted state. Its out-side is a column of the matching problem, its in-side a row. Columns carry the
vertex's predicted state at the present frame, moved on step by step, so that an edge over j frames uses the j-step
transition. A record is never written into; each frame makes a new one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.kernels.matching import insert_rows
from phdtrack.protocols import Motion
from phdtrack.types import F8, I8, Estimates


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Out-sides of vertices that may still get a successor.

    ``vertex`` (C,) global number, ascending. ``since`` (C,) model time since their frame.
    ``mean`` (d, C) and ``cov`` (C, d, d): the state predicted for the present. ``row`` (C,): index of the row matched to it
    or −1. ``price`` (C,): its dual variable.
    """

    vertex: I8
    since: F8
    mean: F8
    cov: F8
    row: I8
    price: F8


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """In-sides of vertices whose link may still be corrected, with their edges as compressed rows.

    ``vertex`` (R,), ``since`` (R,), ``column`` (R,): matched column or −1; ``price`` (R,): dual variable; row r has the
    edges start[r] … start[r+1]−1 to columns ``target`` with gains ``gain``.
    """

    vertex: I8
    since: F8
    column: I8
    price: F8
    start: I8
    target: I8
    gain: F8


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """Columns and rows of the recent past."""

    columns: Columns
    rows: Rows


def empty_window(dim: int) -> Window:
    """No vertices."""
    none, zero = np.zeros(0, np.int64), np.zeros(0)
    columns = Columns(none, zero, np.zeros((dim, 0)), np.zeros((0, dim, dim)), none, zero)
    return Window(columns, Rows(none, zero, none, zero, np.zeros(1, np.int64), none, zero))


@dataclass(frozen=True, slots=True, eq=False)
class Links:
    """Links (L,) from vertex ``later`` back to vertex ``earlier``, with their gains."""

    later: I8
    earlier: I8
    gain: F8


def links(window: Window, rows: I8 | None = None) -> Links:
    """The links of the matched rows, or of those among ``rows``."""
    matched = np.flatnonzero(window.rows.column >= 0) if rows is None else rows[window.rows.column[rows] >= 0]
    degree = np.diff(window.rows.start)
    owner = np.repeat(np.arange(len(degree)), degree)
    taken = window.rows.target == window.rows.column[owner]
    gain = np.bincount(owner[taken], window.rows.gain[taken], len(degree)).astype(np.float64)
    column = window.rows.column[matched]
    return Links(window.rows.vertex[matched], window.columns.vertex[column], gain[matched])


def advance(window: Window, motion: Motion, dt: float, span: float) -> tuple[Window, Links]:
    """Let ``dt`` pass: predict the columns; close what is older than ``span``.

    Returns the window and the links that can no longer change. A closed row takes its
    matched column with it; a closed column without a row ends its track. The rest stays optimally matched, because the
    dual variables of what is left still certify it.
    """
    rows, columns = window.rows, window.columns
    age_row, age_column = rows.since + dt, columns.since + dt
    row_stays = age_row <= span
    closed = np.flatnonzero(~row_stays)
    linked = closed[rows.column[closed] >= 0]
    spent = np.zeros(len(columns.vertex), np.bool_)
    spent[rows.column[linked]] = True
    column_stays = ~spent & ((age_column <= span) | (columns.row >= 0))
    final = links(window, closed)

    new_row = np.where(row_stays, np.cumsum(row_stays) - 1, -1)
    new_column = np.where(column_stays, np.cumsum(column_stays) - 1, -1)
    mean = np.ascontiguousarray(columns.mean[:, column_stays])
    mean, jacobian, noise = motion.transition(mean, dt)
    cov = jacobian @ columns.cov[column_stays] @ jacobian.transpose(0, 2, 1) + noise
    kept_columns = Columns(
        columns.vertex[column_stays],
        age_column[column_stays],
        mean,
        cov,
        _renumbered(columns.row[column_stays], new_row),
        columns.price[column_stays],
    )
    return Window(kept_columns, _kept_rows(rows, row_stays, age_row, new_column)), final


def _renumbered(index: I8, new: I8) -> I8:
    """``index`` under a new numbering; −1 stays −1."""
    out: I8 = np.append(new, -1)[index]
    return out


def _kept_rows(rows: Rows, stays: np.ndarray[tuple[int], np.dtype[np.bool_]], age: F8, new_column: I8) -> Rows:
    """The rows that stay, with their edges to columns that stay."""
    degree = np.diff(rows.start)
    owner = np.repeat(np.arange(len(degree)), degree)
    target = _renumbered(rows.target, new_column)
    edge_stays = stays[owner] & (target >= 0)
    left = np.bincount(owner[edge_stays], minlength=len(degree))[stays]
    return Rows(
        rows.vertex[stays],
        age[stays],
        _renumbered(rows.column[stays], new_column),
        rows.price[stays],
        np.concatenate([[0], np.cumsum(left)]).astype(np.int64),
        target[edge_stays],
        rows.gain[edge_stays],
    )


def insert(window: Window, vertex: I8, estimates: Estimates, row: I8, column: I8, gain: F8) -> Window:
    """Add the vertices of the present frame, with edges (``row``, ``column``, ``gain``) from them back to the columns.

    ``row`` counts within the new vertices, ascending. The matching is extended by one augmenting path per new vertex, which
    may undo earlier links: the correction of false hypotheses [M07 §3].
    """
    rows, columns = window.rows, window.columns
    n, first = len(vertex), len(rows.vertex)
    degree = np.bincount(row, minlength=n)
    start = np.concatenate([rows.start, rows.start[-1] + np.cumsum(degree)])
    target, gains = np.concatenate([rows.target, column]), np.concatenate([rows.gain, gain])
    nobody = np.full(n, -1, np.int64)
    column_of, row_of, u, v = insert_rows(
        first,
        start,
        target,
        gains,
        np.concatenate([rows.column, nobody]),
        columns.row,
        np.concatenate([rows.price, np.zeros(n)]),
        columns.price,
    )
    new_rows = Rows(
        np.concatenate([rows.vertex, vertex]), np.append(rows.since, np.zeros(n)), column_of, u, start, target, gains
    )
    new_columns = Columns(
        np.concatenate([columns.vertex, vertex]),
        np.append(columns.since, np.zeros(n)),
        np.hstack([columns.mean, estimates.state]),
        np.concatenate([columns.cov, estimates.covariance]),
        np.concatenate([row_of, nobody]),
        np.append(v, np.zeros(n)),
    )
    return Window(new_columns, new_rows)
