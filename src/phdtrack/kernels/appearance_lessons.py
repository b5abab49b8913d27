"""Lessons on what similarity says: targets whose detections motion alone leaves no doubt of are
compared with themselves, and with each other (docs/methods.md, Appearance) [APP (3)].
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from phdtrack.kernels import F4, F8, I8, Bool
from phdtrack.kernels.appearance import (
    LEAST_LENGTH,
    SOON,
    Looks,
    directions,
    move_mean,
    named,
    similarity_gain,
    similarity_of,
)
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER

# The share of targets beside another one that have changed looks with it usually, and the lessons
# that this counts for.
USUAL_CHANGED = 0.01
PRIOR_BESIDE = 40.0


class Followed(NamedTuple):
    """The knowledge of targets that lessons are taken from (L,), ascending by label.

    ``label``. ``mean`` (L, D), ``weight``, ``time`` (L,): as of `Pasts`, of detections without any
    doubt. ``taught`` (L,): seconds at the last lesson. ``early`` (L, S, D), ``early_time`` (L, S):
    the mean at earlier times, NaN where there is none, and ``early_weight`` what it counted for.
    ``single`` (L, 2, D), ``single_time`` (L, 2): single descriptors, of the last detection and of
    one some time ago.
    """

    label: I8
    mean: F4
    weight: F8
    time: F8
    taught: F8
    early: F4
    early_time: F8
    early_weight: F8
    single: F4
    single_time: F8


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
    followed: Followed, lessons: Lessons, sure: I8, looks: Looks, rules: Rules
) -> tuple[Followed, Lessons]:
    """The targets that are followed, and the lessons, after a frame [APP (3)].

    ``sure`` (K, 2), ascending by label: targets that motion leaves no doubt of, and their
    measurements, −1 where there is none. Others are forgotten.
    """
    followed = Followed(*followed)
    looks = named(looks)
    rules = Rules(*rules)
    same, other, single, means, beside = lessons
    sums = Lessons(same.copy(), other.copy(), single.copy(), means.copy(), beside.copy())
    out = _carried_over(followed, sure[:, 0], looks.raw.shape[1], len(rules.spans))
    count = len(sure)
    learns = np.zeros(count, np.bool_)
    for a in range(count):
        j = sure[a, 1]
        if j >= 0 and looks.free[j] >= rules.least_free:
            learns[a] = looks.time >= out.taught[a] + rules.pause
    # Most frames have no lesson: one target's are some time apart.
    some = np.any(learns)
    known = directions(out.mean if some else out.mean[:0], looks.mean)
    for a in range(count):
        if learns[a]:
            out.taught[a] = looks.time
            _teach_other(out, known, looks, (a, sure[a, 1]), sums, rules.most)
            if out.weight[a] > 0.0:
                _teach_same(out, known, looks, (a, sure[a, 1]), sums, rules)
                _teach_beside(out, known, looks, (a, sure), sums.beside, rules.most)
    for a in range(count):
        j = sure[a, 1]
        if j >= 0 and looks.free[j] >= rules.least_free:
            _teach_single(out, looks, (a, j), learns, sums.single, rules)
            _renew(out, looks, (a, j), rules.spans)
    if sums.means[0] > rules.most or sums.means[3] > rules.most:
        _forget(sums.means, rules.most)
    return out, sums


@njit(**INNER)
def _carried_over(followed: Followed, label: I8, size: int, depth: int) -> Followed:
    """The targets of these labels (K,), with what was known of them."""
    count = len(label)
    if np.array_equal(followed.label, label):
        return Followed(
            followed.label,
            followed.mean.copy(),
            followed.weight.copy(),
            followed.time.copy(),
            followed.taught.copy(),
            followed.early.copy(),
            followed.early_time.copy(),
            followed.early_weight.copy(),
            followed.single.copy(),
            followed.single_time.copy(),
        )
    out = Followed(
        label.copy(),
        np.zeros((count, size), np.float32),
        np.zeros(count),
        np.full(count, -np.inf),
        np.full(count, -np.inf),
        np.zeros((count, depth, size), np.float32),
        np.full((count, depth), np.nan),
        np.zeros((count, depth)),
        np.zeros((count, 2, size), np.float32),
        np.full((count, 2), np.nan),
    )
    place = np.searchsorted(followed.label, label)
    for a in range(count):
        p = place[a]
        if p < len(followed.label) and followed.label[p] == label[a]:
            out.mean[a] = followed.mean[p]
            out.weight[a] = followed.weight[p]
            out.time[a] = followed.time[p]
            out.taught[a] = followed.taught[p]
            out.early[a] = followed.early[p]
            out.early_time[a] = followed.early_time[p]
            out.early_weight[a] = followed.early_weight[p]
            out.single[a] = followed.single[p]
            out.single_time[a] = followed.single_time[p]
    return out


@njit(**INNER)
def _forget(sums: F8, most: float) -> None:
    """Forget a lesson's part of old ones."""
    for k in range(sums.size):
        sums[k] *= max(1.0 - 1.0 / most, 0.0)


@njit(**INNER)
def _teach_other(
    out: Followed, known: F4, looks: Looks, at: tuple[int, int], sums: Lessons, most: float
) -> None:
    """Learn how similar other targets are to detection j of target a, ``at`` = (a, j); all of them
    count as one lesson. ``known`` (K, D): the directions of what the targets look like.
    """
    a, j = at
    rivals = 0
    for b in range(len(known)):
        rivals += b != a and out.weight[b] > 0.0
    if rivals == 0:
        return
    _forget(sums.other, most)
    part = 1.0 / rivals
    for b in range(len(known)):
        if b != a and out.weight[b] > 0.0:
            s = similarity_of(known, b, looks.seen, j)
            sums.other[0] += part
            sums.other[1] += part * s
            sums.other[2] += part * s * s
            if out.weight[a] > 0.0:
                s = similarity_of(known, b, known, a)
                sums.means[3] += part
                sums.means[4] += part * s
                sums.means[5] += part * s * s


