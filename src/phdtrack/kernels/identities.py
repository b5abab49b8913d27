"""The looks of identities, and which two targets look as if they had exchanged theirs
(docs/methods.md, Appearance) [APP (5)], [APP (6)].
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from phdtrack.kernels import F4, F8, I8, Bool
from phdtrack.kernels.appearance import (
    MOST,
    Law,
    Looks,
    directions,
    free_parts,
    named,
    ratio_of_means,
)
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER

# Two labels as one number, the lower one first: for fewer labels than this.
LABELS = 1 << 31


class Seen(NamedTuple):
    """The knowledge of targets (K,), ascending by label.

    ``label``. ``identity``: of a target that is followed no more, 0 where it is not known.
    ``first``, ``last``: seconds of its first and last detection; ``began``, ``ended`` (K, 2): frame
    and row of these. ``xyxy`` (K, 4): its last box. ``detections``: how many it had. ``given``: it
    has the identity of another one. ``alive``: it is followed.

    ``mean`` (K, D), ``weight``, ``number``: of what its identity looks like, as of
    `kernels.appearance.Pasts`; ``lately`` (K, D), ``lately_weight``, ``lately_number``: of what the
    target has looked like just now; ``updated``: seconds of the last detection that both are of.
    """

    label: I8
    identity: I8
    first: F8
    last: F8
    began: I8
    ended: I8
    xyxy: F8
    detections: I8
    given: Bool
    alive: Bool
    mean: F4
    weight: F8
    number: F8
    lately: F4
    lately_weight: F8
    lately_number: F8
    updated: F8

    def select(self, index: I8 | Bool) -> Seen:
        """The rows at ``index``."""
        return Seen._make(column[index] for column in self)

    def followed_by(self, others: Seen) -> Seen:
        """The targets, and then others."""
        columns: list[tuple[Any, Any]] = list(zip(self, others, strict=True))
        return Seen._make(np.concatenate(both) for both in columns)


class Targets(NamedTuple):
    """The targets (n,) of a frame, ascending by label.

    ``label``; ``column``: its measurement; ``row``: the `Detections.row` of it; both −1 for none.
    ``confirmed``. ``xyxy`` (n, 4). ``mean`` (n, D), ``number``: of what its past looks like;
    ``number`` 0 where that is not known.
    """

    label: I8
    column: I8
    row: I8
    confirmed: Bool
    xyxy: F8
    mean: F4
    number: F8


class Rules(NamedTuple):
    """The rules of identities.

    ``memory``, ``lately``: seconds after which what an identity and a target look like count for
    37 %. ``larger``, ``doubt``: targets meet where boxes overlap that are larger by this part; for
    so many seconds it is possible that they have exchanged identities. ``exchanged``,
    ``exchanged_with_lost``: the log odds of that for pairs of which nothing is known, both
    followed, and one not. ``least``: independent descriptors of what a target has looked like just
    now that this needs. ``detections``, ``undecided``: detections of a new target from which on it
    is compared with lost ones, and seconds until which it is.
    """

    memory: float
    lately: float
    larger: float
    doubt: float
    exchanged: float
    exchanged_with_lost: float
    least: float
    detections: int
    undecided: float


def nobody(size: int) -> Seen:
    """No targets, of descriptors of length ``size``."""
    none = np.zeros(0)
    count = np.zeros(0, np.int64)
    pairs = np.zeros((0, 2), np.int64)
    looks = np.zeros((0, size), np.float32)
    false = np.zeros(0, np.bool_)
    boxes = np.zeros((0, 4))
    return Seen(
        *(count, count, none, none, pairs, pairs, boxes, count, false, false),
        *(looks, none, none, looks, none, none, none),
    )


@njit(**ENTRY)
def identities_after(
    seen: tuple[Any, ...],
    pairs: tuple[I8, F8],
    targets: tuple[Any, ...],
    frame: int,
    followed: I8,
    looks: Looks,
    rules: tuple[Any, ...],
) -> tuple[Any, ...]:
    """The knowledge of identities after a frame.

    Parameters
    ----------
    seen, pairs : `Seen` before, and the pairs that have met, with seconds, as of `met_after`.
    targets : `Targets` of the frame.
    frame : its number.
    followed : labels of all targets that are followed, ascending.
    looks, rules : of the frame, and `Rules`.

    Returns
    -------
    `Seen`; the pairs that have met, and seconds; those of them that probably have exchanged their
    identities, and the log odds of that [APP (6)]; left, top, right and bottom of the boxes of
    confirmed targets that were detected; how many of these are new, and how many may be lost ones;
    and how many are followed no more.
    """
    before = Seen(*seen)
    now = Targets(*targets)
    looks = named(looks)
    rules = Rules(*rules)
    fresh, out = _seen_after(before, now, frame, followed, looks, rules)
    met, when = met_after(
        pairs[0],
        pairs[1],
        out.label,
        (now.label, now.xyxy),
        looks.time,
        (rules.larger, rules.doubt),
    )
    odds = exchange_odds(out, met, looks, rules)
    likely = odds > 0.0
    extent = math.inf, math.inf, -math.inf, -math.inf
    undecided = 0
    gone = 0
    for p in range(out.label.size):
        gone += not out.alive[p]
        if out.last[p] != looks.time:
            continue
        box = out.xyxy[p]
        extent = (
            min(extent[0], box[0]),
            min(extent[1], box[1]),
            max(extent[2], box[2]),
            max(extent[3], box[3]),
        )
        young = looks.time - out.first[p] <= rules.undecided and not out.given[p]
        undecided += young and out.alive[p] and out.detections[p] >= rules.detections
    return tuple(out), met, when, met[likely], odds[likely], extent, (fresh, undecided, gone)


@njit(**INNER)
def _seen_after(
    before: Seen, now: Targets, frame: int, followed: I8, looks: Looks, rules: Rules
) -> tuple[int, Seen]:
    """How many targets are new, and `Seen` after a frame."""
    present = _present(now)
    label = now.label[present]
    fresh = _new(before.label, label)
    out = _with_room(before, label[fresh], looks.mean.size)
    place = np.searchsorted(out.label, label)
    for each in range(fresh.size):
        _begin(out, place[fresh[each]], now, present[fresh[each]], frame, looks.time)
    clear = free_parts(now.xyxy)
    for each in range(present.size):
        k = present[each]
        p = place[each]
        j = now.column[k]
        out.last[p] = looks.time
        out.ended[p, 0] = frame
        out.ended[p, 1] = now.row[k]
        out.xyxy[p] = now.xyxy[k]
        out.detections[p] += 1
        share = min(looks.free[j], clear[k])
        if share > 0.0 and looks.time > out.updated[p]:
            _look(out, p, looks, j, share, (rules.memory, rules.lately))
    for t in range(out.label.size):
        at = np.searchsorted(followed, out.label[t])
        out.alive[t] = at < followed.size and followed[at] == out.label[t]
    return fresh.size, out


@njit(**INNER)
def _present(now: Targets) -> I8:
    """The confirmed targets that have a detection and of which it is known what they look like."""
    out = np.empty(now.label.size, np.int64)
    n = 0
    for k in range(now.label.size):
        if now.row[k] >= 0 and now.confirmed[k] and now.number[k] > 0.0:
            out[n] = k
            n += 1
    return out[:n]


@njit(**INNER)
def _new(known: I8, label: I8) -> I8:
    """The places of labels, ascending, that are not among the ``known``."""
    place = np.searchsorted(known, label)
    out = np.empty(label.size, np.int64)
    n = 0
    for k in range(label.size):
        if place[k] == known.size or known[place[k]] != label[k]:
            out[n] = k
            n += 1
    return out[:n]


@njit(**INNER)
def _begin(out: Seen, p: int, now: Targets, k: int, frame: int, time: float) -> None:
    """Write what is known of target k, which is new, into row p."""
    out.first[p] = time
    out.began[p, 0] = frame
    out.began[p, 1] = now.row[k]
    out.mean[p] = now.mean[k]
    out.lately[p] = now.mean[k]
    out.weight[p] = now.number[k]
    out.lately_weight[p] = min(now.number[k], 1.0)
    out.number[p] = now.number[k]
    out.lately_number[p] = min(now.number[k], 1.0)
    out.updated[p] = time


@njit(**INNER)
def _with_room(before: Seen, label: I8, size: int) -> Seen:
    """A copy with rows for new labels, ascending; ``size`` is the length of descriptors. Columns
    that only change with new rows are the same if there are none.
    """
    if label.size == 0:
        return Seen(
            before.label,
            before.identity,
            before.first,
            before.last.copy(),
            before.began,
            before.ended.copy(),
            before.xyxy.copy(),
            before.detections.copy(),
            before.given,
            before.alive.copy(),
            before.mean.copy(),
            before.weight.copy(),
            before.number.copy(),
            before.lately.copy(),
            before.lately_weight.copy(),
            before.lately_number.copy(),
            before.updated.copy(),
        )
    count = before.label.size + label.size
    out = Seen(
        np.empty(count, np.int64),
        np.zeros(count, np.int64),
        np.zeros(count),
        np.zeros(count),
        np.zeros((count, 2), np.int64),
        np.zeros((count, 2), np.int64),
        np.zeros((count, 4)),
        np.zeros(count, np.int64),
        np.zeros(count, np.bool_),
        np.zeros(count, np.bool_),
        np.zeros((count, size), np.float32),
        np.zeros(count),
        np.zeros(count),
        np.zeros((count, size), np.float32),
        np.zeros(count),
        np.zeros(count),
        np.zeros(count),
    )
    old = 0
    new = 0
    for p in range(count):
        if new < label.size and (old == before.label.size or label[new] < before.label[old]):
            out.label[p] = label[new]
            new += 1
            continue
        out.label[p] = before.label[old]
        out.identity[p] = before.identity[old]
        out.first[p] = before.first[old]
        out.last[p] = before.last[old]
        out.began[p] = before.began[old]
        out.ended[p] = before.ended[old]
        out.xyxy[p] = before.xyxy[old]
        out.detections[p] = before.detections[old]
        out.given[p] = before.given[old]
        out.mean[p] = before.mean[old]
        out.weight[p] = before.weight[old]
        out.number[p] = before.number[old]
        out.lately[p] = before.lately[old]
        out.lately_weight[p] = before.lately_weight[old]
        out.lately_number[p] = before.lately_number[old]
        out.updated[p] = before.updated[old]
        old += 1
    return out


@njit(**INNER)
def _look(
    out: Seen, p: int, looks: Looks, j: int, share: float, memories: tuple[float, float]
) -> None:
    """Take detection j into what target p and its identity look like."""
    seconds = looks.time - out.updated[p]
    rho = math.exp(-seconds / looks.law.independent)
    new = share * (1.0 - rho) / (1.0 + rho)
    own, short = memories
    kept = math.exp(-seconds / own)
    out.weight[p] = out.weight[p] * kept + share
    out.number[p] = max(out.number[p] * kept + new, 1.0)
    part = np.float32(share / out.weight[p])
    kept = math.exp(-seconds / short)
    out.lately_weight[p] = out.lately_weight[p] * kept + share
    out.lately_number[p] = max(out.lately_number[p] * kept + new, 1.0)
    lately_part = np.float32(share / out.lately_weight[p])
    for d in range(looks.mean.size):
        out.mean[p, d] += part * (looks.raw[j, d] - out.mean[p, d])
        out.lately[p, d] += lately_part * (looks.raw[j, d] - out.lately[p, d])
    out.updated[p] = looks.time


@njit(**ENTRY)
def met_after(
    met: I8, when: F8, known: I8, targets: tuple[I8, F8], time: float, rules: tuple[float, float]
) -> tuple[I8, F8]:
    """The pairs of targets that have met, and seconds when they last did, after a frame.

    Parameters
    ----------
    met, when : (M,) pairs, ascending, a·`LABELS` + b of labels a < b, and seconds.
    known : labels of the targets that are remembered, ascending. Pairs of others are forgotten.
    targets : labels (n,), ascending, and boxes (n, 4) of all targets of the frame.
    time : seconds.
    rules : targets meet where boxes overlap that are larger by this part; pairs are remembered for
        as many seconds.
    """
    label, boxes = targets
    larger, kept = rules
    half = 0.5 * (1.0 + larger)
    remembered = np.empty(label.size, np.bool_)
    for a in range(label.size):
        p = np.searchsorted(known, label[a])
        remembered[a] = p < known.size and known[p] == label[a]
    near = _near(label[remembered], boxes[remembered], half)
    n = near.size
    out = np.empty(met.size + n, np.int64)
    seconds = np.empty(met.size + n)
    count = 0
    k = 0
    for m in range(met.size):
        while k < n and near[k] < met[m]:
            out[count] = near[k]
            seconds[count] = time
            count += 1
            k += 1
        if k < n and near[k] == met[m]:
            continue
        a, b = _places(known, met[m])
        if a >= 0 and b >= 0 and time - when[m] <= kept:
            out[count] = met[m]
            seconds[count] = when[m]
            count += 1
    while k < n:
        out[count] = near[k]
        seconds[count] = time
        count += 1
        k += 1
    return out[:count].copy(), seconds[:count].copy()


@njit(**INNER)
def _places(known: I8, pair: int) -> tuple[int, int]:
    """The rows of the labels of a pair among those ``known``, ascending; −1 for one that is not."""
    a = np.searchsorted(known, pair // LABELS)
    b = np.searchsorted(known, pair % LABELS)
    first = int(a) if a < known.size and known[a] == pair // LABELS else -1
    second = int(b) if b < known.size and known[b] == pair % LABELS else -1
    return first, second


@njit(**INNER)
def _near(label: I8, boxes: F8, half: float) -> I8:
    """The pairs of labels, ascending, whose boxes overlap if their sides are 2·``half`` times as
    long.
    """
    count = label.size
    x = 0.5 * (boxes[:, 0] + boxes[:, 2])
    y = 0.5 * (boxes[:, 1] + boxes[:, 3])
    width = half * (boxes[:, 2] - boxes[:, 0])
    height = half * (boxes[:, 3] - boxes[:, 1])
    left = x - width
    order = np.argsort(left)
    out = np.empty(4 * count + 16, np.int64)
    n = 0
    for i in range(count):
        a = order[i]
        right = x[a] + width[a]
        for k in range(i + 1, count):
            b = order[k]
            if left[b] >= right:
                break
            if abs(y[a] - y[b]) < height[a] + height[b]:
                if n == out.size:
                    more = np.empty(2 * n, np.int64)
                    more[:n] = out
                    out = more
                out[n] = min(label[a], label[b]) * LABELS + max(label[a], label[b])
                n += 1
    return np.sort(out[:n])


@njit(**ENTRY)
def exchange_odds(seen: tuple[Any, ...], met: I8, looks: Looks, rules: tuple[Any, ...]) -> F8:
    """(M,) the log odds that the targets of each pair have exchanged their identities [APP (6)]; −∞
    where that cannot be known, or they are below 0.

    Parameters
    ----------
    seen, met : `Seen`, and pairs of `met_after`.
    looks, rules : of the frame, and `Rules`.
    """
    known = Seen(*seen)
    looks = named(looks)
    rules = Rules(*rules)
    out = np.full(met.size, -np.inf)
    if met.size == 0 or not looks.law.means_weight > 0.0:
        return out
    directions_of = directions(known.mean, looks.mean), directions(known.lately, looks.mean)
    fits = np.empty(known.label.size)
    seen_now = np.empty(known.label.size, np.bool_)
    for a in range(known.label.size):
        fits[a] = _fit(known, directions_of, a, a, looks.law)
        seen_now[a] = _is_seen(known, a, looks.time, rules.least)
    for m in range(met.size):
        a, b = _places(known.label, met[m])
        if a < 0 or b < 0:
            continue
        if not (seen_now[a] or seen_now[b]):
            continue
        # One that is hidden just now says nothing; it may have the other's identity all the same.
        both = known.alive[a] and known.alive[b]
        earliest = looks.time - rules.doubt
        if not (known.alive[a] or known.last[a] >= earliest):
            continue
        if not (known.alive[b] or known.last[b] >= earliest):
            continue
        odds = rules.exchanged if both else rules.exchanged_with_lost
        odds -= looks.law.doubt + seen_now[a] * fits[a] + seen_now[b] * fits[b]
        # No ratio of likelihoods is larger than this.
        if odds + (seen_now[a] + seen_now[b]) * MOST <= 0.0:
            continue
        if seen_now[a]:
            odds += _fit(known, directions_of, a, b, looks.law)
        if seen_now[b]:
            odds += _fit(known, directions_of, b, a, looks.law)
        out[m] = odds
    return out


@njit(**INNER)
def _is_seen(known: Seen, a: int, time: float, least: float) -> bool:
    """True if target a is detected now and enough is known of how it looks."""
    return bool(known.alive[a] and known.last[a] == time and known.lately_number[a] >= least)


@njit(**INNER)
def _fit(known: Seen, directions_of: tuple[F4, F4], a: int, b: int, law: Law) -> float:
    """The log-likelihood ratio that target a, as it looks just now, has the identity of b."""
    own, lately = directions_of
    ratio: float = ratio_of_means(
        own, b, known.number[b], lately, a, known.lately_number[a], 0.0, law
    )
    return ratio
