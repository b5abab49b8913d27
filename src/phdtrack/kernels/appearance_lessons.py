"""Lessons on what similarity says: targets whose detections motion alone leaves no doubt of are
compared with themselves, and with each other (docs/methods.md, Appearance) [APP (3)].
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from phdtrack.kernels import F4, F8, I8, Bool, Records
from phdtrack.kernels.appearance import (
    LEAST_LENGTH,
    SOON,
    Looks,
    directions,
    named,
    similarity_gain,
    similarity_of,
)
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.gaussian import records

# The share of targets beside another one that have changed looks with it usually, and the lessons
# that this counts for.
USUAL_CHANGED = 0.01
PRIOR_BESIDE = 40.0


# A target that lessons are taken from. ``weight``, ``time``: as of `kernels.appearance.Pasts`, of
# detections without any doubt. ``taught``: seconds at the last lesson. ``near_time``, ``far_time``:
# seconds of single descriptors, of the last detection and of one some time ago, NaN for none.
FOLLOWED = records("weight time taught near_time far_time", "label")
# What a target looked like at an earlier time: seconds, NaN for none, and what that counted for.
EARLY = records("time weight", "")
# The descriptors of a target: their mean, two single ones, and its mean at earlier times.
MEAN = 0
NEAR = 1
FAR = 2
FIRST_EARLY = 3


class Followed(NamedTuple):
    """The knowledge of targets that lessons are taken from (L,), ascending by label.

    ``rows`` (L,) of `FOLLOWED`; ``early`` (L, S) of `EARLY`; ``looks`` (L, 3 + S, D): descriptors,
    the mean of each target at `MEAN`, single ones at `NEAR` and `FAR`, and early means from
    `FIRST_EARLY` on. Few arrays cost a call of a kernel less than many.
    """

    rows: Records
    early: Records
    looks: F4


class Lessons(NamedTuple):
    """Sums over lessons, old ones forgotten. ``same`` (6,): their number, and the sums of x, x², s,
    xs and s², x = log(Δ/0.1 s). ``other`` (3,): the number, and the sums of s and s².
    ``single`` (6,): of single descriptors of one object the number, and the sums of Δ and s, of
    neighbouring frames; the number and the sum of s of those some time apart; the sum of s² of the
    first. ``means`` (6,): of means of one object and of two, the number, and the sums of s and s².
    ``beside`` (2,): of targets beside another one the number, and how many have changed looks.
    """

    same: F8
    other: F8
    single: F8
    means: F8
    beside: F8


# How many sums there are.
SUMS = 23


def lessons_of(sums: F8) -> Lessons:
    """The parts of all sums (23,), which follow each other."""
    return Lessons(sums[:6], sums[6:9], sums[9:15], sums[15:21], sums[21:])


# The same for kernels.
named_lessons = njit(**INNER)(lessons_of)


class Rules(NamedTuple):
    """The rules of lessons.

    ``spans`` (S,): seconds after which `Followed.early` is renewed. ``pause``: seconds between
    lessons of one target. ``least_free``: of a box that teaches. ``most``: lessons that are
    remembered.
    """

    spans: tuple[float, ...]
    pause: float
    least_free: float
    most: float


@njit(**ENTRY)
def taught(
    followed: Followed, sums: F8, sure: I8, looks: Looks, rules: Rules
) -> tuple[tuple[Records, Records, F4], F8]:
    """The targets that are followed, and the sums of lessons, after a frame [APP (3)]. Records as
    plain tuples, see `kernels.appearance.plain`.

    Parameters
    ----------
    followed, sums : of the frame before; the sums are those of `lessons_of`.
    sure : (K, 2), ascending by label: targets that motion leaves no doubt of, and their
        measurements, −1 where there is none. Others are forgotten.
    looks, rules : of the frame, and `Rules`.
    """
    looks = named(looks)
    rules = Rules(*rules)
    total = sums.copy()
    lessons = named_lessons(total)
    out = _carried_over(Followed(*followed), sure, looks.raw.shape[1], len(rules.spans))
    rows = out.rows
    detection = _free_detections(sure, looks.free, rules.least_free)
    learns = _learning(detection, rows, looks.time, rules.pause)
    # Most frames have few lessons, or none: one target's are some time apart.
    if np.any(learns):
        known = directions(_means(out.looks), looks.mean)
        for a in range(len(sure)):
            if learns[a]:
                rows[a].taught = looks.time
                _teach_other(known, rows, looks.seen, (a, detection[a]), lessons, rules.most)
                if rows[a].weight > 0.0:
                    _teach_same(out, known, looks, (a, detection[a]), lessons, rules)
                    _teach_beside(rows, known, looks, (a, sure), lessons.beside, rules.most)
    _teach_single(out, looks, detection, learns, lessons.single, rules)
    _renew(out, looks, detection, rules.spans)
    if lessons.means[0] > rules.most or lessons.means[3] > rules.most:
        _forget(lessons.means, rules.most)
    return (out.rows, out.early, out.looks), total


@njit(**INNER)
def _free_detections(sure: I8, free: F8, least: float) -> I8:
    """(K,) the detection of each target; −1 for none, and for one of which less is ``free``."""
    out = np.empty(len(sure), np.int64)
    for a in range(len(sure)):
        j = sure[a, 1]
        out[a] = j if j >= 0 and free[j] >= least else -1
    return out


@njit(**INNER)
def _learning(detection: I8, rows: Records, time: float, pause: float) -> Bool:
    """(K,) the targets that have a lesson now."""
    out = np.empty(detection.size, np.bool_)
    for a in range(detection.size):
        out[a] = detection[a] >= 0 and time >= rows[a].taught + pause
    return out


@njit(**INNER)
def _means(looks: F4) -> F4:
    """(L, D) the mean descriptor of each target."""
    out = np.empty((looks.shape[0], looks.shape[2]), np.float32)
    for a in range(out.shape[0]):
        for d in range(out.shape[1]):
            out[a, d] = looks[a, MEAN, d]
    return out


@njit(**INNER)
def _carried_over(followed: Followed, sure: I8, size: int, depth: int) -> Followed:
    """The targets ``sure``, with what was known of them."""
    rows, early, looks = followed
    count = len(sure)
    same = count == rows.size
    for a in range(count):
        same = same and rows[a].label == sure[a, 0]
    if same:
        return Followed(rows.copy(), early.copy(), looks.copy())
    out = Followed(
        np.zeros(count, FOLLOWED),
        np.zeros((count, depth), EARLY),
        np.zeros((count, FIRST_EARLY + depth, size), np.float32),
    )
    _write_carried(followed, sure, out.rows, out.early, out.looks)
    return out


@njit(**INNER)
def _write_carried(followed: Followed, sure: I8, out: Records, early: Records, looks: F4) -> None:
    """Write what is known of the targets ``sure``, or that nothing is."""
    rows, early_before, looks_before = followed
    p = 0 * rows.size
    for a in range(out.size):
        label = sure[a, 0]
        while p < rows.size and rows[p].label < label:
            p += 1
        if p < rows.size and rows[p].label == label:
            out[a] = rows[p]
            for k in range(early.shape[1]):
                early[a, k] = early_before[p, k]
            for k in range(looks.shape[1]):
                for d in range(looks.shape[2]):
                    looks[a, k, d] = looks_before[p, k, d]
            continue
        out[a].label = label
        out[a].time = out[a].taught = -np.inf
        out[a].near_time = out[a].far_time = np.nan
        for k in range(early.shape[1]):
            early[a, k].time = np.nan


@njit(**INNER)
def _forget(sums: F8, most: float) -> None:
    """Forget a lesson's part of old ones."""
    for k in range(sums.size):
        sums[k] *= max(1.0 - 1.0 / most, 0.0)


