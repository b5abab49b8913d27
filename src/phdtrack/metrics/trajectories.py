"""Distances between trajectories: T-GOSPA, and the error of each target's position.

T-GOSPA (García-Fernández, Rahmathullah, Svensson 2020; LP relaxation) [G20]:

    min_W Σ_k [ Σ_mapped (1 − IoU) + 1/2 (missed + false) ] + γ/2 Σ_k Σ_ij |W_k+1(i, j) − W_k(i, j)|

over weights W_k(i, j) ∈ [0, 1] with row and column sums ≤ 1: GOSPA with c = p = 1, α = 2 in every
frame, and γ/2 for each mapping of trajectories that begins or ends between two frames. Two
trajectories may stay mapped while one is absent, at 1/2 like a miss. With γ = 0 it is the sum of
GOSPA over the frames. At the optimum the weights are mostly 0 or 1. It takes seconds (800 frames,
19 people, 190 tracks: 8 s), so `evaluate` does not include it.

Notation: K frames, n true and m output trajectories, Q pairs of them whose boxes overlap at some
time.

RMSE per target after association with the truth [D14 Tables I–III]: in each frame true and
estimated points are mapped one to one for the least Σ min(d, gate), d the Euclidean distance; pairs
at a distance ≥ gate are apart. Over the frames in which target i is mapped

    RMSE_i = √( mean ‖estimate − truth_i‖² )        and per axis √( mean (estimate − truth_i)² )

It says how well targets are located that are located at all.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phdtrack.errors import InputError
from phdtrack.metrics.matching import build, cheapest, ratio
from phdtrack.types import F8, I8, Bool, Tracks, Truth


@dataclass(frozen=True, slots=True)
class TGospaParts:
    """``distance`` = ``localisation`` + ``missed`` + ``false`` + ``switching``."""

    distance: float
    localisation: float
    missed: float
    false: float
    switching: float


def tgospa_boxes(
    truth: Truth, tracks: Tracks, *, frames: int = 0, gamma: float = 1.0
) -> TGospaParts:
    """T-GOSPA of ``tracks`` against ``truth`` with base distance 1 − IoU, c = 1, p = 1, and its
    parts, summed over the frames; distractors as in `evaluate`. Raises `InputError` for rows that
    `evaluate` would refuse, or gamma < 0.

    Parameters
    ----------
    truth, tracks : annotated boxes, output boxes.
    frames : later rows are left out; 0: all.
    gamma : price of a switch of identity.
    """
    if not gamma >= 0:
        raise InputError(f"expected a switching penalty ≥ 0, got {gamma}", where="gamma")
    scene = build(truth, tracks, frames)
    shape = len(scene.pairs), len(scene.truth_identity), len(scene.output_identity)
    there = np.zeros(shape[:2], np.bool_)
    given = np.zeros((shape[0], shape[2]), np.bool_)
    distance = np.ones(shape, np.float32)
    for k, pair in enumerate(scene.pairs):
        there[k, pair.truth] = True
        given[k, pair.output] = True
        distance[k][np.ix_(pair.truth, pair.output)] = 1 - pair.iou
    return tgospa(distance, there, given, gamma)


def tgospa(distance: NDArray[np.floating], there: Bool, given: Bool, gamma: float) -> TGospaParts:
    """T-GOSPA of any trajectories and its parts, summed over the frames, in units of the distance c
    at which two are no pair.

    Parameters
    ----------
    distance : (K, n, m) distances over c, in each of K frames; pairs at 1 or more are none.
    there, given : (K, n), (K, m) where the true and the output trajectories are present.
    gamma : price of a switch of identity.
    """
    close = there[:, :, None] & given[:, None, :] & (distance < 1)
    rows, columns = np.nonzero(close.any(axis=0))
    near = close[:, rows, columns]
    cost = np.where(near, distance[:, rows, columns].astype(np.float64), 1.0)
    if len(rows):
        weight = _weights(cost - 1, rows, columns, gamma / 2)
    else:
        weight = np.zeros_like(cost)
    localisation = float((weight * cost)[near].sum())
    mapped = float(weight[near].sum())
    missed = 0.5 * (float(there.sum()) - mapped)
    false = 0.5 * (float(given.sum()) - mapped)
    switching = gamma / 2 * float(np.abs(np.diff(weight, axis=0)).sum())
    whole = localisation + missed + false + switching
    return TGospaParts(max(whole, 0.0), localisation, missed, false, switching)


def _weights(gain: F8, rows: I8, columns: I8, price: float) -> F8:
    """(K, Q) the weights of the Q pairs (rows, columns) with least Σ gain·W + price Σ |W_k+1 −
    W_k|.
    """
    from scipy import sparse
    from scipy.optimize import linprog

    frames, pairs = gain.shape
    # Over (W, change): in each frame Σ_j W ≤ 1 and Σ_i W ≤ 1; ±(W_k+1 − W_k) ≤ change.
    members = np.concatenate(
        [side[None, :] == np.unique(side)[:, None] for side in (rows, columns)]
    )
    sums = sparse.kron(sparse.eye_array(frames), members.astype(np.float64))
    step = sparse.kron(
        sparse.eye_array(frames - 1, frames, k=1) - sparse.eye_array(frames - 1, frames),
        np.eye(pairs),
    )
    change = sparse.eye_array((frames - 1) * pairs)
    matrix: Any = sparse.block_array(
        [[sums, None], [step, -change], [-step, -change]], format="csr"
    )
    bound = np.repeat([1.0, 0.0], [sums.shape[0], 2 * len(gain[1:]) * pairs])
    cost = np.concatenate([gain.ravel(), np.full((frames - 1) * pairs, price)])
    solution = linprog(cost, A_ub=matrix, b_ub=bound, bounds=(0, 1), method="highs")
    if solution.x is None:
        raise ArithmeticError(f"the linear programme of T-GOSPA was not solved: {solution.message}")
    return np.asarray(solution.x[: gain.size], np.float64).reshape(gain.shape)


@dataclass(frozen=True, slots=True, eq=False)
class TargetErrors:
    """Per target ``identity`` (G,) ascending, ``frames`` (G,) in the truth, ``mapped`` (G,) of
    them, ``rmse_axis`` (d, G).

    Errors are in the unit of the points; NaN for a target that is never mapped.
    """

    identity: I8
    frames: I8
    mapped: I8
    rmse_axis: F8

    @property
    def rmse(self) -> F8:
        """(G,) RMSE of the position."""
        whole: F8 = np.sqrt(np.square(self.rmse_axis).sum(axis=0))
        return whole

    @property
    def overall(self) -> float:
        """RMSE over all mapped pairs of all targets; NaN without any."""
        squares = np.nansum(self.rmse**2 * self.mapped)
        return float(np.sqrt(ratio(float(squares), int(self.mapped.sum()))))

    def as_dict(self) -> dict[str, object]:
        """``overall``, and ``objects`` with identity, frames, mapped, rmse and rmse_axis each; NaN
        where never mapped.
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
    truth_frame, truth_identity, truth_point : (M,), (M,), (d, M) frame, identity and place of each
        true point.
    frame, point : (N,), (d, N) of the estimates.
    gate : distance from which a pair counts as a miss and a false estimate, in the unit of the
        points.
    """
    if not gate > 0:
        raise InputError(f"expected a gate > 0, got {gate}", where="gate")
    fits = (
        len(truth_frame) == len(truth_identity) == truth_point.shape[-1]
        and len(frame) == point.shape[-1]
    )
    if not fits or len(truth_point) != len(point):
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
        distance = np.sqrt(
            ((truth_point[:, t][:, :, None] - point[:, e][:, None]) ** 2).sum(axis=0)
        )
        rows, columns = cheapest(np.minimum(distance, gate))
        near = distance[rows, columns] < gate
        rows = t[rows[near]]
        columns = e[columns[near]]
        np.add.at(squares.T, target[rows], (point[:, columns] - truth_point[:, rows]).T ** 2)
        np.add.at(mapped, target[rows], 1)
    mean = np.divide(squares, mapped, out=np.full_like(squares, np.nan), where=mapped > 0)
    return TargetErrors(
        identity,
        np.bincount(target, minlength=len(identity)).astype(np.int64),
        mapped,
        np.sqrt(mean),
    )
