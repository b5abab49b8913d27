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
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, INNER

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
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

    Attributes
    ----------
    z : (J, r) expected measurement.
    covariance : (J, r, r) of it without noise: H P Hᵀ, or that of sigma points.
    cross : (J, d, r) covariance of state and measurement, P Hᵀ.
    noise : (J, r, r) part of R that belongs to the target, or (0, r, r) where none does.
    p_detect : (J,) detection probability at the mean.
    """

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
    period : (r,) 2π for angles, whose differences are taken the short way round, else 0.
    """

    z: F8
    noise: F8
    clutter: F8
    period: F8


class Births(NamedTuple):
    """γT, the intensity of targets that appeared in the interval, as Gaussians.

    A Gaussian is drawn around a detection or stands for itself. All those around detections are given, as if no target were
    there: a filter leaves out those whose detection existing targets explain.

    Attributes
    ----------
    weight : (B,) expected number of births that the Gaussian stands for.
    mean : (B, d).     covariance : (B, d, d).
    measurement : (B,) int64, the detection that it is drawn around, −1 for none.
    density : (B,) ∫ g(z|x) γT(x) dx at that detection, per unit of measurement volume, p_D left out; 0 where there is none.
    first : (B, d, d) covariance about ``mean`` after that detection: γ is flat there, so that the detection alone says where
        the target is. (Around a detection ``covariance`` is wider: seen through the noise, the Gaussian has the density
        of γ.) Equal to ``covariance`` where there is no detection.
    """

    weight: F8
    mean: F8
    covariance: F8
    measurement: I8
    density: F8
    first: F8


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


class Work(NamedTuple):
    """Working space of one pair: ``root`` (r, r) lower factor of S, ``y`` (r,), ``w`` (r, d)."""

    root: F8
    y: F8
    w: F8


@njit(**INNER)
def work_space(d: int, r: int) -> Work:
    """Working space for states of d and measurements of r components."""
    return Work(np.zeros((r, r)), np.zeros(r), np.zeros((r, d)))


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


@njit(**INNER)
def innovation_root(e: Expected, m: Measurements, i: int, j: int, root: F8) -> float:
    """log |2πS| of Gaussian i and measurement j, and the lower Cholesky factor of S into ``root`` (r, r).

    NaN where S is not positive definite. Without noise of measurements j does not count.
    """
    size, product = root.shape[0], 1.0
    of_target, of_measurement = len(e.noise) > 0, len(m.noise) > 0
    for a in range(size):
        for b in range(a + 1):
            value = e.covariance[i, a, b]
            if of_target:
                value += e.noise[i, a, b]
            if of_measurement:
                value += m.noise[j, a, b]
            for t in range(b):
                value -= root[a, t] * root[b, t]
            if a == b:
                # Not positive: NaN, with which nothing is within a gate.
                root[a, a] = np.sqrt(value) if value > 0.0 else np.nan
                product *= root[a, a]
            else:
                root[a, b] = value / root[b, b]
    log_det: float = 2.0 * np.log(product) + size * LOG_2PI
    return log_det


@njit(**INNER)
def whitened(e: Expected, m: Measurements, i: int, j: int, work: Work) -> float:
    """d² of Gaussian i and measurement j, and y = L⁻¹ (z − ẑ) into ``work.y``; L is in ``work.root``."""
    total = 0.0
    for a in range(work.y.size):
        value = difference(m.z[j, a], e.z[i, a], m.period[a])
        for t in range(a):
            value -= work.root[a, t] * work.y[t]
        work.y[a] = value / work.root[a, a]
        total += work.y[a] * work.y[a]
    return total


@njit(**INNER)
def gain(e: Expected, i: int, work: Work) -> None:
    """W = L⁻¹ Cᵀ of Gaussian i into ``work.w``; L is in ``work.root``."""
    for c in range(e.cross.shape[1]):
        for a in range(work.y.size):
            value = e.cross[i, c, a]
            for t in range(a):
                value -= work.root[a, t] * work.w[t, c]
            work.w[a, c] = value / work.root[a, a]


@njit(**INNER)
def posterior_mean(mean: F8, i: int, work: Work, out: F8, k: int) -> None:
    """m_i + Wᵀ y into ``out[k]``; ``mean`` (J, d), W and y are in ``work``."""
    for c in range(mean.shape[1]):
        value = mean[i, c]
        for a in range(work.y.size):
            value += work.w[a, c] * work.y[a]
        out[k, c] = value


