"""Identities handed on from state to state, once and for all; and how long the missing are waited for."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, INNER

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
Bool = NDArray[np.bool_]


@njit(**INNER)
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


@njit(**INNER)
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
) -> int:
    """Identities for the n vertices behind the V that have one; returns how many identities there are.

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
    now = first + old + n
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
    return used


@njit(**ENTRY)
def hand_on(
    first: int,
    row: int,
    previous: I8,
    link_gain: F8,
    later: I8,
    earlier: I8,
    final_gain: F8,
    used: int,
    shortest: int,
    least: float,
    names: I8,
    lengths: I8,
    gains: F8,
    sure: Bool,
    holding: Bool,
    missing: I8,
    known: I8,
    fresh: int,
    onward: I8,
    worth: F8,
    identity: I8,
    length: I8,
    gain: F8,
    confirmed: Bool,
    holds: Bool,
    missed: I8,
    waits: I8,
    absent: I8,
    source: I8,
    space: I8,
) -> tuple[int, int]:
    """One frame of identities: who has them (`claim`), who is missing, and what became of those that were.

    Parameters
    ----------
    first, used, shortest, least : as for `claim`.
    row, previous, link_gain : as for `follow`, the links still open.
    later, earlier, final_gain : (L,) links of other vertices, which are settled.
    names, lengths, gains, sure, holding, missing : (V,) what is known of each vertex: identity and so on as for `claim`, and
        for how many frames in a row its identity has had no state by now.
    known : (a,) ascending, the vertices whose states are carried on; behind them stand those from ``fresh`` on.
    onward, worth : outputs for all vertices, as for `follow`.
    identity, length, gain, confirmed, holds, missed : (V + n,) outputs, the same with the n vertices of this frame.
    waits : (2, A) in place: of how many confirmed identities it was asked, after so many frames without a state, whether
        they come back in the next, and how many did.
    absent : (V,) output, the places of confirmed holders that go on to no vertex up to now, ascending; of those that go on
        to none at all only where they have been missing for less than A frames.
    source : (V,) output, where their states are: place among those carried on and the fresh behind them; −1 where lost.
    space : (n,) working space.

    Returns
    -------
    How many identities there are, and how many are absent.
    """
    old, n, ages = names.size, space.size, waits.shape[1]
    follow(first, row, previous, link_gain, onward, worth)
    for e in range(later.size):
        onward[earlier[e] - first], worth[earlier[e] - first] = later[e], final_gain[e]
    for place in range(old):
        identity[place], length[place], gain[place] = names[place], lengths[place], gains[place]
        confirmed[place], holds[place], missed[place] = sure[place], holding[place], missing[place] + 1
    for i in range(n):
        # Not anybody's yet.
        identity[old + i], holds[old + i], missed[old + i] = 0, False, 0
    used = claim(
        first, used, names, holding, onward, worth, shortest, least, identity, length, gain, confirmed, holds, space
    )
    now, count, k = first + old + n, 0, 0
    for place in range(old):
        if sure[place] and holding[place] and 0 < missing[place] < ages:
            waits[0, missing[place]] += 1
            waits[1, missing[place]] += 0 if holds[place] else 1
        if not (holds[place] and confirmed[place]) or 0 <= onward[place] < now:
            continue
        if onward[place] < 0 and missed[place] >= ages:
            continue
        vertex = first + place
        while k < known.size and known[k] < vertex:
            k += 1
        absent[count], source[count] = place, -1
        if vertex >= fresh:
            source[count] = known.size + vertex - fresh
        elif k < known.size and known[k] == vertex:
            source[count] = k
        count += 1
    return used, count


@njit(**ENTRY)
def come_back(survive: F8, detect: F8, waits: I8, out: F8) -> None:
    """(A,) probabilities that an identity that has had no state for so many frames will have one again, into ``out``.

    By how many did so far, age by age (Kaplan and Meier's product of hazards). Beside them each age counts one that
    behaves as the model says: it exists with r, survives with p_S, is missed with 1 − p_D, and then exists with
    r p_S (1 − p_D)/(1 − r p_S p_D), as a Bernoulli filter has it. ``survive``, ``detect`` (a,) are p_S and p_D at states
    of the missing, of which those that survive are averaged; ``waits`` as for `hand_on`.
    """
    count, stays, seen = 0, 0.0, 0.0
    for i in range(survive.size):
        if survive[i] > 0.0:
            count, stays, seen = count + 1, stays + survive[i], seen + detect[i]
    if count > 0:
        stays, seen = stays / count, seen / count
    exists, never = 1.0, 1.0
    for age in range(out.size):
        there = exists * stays
        out[age] = (waits[1, age] + there * seen) / (waits[0, age] + 1.0)
        exists = there * (1.0 - seen) / (1.0 - there * seen) if there * seen < 1.0 else 0.0
    for k in range(out.size):
        age = out.size - 1 - k
        never *= 1.0 - out[age]
        out[age] = 1.0 - never
