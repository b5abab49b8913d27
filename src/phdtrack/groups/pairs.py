"""Groups from pairwise evidence that accumulates over time.

Two people are either companions or strangers. A frame in which both are visible, with differences Δ
in position and δ in velocity, multiplies the odds that they are companions by

    N(Δ; 0, (σ² + P_Δ) I) / ρ  ·  t(δ; (s² + P_δ) I) / t(δ; (s² + P_δ + (u_a² + u_b²) / 2) I)

A companion is near and walks at the same velocity. Strangers are anywhere, with the density ρ of
the neighbourhood in this frame, and their velocities differ as those of strangers do here. u_a² is
the mean square of the velocity of a relative to everybody between `COMPANY` and `NEIGHBOURHOOD`
metres away, and to `STRANGERS` more who walk as fast as a in any direction: where all go one way,
or stand and wait, equal velocities say little. P is the variance of the estimates of the two, the
mean over both axes: uncertain people give less evidence. The densities of velocities are Student's
t, because people stumble and turn, and that of positions has a wide component for a row of
companions abreast.

Consecutive frames are correlated: strangers stay beside each other until they have walked. So a
frame counts with the share in ``path`` of what both have walked since the last one, in the mean,
but at most with the share of the interval in `MEMORY`. People who wait side by side for minutes are
no more of a group than when they came.

Before the first frame the odds are ``prior_odds``, divided by e for each `ARRIVAL_TIME` between the
arrivals of the two; after the last frame the same holds for leaving. In between companions rarely
part and strangers rarely join: a two-state Markov chain. Its forward pass gives the odds from the
past (`Pairs.extend`), both passes the odds given all frames (`Pairs.over_time`).

Groups are the clusters with the largest sum of log-odds within them, in which a pair counts at most
``max_log_odds`` for being together, and at most `APART_COST` against: companions at the two ends of
a row are far apart, but a longer chain of strangers needs stronger links.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from phdtrack.errors import Checked, Positive
from phdtrack.kernels.clustering import clusters
from phdtrack.types import F8, I8, Bool

# s, metres per second: standard deviation of the relative velocity of companions on each axis.
SPEED_DIFFERENCE = 0.7
# Seconds between the arrivals, or departures, of companions; mean time in seconds that they stay
# together.
ARRIVAL_TIME = 7.0
PARTING_TIME = 1300.0
# Largest cost of a pair of strangers in a group.
APART_COST = 0.004
# Seconds after which people who are not seen are forgotten by `Pairs.extend`.
FORGET = 60.0
# Seconds after which the evidence about two people is independent, however fast they are.
MEMORY = 1.25
# Radius in metres in which strangers are counted; pairs that were never as near are strangers.
NEIGHBOURHOOD = 5.0
# Metres within which others may be companions, and what independent velocities weigh against those
# of the neighbours, in people.
COMPANY = 1.5
STRANGERS = 3.0
# The wide component of companions' positions: its share and its standard deviation in metres.
WIDE_SHARE = 0.02
WIDE = 2.9
# Degrees of freedom of Student's t; ratio of the rates of joining and parting.
FREEDOM = 4.0
JOINING = 0.1


class Walkers(NamedTuple):
    """The people of one frame.

    Attributes
    ----------
    identity : (n,) of each, without repetition.
    mean : (4, n) position and velocity, metres and metres per second.
    covariance : (n, 4, 4).
    time : of the frame, seconds.
    """

    identity: I8
    mean: F8
    covariance: F8
    time: float


class _Table(NamedTuple):
    """A value for each pair or person, and the time when it was last seen: ``key`` ascending,
    ``value``, ``time``, (K,) each.
    """

    key: I8
    value: F8
    time: F8

    def at(self, key: I8) -> tuple[F8, F8]:
        """Value and time of each key, NaN for unknown keys."""
        if not len(self.key):
            return np.full(len(key), np.nan), np.full(len(key), np.nan)
        row = np.minimum(self.key.searchsorted(key), len(self.key) - 1)
        known = self.key[row] == key
        return np.where(known, self.value[row], np.nan), np.where(known, self.time[row], np.nan)

    def updated(self, key: I8, value: F8, time: float, since: float = -np.inf) -> _Table:
        """The table with new values for these keys, without keys last seen before ``since``."""
        kept = ~np.isin(self.key, key, assume_unique=True) & (self.time >= since)
        keys = np.concatenate([self.key[kept], key])
        order = np.argsort(keys)
        return _Table(
            keys[order],
            np.concatenate([self.value[kept], value])[order],
            np.concatenate([self.time[kept], np.full(len(key), time)])[order],
        )


_EMPTY = _Table(np.zeros(0, np.int64), np.zeros(0), np.zeros(0))


@dataclass(frozen=True, slots=True)
class PairState:
    """Log-odds of the pairs that were near, and the time when each person was first seen."""

    pairs: _Table = _EMPTY
    people: _Table = _EMPTY


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
    """The model of companions.

    Parameters
    ----------
    prior_odds : odds that two people who arrive at the same time are companions, regardless of
        their positions.
    distance : σ, metres: standard deviation of the relative position of companions on each axis.
    path : metres that two people walk, in the mean, until the evidence about them is independent.
    max_log_odds : limit of the log-odds of a pair, for and against.
    """

    prior_odds: Positive = 5.0
    distance: Positive = 0.57
    path: Positive = 0.8
    max_log_odds: Positive = 10.0

    def extend(self, state: PairState, walkers: Walkers) -> tuple[PairState, I8]:
        """Process a frame: the new state, and the group (n,) of each person, from 0, from past and
        present frames.
        """
        state, rows, forward = self._forward(state, walkers, since=walkers.time - FORGET)
        return state, self._groups(len(walkers.identity), rows, forward)

    def over_time(self, frames: Sequence[Walkers]) -> list[I8]:
        """The group (n,) of each person in each of the frames, which are in order of time, given
        all frames.
        """
        return [
            self._groups(len(walkers.identity), rows, odds)
            for walkers, (odds, rows) in zip(frames, self.log_odds(frames), strict=True)
        ]

    def log_odds(self, frames: Sequence[Walkers]) -> list[tuple[F8, PairRows]]:
        """The log-odds (P,) of the pairs of each frame, given all frames, and the pairs."""
        state = PairState()
        passes = list[tuple[PairRows, F8]]()
        last = _EMPTY
        for walkers in frames:
            state, rows, forward = self._forward(state, walkers)
            passes.append((rows, forward))
            last = last.updated(
                np.sort(walkers.identity),
                np.full(len(walkers.identity), walkers.time),
                walkers.time,
            )
        after = _EMPTY
        out = list[tuple[F8, PairRows]]()
        for walkers, (rows, forward) in zip(reversed(frames), reversed(passes), strict=True):
            ends, _ = last.at(walkers.identity)
            value, time = after.at(rows.key)
            is_last = np.isnan(value)
            leaving = -np.abs(ends[rows.a] - ends[rows.b]) / ARRIVAL_TIME
            before = self._before(
                np.where(is_last, 0.0, value), np.where(is_last, 0.0, time - walkers.time)
            )
            backward = np.where(is_last, leaving, before)
            out.append((forward + backward, rows))
            # The backward message to the previous frame includes the evidence of this one.
            after = after.updated(*_sorted(rows.key, backward + rows.evidence), walkers.time)
        return out[::-1]

    def _forward(
        self, state: PairState, walkers: Walkers, since: float = -np.inf
    ) -> tuple[PairState, PairRows, F8]:
        """Process a frame in the forward pass: the new state, the pairs of the frame, and their
        log-odds (P,) from past and present frames.
        """
        identity = walkers.identity
        time = walkers.time
        first, _ = state.people.at(identity)
        first = np.where(np.isnan(first), time, first)
        x, y = walkers.mean[:2]
        distance = np.hypot(x[:, None] - x, y[:, None] - y)
        near = distance < NEIGHBOURHOOD
        low = np.minimum(identity[:, None], identity)
        high = np.maximum(identity[:, None], identity)
        keys = (low << 32) | high
        a, b = np.nonzero(np.triu(near | np.isin(keys, state.pairs.key), k=1))
        key = keys[a, b]
        before, seen = state.pairs.at(key)
        new = np.isnan(before)
        interval = np.where(new, 0.0, time - seen)
        others = near.sum(axis=1) - 1.0
        density = (1 + (others[a] + others[b]) / 2 - near[a, b]) / (np.pi * NEIGHBOURHOOD**2)
        speed = np.hypot(*walkers.mean[2:])
        walked = (speed[a] + speed[b]) / 2 * interval
        share = np.minimum(np.minimum(walked / self.path, interval / MEMORY), 1.0)
        weight = np.where(new, 1.0, share)
        independent = _independent(walkers.mean[2:], near & (distance >= COMPANY))
        spread = (independent[a] + independent[b]) / 2
        evidence = weight * self._evidence(walkers, a, b, density, spread)
        prior = np.log(self.prior_odds) - np.abs(first[a] - first[b]) / ARRIVAL_TIME
        odds = np.where(new, prior, self._later(np.where(new, 0.0, before), interval)) + evidence
        forward: F8 = np.clip(odds, -self.max_log_odds, self.max_log_odds)
        people = state.people.updated(*_sorted(identity, first), time, since)
        pairs = state.pairs.updated(*_sorted(key, forward), time, since)
        return PairState(pairs, people), PairRows(a, b, key, evidence), forward

    def _evidence(self, walkers: Walkers, a: I8, b: I8, density: F8, spread: F8) -> F8:
        """(P,) log-odds from the positions and velocities in one frame; ``spread`` (P,) is the mean
        square of the relative velocities of strangers.
        """
        difference = walkers.mean[:, a] - walkers.mean[:, b]
        variance = np.diagonal(walkers.covariance, axis1=1, axis2=2)
        variance = variance[a] + variance[b]
        distance2 = (difference[:2] ** 2).sum(axis=0)
        speed2 = (difference[2:] ** 2).sum(axis=0)
        of_position = variance[:, :2].mean(axis=1)
        of_velocity = variance[:, 2:].mean(axis=1)
        companion = sum(
            share
            * np.exp(-0.5 * distance2 / (width**2 + of_position))
            / (2 * np.pi * (width**2 + of_position))
            for share, width in ((1 - WIDE_SHARE, self.distance), (WIDE_SHARE, WIDE))
        )
        together = SPEED_DIFFERENCE**2 + of_velocity
        apart = together + spread
        power = (FREEDOM + 2) / 2
        velocity = power * (
            np.log1p(speed2 / (FREEDOM * apart)) - np.log1p(speed2 / (FREEDOM * together))
        ) + np.log(apart / together)
        return np.asarray(np.log(np.maximum(companion / density, 1e-300)) + velocity)

    def _transitions(self, interval: F8) -> tuple[F8, F8]:
        """(P,) transition probabilities of an interval in seconds: companions have parted, and
        strangers have joined.
        """
        parted = -np.expm1(-interval / PARTING_TIME)
        return parted, JOINING * parted

    def _later(self, odds: F8, interval: F8) -> F8:
        """(P,) log-odds after an interval without evidence."""
        parted, joined = self._transitions(interval)
        ratio = np.exp(np.clip(odds, -500.0, 500.0))
        return np.log((ratio * (1 - parted) + joined) / (ratio * parted + 1 - joined))

    def _before(self, odds: F8, interval: F8) -> F8:
        """(P,) log likelihood ratio of all later evidence for companions over strangers, an
        ``interval`` before the time for which it is ``odds``.
        """
        parted, joined = self._transitions(interval)
        ratio = np.exp(np.clip(odds, -500.0, 500.0))
        return np.log((ratio * (1 - parted) + parted) / (ratio * joined + 1 - joined))

    def _groups(self, count: int, rows: PairRows, odds: F8) -> I8:
        """(n,) the groups of a frame of ``count`` people."""
        gain = np.full((count, count), -APART_COST)
        pair_gain = np.clip(odds, -APART_COST, self.max_log_odds)
        gain[rows.a, rows.b] = pair_gain
        gain[rows.b, rows.a] = pair_gain
        return np.asarray(clusters(gain))


def _independent(velocity: F8, strangers: Bool) -> F8:
    """(n,) mean square of the velocity of each person relative to ``strangers`` (n, n), and to
    `STRANGERS` more of the same speed and any direction.
    """
    squares = (velocity**2).sum(axis=0)
    relative = np.maximum(squares[:, None] + squares - 2 * velocity.T @ velocity, 0.0)
    total = (strangers * relative).sum(axis=1) + STRANGERS * 2 * squares
    return np.asarray(total / (strangers.sum(axis=1) + STRANGERS))


def _sorted(key: I8, value: F8) -> tuple[I8, F8]:
    """Keys in ascending order, with their values."""
    order = np.argsort(key)
    return key[order], value[order]
