"""Groups over time: identities, the events of their lives, and warnings before two meet.

Clusters flicker: two people at two metres are one group in one frame and two in the next. So a
group's identity is kept by its members. In every frame each cluster proposes an identity to its
members: that of the group from which most of them come, or a new one. A member accepts it once the
same has been proposed for ``hold_time`` seconds. The accepted identities are the groups, and their
changes are the events:

    appear   members who were in no group have one that is new
    split    some members leave for a new group while others stay
    merge    the last members leave for a group that was there before
    vanish   the last members have not been seen for ``hold_time`` seconds

An event carries the time at which it began, ``hold_time`` earlier than it was certain. With 0 the
groups are the clusters.

Early warning (E13's conclusion asks for it): two people at relative position Δ and velocity δ, who
keep their velocities, are closest after τ = −Δ·δ / |δ|², at the distance |Δ + δτ|. Two groups meet
when any member of one comes that close to any of the other.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

import numpy as np

from phdtrack.errors import Checked, NonNegative, Positive, Share
from phdtrack.types import F8, I8, GaussianMixture

Kind = Literal["appear", "vanish", "merge", "split"]
# Frame number and time, seconds.
When = tuple[int, float]


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
    """One person's membership: the ``group`` accepted, the one ``proposed`` and since when, and
    when last seen.
    """

    group: int
    proposed: int
    since: When
    seen: When


@dataclass(frozen=True, slots=True)
class LifeCycleState:
    """The state between frames: members by identity, groups announced, groups to be announced, and
    the next number.
    """

    members: Mapping[int, Member] = field(default_factory=lambda: MappingProxyType({}))
    announced: frozenset[int] = frozenset()
    born: Mapping[int, When] = field(default_factory=lambda: MappingProxyType({}))
    following: int = 1


@dataclass(frozen=True, slots=True)
class GroupLifeCycle(Checked):
    """``hold_time``: seconds for which something must last until it counts."""

    hold_time: NonNegative = 0.5

    def extend(
        self, state: LifeCycleState, member: I8, label: I8, weight: F8, frame: int, time: float
    ) -> tuple[LifeCycleState, I8, tuple[Event, ...]]:
        """The state with one frame's clusters, the group (n,) of each member, and the events that
        became certain with this frame.

        Parameters
        ----------
        state : after the frame before.
        member : (n,) identities of people, each at most once.
        label : (n,) the cluster of each.
        weight : (n,) how much each counts when identities are handed on.
        frame, time : number of the frame, and its time in seconds.
        """
        proposed, following = _proposals(state, member, label, weight)
        now = (frame, time)
        members = dict(state.members)
        moves = list[tuple[int, int, When]]()
        for person, group in zip(member.tolist(), proposed.tolist(), strict=True):
            old = members.get(person, Member(group, group, now, now))
            if group == old.proposed:
                since = old.since
            else:
                since = now
            accepted = group != old.group and time - since[1] >= self.hold_time
            if accepted:
                moves.append((old.group, group, since))
            members[person] = Member(group if accepted else old.group, group, since, now)
        lost = [m for m in members.values() if time - m.seen[1] > self.hold_time]
        members = {person: m for person, m in members.items() if time - m.seen[1] <= self.hold_time}
        living: dict[int, float] = {}
        for m in members.values():
            living[m.group] = max(m.seen[1], living.get(m.group, 0.0))
        born = {
            group: state.born.get(group, now)
            for group in living
            if group in state.born or group not in state.announced
        }
        announced = set(state.announced)
        events = list[Event]()
        for source, target, since in dict.fromkeys(sorted(moves, key=lambda move: move[2][0])):
            if source in living and source in announced and target not in announced:
                events.append(Event(*since, "split", target, source))
                announced.add(target)
            elif source not in living and source in announced and target in announced:
                events.append(Event(*since, "merge", source, target))
                announced.discard(source)
        for group, since in sorted(born.items()):
            if group not in announced and living[group] - since[1] >= self.hold_time:
                events.append(Event(*since, "appear", group))
                announced.add(group)
        for group in sorted(announced - living.keys()):
            # No member has moved on: the last have not been seen. (Or all left for groups that are
            # not certain yet.)
            events.append(
                Event(
                    *max((m.seen for m in lost if m.group == group), default=now), "vanish", group
                )
            )
        announced &= living.keys()
        born = {group: since for group, since in born.items() if group not in announced}
        after = LifeCycleState(
            MappingProxyType(members), frozenset(announced), MappingProxyType(born), following
        )
        return (
            after,
            np.array([members[person].group for person in member.tolist()], np.int64),
            tuple(events),
        )


def _proposals(state: LifeCycleState, member: I8, label: I8, weight: F8) -> tuple[I8, int]:
    """The identity that each member's cluster proposes, and the next number that is free.

    Clusters and groups are matched one to one with the largest total weight in common. A member
    speaks for the group last proposed and, at half its weight, for the one accepted: two groups
    that touch for a moment have their old identities afterwards. A cluster without a match takes a
    new number.
    """
    from scipy.optimize import linear_sum_assignment

    if len(member) == 0:
        return np.zeros(0, np.int64), state.following
    clusters, cluster = np.unique(label, return_inverse=True)
    unknown = Member(0, 0, (0, 0.0), (0, 0.0))
    before = [state.members.get(person, unknown) for person in member.tolist()]
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

    Of the two members that are likeliest to: ``seconds`` from now until they are closest,
    ``distance`` then and its ``deviation``, metres, the ``place`` half-way between them, and the
    ``probability`` that they come near.
    """

    first: int
    second: int
    seconds: float
    distance: float
    deviation: float
    place: tuple[float, float]
    probability: float


