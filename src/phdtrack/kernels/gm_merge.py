"""Mixture reduction: prune, merge and cap Gaussians, in time linear in their number.

Merging as printed takes the strongest remaining Gaussian j and merges with it all i of small (m_i −
m_j)ᵀ P_i⁻¹ (m_i − m_j), then the strongest of the rest, and so on. Here it is the other way round:
each Gaussian, by descending weight, joins the strongest head that it is near, or becomes a head
itself. The groups are the same, and because the distance is in its own covariance, the heads that
can be near lie in a rectangle about its mean: a grid of heads finds them at once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from phdtrack.kernels import F8, I8
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.gaussian import factored
from phdtrack.kernels.grid import cell_of

# ``axes`` is (0, 1, …, d − 1): the length of a tuple is known when a function is compiled, and
# loops of known length are unrolled, which saves a third of the time.
Axes = tuple[int, ...]


class Rows(NamedTuple):
    """A Gaussian mixture, a Gaussian a row: ``weight`` (J,), ``mean`` (J, d), ``covariance`` (J, d,
    d).
    """

    weight: F8
    mean: F8
    covariance: F8


class Merging(NamedTuple):
    """Settings of `filters.GMPHD` that a reduction needs."""

    weight_threshold: float
    merge_distance: float
    max_components: int
    keep_mass: bool


# Up to so many numbers, insertion sort is faster than radix sort.
FEW = 48
BITS = 8
SIZE = 1 << BITS
DIGITS = 8


@njit(**INNER)
def descending(weight: F8) -> I8:
    """(J,) indices by descending weight (each ≥ 0, no NaN), the lower index first where equal.

    The bits of positive floats sort like integers: a radix sort by bytes. It skips a digit in which
    all agree, as the exponents of most mixtures do.
    """
    n = weight.size
    order = np.empty(n, np.int64)
    if n <= FEW:
        for i in range(n):
            k = i
            while k > 0 and weight[order[k - 1]] < weight[i]:
                order[k] = order[k - 1]
                k -= 1
            order[k] = i
        return order
    bits = weight.view(np.int64)
    key = np.empty(n, np.int64)
    spare_key = np.empty(n, np.int64)
    spare = np.empty(n, np.int64)
    count = np.empty(DIGITS * SIZE, np.int64)
    for b in range(DIGITS * SIZE):
        count[b] = 0
    for i in range(n):
        key[i] = 0x7FFFFFFFFFFFFFFF - bits[i]
        order[i] = i
        for digit in range(DIGITS):
            count[digit * SIZE + ((key[i] >> (BITS * digit)) & (SIZE - 1))] += 1
    for digit in range(DIGITS):
        shift = BITS * digit
        first = digit * SIZE
        if count[first + ((key[0] >> shift) & (SIZE - 1))] == n:
            continue
        place = 0
        for b in range(first, first + SIZE):
            here = count[b]
            count[b] = place
            place += here
        for k in range(n):
            b = first + ((key[k] >> shift) & (SIZE - 1))
            spare[count[b]] = order[k]
            spare_key[count[b]] = key[k]
            count[b] += 1
        order, spare, key, spare_key = spare, order, spare_key, key
    return order


@njit(**INNER)
def _apart(step: F8, cov: F8, i: int, limit: float, axes: Axes) -> bool:
    """True if a single component shows that stepᵀ cov_i⁻¹ step is above ``limit``: it is at least
    step_r² / cov_rr.
    """
    far = False
    for r in range(len(axes)):
        far |= step[r] * step[r] > limit * cov[i, r, r]
    return far


@njit(**INNER)
def _distance2(step: F8, factors: F8, axes: Axes) -> float:
    """stepᵀ cov⁻¹ step from the factors as of `gaussian.factored`; overwrites ``step`` with L⁻¹
    step.
    """
    total = 0.0
    for r in range(len(axes)):
        for t in range(r):
            step[r] -= factors[r, t] * step[t]
        total += step[r] * step[r] * factors[r, r]
    return total


@njit(**INNER)
def _cells(x: F8, cov: F8, alive: I8) -> tuple[float, float, float, float, int, int]:
    """Origin, inverse cell size and number of cells of the heads' grid: cells of about four
    deviations, at most two cells a Gaussian.
    """
    n = alive.size
    x0 = np.inf
    y0 = np.inf
    x1 = -np.inf
    y1 = -np.inf
    wide = 0.0
    high = 0.0
    sums = 0.0
    for i in alive:
        x0 = min(x0, x[i, 0])
        x1 = max(x1, x[i, 0])
        y0 = min(y0, x[i, 1])
        y1 = max(y1, x[i, 1])
        sums += x[i, 0] + x[i, 1]
        wide += np.sqrt(cov[i, 0, 0])
        high += np.sqrt(cov[i, 1, 1])
    # A cell made of NaN would be written through.
    if not np.isfinite(sums + wide + high):
        raise ValueError("means and variances must be finite, and variances not negative")
    width = max(4.0 * wide / n, 1e-9)
    height = max(4.0 * high / n, 1e-9)
    columns = (x1 - x0) / width + 1.0
    lines = (y1 - y0) / height + 1.0
    most = 2.0 * n
    if columns * lines > most:
        shrink = np.sqrt(columns / most * lines)
        columns = max(1.0, min(columns / shrink, most))
        lines = max(1.0, min(lines / shrink, most))
    nx = int(columns)
    ny = int(lines)
    return x0, y0, nx / max(x1 - x0, 1e-9), ny / max(y1 - y0, 1e-9), nx, ny


@njit(**INNER)
def _by_weight(weight: F8, alive: I8) -> I8:
    """The indices ``alive`` (n,) by descending weight."""
    own = np.empty(alive.size)
    for k in range(alive.size):
        own[k] = weight[alive[k]]
    order: I8 = descending(own)
    for k in range(alive.size):
        order[k] = alive[order[k]]
    return order


@njit(**INNER)
def _factor_covariance(cov: F8, i: int, factors: F8, axes: Axes) -> None:
    """Write the factors of covariance i, see `gaussian.factored`."""
    for r in range(len(axes)):
        for t in range(r + 1):
            factors[r, t] = cov[i, r, t]
    factored(factors, axes)


@njit(**INNER)
def _reaches(cov: F8, order: I8, distance: float) -> F8:
    """(n, 2) the distances along x and y within which a head can be near each Gaussian."""
    out = np.empty((order.size, 2))
    for k in range(order.size):
        for r in range(2):
            out[k, r] = distance * np.sqrt(cov[order[k], r, r])
    return out


@njit(**INNER)
def _ranges(
    x: F8, order: I8, reach: F8, grid: tuple[float, float, float, float, int, int]
) -> tuple[I8, I8, I8, I8, I8]:
    """(n,) the first and last columns and lines of cells within reach of each mean, and its own
    cell.
    """
    x0, y0, sx, sy, nx, ny = grid
    n = order.size
    out = np.empty((5, n), np.int64)
    for k in range(n):
        px = x[order[k], 0]
        py = x[order[k], 1]
        out[0, k] = cell_of(px - reach[k, 0], x0, sx, nx)
        out[1, k] = cell_of(px + reach[k, 0], x0, sx, nx)
        out[2, k] = cell_of(py - reach[k, 1], y0, sy, ny)
        out[3, k] = cell_of(py + reach[k, 1], y0, sy, ny)
        out[4, k] = cell_of(py, y0, sy, ny) * nx + cell_of(px, x0, sx, nx)
    return out[0], out[1], out[2], out[3], out[4]


@njit(**INNER)
def _groups(
    weight: F8, x: F8, cov: F8, alive: I8, distance: float, axes: Axes
) -> tuple[I8, I8, I8]:
    """Indices by descending weight (n,), the number of the group of each of these (n,), the head of
    each group (k,).
    """
    n = alive.size
    order = _by_weight(weight, alive)
    reach = _reaches(cov, order, distance)
    limit = distance * distance
    group = np.empty(n, np.int64)
    head = np.empty(n, np.int64)
    # The groups whose heads are in each cell, as a list: its first one, and the next after each.
    grid = _cells(x, cov, alive)
    nx = grid[4]
    first = np.full(nx * grid[5], -1, np.int64)
    left, right, top, bottom, home = _ranges(x, order, reach, grid)
    after = np.empty(n, np.int64)
    factors = np.empty((len(axes), len(axes)))
    step = np.empty(len(axes))
    count = 0
    for k in range(n):
        i = order[k]
        best = n
        known = False
        for line in range(top[k], bottom[k] + 1):
            for column in range(left[k], right[k] + 1):
                g = first[line * nx + column]
                while g >= 0:
                    # The strongest head counts; one weaker than the best so far cannot win.
                    if g < best and _within(x, head[g], i, reach, k):
                        for r in range(len(axes)):
                            step[r] = x[head[g], r] - x[i, r]
                        if not _apart(step, cov, i, limit, axes):
                            if not known:
                                _factor_covariance(cov, i, factors, axes)
                                known = True
                            if _distance2(step, factors, axes) <= limit:
                                best = g
                    g = after[g]
        if best == n:
            best = count
            head[count] = i
            after[count] = first[home[k]]
            first[home[k]] = count
            count += 1
        group[k] = best
    return order, group, head[:count]


@njit(**INNER)
def _within(x: F8, h: int, i: int, reach: F8, k: int) -> bool:
    """True if means h and i are within the reach of the k-th Gaussian along x and y."""
    across: bool = abs(x[h, 0] - x[i, 0]) <= reach[k, 0]
    along: bool = abs(x[h, 1] - x[i, 1]) <= reach[k, 1]
    return across and along


class GroupSums(NamedTuple):
    """Sums over the members of k groups: ``mass`` (k,), how many they are ``members`` (k,), and,
    for those of several, Σ w·step ``first`` (k, d) and Σ w (P + step stepᵀ) ``second`` (k, d, d),
    its lower triangle, with steps from the head.
    """

    mass: F8
    members: I8
    first: F8
    second: F8


@njit(**INNER)
def _summed(weight: F8, x: F8, cov: F8, order: I8, group: I8, head: I8, axes: Axes) -> GroupSums:
    """Sums over the members of the groups.

    About the head, the strongest member, so that no digits are lost far from the origin.
    """
    d = len(axes)
    count = head.size
    mass = np.empty(count)
    step = np.empty(d)
    members = np.empty(count, np.int64)
    first = np.empty((count, d))
    second = np.empty((count, d, d))
    for g in range(count):
        mass[g] = 0.0
        members[g] = 0
    for k in range(order.size):
        i = order[k]
        g = group[k]
        w = weight[i]
        h = head[g]
        mass[g] += w
        members[g] += 1
        if members[g] == 1:
            continue
        if members[g] == 2:
            for r in range(d):
                first[g, r] = 0.0
                for s in range(r + 1):
                    second[g, r, s] = weight[h] * cov[h, r, s]
        for r in range(d):
            step[r] = x[i, r] - x[h, r]
            first[g, r] += w * step[r]
            for s in range(r + 1):
                second[g, r, s] += w * (cov[i, r, s] + step[r] * step[s])
    return GroupSums(mass, members, first, second)


@njit(**INNER)
def _heaviest(mass: F8, most: int) -> I8:
    """The groups that are kept: all in their order, or the ``most`` heaviest (0: no limit)."""
    if 0 < most < mass.size:
        order: I8 = descending(mass)[:most]
        return order
    return np.arange(mass.size)


@njit(**INNER)
def _merged(
    sums: GroupSums, x: F8, cov: F8, head: I8, kept: I8, wanted: float, axes: Axes
) -> tuple[F8, F8, F8]:
    """Mass (k,), mean (d, k) and covariance (k, d, d) of the groups that are ``kept`` (k,); see
    `merged_rows`.
    """
    mass, members, first, second = sums
    d = len(axes)
    size = kept.size
    total = 0.0
    for k in range(size):
        total += mass[kept[k]]
    scale = 1.0
    if wanted >= 0.0 and total > 0.0:
        scale = wanted / total
    step = np.empty(d)
    out_mass = np.empty(size)
    out_mean = np.empty((d, size))
    out_cov = np.empty((size, d, d))
    for k in range(size):
        g = kept[k]
        i = head[g]
        out_mass[k] = scale * mass[g]
        # A head without weight has members without weight: it represents them.
        several = members[g] > 1 and mass[g] > 0.0
        share = 0.0
        if several:
            share = 1.0 / mass[g]
        for r in range(d):
            step[r] = 0.0
            if several:
                step[r] = first[g, r] * share
            out_mean[r, k] = x[i, r] + step[r]
            for s in range(r + 1):
                value = cov[i, r, s]
                if several:
                    value = second[g, r, s] * share - step[r] * step[s]
                out_cov[k, r, s] = value
                out_cov[k, s, r] = value
    return out_mass, out_mean, out_cov


@njit(**ENTRY)
def merged_rows(rows: Rows, axes: Axes, s: Merging, mass: float) -> tuple[F8, F8, F8]:
    """Prune, merge and cap: weight (k,), mean (d, k), covariance (k, d, d).

    Each group has mass, mean and covariance of its members; groups are ordered by the weights of
    their strongest members. The weights are scaled to the sum ``mass``, unless it is negative.
    ValueError if a mean or a variance is NaN or infinite, or a variance negative.
    """
    weight, x, cov = rows
    alive = np.empty(weight.size, np.int64)
    count = 0 * weight.size
    for i in range(weight.size):
        if weight[i] >= s.weight_threshold:
            alive[count] = i
            count += 1
    alive = alive[:count]
    if count == 0:
        return np.empty(0), np.empty((len(axes), 0)), np.empty((0, len(axes), len(axes)))
    order, group, head = _groups(weight, x, cov, alive, s.merge_distance, axes)
    sums = _summed(weight, x, cov, order, group, head, axes)
    kept = _heaviest(sums.mass, s.max_components)
    out: tuple[F8, F8, F8] = _merged(sums, x, cov, head, kept, mass, axes)
    return out
