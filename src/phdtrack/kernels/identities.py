"""Identities handed on from state to state, once and for all."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
Bool = NDArray[np.bool_]


@njit(cache=True)
def follow(first: int, row: int, previous: I8, gain: F8, onward: I8, worth: F8) -> None:
    """Links seen from their other end: for each vertex from ``first`` on the one that goes on from it.

    Parameters
    ----------
    row : number of the first of the R vertices that ``previous`` and ``gain`` are of; they are the last there are.
    previous, gain : (R,) the vertex that each goes on from, −1 where none, and the link's gain.
    onward, worth : outputs for the vertices from ``first`` to the last: −1 and 0 where there is no link.
    """
    for place in range(onward.size):
        onward[place], worth[place] = -1, 0.0
    for r in range(previous.size):
        place = previous[r] - first
        if place >= 0:
            onward[place], worth[place] = row + r, gain[r]


@njit(cache=True)
def claim(
    first: int,
    used: int,
    names: I8,
    holding: Bool,
    onward: I8,
    worth: F8,
    shortest: int,
    least: float,
    identity: I8,
    length: I8,
    gain: F8,
    confirmed: Bool,
    holds: Bool,
    before: I8,
    absent: I8,
) -> tuple[int, int]:
    """Identities for the n vertices behind the V that have one.

    A vertex takes the identity of the one that goes on to it. Where two claim one, the one that follows its holder (its
    last vertex) has it; after those it is first come, first served, and the others get new ones.

    Parameters
    ----------
    first : number of the first vertex; the V + n vertices and those still to come are numbered through from it.
    used : how many identities there were.
    names, holding : (V,) identity, and whether the vertex is its holder.
    onward, worth : (V + n or more,) the vertex that each goes on to, below 0 where there is none, and the link's gain.
    shortest, least : states and mean gain of the links that confirm an identity.
    identity, length, gain, confirmed, holds : (V + n,) of each vertex: identity, states under it so far, what their links
        gained, whether confirmed, whether it is the holder. Those of the first V are given, the others written; of the
        first, ``confirmed`` and ``holds`` may change.
    before : (n,) working space.
    absent : (V,) output: the places of confirmed holders that do not go on to a vertex up to now.

    Returns
    -------
    How many identities there are, and how many are absent.
    """
    old, n = names.size, before.size
    for i in range(n):
        before[i] = -1
    for place in range(old):
        i = onward[place] - first - old
        if 0 <= i < n:
            before[i] = place
    for turn in range(2):
        for i in range(n):
            source = before[i]
            follows = source >= 0 and holding[source]
            if follows != (turn == 0):
                continue
            if turn == 1 and source >= 0:
                # The last state under the identity, which there is: nobody else may have taken it in this frame.
                name, source = names[source], old + n - 1
                while identity[source] != name or not holds[source]:
                    source -= 1
                source = source if source < old else -1
            here = old + i
            holds[here] = True
            if source < 0:
                used += 1
                identity[here], length[here], gain[here], confirmed[here] = used, 1, 0.0, False
                continue
            holds[source] = False
            identity[here], length[here] = identity[source], length[source] + 1
            gain[here], confirmed[here] = gain[source] + worth[before[i]], confirmed[source]
    now, count = first + old + n, 0
    for place in range(old + n):
        if not holds[place]:
            continue
        # With the states that it goes on to later an identity may suffice already.
        states, total, here = length[place], gain[place], place
        while not confirmed[place]:
            confirmed[place] = states >= shortest and total >= least * (states - 1)
            if onward[here] < now:
                break
            states, total, here = states + 1, total + worth[here], onward[here] - first
        if place < old and confirmed[place] and not 0 <= onward[place] < now:
            absent[count] = place
            count += 1
    return used, count
