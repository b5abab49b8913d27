"""RMSE per target after association with the truth [D14 Tables I–III].

In each frame true and estimated points are mapped one to one for the least Σ min(d, gate), d the Euclidean distance; pairs
at a distance ≥ gate are apart. Over the frames in which target i is mapped

    RMSE_i = √( mean ‖estimate − truth_i‖² )        and per axis √( mean (estimate − truth_i)² )

It says how well targets are located that are located at all; read it beside the number of frames in which they were not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.errors import InputError
from phdtrack.metrics.assignment import cheapest
from phdtrack.metrics.ospa import euclidean
from phdtrack.types import F8, I8


@dataclass(frozen=True, slots=True, eq=False)
class TargetErrors:
    """Per target: ``identity`` (G,) ascending, ``frames`` (G,) in the truth, ``mapped`` (G,) of them, ``rmse_axis`` (d, G).

    Errors are in the unit of the points; NaN for a target that is never mapped.
    """

    identity: I8
    frames: I8
    mapped: I8
    rmse_axis: F8

    @property
    def rmse(self) -> F8:
        """(G,) RMSE of the position."""
        whole: F8 = np.sqrt((self.rmse_axis**2).sum(axis=0))
        return whole

    @property
    def overall(self) -> float:
        """RMSE over all mapped pairs of all targets; NaN without any."""
        seen = self.mapped > 0
        if not seen.any():
            return float("nan")
        return float(np.sqrt(np.average(self.rmse[seen] ** 2, weights=self.mapped[seen])))

    def as_dict(self) -> dict[str, object]:
        """``overall``, and ``objects`` with identity, frames, mapped, rmse and rmse_axis each; NaN where never mapped."""
        return {
            "overall": self.overall,
            "objects": [
                {
                    "identity": int(self.identity[i]),
                    "frames": int(self.frames[i]),
                    "mapped": int(self.mapped[i]),
                    "rmse": float(self.rmse[i]),
                    "rmse_axis": self.rmse_axis[:, i].tolist(),
                }
                for i in range(len(self.identity))
            ],
        }


def rmse_per_target(truth_frame: I8, truth_identity: I8, truth_point: F8, frame: I8, point: F8, gate: float) -> TargetErrors:
    """Errors of estimates ``point`` (d, N) of frames ``frame`` (N,) against ``truth_point`` (d, M) [D14 Tables I–III].

    Parameters
    ----------
    truth_frame, truth_identity : (M,) frame and identity of each true point.
    gate : distance from which a pair counts as a miss and a false estimate, in the unit of the points.

    Raises
    ------
    InputError : for shapes that do not fit, points that are not finite, or a gate ≤ 0.
    """
    if not gate > 0:
        raise InputError(f"expected a gate > 0, got {gate}", where="gate")
    if not len(truth_frame) == len(truth_identity) == truth_point.shape[-1] or len(frame) != point.shape[-1]:
        raise InputError(
            f"expected a frame and an identity per true point and a frame per estimate, got {len(truth_frame)}, "
            f"{len(truth_identity)}, {truth_point.shape} and {len(frame)}, {point.shape}",
            cure="Points are columns: (d, M) and (d, N).",
        )
    identity, target = np.unique(truth_identity, return_inverse=True)
    squares, mapped = np.zeros((len(truth_point), len(identity))), np.zeros(len(identity), np.int64)
    for number in np.unique(truth_frame):
        t, e = np.flatnonzero(truth_frame == number), np.flatnonzero(frame == number)
        distance = euclidean(truth_point[:, t], point[:, e])
        rows, columns = cheapest(np.minimum(distance, gate))
        near = distance[rows, columns] < gate
        rows, columns = t[rows[near]], e[columns[near]]
        np.add.at(squares.T, target[rows], (point[:, columns] - truth_point[:, rows]).T ** 2)
        np.add.at(mapped, target[rows], 1)
    mean = np.divide(squares, mapped, out=np.full_like(squares, np.nan), where=mapped > 0)
    return TargetErrors(identity, np.bincount(target, minlength=len(identity)).astype(np.int64), mapped, np.sqrt(mean))
