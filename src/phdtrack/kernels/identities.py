"""The looks of identities, and which two targets look as if they had exchanged theirs
(docs/methods.md, Appearance) [APP (5)], [APP (6)].
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from phdtrack.kernels import F4, F8, I8, Bool, Records
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
from phdtrack.kernels.gaussian import records
from phdtrack.kernels.small_arrays import copy_into, first_not_below

# Two labels as one number, the lower one first: for fewer labels than this.
LABELS = 1 << 31
# A target. ``identity``: of one that is followed no more, 0 where it is not known. ``first``,
# ``last``: seconds of its first and last detection; ``began_frame``, ``began_row``,
# ``ended_frame``, ``ended_row``: frame and row of these. ``left`` to ``bottom``: its last box.
# ``detections``: how many it had. ``given``: 1 if it has the identity of another one. ``alive``: 1
# if it is followed. ``weight``, ``number``: of what its identity looks like, as of
# `kernels.appearance.Pasts`; ``lately_weight``, ``lately_number``: of what the target has looked
# like just now; ``updated``: seconds of the last detection that both are of.
SEEN = records(
    "first last left top right bottom weight number lately_weight lately_number updated",
    "label identity began_frame began_row ended_frame ended_row detections given alive",
)
# Two targets that have met: both labels as one number, a·`LABELS` + b with a < b; and seconds when
# they last did.
MET = records("when", "pair")
# Two that probably have exchanged their identities, and the log odds of that.
LIKELY = records("odds", "pair")


class Seen(NamedTuple):
    """The knowledge of targets (K,), ascending by label.

    ``rows`` (K,) of `SEEN`; one array costs a call of a kernel less than many. ``looks`` (K, 2, D):
    the mean of the descriptors of its identity, and of those that the target has had just now.
    """

    rows: Records
    looks: F4

    @property
    def label(self) -> I8:
        """(K,) the labels."""
        label: I8 = self.rows["label"]
        return label

    def select(self, index: I8 | Bool) -> Seen:
        """The targets at ``index``."""
        return Seen(self.rows[index], self.looks[index])

    def followed_by(self, others: Seen) -> Seen:
        """The targets, and then others."""
        return Seen(
            np.concatenate((self.rows, others.rows)), np.concatenate((self.looks, others.looks))
        )


class Targets(NamedTuple):
    """The targets (n,) of a frame.

    ``label``; ``column``: its measurement; ``row``: the `Detections.row` of it; both −1 for none.
    ``confirmed``. ``xyxy`` (n, 4). ``mean`` (n, D), ``number``: of what its past looks like;
    ``number`` 0 where that is not known, (0, 0) and (0,) where nothing is.
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
    return Seen(np.zeros(0, SEEN), np.zeros((0, 2, size), np.float32))


@njit(**ENTRY)
def identities_after(
    seen: Seen,
    met: Records,
    targets: Targets,
    frame: int,
    followed: I8,
    looks: Looks,
    rules: Rules,
    extent: tuple[float, float, float, float],
) -> tuple[
    tuple[Records, F4], Records, Records, tuple[float, float, float, float], tuple[int, int, int]
]:
    """The knowledge of identities after a frame. Records as plain tuples, see
    `kernels.appearance.plain`.

    Parameters
    ----------
    seen, met : `Seen` before, and the pairs that have met, as of `met_after`.
    targets : `Targets` of the frame.
    frame : its number.
    followed : labels of all targets that are followed, ascending.
    looks, rules : of the frame, and `Rules`.
    extent : left, top, right and bottom of the boxes before of confirmed targets that were
        detected.

    Returns
    -------
    `Seen`; the pairs that have met; those of them that probably have exchanged their identities
    [APP (6)], of `LIKELY`; the ``extent`` with the frame's boxes; how many of these targets are
    new, and how many may be lost ones; and how many are followed no more.
    """
    before = Seen(*seen)
    now = Targets(*targets)
    looks = named(looks)
    rules = Rules(*rules)
    fresh, rows, known = _seen_after(before, now, frame, followed, looks, rules)
    met = met_after(met, rows, (now.label, now.xyxy), looks.time, (rules.larger, rules.doubt))
    likely = _likely(met, _exchange_odds(rows, known, met, looks, rules))
    undecided = undecided_places(rows, looks.time, rules.detections, rules.undecided).size
    gone = 0
    for p in range(rows.size):
        row = rows[p]
        gone += 1 - row.alive
        if row.last == looks.time:
            extent = (
                min(extent[0], row.left),
                min(extent[1], row.top),
                max(extent[2], row.right),
                max(extent[3], row.bottom),
            )
    return (rows, known), met, likely, extent, (fresh, undecided, gone)


