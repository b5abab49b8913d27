"""T-GOSPA: a distance between two sets of trajectories (García-Fernández, Rahmathullah, Svensson 2020; LP relaxation) [G20].

    d^p = min_W Σ_k [ Σ_mapped min(d, c)^p + c^p/2 (missed + false) ] + γ^p/2 Σ_k Σ_ij |W_k+1(i, j) − W_k(i, j)|

over weights W_k(i, j) ∈ [0, 1] with row and column sums ≤ 1: GOSPA with α = 2 in every frame, and γ^p/2 for each mapping of
trajectories that begins or ends between two frames; a switch costs γ^p, a mapping that is given up γ^p/2. Two trajectories
may stay mapped while one is absent, at c^p/2 like a miss. With γ = 0 it is the sum of GOSPA^p over the frames. The
relaxation to weights keeps it a metric, and makes it a linear programme; at the optimum the weights are mostly 0 or 1.

Pairs that never come nearer than c are left out, for mapping them cannot pay. Pairs that share no trajectory with others,
not even by a chain, are a programme of their own. A programme has two variables per remaining pair and frame and takes
seconds (800 frames, 19 people, 190 tracks: 5 s), which is why `evaluate` does not include it.

Notation: K frames, n true and m output trajectories; ``distance`` (K, n, m) where both are present.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from phdtrack.errors import InputError
from phdtrack.metrics.ospa import check_order
from phdtrack.metrics.trajectories import PointRows, Trajectories, laid, of_boxes, of_points
from phdtrack.types import F8, I8, Bool, Tracks, Truth


@dataclass(frozen=True, slots=True)
class TGospaParts:
    """``distance``^p = ``localisation`` + ``missed`` + ``false`` + ``switching``."""

    distance: float
    localisation: float
    missed: float
    false: float
    switching: float


def tgospa_boxes(truth: Truth, tracks: Tracks, *, frames: int = 0, gamma: float = 1.0) -> TGospaParts:
    """T-GOSPA of ``tracks`` against ``truth`` with base distance 1 − IoU, c = 1, p = 1; distractors as in `evaluate`.

    Raises
    ------
    InputError : for rows that `evaluate` would refuse, or gamma < 0.
    """
    _check(1.0, 1.0, gamma)
    return _least(of_boxes(truth, tracks, frames), 1.0, 1.0, gamma)


def tgospa_points(truth: PointRows, output: PointRows, c: float, p: float = 1.0, gamma: float = 1.0) -> TGospaParts:
    """T-GOSPA of trajectories of points under the Euclidean distance; ``c`` and ``gamma`` in the unit of the points.

    Raises
    ------
    InputError : for points of different dimension or not finite, or settings out of range.
    """
    _check(c, p, gamma)
    return _least(of_points(truth, output, c), c, p, gamma)


def tgospa_of(distance: F8, there: Bool, given: Bool, c: float, p: float = 1.0, gamma: float = 1.0) -> TGospaParts:
    """T-GOSPA between trajectories.

    Parameters
    ----------
    distance : (K, n, m) distance of each true from each output trajectory in each frame; read only where both are present.
    there, given : (K, n), (K, m) whether the true, the output trajectory is present.
    c, gamma : cut-off distance and switching penalty ≥ 0, in the unit of ``distance``.
    p : order in [1, ∞).

    Raises
    ------
    InputError : for shapes that do not fit, or settings out of range.
    """
    _check(c, p, gamma)
    return _least(laid(distance, there, given, c), c, p, gamma)


def _check(c: float, p: float, gamma: float) -> None:
    check_order(c, p)
    if not gamma >= 0:
        raise InputError(f"expected a switching penalty ≥ 0, got {gamma}", where="gamma")


def _least(pairs: Trajectories, c: float, p: float, gamma: float) -> TGospaParts:
    cost = pairs.distance**p
    weight = np.zeros_like(cost)
    for some in _apart(pairs):
        rows, columns = pairs.rows[some], pairs.columns[some]
        weight[:, some] = _weights(cost[:, some] - c**p, rows, columns, gamma**p / 2)
    localisation = float((weight * cost)[pairs.near].sum())
    mapped = float(weight[pairs.near].sum())
    missed = c**p / 2 * (float(pairs.there.sum()) - mapped)
    false = c**p / 2 * (float(pairs.given.sum()) - mapped)
    switching = gamma**p / 2 * float(np.abs(np.diff(weight, axis=0)).sum())
    whole = localisation + missed + false + switching
    return TGospaParts(max(whole, 0.0) ** (1 / p), localisation, missed, false, switching)


def _apart(pairs: Trajectories) -> list[I8]:
    """The pairs by programme: those that are joined by trajectories which they share."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n, size = pairs.there.shape[1], pairs.there.shape[1] + pairs.given.shape[1]
    joined = coo_array((np.ones(len(pairs.rows)), (pairs.rows, n + pairs.columns)), shape=(size, size))
    _, label = connected_components(joined, directed=False)
    return [np.flatnonzero(label[pairs.rows] == one) for one in np.unique(label[pairs.rows])]


def _weights(gain: F8, rows: I8, columns: I8, price: float) -> F8:
    """(K, Q) the weights of the Q pairs (rows, columns) with least Σ gain·W + price Σ |W_k+1 − W_k|."""
    from scipy.optimize import linprog

    matrix, bound = _constraints(len(gain), rows, columns)
    cost = np.concatenate([gain.ravel(), np.full(matrix.shape[1] - gain.size, price)])
    solution = linprog(cost, A_ub=matrix, b_ub=bound, bounds=(0, 1), method="highs")
    if solution.x is None:
        raise ArithmeticError(f"the linear programme of T-GOSPA was not solved: {solution.message}")
    weight: F8 = solution.x[: gain.size].reshape(gain.shape)
    return weight


def _constraints(frames: int, rows: I8, columns: I8) -> tuple[Any, F8]:
    """The sparse matrix and the upper bounds of Σ_j W ≤ 1, Σ_i W ≤ 1 and ±(W_k+1 − W_k) ≤ change, over (W, change)."""
    from scipy.sparse import coo_array

    pairs = len(rows)
    weight = np.arange(frames * pairs).reshape(frames, pairs)
    change = weight.size + np.arange((frames - 1) * pairs)
    line: list[I8] = []
    sums = 0
    for side in (rows, columns):
        _, member = np.unique(side, return_inverse=True)
        line.append((sums + np.arange(frames)[:, None] * (member.max() + 1) + member).ravel())
        sums += frames * int(member.max() + 1)
    up, down = sums + np.arange(len(change)), sums + len(change) + np.arange(len(change))
    before, after, one = weight[:-1].ravel(), weight[1:].ravel(), np.ones(len(change))
    row = np.concatenate([*line, up, up, up, down, down, down])
    column = np.concatenate([weight.ravel(), weight.ravel(), after, before, change, after, before, change])
    value = np.concatenate([np.ones(2 * weight.size), one, -one, -one, -one, one, -one])
    bound = np.concatenate([np.ones(sums), np.zeros(2 * len(change))])
    return coo_array((value, (row, column)), shape=(len(bound), weight.size + len(change))).tocsr(), bound