@dataclass(frozen=True, slots=True)
class EncounterWarning(Checked):
    """When to warn.

    Parameters
    ----------
    horizon : seconds looked ahead; people turn, and straight lines say little about more.
    max_distance : metres; groups that come closer have met.
    probability : of coming so close, from which on a warning is given.
    """

    horizon: Positive = 4.0
    max_distance: Positive = 2.0
    probability: Share = 0.5

    def expected(self, group: I8, members: GaussianMixture) -> tuple[Encounter, ...]:
        """Warnings, at most one for each pair of groups, in order; groups that are near already do
        not count.

        ``group`` (J,) is that of each of the ``members`` over (px, py, vx, vy), 0 for none. The
        deviation is that of the distance along the line of closest approach, P_a + P_b carried on
        to that time.
        """
        from scipy.special import ndtr

        named = np.flatnonzero(group)
        mean = members.mean
        covariance = members.covariance
        i, j = named[np.stack(np.triu_indices(len(named), 1))]
        i, j = i[group[i] != group[j]], j[group[i] != group[j]]
        apart = mean[:2, i] - mean[:2, j]
        drift = mean[2:4, i] - mean[2:4, j]
        with np.errstate(divide="ignore", invalid="ignore"):
            after = np.clip(
                np.nan_to_num(-(apart * drift).sum(0) / (drift**2).sum(0)), 0, self.horizon
            )
            then = apart + drift * after
            distance = np.hypot(then[0], then[1])
            line = np.where(distance > 0, then / distance, [[1.0], [0.0]])
            along = np.concatenate([line, line * after])
            both = covariance[i, :4, :4] + covariance[j, :4, :4]
            deviation = np.sqrt(np.einsum("rp,prs,sp->p", along, both, along))
            chance = np.nan_to_num(ndtr((self.max_distance - distance) / deviation))
        pair = np.sort(np.stack([group[i], group[j]]), axis=0)
        met = {(a, b) for a, b in pair[:, np.hypot(*apart) < self.max_distance].T.tolist()}
        best: dict[tuple[int, int], Encounter] = {}
        for k in np.flatnonzero((after > 0) & (chance >= self.probability)):
            key = (int(pair[0, k]), int(pair[1, k]))
            if key in met or (key in best and best[key].probability >= chance[k]):
                continue
            x, y = (
                0.5
                * (mean[:2, i[k]] + mean[:2, j[k]] + (mean[2:4, i[k]] + mean[2:4, j[k]]) * after[k])
            ).tolist()
            numbers = float(after[k]), float(distance[k]), float(deviation[k])
            best[key] = Encounter(*key, *numbers, (x, y), float(chance[k]))
        return tuple(best[key] for key in sorted(best))