@njit(**INNER)
def posterior_covariance(covariance: F8, i: int, work: Work, out: F8, k: int) -> None:
    """P_i − Wᵀ W into ``out[k]``; ``covariance`` (J, d, d), W is in ``work``."""
    for c in range(covariance.shape[1]):
        for b in range(c + 1):
            value = covariance[i, c, b]
            for a in range(work.y.size):
                value -= work.w[a, c] * work.w[a, b]
            out[k, c, b] = value
            out[k, b, c] = value


@njit(**INNER)
def sorted_along(z: F8, period: F8) -> tuple[int, I8]:
    """The axis along which measurements (N, r) are searched, −1 where there is none, and their order along it, rising.

    The axis is that of the first two on which they are spread most; angles have no order. Raises ValueError where a
    measurement is NaN or infinite.
    """
    axis, widest, n = -1, -1.0, z.shape[0]
    for a in range(period.size):
        low, high, total = np.inf, -np.inf, 0.0
        for j in range(n):
            low, high, total = min(low, z[j, a]), max(high, z[j, a]), total + z[j, a]
        if not np.isfinite(total):
            raise ValueError("measurements must be finite")
        if period[a] == 0.0 and a < 2 and high - low > widest:
            axis, widest = a, high - low
    order, gap = np.empty(n, np.int64), 1
    for j in range(n):
        order[j] = j
    # Shell's sort: for a thousand as fast as better ones, and much faster to compile.
    while 3 * gap + 1 < n:
        gap = 3 * gap + 1
    while axis >= 0 and gap > 0:
        for k in range(gap, n):
            j, place = order[k], k
            while place >= gap and z[order[place - gap], axis] > z[j, axis]:
                order[place] = order[place - gap]
                place -= gap
            order[place] = j
        gap //= 3
    return axis, order


@njit(**INNER)
def longer(index: I8, value: F8) -> tuple[I8, F8]:
    """The same rows at the beginning of arrays twice as long."""
    n = len(index)
    more_index, more_value = np.empty((2 * n, index.shape[1]), np.int64), np.empty((2 * n, value.shape[1]))
    # In a loop: an assignment of rows would compile Numba's code for its error messages.
    for k in range(n):
        for a in range(index.shape[1]):
            more_index[k, a] = index[k, a]
        for a in range(value.shape[1]):
            more_value[k, a] = value[k, a]
    return more_index, more_value


@njit(**INNER)
def gated(e: Expected, m: Measurements, gate: float) -> Pairs:
    """The pairs (Gaussian, measurement) with d ≤ ``gate``, in time linear in Gaussians and pairs but for one sorted axis.

    Raises ValueError where a measurement is NaN or infinite.
    """
    seen, cov, noise, z, extra, period = e.z, e.covariance, e.noise, m.z, m.noise, m.period
    axis, order = sorted_along(z, period)
    work, along, gate2, wide, high = work_space(e.cross.shape[1], period.size), max(axis, 0), gate * gate, 0.0, 0.0
    # The other of the first two axes, where there is one that is no angle.
    across = 1 - along if period.size > 1 and period[1 - along] == 0.0 else along
    first, second = np.empty(len(z)), np.empty(len(z))
    for k in range(len(z)):
        first[k], second[k] = z[order[k], along], z[order[k], across]
    for j in range(len(extra)):
        wide, high = max(wide, extra[j, along, along]), max(high, extra[j, across, across])
    room, found = 2 * len(seen) + 2 * len(z) + 16, 0 * len(z)
    index, number = np.empty((room, 2), np.int64), np.empty((room, 2))
    for i in range(len(seen)):
        reach, width = cov[i, along, along] + wide, cov[i, across, across] + high
        if len(noise) > 0:
            reach, width = reach + noise[i, along, along], width + noise[i, across, across]
        reach, width = gate * np.sqrt(reach), gate * np.sqrt(width)
        begin, end, log_det, known = 0 * found, len(z), 0.0, False
        x, y = seen[i, along], seen[i, across]
        while axis >= 0 and begin < end:
            middle = (begin + end) // 2
            if first[middle] < x - reach:
                begin = middle + 1
            else:
                end = middle
        for k in range(begin, len(z)):
            if axis >= 0 and first[k] > x + reach:
                break
            if axis >= 0 and abs(second[k] - y) > width:
                continue
            j = order[k]
            if len(extra) > 0 or not known:
                log_det, known = innovation_root(e, m, i, j, work.root), True
            d2 = whitened(e, m, i, j, work)
            if d2 <= gate2:
                if found == len(index):
                    index, number = longer(index, number)
                index[found, 0], index[found, 1] = i, j
                number[found, 0], number[found, 1] = d2, -0.5 * (d2 + log_det)
                found += 1
    return Pairs(index[:found, 0].copy(), index[:found, 1].copy(), number[:found, 0].copy(), number[:found, 1].copy())


