"""Gaussians and measurements of one frame as arrays, and what all Gaussian filters compute of them
[V06 (24)–(38)].

A model answers for one frame with four records, which `models.gaussian` asks it for: `Predicted`
(its motion), `Expected` (its sensor), `Measurements` (its sensor and its clutter) and `Births`.
GM-PHD, GM-CPHD, PMB and MHT are compiled over these records and know nothing else of the model:
boxes, ground plane, points and bearings, linear or by sigma points, are all the same here.

For Gaussian i with expected measurement ẑ_i, spread H P Hᵀ (or that of its sigma points) and
cross-covariance C = P Hᵀ, and measurement j, with R = R_i + R_j

    S = H P Hᵀ + R = L D Lᵀ,   y = L⁻¹ (z_j − ẑ_i),   W = L⁻¹ Cᵀ d² = yᵀ D⁻¹ y,   log N(z_j; ẑ_i, S)
    = −(d² + log |2πS|)/2,   m' = m + Wᵀ D⁻¹ y,   P' = P − Wᵀ D⁻¹ W

which is symmetric by construction and needs no inverse. Where no noise belongs to a measurement, S
is the same for all measurements and factored once for each Gaussian.

Arrays are C-contiguous, float64 or int64; the first axis counts Gaussians (J), births (B),
measurements (N) or pairs (P). A state has d components, and r components of a measurement are
compared. The functions here are for kernels (`INNER`): a filter calls them in a kernel that is
compiled for it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import config

from phdtrack.kernels import F8, I8, Records
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.grid import cell_of

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
    """What Gaussians say about measurements.

    ``rows`` (r,), int64: what is compared with the components of a measurement. ``z`` (J, n):
    ``rows`` of it are the expected measurement. ``covariance`` (J, n, n) of it without noise, H P
    Hᵀ in these rows and columns; ``cross`` (J, d, n): of state and measurement, P Hᵀ in these
    columns. ``noise`` (J, r, r): part of R that belongs to the target, (0, r, r) where none does.
    ``p_detect`` (J,): at the mean.

    A linear sensor shows ``rows`` of the state: ``z`` is the mean then, and ``covariance`` and
    ``cross`` are the covariance of the Gaussians themselves. Of any other they are made of sigma
    points, and ``rows`` are 0, 1, …, r − 1.
    """

    rows: I8
    z: F8
    covariance: F8
    cross: F8
    noise: F8
    p_detect: F8


class Measurements(NamedTuple):
    """The measurements of a frame.

    ``z`` (N, r) is compared with `Expected.z`. ``noise`` (N, r, r): part of R that belongs to the
    measurement, added to that of the target, or (0, r, r). ``clutter`` (N,): κ(z), expected false
    alarms per unit of measurement volume. ``period``: r numbers, 2π for angles, whose differences
    are taken the short way round, else 0. A tuple: its length is known when a kernel is compiled,
    and loops over it are unrolled.
    """

    z: F8
    noise: F8
    clutter: F8
    period: Period


class NewTargets(NamedTuple):
    """Targets whose first detection is measurement j.

    ``density`` (N,): theirs at the measurement, per unit of its volume. ``mean`` (N, d),
    ``covariance`` (N, d, d): of their state.
    """

    density: F8
    mean: F8
    covariance: F8


class Births(NamedTuple):
    """γT, the intensity of targets that appeared in the interval.

    ``around``: γT at each measurement, and what the measurement says of a target there that nothing
    else is known of. Filters leave out those whose measurement existing targets explain. ``weight``
    (B,), ``mean`` (B, d), ``covariance`` (B, d, d): expected number of births of each Gaussian that
    was given, wherever measurements are, and its moments.
    """

    around: NewTargets
    weight: F8
    mean: F8
    covariance: F8


def records(floats: str, integers: str) -> np.dtype[np.void]:
    """The type of arrays of records with these fields; where nothing is compiled, Python must read
    them as attributes.
    """
    fields = [(name, "f8") for name in floats.split()] + [(name, "i8") for name in integers.split()]
    if config.DISABLE_JIT:
        return np.dtype((np.record, fields))
    return np.dtype(fields)


# A Gaussian and a measurement within the gate of each other: d², the first two components' part of
# it, the log of the measurement's density, and what a filter weighs the pair with.
PAIR = records("distance2 first log_density weight", "gaussian measurement")
# For those whose noises are as the model says.
GAUSSIAN = np.zeros((0, 3))
# A measurement in `places_of`: its components along and across, and which one it is.
SPOT = records("along across", "measurement")


@njit(**INNER)
def factor(cov: F8, root: F8) -> float:
    """Log-determinant of ``cov`` (m, m), whose Cholesky factor is written into the lower part of
    ``root`` (m, m).

    NaN where the matrix is not positive definite, −∞ or NaN where it is singular.
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