@njit(**INNER)
def _teach_other(
    known: F4, rows: Records, seen: F4, at: tuple[int, int], sums: Lessons, most: float
) -> None:
    """Learn how similar other targets are to detection j of target a, ``at`` = (a, j); all of them
    count as one lesson.

    ``known`` (K, D): the directions of what the targets look like. ``seen``: `Looks.seen`.
    """
    a, j = at
    other = sums.other
    means = sums.means
    rivals = 0
    for b in range(len(known)):
        rivals += b != a and rows[b].weight > 0.0
    if rivals == 0:
        return
    _forget(other, most)
    part = 1.0 / rivals
    for b in range(len(known)):
        if b != a and rows[b].weight > 0.0:
            s = similarity_of(known, b, seen, j)
            other[0] += part
            other[1] += part * s
            other[2] += part * s * s
            if rows[a].weight > 0.0:
                s = similarity_of(known, b, known, a)
                means[3] += part
                means[4] += part * s
                means[5] += part * s * s


@njit(**INNER)
def _teach_same(
    out: Followed, known: F4, looks: Looks, at: tuple[int, int], sums: Lessons, rules: Rules
) -> None:
    """Learn how similar a target is to what it looked like before, just now and some time ago; all
    of these count as one lesson.
    """
    a, j = at
    early = out.early
    time = out.rows[a].time
    seen = looks.seen
    same = sums.same
    means = sums.means
    depth = len(rules.spans)
    parts = 1.0
    for k in range(depth):
        parts += np.isfinite(early[a, k].time)
    _forget(same, rules.most)
    s = similarity_of(known, a, seen, j)
    _learn(same, s, looks.time - time, 1.0 / parts)
    before = directions(out.looks[a], looks.mean)
    for k in range(depth):
        if np.isfinite(early[a, k].time):
            s = similarity_of(before, FIRST_EARLY + k, seen, j)
            _learn(same, s, looks.time - early[a, k].time, 1.0 / parts)
            s = _since(out, a, k, looks.mean, looks.memory)
            if np.isfinite(s) and time - early[a, k].time >= rules.spans[0]:
                means[0] += 1.0 / parts
                means[1] += s / parts
                means[2] += s * s / parts


