"""Two sets of trajectories laid side by side: what T-GOSPA and OSPA(2) read, of boxes or of points.

Only pairs that are nearer than the cut-off c at some time are kept: all others are at c for both distances.

Notation: K frames, n true and m output trajectories, Q pairs of them.

OSPA(2): OSPA between sets of trajectories, whose base distance is a mean over time (Beard, Vo, Vo 2017, 2020).

    d(f, g) = [ 1/|D_f ∪ D_g| Σ_{t ∈ D_f ∪ D_g} d_c({f(t)}, {g(t)})^q ]^(1/q)                                   [B20]

over the frames D in which the trajectories are present, where d_c is min(d, c) while both are and c while one is. OSPA(2) is
OSPA with this distance, cut-off c and order p, between the trajectories that are present in a window of time. It knows
switches, breaks and false tracks, and is a metric; it lies between 0 and c, in the unit of d.

On boxes, 1 − IoU with c = p = q = 1: over a whole sequence it is 1 − STDA / max(n, m), STDA as in `vace`.

Notation: K frames, n true and m output trajectories, Q pairs of them.

T-GOSPA: a distance between two sets of trajectories (García-Fernández, Rahmathullah, Svensson 2020; LP relaxation) [G20].

    d^p = min_W Σ_k [ Σ_mapped min(d, c)^p + c^p/2 (missed + false) ] + γ^p/2 Σ_k Σ_ij |W_k+1(i, j) − W_k(i, j)|

over weights W_k(i, j) ∈ [0, 1] with row and column sums ≤ 1: GOSPA with α = 2 in every frame, and γ^p/2 for each mapping of
trajectories that begins or ends between two frames; a switch costs γ^p, a mapping that is given up γ^p/2. Two trajectories
may stay mapped while one is absent, at c^p/2 like a miss. With γ = 0 it is the sum of GOSPA^p over the frames. The
relaxation to weights keeps it a metric, and makes it a linear programme; at the optimum the weights are mostly 0 or 1.

Pairs that never come nearer than c are left out, for mapping them cannot pay. Pairs that share no trajectory with others,
not even by a chain, are a programme of their own. A programme has two variables per remaining pair and frame and takes
seconds (800 frames, 19 people, 190 tracks: 5 s), which is why `evaluate` does not include it.

Notation: K frames, n true and m output trajectories; ``distance`` (K, n, m) where both are present.

RMSE per target after association with the truth [D14 Tables I–III].

In each frame true and estimated points are mapped one to one for the least Σ min(d, gate), d the Euclidean distance; pairs
at a distance ≥ gate are apart. Over the frames in which target i is mapped

    RMSE_i = √( mean ‖estimate − truth_i‖² )        and per axis √( mean (estimate − truth_i)² )

It says how well targets are located that are located at all; read it beside the number of frames in which they were not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from phdtrack.errors import InputError
from phdtrack.metrics.matching import assign, build, cheapest
from phdtrack.metrics.sets import check_order, euclidean
from phdtrack.types import F8, I8, Bool, Tracks, Truth


@dataclass(frozen=True, slots=True, eq=False)
class PointRows:
    """Trajectories of points: ``frame`` (M,) from 1, ``identity`` (M,), ``point`` (d, M), columns."""

    frame: I8
    identity: I8
    point: F8

    def __post_init__(self) -> None:
        if self.frame.shape != self.identity.shape or self.point.shape[1:] != self.frame.shape or self.point.ndim != 2:
            shapes = f"{self.frame.shape}, {self.identity.shape}, {self.point.shape}"
            raise InputError(f"expected frame (M,), identity (M,), point (d, M), got {shapes}", cure="Points are columns.")
        if len(self.frame) and self.frame.min() < 1:
            raise InputError(f"expected frame numbers from 1, got {self.frame.min()}", where="frame")
        rows = np.stack([self.frame, self.identity])
        if np.unique(rows, axis=1).shape[1] < len(self.frame):
            raise InputError("expected one point per identity and frame, got some twice", where="identity")


@dataclass(frozen=True, slots=True, eq=False)
class Trajectories:
    """The K frames that hold anything, and the Q pairs of trajectories that come near each other.

    Attributes
    ----------
    number : (K,) frame numbers, ascending.
    there, given : (K, n), (K, m) whether each true, each output trajectory is present.
    rows, columns : (Q,) the pairs: indices of the true and of the output trajectory.
    near : (K, Q) both present and nearer than c.
    distance : (K, Q) their distance where near, c elsewhere.
    """

    number: I8
    there: Bool
    given: Bool
    rows: I8
    columns: I8
    near: Bool
    distance: F8


def laid(distance: F8, there: Bool, given: Bool, c: float) -> Trajectories:
    """Frames 1…K of ``distance`` (K, n, m) between trajectories that are ``there`` (K, n) and ``given`` (K, m).

    Parameters
    ----------
    distance : (K, n, m) in each frame.
    there, given : (K, n), (K, m) whether the true and the output trajectory is present.
    c : cut-off distance.

    Raises
    ------
    InputError : for shapes that do not fit.
    """
    if distance.shape != (len(there), there.shape[-1], given.shape[-1]) or len(there) != len(given):
        raise InputError(f"expected shapes (K, n, m), (K, n), (K, m), got {distance.shape}, {there.shape}, {given.shape}")
    close = there[:, :, None] & given[:, None, :] & (distance < c)
    rows, columns = np.nonzero(close.any(axis=0))
    near = close[:, rows, columns]
    cut = np.where(near, distance[:, rows, columns], c)
    return Trajectories(np.arange(1, len(there) + 1), there, given, rows, columns, near, cut)


def of_boxes(truth: Truth, tracks: Tracks, frames: int = 0) -> Trajectories:
    """By 1 − IoU with c = 1; rows after ``frames`` are left out, distractors are as in `evaluate`.

    Parameters
    ----------
    truth : annotated boxes.
    tracks : output boxes.
    frames : later rows are left out; 0: all.

    Raises
    ------
    InputError : for rows that `evaluate` would refuse.
    """
    scene = build(truth, tracks, frames)
    parts = [_Frame(pair.number, pair.truth, pair.output, 1 - pair.iou) for pair in scene.pairs]
    return _gathered(parts, len(scene.truth_identity), len(scene.output_identity), 1.0)


def _of_points(truth: PointRows, output: PointRows, c: float) -> Trajectories:
    """By the Euclidean distance, in the unit of the points.

    Raises
    ------
    InputError : for points of different dimension or not finite.
    """
    true_name, true_index = np.unique(truth.identity, return_inverse=True)
    name, index = np.unique(output.identity, return_inverse=True)
    parts = []
    for number in np.union1d(truth.frame, output.frame):
        t, o = np.flatnonzero(truth.frame == number), np.flatnonzero(output.frame == number)
        parts.append(_Frame(int(number), true_index[t], index[o], euclidean(truth.point[:, t], output.point[:, o])))
    return _gathered(parts, len(true_name), len(name), c)


@dataclass(frozen=True, slots=True, eq=False)
class _Frame:
    number: int
    truth: I8
    output: I8
    distance: F8


def _gathered(parts: list[_Frame], n: int, m: int, c: float) -> Trajectories:
    there, given = np.zeros((len(parts), n), np.bool_), np.zeros((len(parts), m), np.bool_)
    none = np.zeros(0, np.int64)
    frame, pair, value = [none], [none], [np.zeros(0)]
    for k, part in enumerate(parts):
        there[k, part.truth], given[k, part.output] = True, True
        i, j = np.nonzero(part.distance < c)
        frame.append(np.full(len(i), k))
        pair.append(part.truth[i] * m + part.output[j])
        value.append(part.distance[i, j])
    which, column = np.unique(np.concatenate(pair), return_inverse=True)
    near = np.zeros((len(parts), len(which)), np.bool_)
    distance = np.full(near.shape, c)
    near[np.concatenate(frame), column] = True
    distance[np.concatenate(frame), column] = np.concatenate(value)
    number = np.array([part.number for part in parts], np.int64)
    return Trajectories(number, there, given, which // max(m, 1), which % max(m, 1), near, distance)


def ospa2_boxes(truth: Truth, tracks: Tracks, *, frames: int = 0, window: int = 0) -> F8:
    """(K,) OSPA(2) of ``tracks`` against ``truth`` at each frame, base distance 1 − IoU, c = 1, p = q = 1 [B17; B20].

    Parameters
    ----------
    frames : number of frames of the sequence; 0: up to the last of either side.
    window : frames that each value looks back on, its own included; 0: one value, over the whole sequence, (1,).

    Raises
    ------
    InputError : for rows that `evaluate` would refuse, or a window < 0.
    """
    last = frames or int(max(truth.frame.max(initial=0), tracks.frame.max(initial=0)))
    return _over(of_boxes(truth, tracks, frames), last, window, (1.0, 1.0, 1.0))


def ospa2_points(
    truth: PointRows, output: PointRows, c: float, p: float = 1.0, q: float = 1.0, *, frames: int = 0, window: int = 0
) -> F8:
    """As `ospa2_boxes`, for points under the Euclidean distance, ``c`` in their unit.

    Parameters
    ----------
    truth, output : rows of points.
    c : cut-off distance, in the unit of the points.
    p, q : orders over the trajectories and over time.
    frames : later rows are left out; 0: all.
    window : frames looked back; 0: all.

    Raises
    ------
    InputError : for points of different dimension or not finite, or settings out of range.
    """
    _check(c, p, q)
    last = frames or int(max(truth.frame.max(initial=0), output.frame.max(initial=0)))
    return _over(_of_points(truth, output, c), last, window, (c, p, q))


def ospa2_of(distance: F8, there: Bool, given: Bool, c: float, p: float = 1.0, q: float = 1.0, window: int = 0) -> F8:
    """As `ospa2_boxes`, for trajectories with the given ``distance`` (K, n, m) in each frame, read where both are present.

    ``there`` (K, n) and ``given`` (K, m): whether the true, the output trajectory is present.

    Parameters
    ----------
    distance : (K, n, m) between the trajectories in each frame, read where both are present.
    there, given : (K, n), (K, m) whether the true and the output trajectory is present.
    c : cut-off distance.
    p, q : orders over the trajectories and over time.
    window : frames looked back; 0: all.

    Raises
    ------
    InputError : for shapes that do not fit, or settings out of range.
    """
    _check(c, p, q)
    return _over(laid(distance, there, given, c), len(there), window, (c, p, q))


def _check(c: float, p: float, q: float) -> None:
    check_order(c, p)
    check_order(c, q)


def _over(pairs: Trajectories, frames: int, window: int, settings: tuple[float, float, float]) -> F8:
    """One value of each window that ends at one of ``frames`` frames; of all of them at once without a window."""
    if window < 0:
        raise InputError(f"expected a number of frames ≥ 0, got {window}", where="window")
    c, _, q = settings
    gain = _summed((c**q - pairs.distance**q) * pairs.near)
    both = _summed(pairs.there[:, pairs.rows] & pairs.given[:, pairs.columns])
    there, given = _summed(pairs.there), _summed(pairs.given)
    ends = np.arange(1, frames + 1) if window else np.array([frames])
    first = np.searchsorted(pairs.number, ends - window, side="right") if window else np.zeros(1, np.int64)
    last = np.searchsorted(pairs.number, ends, side="right")
    return np.array(
        [
            _value(pairs, (gain[b] - gain[a], both[b] - both[a], there[b] - there[a], given[b] - given[a]), settings)
            for a, b in zip(first.tolist(), last.tolist(), strict=True)
        ]
    )


def _summed(values: F8 | Bool) -> F8:
    """(K + 1, …) sums over the frames before each."""
    return np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0, dtype=np.float64)])


def _value(pairs: Trajectories, sums: tuple[F8, F8, F8, F8], settings: tuple[float, float, float]) -> float:
    """OSPA(2) of one window: ``sums`` over it of c^q − d^q (Q,), of joint frames (Q,), of frames (n,) and (m,)."""
    (gain, both, there, given), (c, p, q) = sums, settings
    most = max(np.count_nonzero(there), np.count_nonzero(given))
    if not most:
        return 0.0
    i, j = pairs.rows, pairs.columns
    length = there[i] + given[j] - both
    # Sums of differences of sums: what is 0 may come out a rounding beside it.
    mean = np.clip(c**q - np.divide(gain, length, out=np.zeros_like(gain), where=length > 0), 0.0, c**q)
    saved = np.zeros((len(there), len(given)))
    saved[i, j] = np.where(length > 0, c**p - mean ** (p / q), 0.0)
    rows, columns = assign(saved[np.ix_(*_present(there, given))])
    kept = saved[np.ix_(*_present(there, given))][rows, columns].sum()
    return float(max(c**p - kept / most, 0.0) ** (1 / p))


def _present(there: F8, given: F8) -> tuple[I8, I8]:
    return np.flatnonzero(there), np.flatnonzero(given)


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

    Parameters
    ----------
    truth : annotated boxes.
    tracks : output boxes.
    frames : later rows are left out; 0: all.
    gamma : price of a switch of identity.

    Raises
    ------
    InputError : for rows that `evaluate` would refuse, or gamma < 0.
    """
    _check_tgospa(1.0, 1.0, gamma)
    return _least(of_boxes(truth, tracks, frames), 1.0, 1.0, gamma)


def tgospa_points(truth: PointRows, output: PointRows, c: float, p: float = 1.0, gamma: float = 1.0) -> TGospaParts:
    """T-GOSPA of trajectories of points under the Euclidean distance; ``c`` and ``gamma`` in the unit of the points.

    Parameters
    ----------
    truth, output : rows of points.
    c : cut-off distance, in the unit of the points.
    p : order.
    gamma : price of a switch of identity, in the unit of the points.

    Raises
    ------
    InputError : for points of different dimension or not finite, or settings out of range.
    """
    _check_tgospa(c, p, gamma)
    return _least(_of_points(truth, output, c), c, p, gamma)


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
    _check_tgospa(c, p, gamma)
    return _least(laid(distance, there, given, c), c, p, gamma)


def _check_tgospa(c: float, p: float, gamma: float) -> None:
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