@njit(**INNER)
def posteriors(mean: F8, covariance: F8, e: Expected, m: Measurements, gaussian: I8, measurement: I8) -> tuple[F8, F8]:
    """Means (P, d) and covariances (P, d, d) of pairs after the update [V06 (37), (38)].

    Parameters
    ----------
    mean, covariance : (J, d), (J, d, d) before it.
    e, m : what these Gaussians say of measurements, and the measurements.
    gaussian, measurement : (P,) the pairs; faster where pairs of one Gaussian follow each other.
    """
    d, count, fixed = mean.shape[1], gaussian.size, len(m.noise) == 0
    work = work_space(d, m.period.size)
    out_mean, out_covariance = np.empty((count, d)), np.empty((count, d, d))
    for p in range(count):
        i, j = gaussian[p], measurement[p]
        same = fixed and p > 0 and gaussian[p - 1] == i
        if not same:
            innovation_root(e, m, i, j, work.root)
            gain(e, i, work)
        whitened(e, m, i, j, work)
        posterior_mean(mean, i, work, out_mean, p)
        if same:
            for c in range(d):
                for b in range(d):
                    out_covariance[p, c, b] = out_covariance[p - 1, c, b]
        else:
            posterior_covariance(covariance, i, work, out_covariance, p)
    return out_mean, out_covariance


@njit(**ENTRY)
def gated_pairs(e: Expected, m: Measurements, gate: float) -> Pairs:
    """`gated`, to be called from Python."""
    out: Pairs = gated(e, m, gate)
    return out


@njit(**ENTRY)
def pair_posteriors(mean: F8, covariance: F8, e: Expected, m: Measurements, gaussian: I8, measurement: I8) -> tuple[F8, F8]:
    """`posteriors`, to be called from Python."""
    out: tuple[F8, F8] = posteriors(mean, covariance, e, m, gaussian, measurement)
    return out


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


class NewTargets(NamedTuple):
    """Targets whose first detection is measurement j: ``density`` (N,) γ̂, ``mean`` (N, d), ``covariance`` (N, d, d)."""

    density: F8
    mean: F8
    covariance: F8


@njit(**ENTRY)
def first_states(births: Births, e: Expected, m: Measurements, gate: float) -> NewTargets:
    """γ̂(z) = ∫ p_D g(z|x) γ(x) dx, and mean and covariance of p_D g(z|x) γ(x) given z.

    Parameters
    ----------
    births : γ. One around a detection is flat there: the detection alone says where the target is.
    e : what the births say of measurements; without births that stand for themselves ``p_detect`` is enough.
    m : the measurements.
    gate : in deviations.
    """
    n, d, count = len(m.z), births.mean.shape[1], births.weight.size
    pairs = gated(e, m, gate)
    states, covs = posteriors(births.mean, births.covariance, e, m, pairs.gaussian, pairs.measurement)
    density, mean, cov = np.zeros(n), np.zeros((n, d)), np.zeros((n, d, d))
    total = pairs.gaussian.size + count
    part, of = np.zeros(total), np.zeros(total, np.int64)
    for q in range(total):
        b = pairs.gaussian[q] if q < pairs.gaussian.size else q - pairs.gaussian.size
        around = births.measurement[b] >= 0
        if q < pairs.gaussian.size:
            of[q] = pairs.measurement[q]
            part[q] = 0.0 if around else births.weight[b] * e.p_detect[b] * np.exp(pairs.log_density[q])
        elif around:
            of[q], part[q] = births.measurement[b], e.p_detect[b] * births.density[b]
        density[of[q]] += part[q]
    # First the means, then the covariances about them.
    for turn in range(2):
        for q in range(total):
            if not part[q] > 0.0:
                continue
            j, b = of[q], q - pairs.gaussian.size
            share = part[q] / density[j]
            for k in range(d):
                state = states[q, k] if b < 0 else births.mean[b, k]
                if turn == 0:
                    mean[j, k] += share * state
                    continue
                for c in range(d):
                    other = states[q, c] if b < 0 else births.mean[b, c]
                    value = covs[q, k, c] if b < 0 else births.first[b, k, c]
                    cov[j, k, c] += share * (value + (state - mean[j, k]) * (other - mean[j, c]))
    return NewTargets(density, mean, cov)
