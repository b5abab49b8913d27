"""Groups over time: identities, and the events of their lives.

Clusters flicker: two people at two metres are one group in one frame and two in the next. So a group's identity is kept by
its members. In every frame each cluster proposes an identity to its members: that of the group from which most of them come,
or a new one. A member accepts it once the same has been proposed for ``hold_time`` seconds. The accepted identities are the
groups, and their changes are the events:

    appear   members who were in no group have one that is new
    split    some members leave for a new group while others stay
    merge    the last members leave for a group that was there before
    vanish   the last members have not been seen for ``hold_time`` seconds

An event carries the time at which it began, ``hold_time`` earlier than it was certain. With 0 the groups are the clusters.

Early warning: groups that are about to meet (E13's conclusion asks for it).

Two people at relative position Δ and velocity δ, who both go on as they go, are closest after τ = −Δ·δ / |δ|², at the
distance |Δ + δτ|. Two groups meet when any member of one comes that close to any of the other.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

import numpy as np

from phdtrack.checks import NonNegative, Positive, Share, check
from phdtrack.types import F8, I8

Kind = Literal["appear", "vanish", "merge", "split"]


@dataclass(frozen=True, slots=True)
class Event:
    """What happened to group ``group``, from the frame and time at which it began.

    ``other`` is the group that it merged into or split from; 0 for appear and vanish.
    """

    frame: int
    time: float
    kind: Kind
    group: int
    other: int = 0


@dataclass(frozen=True, slots=True)
class Member:
    """One person's membership: the ``group`` accepted, the one ``proposed`` and since when, and when he was last seen."""

    group: int
    proposed: int
    since: tuple[int, float]
    seen: tuple[int, float]


@dataclass(frozen=True, slots=True)
class LifeCycleState:
    """The state between frames: members by identity, groups announced, groups to be announced, and the next number."""

    members: Mapping[int, Member] = field(default_factory=lambda: MappingProxyType({}))
    announced: frozenset[int] = frozenset()
    born: Mapping[int, tuple[int, float]] = field(default_factory=lambda: MappingProxyType({}))
    following: int = 1


@dataclass(frozen=True, slots=True)
class GroupLifeCycle:
    """``hold_time``: seconds for which something must last to be believed."""

    hold_time: NonNegative = 0.5

    def __post_init__(self) -> None:
        check(self)

    def extend(
        self, state: LifeCycleState, member: I8, label: I8, weight: F8, frame: int, time: float
    ) -> tuple[LifeCycleState, I8, tuple[Event, ...]]:
        """Take in one frame's clusters.

        Parameters
        ----------
        member : (n,) identities of people (tracks, or tags of components), each at most once.
        label : (n,) the cluster of each.
        weight : (n,) how much each counts when identities are handed on.

        Returns
        -------
        The new state, the group (n,) of each member, and the events that became certain with this frame.
        """
        proposed, following = _proposals(state, member, label, weight)
        now = (frame, time)
        members = dict(state.members)
        moves: list[tuple[int, int, tuple[int, float]]] = []
        for who, group in zip(member.tolist(), proposed.tolist(), strict=True):
            members[who], moved = self._considered(members.get(who), group, now)
            if moved is not None:
                moves.append(moved)
        lost = {who: m for who, m in members.items() if time - m.seen[1] > self.hold_time}
        for who in lost:
            del members[who]
        living: dict[int, float] = {}
        for m in members.values():
            living[m.group] = max(m.seen[1], living.get(m.group, 0.0))
        born = {g: at for g, at in state.born.items() if g in living}
        for group in living.keys() - state.announced:
            born.setdefault(group, now)
        announced, born, events = self._told(state, moves, lost, living, born, now)
        after = LifeCycleState(MappingProxyType(members), announced, MappingProxyType(born), following)
        accepted = np.array([members[who].group for who in member.tolist()], np.int64)
        return after, accepted, events

    def _considered(
        self, old: Member | None, group: int, now: tuple[int, float]
    ) -> tuple[Member, tuple[int, int, tuple[int, float]] | None]:
        """A member after a proposal, and (from, to, since) where he has moved."""
        if old is None:
            return Member(group, group, now, now), None
        since = old.since if group == old.proposed else now
        if group != old.group and now[1] - since[1] >= self.hold_time:
            return Member(group, group, since, now), (old.group, group, since)
        return Member(old.group, group, since, now), None

    def _told(
        self,
        state: LifeCycleState,
        moves: list[tuple[int, int, tuple[int, float]]],
        lost: Mapping[int, Member],
        living: Mapping[int, float],
        born: dict[int, tuple[int, float]],
        now: tuple[int, float],
    ) -> tuple[frozenset[int], dict[int, tuple[int, float]], tuple[Event, ...]]:
        """The groups announced by now, those still to be, and the events; ``living``: when each group was last seen."""
        announced, told = set(state.announced), list[Event]()
        for source, target, since in dict.fromkeys(sorted(moves, key=lambda move: move[2][0])):
            if source in living and source in announced and target not in announced:
                told.append(Event(*since, "split", target, source))
                announced.add(target)
            elif source not in living and source in announced and target in announced:
                told.append(Event(*since, "merge", source, target))
                announced.discard(source)
        for group, at in sorted(born.items()):
            if group not in announced and living[group] - at[1] >= self.hold_time:
                told.append(Event(*at, "appear", group))
                announced.add(group)
        last: dict[int, tuple[int, float]] = {}
        for gone in lost.values():
            last[gone.group] = max(gone.seen, last.get(gone.group, gone.seen))
        for group in sorted(announced - living.keys()):
            # Nobody has moved on: whoever was left has not been seen. (Or all left for groups that are not certain yet.)
            told.append(Event(*last.get(group, now), "vanish", group))
            announced.discard(group)
        return frozenset(announced), {g: at for g, at in born.items() if g not in announced}, tuple(told)