@njit(**INNER)
def _teach_same(
    out: Followed, known: F4, looks: Looks, at: tuple[int, int], sums: Lessons, rules: Rules
) -> None:
    """Learn how similar a target is to what it looked like before, just now and some time ago; all
    of these count as one lesson.
    """
    a, j = at
    depth = len(rules.spans)
    parts = 1.0
    for k in range(depth):
        parts += np.isfinite(out.early_time[a, k])
    _forget(sums.same, rules.most)
    s = similarity_of(known, a, looks.seen, j)
    _learn(sums.same, s, looks.time - out.time[a], 1.0 / parts)
    early = directions(out.early[a], looks.mean)
    for k in range(depth):
        if np.isfinite(out.early_time[a, k]):
            s = similarity_of(early, k, looks.seen, j)
            _learn(sums.same, s, looks.time - out.early_time[a, k], 1.0 / parts)
            s = _since(out, a, k, looks)
            if np.isfinite(s) and out.time[a] - out.early_time[a, k] >= rules.spans[0]:
                sums.means[0] += 1.0 / parts
                sums.means[1] += s / parts
                sums.means[2] += s * s / parts


@njit(**INNER)
def _teach_beside(
    out: Followed, known: F4, looks: Looks, at: tuple[int, I8], beside: F8, most: float
) -> None:
    """Learn whether a target that is beside another one has changed looks with it, ``at`` =
    (a, sure): with the probability that this is the case by what is known so far [APP (7)].
    """
    a, sure = at
    j = sure[a, 1]
    law = looks.law
    other = looks.beside[j] if looks.beside.size > 0 else -1
    # Before anything is known: the law of `UNKNOWN`. A weight of 0 would not do, because what is no
    # longer trusted must be able to be trusted again.
    if other < 0 or law.same_deviation >= 1.0:
        return
    for b in range(len(sure)):
        if sure[b, 1] == other and out.weight[b] > 0.0:
            fits = similarity_gain(similarity_of(known, a, looks.seen, j), law)
            crossed = similarity_gain(similarity_of(known, b, looks.seen, j), law)
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
    out: Followed, looks: Looks, at: tuple[int, int], learns: Bool, single: F8, rules: Rules
) -> None:
    """Learn how similar single descriptors of one target are, of neighbouring frames and some time
    apart [APP (4)].
    """
    a, j = at
    kept = max(1.0 - 1.0 / rules.most, 0.0)
    apart = looks.time - out.single_time[a, 1]
    if not apart < rules.spans[1]:
        if apart < 2.0 * rules.spans[1]:
            single[3] = kept * single[3] + 1.0
            single[4] = kept * single[4] + _alike(out.single[a], 1, looks, j)
        out.single[a, 1] = looks.raw[j]
        out.single_time[a, 1] = looks.time
    apart = looks.time - out.single_time[a, 0]
    if apart < rules.spans[0] and learns[a]:
        s = _alike(out.single[a], 0, looks, j)
        single[0] = kept * single[0] + 1.0
        single[1] = kept * single[1] + apart
        single[2] = kept * single[2] + s
        single[5] = kept * single[5] + s * s
    out.single[a, 0] = looks.raw[j]
    out.single_time[a, 0] = looks.time


@njit(**INNER)
def _renew(out: Followed, looks: Looks, at: tuple[int, int], spans: tuple[float, ...]) -> None:
    """Take detection j into what target a looks like, and renew what it looked like before."""
    a, j = at
    old = 0.0
    if out.weight[a] > 0.0:
        for k in range(len(spans)):
            if not looks.time - out.early_time[a, k] < 2.0 * spans[k]:
                out.early[a, k] = out.mean[a]
                out.early_time[a, k] = out.time[a]
                out.early_weight[a, k] = out.weight[a]
        old = out.weight[a] * math.exp((out.time[a] - looks.time) / looks.memory)
    out.weight[a] = old + looks.free[j]
    out.time[a] = looks.time
    move_mean(out.mean, a, looks, j, looks.free[j] / out.weight[a])


@njit(**INNER)
def _since(followed: Followed, a: int, k: int, looks: Looks) -> float:
    """The similarity of the early mean k of target a to the mean of what it has looked like since;
    NaN if nothing new is known.
    """
    kept = followed.early_weight[a, k] * math.exp(
        (followed.early_time[a, k] - followed.time[a]) / looks.memory
    )
    new = followed.weight[a] - kept
    if not new > 0.5:
        return np.nan
    product = 0.0
    length = 0.0
    early_length = 0.0
    for d in range(followed.mean.shape[1]):
        early = followed.early[a, k, d]
        since = (followed.weight[a] * followed.mean[a, d] - kept * early) / new
        since -= looks.mean[d]
        early -= looks.mean[d]
        product += since * early
        length += since * since
        early_length += early * early
    scale = length * early_length
    return product / math.sqrt(scale) if scale > LEAST_LENGTH**4 else np.nan


@njit(**INNER)
def _alike(single: F4, k: int, looks: Looks, j: int) -> float:
    """The similarity of descriptor k of ``single`` (2, D) to that of detection j, both less the
    stream's mean.
    """
    product = 0.0
    length = 0.0
    for d in range(single.shape[1]):
        value = single[k, d] - looks.mean[d]
        product += value * looks.seen[j, d]
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
