"""Merged measurements: the targets that each blob shows, their boxes in it, and the estimates that
continue them.

The model is that of `detect.merged`. N blobs and n targets have boxes of four edges: left, top,
right, bottom.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from phdtrack.kernels import F8, I8, Bool
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.gaussian import LOG_2PI, factor, norm2
from phdtrack.kernels.gm_merge import descending

# See `explained`.
Parts = tuple[F8, I8, I8, I8, F8, F8]
# Squared deviations beyond which a blob does not fit; the largest number of blobs and targets that
# are explained together.
GATE2 = 25.0
GROUP = 6
# Largest probability of existence; targets of a smaller one than the least are dropped.
MAX_EXISTENCE = 0.99
MIN_EXISTENCE = 0.1
# Squared Mahalanobis distance in the plane within which an estimate can continue a target: 99 % of
# two dimensions.
NEAR = 9.21
TINY = 1e-300
# Log-likelihoods that differ by less are equal: sums of the same numbers in another order.
ROUNDING = 1e-9
# Rows of centre and size in covariances of noise.
NOISE_ROWS = (0, 1, 2, 3)


class Rule(NamedTuple):
    """The settings of `detect.merged.MergedMeasurements`."""

    merge_probability: float
    min_separate_time: float
    max_hidden_time: float


class Lives(NamedTuple):
    """(n,) each, of the targets: r, p_D, and the seconds of `detect.merged.ExpectedTargets`."""

    existence: F8
    p_detect: F8
    hidden: F8
    separate: F8


class Frame(NamedTuple):
    """The terms of log-likelihoods: the boxes of blobs (N, 4) and of targets (n, 4), the
    covariances (k, 4, 4) of the targets' edges, of the noise that belongs to targets and to blobs,
    each perhaps none; κ (N,); log-probabilities (n,) that a target is missed and is detected.
    """

    blobs: F8
    boxes: F8
    spread: F8
    own: F8
    measured: F8
    clutter: F8
    missed: F8
    detected: F8
    lives: Lives
    rule: Rule


@njit(**ENTRY)
def explained(
    blobs: F8,
    possible: Bool,
    clutter: F8,
    boxes: F8,
    covariance: F8,
    rows: tuple[int, ...],
    noise: tuple[F8, F8],
    lives: Lives,
    rule: Rule,
    seconds: float,
) -> Parts:
    """The boxes (N′, 4) for the filter, ``source``, ``part`` and ``target`` of `DividedDetections`,
    and the seconds (n,) for which each target has been hidden and has had a blob to itself.

    ``possible`` (N,): true for blobs that show a possible state; κ of others is not read.
    ``covariance`` (n, d, d) of the states, whose ``rows`` are centre and size; ``noise``: the
    covariances of centre and size that belong to targets and to blobs.
    """
    spread = _of_edges(covariance, rows)
    of = np.full(len(boxes), -1, np.int64)
    order = np.arange(len(boxes))
    pairs, crowded = _touching(blobs, possible, boxes, spread, of)
    if crowded:
        order = _in_order(boxes, np.ones(len(boxes), np.bool_))
        own = _of_edges(noise[0], NOISE_ROWS)
        measured = _of_edges(noise[1], NOISE_ROWS)
        missed = np.empty(len(boxes))
        detected = np.empty(len(boxes))
        frame = Frame(blobs, boxes, spread, own, measured, clutter, missed, detected, lives, rule)
        _assign(frame, pairs, _in_order(blobs, possible), order, of)
    parts: Parts = _divided(blobs, boxes, of, order, lives, seconds)
    return parts


@njit(**INNER)
def _of_edges(covariance: F8, rows: tuple[int, ...]) -> F8:
    """(k, 4, 4) covariances of the edges of boxes, of (k, d, d) whose ``rows`` are centre x, centre
    y, width, height.
    """
    out = np.empty((len(covariance), 4, 4))
    for k in range(len(covariance)):
        for a in range(4):
            i = rows[a % 2]
            w = rows[a % 2 + 2]
            s = -0.5 if a < 2 else 0.5
            for b in range(4):
                j = rows[b % 2]
                v = rows[b % 2 + 2]
                u = -0.5 if b < 2 else 0.5
                centre = covariance[k, i, j] + s * covariance[k, w, j]
                out[k, a, b] = centre + u * (covariance[k, i, v] + s * covariance[k, w, v])
    return out


@njit(**INNER)
def _touching(blobs: F8, possible: Bool, boxes: F8, spread: F8, of: I8) -> tuple[Bool, bool]:
    """(N, n) true for the pairs that touch, the targets' edges moved out by a deviation, and
    whether any blob or target touches two.

    Writes a blob that each target touches into ``of`` (n,).
    """
    pairs = np.zeros((len(blobs), len(boxes)), np.bool_)
    used = np.zeros(len(blobs), np.bool_)
    crowded = False
    out = np.empty(4)
    for t in range(len(boxes)):
        for side in range(4):
            reach = math.sqrt(max(spread[t, side, side], 0.0))
            out[side] = boxes[t, side] - reach if side < 2 else boxes[t, side] + reach
        for b in range(len(blobs)):
            across = blobs[b, 0] <= out[2] and out[0] <= blobs[b, 2]
            if possible[b] and across and blobs[b, 1] <= out[3] and out[1] <= blobs[b, 3]:
                crowded = crowded or used[b] or of[t] >= 0
                pairs[b, t] = True
                used[b] = True
                of[t] = b
    return pairs, crowded


@njit(**INNER)
def _in_order(boxes: F8, used: Bool) -> I8:
    """Indices of the boxes ``used`` in the order of their edges, so that nothing depends on the
    order of the input.
    """
    order = np.empty(len(boxes), np.int64)
    count = 0
    for i in range(len(boxes)):
        if used[i]:
            k = count
            count = count + 1
            while k > 0:
                side = 0
                before = order[k - 1]
                while side < 3 and boxes[i, side] == boxes[before, side]:
                    side += 1
                if boxes[i, side] >= boxes[before, side]:
                    break
                order[k] = before
                k -= 1
            order[k] = i
    return order[:count]


@njit(**INNER)
def _area(boxes: F8, i: int) -> float:
    """The area of box i."""
    area: float = (boxes[i, 2] - boxes[i, 0]) * (boxes[i, 3] - boxes[i, 1])
    return area


@njit(**INNER)
def _assign(frame: Frame, pairs: Bool, blobs: I8, targets: I8, of: I8) -> None:
    """Write the blob of each target in the best explanation, −1 for none, into ``of`` (n,).

    ``blobs`` and ``targets`` are in the order of their edges. Writes the log-probabilities of
    `Frame` first.
    """
    a = frame.blobs
    c = frame.boxes
    r, p, _, _ = frame.lives
    shared = np.zeros(pairs.shape)
    for t in range(len(of)):
        covered = 0.0
        of[t] = -1
        for b in range(len(a)):
            width = min(a[b, 2], c[t, 2]) - max(a[b, 0], c[t, 0])
            height = min(a[b, 3], c[t, 3]) - max(a[b, 1], c[t, 1])
            if pairs[b, t] and width > 0.0 and height > 0.0:
                shared[b, t] = width * height
                covered = max(covered, shared[b, t])
        covered = min(covered / max(_area(c, t), TINY), 1.0)
        frame.missed[t] = math.log(max(1.0 - r[t] * (p[t] + (1.0 - p[t]) * covered), TINY))
        frame.detected[t] = math.log(max(r[t] * p[t], TINY))
        for b in range(len(a)):
            shared[b, t] /= max(min(_area(a, b), _area(c, t)), TINY)
    group, kept = _grouped(pairs, shared, blobs, targets)
    inside = np.empty(len(blobs), np.int64)
    members = np.empty(len(targets), np.int64)
    for first in blobs:
        n = 0
        m = 0
        for b in blobs:
            if group[b] == group[first]:
                inside[n] = b
                n += 1
        for t in targets:
            if group[len(a) + t] == group[first]:
                members[m] = t
                m += 1
        if inside[0] == first and n == 1 and m == 1:
            of[members[0]] = first
        elif inside[0] == first and m > 0:
            _explain(frame, kept, inside[:n], members[:m], of)


@njit(**INNER)
def _grouped(pairs: Bool, strength: F8, blobs: I8, targets: I8) -> tuple[I8, Bool]:
    """(N + n,) the group of each blob, then of each target, of at most `GROUP` members, and the
    pairs (N, n) that are kept.

    The strongest pairs are joined first; a pair that would make a group too large is dropped.
    """
    n = len(pairs)
    size = pairs.sum()
    count = 0
    blob = np.empty(size, np.int64)
    target = np.empty(size, np.int64)
    weight = np.empty(size)
    for b in blobs:
        for t in targets:
            if pairs[b, t]:
                blob[count] = b
                target[count] = t
                weight[count] = strength[b, t]
                count += 1
    group = np.arange(n + pairs.shape[1])
    kept = np.zeros(pairs.shape, np.bool_)
    for q in descending(weight):
        a = group[blob[q]]
        c = group[n + target[q]]
        together = 0
        for i in range(len(group)):
            together += group[i] == a or group[i] == c
        if a == c or together <= GROUP:
            kept[blob[q], target[q]] = True
            for i in range(len(group)):
                if group[i] == c:
                    group[i] = a
    return group, kept


@njit(**INNER)
def _explain(frame: Frame, kept: Bool, blobs: I8, targets: I8, of: I8) -> None:
    """Write the blob of each target of a group in the most likely explanation into ``of`` (n,); the
    first of equally likely ones.

    Explanations are counted like numbers: a target's digit is 0 for no blob, then the blobs that it
    may be in, and the last target's digit changes fastest. A table holds the log-likelihoods of a
    blob and a set of targets.
    """
    m = len(targets)
    turn = 0
    top = -math.inf
    options = np.full((m, GROUP), -1, np.int64)
    count = np.ones(m, np.int64)
    digit = np.zeros(m, np.int64)
    for i in range(m):
        for k in range(len(blobs)):
            if kept[blobs[k], targets[i]]:
                options[i, count[i]] = k
                count[i] += 1
    table = np.full((len(blobs), 1 << m), np.nan)
    sets = np.empty(len(blobs), np.int64)
    while turn >= 0:
        value = 0.0
        total = 0.0
        sets[:] = 0
        for i in range(m):
            k = options[i, digit[i]]
            if k < 0:
                value += frame.missed[targets[i]]
            else:
                sets[k] |= 1 << i
        for k in range(len(blobs)):
            if math.isnan(table[k, sets[k]]):
                table[k, sets[k]] = _log_likelihood(frame, blobs[k], targets, sets[k])
            total += table[k, sets[k]]
        if value + total > top + ROUNDING:
            top = value + total
            for i in range(m):
                k = options[i, digit[i]]
                of[targets[i]] = blobs[k] if k >= 0 else -1
        turn = m - 1
        while turn >= 0 and digit[turn] == count[turn] - 1:
            digit[turn] = 0
            turn -= 1
        if turn >= 0:
            digit[turn] += 1


@njit(**INNER)
def _log_likelihood(frame: Frame, blob: int, targets: I8, chosen: int) -> float:
    """Log-likelihood of a blob that shows the targets whose bits are set in ``chosen``; −∞ if that
    is not allowed.
    """
    several = np.empty(len(targets), np.int64)
    k = 0
    detected = 0.0
    for i in range(len(targets)):
        if chosen >> i & 1:
            several[k] = targets[i]
            k += 1
            detected += frame.detected[targets[i]]
    if k == 0:
        return math.log(max(frame.clutter[blob], TINY))
    owner = _owners(frame.boxes, several[:k])
    rule = frame.rule
    for t in several[:k]:
        late = t != owner[0] and t != owner[2] and frame.lives.hidden[t] > rule.max_hidden_time
        if k > 1 and (late or frame.lives.separate[t] < rule.min_separate_time):
            return -math.inf
    # The union of the boxes as a Gaussian: edges of different targets are independent.
    step = np.empty(4)
    spread = np.zeros((4, 4))
    for i in range(4):
        t = owner[i]
        step[i] = frame.blobs[blob, i] - frame.boxes[t, i]
        for j in range(4):
            if owner[j] == t:
                spread[i, j] = frame.spread[t, i, j]
                if len(frame.own):
                    spread[i, j] += frame.own[t, i, j]
                if len(frame.measured):
                    spread[i, j] += frame.measured[blob, i, j]
    root = np.empty((4, 4))
    y = np.empty(4)
    log_det = factor(spread, root)
    distance2 = norm2(step, root, y)
    if not distance2 <= GATE2:  # also NaN, where the spread has no factors
        return -math.inf
    merged = (k - 1) * math.log(max(rule.merge_probability, TINY))
    return float(-0.5 * (distance2 + log_det + 4.0 * LOG_2PI) + merged + detected)


@njit(**INNER)
def _owners(boxes: F8, several: I8) -> I8:
    """(4,) the one of ``several`` boxes that has each edge of their union, the first of equal
    ones.
    """
    owner = np.full(4, several[0])
    for i in several:
        for side in range(4):
            edge = boxes[i, side]
            outermost = boxes[owner[side], side]
            farther = edge > outermost if side > 1 else edge < outermost
            if farther:
                owner[side] = i
    return owner


@njit(**INNER)
def _divided(blobs: F8, boxes: F8, of: I8, order: I8, lives: Lives, seconds: float) -> Parts:
    """The parts of blobs that `explained` returns: ``of`` (n,) is each target's blob; targets of a
    blob are in this ``order`` (n,).
    """
    count = np.zeros(len(blobs), np.int64)
    part = np.empty(len(blobs), np.int64)
    total = 0
    for b in of:
        if b >= 0:
            count[b] += 1
    for b in range(len(blobs)):
        part[b] = total
        total = total + max(count[b], 1)
    xyxy = np.empty((total, 4))
    source = np.empty(total, np.int64)
    target = np.full(total, -1, np.int64)
    end = part.copy()
    hidden = lives.hidden.copy()
    separate = lives.separate.copy()
    for t in order:
        if of[t] >= 0:
            target[end[of[t]]] = t
            end[of[t]] += 1
    for b in range(len(blobs)):
        for k in range(part[b], part[b] + max(count[b], 1)):
            source[k] = b
            for side in range(4):
                xyxy[k, side] = blobs[b, side]
        several = target[part[b] : end[b]]
        if count[b] == 1:
            separate[several[0]] += seconds
            hidden[several[0]] = 0.0
        elif count[b] > 1:
            owner = _owners(boxes, several)
            for i in range(count[b]):
                t = several[i]
                hidden[t] += seconds
                # A target that has an edge at the side of the blob is in view.
                if t == owner[0] or t == owner[2]:
                    hidden[t] = 0.0
                for axis in range(2):
                    _place(boxes, t, axis, owner, xyxy, part[b] + i)
    return xyxy, source, part, target, hidden, separate


@njit(**INNER)
def _place(boxes: F8, t: int, axis: int, owner: I8, xyxy: F8, k: int) -> None:
    """Replace a merged blob's edges along an axis, in row k, by those of its target t, whose size
    is unchanged.

    The edges of the blob that are the target's place it, midway if both are; a target without any
    stays at its predicted position, inside the blob.
    """
    low = xyxy[k, axis]
    high = xyxy[k, axis + 2]
    start = boxes[t, axis]
    size = boxes[t, axis + 2] - boxes[t, axis]
    room = high - low - size
    if owner[axis] == t:
        start = low
    if owner[axis + 2] == t:
        start = high - size
        if owner[axis] == t:
            start = (low + high - size) / 2
    if room > 0.0:
        start = min(max(start, low), max(low, high - size))
    else:
        start = low + room / 2
    xyxy[k, axis] = start
    xyxy[k, axis + 2] = start + size


@njit(**ENTRY)
def continued(
    after: tuple[I8, I8, F8],
    state: F8,
    covariance: F8,
    noise: F8,
    lives: Lives,
    longest: float,
    seconds: float,
) -> tuple[F8, F8, F8, F8, Bool]:
    """(k,) the seconds of `Lives` for the estimates, (n,) r and ``hidden`` of the targets after the
    frame, and true for those without an estimate that may still exist.

    ``after``: the target (N′,) of each detection, the detection (k,) and the state (d, k) of each
    estimate. ``noise``: deviations (d, n) of the targets' states. ``longest``: seconds for which a
    target may stay hidden.
    """
    target, detection, now = after
    n = len(lives.existence)
    of = np.full(len(detection), -1, np.int64)
    hidden = np.zeros(len(detection))
    separate = np.zeros(len(detection))
    continued_by = np.zeros(n, np.bool_)
    detected = np.zeros(n, np.bool_)
    left = np.empty(n, np.bool_)
    for i in range(len(of)):
        if detection[i] < 0:
            continue
        t = target[detection[i]]
        if t >= 0 and not continued_by[t]:
            of[i] = t
            continued_by[t] = True
    _continue_nearest(now, state, covariance, noise, of, continued_by)
    for i in range(len(of)):
        if of[i] >= 0:
            hidden[i] = lives.hidden[of[i]]
            separate[i] = lives.separate[of[i]]
    for t in target:
        if t >= 0:
            detected[t] = True
    existence = lives.existence.copy()
    unseen = lives.hidden + seconds
    for t in range(n):
        r = existence[t]
        p = lives.p_detect[t]
        if not detected[t]:
            existence[t] = r * (1.0 - p) / max(1.0 - r * p, 1.0 - MAX_EXISTENCE)
        left[t] = not continued_by[t] and existence[t] > MIN_EXISTENCE and unseen[t] <= longest
    return hidden, separate, existence, unseen, left


@njit(**INNER)
def _continue_nearest(
    now: F8, state: F8, covariance: F8, noise: F8, of: I8, continued_by: Bool
) -> None:
    """Let estimates that continue no target continue the nearest that is left within the gate, the
    nearest pair first.
    """
    distance2 = np.full((len(of), len(continued_by)), np.inf)
    for t in range(len(continued_by)):
        a = covariance[t, 0, 0] + noise[0, t] * noise[0, t]
        c = covariance[t, 1, 1] + noise[1, t] * noise[1, t]
        b = covariance[t, 0, 1]
        d = covariance[t, 1, 0]
        for i in range(len(of)):
            if of[i] < 0 and not continued_by[t]:
                x = now[0, i] - state[0, t]
                y = now[1, i] - state[1, t]
                distance2[i, t] = (x * (c * x - b * y) + y * (a * y - d * x)) / (a * c - b * d)
    nearest = 0.0
    while nearest <= NEAR:
        nearest = np.inf
        k = 0
        j = 0
        for i in range(len(of)):
            for t in range(len(continued_by)):
                if of[i] < 0 and not continued_by[t] and distance2[i, t] < nearest:
                    nearest = distance2[i, t]
                    k = i
                    j = t
        if nearest <= NEAR:
            of[k] = j
            continued_by[j] = True
