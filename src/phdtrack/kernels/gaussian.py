"""Gaussians and measurements of one frame as arrays, and what all Gaussian filters compute of them [V06 (24)–(38)].

A model answers for one frame with four records, which `models.gaussian` asks it for: `Predicted` (its motion), `Expected`
(its sensor), `Measurements` (its sensor and its clutter) and `Births`. GM-PHD, GM-CPHD, PMB and MHT are compiled over these
records and know nothing else of the model: boxes, ground plane, points and bearings, linear or by sigma points, are all the
same here.

For Gaussian i with expected measurement ẑ_i, spread H P Hᵀ (or that of its sigma points) and cross-covariance C = P Hᵀ, and
measurement j, with R = R_i + R_j

    S = H P Hᵀ + R = L Lᵀ,   y = L⁻¹ (z_j − ẑ_i),   W = L⁻¹ Cᵀ
    d² = yᵀ y,   log N(z_j; ẑ_i, S) = −(d² + log |2πS|)/2,   m' = m + Wᵀ y,   P' = P − Wᵀ W

which is symmetric by construction and needs no inverse. Where no noise belongs to a measurement, S is the same for all
measurements and factored once for each Gaussian.

Arrays are C-contiguous, float64 or int64; the first axis counts Gaussians (J), births (B), measurements (N) or pairs (P). A
state has d components, and r components of a measurement are compared. The functions here are for kernels (`INNER`): a
filter calls them in a kernel that is compiled for it.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
Period = tuple[float, ...]
LOG_2PI = math.log(2 * math.pi)


class Predicted(NamedTuple):
    """Gaussians after an interval [V06 (24)–(29)].

    Attributes
    ----------
    mean : (J, d).     covariance : (J, d, d).
    p_survive : (J,) probability that the target is still there.
    """

    mean: F8
    covariance: F8
    p_survive: F8


class Expected(NamedTuple):
    """What Gaussians say about measurements.

    A linear sensor shows ``rows`` of the state: ``z`` is the mean then, and ``covariance`` and ``cross`` are the covariance
    of the Gaussians themselves. Of any other they are made of sigma points, and ``rows`` are 0, 1, …, r − 1.

    Attributes
    ----------
    rows : (r,) int64, what is compared with the components of a measurement.
    z : (J, n) of which ``rows`` are the expected measurement.
    covariance : (J, n, n) of it without noise, H P Hᵀ in these rows and columns.
    cross : (J, d, n) covariance of state and measurement, P Hᵀ in these columns.
    noise : (J, r, r) part of R that belongs to the target, or (0, r, r) where none does.
    p_detect : (J,) detection probability at the mean.
    """

    rows: I8
    z: F8
    covariance: F8
    cross: F8
    noise: F8
    p_detect: F8


class Measurements(NamedTuple):
    """The measurements of a frame.

    Attributes
    ----------
    z : (N, r) what is compared with `Expected.z`.
    noise : (N, r, r) part of R that belongs to the measurement, added to that of the target, or (0, r, r).
    clutter : (N,) κ(z), expected false alarms per unit of measurement volume.
    period : r numbers, 2π for angles, whose differences are taken the short way round, else 0. A tuple: its length is known
        when a kernel is compiled, and loops over it are unrolled.
    """

    z: F8
    noise: F8
    clutter: F8
    period: Period


class NewTargets(NamedTuple):
    """Targets whose first detection is measurement j.

    Attributes
    ----------
    density : (N,) their density at the measurement, per unit of measurement volume.
    mean : (N, d).     covariance : (N, d, d) of their state.
    """

    density: F8
    mean: F8
    covariance: F8


class Births(NamedTuple):
    """γT, the intensity of targets that appeared in the interval.

    Attributes
    ----------
    around : γT at each measurement, and what the measurement says of a target there that nothing else is known of.
        Filters leave out those whose measurement existing targets explain.
    weight : (B,) expected number of births of each Gaussian that was given, wherever measurements are.
    mean : (B, d).     covariance : (B, d, d) of these.
    """

    around: NewTargets
    weight: F8
    mean: F8
    covariance: F8


class Pairs(NamedTuple):
    """Gaussians and measurements within the gate of each other, ordered by Gaussian.

    Attributes
    ----------
    gaussian, measurement : (P,) indices.
    distance2 : (P,) d².     log_density : (P,) log N(z; ẑ, S).
    """

    gaussian: I8
    measurement: I8
    distance2: F8
    log_density: F8


@njit(cache=True)
def factor(cov: F8, root: F8) -> float:
    """Log-determinant of ``cov`` (m, m), whose Cholesky factor is written into the lower part of ``root`` (m, m).

    NaN where the matrix is not positive definite.
    """
    product = 1.0
    for r in range(cov.shape[0]):
        for s in range(r + 1):
            value = cov[r, s]
            for t in range(s):
                value -= root[r, t] * root[s, t]
            root[r, s] = np.sqrt(value) if r == s else value / root[s, s]
        product *= root[r, r]
    log_det: float = 2.0 * np.log(product)
    return log_det


@njit(cache=True)
def norm2(step: F8, root: F8, y: F8) -> float:
    """Squared Mahalanobis norm of ``step`` (m,) under the matrix that ``root`` factors; ``y`` (m,) becomes L⁻¹ step."""
    total = 0.0
    for r in range(step.size):
        value = step[r]
        for t in range(r):
            value -= root[r, t] * y[t]
        y[r] = value / root[r, r]
        total += y[r] * y[r]
    return total


@njit(cache=True)
def gaussian_parts(step: F8, cov: F8) -> tuple[F8, F8]:
    """(P,) squared Mahalanobis norms and log-determinants: ``step`` (m, P), ``cov`` (P, m, m) positive definite.

    NaN where a matrix is not positive definite.
    """
    m, count = step.shape
    distance2, log_det = np.empty(count), np.empty(count)
    root, y = np.empty((m, m)), np.empty(m)
    for p in range(count):
        log_det[p] = factor(cov[p], root)
        distance2[p] = norm2(step[:, p], root, y)
    return distance2, log_det


@njit(**INNER)
def difference(a: float, b: float, period: float) -> float:
    """a − b, the short way round where ``period`` is above 0."""
    step = a - b
    if period > 0.0:
        step -= period * float(np.rint(step / period))
    return step


# The functions of one pair take arrays and no records: a record in a loop would have all of its arrays counted again.
@njit(**INNER)
def innovation_root(spread: F8, rows: I8, noise: F8, extra: F8, i: int, j: int, period: Period, root: F8) -> float:
    """log |2πS| of Gaussian i and measurement j; the lower factor of S into ``root`` (r, r), with inverses in its diagonal.

    ``spread``, ``rows`` and ``noise`` are of `Expected`, ``extra`` is the noise and ``period`` that of `Measurements`. NaN
    where S is not positive definite. Without noise of measurements j does not count.
    """
    product, of_target, of_measurement = 1.0, len(noise) > 0, len(extra) > 0
    for a in range(len(period)):
        for b in range(a + 1):
            value = spread[i, rows[a], rows[b]]
            if of_target:
                value += noise[i, a, b]
            if of_measurement:
                value += extra[j, a, b]
            for t in range(b):
                value -= root[a, t] * root[b, t]
            if a == b:
                product *= value
                # Not positive: NaN, with which nothing is within a gate.
                root[a, a] = 1.0 / np.sqrt(value) if value > 0.0 else np.nan
            else:
                root[a, b] = value * root[b, b]
    log_det: float = np.log(product) + len(period) * LOG_2PI
    return log_det


@njit(**INNER)
def whitened(seen: F8, rows: I8, z: F8, i: int, j: int, period: Period, root: F8, y: F8) -> float:
    """d² of Gaussian i and measurement j, and L⁻¹ (z − ẑ) into ``y`` (r,).

    ``seen`` and ``rows`` are of `Expected`, ``z`` and ``period`` of `Measurements`, ``root`` of `innovation_root`.
    """
    total = 0.0
    for a in range(len(period)):
        value = difference(z[j, a], seen[i, rows[a]], period[a])
        for t in range(a):
            value -= root[a, t] * y[t]
        y[a] = value * root[a, a]
        total += y[a] * y[a]
    return total


@njit(**INNER)
def posterior(mean: F8, cross: F8, rows: I8, i: int, period: Period, root: F8, y: F8, w: F8, out: F8, k: int) -> None:
    """m_i + Wᵀ y into ``out[k]``, and W = L⁻¹ Cᵀ into ``w`` (r, d)."""
    d = mean.shape[1]
    for c in range(d):
        total = mean[i, c]
        for a in range(len(period)):
            value = cross[i, c, rows[a]]
            for t in range(a):
                value -= root[a, t] * w[t, c]
            w[a, c] = value * root[a, a]
            total += w[a, c] * y[a]
        out[k, c] = total


@njit(**INNER)
def posterior_covariance(covariance: F8, i: int, period: Period, w: F8, out: F8, k: int) -> None:
    """P_i − Wᵀ W into ``out[k]``; ``covariance`` (J, d, d), ``w`` as `posterior` leaves it."""
    for c in range(covariance.shape[1]):
        for b in range(c + 1):
            value = covariance[i, c, b]
            for a in range(len(period)):
                value -= w[a, c] * w[a, b]
            out[k, c, b] = value
            out[k, b, c] = value


class Places(NamedTuple):
    """Measurements in cells along one of their first two components, the one on which they are spread most.

    Attributes
    ----------
    along, across : that component, and the other one.
    first, second : (N,) both of each measurement, by cells.     order : (N,) which one it is.
    begin : (cells + 1,) where each cell begins.
    low, scale : a value lies in cell (value − low)·scale.
    near : whether what is far along an axis is far altogether: not of angles, which are all in one cell.
    """

    along: int
    across: int
    first: F8
    second: F8
    order: I8
    begin: I8
    low: float
    scale: float
    near: bool


@njit(**INNER)
def cell(value: float, low: float, scale: float, count: int) -> int:
    """Which of ``count`` cells from ``low`` on, ``scale`` of them a unit, holds a value; beyond them the nearest."""
    position = (value - low) * scale
    if not position > 0.0:  # also NaN
        return 0
    return count - 1 if position >= count else int(position)


@njit(**INNER)
def places_of(m: Measurements) -> Places:
    """The measurements in cells, about one in each. Raises ValueError where a measurement is NaN or infinite."""
    z, period = m.z, m.period
    n, along, low, widest, near = len(z), 0 * len(z), 0.0, 0.0, False
    for a in range(len(period)):
        least, most, total = np.inf, -np.inf, 0.0
        for j in range(n):
            least, most, total = min(least, z[j, a]), max(most, z[j, a]), total + z[j, a]
        if not np.isfinite(total):
            raise ValueError("measurements must be finite")
        if period[a] == 0.0 and a < 2 and most - least > widest:
            along, low, widest, near = a, least, most - least, True
    across = 1 - along if len(period) > 1 and period[1 - along] == 0.0 else along
    count = n if near else 1
    scale, begin, number = count / widest if near else 0.0, np.empty(count + 1, np.int64), np.empty(n, np.int64)
    for c in range(count + 1):
        begin[c] = 0
    for j in range(n):
        number[j] = cell(z[j, along], low, scale, count)
        begin[number[j]] += 1
    # From the last one back: a cell's end becomes its beginning.
    for c in range(count):
        begin[c + 1] += begin[c]
    first, second, order = np.empty(n), np.empty(n), np.empty(n, np.int64)
    for back in range(n):
        j = n - 1 - back
        begin[number[j]] -= 1
        k = begin[number[j]]
        order[k], first[k], second[k] = j, z[j, along], z[j, across]
    return Places(along, across, first, second, order, begin, low, scale, near)


@njit(**INNER)
def longer(values: NDArray[Any]) -> NDArray[Any]:
    """The same at the beginning of an array twice as long, of integers or of floats (P,)."""
    out = np.empty(2 * values.size, values.dtype)
    # In a loop: an assignment of a slice would compile Numba's code for its error messages.
    for k in range(values.size):
        out[k] = values[k]
    return out


@njit(**INNER)
def gated(e: Expected, m: Measurements, places: Places, gate: float, active: F8) -> Pairs:
    """The pairs (Gaussian, measurement) with d ≤ ``gate``, in time linear in Gaussians and pairs.

    Parameters
    ----------
    e : what the Gaussians say of measurements.
    m, places : the measurements.
    gate : in deviations of the innovation.
    active : (J,) Gaussians at which this is 0 are left out.
    """
    rows, seen, spread, noise, z, extra, period = e.rows, e.z, e.covariance, e.noise, m.z, m.noise, m.period
    along, across, first, second, order, begin, low, scale, near = places
    root, y, wide, high = np.empty((rows.size, rows.size)), np.empty(rows.size), 0.0, 0.0
    for j in range(len(extra)):
        wide, high = max(wide, extra[j, along, along]), max(high, extra[j, across, across])
    row, other, room, found = rows[along], rows[across], 2 * len(seen) + 2 * len(z) + 16, 0 * len(z)
    gaussian, measurement = np.empty(room, np.int64), np.empty(room, np.int64)
    distance2, log_density = np.empty(room), np.empty(room)
    cells, limit = begin.size - 1, gate * gate
    for i in range(len(seen)):
        if not active[i] > 0.0:
            continue
        reach, width = spread[i, row, row] + wide, spread[i, other, other] + high
        if len(noise) > 0:
            reach, width = reach + noise[i, along, along], width + noise[i, across, across]
        reach, width = gate * np.sqrt(reach) if near else np.inf, gate * np.sqrt(width) if near else np.inf
        x, middle = seen[i, row], seen[i, other]
        log_det, known = 0.0, False
        for k in range(begin[cell(x - reach, low, scale, cells)], begin[cell(x + reach, low, scale, cells) + 1]):
            if abs(first[k] - x) > reach or abs(second[k] - middle) > width:
                continue
            j = order[k]
            if len(extra) > 0 or not known:
                log_det, known = innovation_root(spread, rows, noise, extra, i, j, period, root), True
            d2 = whitened(seen, rows, z, i, j, period, root, y)
            if d2 <= limit:
                if found == gaussian.size:
                    gaussian, measurement = longer(gaussian), longer(measurement)
                    distance2, log_density = longer(distance2), longer(log_density)
                gaussian[found], measurement[found] = i, j
                distance2[found], log_density[found] = d2, -0.5 * (d2 + log_det)
                found += 1
    return Pairs(gaussian[:found], measurement[:found], distance2[:found], log_density[:found])


@njit(**INNER)
def write_posteriors(
    mean: F8, covariance: F8, e: Expected, m: Measurements, gaussian: I8, measurement: I8, out_mean: F8, out_covariance: F8,
    first: int,
) -> None:  # fmt: skip
    """Means and covariances of pairs after the update [V06 (37), (38)], from row ``first`` of the outputs on.

    Parameters
    ----------
    mean, covariance : (J, d), (J, d, d) before it.
    e, m : what these Gaussians say of measurements, and the measurements.
    gaussian, measurement : (P,) the pairs; faster where pairs of one Gaussian follow each other. Those of −1 are left out.
    out_mean, out_covariance : (K, d), (K, d, d) output.
    """
    rows, seen, spread, cross, noise = e.rows, e.z, e.covariance, e.cross, e.noise
    z, extra, period, last = m.z, m.noise, m.period, -1
    root, y, w = np.empty((rows.size, rows.size)), np.empty(rows.size), np.empty((rows.size, mean.shape[1]))
    for p in range(gaussian.size):
        i, j = gaussian[p], measurement[p]
        if j < 0:
            continue
        if len(extra) > 0 or i != last:
            innovation_root(spread, rows, noise, extra, i, j, period, root)
            last = i
        whitened(seen, rows, z, i, j, period, root, y)
        posterior(mean, cross, rows, i, period, root, y, w, out_mean, first + p)
        posterior_covariance(covariance, i, period, w, out_covariance, first + p)


@njit(**ENTRY)
def gated_pairs(e: Expected, m: Measurements, gate: float, active: F8) -> Pairs:
    """`gated`, to be called from Python."""
    out: Pairs = gated(e, m, places_of(m), gate, active)
    return out


@njit(**ENTRY)
def pair_posteriors(mean: F8, covariance: F8, e: Expected, m: Measurements, gaussian: I8, measurement: I8) -> tuple[F8, F8]:
    """Means (P, d) and covariances (P, d, d) of pairs, see `write_posteriors`."""
    d, count = mean.shape[1], gaussian.size
    out_mean, out_covariance = np.empty((count, d)), np.empty((count, d, d))
    write_posteriors(mean, covariance, e, m, gaussian, measurement, out_mean, out_covariance, 0)
    return out_mean, out_covariance


@njit(cache=True)
def predicted_covariance(cov: F8, f: F8, q: F8) -> F8:
    """(n, d, d) F P Fᵀ + Q of each; all three are (n, d, d)."""
    n, d, _ = cov.shape
    out = np.empty((n, d, d))
    half = np.empty((d, d))
    for i in range(n):
        for r in range(d):
            for s in range(d):
                total = 0.0
                for t in range(d):
                    total += f[i, r, t] * cov[i, t, s]
                half[r, s] = total
        for r in range(d):
            for s in range(r + 1):
                total = q[i, r, s]
                for t in range(d):
                    total += half[r, t] * f[i, s, t]
                out[i, r, s] = total
                out[i, s, r] = total
    return out


@njit(**ENTRY)
def first_states(births: Births, p_detect: F8, e: Expected, m: Measurements, gate: float) -> NewTargets:
    """γ̂(z) = ∫ p_D g(z|x) γ(x) dx, and mean and covariance of p_D g(z|x) γ(x) given z.

    Parameters
    ----------
    births : γ.
    p_detect : (N,) detection probability of those around each measurement.
    e : what the births that are given say of measurements.
    m : the measurements.
    gate : in deviations.
    """
    around, n, d = births.around, len(m.z), births.mean.shape[1]
    pairs = gated(e, m, places_of(m), gate, births.weight)
    states, covs = np.empty((pairs.gaussian.size, d)), np.empty((pairs.gaussian.size, d, d))
    write_posteriors(births.mean, births.covariance, e, m, pairs.gaussian, pairs.measurement, states, covs, 0)
    density, part = np.empty(n), np.empty(pairs.gaussian.size)
    for j in range(n):
        density[j] = p_detect[j] * around.density[j]
    for q in range(part.size):
        i = pairs.gaussian[q]
        part[q] = births.weight[i] * e.p_detect[i] * np.exp(pairs.log_density[q])
        density[pairs.measurement[q]] += part[q]
    mean, cov = np.zeros((n, d)), np.zeros((n, d, d))
    # First the means, then the covariances about them.
    for turn in range(2):
        for q in range(part.size + n):
            from_given = q < part.size
            k = q if from_given else q - part.size
            j = pairs.measurement[k] if from_given else k
            weight = part[k] if from_given else p_detect[j] * around.density[j]
            if not weight > 0.0:
                continue
            share = weight / density[j]
            for a in range(d):
                state = states[k, a] if from_given else around.mean[j, a]
                if turn == 0:
                    mean[j, a] += share * state
                    continue
                for b in range(d):
                    other = states[k, b] if from_given else around.mean[j, b]
                    value = covs[k, a, b] if from_given else around.covariance[j, a, b]
                    cov[j, a, b] += share * (value + (state - mean[j, a]) * (other - mean[j, b]))
    return NewTargets(density, mean, cov)
