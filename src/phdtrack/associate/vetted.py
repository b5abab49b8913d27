"""Tracks that stay where a scene's false alarms are, held back: identities behind what a person has taught of the scene.

Whether a track is a false alarm's or an object's never changes, and false alarms stay where they are. So the odds that a
track is a false alarm's are those of the place on its way where false alarms are the rarest, and it is believed from the
first row on at which an object is the likelier. What an object's track tells before is left out, as is what a false alarm's
told before somebody took it over.

Online, tracks are confirmed after some states, because most of what is seen once or twice is false. Where the scene says
that it is not, this need not be waited for: who has been where false alarms are rare among objects is confirmed at once.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Generic, Protocol, TypeVar

import numpy as np

from phdtrack.boxes import to_cxcywh
from phdtrack.measured import Measured
from phdtrack.protocols import Associator, Model
from phdtrack.types import F8, I8, Bool, Estimates, Tracks

A = TypeVar("A")
# So many identities are remembered online, those in view and the newest: cameras run for days.
KEPT = 10_000


class FalseOdds(Protocol):
    """How likely what lies somewhere is a false alarm."""

    def log(self, z: F8, first: Bool) -> F8:
        """(N,) logarithms of the odds at boxes ``z`` (4, N) as centres and sizes; ``first``: seen for the first time."""


@dataclass(frozen=True, slots=True)
class VettedState(Generic[A]):
    """The associator's state, and of the identities given online (a,), ascending, the least odds on their way."""

    inner: A
    identity: I8 = field(default_factory=lambda: np.zeros(0, np.int64))
    odds: F8 = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, slots=True)
class Vetted(Generic[A]):
    """An associator whose tracks are believed once they have been where objects are likelier than false alarms.

    ``sure``: the logarithm of the odds below which who is followed online is confirmed at once, before the associator does.
    """

    associator: Associator[A]
    false: FalseOdds
    sure: float = -np.inf

    def start(self) -> VettedState[A]:
        """Nothing seen."""
        return VettedState(self.associator.start())

    def extend(
        self, state: VettedState[A], estimates: Estimates, z: F8, number: int, dt: float, model: Model
    ) -> tuple[VettedState[A], Tracks]:
        """The online rows, confirmed where the track is believed too, or is surely an object's."""
        inner, rows = self.associator.extend(state.inner, estimates, z, number, dt, model)
        return self._judged(replace(state, inner=inner), rows)

    def flush(self, state: VettedState[A], model: Model) -> Tracks:
        """The online rows still held back by the output delay."""
        return self._judged(state, self.associator.flush(state.inner, model))[1]

    def finish(self, state: VettedState[A], model: Model) -> Tracks:
        """The corrected tracks, each from where it is believed on; identities from 1, in the associator's order."""
        return believed(self.associator.finish(state.inner, model), self.false)

    def measured(self, state: VettedState[A]) -> Measured:
        """The measurements of everything that is remembered."""
        return self.associator.measured(state.inner)

    def _judged(self, state: VettedState[A], rows: Tracks) -> tuple[VettedState[A], Tracks]:
        """The rows, confirmed or not as their tracks' odds say; of several frames in their order."""
        # Who is believed stays so, and mostly everybody is.
        known = _known(state, rows.identity)
        if ((known < self.sure) | (rows.confirmed & (known < 0))).all():
            return state, replace(rows, confirmed=np.ones(len(rows), np.bool_))
        confirmed = rows.confirmed.copy()
        for frame in np.unique(rows.frame):
            here = np.flatnonzero(rows.frame == frame)
            state, odds = self._counted(state, rows.take(here))
            confirmed[here] = (odds < self.sure) | (confirmed[here] & (odds < 0))
        return state, replace(rows, confirmed=confirmed)

    def _counted(self, state: VettedState[A], rows: Tracks) -> tuple[VettedState[A], F8]:
        """The state with the rows of a frame, and the least odds of each row's identity."""
        before = _known(state, rows.identity)
        odds = np.minimum(before, _odds(rows, np.isinf(before), self.false))
        others = np.flatnonzero(~np.isin(state.identity, rows.identity))[-max(KEPT - len(rows), 1) :]
        identity = np.concatenate([state.identity[others], rows.identity])
        least = np.concatenate([state.odds[others], odds])
        order = np.argsort(identity)
        return VettedState(state.inner, identity[order], least[order]), odds


def _known(state: VettedState[A], identity: I8) -> F8:
    """(M,) the least odds so far of these identities; ∞ of those that are not remembered."""
    if len(state.identity) == 0:
        return np.full(len(identity), np.inf)
    place = np.minimum(np.searchsorted(state.identity, identity), len(state.identity) - 1)
    return np.where(state.identity[place] == identity, state.odds[place], np.inf)


def believed(tracks: Tracks, false: FalseOdds) -> Tracks:
    """Tracks, each from where it is believed on; identities from 1, in the order that they had."""
    kept = np.zeros(len(tracks), np.bool_)
    order = np.lexsort((tracks.frame, tracks.identity))
    for rows in np.split(order, np.flatnonzero(np.diff(tracks.identity[order])) + 1):
        way = tracks.take(rows)
        first = ~way.predicted & (np.cumsum(~way.predicted) == 1)
        kept[rows] = np.minimum.accumulate(_odds(way, first, false)) < 0
    left = tracks.take(kept)
    _, name = np.unique(left.identity, return_inverse=True)
    return replace(left, identity=name.astype(np.int64) + 1)


def _odds(rows: Tracks, first: Bool, false: FalseOdds) -> F8:
    """(M,) of rows that rest on a detection; of others nothing is known."""
    odds = np.full(len(rows), np.inf)
    seen = np.flatnonzero(rows.detection >= 0)
    odds[seen] = false.log(to_cxcywh(rows.xyxy[seen]), first[seen])
    return odds
