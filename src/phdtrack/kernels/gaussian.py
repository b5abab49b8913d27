"""Gaussians and measurements of one frame as arrays, and what all Gaussian filters compute from
them [V06 (24)–(38)].

For one frame a model is four records, which `models.gaussian` makes: `Predicted` (its motion),
`Expected` (its sensor), `Measurements` (its sensor and its clutter) and `Births`. GM-PHD, GM-CPHD,
PMB and MHT are compiled over these records and know nothing else of the model: boxes, ground plane,
points and bearings, linear or by sigma points, are all the same here.

For Gaussian i with expected measurement ẑ_i, spread H P Hᵀ (or that of its sigma points) and
cross-covariance C = P Hᵀ, and measurement j, with R = R_i + R_j

    S = H P Hᵀ + R = L D Lᵀ,   y = L⁻¹ (z_j − ẑ_i),   W = L⁻¹ Cᵀ
    d² = yᵀ D⁻¹ y,   log N(z_j; ẑ_i, S) = −(d² + log |2πS|)/2
    m' = m + Wᵀ D⁻¹ y,   P' = P − Wᵀ D⁻¹ W

which is symmetric by construction and needs no inverse. If no noise belongs to a measurement, S is
the same for all measurements and factored once for each Gaussian.

Arrays are C-contiguous, float64 or int64; the first axis counts Gaussians (J), births (B),
measurements (N) or pairs (P). A state has d components, and r components of a measurement are
compared. The functions here are for kernels (`INNER`): a filter calls them in a kernel that is
compiled for it.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from phdtrack.kernels import F8, I8, Records
from phdtrack.kernels.cache import njit, without_compilation
from phdtrack.kernels.fast32 import ENTRY, INLINED, INNER
from phdtrack.kernels.grid import cell_of, sorted_by_cell

Period = tuple[float, ...]
Axes = tuple[float, ...] | tuple[int, ...]
LOG_2PI = math.log(2 * math.pi)


class Predicted(NamedTuple):
    """Gaussians after an interval [V06 (24)–(29)].

    ``mean`` (J, d), ``covariance`` (J, d, d), ``p_survive`` (J,): probability that the target is
    still there.
    """

    mean: F8
    covariance: F8
    p_survive: F8


class Expected(NamedTuple):
    """Predicted measurements of Gaussians.

    ``rows`` (r,), int64: the rows of ``z`` that are compared with the components of a measurement.
    ``z`` (J, n): predicted measurements ẑ. ``covariance`` (J, n, n): theirs without noise, H P Hᵀ
    in these rows and columns. ``cross`` (J, d, n): of state and measurement, P Hᵀ in these columns.
    ``noise`` (J, r, r): the part of R that belongs to the target, (0, r, r) if none does.
    ``p_detect`` (J,): p_D at the mean.

    A linear sensor observes ``rows`` of the state: then ``z`` is the mean, and ``covariance`` and
    ``cross`` are the covariance of the Gaussians themselves. For any other sensor they come from
    sigma points, and ``rows`` are 0, 1, …, r − 1.
    """

    rows: I8
    z: F8
    covariance: F8
    cross: F8
    noise: F8
    p_detect: F8


class Measurements(NamedTuple):
    """The measurements of a frame.

    ``z`` (N, r) is compared with `Expected.z`. ``noise`` (N, r, r): the part of R that belongs to
    the measurement, added to that of the target, or (0, r, r). ``clutter`` (N,): κ(z), expected
    false alarms per unit of measurement volume. ``period``: r numbers, 2π for angles, whose
    differences are taken the short way round, else 0. A tuple, because its length is known when a
    kernel is compiled, and loops over it are unrolled.
    """

    z: F8
    noise: F8
    clutter: F8
    period: Period


class NewTargets(NamedTuple):
    """Targets whose first detection is measurement j.

    ``density`` (N,): expected number of them at the measurement, per unit of its volume. ``mean``
    (N, d), ``covariance`` (N, d, d) of their states.
    """

    density: F8
    mean: F8
    covariance: F8


class Births(NamedTuple):
    """γT, the intensity of targets that appeared in the interval.

    ``around``: γT at each measurement, and the state that this measurement alone implies. Filters
    leave out those whose measurement existing targets explain. ``weight`` (B,), ``mean`` (B, d),
    ``covariance`` (B, d, d): fixed Gaussians, which do not depend on measurements, with their
    expected numbers of births.
    """

    around: NewTargets
    weight: F8
    mean: F8
    covariance: F8


def records(floats: str, integers: str) -> np.dtype[np.void]:
    """The type of arrays of records with these fields.

    Without compilation Python must read the fields as attributes.
    """
    fields = [(name, "f8") for name in floats.split()] + [(name, "i8") for name in integers.split()]
    if without_compilation():
        return np.dtype((np.record, fields))
    return np.dtype(fields)


# A Gaussian and a measurement within the gate of each other: d², the first two components' part of
# it, the log of the measurement's density, and the weight that a filter gives to the pair.
PAIR = records("distance2 first log_density weight", "gaussian measurement")
# The ``tails`` of `gated` if all noises are the model's.
GAUSSIAN = np.zeros((0, 3))
# `Measurements.period` of boxes: none of the four components is an angle.
FOUR_LENGTHS = (0.0, 0.0, 0.0, 0.0)
# A measurement in `by_position`: its components along and across, and its number.
SPOT = records("along across", "measurement")


@njit(**INLINED)
def factor(cov: F8, root: F8) -> float:
    """Log-determinant of ``cov`` (m, m); writes its Cholesky factor into the lower part of ``root``
    (m, m).

    NaN if the matrix is not positive definite, −∞ or NaN if it is singular.
    """
    product = 1.0
    for r in range(cov.shape[0]):
        for s in range(r + 1):
            value = cov[r, s]
            for t in range(s):
                value -= root[r, t] * root[s, t]
            if s < r:
                root[r, s] = value / root[s, s]
            else:
                root[r, r] = np.sqrt(value)
        product *= root[r, r]
    log_det: float = 2.0 * np.log(product)
    return log_det


@njit(**INNER)
def norm2(step: F8, root: F8, y: F8) -> float:
    """Squared Mahalanobis norm of ``step`` (m,) for the covariance with Cholesky factor ``root``;
    ``y`` (m,) becomes L⁻¹ step.
    """
    total = 0.0
    for r in range(step.size):
        value = step[r]
        for t in range(r):
            value -= root[r, t] * y[t]
        y[r] = value / root[r, r]
        total += y[r] * y[r]
    return total


@njit(**ENTRY)
def gaussian_parts(step: F8, cov: F8) -> tuple[F8, F8]:
    """(P,) squared Mahalanobis norms and log-determinants: ``step`` (m, P), ``cov`` (P, m, m)
    positive definite.

    NaN if a matrix is not positive definite.
    """
    m, count = step.shape
    distance2 = np.empty(count)
    log_det = np.empty(count)
    root = np.empty((m, m))
    y = np.empty(m)
    for p in range(count):
        log_det[p] = factor(cov[p], root)
        distance2[p] = norm2(step[:, p], root, y)
    return distance2, log_det


@njit(**INNER)
def factored(s: F8, axes: Axes) -> float:
    """The determinant of S, whose lower part is in ``s`` (r, r); replaces it by the factors of S =
    L D Lᵀ.

    L below the diagonal, D⁻¹ in it, (L D)ᵀ above it. NaN if S is not positive definite. ``axes``
    has r elements.
    """
    product = 1.0
    for a in range(len(axes)):
        pivot = s[a, a]
        for b in range(a):
            value = s[a, b]
            for t in range(b):
                value -= s[t, a] * s[b, t]
            s[b, a] = value
            s[a, b] = value * s[b, b]
            pivot -= value * s[a, b]
        product *= pivot
        # Not positive: NaN, with which nothing is within a gate.
        s[a, a] = 1.0 / pivot if pivot > 0.0 else np.nan
    return product


# The functions of one pair take arrays and no records: a record in a loop would have all of its
# arrays counted again.
@njit(**INNER)
def innovation(
    spread: F8, rows: I8, noise: F8, extra: F8, i: int, j: int, period: Axes, s: F8
) -> float:
    """|S| of Gaussian i and measurement j; writes the factors of S into ``s`` (r, r), see
    `factored`.

    ``spread``, ``rows`` and ``noise`` are of `Expected`, ``extra`` (the noise) and ``period`` of
    `Measurements`. j does not matter if measurements have no noise of their own.
    """
    for a in range(len(period)):
        for b in range(a + 1):
            s[a, b] = spread[i, rows[a], rows[b]]
            if len(noise) > 0:
                s[a, b] += noise[i, a, b]
            if len(extra) > 0:
                s[a, b] += extra[j, a, b]
    determinant: float = factored(s, period)
    return determinant


@njit(**INNER)
def whitened(predicted: F8, rows: I8, z: F8, i: int, j: int, period: Axes, s: F8, y: F8) -> float:
    """d² of Gaussian i and measurement j; writes L⁻¹ (z − ẑ) into ``y`` (r,).

    ``predicted`` (ẑ) and ``rows`` are of `Expected`, ``z`` and ``period`` of `Measurements`, ``s``
    of `innovation`.
    """
    total = 0.0
    for a in range(len(period)):
        value = z[j, a] - predicted[i, rows[a]]
        if period[a] > 0.0:
            value -= period[a] * np.rint(value / period[a])
        for t in range(a):
            value -= s[a, t] * y[t]
        y[a] = value
        total += value * value * s[a, a]
    return total


@njit(**INNER)
def by_position(z: F8, period: Axes) -> tuple[Records, I8, int, int, float, float, bool]:
    """Sort the measurements into cells along one of their first two components, that with the
    largest extent.

    (N,) of `SPOT`, about one in each cell; where each cell begins (cells + 1,); that component, and
    the other one; low and scale, a value lies in cell (value − low)·scale; whether a distance along
    the axis bounds the distance: not for angles, which are all in one cell. Raises ValueError if a
    measurement is NaN or infinite.
    """
    n = len(z)
    along = 0 * len(z)
    low = 0.0
    widest = 0.0
    bounded = False
    for a in range(len(period)):
        smallest, largest = _extent_of(z, a)
        if period[a] == 0.0 and a < 2 and largest - smallest > widest:
            along = a
            low = smallest
            widest = largest - smallest
            bounded = True
    across = along
    if len(period) > 1 and period[1 - along] == 0.0:
        across = 1 - along
    count = 1
    scale = 0.0
    if bounded:
        count = n
        scale = count / widest
    cell = np.empty(n, np.int64)
    for j in range(n):
        cell[j] = cell_of(z[j, along], low, scale, count)
    begin, order = sorted_by_cell(cell, count)
    spots = np.empty(n, SPOT)
    for k in range(n):
        spot = spots[k]
        spot.along = z[order[k], along]
        spot.across = z[order[k], across]
        spot.measurement = order[k]
    return spots, begin, along, across, low, scale, bounded


@njit(**INNER)
def _extent_of(z: F8, a: int) -> tuple[float, float]:
    """The smallest and the largest value of component a; ValueError if one is not finite."""
    smallest = np.inf
    largest = -np.inf
    total = 0.0
    for j in range(len(z)):
        value = z[j, a]
        smallest = min(smallest, value)
        largest = max(largest, value)
        total = total + value
    if not np.isfinite(total):
        raise ValueError("measurements must be finite")
    return smallest, largest


@njit(**INNER)
def log_tails(
    first: float, rest: float, count: int, log_scales: tuple[float, float], freedom: float
) -> float:
    """The log-density, without −log(2π)^(m/2)√|S|, for noises whose variances are c times the
    model's [WH97 §10.8].

    Each two of the ``count`` components, 2 or 4, have Student's t-distribution: −log c − (n/2 + 1)
    log(1 + d²/(nc)), with d²/c ``first`` and ``rest``, log c ``log_scales``, and n the degrees of
    freedom.
    """
    power = 0.5 * freedom + 1.0
    value = -log_scales[0] - power * np.log1p(first / freedom)
    if count > 2:
        value -= log_scales[1] + power * np.log1p(rest / freedom)
    return float(value)


@njit(**INNER)
def _gate_extents(
    spread: F8, noise: F8, extra: F8, tails: F8, row: int, a: int, gate: float, bounded: bool
) -> F8:
    """(J,) half the extents of the gates in component a, which is ``row`` of ``spread``."""
    widest = 0.0
    for j in range(len(extra)):
        widest = max(widest, extra[j, a, a])
    out = np.empty(len(spread))
    for i in range(len(spread)):
        variance = spread[i, row, row] + widest
        if len(noise) > 0:
            variance = variance + noise[i, a, a]
        if len(tails) > 0:
            variance = variance * tails[i, 0]
        out[i] = gate * np.sqrt(variance) if bounded else np.inf
    return out


@njit(**INNER)
def _longer(pairs: Records) -> Records:
    """A copy of the pairs with room for as many again.

    In a loop, because Numba would compile code for error messages with an assignment of slices.
    """
    out = np.empty(2 * pairs.size, PAIR)
    for q in range(pairs.size):
        out[q] = pairs[q]
    return out


@njit(**INNER)
def _by_tails(d2: float, y: F8, s: F8, count: int, tails: F8, i: int) -> tuple[float, float, float]:
    """The part of d² of the first two of ``count`` components, and that part and the rest over c,
    which is in ``tails`` as of `gated`; d², d² and 0 without tails. ``y`` is of `whitened`.
    """
    if len(tails) == 0:
        return d2, d2, 0.0
    if count <= 2:
        return d2, d2 / tails[i, 0], 0.0
    first = y[0] * y[0] * s[0, 0] + y[1] * y[1] * s[1, 1]
    return first, first / tails[i, 0], (d2 - first) / tails[i, 1]


@njit(**INNER)
def _write_pair(pair: Any, i: int, j: int, values: tuple[float, float, float]) -> None:
    """Write a pair of Gaussian i and measurement j; ``values`` are d² of all components and of the
    first two, and the log-density.
    """
    pair.gaussian = i
    pair.measurement = j
    pair.distance2 = values[0]
    pair.first = values[1]
    pair.log_density = values[2]


@njit(**INNER)
def gated(
    rows: I8,
    predicted: F8,
    spread: F8,
    noise: F8,
    z: F8,
    extra: F8,
    period: Axes,
    gate: float,
    active: F8,
    tails: F8,
) -> Records:
    """(P,) of `PAIR`, the pairs (Gaussian, measurement) with d ≤ ``gate``, in time linear in
    Gaussians and pairs.

    They are ordered by Gaussian; their weight is not written. The first arguments are those of
    `Expected` and `Measurements`. Gaussians at which ``active`` (J,) is 0 are left out. ``tails``
    (J, 3): c of the first two components and of two others, and n, see `log_tails`; `GAUSSIAN` for
    none.
    """
    spots, begin, along, across, low, scale, bounded = by_position(z, period)
    s = np.empty((rows.size, rows.size))
    y = np.empty(rows.size)
    reach = _gate_extents(spread, noise, extra, tails, rows[along], along, gate, bounded)
    width = _gate_extents(spread, noise, extra, tails, rows[across], across, gate, bounded)
    count = 0 * len(z)
    pairs = np.empty(2 * len(predicted) + 2 * len(z) + 16, PAIR)
    for i in range(len(predicted)):
        if not active[i] > 0.0:
            continue
        x = predicted[i, rows[along]]
        middle = predicted[i, rows[across]]
        log_det = np.nan
        log_scales = (0.0, 0.0)
        first_cell = cell_of(x - reach[i], low, scale, begin.size - 1)
        last_cell = cell_of(x + reach[i], low, scale, begin.size - 1)
        for k in range(begin[first_cell], begin[last_cell + 1]):
            spot = spots[k]
            if abs(spot.along - x) > reach[i] or abs(spot.across - middle) > width[i]:
                continue
            j = spot.measurement
            if len(extra) > 0 or np.isnan(log_det):
                log_det = (
                    np.log(innovation(spread, rows, noise, extra, i, j, period, s))
                    + len(period) * LOG_2PI
                )
                if len(tails) > 0:
                    log_scales = (np.log(tails[i, 0]), np.log(tails[i, 1]))
            d2 = whitened(predicted, rows, z, i, j, period, s, y)
            first, near, rest = _by_tails(d2, y, s, len(period), tails, i)
            if not near + rest <= gate * gate:
                continue
            if len(tails) > 0:
                value = log_tails(near, rest, len(period), log_scales, tails[i, 2])
                log_density = value - 0.5 * log_det
            else:
                log_density = -0.5 * (d2 + log_det)
            if count == pairs.size:
                pairs = _longer(pairs)
            _write_pair(pairs[count], i, j, (d2, first, log_density))
            count += 1
    return pairs[:count]


@njit(**INNER)
def write_posteriors(
    mean: F8,
    covariance: F8,
    e: Expected,
    m: Measurements,
    pairs: Records,
    out_mean: F8,
    out_covariance: F8,
) -> None:
    """Write means and covariances of pairs after the update [V06 (37), (38)] into the first rows of
    the outputs.

    ``pairs`` (P,) of `PAIR`: faster if those of one Gaussian follow each other. Those of
    measurement −1 are left out.
    """
    rows = e.rows
    predicted = e.z
    spread = e.covariance
    cross = e.cross
    noise = e.noise
    z = m.z
    extra = m.noise
    period = m.period
    last = -1
    d = mean.shape[1]
    s = np.empty((rows.size, rows.size))
    y = np.empty(rows.size)
    w = np.empty((d, rows.size))
    for p in range(pairs.size):
        i = pairs[p].gaussian
        j = pairs[p].measurement
        if j < 0:
            continue
        if len(extra) > 0 or i != last:
            innovation(spread, rows, noise, extra, i, j, period, s)
            last = i
        whitened(predicted, rows, z, i, j, period, s, y)
        for c in range(d):
            total = mean[i, c]
            for a in range(len(period)):
                value = cross[i, c, rows[a]]
                for t in range(a):
                    value -= s[a, t] * w[c, t]
                w[c, a] = value
                total += value * s[a, a] * y[a]
            out_mean[p, c] = total
            for b in range(c + 1):
                value = covariance[i, c, b]
                for a in range(len(period)):
                    value -= w[c, a] * s[a, a] * w[b, a]
                out_covariance[p, c, b] = value
                out_covariance[p, b, c] = value


@njit(**INNER)
def copy_gaussian(
    mean: F8, covariance: F8, i: int, out_mean: F8, out_covariance: F8, k: int
) -> None:
    """Copy Gaussian i to row k of the outputs.

    In loops, because Numba would compile code for error messages with an assignment of rows.
    """
    for a in range(mean.shape[1]):
        out_mean[k, a] = mean[i, a]
        for b in range(mean.shape[1]):
            out_covariance[k, a, b] = covariance[i, a, b]


# The same two, callable from Python.
all_gated, all_posteriors = (
    njit(**ENTRY)(getattr(kernel, "py_func", kernel)) for kernel in (gated, write_posteriors)
)


@njit(**INNER)
def _add_mean(share: float, states: F8, k: int, mean: F8, j: int) -> None:
    """Add a share of state k to mean j."""
    for a in range(mean.shape[1]):
        mean[j, a] += share * states[k, a]


@njit(**INNER)
def _add_covariance(share: float, states: F8, covs: F8, k: int, mean: F8, cov: F8, j: int) -> None:
    """Add a share of covariance k, about mean j, to covariance j."""
    for a in range(mean.shape[1]):
        for b in range(mean.shape[1]):
            step = (states[k, a] - mean[j, a]) * (states[k, b] - mean[j, b])
            cov[j, a, b] += share * (covs[k, a, b] + step)


@njit(**ENTRY)
def first_states(
    births: Births, p_detect: F8, e: Expected, m: Measurements, gate: float
) -> NewTargets:
    """λ̂(z) = ∫ p_D g(z|x) λ⁺(x) dx, and mean and covariance of p_D g(z|x) λ⁺(x) given z
    [PMB (5)]. λ⁺ are the ``births``.

    ``p_detect`` (N,): p_D of targets around each measurement. ``e``: predicted measurements of the
    fixed Gaussians of births.
    """
    around = births.around
    n = len(m.z)
    d = births.mean.shape[1]
    pairs = gated(
        e.rows, e.z, e.covariance, e.noise, m.z, m.noise, m.period, gate, births.weight, GAUSSIAN
    )
    states = np.empty((pairs.size, d))
    covs = np.empty((pairs.size, d, d))
    write_posteriors(births.mean, births.covariance, e, m, pairs, states, covs)
    density = np.empty(n)
    for j in range(n):
        density[j] = p_detect[j] * around.density[j]
    own = density.copy()
    for q in range(pairs.size):
        pair = pairs[q]
        i = pair.gaussian
        pair.weight = births.weight[i] * e.p_detect[i] * np.exp(pair.log_density)
        density[pair.measurement] += pair.weight
    mean = np.zeros((n, d))
    cov = np.zeros((n, d, d))
    for q in range(pairs.size):
        j = pairs[q].measurement
        if pairs[q].weight > 0.0:
            _add_mean(pairs[q].weight / density[j], states, q, mean, j)
    for j in range(n):
        if own[j] > 0.0:
            _add_mean(own[j] / density[j], around.mean, j, mean, j)
    # Covariances are about the means, which are complete now.
    for q in range(pairs.size):
        j = pairs[q].measurement
        if pairs[q].weight > 0.0:
            _add_covariance(pairs[q].weight / density[j], states, covs, q, mean, cov, j)
    for j in range(n):
        if own[j] > 0.0:
            _add_covariance(own[j] / density[j], around.mean, around.covariance, j, mean, cov, j)
    return NewTargets(density, mean, cov)


@njit(**ENTRY)
def learned_births(
    measured: tuple[F8, F8],
    weight: F8,
    learned: Expected,
    gate: float,
    volume: tuple[F8, F8, float],
    rate: F8,
    least: float,
) -> NewTargets:
    """Births at detections from a density of states, with what it says of the components that are
    not observed.

    The density is ``volume``, the bounds of the observed components and a flat density between
    them, and Gaussians. Its evidence at each detection, not less than ``least``, is multiplied by
    ``rate`` (N,).

    ``measured``: states (d, N) and covariances (N, d, d) that the detections alone imply.
    ``weight``, ``learned``, ``gate``: the weights of the Gaussians, their predicted measurements,
    and the distance beyond which none counts.
    """
    state, noise = measured
    low, high, flat = volume
    rows = learned[0]
    d, n = state.shape
    z = np.empty((n, rows.size))
    spread = np.empty((n, rows.size, rows.size))
    mean = np.empty((n, d))
    covariance = noise.copy()
    hidden = np.ones(d, np.bool_)
    for a in range(rows.size):
        hidden[rows[a]] = False
    for j in range(n):
        for c in range(d):
            mean[j, c] = state[c, j]
        for a in range(rows.size):
            z[j, a] = state[rows[a], j]
            for b in range(rows.size):
                spread[j, a, b] = noise[j, rows[a], rows[b]]
    expected = Expected(rows, learned[1], learned[2], learned[3], learned[4], learned[5])
    # The Gaussians' means and covariances are their predicted measurements, in all components.
    births = Births(
        NewTargets(np.full(n, flat), mean, noise), weight, expected.z, expected.covariance
    )
    nothing = np.zeros(n)
    found = first_states(
        births, nothing + 1.0, expected, Measurements(z, spread, nothing, FOUR_LENGTHS), gate
    )
    density = np.empty(n)
    mean = mean.copy()
    for j in range(n):
        inside = True
        for a in range(rows.size):
            inside &= low[a] <= z[j, a] <= high[a]
        density[j] = rate[j] * max(found.density[j] if inside else 0.0, least)
        for c in range(d):
            # Observed components stay those of the detection.
            if hidden[c]:
                mean[j, c] = found.mean[j, c]
                for b in range(d):
                    if hidden[b]:
                        covariance[j, c, b] = found.covariance[j, c, b]
    return NewTargets(density, mean, covariance)
