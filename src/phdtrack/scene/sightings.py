"""What is known of every identity that the tracker has given: whether it is somebody, or a place that fires.

A false alarm that comes back in the same place is a track like any other for a filter that does not know the place. What
tells it from an object is that it has no memory: it is seen in fewer frames than an object would be, and it never goes
anywhere. So a confirmed track is believed where its detections have spread with a deviation of 0.4 of its width or height (a
walk over 1.4 of them), or where they came as often as p_D says: with h of n frames detected, where

    h log(p_D/q) + (n − h) log((1 − p_D)/(1 − q)) > 0,     q = p_D/2

which is the case from h/n = 0.71 on for p_D = 0.9. An object that stands still and is seen no more often than every second
frame cannot be told from a place that fires, and a place that fires nine times in ten not from an object.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from phdtrack.arrays import to_cxcywh
from phdtrack.types import F8, I8, Bool, Tracks

# Deviation of a track's centres, in its widths or heights, from which it has gone somewhere.
WENT = 0.4
_NONE: I8 = np.zeros(0, np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """Identities (n,), ascending, of the tracks of the last seconds.

    ``first``, ``last`` (n,): places of their first and last detections, counted in observed frames. ``hits`` (n,): frames in
    which they were detected; of the boxes then, centres and sizes, ``sums`` (4, n), and ``squares`` (2, n) of the centres.
    ``confirmed`` (n,).
    """

    identity: I8
    first: I8
    last: I8
    hits: I8
    sums: F8
    squares: F8
    confirmed: Bool

    @classmethod
    def none(cls) -> Sightings:
        """Nobody yet."""
        return cls(_NONE, _NONE, _NONE, _NONE, np.zeros((4, 0)), np.zeros((2, 0)), np.zeros(0, np.bool_))

    def __len__(self) -> int:
        return len(self.identity)

    def since(self, place: int) -> Sightings:
        """Without those that were last detected before ``place``."""
        kept = self.last >= place
        if kept.all():
            return self
        return Sightings(
            self.identity[kept],
            self.first[kept],
            self.last[kept],
            self.hits[kept],
            self.sums[:, kept],
            self.squares[:, kept],
            self.confirmed[kept],
        )

    def met(self, rows: Tracks, place: I8) -> Sightings:
        """With more rows of tracks, of frames at the places (M,)."""
        seen = rows.detection >= 0
        rows, place = rows.take(seen), place[seen]
        if not len(rows):
            return self
        identity = np.union1d(self.identity, rows.identity)
        n, old, new = len(identity), np.searchsorted(identity, self.identity), np.searchsorted(identity, rows.identity)
        far = np.iinfo(np.int64).max
        first, last, hits = np.full(n, far), np.full(n, -1), np.zeros(n, np.int64)
        sums, squares, confirmed = np.zeros((4, n)), np.zeros((2, n)), np.zeros(n, np.bool_)
        first[old], last[old], hits[old], confirmed[old] = self.first, self.last, self.hits, self.confirmed
        sums[:, old], squares[:, old] = self.sums, self.squares
        box = to_cxcywh(rows.xyxy)
        np.minimum.at(first, new, place)
        np.maximum.at(last, new, place)
        hits += np.bincount(new, minlength=n)
        for r in range(4):
            sums[r] += np.bincount(new, box[r], n)
        for r in range(2):
            squares[r] += np.bincount(new, np.square(box[r]), n)
        np.logical_or.at(confirmed, new, rows.confirmed)
        return Sightings(identity, first, last, hits, sums, squares, confirmed)

    def went(self) -> Bool:
        """(n,) whether each has gone somewhere."""
        mean, size = self.sums[:2] / self.hits, self.sums[2:] / self.hits
        spread: Bool = self.squares / self.hits - np.square(mean) > np.square(WENT * size)
        far: Bool = spread[0] | spread[1]
        return far

    def believed(self, detection: float) -> Bool:
        """(n,) whether each is somebody, where objects are detected with this probability."""
        p = min(max(detection, 0.01), 0.99)
        missed = self.last - self.first + 1 - self.hits
        seen = self.hits * math.log(2) + missed * math.log((1 - p) / (1 - p / 2)) > 0
        believed: Bool = self.confirmed & (self.went() | seen)
        return believed

    def of(self, identity: I8, values: Bool) -> Bool:
        """(M,) the ``values`` (n,) of the identities (M,); False for those that are not known."""
        if not len(self):
            return np.zeros(len(identity), np.bool_)
        place = np.minimum(np.searchsorted(self.identity, identity), len(self) - 1)
        found: Bool = values[place] & (self.identity[place] == identity)
        return found