@njit(**INNER)
def _teach_beside(
    rows: Records, known: F4, looks: Looks, at: tuple[int, I8], beside: F8, most: float
) -> None:
    """Learn whether a target that is beside another one has changed looks with it, ``at`` =
    (a, sure): with the probability that this is the case by what is known so far [APP (7)].
    """
    a, sure = at
    j = sure[a, 1]
    law = looks.law
    seen = looks.seen
    other = looks.beside[j] if looks.beside.size > 0 else -1
    # Before anything is known: the law of `UNKNOWN`. A weight of 0 would not do, because what is no
    # longer trusted must be able to be trusted again.
    if other < 0 or law.same_deviation >= 1.0:
        return
    for b in range(len(sure)):
        if sure[b, 1] == other and rows[b].weight > 0.0:
            fits = similarity_gain(similarity_of(known, a, seen, j), law)
            crossed = similarity_gain(similarity_of(known, b, seen, j), law)
            share = changed_share(beside)
            # More would overflow.
            unchanged = (1.0 - share) * math.exp(min(fits - crossed, 100.0))
            _forget(beside, most)
            beside[0] += 1.0
            beside[1] += share / (share + unchanged)


@njit(**INNER)
def changed_share(beside: F8) -> float:
    """The share of what is seen of targets beside another one in which they have changed looks, by
    `Lessons.beside`.
    """
    found: float = (beside[1] + PRIOR_BESIDE * USUAL_CHANGED) / (beside[0] + PRIOR_BESIDE)
    return found


