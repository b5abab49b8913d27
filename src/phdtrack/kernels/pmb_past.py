"""The past as the hypotheses of Bernoulli targets tell it, frame by frame backwards, and what is reported of a frame.

Who is told of in a layer (`bernoullis.Layer`) stands by its targets: ``place`` (T,) the hypothesis of each, −1 where nothing
is told, and ``presence`` (T,), the greatest from that frame on.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, INNER

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]


@njit(**INNER)
def _earlier(place: I8, presence: F8, parent: I8, target: I8, now: F8, ended: I8, back: int) -> tuple[I8, F8]:
    """Places and presences in a layer of who is told of in the next, and of the targets that ended after it."""
    out, most = np.empty(now.size, np.int64), np.empty(now.size)
    for t in range(now.size):
        out[t], most[t] = -1, now[t]
    for i in range(place.size):
        p = parent[place[i]] if place[i] >= 0 else -1
        if p >= 0:
            t = target[p]
            out[t], most[t] = p, max(presence[i], now[t])
    for e in range(ended.shape[1]):
        if ended[0, e] == back:
            out[target[ended[1, e]]] = ended[1, e]
    return out, most


@njit(**ENTRY)
def earlier(
    place: I8, presence: F8, known: I8, before: F8, parent: I8, first: I8, now: F8, believed: F8, ended: I8, back: int,
    least: float,
) -> tuple[I8, F8, I8, F8, bool]:  # fmt: skip
    """What is told of the layer ``back`` frames ago, and what was told of it a frame ago; whether that is the same.

    Parameters
    ----------
    place, presence : what is told of the layer after it, (T,).      known, before : what was a frame ago; (0,) for ``back``
        of 1, for which it is what the layer tells itself.
    parent : (C,) of the layer after it.
    first, now, believed : (T' + 1,), (T',), (T',) of the layer: where hypotheses begin, presence, greatest presence ever.
    ended : (2, E) see `bernoullis.Bernoullis`.
    least : presence from which a target is reported. The same is told where all who are reported, or may be in a layer
        before, are in the same hypotheses and are reported here or not as they were: they then share their pasts.

    Returns
    -------
    place, presence, known, before (T',), and whether they say the same.
    """
    target = np.empty(first[-1], np.int64)
    for t in range(now.size):
        for c in range(first[t], first[t + 1]):
            target[c] = t
    place, presence = _earlier(place, presence, parent, target, now, ended, back)
    if back > 1:
        known, before = _earlier(known, before, parent, target, now, ended, back)
    same = True
    for t in range(now.size):
        one = place[t] >= 0 and (presence[t] >= least or believed[t] >= least)
        other = known[t] >= 0 and (before[t] >= least or believed[t] >= least)
        differ = one != other
        if one and other:
            differ = place[t] != known[t] or (presence[t] >= least) != (before[t] >= least)
        same = same and not differ
    return place, presence, known, before, same


@njit(**ENTRY)
def reported(
    place: I8, presence: F8, least: float, mean: F8, cov: F8, detection: I8, label: I8
) -> tuple[F8, F8, F8, I8, I8]:
    """Mean (d, n), covariance (n, d, d), presence, detection and label (n,) of who is told of with ``least`` or more."""
    d, n = len(mean), 0
    for t in range(place.size):
        n += place[t] >= 0 and presence[t] >= least
    x, p, weight = np.empty((d, n)), np.empty((n, d, d)), np.empty(n)
    taken, name = np.empty(n, np.int64), np.empty(n, np.int64)
    k = 0
    for t in range(place.size):
        i = place[t]
        if i < 0 or not presence[t] >= least:
            continue
        weight[k], taken[k], name[k] = presence[t], detection[i], label[t]
        for r in range(d):
            x[r, k] = mean[r, i]
            for s in range(d):
                p[k, r, s] = cov[i, r, s]
        k += 1
    return x, p, weight, taken, name