@njit(**INNER)
def norm2(step: F8, root: F8, y: F8) -> float:
    """Squared Mahalanobis norm of ``step`` (m,) under the matrix that ``root`` factors; ``y`` (m,)
    becomes L⁻¹ step.
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

    NaN where a matrix is not positive definite.
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
    """The determinant of S, whose lower part is in ``s`` (r, r), which becomes the factors of S = L
    D Lᵀ.

    L below the diagonal, D⁻¹ in it, (L D)ᵀ above it. NaN where S is not positive definite. ``axes``
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
    """|S| of Gaussian i and measurement j, whose factors are written into ``s`` (r, r), see
    `factored`.

    ``spread``, ``rows`` and ``noise`` are of `Expected`, ``extra`` is the noise and ``period`` that
    of `Measurements`. Without noise of measurements j does not count.
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
def whitened(seen: F8, rows: I8, z: F8, i: int, j: int, period: Axes, s: F8, y: F8) -> float:
    """d² of Gaussian i and measurement j, and L⁻¹ (z − ẑ) into ``y`` (r,).

    ``seen`` and ``rows`` are of `Expected`, ``z`` and ``period`` of `Measurements`, ``s`` of
    `innovation`.
    """
    total = 0.0
    for a in range(len(period)):
        value = z[j, a] - seen[i, rows[a]]
        if period[a] > 0.0:
            value -= period[a] * np.rint(value / period[a])
        for t in range(a):
            value -= s[a, t] * y[t]
        y[a] = value
        total += value * value * s[a, a]
    return total


@njit(**INNER)
def places_of(z: F8, period: Axes) -> tuple[Records, I8, int, int, float, float, bool]:
    """The measurements by cells along one of their first two components, the one on which they are
    spread most.

    (N,) of `SPOT`, about one in each cell; where each begins (cells + 1,); that component, and the
    other one; low and scale, a value lies in cell (value − low)·scale; whether what is far along an
    axis is far altogether: not of angles, which are all in one cell. Raises ValueError where a
    measurement is NaN or infinite.
    """
    n = len(z)
    along = 0 * len(z)
    low = 0.0
    widest = 0.0
    near = False
    for a in range(len(period)):
        least = np.inf
        most = -np.inf
        total = 0.0
        for j in range(n):
            value = z[j, a]
            least = value if value < least else least
            most = value if value > most else most
            total = total + value
        if not np.isfinite(total):
            raise ValueError("measurements must be finite")
        if period[a] == 0.0 and a < 2 and most - least > widest:
            along = a
            low = least
            widest = most - least
            near = True
    if len(period) > 1 and period[1 - along] == 0.0:
        across = 1 - along
    else:
        across = along
    count = n if near else 1
    scale = count / widest if near else 0.0
    begin = np.empty(count + 1, np.int64)
    spots = np.empty(n, SPOT)
    for c in range(count + 1):
        begin[c] = 0
    for j in range(n):
        begin[cell_of(z[j, along], low, scale, count)] += 1
    # From the last one back: a cell's end becomes its beginning.
    for c in range(count):
        begin[c + 1] += begin[c]
    for back in range(n):
        j = n - 1 - back
        c = cell_of(z[j, along], low, scale, count)
        begin[c] -= 1
        spot = spots[begin[c]]
        spot.along = z[j, along]
        spot.across = z[j, across]
        spot.measurement = j
    return spots, begin, along, across, low, scale, near


@njit(**INNER)
def with_tails(
    first: float, rest: float, count: int, position_scale: float, size_scale: float, freedom: float
) -> tuple[float, float]:
    """d² by noises whose variances are c times the model's, and the log-density without
    −log(2π)^(m/2)√|S| [WH97 §10.8].

    Each two of the ``count`` components, 2 or 4, are Student's t: −log c − (n/2 + 1) log(1 +
    d²/(nc)), with d² by the model's noises ``first`` and ``rest``, c the two scales, and n the
    ``freedom`` with which they are known.
    """
    own = first / position_scale
    power = 0.5 * freedom + 1.0
    value = -np.log(position_scale) - power * np.log1p(own / freedom)
    if count > 2:
        value -= np.log(size_scale) + power * np.log1p(rest / size_scale / freedom)
        own += rest / size_scale
    return own, value


@njit(**INNER)
def gated(
    rows: I8,
    seen: F8,
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

    They are ordered by Gaussian. Their weight is not written. The first arguments are as `Expected`
    and `Measurements` have them. Gaussians at which ``active`` (J,) is 0 are left out. ``tails``
    (J, 3): c of the first two components and of two others, and n, see `with_tails`; `GAUSSIAN` for
    none.
    """
    spots, begin, along, across, low, scale, near = places_of(z, period)
    s = np.empty((rows.size, rows.size))
    y = np.empty(rows.size)
    wide = 0.0
    high = 0.0
    for j in range(len(extra)):
        if extra[j, along, along] > wide:
            wide = extra[j, along, along]
        else:
            wide = wide
        if extra[j, across, across] > high:
            high = extra[j, across, across]
        else:
            high = high
    row = rows[along]
    other = rows[across]
    found = 0 * len(z)
    cells = begin.size - 1
    limit = gate * gate
    pairs = np.empty(2 * len(seen) + 2 * len(z) + 16, PAIR)
    for i in range(len(seen)):
        if not active[i] > 0.0:
            continue
        reach = spread[i, row, row] + wide
        width = spread[i, other, other] + high
        if len(noise) > 0:
            reach = reach + noise[i, along, along]
            width = width + noise[i, across, across]
        if len(tails) > 0:
            reach = reach * tails[i, 0]
            width = width * tails[i, 0]
        if near:
            reach = gate * np.sqrt(reach)
        else:
            reach = np.inf
        if near:
            width = gate * np.sqrt(width)
        else:
            width = np.inf
        x = seen[i, row]
        middle = seen[i, other]
        log_det = 0.0
        known = False
        for k in range(
            begin[cell_of(x - reach, low, scale, cells)],
            begin[cell_of(x + reach, low, scale, cells) + 1],
        ):
            spot = spots[k]
            if abs(spot.along - x) > reach or abs(spot.across - middle) > width:
                continue
            j = spot.measurement
            if len(extra) > 0 or not known:
                log_det = (
                    np.log(innovation(spread, rows, noise, extra, i, j, period, s))
                    + len(period) * LOG_2PI
                )
                known = True
            d2 = first = whitened(seen, rows, z, i, j, period, s, y)
            reached = d2
            value = -0.5 * (d2 + log_det)
            if len(tails) > 0:
                if len(period) > 2:
                    first = y[0] * y[0] * s[0, 0] + y[1] * y[1] * s[1, 1]
                else:
                    first = d2
                reached, value = with_tails(
                    first, d2 - first, len(period), tails[i, 0], tails[i, 1], tails[i, 2]
                )
                value -= 0.5 * log_det
            if reached <= limit:
                if found == pairs.size:
                    more = np.empty(2 * found, PAIR)
                    # In a loop: an assignment of a slice would compile Numba's code for its error
                    # messages.
                    for q in range(found):
                        more[q] = pairs[q]
                    pairs = more
                pair = pairs[found]
                pair.gaussian = i
                pair.measurement = j
                pair.distance2 = d2
                pair.first = first
                pair.log_density = value
                found += 1
    return pairs[:found]


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
    """Means and covariances of pairs after the update [V06 (37), (38)], into the first rows of the
    outputs.

    ``pairs`` (P,) of `PAIR`: faster where those of one Gaussian follow each other. Those of
    measurement −1 are left out.
    """
    rows = e.rows
    seen = e.z
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
        k = p
        if j < 0:
            continue
        if len(extra) > 0 or i != last:
            innovation(spread, rows, noise, extra, i, j, period, s)
            last = i
        whitened(seen, rows, z, i, j, period, s, y)
        for c in range(d):
            total = mean[i, c]
            for a in range(len(period)):
                value = cross[i, c, rows[a]]
                for t in range(a):
                    value -= s[a, t] * w[c, t]
                w[c, a] = value
                total += value * s[a, a] * y[a]
            out_mean[k, c] = total
            for b in range(c + 1):
                value = covariance[i, c, b]
                for a in range(len(period)):
                    value -= w[c, a] * s[a, a] * w[b, a]
                out_covariance[k, c, b] = value
                out_covariance[k, b, c] = value


