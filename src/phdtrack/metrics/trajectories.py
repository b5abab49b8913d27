"""Two sets of trajectories laid side by side: what T-GOSPA and OSPA(2) read, of boxes or of points.

Only pairs that are nearer than the cut-off c at some time are kept: all others are at c for both distances.

Notation: K frames, n true and m output trajectories, Q pairs of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.errors import InputError
from phdtrack.metrics.ospa import euclidean
from phdtrack.metrics.scene import build
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

    Raises
    ------
    InputError : for rows that `evaluate` would refuse.
    """
    scene = build(truth, tracks, frames)
    parts = [_Frame(pair.number, pair.truth, pair.output, 1 - pair.iou) for pair in scene.pairs]
    return _gathered(parts, len(scene.truth_identity), len(scene.output_identity), 1.0)


def of_points(truth: PointRows, output: PointRows, c: float) -> Trajectories:
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
