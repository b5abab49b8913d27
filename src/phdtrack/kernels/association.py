"""The association's work on every open vertex in every frame: predict it, and find who could follow it."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.gating import gated_pairs
from phdtrack.kernels.gaussian import factor, norm2

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]


@njit(cache=True)
def _off_identity(jacobian: F8, row: I8, column: I8, value: F8) -> int:
    """The non-zero elements of F − I, of which motion models have few; gives how many there are."""
    count = 0
    for r in range(jacobian.shape[0]):
        for c in range(jacobian.shape[0]):
            here = jacobian[r, c] - (1.0 if r == c else 0.0)
            if here != 0.0:
                row[count], column[count], value[count] = r, c, here
                count += 1
    return count


@njit(cache=True)
def predict_covariances(cov: F8, jacobian: F8, noise: F8, out: F8) -> None:
    """F P Fᵀ + Q for each P of ``cov`` (C, d, d), written to ``out`` (C, d, d).

    Parameters
    ----------
    jacobian : F, (C, d, d) or more; or (1, d, d), one for all.
    noise : Q, (C, d, d) or more; what lies beyond C is not read, in both. All arrays are C-contiguous.
    """
    count, d = cov.shape[0], cov.shape[1]
    flat, old, added = out.ravel(), cov.ravel(), noise.ravel()
    for k in range(old.size):
        flat[k] = old[k] + added[k]
    row, column, value = np.empty(d * d, np.int64), np.empty(d * d, np.int64), np.empty(d * d)
    shared, off = jacobian.shape[0] == 1, 0
    for i in range(count):
        if i == 0 or not shared:
            off = _off_identity(jacobian[i], row, column, value)
        # With F = I + E: P + E P + P Eᵀ + E P Eᵀ.
        for k in range(off):
            r, c, here = row[k], column[k], value[k]
            for s in range(d):
                out[i, r, s] += here * cov[i, c, s]
                out[i, s, r] += here * cov[i, s, c]
            for j in range(off):
                out[i, r, row[j]] += here * value[j] * cov[i, c, column[j]]


@njit(cache=True)
def _observed(cov: F8, rows: I8, out: F8) -> None:
    """The block of ``cov`` that a measurement shows."""
    for a in range(rows.size):
        for b in range(rows.size):
            out[a, b] = cov[rows[a], rows[b]]


@njit(cache=True)
def _loose_ends(cov: F8, noise: F8, sigma: F8, rows: I8, gate: float) -> tuple[F8, F8]:
    """(n,) minus the log-density of two loose ends, less the Gaussian's constant; and log |covariance| of each state."""
    n, m = cov.shape[0], rows.size
    open_end, log_det = np.empty(n), np.empty(n)
    block, root = np.empty((m, m)), np.empty((m, m))
    for i in range(n):
        _observed(cov[i], rows, block)
        log_det[i] = factor(block, root)
        _observed(noise[i], rows, block)
        for a in range(m):
            block[a, a] += 2.0 * sigma[rows[a], i] ** 2
        open_end[i] = 0.5 * (gate**2 + factor(block, root))
    return open_end, log_det


@njit(cache=True, error_model="numpy")
def _determinants(cov: F8, count: int, rows: I8) -> F8:
    """(count,) determinants of the observed blocks, by elimination side by side: the compiler makes vectors of them."""
    m, lanes = rows.size, 16
    out, block, share = np.ones(count), np.empty((m, m, lanes)), np.empty(lanes)
    for begin in range(0, count, lanes):
        width = min(lanes, count - begin)
        for k in range(width):
            for a in range(m):
                for b in range(a + 1):
                    block[a, b, k] = cov[begin + k, rows[a], rows[b]]
        for t in range(m):
            for k in range(width):
                out[begin + k] *= block[t, t, k]
            for a in range(t + 1, m):
                for k in range(width):
                    share[k] = block[a, t, k] / block[t, t, k]
                for b in range(t + 1, a + 1):
                    for k in range(width):
                        block[a, b, k] -= share[k] * block[b, t, k]
    return out


