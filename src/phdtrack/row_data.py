"""Columns of any type, an entry for each detection or row: masks, keypoints, texts, objects.

A row that no detection supports has an empty entry: zeros, False or an empty text, by the column's
type, and None in a column of Python objects.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Columns = Mapping[str, NDArray[Any]]


def gathered(column: NDArray[Any], index: NDArray[np.int64]) -> NDArray[Any]:
    """(M, …) the entries of a column (N, …) at an index (M,), empty ones where that is −1."""
    out = _empty(len(index), column)
    known = index >= 0
    out[known] = column[index[known]]
    return out


def stacked(parts: Sequence[Columns], counts: Sequence[int]) -> dict[str, NDArray[Any]]:
    """The columns of all parts end to end; empty entries where a part lacks a column.

    Parameters
    ----------
    parts, counts : columns with names, and the number of their rows.
    """
    names = dict.fromkeys(name for part in parts for name in part)
    return {name: _joined(name, parts, counts) for name in names}


def _joined(name: str, parts: Sequence[Columns], counts: Sequence[int]) -> NDArray[Any]:
    """One column of all parts; of Python objects if their entries differ in shape."""
    like = next(part[name] for part in parts if name in part)
    columns = [
        part[name] if name in part else _empty(count, like)
        for part, count in zip(parts, counts, strict=True)
    ]
    filled = [column for column in columns if len(column)] or columns[:1]
    if len({column.shape[1:] for column in filled}) == 1:
        return np.concatenate(filled)
    out = np.empty(sum(map(len, filled)), np.object_)
    for k, entry in enumerate(entry for column in filled for entry in column):
        out[k] = entry
    return out


def _empty(count: int, like: NDArray[Any]) -> NDArray[Any]:
    """So many empty entries of the shape and type of those of a column."""
    shape = (count, *like.shape[1:])
    if like.dtype.hasobject:
        return np.full(shape, None, np.object_)
    return np.zeros(shape, like.dtype)