@njit(**INNER)
def _likely(met: Records, odds: F8) -> Records:
    """The pairs that have met whose odds (M,) are above 1."""
    out = np.empty(met.size, LIKELY)
    n = 0
    for m in range(met.size):
        if odds[m] > 0.0:
            out[n].pair = met[m].pair
            out[n].odds = odds[m]
            n += 1
    return out[:n].copy()


@njit(**INNER)
def _seen_after(
    before: Seen, now: Targets, frame: int, followed: I8, looks: Looks, rules: Rules
) -> tuple[int, Records, F4]:
    """How many targets are new, and `Seen` after a frame."""
    present = _present(now)
    label = now.label
    fresh = _new(before.rows, label, present)
    rows, known = _with_room(before, label, fresh, looks.mean.size)
    _begin(rows, known, now, fresh, frame, looks.time)
    free = looks.free
    raw = looks.raw
    boxes = now.xyxy
    column = now.column
    row = now.row
    clear = free_parts(boxes)
    for k in present:
        p = place_of(rows, label[k])
        target = rows[p]
        target.last = looks.time
        target.ended_frame = frame
        target.ended_row = row[k]
        target.left = boxes[k, 0]
        target.top = boxes[k, 1]
        target.right = boxes[k, 2]
        target.bottom = boxes[k, 3]
        target.detections += 1
        share = min(free[column[k]], clear[k])
        if share > 0.0 and looks.time > target.updated:
            seconds = looks.time - target.updated
            parts = _look(target, seconds, share, looks.law.independent, rules)
            _move_means(known, p, raw, column[k], parts)
            target.updated = looks.time
    for p in range(rows.size):
        at = first_not_below(followed, rows[p].label)
        rows[p].alive = at < followed.size and followed[at] == rows[p].label
    return fresh.size, rows, known


@njit(**INNER)
def _present(now: Targets) -> I8:
    """The confirmed targets that have a detection and of which it is known what they look like."""
    out = np.empty(now.label.size, np.int64)
    n = 0
    for k in range(now.number.size):
        if now.row[k] >= 0 and now.confirmed[k] and now.number[k] > 0.0:
            out[n] = k
            n += 1
    return out[:n]


@njit(**INNER)
def place_of(rows: Records, label: int) -> int:
    """The first place in rows, ascending by label, whose label is not below this one, or their
    number.
    """
    place: int = first_not_below(rows["label"], label)
    return place


@njit(**INNER)
def _has(rows: Records, label: int) -> bool:
    """True if one of the rows, ascending by label, has this one."""
    p = place_of(rows, label)
    return bool(p < rows.size and rows[p].label == label)


@njit(**INNER)
def _new(rows: Records, label: I8, present: I8) -> I8:
    """The targets of those ``present`` that have no row, ascending by label; ``label`` (n,): of all
    targets.
    """
    out = np.empty(present.size, np.int64)
    n = 0
    for k in present:
        if not _has(rows, label[k]):
            at = n
            while at > 0 and label[out[at - 1]] > label[k]:
                out[at] = out[at - 1]
                at -= 1
            out[at] = k
            n += 1
    return out[:n]


@njit(**INNER)
def _begin(rows: Records, known: F4, now: Targets, fresh: I8, frame: int, time: float) -> None:
    """Write what is known of the targets ``fresh``, which are new."""
    label = now.label
    row = now.row
    mean = now.mean
    number = now.number
    for k in fresh:
        p = place_of(rows, label[k])
        target = rows[p]
        target.first = time
        target.began_frame = frame
        target.began_row = row[k]
        target.weight = target.number = number[k]
        target.lately_weight = target.lately_number = min(number[k], 1.0)
        target.updated = time
        for d in range(mean.shape[1]):
            known[p, 0, d] = mean[k, d]
            known[p, 1, d] = mean[k, d]


