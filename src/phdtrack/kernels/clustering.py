"""Clusters from log-odds of pairs: those with the largest sum of the log-odds within them
(correlation clustering).
"""

from __future__ import annotations

import numpy as np

from phdtrack.kernels import F8, I8
from phdtrack.kernels.association import numbered, root, unite
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER

# For up to so many nodes all partitions are compared; else clusters are merged while that gains,
# then single nodes move.
EXACT = 9


@njit(**ENTRY)
def clusters(gain: F8) -> I8:
    """(n,) the cluster of each node, numbered from 0 by their first node; ``gain`` (n, n)
    symmetric, the log-odds of pairs.

    Nodes that no chain of pairs with a positive gain connects are never together, so each connected
    part is solved alone.
    """
    n = gain.shape[0]
    parent = np.arange(n)
    for i in range(n):
        for j in range(i):
            if gain[i, j] > 0.0:
                unite(parent, i, j)
    cluster = np.arange(n)
    for first in range(n):
        if root(parent, first) != first:
            continue
        nodes = _members(parent, first)
        part = np.empty((nodes.size, nodes.size))
        for a in range(nodes.size):
            for b in range(nodes.size):
                part[a, b] = gain[nodes[a], nodes[b]]
        if nodes.size <= EXACT:
            label = _best(part)
        else:
            label = _improved(part, _merged(part))
        for a in range(nodes.size):
            for b in range(a):
                if label[a] == label[b]:
                    unite(cluster, nodes[a], nodes[b])
    out: I8 = numbered(cluster)
    return out


@njit(**INNER)
def _members(parent: I8, first: int) -> I8:
    """The nodes of the set that ``first`` represents, ascending."""
    out = np.empty(parent.size, np.int64)
    count = 0
    for i in range(parent.size):
        if root(parent, i) == first:
            out[count] = i
            count += 1
    return out[:count]


@njit(**INNER)
def _best(gain: F8) -> I8:
    """(n,) the best clusters of few nodes, by dynamic programming over sets of nodes."""
    n = gain.shape[0]
    size = 1 << n
    within = np.zeros(size)
    value = np.zeros(size)
    last = np.zeros(size, np.int64)
    for some in range(1, size):
        first = 0
        while not (some >> first) & 1:
            first += 1
        rest = some & ~(1 << first)
        total = within[rest]
        for j in range(first + 1, n):
            if (rest >> j) & 1:
                total += gain[first, j]
        within[some] = total
        # The cluster of the first node: every set of the others with it. All together is tried
        # first and wins ties.
        best = total
        chosen = some
        others = rest
        while others > 0:
            others = (others - 1) & rest
            here = others | (1 << first)
            total = within[here] + value[some & ~here]
            if total > best:
                best = total
                chosen = here
        value[some] = best
        last[some] = chosen
    label = np.zeros(n, np.int64)
    left = size - 1
    number = 0
    while left > 0:
        for i in range(n):
            if (last[left] >> i) & 1:
                label[i] = number
        left &= ~last[left]
        number += 1
    return label


@njit(**INNER)
def _merged(gain: F8) -> I8:
    """(n,) clusters of many nodes: merges the pair that gains most while one gains."""
    n = gain.shape[0]
    label = np.arange(n)
    between = gain.copy()
    alive = np.ones(n, np.bool_)
    while True:
        most = 0.0
        a = -1
        b = -1
        for i in range(n):
            for j in range(i + 1, n):
                if alive[i] and alive[j] and between[i, j] > most:
                    most = between[i, j]
                    a = i
                    b = j
        if a < 0:
            return label
        alive[b] = False
        for k in range(n):
            between[a, k] += between[b, k]
            between[k, a] = between[a, k]
            if label[k] == b:
                label[k] = a


@njit(**INNER)
def _improved(gain: F8, label: I8) -> I8:
    """(n,) better clusters: single nodes move to the cluster to which they gain most, in place."""
    n = gain.shape[0]
    total = np.zeros(n)
    empty = np.zeros(n, np.bool_)
    # Every move gains, so it ends; the bound is for gains that are rounding.
    for _ in range(n):
        moved = False
        for i in range(n):
            total[:] = 0.0
            empty[:] = True
            for j in range(n):
                if j != i:
                    total[label[j]] += gain[i, j]
                    empty[label[j]] = False
            best = label[i]
            for k in range(n):
                # An empty cluster has a total of 0: alone.
                if total[k] > total[best] + 1e-9 and (total[k] > 0.0 or empty[k]):
                    best = k
            if best != label[i]:
                label[i] = best
                moved = True
        if not moved:
            break
    return label
