"""Small groups of blobs and targets that touch: what has to be explained together."""

from __future__ import annotations

import numpy as np

from phdtrack.kernels.joining import meeting
from phdtrack.types import F8, I8

Group = tuple[list[int], list[int]]
"""Blobs and targets of one group."""


def contacts(blobs: F8, targets: F8, reach: F8) -> tuple[I8, I8]:
    """Pairs (blob, target) (P,) whose boxes (N, 4) and (n, 4) meet, the targets' edges moved out by ``reach`` (n, 4)."""
    if not len(blobs) or not len(targets):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    low, high = np.ascontiguousarray(blobs[:, :2].T), np.ascontiguousarray(blobs[:, 2:].T)
    lower = np.ascontiguousarray((targets - reach)[:, :2].T)
    upper = np.ascontiguousarray((targets + reach)[:, 2:].T)
    first, second = meeting(low, high, lower, upper)
    return first, second


def canonical(boxes: F8) -> I8:
    """(N,) the rank of each box by its edges, so that nothing depends on the order in which boxes come."""
    rank = np.empty(len(boxes), np.int64)
    rank[np.lexsort(boxes.T[::-1])] = np.arange(len(boxes))
    return rank


def groups(blob: I8, target: I8, strength: F8, size: int) -> list[tuple[Group, set[tuple[int, int]]]]:
    """Groups of at most ``size`` members that pairs (P,) connect, each with the pairs (blob, target) inside it.

    The strongest pairs come first; one that would make a group too large is left out. So the work is linear in the pairs.
    """
    of: dict[tuple[bool, int], int] = {}
    members: dict[int, list[tuple[bool, int]]] = {}
    for name, (b, t) in enumerate((b, t) for b, t in zip(blob.tolist(), target.tolist(), strict=True)):
        for node in ((True, b), (False, t)):
            if node not in of:
                of[node] = key = 2 * name + node[0]
                members[key] = [node]
    inside: dict[int, set[tuple[int, int]]] = {key: set() for key in members}
    for p in np.argsort(-strength, kind="stable").tolist():
        b, t = int(blob[p]), int(target[p])
        a, c = of[True, b], of[False, t]
        if a != c and len(members[a]) + len(members[c]) > size:
            continue
        if a != c:
            for node in members[c]:
                of[node] = a
            members[a] += members.pop(c)
            inside[a] |= inside.pop(c)
        inside[a].add((b, t))
    return [
        (([i for kind, i in found if kind], [i for kind, i in found if not kind]), inside[key])
        for key, found in members.items()
        if inside[key]
    ]
