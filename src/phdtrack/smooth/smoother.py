"""Trajectories as rows, and the smoothed state of every row.

A trajectory has a row in every frame from its first measurement to its last, also where nothing was measured. All of them go
through the frames together, so that the motion is asked once a frame (`models.rts`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from phdtrack.models.rts import Ahead, predict, smooth_back, update
from phdtrack.protocols import Motion, Sensor
from phdtrack.types import F8, I8, STILL, Bool, MeasurementHistory, Tracks


@dataclass(frozen=True, slots=True, eq=False)
class Paths:
    """K trajectories, end to end.

    Attributes
    ----------
    start : (K + 1,) path k has the rows from start[k] to start[k + 1] − 1.
    frame : (M,) place of each row's frame among those of the sequence; along a path it grows by one.
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
    def path(self) -> I8:
        """(M,) the path of each row."""
        return np.repeat(np.arange(len(self)), np.diff(self.start))

    def take(self, wanted: Bool) -> Paths:
        """The paths that are ``wanted`` (K,)."""
        rows, length = wanted[self.path], np.diff(self.start)[wanted]
        start = np.concatenate(([0], np.cumsum(length)))
        return Paths(start, self.frame[rows], self.measurement[rows], self.row[rows])


class Smoothed(NamedTuple):
    """Of each row the state given all of its path's measurements: ``mean`` (M, d) and ``covariance`` (M, d, d)."""

    mean: F8
    covariance: F8


def paths_of(tracks: Tracks, measurements: MeasurementHistory) -> Paths:
    """The tracks from their first measurement to their last, in the order of their identities.

    A track that rests on no measurement has no path. A measurement that several tracks rest on (one box of two people) is
    given to none of them.
    """
    place = np.searchsorted(measurements.number, tracks.frame)
    column = np.where(tracks.detection >= 0, measurements.start[place] + tracks.detection, -1)
    shared = np.bincount(column[column >= 0], minlength=measurements.z.shape[1]) > 1
    column[column >= 0] = np.where(shared[column[column >= 0]], -1, column[column >= 0])
    order = np.lexsort((place, tracks.identity))
    measured = order[column[order] >= 0]
    names, first, count = np.unique(tracks.identity[measured], return_index=True, return_counts=True)
    begin, end = place[measured[first]], place[measured[first + count - 1]]
    at = np.minimum(np.searchsorted(names, tracks.identity), max(len(names) - 1, 0))
    held = np.flatnonzero(np.isin(tracks.identity, names))
    held = held[(place[held] >= begin[at[held]]) & (place[held] <= end[at[held]])]
    return _laid_out((begin, end), at[held], place[held], column[held], held)


def joined(paths: Paths, chain: I8) -> Paths:
    """Paths of one ``chain`` (K,), numbered from 0, as one path; rows between its paths rest on nothing.

    Where two overlap in time, a measurement is preferred to none, and of two measurements the earlier path's is taken up to
    the middle of the overlap, and the later one's from there on.
    """
    begin, end = paths.frame[paths.first], paths.frame[paths.last]
    order = np.lexsort((begin, chain))
    follows = chain[order][1:] == chain[order][:-1]
    since, until = begin.copy(), end + 1
    before, after = order[:-1][follows], order[1:][follows]
    middle = (begin[after] + end[before] + 1) // 2
    since[after], until[before] = np.maximum(since[after], middle), np.minimum(until[before], middle)
    path = paths.path
    preferred = (paths.frame >= since[path]) & (paths.frame < until[path])
    rank = np.argsort(2 * (paths.measurement >= 0) + preferred, kind="stable")
    first, last = np.full((2, chain.max(initial=-1) + 1), end.max(initial=0) + 1, np.int64)
    last[:] = -1
    np.minimum.at(first, chain, begin)
    np.maximum.at(last, chain, end)
    return _laid_out((first, last), chain[path][rank], paths.frame[rank], paths.measurement[rank], paths.row[rank])


