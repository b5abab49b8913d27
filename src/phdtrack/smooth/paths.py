"""Trajectories as rows, end to end: what is smoothed and joined.

A path has a row in every frame from its first measurement to its last, also where nothing was measured.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.protocols import Sensor
from phdtrack.types import F8, I8, Bool, MeasurementHistory, Tracks


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """The measurements as states: ``state`` (d, Z), ``covariance`` (Z, d, d), and which of their rows were ``observed``.

    What no measurement shows, as a velocity, has the mean and the covariance that it has before anything is known.
    """

    state: F8
    covariance: F8
    observed: I8

    @classmethod
    def of(cls, z: F8, sensor: Sensor) -> Seen:
        """Of the measurements (m, Z)."""
        return cls(*sensor.states(z), np.array(sensor.observed, np.int64))


@dataclass(frozen=True, slots=True, eq=False)
class Paths:
    """K trajectories, end to end.

    Attributes
    ----------
    start : (K + 1,) path k has the rows from start[k] to start[k + 1] − 1.
    frame : (M,) place of each row's frame among those that were seen; along a path it grows by one.
    measurement : (M,) the measurement that the row rests on, −1 where there is none; never −1 in first and last rows.
    row : (M,) the row of the tracks that it comes from, −1 where there is none.
    """

    start: I8
    frame: I8
    measurement: I8
    row: I8

    def __len__(self) -> int:
        return len(self.start) - 1

    @property
    def first(self) -> I8:
        """(K,) first rows."""
        return self.start[:-1]

    @property
    def last(self) -> I8:
        """(K,) last rows."""
        return self.start[1:] - 1

    @property
    def owner(self) -> I8:
        """(M,) the path of each row."""
        return np.repeat(np.arange(len(self)), np.diff(self.start))

    def take(self, wanted: Bool) -> Paths:
        """The paths that are ``wanted`` (K,)."""
        rows, length = wanted[self.owner], np.diff(self.start)[wanted]
        start = np.concatenate(([0], np.cumsum(length)))
        return Paths(start, self.frame[rows], self.measurement[rows], self.row[rows])


def paths_of(tracks: Tracks, measured: MeasurementHistory) -> Paths:
    """The tracks from their first measurement to their last, in the order of their identities.

    A track that rests on no measurement has no path. A measurement that several tracks rest on (one box of two people) tells
    where they all are and not where each is: none of them is given it.
    """
    place = np.searchsorted(measured.number, tracks.frame)
    column = np.where(tracks.detection >= 0, measured.start[place] + tracks.detection, -1)
    shared = np.bincount(column[column >= 0], minlength=measured.z.shape[1]) > 1
    column[column >= 0] = np.where(shared[column[column >= 0]], -1, column[column >= 0])
    order = np.lexsort((place, tracks.identity))
    sure = order[column[order] >= 0]
    names, first, count = np.unique(tracks.identity[sure], return_index=True, return_counts=True)
    begin, end = place[sure[first]], place[sure[first + count - 1]]
    at = np.minimum(np.searchsorted(names, tracks.identity), max(len(names) - 1, 0))
    held = np.flatnonzero(np.isin(tracks.identity, names))
    held = held[(place[held] >= begin[at[held]]) & (place[held] <= end[at[held]])]
    return _laid_out(begin, end, at[held], place[held], column[held], held)


def joined(paths: Paths, chain: I8) -> Paths:
    """Paths of one ``chain`` (K,), numbered from 0, each chain as one path; rows between its paths rest on nothing.

    Where two go on beside each other, a measurement goes before none, and of two measurements the earlier path's is taken up
    to the middle of what they share, and the later one's from there on.
    """
    begin, end = paths.frame[paths.first], paths.frame[paths.last]
    order = np.lexsort((begin, chain))
    follows = chain[order][1:] == chain[order][:-1]
    since, until = begin.copy(), end + 1
    before, after = order[:-1][follows], order[1:][follows]
    middle = (begin[after] + end[before] + 1) // 2
    since[after], until[before] = np.maximum(since[after], middle), np.minimum(until[before], middle)
    owner = paths.owner
    own = (paths.frame >= since[owner]) & (paths.frame < until[owner])
    rank = np.argsort(2 * (paths.measurement >= 0) + own, kind="stable")
    first, last = np.full((2, chain.max(initial=-1) + 1), end.max(initial=0) + 1, np.int64)
    last[:] = -1
    np.minimum.at(first, chain, begin)
    np.maximum.at(last, chain, end)
    return _laid_out(first, last, chain[owner][rank], paths.frame[rank], paths.measurement[rank], paths.row[rank])


def _laid_out(begin: I8, end: I8, owner: I8, frame: I8, measurement: I8, row: I8) -> Paths:
    """Paths from ``begin`` to ``end`` (K,) with what is known of some of their rows, the last of it where there is more."""
    start = np.concatenate(([0], np.cumsum(end - begin + 1)))
    at = start[owner] + frame - begin[owner]
    frames = np.arange(start[-1]) - np.repeat(start[:-1] - begin, end - begin + 1)
    rests, comes = np.full((2, start[-1]), -1, np.int64)
    rests[at], comes[at] = measurement, row
    return Paths(start, frames, rests, comes)


def chains(after: I8) -> I8:
    """(K,) the number of the chain that each path is in, with its successor ``after`` (K,), −1 for none.

    Chains are numbered in the order of their first paths.
    """
    follows = np.isin(np.arange(len(after)), after)
    chain = np.full(len(after), -1, np.int64)
    for number, head in enumerate(np.flatnonzero(~follows).tolist()):
        here = head
        while here >= 0:
            chain[here] = number
            here = int(after[here])
    return chain
