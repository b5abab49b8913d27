"""Symmetric matrices as their lower triangles, row by row: half the room."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from phdtrack.types import F8, I8


@dataclass(frozen=True, slots=True, eq=False)
class Triangle:
    """Where the elements of a (d, d) matrix stand: ``row``, ``column`` (k,) of each place; ``place`` (d, d) of each."""

    row: I8
    column: I8
    place: I8


@cache
def lower(dim: int) -> Triangle:
    """The lower triangle of (dim, dim); k = dim·(dim + 1)/2."""
    row, column = np.tril_indices(dim)
    place = np.empty((dim, dim), np.int64)
    place[row, column] = place[column, row] = np.arange(len(row))
    return Triangle(row, column, place)


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """The elements (m, m) of a (d, d) matrix in some ``rows`` (m,) and the same columns.

    Where they stand among its lower ``triangle``'s, and in the whole ``square``, row by row.
    """

    rows: I8
    triangle: I8
    square: I8


@cache
def block(dim: int, rows: tuple[int, ...]) -> Block:
    """The block of (dim, dim) in these rows."""
    index = np.array(rows)
    return Block(index, lower(dim).place[np.ix_(index, index)], dim * index[:, None] + index)


def whole(packed: F8, dim: int) -> F8:
    """(n, dim, dim) symmetric matrices from their lower triangles (n, k)."""
    return packed[:, lower(dim).place]