# The same two for callers in Python.
all_gated, all_posteriors = (
    njit(**ENTRY)(getattr(kernel, "py_func", kernel)) for kernel in (gated, write_posteriors)
)


@njit(**ENTRY)
def first_states(
    births: Births, p_detect: F8, e: Expected, m: Measurements, gate: float
) -> NewTargets:
    """γ̂(z) = ∫ p_D g(z|x) γ(x) dx, and mean and covariance of p_D g(z|x) γ(x) given z.

    ``p_detect`` (N,): of targets around each measurement. ``e``: what the births that are given say
    of measurements.
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
    for q in range(pairs.size):
        pair = pairs[q]
        pair.weight = (
            births.weight[pair.gaussian] * e.p_detect[pair.gaussian] * np.exp(pair.log_density)
        )
        density[pair.measurement] += pair.weight
    mean = np.zeros((n, d))
    cov = np.zeros((n, d, d))
    # First the means, then the covariances about them.
    for turn in range(2):
        for q in range(pairs.size + n):
            from_given = q < pairs.size
            k = q if from_given else q - pairs.size
            if from_given:
                j = pairs[k].measurement
            else:
                j = k
            if from_given:
                weight = pairs[k].weight
            else:
                weight = p_detect[j] * around.density[j]
            if not weight > 0.0:
                continue
            share = weight / density[j]
            for a in range(d):
                if from_given:
                    state = states[k, a]
                else:
                    state = around.mean[j, a]
                if turn == 0:
                    mean[j, a] += share * state
                    continue
                for b in range(d):
                    if from_given:
                        other = states[k, b]
                    else:
                        other = around.mean[j, b]
                    if from_given:
                        value = covs[k, a, b]
                    else:
                        value = around.covariance[j, a, b]
                    cov[j, a, b] += share * (value + (state - mean[j, a]) * (other - mean[j, b]))
    return NewTargets(density, mean, cov)
