"""Who walks with whom: evidence about every two people that adds up while both are seen, and groups
from it.

Two people are together, as companions, or apart, as strangers. A row in which both are seen, Δ and
δ apart in place and velocity, multiplies the odds that they are together by

    N(Δ; 0, (σ² + P_Δ) I) / ρ  ·  t(δ; (s² + P_δ) I) / t(δ; (s² + P_δ + |v_a|² + |v_b|²) I)

A companion is near and keeps step; strangers are anywhere, ρ of them per square metre as in this
frame's neighbourhood, and have velocities of their own: of two who stand, nothing is learned from
their velocities. P is the variance of what is known of the two, the mean of both axes: uncertain
people say less. The densities of velocities are Student's, as people stumble and turn, and that of
places has a wide part, for a row of companions abreast. Rows that follow each other say nearly the
same: one counts for its interval over ``memory``.

Before the first row the odds are ``prior_odds``, less by e for each `ARRIVAL_TIME` by which one
had been there before the other; after the last the same holds for leaving. In between companions
part, and strangers join, seldom: a Markov chain of two states. Forward it gives the odds by what
was seen up to a row (`Pairs.extend`); with what followed, the odds given all (`Pairs.over_time`).
Groups are the clusters with the largest sum of log-odds within them, in which one pair counts at
most ``max_log_odds`` for, and `APART_COST` against, being together: companions at the two ends of
a row are far apart, but a chain of strangers needs stronger links the longer it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from phdtrack.errors import Checked, Positive
from phdtrack.kernels.clustering import clusters
from phdtrack.types import F8, I8

# s, metres per second: deviation of the relative velocity of companions on each axis.
SPEED_DIFFERENCE = 0.7
# Seconds by which companions come, or leave, one after the other; seconds for which they stay
# together on average.
ARRIVAL_TIME = 7.0
PARTING_TIME = 1300.0
# How much a pair that is apart counts against a group that contains both, at most.
APART_COST = 0.004
# Seconds after which people who are not seen are forgotten while groups are found frame by frame.
FORGET = 60.0
# Metres around a person in which strangers are counted; pairs that never were as near are
# strangers.
NEIGHBOURHOOD = 5.0
# The wide part of companions' places: its share and its deviation in metres.
WIDE_SHARE = 0.02
WIDE = 2.9
# Degrees of freedom of Student's t; how often strangers join, over how often companions part.
FREEDOM = 4.0
JOINING = 0.1


class Walkers(NamedTuple):
    """The people of one frame.

    Attributes
    ----------
    identity : (n,) of each, once.
    mean : (4, n) place and velocity, metres and metres per second.
    covariance : (n, 4, 4).
    time : of the frame, seconds.
    """

    identity: I8
    mean: F8
    covariance: F8
    time: float


class _Known(NamedTuple):
    """A value of each pair, or person, and when it was seen last: ``key`` ascending, ``value``,
    ``time``, (K,) each.
    """

    key: I8
    value: F8
    time: F8

    def at(self, key: I8) -> tuple[F8, F8]:
        """Value and time of each key, NaN where it is not known."""
        place = np.minimum(self.key.searchsorted(key), max(len(self.key) - 1, 0))
        if len(self.key):
            known = self.key[place] == key
        else:
            known = np.zeros(len(key), np.bool_)
        if not known.any():
            return np.full(len(key), np.nan), np.full(len(key), np.nan)
        return np.where(known, self.value[place], np.nan), np.where(known, self.time[place], np.nan)

    def having(self, key: I8, value: F8, time: float, since: float = -np.inf) -> _Known:
        """With the values of these keys, and without what was last seen before ``since``."""
        stay = ~np.isin(self.key, key, assume_unique=True) & (self.time >= since)
        keys = np.concatenate([self.key[stay], key])
        order = np.argsort(keys)
        return _Known(
            keys[order],
            np.concatenate([self.value[stay], value])[order],
            np.concatenate([self.time[stay], np.full(len(key), time)])[order],
        )


_NOTHING = _Known(np.zeros(0, np.int64), np.zeros(0), np.zeros(0))


@dataclass(frozen=True, slots=True)
class PairState:
    """Log-odds of the pairs that were near, and when each person was first seen."""

    pairs: _Known = _NOTHING
    people: _Known = _NOTHING


class PairRows(NamedTuple):
    """Pairs of a frame (P,): people ``a`` < ``b``, the ``key`` of both identities, and the
    ``evidence`` of the row.
    """

    a: I8
    b: I8
    key: I8
    evidence: F8


@dataclass(frozen=True, slots=True)
class Pairs(Checked):
    """What makes two people companions, and companions a group.

    Parameters
    ----------
    prior_odds : that two who are first seen at the same time are together, places not considered.
    distance : σ, metres: deviation of a companion's place on each axis.
    memory : seconds after which what is seen of two people counts as new.
    max_log_odds : of a pair at most, for or against.
    """

    prior_odds: Positive = 5.0
    distance: Positive = 0.57
    memory: Positive = 1.25
    max_log_odds: Positive = 10.0

    def extend(self, state: PairState, walkers: Walkers) -> tuple[PairState, I8]:
        """The state with a frame, and the group (n,) of each of its people, from 0, by what was
        seen so far.
        """
        state, rows, forward = self._forward(state, walkers, since=walkers.time - FORGET)
        return state, self._groups(len(walkers.identity), rows, forward)

    def over_time(self, frames: Sequence[Walkers]) -> list[I8]:
        """The group (n,) of each person of all frames, in order of time, by what was seen before
        and after.
        """
        found = self.log_odds(frames)
        return [
            self._groups(len(walkers.identity), rows, odds)
            for walkers, (odds, rows) in zip(frames, found, strict=True)
        ]

    def log_odds(self, frames: Sequence[Walkers]) -> list[tuple[F8, PairRows]]:
        """Of each frame the log-odds (P,) of its pairs, given all frames, and which pairs they
        are.
        """
        state = PairState()
        passed = list[tuple[PairRows, F8]]()
        last = _NOTHING
        for walkers in frames:
            state, rows, forward = self._forward(state, walkers)
            passed.append((rows, forward))
            last = last.having(
                np.sort(walkers.identity),
                np.full(len(walkers.identity), walkers.time),
                walkers.time,
            )
        after = _NOTHING
        out = list[tuple[F8, PairRows]]()
        for walkers, (rows, forward) in zip(reversed(frames), reversed(passed), strict=True):
            ends, _ = last.at(walkers.identity)
            value, time = after.at(rows.key)
            met = np.isnan(value)
            leaving = -np.abs(ends[rows.a] - ends[rows.b]) / ARRIVAL_TIME
            before = self._before(
                np.where(met, 0.0, value), np.where(met, 0.0, time - walkers.time)
            )
            backward = np.where(met, leaving, before)
            out.append((forward + backward, rows))
            # What the row before may be told holds this row's own evidence.
            after = after.having(*_sorted(rows.key, backward + rows.evidence), walkers.time)
        return out[::-1]

    def _forward(
        self, state: PairState, walkers: Walkers, since: float = -np.inf
    ) -> tuple[PairState, PairRows, F8]:
        """The state with a frame, its pairs, and their log-odds (P,) by what was seen so far."""
        who = walkers.identity
        time = walkers.time
        first, _ = state.people.at(who)
        first = np.where(np.isnan(first), time, first)
        place = walkers.mean[:2]
        apart = np.hypot(place[0][:, None] - place[0], place[1][:, None] - place[1])
        near = apart < NEIGHBOURHOOD
        low = np.minimum(who[:, None], who)
        high = np.maximum(who[:, None], who)
        keys = (low << 32) | high
        a, b = np.nonzero(np.triu(near | np.isin(keys, state.pairs.key), k=1))
        key = keys[a, b]
        before, seen = state.pairs.at(key)
        new = np.isnan(before)
        interval = np.where(new, 0.0, time - seen)
        others = near.sum(axis=1) - 1.0
        density = (1 + (others[a] + others[b]) / 2 - near[a, b]) / (np.pi * NEIGHBOURHOOD**2)
        # The first row is all new; the others are as new as they are late.
        weight = np.where(new, 1.0, np.minimum(interval / self.memory, 1.0))
        evidence = weight * self._evidence(walkers, a, b, density)
        prior = np.log(self.prior_odds) - np.abs(first[a] - first[b]) / ARRIVAL_TIME
        odds = np.where(new, prior, self._later(np.where(new, 0.0, before), interval)) + evidence
        forward: F8 = np.clip(odds, -self.max_log_odds, self.max_log_odds)
        people = state.people.having(*_sorted(who, first), time, since)
        pairs = state.pairs.having(*_sorted(key, forward), time, since)
        return PairState(pairs, people), PairRows(a, b, key, evidence), forward

    def _evidence(self, walkers: Walkers, a: I8, b: I8, density: F8) -> F8:
        """(P,) log-odds that the places and velocities of one row add."""
        away = walkers.mean[:, a] - walkers.mean[:, b]
        variance = np.diagonal(walkers.covariance, axis1=1, axis2=2)
        variance = variance[a] + variance[b]
        place2 = (away[:2] ** 2).sum(axis=0)
        speed2 = (away[2:] ** 2).sum(axis=0)
        at = variance[:, :2].mean(axis=1)
        of = variance[:, 2:].mean(axis=1)
        companion = sum(
            share * np.exp(-0.5 * place2 / (width**2 + at)) / (2 * np.pi * (width**2 + at))
            for share, width in ((1 - WIDE_SHARE, self.distance), (WIDE_SHARE, WIDE))
        )
        step = SPEED_DIFFERENCE**2 + of
        own = step + (walkers.mean[2:, a] ** 2 + walkers.mean[2:, b] ** 2).sum(axis=0)
        power = (FREEDOM + 2) / 2
        keeps = power * (
            np.log1p(speed2 / (FREEDOM * own)) - np.log1p(speed2 / (FREEDOM * step))
        ) + np.log(own / step)
        return np.asarray(np.log(np.maximum(companion / density, 1e-300)) + keeps)

    def _chances(self, interval: F8) -> tuple[F8, F8]:
        """(P,) probabilities that companions have parted after so many seconds, and that strangers
        have joined.
        """
        parted = -np.expm1(-interval / PARTING_TIME)
        return parted, JOINING * parted

    def _later(self, odds: F8, interval: F8) -> F8:
        """(P,) log-odds after an interval in which nothing was seen."""
        parted, joined = self._chances(interval)
        ratio = np.exp(np.clip(odds, -500.0, 500.0))
        return np.log((ratio * (1 - parted) + joined) / (ratio * parted + 1 - joined))

    def _before(self, odds: F8, interval: F8) -> F8:
        """(P,) log of how much better two together explain what follows than two apart, from the
        same after an interval.
        """
        parted, joined = self._chances(interval)
        ratio = np.exp(np.clip(odds, -500.0, 500.0))
        return np.log((ratio * (1 - parted) + parted) / (ratio * joined + 1 - joined))

    def _groups(self, count: int, rows: PairRows, odds: F8) -> I8:
        """(n,) the groups of a frame."""
        gain = np.full((count, count), -APART_COST)
        gain[rows.a, rows.b] = gain[rows.b, rows.a] = np.clip(odds, -APART_COST, self.max_log_odds)
        return np.asarray(clusters(gain))


def _sorted(key: I8, value: F8) -> tuple[I8, F8]:
    order = np.argsort(key)
    return key[order], value[order]
