"""OSPA(2): OSPA between sets of trajectories, whose base distance is a mean over time (Beard, Vo, Vo 2017, 2020).

    d(f, g) = [ 1/|D_f ∪ D_g| Σ_{t ∈ D_f ∪ D_g} d_c({f(t)}, {g(t)})^q ]^(1/q)                                   [B20]

over the frames D in which the trajectories are present, where d_c is min(d, c) while both are and c while one is. OSPA(2) is
OSPA with this distance, cut-off c and order p, between the trajectories that are present in a window of time. It knows
switches, breaks and false tracks, and is a metric; it lies between 0 and c, in the unit of d.

On boxes, 1 − IoU with c = p = q = 1: over a whole sequence it is 1 − STDA / max(n, m), STDA as in `vace`.

Notation: K frames, n true and m output trajectories, Q pairs of them.
"""

from __future__ import annotations

import numpy as np

from phdtrack.errors import InputError
from phdtrack.metrics.assignment import assign
from phdtrack.metrics.ospa import check_order
from phdtrack.metrics.trajectories import PointRows, Trajectories, laid, of_boxes, of_points
from phdtrack.types import F8, I8, Bool, Tracks, Truth


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

    Raises
    ------
    InputError : for points of different dimension or not finite, or settings out of range.
    """
    _check(c, p, q)
    last = frames or int(max(truth.frame.max(initial=0), output.frame.max(initial=0)))
    return _over(of_points(truth, output, c), last, window, (c, p, q))


def ospa2_of(distance: F8, there: Bool, given: Bool, c: float, p: float = 1.0, q: float = 1.0, window: int = 0) -> F8:
    """As `ospa2_boxes`, for trajectories with the given ``distance`` (K, n, m) in each frame, read where both are present.

    ``there`` (K, n) and ``given`` (K, m): whether the true, the output trajectory is present.

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
