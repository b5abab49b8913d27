"""Tracks that stay where a scene's false alarms are, held back: identities behind what a person has taught of the scene.

Whether a track is a false alarm's or an object's never changes, and false alarms stay where they are. So the odds that a
track is a false alarm's are those of the place on its way where false alarms are the rarest, and it is believed from the
first row on at which an object is the likelier. What an object's track tells before is left out, as is what a false alarm's
told before somebody took it over.

Online, tracks are confirmed after some states, because most of what is seen once or twice is false. Where the scene says
that it is not, this need not be waited for: who has been where false alarms are rare among objects is confirmed at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Generic, Protocol, TypeVar

import numpy as np

from phdtrack.arrays import to_cxcywh
from phdtrack.checks import NonNegative, PositiveCount, check
from phdtrack.kernels.vetting import remembered, unbelieved
from phdtrack.protocols import Associator, Model
from phdtrack.types import F8, I8, Bool, Estimates, MeasurementHistory, Tracks

A = TypeVar("A")
# So many identities are remembered online, those in view and the newest: cameras run for days.
KEPT = 10_000


class FalseOdds(Protocol):
    """How likely what lies somewhere is a false alarm."""

    def log(self, z: F8) -> F8:
        """(2, N) logarithms of the odds at boxes ``z`` (4, N), centres and sizes: of those that are followed, and of any."""


@dataclass(frozen=True, slots=True)
class RejectionState(Generic[A]):
    """The associator's state, and of the identities given online (a,), ascending, the least odds (2, a) on their way."""

    inner: A
    identity: I8 = field(default_factory=lambda: np.zeros(0, np.int64))
    odds: F8 = field(default_factory=lambda: np.zeros((2, 0)))


@dataclass(frozen=True, slots=True)
class FalseTrackRejection(Generic[A]):
    """An associator whose tracks are believed once they have been where objects are likelier than false alarms.

    Parameters
    ----------
    immediate_confirmation : odds of any false alarm below which who is followed online is confirmed at once, before the
        associator does.
    min_track_length : corrected tracks of which fewer rows that rest on detections are believed are left out.
    """

    associator: Associator[A]
    false: FalseOdds
    immediate_confirmation: NonNegative = 0.0
    min_track_length: PositiveCount = 1

    def __post_init__(self) -> None:
        check(self)

    def start(self) -> RejectionState[A]:
        """Nothing seen."""
        return RejectionState(self.associator.start())

    def extend(
        self, state: RejectionState[A], estimates: Estimates, z: F8, number: int, dt: float, model: Model
    ) -> tuple[RejectionState[A], Tracks]:
        """The online rows, confirmed where the track is believed too, or is surely an object's."""
        inner, rows = self.associator.extend(state.inner, estimates, z, number, dt, model)
        return self._judged(RejectionState(inner, state.identity, state.odds), rows)

    def flush(self, state: RejectionState[A], model: Model) -> Tracks:
        """The online rows still held back by the output delay."""
        return self._judged(state, self.associator.flush(state.inner, model))[1]

    def finish(self, state: RejectionState[A], model: Model) -> Tracks:
        """The corrected tracks, each from where it is believed on; identities from 1, in the associator's order."""
        return believed(self.associator.finish(state.inner, model), self.false, self.min_track_length)

    def measurements(self, state: RejectionState[A]) -> MeasurementHistory:
        """The measurements of everything that is remembered."""
        return self.associator.measurements(state.inner)

    def _judged(self, state: RejectionState[A], rows: Tracks) -> tuple[RejectionState[A], Tracks]:
        """The rows, confirmed or not as their tracks' odds say; of several frames in their order."""
        if len(rows) == 0 or rows.frame[0] == rows.frame[-1]:
            state, confirmed = self._confirmed(state, rows)
        else:
            confirmed = rows.confirmed.copy()
            for frame in np.unique(rows.frame):
                here = np.flatnonzero(rows.frame == frame)
                state, confirmed[here] = self._confirmed(state, rows.take(here))
        return state, Tracks(rows.frame, rows.identity, rows.xyxy, rows.confidence, rows.detection, confirmed)

    def _confirmed(self, state: RejectionState[A], rows: Tracks) -> tuple[RejectionState[A], Bool]:
        """The state with the rows of a frame, and who is believed and confirmed by the associator, or surely somebody.

        Who is so already is not asked again.
        """
        sure = math.log(self.immediate_confirmation) if self.immediate_confirmation > 0 else -math.inf
        confirmed, which, least, z = unbelieved(
            state.identity, state.odds, rows.identity, rows.detection, rows.confirmed, rows.xyxy, sure
        )
        if len(which) == 0:
            return state, confirmed
        identity, odds, confirmed = remembered(
            state.identity, state.odds, rows.identity, rows.confirmed, confirmed, which, least, self.false.log(z), sure, KEPT
        )
        return RejectionState(state.inner, identity, odds), confirmed


def believed(tracks: Tracks, false: FalseOdds, shortest: int = 1) -> Tracks:
    """Tracks, each from where it is believed on, if so many rows on detections are left; identities from 1, in order."""
    kept = np.zeros(len(tracks), np.bool_)
    order = np.lexsort((tracks.frame, tracks.identity))
    for rows in np.split(order, np.flatnonzero(np.diff(tracks.identity[order])) + 1):
        way = tracks.take(rows)
        trusted = np.minimum.accumulate(_odds(way, false)[0]) < 0
        kept[rows] = trusted & (np.count_nonzero(trusted & (way.detection >= 0)) >= shortest)
    left = tracks.take(kept)
    _, name = np.unique(left.identity, return_inverse=True)
    return replace(left, identity=name.astype(np.int64) + 1)


def _odds(rows: Tracks, false: FalseOdds) -> F8:
    """(2, M) of rows that rest on a detection; of others nothing is known."""
    odds = np.full((2, len(rows)), np.inf)
    seen = np.flatnonzero(rows.detection >= 0)
    odds[:, seen] = false.log(to_cxcywh(rows.xyxy[seen]))
    return odds
