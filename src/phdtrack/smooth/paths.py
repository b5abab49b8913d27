"""Trajectories as rows: a trajectory has a row in every frame from its first measurement to its
last.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.types import I8, Bool, MeasurementHistory, Tracks


@dataclass(frozen=True, slots=True, eq=False)
class Paths:
    """K trajectories, end to end.

    Attributes
    ----------
    start : (K + 1,) path k has the rows from start[k] to start[k + 1] − 1.
    frame : (M,) place of each row's frame among those of the sequence; along a path it grows by
        one.
    measurement : (M,) the measurement that the row rests on, −1 where there is none; never −1 in
        first and last rows.
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
    def path(self) -> I8:
        """(M,) the path of each row."""
        return np.repeat(np.arange(len(self)), np.diff(self.start))

    def select(self, wanted: Bool) -> Paths:
        """The paths that are ``wanted`` (K,)."""
        rows = wanted[self.path]
        length = np.diff(self.start)[wanted]
        start = np.concatenate(([0], np.cumsum(length)))
        return Paths(start, self.frame[rows], self.measurement[rows], self.row[rows])

    def repeated(self, times: int) -> Paths:
        """All paths in their order, and again, so many times."""
        start = np.concatenate(([0], np.cumsum(np.tile(np.diff(self.start), times))))
        return Paths(
            start, *(np.tile(part, times) for part in (self.frame, self.measurement, self.row))
        )


def paths_of(tracks: Tracks, measurements: MeasurementHistory) -> Paths:
    """The tracks from their first measurement to their last, in the order of their identities.

    A track that rests on no measurement has no path. A measurement that several tracks rest on (one
    box of two people) is given to none of them.
    """
    place = np.searchsorted(measurements.number, tracks.frame)
    column = np.where(tracks.detection >= 0, measurements.start[place] + tracks.detection, -1)
    shared = np.bincount(column[column >= 0], minlength=measurements.z.shape[1]) > 1
    column[column >= 0] = np.where(shared[column[column >= 0]], -1, column[column >= 0])
    order = np.lexsort((place, tracks.identity))
    measured = order[column[order] >= 0]
    names, first, count = np.unique(
        tracks.identity[measured], return_index=True, return_counts=True
    )
    begin = place[measured[first]]
    end = place[measured[first + count - 1]]
    at = np.minimum(np.searchsorted(names, tracks.identity), max(len(names) - 1, 0))
    held = np.flatnonzero(np.isin(tracks.identity, names))
    held = held[(place[held] >= begin[at[held]]) & (place[held] <= end[at[held]])]
    return _laid_out((begin, end), at[held], place[held], column[held], held)


def joined(paths: Paths, chain: I8) -> Paths:
    """Paths of one ``chain`` (K,), numbered from 0, as one path; rows between its paths rest on
    nothing.

    Where two overlap in time, a measurement is preferred to none, and of two measurements the
    earlier path's is taken up to the middle of the overlap, and the later one's from there on.
    """
    begin = paths.frame[paths.first]
    end = paths.frame[paths.last]
    order = np.lexsort((begin, chain))
    follows = chain[order][1:] == chain[order][:-1]
    since = begin.copy()
    until = end + 1
    before = order[:-1][follows]
    after = order[1:][follows]
    middle = (begin[after] + end[before] + 1) // 2
    since[after] = np.maximum(since[after], middle)
    until[before] = np.minimum(until[before], middle)
    path = paths.path
    preferred = (paths.frame >= since[path]) & (paths.frame < until[path])
    rank = np.argsort(2 * (paths.measurement >= 0) + preferred, kind="stable")
    first, last = np.full((2, chain.max(initial=-1) + 1), end.max(initial=0) + 1, np.int64)
    last[:] = -1
    np.minimum.at(first, chain, begin)
    np.maximum.at(last, chain, end)
    return _laid_out(
        (first, last),
        chain[path][rank],
        paths.frame[rank],
        paths.measurement[rank],
        paths.row[rank],
    )


def _laid_out(ends: tuple[I8, I8], path: I8, frame: I8, measurement: I8, row: I8) -> Paths:
    """Paths between their ``ends`` (K,) with what is known of some of their rows, the last of it
    where there is more.
    """
    begin, end = ends
    start = np.concatenate(([0], np.cumsum(end - begin + 1)))
    at = start[path] + frame - begin[path]
    frames = np.arange(start[-1]) - np.repeat(start[:-1] - begin, end - begin + 1)
    rests, comes = np.full((2, start[-1]), -1, np.int64)
    rests[at] = measurement
    comes[at] = row
    return Paths(start, frames, rests, comes)
