"""The past of the targets of the Poisson multi-Bernoulli filter, as it is seen later.

A hypothesis knows the one that it comes from in the frame before. Followed back from the best
hypotheses of today, these are the states that the targets had, and a target that is sure today was
there before, too.
"""

from __future__ import annotations

import math

import numpy as np

from phdtrack.kernels import F8, I8, Records
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.gaussian import records

# Of each target of a frame: the hypothesis that leads to the one that is best today, −1 for none;
# the greatest presence from that frame on.
TRACE = records("presence", "place")


@njit(**INNER)
def followed_back(
    trace: Records, after: Records, targets: Records, hypotheses: Records, ended: I8, frame: int
) -> Records:
    """The trace a frame earlier, with the targets that ended after it."""
    out = np.empty(targets.size, TRACE)
    for t in range(targets.size):
        out[t].place = -1
        out[t].presence = targets[t].presence
    for i in range(trace.size):
        if trace[i].place >= 0:
            p = after[trace[i].place].parent
        else:
            p = -1
        if p >= 0:
            found = out[hypotheses[p].target]
            found.place = p
            if trace[i].presence > found.presence:
                found.presence = trace[i].presence
    for e in range(len(ended)):
        if ended[e, 0] == frame:
            out[hypotheses[ended[e, 1]].target].place = ended[e, 1]
    return out


@njit(**ENTRY)
def earlier(
    now: Records,
    before: Records,
    after: Records,
    targets: Records,
    hypotheses: Records,
    past: tuple[I8, int],
    present: bool,
    min_weight: float,
) -> tuple[Records, Records, bool]:
    """The traces a frame earlier, as seen now and as seen a frame ago, and whether both report the
    same states up to there.

    ``now``, ``before``, of `TRACE`, and ``after``, hypotheses, are of the frame after it; if that
    is the ``present`` one, ``before`` is of the frame itself. ``past`` (E, 2): frame and hypothesis
    of targets that have ended, and the number of the frame. ``min_weight``: presence from which a
    target is reported. Both report the same where all targets that are reported, or may be in an
    earlier frame, have the same hypotheses and are reported in both or in none: their pasts are the
    same.
    """
    ended, frame = past
    now = followed_back(now, after, targets, hypotheses, ended, frame)
    if not present:
        before = followed_back(before, after, targets, hypotheses, ended, frame)
    for t in range(targets.size):
        new = now[t]
        old = before[t]
        ever = targets[t].max_presence >= min_weight
        shown = new.presence >= min_weight
        was_shown = old.presence >= min_weight
        is_there = new.place >= 0 and (shown or ever)
        was_there = old.place >= 0 and (was_shown or ever)
        if is_there != was_there or (is_there and (new.place != old.place or shown != was_shown)):
            return now, before, False
    return now, before, True


@njit(**ENTRY)
def scaled(covariance: F8, hypotheses: Records, at: I8) -> F8:
    """(n, d, d) covariances of the hypotheses ``at`` (n,), with the noises that they have; sizes
    come last in a state.
    """
    d = covariance.shape[1]
    out = np.empty((at.size, d, d))
    root = np.empty(d)
    for k in range(at.size):
        of = hypotheses[at[k]]
        root[:4] = math.sqrt(of.position_scale)
        root[4:] = math.sqrt(of.size_scale)
        for a in range(d):
            for b in range(d):
                out[k, a, b] = root[a] * covariance[at[k], a, b] * root[b]
    return out