@njit(**INNER)
def _teach_single(
    out: Followed, looks: Looks, detection: I8, learns: Bool, sums: F8, rules: Rules
) -> None:
    """Learn how similar single descriptors of one target are, of neighbouring frames and some time
    apart [APP (4)], and keep those of this frame.

    ``detection``: `_free_detections`.
    """
    rows = out.rows
    own = out.looks
    raw = looks.raw
    seen = looks.seen
    mean = looks.mean
    kept = max(1.0 - 1.0 / rules.most, 0.0)
    for a in range(detection.size):
        j = detection[a]
        if j < 0:
            continue
        apart = looks.time - rows[a].far_time
        if not apart < rules.spans[1]:
            if apart < 2.0 * rules.spans[1]:
                sums[3] = kept * sums[3] + 1.0
                sums[4] = kept * sums[4] + _alike(own, (a, FAR), mean, seen, j)
            for d in range(raw.shape[1]):
                own[a, FAR, d] = raw[j, d]
            rows[a].far_time = looks.time
        apart = looks.time - rows[a].near_time
        if apart < rules.spans[0] and learns[a]:
            s = _alike(own, (a, NEAR), mean, seen, j)
            sums[0] = kept * sums[0] + 1.0
            sums[1] = kept * sums[1] + apart
            sums[2] = kept * sums[2] + s
            sums[5] = kept * sums[5] + s * s
        for d in range(raw.shape[1]):
            own[a, NEAR, d] = raw[j, d]
        rows[a].near_time = looks.time


@njit(**INNER)
def _renew(out: Followed, looks: Looks, detection: I8, spans: tuple[float, ...]) -> None:
    """Take the detections into what targets look like, and renew what these looked like before.

    ``detection``: `_free_detections`.
    """
    rows, early, own = out
    raw = looks.raw
    free = looks.free
    for a in range(detection.size):
        j = detection[a]
        if j < 0:
            continue
        row = rows[a]
        old = 0.0
        if row.weight > 0.0:
            for k in range(len(spans)):
                if not looks.time - early[a, k].time < 2.0 * spans[k]:
                    early[a, k].time = row.time
                    early[a, k].weight = row.weight
                    for d in range(own.shape[2]):
                        own[a, FIRST_EARLY + k, d] = own[a, MEAN, d]
            old = row.weight * math.exp((row.time - looks.time) / looks.memory)
        row.weight = old + free[j]
        row.time = looks.time
        part = np.float32(free[j] / row.weight)
        for d in range(own.shape[2]):
            own[a, MEAN, d] += part * (raw[j, d] - own[a, MEAN, d])


@njit(**INNER)
def _since(followed: Followed, a: int, k: int, middle: F4, memory: float) -> float:
    """The similarity of the early mean k of target a to the mean of what it has looked like since,
    both less ``middle``, the mean of the stream; NaN if nothing new is known.
    """
    looks = followed.looks
    row = followed.rows[a]
    before = followed.early[a, k]
    kept = before.weight * math.exp((before.time - row.time) / memory)
    new = row.weight - kept
    if not new > 0.5:
        return np.nan
    product = 0.0
    length = 0.0
    early_length = 0.0
    for d in range(looks.shape[2]):
        early = looks[a, FIRST_EARLY + k, d]
        since = (row.weight * looks[a, MEAN, d] - kept * early) / new
        since -= middle[d]
        early -= middle[d]
        product += since * early
        length += since * since
        early_length += early * early
    scale = length * early_length
    return product / math.sqrt(scale) if scale > LEAST_LENGTH**4 else np.nan


@njit(**INNER)
def _alike(looks: F4, at: tuple[int, int], mean: F4, seen: F4, j: int) -> float:
    """The similarity of descriptor k of target a in ``looks`` (L, S, D), ``at`` = (a, k), to row j
    of ``seen``, which are directions; both less ``mean``.
    """
    a, k = at
    product = 0.0
    length = 0.0
    for d in range(looks.shape[2]):
        value = looks[a, k, d] - mean[d]
        product += value * seen[j, d]
        length += value * value
    return product / math.sqrt(length) if length > LEAST_LENGTH**2 else 0.0


@njit(**INNER)
def _learn(sums: F8, s: float, seconds: float, weight: float) -> None:
    """Add a lesson of the same object to the sums of `Lessons.same`."""
    x = math.log(seconds / SOON) if seconds > SOON else 0.0
    sums[0] += weight
    sums[1] += weight * x
    sums[2] += weight * x * x
    sums[3] += weight * s
    sums[4] += weight * x * s
    sums[5] += weight * s * s