@njit(cache=True)
def _reach(
    mean: F8, cov: F8, price: F8, rows: I8, new: F8, best: float, least: float, consistent: float
) -> tuple[I8, F8, F8, F8]:
    """The columns to which an edge can be worth taking, the rectangles in which it ends, and log |observed block|.

    gain > 0 needs distance² < 2·(open_end + price) − log|S|, and |S| is at least that of either state's covariance.
    """
    px, py = rows[0], rows[1]
    wide, high = new[:, px, px].max(), new[:, py, py].max()
    index, log_det = np.empty(price.size, np.int64), np.empty(price.size)
    lower, upper = np.empty((2, price.size)), np.empty((2, price.size))
    determinant = _determinants(cov, price.size, rows)
    found = 0
    for c in range(price.size):
        limit = 2.0 * (best + price[c])
        if not limit - least > 0.0:
            continue
        log_det[found] = np.log(determinant[c])
        limit = min(limit - max(least, log_det[found]), consistent**2)
        if not limit > 0.0:
            continue
        x, y = np.sqrt(limit * (cov[c, px, px] + wide)), np.sqrt(limit * (cov[c, py, py] + high))
        lower[0, found], upper[0, found] = mean[px, c] - x, mean[px, c] + x
        lower[1, found], upper[1, found] = mean[py, c] - y, mean[py, c] + y
        index[found] = c
        found += 1
    return index[:found], lower[:, :found].copy(), upper[:, :found].copy(), log_det[:found]


@njit(cache=True)
def find_edges(
    mean: F8,
    cov: F8,
    noise: F8,
    sigma: F8,
    since: F8,
    rows: I8,
    dt: float,
    gate: float,
    log_miss: float,
    consistent: float,
) -> tuple[I8, I8, F8]:
    """Edges of positive gain from each new state back to the columns, as compressed rows [M07 §3].

    gain = log N(step; 0, S) − log-density of two loose ends + (since − dt)·log miss, S = predicted + own covariance, on the
    rows that a measurement shows. The loose ends' is the density at ``gate`` deviations from a typical one-step prediction:
    two measurements' noise and one step of the motion's.

    Parameters
    ----------
    mean, cov : (d, C + n), (C + n, d, d) the C columns predicted for now, then the n new states.
    noise : (n, d, d) the motion's noise of one step from the new states.
    sigma : (d, n) measurement noise of the new states.
    since : (C,) time since each column's frame.
    rows : the state's components that a measurement shows; the first two are the position.
    dt, gate, log_miss, consistent : as in `GraphMatching`.

    Returns
    -------
    start, target, gain : row r has the edges start[r] … start[r + 1] − 1 to columns ``target``, ascending.

    Raises
    ------
    ValueError : a position is not finite.
    """
    n, count, m = sigma.shape[1], since.size, rows.size
    start = np.zeros(n + 1, np.int64)
    if n == 0 or count == 0:
        return start, np.empty(0, np.int64), np.empty(0)
    new, new_cov = mean[:, count:], cov[count:]
    open_end, log_new = _loose_ends(new_cov, noise, sigma, rows, gate)
    price = (since - dt) * log_miss
    index, lower, upper, log_old = _reach(mean, cov, price, rows, new_cov, open_end.max(), log_new.min(), consistent)
    row, place = gated_pairs(new[rows[0]].copy(), new[rows[1]].copy(), lower, upper)
    gain = np.empty(row.size)
    step, y, block, root = np.empty(m), np.empty(m), np.empty((m, m)), np.empty((m, m))
    kept = 0
    for p in range(row.size):
        i, c = row[p], index[place[p]]
        # What the gain cannot exceed, seen from one component at a time, spares most of the factors.
        most = 0.0
        for a in range(m):
            step[a] = new[rows[a], i] - mean[rows[a], c]
            most = max(most, step[a] ** 2 / (cov[c, rows[a], rows[a]] + new_cov[i, rows[a], rows[a]]))
        worth = open_end[i] + price[c]
        if most > consistent**2 or not worth > 0.5 * (most + max(log_new[i], log_old[place[p]])):
            continue
        for a in range(m):
            for b in range(m):
                block[a, b] = cov[c, rows[a], rows[b]] + new_cov[i, rows[a], rows[b]]
        log_det = factor(block, root)
        distance2 = norm2(step, root, y)
        worth -= 0.5 * (distance2 + log_det)
        if worth > 0.0 and distance2 <= consistent**2:
            row[kept], place[kept], gain[kept] = i, c, worth
            kept += 1
            start[i + 1] += 1
    edges: tuple[I8, I8, F8] = _by_row(start, row[:kept], place[:kept], gain[:kept])
    return edges


@njit(cache=True)
def _by_row(start: I8, row: I8, column: I8, gain: F8) -> tuple[I8, I8, F8]:
    """Counting sort of edges, stable; ``start`` holds the counts, one place on, and becomes the starts."""
    for r in range(start.size - 1):
        start[r + 1] += start[r]
    place = start[:-1].copy()
    target, out = np.empty(row.size, np.int64), np.empty(row.size)
    for e in range(row.size):
        k = place[row[e]]
        target[k], out[k] = column[e], gain[e]
        place[row[e]] = k + 1
    return start, target, out
