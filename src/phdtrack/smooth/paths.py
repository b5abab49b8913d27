"""Trajectories as rows: one row in every frame from the first measurement to the last."""

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
    frame : (M,) index of each row's frame in the sequence; it grows by one along a path.
    measurement : (M,) the measurement of the row, −1 for none; never −1 in first and last rows.
    row : (M,) the corresponding row of the tracks, −1 for none.
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

    def track_of(self, measurements: MeasurementHistory) -> I8:
        """(Z,) the path that has each measurement, −1 for none."""
        out: I8 = np.full(measurements.z.shape[1], -1)
        seen = self.measurement >= 0
        out[self.measurement[seen]] = self.path[seen]
        return out

    def select(self, mask: Bool) -> Paths:
        """The paths for which ``mask`` (K,) is True."""
        rows = mask[self.path]
        length = np.diff(self.start)[mask]
        start = np.concatenate(([0], np.cumsum(length)))
        return Paths(start, self.frame[rows], self.measurement[rows], self.row[rows])

    def repeated(self, times: int) -> Paths:
        """All paths in their order, repeated so many times."""
        start = np.concatenate(([0], np.cumsum(np.tile(np.diff(self.start), times))))
        return Paths(
            start, *(np.tile(part, times) for part in (self.frame, self.measurement, self.row))
        )


def paths_of(tracks: Tracks, measurements: MeasurementHistory) -> Paths:
    """The tracks from their first measurement to their last, in the order of their identities.

    A track without measurements has no path. A measurement shared by several tracks (one box of two
    people) belongs to none of them.
    """
    place = np.searchsorted(measurements.number, tracks.frame)
    column = measurements.columns(tracks)
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
    rows = np.flatnonzero(np.isin(tracks.identity, names))
    rows = rows[(place[rows] >= begin[at[rows]]) & (place[rows] <= end[at[rows]])]
    return _filled((begin, end), at[rows], place[rows], column[rows], rows)


def joined(paths: Paths, chain: I8) -> Paths:
    """Join the paths of each ``chain`` (K,), numbered from 0. Rows between them have no
    measurement.

    Where two paths overlap in time, a measurement is preferred to none; of two measurements that of
    the earlier path is used up to the middle of the overlap, and that of the later one from there
    on.
    """
    begin = paths.frame[paths.first]
    end = paths.frame[paths.last]
    order = np.lexsort((begin, chain))
    follows = chain[order][1:] == chain[order][:-1]
    preferred_from = begin.copy()
    preferred_to = end + 1
    before = order[:-1][follows]
    after = order[1:][follows]
    middle = (begin[after] + end[before] + 1) // 2
    preferred_from[after] = np.maximum(preferred_from[after], middle)
    preferred_to[before] = np.minimum(preferred_to[before], middle)
    path = paths.path
    preferred = (paths.frame >= preferred_from[path]) & (paths.frame < preferred_to[path])
    rank = np.argsort(2 * (paths.measurement >= 0) + preferred, kind="stable")
    count = chain.max(initial=-1) + 1
    first = np.full(count, end.max(initial=0) + 1, np.int64)
    last = np.full(count, -1, np.int64)
    np.minimum.at(first, chain, begin)
    np.maximum.at(last, chain, end)
    return _filled(
        (first, last),
        chain[path][rank],
        paths.frame[rank],
        paths.measurement[rank],
        paths.row[rank],
    )


def _filled(ends: tuple[I8, I8], path: I8, frame: I8, measurement: I8, row: I8) -> Paths:
    """Paths between their ``ends`` (K,), filled with known rows; of several for one frame the last
    is used.
    """
    begin, end = ends
    start = np.concatenate(([0], np.cumsum(end - begin + 1)))
    at = start[path] + frame - begin[path]
    frames = np.arange(start[-1]) - np.repeat(start[:-1] - begin, end - begin + 1)
    measurements = np.full(start[-1], -1, np.int64)
    rows = np.full(start[-1], -1, np.int64)
    measurements[at] = measurement
    rows[at] = row
    return Paths(start, frames, measurements, rows)
