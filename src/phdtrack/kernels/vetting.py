"""Who is believed among a scene's lasting false alarms (`associate.rejection`, `models.scene.FalseAlarmRatio`).

Identities that are remembered stand ascending, (a,), each with the least odds on its way, (2, a).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, INNER

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
B1 = NDArray[np.bool_]

# Components of a box.
M = 4


@njit(**INNER)
def _place(known: I8, identity: int) -> int:
    """How many of the identities are less than this one."""
    low, high = 0 * identity, known.size
    while low < high:
        middle = (low + high) // 2
        if known[middle] < identity:
            low = middle + 1
        else:
            high = middle
    return low


@njit(**INNER)
def _believed(followed: float, every: float, confirmed: bool, sure: float) -> bool:
    """Whether a row is confirmed by its track's odds: one that is confirmed and not false, or surely somebody's."""
    return (confirmed and followed < 0.0) or every < sure


@njit(**ENTRY)
def unbelieved(
    known: I8, odds: F8, identity: I8, detection: I8, confirmed: B1, xyxy: F8, sure: float
) -> tuple[B1, I8, F8, F8]:
    """Whom nobody believes yet among the rows of tracks ``identity``, ``detection``, ``confirmed`` (n,), ``xyxy`` (n, 4).

    Returns which rows are confirmed by what is known (n,): before and by odds of who is followed below 0, or by those of
    anybody below ``sure``; and of those that are not, but rest on a detection, which they are (k,), the least odds so far
    (2, k), ∞ where nothing is remembered, and their boxes as centres and sizes (4, k).
    """
    n, k = identity.size, 0
    believed, which, place = np.empty(n, np.bool_), np.empty(n, np.int64), np.empty(n, np.int64)
    for i in range(n):
        at = _place(known, identity[i])
        place[k] = at if at < known.size and known[at] == identity[i] else -1
        believed[i] = place[k] >= 0 and _believed(odds[0, at], odds[1, at], confirmed[i], sure)
        if not believed[i] and detection[i] >= 0:
            which[k] = i
            k += 1
    least, z = np.empty((2, k)), np.empty((M, k))
    for j in range(k):
        i = which[j]
        for a in range(2):
            least[a, j] = odds[a, place[j]] if place[j] >= 0 else np.inf
            z[a, j], z[a + 2, j] = 0.5 * (xyxy[i, a] + xyxy[i, a + 2]), xyxy[i, a + 2] - xyxy[i, a]
    return believed, which[:k], least, z


@njit(**ENTRY)
def remembered(
    known: I8, odds: F8, identity: I8, confirmed: B1, believed: B1, which: I8, least: F8, now: F8, sure: float, most: int
) -> tuple[I8, F8, B1]:
    """Take in the odds ``now`` (2, k) of rows that `unbelieved` asked for; other arguments are as it took or returned them.

    Returns who is known, ascending, and his least odds, without the oldest beyond ``most`` who are not among the rows; and
    which rows are confirmed now (n,).
    """
    after, lowest = believed.copy(), np.minimum(least, now)
    for k in range(which.size):
        after[which[k]] = _believed(lowest[0, k], lowest[1, k], confirmed[which[k]], sure)
    room = known.size + which.size
    # Whose odds they are: of those known, or, from there on, of the rows.
    name, source, count, a = np.empty(room, np.int64), np.empty(room, np.int64), 0 * most, 0 * most
    for k in np.argsort(identity[which]):
        own = identity[which[k]]
        while a < known.size and known[a] < own:
            name[count], source[count] = known[a], a
            count, a = count + 1, a + 1
        a += a < known.size and known[a] == own
        name[count], source[count] = own, known.size + k
        count += 1
    while a < known.size:
        name[count], source[count] = known[a], a
        count, a = count + 1, a + 1
    spare, left = max(count - most, 0), 0 * most
    for k in range(count):
        if spare > 0 and not (identity == name[k]).any():
            spare -= 1
            continue
        name[left], source[left] = name[k], source[k]
        left += 1
    told = np.empty((2, left))
    for k in range(left):
        for a in range(2):
            told[a, k] = odds[a, source[k]] if source[k] < known.size else lowest[a, source[k] - known.size]
    return name[:left], told, after
