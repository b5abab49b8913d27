"""Identities given back to targets that were deleted and come again, and to those that have
exchanged theirs, by odds.

A new target is compared with every one that the filter has deleted (`models.returns`) [APP (5)].
What was seen of it so far counts as one observation: its detections are not independent. All old
targets and a new one share the probability; where an old one has more than half of it, the new
target takes its identity.

Where two targets meet, the filter may take one for the other: while they hide each other, motion
alone decides. So those that have met are compared with what both identities looked like. Where it
is more probable than not that they have exchanged them, they do so again [APP (6)].
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from phdtrack.kernels import Records
from phdtrack.kernels.appearance import LARGER, Looks, likeness, plain
from phdtrack.kernels.identities import (
    LABELS,
    MET,
    Seen,
    identities_after,
    nobody,
    undecided_places,
)
from phdtrack.models.returns import (
    EXCHANGED,
    Rates,
    among,
    log_odds,
    mean_away,
    returning_share,
    twin_chance,
    twins_among,
)
from phdtrack.types import F8, I8, Bool, Estimates, Exchange, Return

# Detections of a new target from which on it is compared, and seconds until which it is.
LEAST_SEEN = 3
UNDECIDED = 3.0
# The probability from which on an identity is given back.
ENOUGH = 0.5
# Lost targets, and identities given back, that are remembered.
MOST_LOST = 2000
MOST_PAIRS = 10_000
# Seconds after which what an identity looks like counts for 37 %, and what a target looks like just
# now, which is of this many frames at least.
MEMORY = 10.0
LATELY = 0.7
LATELY_FRAMES = 3.0
# Seconds for which it is possible that two that have met, which are beside each other by `LARGER`,
# have exchanged identities.
DOUBT = 5.0
# The log odds that one of two that have met has the identity of the other, which has not been
# followed since.
EXCHANGED_WITH_LOST = -6.0
# Independent descriptors of how a target looks just now that this needs.
LEAST_LATELY = 1.5
# `Rules`, but for the first two.
RULES = (
    LARGER,
    DOUBT,
    EXCHANGED,
    EXCHANGED_WITH_LOST,
    LEAST_LATELY,
    LEAST_SEEN,
    UNDECIDED,
)


@dataclass(frozen=True, slots=True)
class Returns:
    """The looks of targets, and the identities that were given back.

    Attributes
    ----------
    seen : the targets with known looks that are followed, or were not long ago.
    lost : those that were followed before, and may come back.
    met : the pairs of targets in ``seen`` that have met, as of `kernels.identities.met_after`.
    pairs, exchanges : identities given back, the newest last; old ones are forgotten.
    extent : left, top, right and bottom of all boxes so far.
    begun, time : seconds of the first and of the last frame.
    confirmed : targets confirmed since the first.
    back : how many of these are lost ones that came back, as expected when each was first compared.
    away : for how many seconds these were away together.
    twins, chances : how many of those that were lost looked like another one that was there with
        them, as expected, and how many would if each looked like one of all that were seen.
    """

    seen: Seen = field(default_factory=lambda: nobody(0))
    lost: Seen = field(default_factory=lambda: nobody(0))
    met: Records = field(default_factory=lambda: np.zeros(0, MET))
    pairs: tuple[Return, ...] = ()
    exchanges: tuple[Exchange, ...] = ()
    extent: tuple[float, float, float, float] = (math.inf, math.inf, -math.inf, -math.inf)
    begun: float = math.nan
    time: float = math.nan
    confirmed: int = 0
    back: float = 0.0
    away: float = 0.0
    twins: float = 0.0
    chances: float = 0.0

    @property
    def twin_chance(self) -> float:
        """The probability that another target looks like a given one."""
        return twin_chance(self.twins, self.chances, self.confirmed)


class Names(NamedTuple):
    """The identities (n,) of labels (n,), ascending; 0 says nothing."""

    label: I8
    identity: I8


def reidentified(
    state: Returns,
    estimates: Estimates,
    rows: I8,
    frame: int,
    looks: Looks,
    confirmed: Bool,
    names: Names,
) -> tuple[Returns, dict[int, int]]:
    """The state after a frame, and the labels that have another identity from now on, 0: none.

    Parameters
    ----------
    estimates, rows, frame, looks, confirmed : as of `remembering`.
    names : the identities of all labels until now.
    """
    state, shown = remembering(state, estimates, rows, frame, looks, confirmed)
    if shown.gone or len(state.lost.rows):
        state = forgetting(named(with_twins(state, looks), names), looks.law.within)
    change = dict[int, int]()
    if not (shown.undecided or len(shown.likely)):
        return state, change
    swapped = exchanges(state, shown, frame, names)
    state = exchanged(state, swapped)
    found = compared(state, looks) if shown.undecided else None
    if found is None:
        pairs = []
    else:
        pairs = given_back(state, found)
        back, away = expected_back(state, found)
        state = replace(state, back=state.back + back, away=state.away + away)
    for each in swapped:
        change |= zip(each.labels, each.identities[::-1], strict=True)
    for pair in pairs:
        # Should the filter report it again, it is another one.
        change |= {pair.earlier: 0, pair.later: pair.identity}
    return taken(state, pairs), change


class Shown(NamedTuple):
    """Evidence of a frame on identities.

    ``likely`` (n,): the pairs of targets that probably have exchanged theirs, of
    `kernels.identities.LIKELY`. ``undecided``: how many targets may be lost ones. ``gone``: how
    many that are remembered are followed no more.
    """

    likely: Records
    undecided: int
    gone: int


def remembering(
    state: Returns,
    estimates: Estimates,
    rows: I8,
    frame: int,
    looks: Looks,
    confirmed: Bool,
) -> tuple[Returns, Shown]:
    """The state after a frame, and what that has shown.

    Parameters
    ----------
    estimates, rows, confirmed : the targets, the `Detections.row` of each, −1 for none, and which
        are confirmed.
    frame : its number.
    looks : of the frame.
    """
    time = looks.time
    size = looks.raw.shape[1]
    if state.seen.looks.shape[2] != size:
        none = nobody(size)
        state = replace(state, seen=none, lost=none, met=state.met[:0])
    begun = time if math.isnan(state.begun) else state.begun
    interval = 0.0 if math.isnan(state.time) else time - state.time
    rules = MEMORY, max(LATELY, LATELY_FRAMES * interval), *RULES
    seen, met, likely, extent, counts = identities_after(
        tuple(state.seen),
        state.met,
        _targets(estimates, rows, confirmed),
        frame,
        estimates.followed,
        plain(looks),
        rules,
        state.extent,
    )
    after = Returns(
        Seen(*seen),
        state.lost,
        met,
        state.pairs,
        state.exchanges,
        extent,
        begun,
        time,
        state.confirmed + counts[0],
        state.back,
        state.away,
        state.twins,
        state.chances,
    )
    return after, Shown(likely, *counts[1:])


def _targets(estimates: Estimates, rows: I8, confirmed: Bool) -> tuple[Any, ...]:
    """`Targets` of a frame, as a plain tuple."""
    return (
        estimates.tag,
        estimates.detection,
        rows,
        confirmed,
        np.ascontiguousarray(estimates.xyxy),
        estimates.appearance,
        estimates.appearance_count,
    )


def named(state: Returns, names: Names) -> Returns:
    """The state in which those that are followed no more have their identities, and those of them
    that were followed long ago are among the lost; lost ones that no other one can be are
    forgotten.
    """
    seen = state.seen
    gone = seen.rows["alive"] == 0
    if not gone.any() and not len(state.lost.rows):
        return state
    unnamed = gone & (seen.rows["identity"] == 0)
    if unnamed.any():
        rows = seen.rows.copy()
        rows["identity"][unnamed] = _identities(names, seen.label[unnamed])
        seen = Seen(rows, seen.looks)
    lost = state.lost
    old = _ended(state)
    if old.any():
        lost = lost.followed_by(seen.select(old & (seen.rows["identity"] > 0)))
        seen = seen.select(~old)
    return replace(state, seen=seen, lost=lost)


def forgetting(state: Returns, within: float) -> Returns:
    """The state without lost targets that were last seen more than ``within`` seconds ago, or that
    are not among the last `MOST_LOST`.
    """
    lost = state.lost
    if not len(lost.rows):
        return state
    last = lost.rows["last"]
    kept = last >= state.time - within
    if np.count_nonzero(kept) > MOST_LOST:
        newest = np.argsort(-np.where(kept, last, -np.inf), kind="stable")
        kept[newest[MOST_LOST:]] = False
    return state if kept.all() else replace(state, lost=lost.select(kept))


def _identities(names: Names, label: I8) -> I8:
    """(n,) the identities of labels (n,), 0 where they are not known."""
    if not len(names.label):
        return np.zeros(len(label), np.int64)
    place = names.label.searchsorted(label)
    there = names.label.take(place, mode="clip") == label
    return np.where(there, names.identity.take(place, mode="clip"), 0)


def exchanges(state: Returns, shown: Shown, frame: int, names: Names) -> list[Exchange]:
    """The identities that targets exchange [APP (6)].

    Parameters
    ----------
    shown : what the frame has shown.
    frame : its number.
    names : the identities of all labels.
    """
    if not len(shown.likely):
        return []
    rows = state.seen.rows
    pairs = shown.likely["pair"].tolist()
    odds = shown.likely["odds"]
    out = list[Exchange]()
    used = set[int]()
    for m in np.argsort(-odds, kind="stable").tolist():
        labels = np.array(divmod(pairs[m], LABELS))
        two = rows[rows["label"].searchsorted(labels)]
        identity = np.where(two["alive"] > 0, _identities(names, labels), two["identity"]).tolist()
        a, b = labels.tolist()
        if 0 in identity or a in used or b in used:
            continue
        used |= {a, b}
        out.append(Exchange((a, b), (identity[0], identity[1]), math.exp(odds[m]), frame))
    return out


def exchanged(state: Returns, found: list[Exchange]) -> Returns:
    """The state after these targets have exchanged their identities."""
    if not found:
        return state
    rows = state.seen.rows.copy()
    looks = state.seen.looks.copy()
    when = dict(zip(state.met["pair"].tolist(), state.met["when"].tolist(), strict=True))
    for each in found:
        place = rows["label"].searchsorted(np.array(each.labels))
        looks[place, 0] = looks[place[::-1], 0]
        for name in ("weight", "number"):
            rows[name][place] = rows[name][place[::-1]]
        for k in (0, 1):
            if not rows["alive"][place[k]]:
                # Its last detection before is not one of this target's.
                rows["identity"][place[k]] = each.identities[1 - k]
                rows["ended_frame"][place[k]] = each.frame
                rows["ended_row"][place[k]] = -1
        when |= _met_of_both(when, *each.labels)
    met = np.zeros(len(when), MET)
    met["pair"] = sorted(when)
    met["when"] = [when[pair] for pair in sorted(when)]
    return replace(
        state,
        seen=Seen(rows, looks),
        met=met,
        exchanges=(*state.exchanges, *found)[-MOST_PAIRS:],
    )


def _met_of_both(when: dict[int, float], a: int, b: int) -> dict[int, float]:
    """When those that have met one of two targets have met both: either may be the other one."""
    more = dict[int, float]()
    for pair, time in when.items():
        one, two = divmod(pair, LABELS)
        if (one in (a, b)) == (two in (a, b)):
            continue
        third = two if one in (a, b) else one
        for label in (a, b):
            key = min(label, third) * LABELS + max(label, third)
            more[key] = max(time, when.get(key, -math.inf), more.get(key, -math.inf))
    return more


class Compared(NamedTuple):
    """New targets ``new`` (n,), by their places in `Returns.seen`, and the ``odds`` (n, m) of each
    to be one of those ``lost``.
    """

    new: I8
    lost: Seen
    odds: F8


def compared(state: Returns, looks: Looks) -> Compared | None:
    """The new targets of a frame, compared with all lost ones; None without any."""
    seen = state.seen
    rows = seen.rows
    new = undecided_places(rows, state.time, LEAST_SEEN, UNDECIDED)
    if not len(new) or looks.law.means_weight <= 0:
        return None
    lost = state.lost.followed_by(seen.select((rows["alive"] == 0) & (rows["identity"] > 0)))
    if not len(lost.rows):
        return None
    return Compared(new, lost, _odds(state, new, lost, looks))


def expected_back(state: Returns, found: Compared) -> tuple[float, float]:
    """How many of the targets that are compared for the first time are lost ones, as expected, and
    for how many seconds these were away together.
    """
    new = state.seen.rows[found.new]
    first = new["detections"] == LEAST_SEEN
    odds = found.odds[first]
    share = odds / (1 + odds.sum(axis=1, keepdims=True))
    gap = new["first"][first][:, None] - found.lost.rows["last"]
    return float(share.sum()), float((share * np.maximum(gap, 0.0)).sum())


def with_twins(state: Returns, looks: Looks) -> Returns:
    """The state after the targets that are among the lost from now on were compared with those that
    were there with them, and so are others.
    """
    seen = state.seen
    ended = _ended(state)
    if looks.law.means_weight <= 0 or not ended.any():
        return state
    rows = seen.rows
    there = (rows["alive"] > 0) & (rows["first"] < rows["last"][:, None])
    a, b = np.nonzero(ended[:, None] & there)
    ratio = _likeness(seen, a, b, looks)
    return replace(
        state,
        twins=state.twins + twins_among(ratio, state.twin_chance),
        chances=state.chances + len(a) / max(state.confirmed, 1),
    )


def _ended(state: Returns) -> Bool:
    """(K,) which of the targets are followed no more, and have not been for long."""
    rows = state.seen.rows
    ended: Bool = (rows["alive"] == 0) & (rows["last"] < state.time - DOUBT)
    return ended


def _likeness(seen: Seen, before: I8, after: I8, looks: Looks) -> F8:
    """(P,) `kernels.appearance.likeness` of the identities of targets ``before`` and ``after``."""
    mean = np.ascontiguousarray(seen.looks[:, 0])
    number = np.ascontiguousarray(seen.rows["number"])
    ratio: F8 = likeness(mean, number, np.zeros(len(number)), before, after, plain(looks))
    return ratio


def given_back(state: Returns, found: Compared) -> list[Return]:
    """The identities that the targets that were compared take again [APP (5)]."""
    seen = state.seen
    new, lost, odds = found.new, found.lost, found.odds.copy()
    total = 1.0 + odds.sum(axis=1)
    out = list[Return]()
    while True:
        a, b = np.unravel_index(int(odds.argmax()), odds.shape)
        share = odds[a, b] / total[a]
        if not share > ENOUGH:
            return out
        before = lost.rows[b]
        after = seen.rows[new[a]]
        out.append(
            Return(
                int(before["label"]),
                int(after["label"]),
                int(before["identity"]),
                float(share / (1 - share)),
                state.time,
                (int(before["ended_frame"]), int(before["ended_row"])),
                (int(after["began_frame"]), int(after["began_row"])),
            )
        )
        odds[a] = 0.0
        odds[:, b] = 0.0


def _odds(state: Returns, new: I8, lost: Seen, looks: Looks) -> F8:
    """(n, m) the odds of targets ``new`` to be those ``lost``, against new ones."""
    fresh = state.seen.select(new)
    gap = fresh.rows["first"][:, None] - lost.rows["last"][None]
    a, b = np.indices(gap.shape).reshape(2, -1)
    ratio = _likeness(lost.followed_by(fresh), b, len(lost.rows) + a, looks)
    ratio = among(ratio, state.twin_chance)
    # Old pairs and lost targets are forgotten, but have ended all the same.
    ended = max(
        len(state.pairs) + len(lost.rows),
        state.confirmed - int(np.count_nonzero(state.seen.rows["alive"])),
    )
    # Those that came back are not new.
    rates = Rates(
        max(state.confirmed - state.back, 1.0) / max(state.time - state.begun, 1.0),
        returning_share(state.back, ended),
        mean_away(state.away, state.back),
    )
    boxes = _boxes(lost)[b], _boxes(fresh)[a]
    prior = log_odds(gap.ravel(), *boxes, rates, _area(state))
    odds: F8 = np.exp(prior + ratio).reshape(gap.shape)
    odds[gap > looks.law.within] = 0.0
    return odds


def _boxes(seen: Seen) -> F8:
    """(K, 4) the last box of each target."""
    rows = seen.rows
    return np.stack([rows["left"], rows["top"], rows["right"], rows["bottom"]], axis=1)


def _area(state: Returns) -> float:
    """Pixels² in which targets were."""
    left, top, right, bottom = state.extent
    return max((right - left) * (bottom - top), 1.0)


def taken(state: Returns, pairs: list[Return]) -> Returns:
    """The state after these identities were given back."""
    if not pairs:
        return state
    rows = state.seen.rows.copy()
    looks = state.seen.looks.copy()
    for pair in pairs:
        p = int(rows["label"].searchsorted(pair.later))
        rows["given"][p] = 1
        source = state.seen if pair.earlier in rows["label"] else state.lost
        k = int(np.flatnonzero(source.label == pair.earlier)[0])
        looks[p, 0] = source.looks[k, 0]
        for name in ("weight", "number"):
            rows[name][p] = source.rows[name][k]
    earlier = np.array([pair.earlier for pair in pairs])
    seen = Seen(rows, looks)
    return replace(
        state,
        seen=seen.select(~np.isin(seen.label, earlier)),
        lost=state.lost.select(~np.isin(state.lost.label, earlier)),
        pairs=(*state.pairs, *pairs)[-MOST_PAIRS:],
    )