def _proposals(state: LifeCycleState, member: I8, label: I8, weight: F8) -> tuple[I8, int]:
    """The identity that each member's cluster proposes to him, and the next number that is free.

    Clusters and groups are matched one to one with the largest total weight in common. A member speaks for the group last
    proposed to him and, at half his weight, for the one that he has accepted: two groups that touch for a moment part again
    as who they were. A cluster without a match takes a new number.
    """
    from scipy.optimize import linear_sum_assignment

    if len(member) == 0:
        return np.zeros(0, np.int64), state.following
    clusters, cluster = np.unique(label, return_inverse=True)
    nobody = Member(0, 0, (0, 0.0), (0, 0.0))
    before = [state.members.get(who, nobody) for who in member.tolist()]
    spoken_for = np.array([[m.proposed for m in before], [m.group for m in before]], np.int64)
    groups, group = np.unique(spoken_for, return_inverse=True)
    common = np.zeros((len(clusters), len(groups)))
    np.add.at(common, (np.tile(cluster, 2), group.ravel()), np.concatenate([weight, 0.5 * weight]))
    common[:, groups == 0] = 0.0
    rows, columns = linear_sum_assignment(-common)
    identity = np.zeros(len(clusters), np.int64)
    known = common[rows, columns] > 0
    identity[rows[known]] = groups[columns[known]]
    fresh = identity == 0
    identity[fresh] = state.following + np.arange(np.count_nonzero(fresh))
    return identity[cluster], state.following + int(np.count_nonzero(fresh))


@dataclass(frozen=True, slots=True)
class Encounter:
    """Groups ``first`` < ``second`` are expected to meet.

    Of the two members that are likeliest to: ``seconds`` from now until they are closest, ``distance`` then and its
    ``deviation``, metres, the ``place`` half-way between them, and the ``probability`` that they come near.
    """

    first: int
    second: int
    seconds: float
    distance: float
    deviation: float
    place: tuple[float, float]
    probability: float


@dataclass(frozen=True, slots=True)
class EncounterWarning:
    """When to warn.

    Parameters
    ----------
    horizon : seconds looked ahead; people turn, and straight lines say little about more.
    max_distance : metres; who comes closer has met.
    probability : of coming so close, from which on it is worth a warning.
    """

    horizon: Positive = 4.0
    max_distance: Positive = 2.0
    probability: Share = 0.5

    def __post_init__(self) -> None:
        check(self)

    def expected(self, group: I8, mean: F8, covariance: F8) -> tuple[Encounter, ...]:
        """Warnings for members with states (4, n), covariances (n, 4, 4) and groups (n,); groups that are near do not count.

        The deviation is that of the distance along the line of closest approach, P_a + P_b carried on to that time.

        Parameters
        ----------
        group : (n,) group of each member.
        mean : (4, n) states, metres and metres per second.
        covariance : (n, 4, 4).
        """
        i, j = np.triu_indices(len(group), 1)
        other = group[i] != group[j]
        i, j = i[other], j[other]
        apart, drift = mean[:2, i] - mean[:2, j], mean[2:4, i] - mean[2:4, j]
        drift2 = (drift**2).sum(0)
        towards = -(apart * drift).sum(0)
        after = np.clip(np.divide(towards, drift2, out=np.zeros_like(drift2), where=drift2 > 0), 0, self.horizon)
        then = apart + drift * after
        distance = np.hypot(then[0], then[1])
        deviation = _deviation(covariance[i] + covariance[j], then, distance, after)
        pair = np.stack([np.minimum(group[i], group[j]), np.maximum(group[i], group[j])])
        met = {(int(a), int(b)) for a, b in pair[:, np.hypot(*apart) < self.max_distance].T}
        best: dict[tuple[int, int], Encounter] = {}
        for k in np.flatnonzero(after > 0):
            key = (int(pair[0, k]), int(pair[1, k]))
            chance = _below(self.max_distance, float(distance[k]), float(deviation[k]))
            if key in met or chance < self.probability or (key in best and best[key].probability >= chance):
                continue
            middle = 0.5 * (mean[:2, i[k]] + mean[:2, j[k]] + (mean[2:4, i[k]] + mean[2:4, j[k]]) * after[k])
            place = (float(middle[0]), float(middle[1]))
            best[key] = Encounter(*key, float(after[k]), float(distance[k]), float(deviation[k]), place, chance)
        return tuple(best[key] for key in sorted(best))


def _deviation(covariance: F8, then: F8, distance: F8, after: F8) -> F8:
    """(P,) deviations of the distance, from covariances (P, 4, 4) of relative position and velocity."""
    line = np.divide(then, distance, out=np.tile([[1.0], [0.0]], (1, len(distance))), where=distance > 0)
    along = np.concatenate([line, line * after])
    out: F8 = np.sqrt(np.einsum("rp,prs,sp->p", along, covariance[:, :4, :4], along))
    return out


def _below(near: float, distance: float, deviation: float) -> float:
    """Probability that a Gaussian distance lies below ``near``."""
    if deviation == 0:
        return float(distance < near)
    return 0.5 * math.erfc((distance - near) / (deviation * math.sqrt(2)))
