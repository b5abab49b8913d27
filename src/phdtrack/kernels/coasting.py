"""Verdicts on tracks that were missing: found again where they were predicted, or not. See
`associate.labels`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from phdtrack.kernels import F8, I8, Bool
from phdtrack.kernels.box import overlap_of
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY

# Ages are counted in steps that grow by a third of an octave each, from 1/240 s to three hours.
STEPS = 64
SHORTEST = 1 / 240
PER_OCTAVE = 3.0
# A track that is found again must overlap its prediction by so much (IoU).
OVERLAP = 0.5


class Followed(NamedTuple):
    """Tracks that the filter reports, or reported not long ago, and verdicts on those that were
    missing.

    ``label`` (n,): ascending. ``last``, ``age`` (n,), seconds: when each was last detected, and how
    long it had been missing when it was last reported. ``xyxy``, ``speed`` (n, 4): the box of each
    and its change in a second; those no longer reported keep on moving. ``verdicts`` (2, STEPS): of
    those reported missing for as long, how many were found where they were predicted, and how many
    were not; older ones count less.
    """

    label: I8
    last: F8
    age: F8
    xyxy: F8
    speed: F8
    verdicts: F8


class Reported(NamedTuple):
    """States of a frame: labels (m,), their order, boxes (m, 4), when each was last detected, and
    which are confirmed.
    """

    label: I8
    order: I8
    xyxy: F8
    last: F8
    confirmed: Bool


@njit(**ENTRY)
def step_of(age: F8) -> I8:
    """(n,) the step that is nearest to each age in seconds; ages of whole frames lie far from
    halfway at all usual rates.
    """
    out = np.empty(age.size, np.int64)
    for i in range(age.size):
        step = PER_OCTAVE * math.log2(max(age[i], SHORTEST) / SHORTEST)
        out[i] = math.floor(min(step, STEPS - 1.0) + 0.5)
    return out


@njit(**ENTRY)
def returning(verdicts: F8, age: F8, expected: Bool, prior: float, share: float) -> Bool:
    """(n,) whether more than the ``share`` of those missing as long were found; ``prior`` verdicts
    are as ``expected``.
    """
    out = np.empty(age.size, np.bool_)
    step = step_of(age)
    for i in range(age.size):
        found = verdicts[0, step[i]]
        lost = verdicts[1, step[i]]
        out[i] = found + (prior if expected[i] else 0.0) > share * (found + lost + prior)
    return out


@njit(**ENTRY)
def after_frame(
    before: Followed, reported: Reported, now: float, interval: float, patience: float, kept: float
) -> Followed:
    """Who is followed after a frame with these states, and the verdicts: each on all ages up to the
    last reported one.

    In seconds: ``now``, the ``interval`` since the frame before, and the ``patience`` after which a
    missing track is not found. A verdict leaves the share ``kept`` of those before it.
    """
    label, last, age, xyxy, speed, verdicts = before
    tag, order, seen, when, confirmed = reported
    n = label.size
    m = tag.size
    step = step_of(age)
    verdicts = verdicts.copy()
    names = np.empty(n + m, np.int64)
    lasts = np.empty(n + m)
    ages = np.empty(n + m)
    boxes = np.empty((n + m, 4))
    speeds = np.empty((n + m, 4))
    ahead = np.empty((n, 4))
    for i in range(n):
        for c in range(4):
            ahead[i, c] = xyxy[i, c] + interval * speed[i, c]
    i = k = count = 0
    while i < n or k < m:
        # The next label: j is its state, −1 where it has none now; i is its place where it was
        # followed before.
        if k < m and (i == n or tag[order[k]] <= label[i]):
            j = order[k]
        else:
            j = -1
        old = i < n and (j < 0 or tag[j] == label[i])
        found = j >= 0 and when[j] >= now
        late = old and now - last[i] > patience
        if old and age[i] > 0 and (found or late):
            if found and overlap_of(ahead, i, seen, j) >= OVERLAP:
                row = 0
            else:
                row = 1
            for s in range(step[i] + 1):
                verdicts[0, s] *= kept
                verdicts[1, s] *= kept
                verdicts[row, s] += 1
        if j >= 0:
            # One verdict on each gap.
            missing = confirmed[j] and now - when[j] <= patience
            names[count] = tag[j]
            lasts[count] = when[j]
            ages[count] = now - when[j] if missing else 0.0
        else:
            names[count] = label[i]
            lasts[count] = last[i]
            ages[count] = age[i]
        for c in range(4):
            boxes[count, c] = seen[j, c] if j >= 0 else ahead[i, c]
            speeds[count, c] = (
                0.0 if not old else (seen[j, c] - xyxy[i, c]) / interval if j >= 0 else speed[i, c]
            )
        k += 1 if j >= 0 else 0
        i += 1 if old else 0
        count += 0 if j < 0 and late else 1
    return Followed(
        names[:count], lasts[:count], ages[:count], boxes[:count], speeds[:count], verdicts
    )