@njit(**INNER)
def _with_room(before: Seen, label: I8, fresh: I8, size: int) -> tuple[Records, F4]:
    """A copy of rows and looks with rows for the targets ``fresh``, new ones, by ``label`` (n,);
    ``size`` is the length of descriptors.
    """
    rows = before.rows
    known = before.looks
    if fresh.size == 0:
        return rows.copy(), known.copy()
    count = rows.size + fresh.size
    out = np.zeros(count, SEEN)
    looks = np.empty((count, 2, size), np.float32)
    old = 0
    new = 0
    for p in range(count):
        if new < fresh.size and (old == rows.size or label[fresh[new]] < rows[old].label):
            out[p].label = label[fresh[new]]
            new += 1
            continue
        out[p] = rows[old]
        for d in range(size):
            looks[p, 0, d] = known[old, 0, d]
            looks[p, 1, d] = known[old, 1, d]
        old += 1
    return out, looks


@njit(**INNER)
def _look(
    target: Any, seconds: float, share: float, independent: float, rules: Rules
) -> tuple[float, float]:
    """Count a detection, ``seconds`` after the last one, for what a target and its identity look
    like: which part of the means of the identity and of the target it is.
    """
    rho = math.exp(-seconds / independent)
    new = share * (1.0 - rho) / (1.0 + rho)
    kept = math.exp(-seconds / rules.memory)
    target.weight = target.weight * kept + share
    target.number = max(target.number * kept + new, 1.0)
    kept = math.exp(-seconds / rules.lately)
    target.lately_weight = target.lately_weight * kept + share
    target.lately_number = max(target.lately_number * kept + new, 1.0)
    return share / target.weight, share / target.lately_weight


@njit(**INNER)
def _move_means(known: F4, p: int, raw: F4, j: int, parts: tuple[float, float]) -> None:
    """Take row j of ``raw`` (N, D) into both means of target p of ``known`` (K, 2, D), as these
    ``parts`` of them.
    """
    own = np.float32(parts[0])
    lately = np.float32(parts[1])
    for d in range(raw.shape[1]):
        known[p, 0, d] += own * (raw[j, d] - known[p, 0, d])
        known[p, 1, d] += lately * (raw[j, d] - known[p, 1, d])


@njit(**ENTRY)
def met_after(
    met: Records,
    rows: Records,
    targets: tuple[I8, F8],
    time: float,
    rules: tuple[float, float],
) -> Records:
    """The pairs of targets that have met, after a frame, of `MET` and ascending.

    Parameters
    ----------
    met : those before.
    rows : (K,) the targets that are remembered, of `SEEN`. Pairs of others are forgotten.
    targets : labels (n,) and boxes (n, 4) of all targets of the frame.
    time : seconds.
    rules : targets meet where boxes overlap that are larger by this part; pairs are remembered for
        as many seconds.
    """
    label, boxes = targets
    larger, kept = rules
    half = 0.5 * (1.0 + larger)
    remembered = np.empty(label.size, np.bool_)
    for a in range(label.size):
        remembered[a] = _has(rows, label[a])
    near = _near(label[remembered], boxes[remembered], half)
    out = np.empty(met.size + near.size, MET)
    count = 0
    k = 0
    for m in range(met.size + 1):
        # Those near come in between, with the seconds of now.
        while k < near.size and (m == met.size or near[k] <= met[m].pair):
            out[count].pair = near[k]
            out[count].when = time
            count += 1
            k += 1
        if m == met.size or (k > 0 and near[k - 1] == met[m].pair):
            continue
        a, b = _places(rows, met[m].pair)
        if a >= 0 and b >= 0 and time - met[m].when <= kept:
            out[count] = met[m]
            count += 1
    return out[:count].copy()


