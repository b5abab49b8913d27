"""Likelihood ratios of what boxes look like, in the update of a filter (docs/methods.md,
Appearance).

A detection j has a direction e_j, its descriptor less the stream's mean, of length one. A past h is
the mean of the descriptors of the detections that one hypothesis has had, old ones forgotten, and
when it last had one. With s = m_h · e_j, m_h the direction of the past, and Δ the time since, the
pair of a hypothesis and a measurement has the ratio

    log p(s | the same object, Δ)/p(s | another object)

by two Gaussians, of which that of the same object falls with log Δ [APP (1)], [APP (2)].
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from phdtrack.kernels import F4, F8, I8, Records
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, FAST, INLINED, INNER
from phdtrack.kernels.gaussian import records

# The probability that an object begins to look like any other, because of what stands before it, or
# in another light. So no picture alone says that an object is another one.
CHANCE = 0.05
# Seconds for which an object looks odd, on average.
ODD_TIME = 1.0
# A box of which less is free shows nothing of its object.
LEAST_FREE = 0.5
# Detections are beside each other if their boxes, larger by this part, overlap.
LARGER = 0.25
# The largest log-likelihood ratio of a pair.
MOST = 6.0
# Seconds within which an object looks the same.
SOON = 0.1
# A descriptor that is nearer to the mean than this says nothing. Descriptors have length one.
LEAST_LENGTH = 1e-3


class Law(NamedTuple):
    """The meaning of similarity.

    ``weight``, from 0 to 1: how much it is worth as yet. ``same``, ``fading``,
    ``same_deviation``: the similarity of a detection to the past of the same object has the mean
    ``same`` + ``fading`` log(Δ/0.1 s) and this deviation. ``other``, ``other_deviation``: that to
    the past of another object. ``independent``: seconds for which errors of descriptors last.
    ``signal``: the part of a single descriptor's variance that is the object's own.
    ``near_deviation``: of the similarity of descriptors of neighbouring frames.

    ``means_weight``, ``means_same``, ``means_deviation``, ``means_other``,
    ``means_other_deviation``: the same of the similarity of two means of many detections.
    ``doubt``: log of how many times as often as usually the looks of two targets change places
    where they meet, at least 0: so much less do looks that have changed places say of identities.
    ``within``: seconds after which no target takes its identity again.
    """

    weight: float
    same: float
    fading: float
    same_deviation: float
    other: float
    other_deviation: float
    independent: float
    signal: float
    near_deviation: float
    means_weight: float
    means_same: float
    means_deviation: float
    means_other: float
    means_other_deviation: float
    doubt: float
    within: float


class Looks(NamedTuple):
    """The looks of the detections of a frame.

    ``raw`` (N, D): descriptors of length one; zeros where nothing is known. ``seen`` (N, D): the
    same less ``mean`` (D,), of length one again. ``free`` (N,): the part of each box that no other
    one covers. ``law``: what similarity says. ``time``: seconds. ``memory``: seconds after which
    what was seen counts for 37 %. ``beside`` (N,): of the detections that each one is beside, the
    one nearest to it, −1 for none; (0,) where that is not known.
    """

    raw: F4
    seen: F4
    mean: F4
    free: F8
    law: Law
    time: float
    memory: float
    beside: I8 = np.zeros(0, np.int64)


# What a hypothesis has seen. ``weight``, ``time``: what all of its descriptors count for, old ones
# forgotten, and seconds at the last. ``number``: of how many independent ones `Pasts.looks` has the
# mean. ``odd``: the probability that the target then looked odd.
PAST = records("weight time number odd", "")


class Pasts(NamedTuple):
    """The knowledge of hypotheses of what their targets look like.

    ``rows`` (M,) of `PAST`. ``looks`` (M, 2, D): the mean of the descriptors, old ones forgotten,
    and the last of them.
    """

    rows: Records
    looks: F4


# Nothing is known of what similarity says.
UNKNOWN = Law(0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.5, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0, 0.0, 0.0)
_NONE = np.zeros(0)
_NO_LOOKS = np.zeros((0, 0), np.float32)
NO_PASTS = Pasts(np.zeros(0, PAST), np.zeros((0, 2, 0), np.float32))
NO_LOOKS = Looks(_NO_LOOKS, _NO_LOOKS, np.zeros(0, np.float32), _NONE, UNKNOWN, 0.0, 1.0)
# A hypothesis as `pair_ratios` and `remembered` know it: its target, its measurement of the frame,
# and its past; −1 for none. The PMB's have more fields.
HOLDER = records("", "target detection past")


def plain(looks: Looks) -> tuple[Any, ...]:
    """`Looks` as plain tuples, which kernels are called with: Numba looks up the class of every
    named one, which takes as long as some kernels.
    """
    return (*looks[:4], tuple(looks.law), *looks[5:])


@njit(**INLINED)
def named(looks: Looks) -> Looks:
    """`Looks` of those of `plain`."""
    raw, seen, mean, free, law, time, memory, beside = looks
    return Looks(raw, seen, mean, free, Law(*law), time, memory, beside)


@njit(**INLINED)
def _gain(
    similarity: float, same: float, deviation: float, other: float, other_deviation: float
) -> float:
    """log p(s | the same object)/p(s | another object) by two Gaussians [APP (1)].

    It never falls with s: where the wider Gaussian has the tail, the ratio stays what it is at its
    extreme.
    """
    if same < other:
        return 0.0
    narrow = 1.0 / (deviation * deviation)
    wide = 1.0 / (other_deviation * other_deviation)
    s = similarity
    if narrow != wide:
        turn = (same * narrow - other * wide) / (narrow - wide)
        if narrow > wide:
            s = s if s < turn else turn
        else:
            s = s if s > turn else turn
    gain = 0.5 * ((s - other) * (s - other) * wide - (s - same) * (s - same) * narrow)
    gain += math.log(other_deviation / deviation)
    return gain if gain < MOST else MOST


@njit(**INLINED)
def similarity_gain(similarity: float, law: Law) -> float:
    """log p(s | the same object)/p(s | another object) [APP (1)]."""
    gain: float = _gain(similarity, law.same, law.same_deviation, law.other, law.other_deviation)
    return gain


@njit(**INLINED)
def _of_past(
    similar: float, similar_last: float, time: float, past: Any, law: Law
) -> tuple[float, float]:
    """p(s | the same object)/p(s | another object) of a ``past``, a record of `PAST`, and the
    probability that the object now looks odd [APP (2)].

    ``similar``, ``similar_last``: similarity to the mean of the past, and to its last descriptor.
    ``time``: seconds now.
    """
    out: tuple[float, float]
    out = likelihoods(similar, similar_last, time - past.time, past.number, past.odd, law)
    return out


@njit(**INLINED)
def likelihoods(
    s_mean: float, s_last: float, seconds: float, count: float, odd: float, law: Law
) -> tuple[float, float]:
    """p(s | the same object)/p(s | another object), ``seconds`` after it was last seen, and the
    probability that it then looks odd [APP (2)].

    ``s_mean``, ``s_last``: similarity to the mean of ``count`` independent descriptors, and to the
    last one. ``odd``: the probability that it looked odd then.
    """
    fresh = math.log(seconds / SOON) if seconds > SOON else 0.0
    # Of the mean of few detections, which has errors of its own
    same = law.same + law.fading * fresh
    same /= math.sqrt(1.0 + (1.0 - law.signal) / (law.signal * count))
    usual = math.exp(_gain(s_mean, same, law.same_deviation, law.other, law.other_deviation))
    kept = math.exp(-seconds / law.independent)
    last = law.signal + (1.0 - law.signal) * kept
    deviation = law.same_deviation + (law.near_deviation - law.same_deviation) * kept
    again = (1.0 - CHANCE) * math.exp(
        _gain(s_last, last, deviation, law.other, law.other_deviation)
    ) + CHANCE
    stays = odd * math.exp(-seconds / ODD_TIME)
    begins = (1.0 - odd) * CHANCE
    strange = stays * again + begins
    total = strange + (1.0 - stays - begins) * usual
    return total, strange / total


@njit(fastmath=FAST, **INNER)
def similarity_of(a: F4, i: int, b: F4, j: int) -> float:
    """The product of row i of ``a`` and row j of ``b``."""
    total = np.float32(0.0)
    for k in range(len(a[i])):
        total += a[i, k] * b[j, k]
    return float(total)


@njit(**ENTRY)
def all_finite(numbers: F4) -> bool:
    """True if all ``numbers`` (M, D) are finite."""
    wrong = 0
    for i in range(numbers.shape[0]):
        for k in range(numbers.shape[1]):
            wrong += not abs(numbers[i, k]) < np.inf
    return wrong == 0


@njit(**INNER)
def directions(looks: F4, mean: F4) -> F4:
    """(M, D) the descriptors less ``mean``, of length one; zeros where they are nearly the same."""
    out = np.empty(looks.shape, np.float32)
    count = len(looks)
    size = len(mean)
    # Four rows at a time, and those that are left: a sum waits for its last addition.
    fours = count - count % 4
    for i in range(0, fours, 4):
        a = b = c = d = np.float32(0.0)
        for k in range(size):
            out[i, k] = looks[i, k] - mean[k]
            out[i + 1, k] = looks[i + 1, k] - mean[k]
            out[i + 2, k] = looks[i + 2, k] - mean[k]
            out[i + 3, k] = looks[i + 3, k] - mean[k]
            a += out[i, k] * out[i, k]
            b += out[i + 1, k] * out[i + 1, k]
            c += out[i + 2, k] * out[i + 2, k]
            d += out[i + 3, k] * out[i + 3, k]
        _scale(out, i, a)
        _scale(out, i + 1, b)
        _scale(out, i + 2, c)
        _scale(out, i + 3, d)
    for i in range(fours, count):
        a = np.float32(0.0)
        for k in range(size):
            out[i, k] = looks[i, k] - mean[k]
            a += out[i, k] * out[i, k]
        _scale(out, i, a)
    return out


@njit(**INNER)
def _scale(rows: F4, i: int, square: np.float32) -> None:
    """Make row i, whose length has this ``square``, one of length one; of zeros if it is near 0."""
    length = math.sqrt(square)
    scale = np.float32(1.0 / length) if length > LEAST_LENGTH else np.float32(0.0)
    for k in range(rows.shape[1]):
        rows[i, k] *= scale


@njit(**INNER)
def described(raw: F4, boxes: F8, mean: F4, most: float, count: float) -> tuple[Any, ...]:
    """`Looks.raw`, `Looks.seen`, the mean of the stream, `Looks.free`, of how many descriptors that
    mean then is, and `Looks.beside`.

    Parameters
    ----------
    raw, boxes : (N, D), (N, 4) descriptors and boxes of a frame.
    mean, count : (D,) the mean before, and of how many it is; of ``most`` at most.
    """
    n, size = raw.shape
    unit = np.zeros((n, size), np.float32)
    total = np.zeros(size, np.float32)
    known = np.zeros(n, np.bool_)
    for i in range(n):
        length = 0.0
        for k in range(size):
            length += np.float64(raw[i, k]) * np.float64(raw[i, k])
        known[i] = 0.0 < length < math.inf
        if known[i]:
            scale = np.float32(1.0 / math.sqrt(length))
            for k in range(size):
                unit[i, k] = raw[i, k] * scale
                total[k] += unit[i, k]
    after = mean.copy()
    more = known.sum()
    if more > 0:
        count = min(count, most) + more
        for k in range(size):
            after[k] += np.float32((total[k] - more * mean[k]) / count)
    seen = directions(unit, after)
    free = free_parts(boxes)
    for i in range(n):
        if not known[i]:
            seen[i] = 0.0
        if not similarity_of(seen, i, seen, i) > 0.0:
            free[i] = 0.0
    return unit, seen, after, free, count, besides(boxes)


@njit(**ENTRY)
def besides(boxes: F8) -> I8:
    """(N,) `Looks.beside` of boxes (N, 4): those that overlap if they are larger by `LARGER`; the
    nearest one overlaps by the largest part of the sum of the sides.
    """
    n = len(boxes)
    out = np.full(n, -1)
    nearest = np.zeros(n)
    for i in range(n):
        for j in range(i):
            width = boxes[i, 2] - boxes[i, 0] + boxes[j, 2] - boxes[j, 0]
            height = boxes[i, 3] - boxes[i, 1] + boxes[j, 3] - boxes[j, 1]
            if not (width > 0.0 and height > 0.0):
                continue
            x = abs(boxes[i, 0] + boxes[i, 2] - boxes[j, 0] - boxes[j, 2]) / width
            y = abs(boxes[i, 1] + boxes[i, 3] - boxes[j, 1] - boxes[j, 3]) / height
            over = 1.0 + LARGER - max(x, y)
            if over > nearest[i]:
                nearest[i] = over
                out[i] = j
            if over > nearest[j]:
                nearest[j] = over
                out[j] = i
    return out


@njit(**INNER)
def past_directions(pasts: Pasts, looks: Looks) -> F4:
    """(2M, D) the `directions` of the mean and of the last descriptor of each past in turn."""
    both: F4 = directions(pasts.looks.reshape(2 * pasts.rows.size, len(looks.mean)), looks.mean)
    return both


@njit(**INNER)
def pair_ratios(
    pairs: Records, hypotheses: Records, pasts: Pasts, looks: Looks, directions_before: F4
) -> F8:
    """(P,) the log-likelihood ratios of pairs of a hypothesis and a measurement [APP (2)]; (0,)
    where nothing is known. ``directions_before``: `past_directions`.
    """
    # As variables: a record of arrays would count its references in every round.
    rows = pasts.rows
    seen = looks.seen
    free = looks.free
    law = looks.law
    if law.weight <= 0.0 or rows.size == 0:
        return np.empty(0)
    out = np.empty(pairs.size)
    for q in range(pairs.size):
        h = hypotheses[pairs[q].gaussian].past
        j = pairs[q].measurement
        out[q] = 0.0
        if h >= 0 and free[j] > 0.0:
            similar = similarity_of(directions_before, 2 * h, seen, j)
            similar_last = similarity_of(directions_before, 2 * h + 1, seen, j)
            ratio, _ = _of_past(similar, similar_last, looks.time, rows[h], law)
            out[q] = law.weight * free[j] * math.log(ratio)
    return out


@njit(**ENTRY)
def ratios_of_pairs(pairs: Records, hypotheses: Records, pasts: Pasts, looks: Looks) -> F8:
    """(P,) `pair_ratios`, for callers in Python."""
    before = Pasts(*pasts)
    seen = named(looks)
    ratios: F8 = pair_ratios(pairs, hypotheses, before, seen, past_directions(before, seen))
    return ratios


@njit(**ENTRY)
def typical_ratios(past: tuple[F4, F8, F8], before: I8, measurement: I8, looks: Looks) -> F8:
    """(P,) the log-likelihood ratios of targets ``before`` and measurements (P,) [APP (2)], if none
    of the targets looked odd when it was last seen.

    ``past``: as of `Pasts` the mean (M, D), ``number`` and ``time`` (M,).
    """
    looks = named(looks)
    mean, number, time = past
    out = np.zeros(before.size)
    direction = directions(mean, looks.mean)
    for q in range(before.size):
        h = before[q]
        j = measurement[q]
        if number[h] > 0.0 and looks.free[j] > 0.0:
            s = similarity_of(direction, h, looks.seen, j)
            ratio, _ = likelihoods(s, s, looks.time - time[h], number[h], 0.0, looks.law)
            out[q] = looks.law.weight * looks.free[j] * math.log(ratio)
    return out


@njit(**ENTRY)
def likeness(mean: F4, number: F8, seconds: F8, before: I8, after: I8, looks: Looks) -> F8:
    """(P,) log p(s | the same object)/p(s | another object) of two means each, ``before`` and
    ``after`` (P,), s their similarity [APP (5)]; 0 where one of them is not known.

    ``mean`` (M, D): of descriptors. ``number`` (M,): of how many independent ones, 0 where nothing
    is known. ``seconds`` (M,): for how long an object must have looked odd if that is why the two
    differ, the shorter time of both.
    """
    looks = named(looks)
    direction = directions(mean, looks.mean)
    out = np.zeros(before.size)
    for q in range(before.size):
        a = before[q]
        b = after[q]
        odd = min(seconds[a], seconds[b])
        out[q] = ratio_of_means(direction, a, number[a], direction, b, number[b], odd, looks.law)
    return out


@njit(**INNER)
def ratio_of_means(
    before: F4,
    a: int,
    before_number: float,
    after: F4,
    b: int,
    after_number: float,
    seconds: float,
    law: Law,
) -> float:
    """log p(s | the same object)/p(s | another object) of mean a of ``before`` and mean b of
    ``after``, s their similarity [APP (5)]; 0 where one of them is not known.

    ``before``, ``after``: of `directions`. ``before_number``, ``after_number``: of how many
    independent descriptors each is the mean. ``seconds``: as of `likeness`.
    """
    if not (before_number > 0.0 and after_number > 0.0 and law.means_weight > 0.0):
        return 0.0
    s = similarity_of(before, a, after, b)
    errors = (1.0 - law.signal) / law.signal
    same = law.means_same
    same /= math.sqrt((1.0 + errors / before_number) * (1.0 + errors / after_number))
    gain = math.exp(_gain(s, same, law.means_deviation, law.means_other, law.means_other_deviation))
    odd = CHANCE * math.exp(-seconds / ODD_TIME)
    return law.means_weight * math.log((1.0 - odd) * gain + odd)


@njit(**ENTRY)
def free_parts(boxes: F8) -> F8:
    """(N,) how much of each box (N, 4) is free: 1 where no other covers any of it, 0 where the one
    that covers most leaves no more than `LEAST_FREE`.
    """
    n = len(boxes)
    free = np.ones(n)
    for i in range(n):
        area = (boxes[i, 2] - boxes[i, 0]) * (boxes[i, 3] - boxes[i, 1])
        for j in range(n):
            width = min(boxes[i, 2], boxes[j, 2]) - max(boxes[i, 0], boxes[j, 0])
            height = min(boxes[i, 3], boxes[j, 3]) - max(boxes[i, 1], boxes[j, 1])
            if i != j and width > 0.0 and height > 0.0 and area > 0.0:
                free[i] = min(free[i], max(1.0 - width * height / area, 0.0))
        free[i] = max((free[i] - LEAST_FREE) / (1.0 - LEAST_FREE), 0.0)
    return free


@njit(**ENTRY)
def remembered(hypotheses: Records, pasts: Pasts, looks: Looks) -> tuple[Records, F4]:
    """The `Pasts` after a frame. Takes ``hypotheses.past`` for that of the hypothesis which each
    comes from, and writes its own there.

    Hypotheses of one target that come from the same past with the same measurement share one.
    """
    before = Pasts(*pasts)
    seen = named(looks)
    after: tuple[Records, F4]
    after = pasts_after(hypotheses, before, seen, past_directions(before, seen))
    return after


@njit(**INNER)
def pasts_after(
    hypotheses: Records, pasts: Pasts, looks: Looks, directions_before: F4
) -> tuple[Records, F4]:
    """`remembered`, with the `past_directions`."""
    source = _sources(hypotheses, looks.free)
    rows = np.empty(len(source), PAST)
    own = np.empty((len(source), 2, len(looks.mean)), np.float32)
    _write(source, pasts, looks, directions_before, rows, own)
    return rows, own


@njit(**INNER)
def _sources(hypotheses: Records, free: F8) -> I8:
    """(M, 2) of each past after a frame that before, and the measurement; −1 for none. Writes the
    past of each hypothesis.
    """
    source = np.empty((hypotheses.size, 2), np.int64)
    n = 0 * hypotheses.size
    first = 0 * hypotheses.size
    target = -1
    for c in range(hypotheses.size):
        h = hypotheses[c]
        if h.target != target:
            target = h.target
            first = n
        past = h.past
        j = h.detection
        if j >= 0 and not free[j] > 0.0:
            j = -1
        h.past = -1
        for k in range(first, n):
            if source[k, 0] == past and source[k, 1] == j:
                h.past = k
        if h.past >= 0 or (past < 0 and j < 0):
            continue
        source[n, 0] = past
        source[n, 1] = j
        h.past = n
        n += 1
    return source[:n]


@njit(**INNER)
def _write(
    source: I8, pasts: Pasts, looks: Looks, directions_before: F4, rows: Records, own: F4
) -> None:
    """Write `Pasts.rows` and `Pasts.looks` of `_sources`; ``pasts``: those of the frame before."""
    # As variables: a record of arrays would count its references in every round.
    before = pasts.rows
    looks_before = pasts.looks
    seen = looks.seen
    raw = looks.raw
    free = looks.free
    law = looks.law
    for n in range(len(source)):
        h = source[n, 0]
        j = source[n, 1]
        row = rows[n]
        if j < 0:
            rows[n] = before[h]
            for d in range(own.shape[2]):
                own[n, 0, d] = looks_before[h, 0, d]
                own[n, 1, d] = looks_before[h, 1, d]
            continue
        row.weight = free[j]
        row.number = 1.0
        row.odd = 0.0
        row.time = looks.time
        if h >= 0:
            old = before[h]
            seconds = looks.time - old.time
            kept = math.exp(-seconds / looks.memory)
            rho = math.exp(-seconds / law.independent)
            new = free[j] * (1.0 - rho) / (1.0 + rho)
            row.weight = old.weight * kept + free[j]
            row.number = max(old.number * kept + new, 1.0)
            similar = similarity_of(directions_before, 2 * h, seen, j)
            similar_last = similarity_of(directions_before, 2 * h + 1, seen, j)
            _, after = _of_past(similar, similar_last, looks.time, old, law)
            row.odd = old.odd + free[j] * (after - old.odd)
        part = np.float32(free[j] / row.weight)
        for d in range(own.shape[2]):
            mean = looks_before[h, 0, d] if h >= 0 else raw[j, d]
            own[n, 0, d] = mean + part * (raw[j, d] - mean)
            own[n, 1, d] = raw[j, d]