def _laid_out(ends: tuple[I8, I8], path: I8, frame: I8, measurement: I8, row: I8) -> Paths:
    """Paths between their ``ends`` (K,) with what is known of some of their rows, the last of it where there is more."""
    begin, end = ends
    start = np.concatenate(([0], np.cumsum(end - begin + 1)))
    at = start[path] + frame - begin[path]
    frames = np.arange(start[-1]) - np.repeat(start[:-1] - begin, end - begin + 1)
    rests, comes = np.full((2, start[-1]), -1, np.int64)
    rests[at], comes[at] = measurement, row
    return Paths(start, frames, rests, comes)


@dataclass(frozen=True, slots=True, eq=False)
class Sequence:
    """What is known of a whole sequence: its Z measurements, the same as states, and the motion.

    ``state`` (d, Z), ``covariance`` (Z, d, d), of which a measurement shows the rows ``observed``. Rows that no measurement
    shows, as a velocity, have their prior mean and covariance.
    """

    measurements: MeasurementHistory
    state: F8
    covariance: F8
    observed: I8
    motion: Motion

    @classmethod
    def of(cls, measurements: MeasurementHistory, sensor: Sensor, motion: Motion) -> Sequence:
        """The measurements as the sensor's states.

        Parameters
        ----------
        measurements : of the sequence.
        sensor, motion : the model's.

        Returns
        -------
        The sequence.
        """
        return cls(measurements, *sensor.states(measurements.z), np.array(sensor.observed, np.int64), motion)

    def components(self) -> I8:
        """The rows of the state that later states depend on; not a size that a transition forgets."""
        _, jacobian, _ = self.motion.transition(np.ascontiguousarray(self.state[:, :1]), 1.0)
        return np.flatnonzero(jacobian[0].any(axis=0)).astype(np.int64)

    def ahead(self, mean: F8, covariance: F8, place: int) -> Ahead:
        """States of the frame before ``place``, predicted for that frame.

        Parameters
        ----------
        mean, covariance : (n, d), (n, d, d).
        place : of the frame in the sequence.

        Returns
        -------
        The predictions.
        """
        time, warp = self.measurements.time, self.measurements.warp
        return predict(
            self.motion, mean, covariance, float(time[place] - time[place - 1]), warp[place] if len(warp) else STILL
        )  # fmt: skip

    def smooth(self, paths: Paths) -> Smoothed:
        """The states of all rows of the paths, given their measurements [R65]."""
        order, number, shown = np.argsort(paths.frame, kind="stable"), len(self.measurements.time), self.observed
        bounds = np.searchsorted(paths.frame[order], np.arange(number + 1))
        size, d = len(order), len(self.state)
        mean, predicted = np.empty((2, size, d))
        cov, expected, jacobian = np.empty((3, size, d, d))
        column = paths.measurement[paths.first]
        mean[paths.first], cov[paths.first] = self.state[:, column].T, self.covariance[column]
        going = np.ones(size, np.bool_)
        going[paths.first] = False
        frames = [rows[going[rows]] for rows in np.split(order, bounds[1:-1])]
        for p, rows in enumerate(frames):
            if len(rows) == 0:
                continue
            predicted[rows], expected[rows], jacobian[rows] = self.ahead(mean[rows - 1], cov[rows - 1], p)
            mean[rows], cov[rows] = predicted[rows], expected[rows]
            rows = rows[paths.measurement[rows] >= 0]
            if len(rows):
                column = paths.measurement[rows]
                noise = self.covariance[column][:, shown[:, None], shown]
                mean[rows], cov[rows] = update(mean[rows], cov[rows], self.state[shown[:, None], column].T, noise, shown)
        for rows in reversed(frames):
            if len(rows):
                step = Ahead(predicted[rows], expected[rows], jacobian[rows])
                mean[rows - 1], cov[rows - 1] = smooth_back(mean[rows - 1], cov[rows - 1], step, mean[rows], cov[rows])
        return Smoothed(mean, cov)
