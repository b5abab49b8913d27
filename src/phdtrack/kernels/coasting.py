"""Outcomes of track gaps: the target was detected again at its prediction, or not. See
`associate.labels`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from phdtrack.kernels import F8, I8, Bool
from phdtrack.kernels.box import overlap_of
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER, MERGED

# Ages are counted in steps that grow by a third of an octave each, from 1/240 s to three hours.
STEPS = 64
SHORTEST = 1 / 240
PER_OCTAVE = 3.0
# A track that is found again must overlap its prediction by so much (IoU).
OVERLAP = 0.5
# Intervals of the integral over where a box may be, an even number, and the least deviation.
INTERVALS = 32
TINY = 1e-6


class Followed(NamedTuple):
    """Tracks that the filter reports, or reported recently, and the outcomes of gaps.

    ``label`` (n,): ascending. ``last``, ``age`` (n,), seconds: when each was last detected, and how
    long it had been missing when it was last reported. ``xyxy``, ``speed`` (n, 4): the box of each
    and its change in a second; those no longer reported keep moving. ``verdicts`` (2, STEPS): how
    many of those reported missing for as long were detected again at their prediction, and how many
    were not; older ones count less.
    """

    label: I8
    last: F8
    age: F8
    xyxy: F8
    speed: F8
    verdicts: F8


class Reported(NamedTuple):
    """States of a frame: labels (m,), their order, boxes (m, 4), the time when each was last
    detected, and true for those that are confirmed.
    """

    label: I8
    order: I8
    xyxy: F8
    last: F8
    confirmed: Bool


@njit(**INNER)
def _step_of(age: float) -> int:
    """The step that is nearest to an age in seconds; whole numbers of frames are far from halfway
    between steps at all usual rates.
    """
    step = PER_OCTAVE * math.log2(max(age, SHORTEST) / SHORTEST)
    return math.floor(min(step, STEPS - 1.0) + 0.5)


@njit(**ENTRY)
def step_of(age: F8) -> I8:
    """(n,) the step that is nearest to each age in seconds."""
    out = np.empty(age.size, np.int64)
    for i in range(age.size):
        out[i] = _step_of(age[i])
    return out


@njit(**INNER)
def is_returning(verdicts: F8, age: float, expected: bool, prior: float, share: float) -> bool:
    """True if more than the ``share`` of tracks that were missing as long were detected again;
    ``prior`` outcomes are as ``expected``.
    """
    step = _step_of(age)
    again = verdicts[0, step]
    lost = verdicts[1, step]
    out: bool = again + (prior if expected else 0.0) > share * (again + lost + prior)
    return out


@njit(**INNER)
def _judge(verdicts: F8, row: int, last_step: int, kept: float) -> None:
    """Count one outcome for all ages up to a step."""
    for s in range(last_step + 1):
        verdicts[0, s] *= kept
        verdicts[1, s] *= kept
        verdicts[row, s] += 1


@njit(**INNER)
def _predicted(xyxy: F8, speed: F8, interval: float) -> F8:
    """(n, 4) boxes that keep moving at their speed."""
    out = np.empty(xyxy.shape)
    for i in range(len(xyxy)):
        for c in range(4):
            out[i, c] = xyxy[i, c] + interval * speed[i, c]
    return out


@njit(**MERGED)
def after_frame(
    before: Followed, reported: Reported, now: float, interval: float, patience: float, kept: float
) -> Followed:
    """The tracks that are followed after a frame, and the outcomes of gaps: each counts for all
    ages up to the last reported one.

    In seconds: ``now``, the ``interval`` since the frame before, and the ``patience`` after which a
    missing track counts as lost. An outcome leaves the share ``kept`` of those before it.
    """
    label, last, age, xyxy, speed, verdicts = before
    tag, order, boxes, when, confirmed = reported
    n = label.size
    m = tag.size
    step = step_of(age)
    ahead = _predicted(xyxy, speed, interval)
    out = Followed(
        np.empty(n + m, np.int64),
        np.empty(n + m),
        np.empty(n + m),
        np.empty((n + m, 4)),
        np.empty((n + m, 4)),
        verdicts.copy(),
    )
    i = k = count = 0 * n
    while i < n or k < m:
        # The next label: j is its state, −1 if it has none now; i is its row if it was followed
        # before.
        j = -1
        if k < m and (i == n or tag[order[k]] <= label[i]):
            j = order[k]
        old = i < n and (j < 0 or tag[j] == label[i])
        detected = j >= 0 and when[j] >= now
        late = old and now - last[i] > patience
        if old and age[i] > 0 and (detected or late):
            again = detected and overlap_of(ahead, i, boxes, j) >= OVERLAP
            _judge(out.verdicts, 0 if again else 1, step[i], kept)
        if j >= 0:
            out.label[count] = tag[j]
            out.last[count] = when[j]
            # One outcome for each gap.
            missing = confirmed[j] and now - when[j] <= patience
            out.age[count] = now - when[j] if missing else 0.0
            for c in range(4):
                out.xyxy[count, c] = boxes[j, c]
                out.speed[count, c] = (boxes[j, c] - xyxy[i, c]) / interval if old else 0.0
            k += 1
        else:
            out.label[count] = label[i]
            out.last[count] = last[i]
            out.age[count] = age[i]
            for c in range(4):
                out.xyxy[count, c] = ahead[i, c]
                out.speed[count, c] = speed[i, c]
        if old:
            i += 1
        if j >= 0 or not late:
            count += 1
    return Followed(
        out.label[:count],
        out.last[:count],
        out.age[:count],
        out.xyxy[:count],
        out.speed[:count],
        out.verdicts,
    )


@njit(**ENTRY)
def overlap_probability(across: F8, along: F8) -> F8:
    """(n,) the probability that a box overlaps one of its size by half or more (IoU).

    ``across`` and ``along`` (n,): the standard deviations of the centre, which is normally
    distributed, in widths and heights. Two boxes that are u widths and v heights apart overlap so
    if (1 − |u|)(1 − |v|) ≥ 2/3.
    """
    out = np.empty(len(across))
    for k in range(len(across)):
        out[k] = _overlap_probability(across[k], along[k])
    return out


@njit(**INNER)
def _overlap_probability(across: float, along: float) -> float:
    """The probability of `overlap_probability` for one box."""
    root = math.sqrt(0.5)
    a = max(across, TINY)
    b = max(along, TINY)
    # Simpson's rule in units of the deviation: beyond six there is nothing.
    most = min(6.0, 1.0 / (3.0 * a))
    step = most / INTERVALS
    total = 0.0
    for i in range(INTERVALS + 1):
        z = i * step
        reach = max(1.0 - 2.0 / (3.0 * (1.0 - a * z)), 0.0)
        weight = 1.0 if i in (0, INTERVALS) else 4.0 if i % 2 else 2.0
        total += weight * math.exp(-0.5 * z * z) * math.erf(root * reach / b)
    return total * step / 3.0 * 2.0 / math.sqrt(2.0 * math.pi)


@njit(**INNER)
def on_box(state: F8, covariance: F8, k: int) -> float:
    """The probability that the box of state k of (6, n), with covariances (n, 6, 6), overlaps that
    of its target by half or more: `models.predicted_boxes.on_target` for boxes in the image.
    """
    deviation = np.empty(2)
    for axis in range(2):
        middle = state[axis, k]
        half = 0.5 * state[4 + axis, k]
        moved = middle + math.sqrt(covariance[k, axis, axis])
        size = max((middle + half) - (middle - half), 1e-9)
        low = (moved - half) - (middle - half)
        high = (moved + half) - (middle + half)
        shift = (low + high) / (2 * size)
        deviation[axis] = abs(shift)
    return float(_overlap_probability(deviation[0], deviation[1]))
