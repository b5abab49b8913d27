"""What hangs together: components of a graph, and the tracks of a cluster that compete for measurements."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER

I8 = NDArray[np.int64]


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
    i, j = root(parent, i), root(parent, j)
    parent[max(i, j)] = min(i, j)


@njit(**INNER)
def numbered(parent: I8) -> I8:
    """(n,) the number of the set of each, from 0 in order of appearance."""
    out, count = np.empty(parent.size, np.int64), 0
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
    """(count,) the component of each vertex of a graph with edges ``first``–``second`` (E,), from 0 by first appearance."""
    parent = np.arange(count)
    for e in range(first.size):
        unite(parent, first[e], second[e])
    out: I8 = numbered(parent)
    return out


@njit(**ENTRY)
def competing(leaf: I8, trace: I8, most: int) -> I8:
    """(T,) the component of each track of a cluster; tracks that have ever taken the same measurement are in one.

    Parameters
    ----------
    leaf : (H, T) the form in which each hypothesis holds each track, −1: not at all.
    trace : (L, W) the measurement that each form rests on in each frame of the window, −1: none.
    most : measurements are numbered below this.
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
