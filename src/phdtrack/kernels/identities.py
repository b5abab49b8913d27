"""Identities handed on from state to state, once and for all."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
Bool = NDArray[np.bool_]


@njit(cache=True)
def follow(first: int, row: int, previous: I8, gain: F8) -> tuple[I8, F8]:
    """Links seen from their other end: for each vertex from ``first`` on the one that goes on from it, −1 where none does.

    Parameters
    ----------
    row : number of the first of the R vertices that ``previous`` and ``gain`` are of; they are the last there are.
    previous, gain : (R,) the vertex that each goes on from, −1 where none, and the link's gain.

    Returns
    -------
    onward, worth : for the vertices from ``first`` to the last; gains are 0 where there is no link.
    """
    size = row + previous.size - first
    onward, worth = np.full(size, -1), np.zeros(size)
    for r in range(previous.size):
        if previous[r] >= first:
            onward[previous[r] - first], worth[previous[r] - first] = row + r, gain[r]
    return onward, worth


@njit(cache=True)
def _holder(name: int, identity: I8, holds: Bool) -> int:
    """The place of the last state under an identity, which there is."""
    place = identity.size - 1
    while identity[place] != name or not holds[place]:
        place -= 1
    return place


@njit(cache=True)
def _suffices(length: int, gain: float, shortest: int, least: float) -> bool:
    """Whether so many states, whose links gained so much, make a track."""
    return length >= shortest and gain >= least * (length - 1)


@njit(cache=True)
def _confirm(
    first: int, after: int, given: tuple[I8, I8, F8, Bool, Bool], onward: I8, worth: F8, shortest: int, least: float
) -> None:
    """Mark the holders whose states, with those from vertex ``after`` on that they go on to, suffice."""
    _, length, gain, confirmed, holds = given
    for place in range(holds.size):
        if not holds[place] or confirmed[place]:
            continue
        count, total, here = length[place], gain[place], place
        while not _suffices(count, total, shortest, least) and onward[here] >= after:
            count, total, here = count + 1, total + worth[here], onward[here] - first
        confirmed[place] = _suffices(count, total, shortest, least)


@njit(cache=True)
def claim(
    first: int, n: int, used: int, given: tuple[I8, I8, F8, Bool, Bool], onward: I8, worth: F8, shortest: int, least: float
) -> tuple[tuple[I8, I8, F8, Bool, Bool], I8, int]:
    """Identities for the ``n`` vertices behind the V that have one.

    A vertex takes the identity of the one that goes on to it. Where two claim one, the one that follows its holder (its
    last vertex) has it; after those it is first come, first served, and the others get new ones.

    Parameters
    ----------
    first : number of the first vertex; the V + n vertices and those still to come are numbered through from it.
    used : how many identities there were.
    given : (V,) identity, states under it so far, what their links gained, whether confirmed, whether it is the holder.
    onward, worth : (V + n or more,) the vertex that each goes on to, below 0 where there is none, and the link's gain.
    shortest, least : states and mean gain of the links that confirm an identity.

    Returns
    -------
    given : the same with the new vertices behind.
    absent : the places of confirmed holders that do not go on to a vertex up to now.
    used : how many identities there are.
    """
    old = given[0].size
    identity, length = np.zeros(old + n, np.int64), np.ones(old + n, np.int64)
    gain = np.zeros(old + n)
    confirmed, holds = np.zeros(old + n, np.bool_), np.zeros(old + n, np.bool_)
    identity[:old], length[:old], gain[:old], confirmed[:old], holds[:old] = given
    before = np.full(n, -1, np.int64)
    for place in range(old):
        later = onward[place] - first - old
        if 0 <= later < n:
            before[later] = place
    for others in (False, True):
        for i in range(n):
            source = before[i]
            if (source < 0 or not given[4][source]) != others:
                continue
            if others and source >= 0:
                source = _holder(identity[source], identity, holds)
                if source >= old:
                    source = -1
            here = old + i
            holds[here] = True
            if source < 0:
                used += 1
                identity[here] = used
                continue
            holds[source] = False
            identity[here], length[here] = identity[source], length[source] + 1
            gain[here], confirmed[here] = gain[source] + worth[before[i]], confirmed[source]
    result = identity, length, gain, confirmed, holds
    now = first + old + n
    _confirm(first, now, result, onward, worth, shortest, least)
    absent = np.empty(old, np.int64)
    count = 0
    for place in range(old):
        if holds[place] and confirmed[place] and not 0 <= onward[place] < now:
            absent[count] = place
            count += 1
    return result, absent[:count], used
