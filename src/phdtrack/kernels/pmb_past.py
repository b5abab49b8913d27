"""The past of Bernoulli targets, as their best hypotheses tell it, followed back frame by frame.

Layers are those of `kernels.pmb`. A trace says for each target of a frame which of its hypotheses leads to the one that is
best today.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, INNER

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]


class Trace(NamedTuple):
    """Which hypothesis of a frame stands for each of its targets, ``place`` (T,), −1 for none, and ``presence`` (T,), the
    greatest from that frame on."""

    place: I8
    presence: F8


@njit(**INNER)
def followed_back(trace: Trace, parent: I8, target: I8, presence: F8, past: tuple[I8, int]) -> Trace:
    """The trace a frame earlier, with the targets that ended after it."""
    place, most = np.empty(presence.size, np.int64), presence.copy()
    for t in range(place.size):
        place[t] = -1
    for i in range(trace.place.size):
        p = parent[trace.place[i]] if trace.place[i] >= 0 else -1
        if p >= 0:
            place[target[p]], most[target[p]] = p, max(trace.presence[i], presence[target[p]])
    ended, frame = past
    for e in range(ended.shape[1]):
        if ended[0, e] == frame:
            place[target[ended[1, e]]] = ended[1, e]
    return Trace(place, most)


@njit(**ENTRY)
def earlier(
    now: Trace, before: Trace, parent: I8, then: tuple[I8, F8, F8], past: tuple[I8, int], present: bool, min_weight: float
) -> tuple[Trace, Trace, bool]:
    """The traces a frame earlier, as seen now and as seen a frame ago, and whether both report the same up to there.

    Parameters
    ----------
    now, before : traces of the frame after it.
    parent : (C,) of the frame after it.
    then : ``offsets``, ``presence`` and ``max_r`` of the frame.
    past : (2, E) frame and hypothesis of targets that have ended, and the number of the frame.
    present : the frame after it is the present one: ``before`` is given of the frame itself.
    min_weight : presence from which a target is reported. Both report the same where all targets that are reported, or
        may be in an earlier frame, have the same hypotheses and are reported in both or in none: their pasts are the same.
    """
    offsets, presence, max_r = then
    target = np.empty(offsets[-1], np.int64)
    for t in range(presence.size):
        for c in range(offsets[t], offsets[t + 1]):
            target[c] = t
    now = followed_back(now, parent, target, presence, past)
    if not present:
        before = followed_back(before, parent, target, presence, past)
    same = True
    for t in range(presence.size):
        one = now.place[t] >= 0 and (now.presence[t] >= min_weight or max_r[t] >= min_weight)
        other = before.place[t] >= 0 and (before.presence[t] >= min_weight or max_r[t] >= min_weight)
        differ = one != other
        if one and other:
            differ = now.place[t] != before.place[t] or (now.presence[t] >= min_weight) != (before.presence[t] >= min_weight)
        same = same and not differ
    return now, before, same
