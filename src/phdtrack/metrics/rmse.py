"""RMSE per target after association with the truth [D14 Tables I–III].

In each frame true and estimated points are mapped one to one for the least Σ min(d, gate), where d
is the Euclidean distance; pairs at a distance ≥ gate are not mapped. Over the frames in which
target i is mapped

    RMSE_i = √( mean ‖estimate − truth_i‖² )        and per axis √( mean (estimate − truth_i)² )

It measures the accuracy of the targets that are found, not how many are found.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.errors import InputError
from phdtrack.metrics.matching import cheapest, ratio
from phdtrack.types import F8, I8


@dataclass(frozen=True, slots=True, eq=False)
class TargetErrors:
    """Errors per target: ``identity`` (G,) ascending, ``frames`` (G,) in which it exists,
    ``mapped`` (G,) of these, and ``rmse_axis`` (d, G).

    Errors are in the unit of the points; NaN for a target that is never mapped.
    """

    identity: I8
    frames: I8
    mapped: I8
    rmse_axis: F8

    @property
    def rmse(self) -> F8:
        """(G,) RMSE of the position."""
        rmse: F8 = np.sqrt(np.square(self.rmse_axis).sum(axis=0))
        return rmse

    @property
    def overall(self) -> float:
        """RMSE over all mapped pairs of all targets; NaN without any."""
        squares = np.nansum(self.rmse**2 * self.mapped)
        return float(np.sqrt(ratio(float(squares), int(self.mapped.sum()))))

    def as_dict(self) -> dict[str, object]:
        """``overall``, and ``objects`` with identity, frames, mapped, rmse and rmse_axis each; NaN
        for those never mapped.
        """
        names = ("identity", "frames", "mapped", "rmse", "rmse_axis")
        columns = (self.identity, self.frames, self.mapped, self.rmse, self.rmse_axis.T)
        rows = zip(*(column.tolist() for column in columns), strict=True)
        return {
            "overall": self.overall,
            "objects": [dict(zip(names, row, strict=True)) for row in rows],
        }


def rmse_per_target(
    truth_frame: I8, truth_identity: I8, truth_point: F8, frame: I8, point: F8, gate: float
) -> TargetErrors:
    """Errors of estimated points against true ones [D14 Tables I–III]. Raises `InputError` for
    shapes that do not fit, points that are not finite, and a gate ≤ 0.

    Parameters
    ----------
    truth_frame, truth_identity, truth_point : (M,), (M,), (d, M) frame, identity and position of
        each true point.
    frame, point : (N,), (d, N) of the estimates.
    gate : distance from which a pair counts as a miss and a false estimate, in the unit of the
        points.

    Returns
    -------
    The errors of each target, in the unit of the points.
    """
    if not gate > 0:
        raise InputError(f"expected a gate > 0, got {gate}", where="gate")
    fits = (
        len(truth_frame) == len(truth_identity) == truth_point.shape[-1]
        and len(frame) == point.shape[-1]
        and len(truth_point) == len(point)
    )
    if not fits:
        raise InputError(
            "expected a frame and an identity per true point and a frame per estimate, got"
            f" {len(truth_frame)}, {len(truth_identity)}, {truth_point.shape} and {len(frame)},"
            f" {point.shape}",
            cure="Points are columns: (d, M) and (d, N).",
        )
    if not (np.isfinite(truth_point).all() and np.isfinite(point).all()):
        raise InputError("expected finite coordinates, got NaN or infinity")
    identity, target = np.unique(truth_identity, return_inverse=True)
    squares = np.zeros((len(truth_point), len(identity)))
    mapped = np.zeros(len(identity), np.int64)
    for number in np.unique(truth_frame):
        t = np.flatnonzero(truth_frame == number)
        e = np.flatnonzero(frame == number)
        difference = truth_point[:, t][:, :, None] - point[:, e][:, None]
        distance = np.sqrt((difference**2).sum(axis=0))
        rows, columns = cheapest(np.minimum(distance, gate))
        near = distance[rows, columns] < gate
        rows = t[rows[near]]
        columns = e[columns[near]]
        np.add.at(squares.T, target[rows], (point[:, columns] - truth_point[:, rows]).T ** 2)
        np.add.at(mapped, target[rows], 1)
    mean = np.divide(squares, mapped, out=np.full_like(squares, np.nan), where=mapped > 0)
    frames = np.bincount(target, minlength=len(identity)).astype(np.int64)
    return TargetErrors(identity, frames, mapped, np.sqrt(mean))