@njit(**INNER)
def _places(rows: Records, pair: int) -> tuple[int, int]:
    """The rows of the labels of a pair, −1 for one that has none."""
    first = pair // LABELS
    second = pair % LABELS
    a = place_of(rows, first) if _has(rows, first) else -1
    b = place_of(rows, second) if _has(rows, second) else -1
    return a, b


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
                    copy_into(out, more)
                    out = more
                out[n] = min(label[a], label[b]) * LABELS + max(label[a], label[b])
                n += 1
    return np.sort(out[:n])


@njit(**ENTRY)
def exchange_odds(seen: Seen, met: Records, looks: Looks, rules: Rules) -> F8:
    """(M,) the log odds that the targets of each pair have exchanged their identities [APP (6)]; −∞
    where that cannot be known, or they are below 0. Records as plain tuples.

    Parameters
    ----------
    seen, met : `Seen`, and pairs of `met_after`.
    looks, rules : of the frame, and `Rules`.
    """
    rows, known = seen
    odds: F8 = _exchange_odds(rows, known, met, named(looks), Rules(*rules))
    return odds


@njit(**INNER)
def _exchange_odds(rows: Records, known: F4, met: Records, looks: Looks, rules: Rules) -> F8:
    """`exchange_odds` of the rows and looks of `Seen`."""
    out = np.full(met.size, -np.inf)
    law = looks.law
    if met.size == 0 or not law.means_weight > 0.0:
        return out
    # Two for each target: of its identity, and of itself just now.
    both = directions(known.reshape(2 * rows.size, looks.mean.size), looks.mean)
    fits = np.empty(rows.size)
    seen_now = np.empty(rows.size, np.bool_)
    for a in range(rows.size):
        fits[a] = _fit(rows, both, a, a, law)
        seen_now[a] = _is_seen(rows[a], looks.time, rules.least)
    for m in range(met.size):
        a, b = _places(rows, met[m].pair)
        if a < 0 or b < 0:
            continue
        if not (seen_now[a] or seen_now[b]):
            continue
        # One that is hidden just now says nothing; it may have the other's identity all the same.
        earliest = looks.time - rules.doubt
        if rows[a].alive == 0 and rows[a].last < earliest:
            continue
        if rows[b].alive == 0 and rows[b].last < earliest:
            continue
        followed = rows[a].alive > 0 and rows[b].alive > 0
        odds = rules.exchanged if followed else rules.exchanged_with_lost
        odds -= law.doubt + seen_now[a] * fits[a] + seen_now[b] * fits[b]
        # No ratio of likelihoods is larger than this.
        if odds + (seen_now[a] + seen_now[b]) * MOST <= 0.0:
            continue
        if seen_now[a]:
            odds += _fit(rows, both, a, b, law)
        if seen_now[b]:
            odds += _fit(rows, both, b, a, law)
        out[m] = odds
    return out


@njit(**INNER)
def _is_seen(target: Any, time: float, least: float) -> bool:
    """True if a target is detected now and enough is known of how it looks."""
    return bool(target.alive > 0 and target.last == time and target.lately_number >= least)


@njit(**ENTRY)
def undecided_places(rows: Records, time: float, least: int, young: float) -> I8:
    """The places of targets detected now that are new, so that each may be a lost one.

    ``rows`` (K,) of `SEEN`; ``time``: seconds. ``least``, ``young``: detections from which on a
    target is compared with those lost, and seconds until which it is.
    """
    out = np.empty(rows.size, np.int64)
    n = 0
    for p in range(rows.size):
        row = rows[p]
        follows = row.alive > 0 and row.given == 0 and row.last == time
        if follows and row.detections >= least and time - row.first <= young:
            out[n] = p
            n += 1
    return out[:n]


@njit(**INNER)
def _fit(rows: Records, both: F4, a: int, b: int, law: Law) -> float:
    """The log-likelihood ratio that target a, as it looks just now, has the identity of b."""
    ratio: float = ratio_of_means(
        both, 2 * b, rows[b].number, both, 2 * a + 1, rows[a].lately_number, 0.0, law
    )
    return ratio
