"""Groups over time: identities and the events of their lives.

Clusters flicker: two people at a distance of two metres are one group in one frame and two in the
next. So members keep the identity of a group. In every frame each cluster proposes an identity to
its members: that of the group which most of them come from, or a new one. A member accepts it once
the same has been proposed for ``hold_time`` seconds. The accepted identities are the groups, and
their changes are the events:

    appear   members who were in no group have a new one
    split    some members leave for a new group while others stay
    merge    the last members leave for an existing group
    vanish   the last members have not been seen for ``hold_time`` seconds

An event has the time at which it began, ``hold_time`` before it was certain. With a hold time of 0
the groups are the clusters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

import numpy as np

from phdtrack.errors import Checked, NonNegative
from phdtrack.types import F8, I8

Kind = Literal["appear", "vanish", "merge", "split"]
# Frame number and time, seconds.
When = tuple[int, float]


@dataclass(frozen=True, slots=True)
class Event:
    """A change of group ``group``, with the frame and time at which it began.

    ``other`` is the group that it merged into or split from; 0 for appear and vanish.
    """

    frame: int
    time: float
    kind: Kind
    group: int
    other: int = 0


@dataclass(frozen=True, slots=True)
class Member:
    """The membership of one person: the accepted ``group``, the ``proposed`` one and the time since
    when, and the time when the person was last seen.
    """

    group: int
    proposed: int
    since: When
    seen: When


@dataclass(frozen=True, slots=True)
class LifeCycleState:
    """The state between frames: members by identity, groups whose beginning was reported, the
    beginnings of groups that were not reported yet, and the next free number.
    """

    members: Mapping[int, Member] = field(default_factory=lambda: MappingProxyType({}))
    announced: frozenset[int] = frozenset()
    born: Mapping[int, When] = field(default_factory=lambda: MappingProxyType({}))
    following: int = 1


@dataclass(frozen=True, slots=True)
class _Move:
    """Members accept the group ``target`` in place of ``source``, proposed since then."""

    source: int
    target: int
    since: When


@dataclass(frozen=True, slots=True)
class GroupLifeCycle(Checked):
    """``hold_time``: seconds that a change must last before it counts."""

    hold_time: NonNegative = 0.5

    def extend(
        self, state: LifeCycleState, member: I8, label: I8, weight: F8, frame: int, time: float
    ) -> tuple[LifeCycleState, I8, tuple[Event, ...]]:
        """Process the clusters of one frame: the new state, the group (n,) of each member, and the
        events that became certain with this frame.

        Parameters
        ----------
        state : after the previous frame.
        member : (n,) identities of people, each at most once.
        label : (n,) the cluster of each.
        weight : (n,) the vote of each for the identity of its cluster.
        frame, time : number of the frame, and its time in seconds.
        """
        proposed, following = _proposals(state, member, label, weight)
        now = (frame, time)
        members = dict(state.members)
        moves = list[_Move]()
        for person, group in zip(member.tolist(), proposed.tolist(), strict=True):
            old = members.get(person, Member(group, group, now, now))
            since = old.since if group == old.proposed else now
            accepted = old.group
            if group != old.group and time - since[1] >= self.hold_time:
                accepted = group
                moves.append(_Move(old.group, group, since))
            members[person] = Member(accepted, group, since, now)
        lost = [m for m in members.values() if time - m.seen[1] > self.hold_time]
        members = {person: m for person, m in members.items() if time - m.seen[1] <= self.hold_time}
        last_seen: dict[int, float] = {}
        for m in members.values():
            last_seen[m.group] = max(m.seen[1], last_seen.get(m.group, 0.0))
        born = {
            group: state.born.get(group, now)
            for group in last_seen
            if group in state.born or group not in state.announced
        }
        announced, events = self._events(state.announced, born, last_seen, moves, lost, now)
        born = {group: since for group, since in born.items() if group not in announced}
        after = LifeCycleState(
            MappingProxyType(members), announced, MappingProxyType(born), following
        )
        groups = np.array([members[person].group for person in member.tolist()], np.int64)
        return after, groups, events

    def _events(
        self,
        announced: frozenset[int],
        born: Mapping[int, When],
        last_seen: Mapping[int, float],
        moves: Sequence[_Move],
        lost: Sequence[Member],
        now: When,
    ) -> tuple[frozenset[int], tuple[Event, ...]]:
        """The groups whose beginning was reported and that still exist, and the events.

        ``last_seen`` has the time of every existing group, ``lost`` the members who vanished.
        """
        current = set(announced)
        events = list[Event]()
        for move in dict.fromkeys(sorted(moves, key=lambda move: move.since[0])):
            if move.source not in current:
                continue
            if move.source in last_seen and move.target not in current:
                events.append(Event(*move.since, "split", move.target, move.source))
                current.add(move.target)
            elif move.source not in last_seen and move.target in current:
                events.append(Event(*move.since, "merge", move.source, move.target))
                current.discard(move.source)
        for group, since in sorted(born.items()):
            if group not in current and last_seen[group] - since[1] >= self.hold_time:
                events.append(Event(*since, "appear", group))
                current.add(group)
        for group in sorted(current - last_seen.keys()):
            # Nobody moved to a known group: the last members have not been seen, or they left for
            # groups that are not certain yet.
            seen = max((m.seen for m in lost if m.group == group), default=now)
            events.append(Event(*seen, "vanish", group))
        return frozenset(current & last_seen.keys()), tuple(events)


def _proposals(state: LifeCycleState, member: I8, label: I8, weight: F8) -> tuple[I8, int]:
    """The identity that its cluster proposes to each member, and the next free number.

    Clusters and groups are matched one to one for the largest total weight in common. A member
    votes for the group last proposed and, with half its weight, for the accepted one: so two groups
    that touch for a moment keep their identities. A cluster without a match gets a new number.
    """
    from scipy.optimize import linear_sum_assignment

    if len(member) == 0:
        return np.zeros(0, np.int64), state.following
    clusters, cluster = np.unique(label, return_inverse=True)
    unknown = Member(0, 0, (0, 0.0), (0, 0.0))
    before = [state.members.get(person, unknown) for person in member.tolist()]
    votes = np.array([[m.proposed for m in before], [m.group for m in before]], np.int64)
    groups, group = np.unique(votes, return_inverse=True)
    common = np.zeros((len(clusters), len(groups)))
    np.add.at(common, (np.tile(cluster, 2), group.ravel()), np.concatenate([weight, 0.5 * weight]))
    common[:, groups == 0] = 0.0
    rows, columns = linear_sum_assignment(-common)
    identity = np.zeros(len(clusters), np.int64)
    matched = common[rows, columns] > 0
    identity[rows[matched]] = groups[columns[matched]]
    fresh = identity == 0
    count = int(np.count_nonzero(fresh))
    identity[fresh] = state.following + np.arange(count)
    return identity[cluster], state.following + count
