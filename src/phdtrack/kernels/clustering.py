"""Clusters from log-odds of pairs: those with the largest sum of the log-odds within them
(correlation clustering).
"""

from __future__ import annotations

import numpy as np

from phdtrack.kernels import F8, I8
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER

# Nodes up to which all partitions are compared; beyond it clusters are merged while that gains,
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
    out = np.full(n, -1, np.int64)
    place = np.full(n, -1, np.int64)
    queue = np.empty(n, np.int64)
    for first in range(n):
        if out[first] >= 0:
            continue
        count = 1
        done = 0
        queue[0] = first
        place[first] = first
        while done < count:
            i = queue[done]
            done += 1
            for j in range(n):
                if place[j] < 0 and gain[i, j] > 0.0:
                    place[j] = first
                    queue[count] = j
                    count += 1
        nodes = np.sort(queue[:count])
        part = np.empty((count, count))
        for a in range(count):
            for b in range(count):
                part[a, b] = gain[nodes[a], nodes[b]]
        if count <= EXACT:
            label = _best(part)
        else:
            label = _merged(part)
        first_of = np.full(count, -1, np.int64)
        for a in range(count):
            if first_of[label[a]] < 0:
                first_of[label[a]] = nodes[a]
            out[nodes[a]] = first_of[label[a]]
    # So far a cluster is called by its first node.
    used = 0
    for i in range(n):
        place[i] = used if out[i] == i else place[out[i]]
        used += 1 if out[i] == i else 0
    return place


@njit(**INNER)
def _best(gain: F8) -> I8:
    """(n,) the best clusters of few nodes: by dynamic programming over the sets of those that are
    placed.
    """
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
    """(n,) good clusters of many nodes."""
    n = gain.shape[0]
    label = np.arange(n)
    between = gain.copy()
    alive = np.ones(n, np.bool_)
    while True:
        most = 0.0
        a = -1
        b = -1
        for i in range(n):
            if alive[i]:
                for j in range(i + 1, n):
                    if alive[j] and between[i, j] > most:
                        most = between[i, j]
                        a = i
                        b = j
        if a < 0:
            break
        alive[b] = False
        for k in range(n):
            between[a, k] += between[b, k]
            between[k, a] = between[a, k]
            if label[k] == b:
                label[k] = a
    total = np.zeros(n)
    empty = np.zeros(n, np.int64)
    # Every move gains, so it ends; the bound is for gains that are rounding.
    for _ in range(n):
        moved = False
        for i in range(n):
            total[:] = 0.0
            empty[:] = 1
            for j in range(n):
                if j != i:
                    total[label[j]] += gain[i, j]
                    empty[label[j]] = 0
            best = label[i]
            for k in range(n):
                # An empty cluster has a total of 0: alone.
                if total[k] > total[best] + 1e-9 and (total[k] > 0.0 or empty[k] == 1):
                    best = k
            if best != label[i]:
                label[i] = best
                moved = True
        if not moved:
            break
    return label
