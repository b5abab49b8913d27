"""Identities given back to targets that were deleted and come again, by odds (`models.returns`).

A new target is compared with every one that the filter has deleted. What was seen of it so far
counts as one observation: its detections are not independent. All old targets and a new one share
the probability; where an old one has more than half of it, the new target takes its identity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from phdtrack.kernels.appearance import Looks, likeness, plain
from phdtrack.models.returns import log_odds
from phdtrack.types import F4, F8, I8, Bool, Estimates, Return

# Detections of a new target from which on it is compared, and seconds until which it is.
LEAST_SEEN = 3
UNDECIDED = 3.0
# The probability from which on an identity is given back.
ENOUGH = 0.5
# Lost targets, and identities given back, that are remembered.
MOST_LOST = 2000
MOST_PAIRS = 10_000


class Seen(NamedTuple):
    """The knowledge of targets (K,), ascending by label.

    ``label``, ``identity``: 0 before its first row. ``first``, ``last``: seconds of its first and
    last detection; ``began``, ``ended`` (K, 2): frame and row of these. ``xyxy`` (K, 4): its last
    box. ``mean`` (K, D), ``number``: of `kernels.appearance.Pasts`. ``detections``: how many it
    had. ``taken``: another one has its identity now; ``given``: it has that of another one.
    """

    label: I8
    identity: I8
    first: F8
    last: F8
    began: I8
    ended: I8
    xyxy: F8
    mean: F4
    number: F8
    detections: I8
    taken: Bool
    given: Bool

    def select(self, index: I8 | Bool) -> Seen:
        """The rows at ``index``."""
        return Seen._make(column[index] for column in self)


def nobody(size: int) -> Seen:
    """No targets, of descriptors of length ``size``."""
    none = np.zeros(0)
    count = np.zeros(0, np.int64)
    return Seen(
        count,
        count,
        none,
        none,
        np.zeros((0, 2), np.int64),
        np.zeros((0, 2), np.int64),
        np.zeros((0, 4)),
        np.zeros((0, size), np.float32),
        none,
        count,
        count > 0,
        count > 0,
    )


@dataclass(frozen=True, slots=True)
class Returns:
    """The targets that may come back, and those that did.

    Attributes
    ----------
    seen : the targets with known looks.
    pairs : identities given back, the newest last; old ones are forgotten.
    extent : left, top, right and bottom of all boxes so far.
    begun, confirmed : seconds of the first frame, and targets confirmed since.
    """

    seen: Seen = field(default_factory=lambda: nobody(0))
    pairs: tuple[Return, ...] = ()
    extent: tuple[float, float, float, float] = (math.inf, math.inf, -math.inf, -math.inf)
    begun: float = math.nan
    confirmed: int = 0


def remembering(
    state: Returns,
    estimates: Estimates,
    rows: I8,
    when: tuple[int, float],
    looks: Looks,
    confirmed: Bool,
) -> tuple[Returns, list[Return]]:
    """The state after a frame, and the identities that it gives back.

    Parameters
    ----------
    estimates, rows, confirmed : the targets, the `Detections.row` of each, −1 for none, and which
        are confirmed.
    when : number of the frame, and seconds.
    looks : of the frame.
    """
    number, time = when
    begun = time if math.isnan(state.begun) else state.begun
    seen = state.seen
    size = looks.raw.shape[1]
    if seen.mean.shape[1] != size:
        seen = nobody(size)
    now = np.zeros(0, np.int64)
    if len(estimates.appearance_count):
        now = np.flatnonzero((rows >= 0) & confirmed & (estimates.appearance_count > 0))
    if not len(now):
        seen = _still_of_use(seen, estimates.followed, time - looks.law.within)
        return replace(state, begun=begun, seen=seen), []
    box = estimates.xyxy[now]
    low = np.minimum(state.extent[:2], box[:, :2].min(axis=0))
    high = np.maximum(state.extent[2:], box[:, 2:].max(axis=0))
    tag = estimates.tag[now]
    place = seen.label.searchsorted(tag)
    known = place < len(seen.label)
    known[known] = seen.label[place[known]] == tag[known]
    fresh = Seen(
        tag,
        np.zeros(len(now), np.int64),
        np.full(len(now), time),
        np.full(len(now), time),
        np.stack([np.full(len(now), number), rows[now]], axis=1),
        np.stack([np.full(len(now), number), rows[now]], axis=1),
        box,
        estimates.appearance[now],
        estimates.appearance_count[now],
        np.ones(len(now), np.int64),
        np.zeros(len(now), np.bool_),
        np.zeros(len(now), np.bool_),
    )
    new = np.flatnonzero(~known)
    old = place[known]
    here = np.flatnonzero(known)
    columns = [column.copy() for column in seen]
    seen = Seen._make(columns)
    seen.last[old] = time
    seen.ended[old] = fresh.ended[here]
    seen.xyxy[old] = box[here]
    seen.mean[old] = fresh.mean[here]
    seen.number[old] = fresh.number[here]
    seen.detections[old] += 1
    if len(new):
        both = zip(seen, fresh.select(new), strict=True)
        seen = Seen._make(np.concatenate([old, more]) for old, more in both)
        seen = seen.select(np.argsort(seen.label, kind="stable"))
    after = Returns(
        _still_of_use(seen, estimates.followed, time - looks.law.within),
        state.pairs,
        (*low.tolist(), *high.tolist()),
        begun,
        state.confirmed + len(new),
    )
    pairs = _given_back(after, estimates, looks, time)
    return after, pairs


def _still_of_use(seen: Seen, followed: I8, since: float) -> Seen:
    """Without lost targets that no other one can be: those whose identity was given back, that were
    last seen before ``since`` seconds, or that are not among the last `MOST_LOST`.
    """
    lost = ~np.isin(seen.label, followed)
    gone = lost & (seen.taken | (seen.last < since))
    rest = np.flatnonzero(lost & ~gone)
    gone[rest[np.argsort(-seen.last[rest], kind="stable")[MOST_LOST:]]] = True
    return seen.select(~gone) if gone.any() else seen


def _given_back(state: Returns, estimates: Estimates, looks: Looks, time: float) -> list[Return]:
    """The identities that the targets of a frame take again."""
    seen = state.seen
    alive = np.isin(seen.label, estimates.followed)
    new = np.flatnonzero(
        alive
        & ~seen.given
        & (seen.last == time)
        & (seen.detections >= LEAST_SEEN)
        & (time - seen.first <= UNDECIDED)
    )
    lost = np.flatnonzero(~alive & ~seen.taken & (seen.identity > 0))
    if not len(new) or not len(lost) or looks.law.means_weight <= 0:
        return []
    odds = _odds(state, new, lost, looks)
    total = 1.0 + odds.sum(axis=1)
    out = list[Return]()
    while True:
        a, b = np.unravel_index(int(odds.argmax()), odds.shape)
        share = odds[a, b] / total[a]
        if not share > ENOUGH:
            return out
        i = int(new[a])
        k = int(lost[b])
        out.append(
            Return(
                int(seen.label[k]),
                int(seen.label[i]),
                int(seen.identity[k]),
                float(share / (1 - share)),
                time,
                tuple(seen.ended[k].tolist()),
                tuple(seen.began[i].tolist()),
            )
        )
        odds[a] = 0.0
        odds[:, b] = 0.0


def _odds(state: Returns, new: I8, lost: I8, looks: Looks) -> F8:
    """(n, m) the odds of targets ``new`` to be those ``lost``, against new ones."""
    seen = state.seen
    gap = seen.first[new][:, None] - seen.last[lost][None]
    a, b = np.indices(gap.shape).reshape(2, -1)
    ratio = likeness(seen.mean, seen.number, lost[b], new[a], plain(looks))
    left, top, right, bottom = state.extent
    area = max((right - left) * (bottom - top), 1.0)
    births = max(state.confirmed, 1) / max(seen.last.max() - state.begun, 1.0)
    prior = log_odds(gap.ravel(), seen.xyxy[lost][b], seen.xyxy[new][a], births, area)
    odds: F8 = np.exp(prior + ratio).reshape(gap.shape)
    odds[gap > looks.law.within] = 0.0
    return odds


def taken(state: Returns, pairs: list[Return]) -> Returns:
    """The state after these identities were given back."""
    if not pairs:
        return state
    seen = state.seen
    gone = np.isin(seen.label, [pair.earlier for pair in pairs])
    back = np.isin(seen.label, [pair.later for pair in pairs])
    kept = seen._replace(taken=seen.taken | gone, given=seen.given | back)
    return replace(state, seen=kept, pairs=(*state.pairs, *pairs)[-MOST_PAIRS:])


def named(state: Returns, label: I8, identity: I8) -> Returns:
    """The state with known identities.

    Parameters
    ----------
    label, identity : (n,) labels, ascending, and their identities; 0 says nothing.
    """
    seen = state.seen
    place = label.searchsorted(seen.label)
    there = label.take(place, mode="clip") == seen.label if len(label) else np.zeros(0, np.bool_)
    found = np.zeros(len(seen.label), np.int64)
    if len(label):
        found = np.where(there, identity.take(place, mode="clip"), 0)
    return replace(state, seen=seen._replace(identity=np.where(found > 0, found, seen.identity)))
