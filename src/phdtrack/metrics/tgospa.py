"""T-GOSPA, a distance between sets of trajectories (García-Fernández, Rahmathullah, Svensson 2020;
LP relaxation) [G20]:

    min_W Σ_k [ Σ_mapped (1 − IoU) + 1/2 (missed + false) ] + γ/2 Σ_k Σ_ij |W_k+1(i, j) − W_k(i, j)|

over weights W_k(i, j) ∈ [0, 1] with row and column sums ≤ 1: GOSPA with c = p = 1, α = 2 in every
frame, and γ/2 for each mapping of trajectories that begins or ends between two frames. Two
trajectories may stay mapped while one is absent, at cost 1/2 like a miss. With γ = 0 it is the sum
of GOSPA over the frames. At the optimum most weights are 0 or 1. It takes seconds (800 frames, 19
people, 190 tracks: 8 s), so `evaluate` does not include it.

Notation: K frames, n true and m output trajectories, Q pairs of them whose boxes overlap at some
time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phdtrack.errors import InputError
from phdtrack.metrics.matching import pair_frames
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
    parts, summed over the frames. Distractors are handled as in `evaluate`. Raises `InputError` for
    rows that `evaluate` would refuse, or gamma < 0.

    Parameters
    ----------
    truth, tracks : annotated boxes, output boxes.
    frames : number of frames of the sequence, later rows are ignored; 0: all.
    gamma : penalty of an identity switch.

    Returns
    -------
    The metric and its parts, without a unit.
    """
    if not gamma >= 0:
        raise InputError(f"expected a switching penalty ≥ 0, got {gamma}", where="gamma")
    sequence = pair_frames(truth, tracks, frames)
    shape = len(sequence.pairs), len(sequence.truth_identity), len(sequence.output_identity)
    truth_present = np.zeros(shape[:2], np.bool_)
    output_present = np.zeros((shape[0], shape[2]), np.bool_)
    distance = np.ones(shape, np.float32)
    for k, pair in enumerate(sequence.pairs):
        truth_present[k, pair.truth] = True
        output_present[k, pair.output] = True
        distance[k][np.ix_(pair.truth, pair.output)] = 1 - pair.iou
    return tgospa(distance, truth_present, output_present, gamma)


def tgospa(
    distance: NDArray[np.floating], truth_present: Bool, output_present: Bool, gamma: float
) -> TGospaParts:
    """T-GOSPA of any trajectories and its parts, summed over the frames, in units of the cut-off
    distance c.

    Parameters
    ----------
    distance : (K, n, m) distances divided by c; pairs at 1 or more cannot be mapped.
    truth_present, output_present : (K, n), (K, m) True in frames where a trajectory is present.
    gamma : penalty of an identity switch.
    """
    close = truth_present[:, :, None] & output_present[:, None, :] & (distance < 1)
    rows, columns = np.nonzero(close.any(axis=0))
    near = close[:, rows, columns]
    cost = np.where(near, distance[:, rows, columns].astype(np.float64), 1.0)
    if len(rows):
        weight = _weights(cost - 1, rows, columns, gamma / 2)
    else:
        weight = np.zeros_like(cost)
    localisation = float((weight * cost)[near].sum())
    mapped = float(weight[near].sum())
    missed = 0.5 * (float(truth_present.sum()) - mapped)
    false = 0.5 * (float(output_present.sum()) - mapped)
    switching = gamma / 2 * float(np.abs(np.diff(weight, axis=0)).sum())
    total = localisation + missed + false + switching
    return TGospaParts(max(total, 0.0), localisation, missed, false, switching)


def _weights(gain: F8, rows: I8, columns: I8, switch_cost: float) -> F8:
    """(K, Q) the weights of the Q pairs (rows, columns) that minimise
    Σ gain·W + switch_cost Σ |W_k+1 − W_k|.
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
    cost = np.concatenate([gain.ravel(), np.full((frames - 1) * pairs, switch_cost)])
    solution = linprog(cost, A_ub=matrix, b_ub=bound, bounds=(0, 1), method="highs")
    if solution.x is None:
        raise ArithmeticError(f"the linear programme of T-GOSPA was not solved: {solution.message}")
    return np.asarray(solution.x[: gain.size], np.float64).reshape(gain.shape)
