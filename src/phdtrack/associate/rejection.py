"""False-track rejection: tracks are withheld until they have been where real targets are likelier
than false tracks.

A track is a false alarm's or a target's for good, and false alarms stay where they are. So the
likelihood ratio of a track is the least of the places that it has been at, and the track is
confirmed from the first row at which this is below one. Rows before are left out.

Online, tracks are confirmed after some states, because most of what is detected once or twice is
false. A track that has been where false alarms of any kind are rare is confirmed at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Generic, TypeVar

import numpy as np

from phdtrack.arrays import to_cxcywh
from phdtrack.errors import Checked, NonNegative, PositiveCount
from phdtrack.kernels.false_tracks import genuine_so_far
from phdtrack.models.scene import FalseAlarmRatio
from phdtrack.protocols import Associator, Model
from phdtrack.types import (
    F8,
    I8,
    Appeared,
    Bool,
    Detections,
    Estimates,
    Exchange,
    MeasurementHistory,
    Return,
    Tracks,
)

A = TypeVar("A")
# Identities that are remembered online, besides those in view: cameras run for days.
KEPT = 10_000


@dataclass(frozen=True, slots=True)
class RejectionState(Generic[A]):
    """The associator's state; and of the identities of online rows (a,), ascending, the least
    log-ratios (2, a) so far.
    """

    inner: A
    identity: I8 = field(default_factory=lambda: np.zeros(0, np.int64))
    least: F8 = field(default_factory=lambda: np.zeros((2, 0)))


@dataclass(frozen=True, slots=True)
class FalseTrackRejection(Checked, Generic[A]):
    """An associator whose tracks are withheld where a scene's false alarms are.

    Parameters
    ----------
    associator : assigns the identities.
    ratio : false alarms over targets, by place.
    immediate_confirmation : ratio of any false alarm below which an online track is confirmed at
        once.
    min_track_length : rows that rest on detections, from its confirmation on, below which a
        corrected track is discarded.
    """

    associator: Associator[A]
    ratio: FalseAlarmRatio
    immediate_confirmation: NonNegative = 0.1
    min_track_length: PositiveCount = 1

    def start(self) -> RejectionState[A]:
        """Nothing seen."""
        return RejectionState(self.associator.start())

    def extend(
        self,
        state: RejectionState[A],
        estimates: Estimates,
        z: F8,
        detections: Detections,
        number: int,
        dt: float,
        model: Model,
    ) -> tuple[RejectionState[A], Tracks]:
        """The associator's online rows, with what is confirmed."""
        inner, rows = self.associator.extend(
            state.inner, estimates, z, detections, number, dt, model
        )
        return self._judged(replace(state, inner=inner), rows)

    def flush(self, state: RejectionState[A], model: Model) -> Tracks:
        """The online rows still held back by the output delay."""
        return self._judged(state, self.associator.flush(state.inner, model))[1]

    def finish(self, state: RejectionState[A], model: Model) -> Tracks:
        """The corrected tracks, each from its confirmation on; identities from 1, in the
        associator's order.
        """
        return without_false_tracks(
            self.associator.finish(state.inner, model), self.ratio, self.min_track_length
        )

    def measurements(self, state: RejectionState[A]) -> MeasurementHistory:
        """The measurements of everything that is remembered."""
        return self.associator.measurements(state.inner)

    def returns(self, state: RejectionState[A]) -> tuple[Return, ...]:
        """The identities that targets have taken again, oldest first."""
        return self.associator.returns(state.inner)

    def exchanges(self, state: RejectionState[A]) -> tuple[Exchange, ...]:
        """The identities that targets have exchanged, oldest first."""
        return self.associator.exchanges(state.inner)

    def appeared(self, state: RejectionState[A], seen: Appeared) -> Appeared:
        """The looks of the newest frame's targets, as the associator has them."""
        return self.associator.appeared(state.inner, seen)

    def oldest(self, state: RejectionState[A]) -> int:
        """The number of the first frame that is remembered."""
        return self.associator.oldest(state.inner)

    def numbered_after(self, state: RejectionState[A], identity: int) -> RejectionState[A]:
        """The state that numbers new tracks from ``identity`` + 1 on."""
        return replace(state, inner=self.associator.numbered_after(state.inner, identity))

    def _judged(self, state: RejectionState[A], rows: Tracks) -> tuple[RejectionState[A], Tracks]:
        """The rows, confirmed or not by their tracks' ratios, frame by frame."""
        confirmed = rows.confirmed.copy()
        begins = np.flatnonzero(np.diff(rows.frame)) + 1
        for begin, end in pairwise((0, *begins.tolist(), len(rows))):
            here = slice(begin, end)
            state, confirmed[here] = self._confirmed(state, rows, here)
        return state, replace(rows, confirmed=confirmed)

    def _confirmed(
        self, state: RejectionState[A], rows: Tracks, here: slice
    ) -> tuple[RejectionState[A], Bool]:
        """The state with the rows of a frame, which are ``here``, and which of them are confirmed.
        Confirmed tracks are not asked for again.
        """
        identity = rows.identity[here]
        of_associator = rows.confirmed[here]
        least, confirmed = genuine_so_far(
            state.identity, state.least, identity, of_associator, self._limit
        )
        asked = np.flatnonzero(~confirmed & (rows.detection[here] >= 0))
        if len(asked) == 0:
            return state, confirmed
        boxes = to_cxcywh(rows.xyxy[here][asked])
        least[:, asked] = np.minimum(least[:, asked], self.ratio.log(boxes))
        others = ~np.isin(state.identity, identity[asked])
        known = np.concatenate((state.identity[others], identity[asked]))
        values = np.concatenate((state.least[:, others], least[:, asked]), axis=1)
        order = np.argsort(known)
        # The oldest that are not in this frame are forgotten.
        spare = np.flatnonzero(~np.isin(known[order], identity))[: max(len(known) - KEPT, 0)]
        order = np.delete(order, spare)
        state = RejectionState(state.inner, known[order], values.take(order, axis=1))
        _, confirmed = genuine_so_far(
            state.identity, state.least, identity, of_associator, self._limit
        )
        return state, confirmed

    @property
    def _limit(self) -> float:
        """The logarithm of `immediate_confirmation`."""
        share = self.immediate_confirmation
        return math.log(share) if share > 0 else -math.inf


def without_false_tracks(
    tracks: Tracks, ratio: FalseAlarmRatio, min_track_length: int = 1
) -> Tracks:
    """Tracks, each from its confirmation on; identities from 1, in order.

    Parameters
    ----------
    tracks : corrected tracks.
    ratio : false alarms over targets, by place.
    min_track_length : rows that rest on detections below which a track is left out.
    """
    kept = np.zeros(len(tracks), np.bool_)
    order = np.lexsort((tracks.frame, tracks.identity))
    for rows in np.split(order, np.flatnonzero(np.diff(tracks.identity[order])) + 1):
        seen = np.flatnonzero(tracks.detection[rows] >= 0)
        logs = np.full(len(rows), np.inf)
        logs[seen] = ratio.log(to_cxcywh(tracks.xyxy[rows[seen]]))[0]
        confirmed = np.minimum.accumulate(logs) < 0
        kept[rows] = confirmed & (np.count_nonzero(confirmed[seen]) >= min_track_length)
    left = tracks.select(kept)
    _, name = np.unique(left.identity, return_inverse=True)
    return replace(left, identity=name.astype(np.int64) + 1)
