"""Smoothed states of the trajectories of a whole sequence [R65].

All trajectories go through the frames together, so that the motion model is evaluated once per
frame (`models.rts`).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from phdtrack.kernels.rts import filtered, smooth
from phdtrack.models.rts import Ahead, moved
from phdtrack.protocols import Model, Motion
from phdtrack.smooth.looks import SequenceLooks
from phdtrack.smooth.paths import Paths
from phdtrack.types import F8, I8, STILL, MeasurementHistory

# A path's noises are these multiples of the model's deviations: its acceleration, the change of its
# size, its measurements.
ACCELERATION = (1.0, 3.0, 9.0)
SIZE_CHANGE = (0.25, 0.5, 1.0)
MEASUREMENT_NOISE = (0.4, 0.65, 1.0)


class Smoothed(NamedTuple):
    """The state of each row given all measurements of its path: ``mean`` (M, d) and ``covariance``
    (M, d, d).
    """

    mean: F8
    covariance: F8


class Scales(NamedTuple):
    """Standard deviations of a path's noises as multiples of the model's: (K, d) of states, (K, r)
    of measurements.
    """

    state: F8
    measurement: F8


class Filtered(NamedTuple):
    """The states of all rows given the measurements up to each, their predictions, and the log
    evidence (2, K) of the paths: of position, and of size.
    """

    mean: F8
    covariance: F8
    ahead: Ahead
    evidence: F8


@dataclass(frozen=True, slots=True, eq=False)
class Sequence:
    """The Z measurements of a whole sequence, and the motion model.

    Attributes
    ----------
    measurements : of all frames.
    state, covariance : (d, Z), (Z, d, d) the measurements as states. Components that no measurement
        shows, such as a velocity, have their prior mean and covariance.
    observed : the components of a state that a measurement shows.
    motion : the motion model.
    rate : its time units per second.
    boxes : (Z, 4) of the measurements.
    looks : what the boxes look like, None where that is not known.
    """

    measurements: MeasurementHistory
    state: F8
    covariance: F8
    observed: I8
    motion: Motion
    rate: float
    boxes: F8
    looks: SequenceLooks | None = None

    @classmethod
    def of(cls, measurements: MeasurementHistory, model: Model) -> Sequence:
        """The sequence of these measurements."""
        state, covariance = model.sensor.states(measurements.z)
        observed = np.array(model.sensor.observed, np.int64)
        boxes = model.sensor.boxes(state)
        known = SequenceLooks.of(measurements, boxes, model.appearance, model.rate)
        return cls(
            measurements, state, covariance, observed, model.motion, model.rate, boxes, known
        )

    def step(self, place: int) -> tuple[float, F8]:
        """The interval before a frame, and the camera's motion in it."""
        time = self.measurements.time
        warp = self.measurements.warp
        interval = float(time[place] - time[place - 1])
        return interval, warp[place] if len(warp) else STILL

    def smooth(self, paths: Paths, scales: Scales | None = None) -> Smoothed:
        """The states of all rows of the paths, given their measurements [R65]."""
        if scales is None:
            scales = self.scales(np.ones((4, len(paths))))
        forward = self.filtered(paths, scales)
        mean = forward.mean
        cov = forward.covariance
        same_path = paths.path[1:] == paths.path[:-1]
        smooth(
            (mean[:-1], cov[:-1]),
            tuple(part[1:] for part in forward.ahead),
            (mean[1:], cov[1:]),
            same_path,
        )
        return Smoothed(mean, cov)

    def fitting(self, paths: Paths) -> Scales:
        """The noises that maximise the likelihood of the measurements of each path.

        The noises of position are chosen by the innovations of the first two components of the
        measurements, and those of size by the others: they are nearly independent.
        """
        positions = np.array(list(itertools.product(ACCELERATION, MEASUREMENT_NOISE))).T
        sizes = np.array(list(itertools.product(SIZE_CHANGE, MEASUREMENT_NOISE))).T
        candidates = positions.shape[1]
        count = len(paths)
        factors = np.stack([positions[0], sizes[0], positions[1], sizes[1]])
        scales = self.scales(np.repeat(factors, count, axis=1))
        evidence = self.filtered(paths.repeated(candidates), scales, brief=True).evidence
        p, s = evidence.reshape(2, candidates, count).argmax(axis=1)
        return self.scales(np.stack([positions[0, p], sizes[0, s], positions[1, p], sizes[1, s]]))

    def scales(self, factors: F8) -> Scales:
        """The scales for factors (4, K) of acceleration, change of size, position noise and size
        noise.
        """
        d = len(self.state)
        r = len(self.observed)
        # The memory layout must not depend on the number of paths: kernels are compiled per layout.
        return Scales(
            np.repeat(factors[:2].T, [4, d - 4], axis=1),
            np.repeat(factors[2:].T, [2, r - 2], axis=1),
        )

    def filtered(self, paths: Paths, scales: Scales, *, brief: bool = False) -> Filtered:
        """The states of all rows of the paths, given the measurements up to each.

        Parameters
        ----------
        paths : the trajectories.
        scales : of their noises.
        brief : keep only the last state of each path, and no predictions.
        """
        observed = self.observed
        d = len(self.state)
        path = paths.path
        column = paths.measurement[paths.first]
        here = path if brief else np.arange(len(path))
        size = len(paths) if brief else len(path)
        mean = np.empty((size, d))
        cov = np.empty((size, d, d))
        evidence = np.zeros((2, len(paths)))
        first = self.covariance[column]
        first[:, observed[:, None], observed] *= (
            scales.measurement[:, :, None] * scales.measurement[:, None]
        )
        mean[here[paths.first]] = self.state[:, column].T
        cov[here[paths.first]] = first
        predictions = 0 if brief else size
        ahead = Ahead(np.empty((predictions, d)), *np.empty((3, predictions, d, d)))
        rows = np.flatnonzero(path[1:] == path[:-1]) + 1
        rows = rows[np.argsort(paths.frame[rows], kind="stable")]
        at = np.stack([here[rows - 1], here[rows], path[rows], paths.measurement[rows]], axis=1)
        bounds = np.searchsorted(paths.frame[rows], np.arange(len(self.measurements.time) + 1))
        measured = (
            np.ascontiguousarray(self.state),
            np.ascontiguousarray(self.covariance),
            observed,
        )
        for p in np.flatnonzero(np.diff(bounds)).tolist():
            frame_rows = at[bounds[p] : bounds[p + 1]]
            filtered(
                frame_rows,
                (mean, cov),
                moved(self.motion, mean[frame_rows[:, 0]], *self.step(p)),
                ahead,
                measured,
                (scales.state, scales.measurement),
                evidence,
            )
        return Filtered(mean, cov, ahead, evidence)
